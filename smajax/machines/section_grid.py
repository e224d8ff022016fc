"""The grid on half a cross-section: its faces lie on the layers' interfaces and on the square around each wire.

Square and gaps stretch with the wire and its distances while the numbers of cells stay. So one compiled program serves all dimensions, and
every cell keeps its share of the wire: the shares are constants, computed once and exactly, and temperatures are smooth in every dimension.
Beside the square the cells grow geometrically from its own size.

A cell that the wire's edge cuts conducts along ``LANES`` parallel lanes, of each of which the part inside the wire is known.
"""

import functools
from typing import NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np

from smajax.parameters import parameter

LANES = 8
# Up to where cells shrink freely towards a gap's end, by the logarithm of the last over the first; over how much of it they then get even.
_SHRUNK, _EVENED = -7.0, 4.0
# A gap narrower than this share of a cell beside it is none: rounding would fill it.
_LEAST = 1e-3


class Columns(NamedTuple):
    """Cells across the section, from the plane of symmetry outwards.

    ``widths``, shape ``(c,)``, in m; ``wires``: for each wire, the column in which its square begins, and whether it is the outer half only
    of a wire on the plane of symmetry; ``open``: whether the outer side meets the air, else it is a plane of symmetry, too.
    """

    widths: jax.Array
    wires: tuple[tuple[int, bool], ...]
    open: bool


class AbstractPlacement(eqx.Module):
    """Where the wires are across the section's width."""

    def columns(self, width: jax.Array, diameter: jax.Array, cells: int) -> Columns:
        """The columns with ``cells`` (even) across each wire, and twice as many in each gap beside it."""
        raise NotImplementedError


class EvenWires(AbstractPlacement):
    """Wires in the middles of equal shares of the width, each cooling like the others: half a share is enough of the section.

    The section's outer sides then count as adiabatic. ``count`` need not be whole, and can be differentiated in.
    """

    count: jax.Array = parameter("1", "number of wires side by side", 1.0, 1000.0, whole=True)

    def columns(self, width: jax.Array, diameter: jax.Array, cells: int) -> Columns:
        """See ``AbstractPlacement``."""
        size = diameter / cells
        gap = graded(size, 0.5 * (width / self.count - diameter), 2 * cells)
        return Columns(jnp.concatenate([jnp.broadcast_to(size, (cells // 2,)), gap]), ((0, True),), False)


class SpacedWires(AbstractPlacement):
    """So many wires at a pitch, in the middle of the section."""

    wires: int = eqx.field(static=True)
    pitch: jax.Array = parameter("m", "distance from wire to wire", 1e-6, 1.0)

    def columns(self, width: jax.Array, diameter: jax.Array, cells: int) -> Columns:
        """See ``AbstractPlacement``."""
        size = diameter / cells
        across = jnp.broadcast_to(size, (cells,))
        between = graded(size, 0.5 * (self.pitch - diameter), 2 * cells)
        margin = graded(size, 0.5 * (width - (self.wires - 1) * self.pitch - diameter), 2 * cells)
        half = self.wires % 2 == 1
        parts = [across[: cells // 2]] if half else [between[::-1], across]
        wires = [(0, True)] if half else [(2 * cells, False)]
        for _ in range((self.wires - 1) // 2):
            parts += [between, between[::-1], across]
            wires.append((sum(map(len, parts)) - cells, False))
        return Columns(jnp.concatenate([*parts, margin]), tuple(wires), True)


def graded(first: jax.Array, length: jax.Array, cells: int) -> jax.Array:
    """Widths of so many cells that fill a length, in m: ``first`` q, ``first`` q^2, ..., shape ``(cells,)``; NaN for a length of none.

    q is found by Newton's method on a convex function, and differentiated by one step of it from there. In a gap of few cells' size q goes
    back to 1, smoothly, so that no cell vanishes, which rounding would turn into heat, and the first one gives way.
    """
    wanted = jnp.log(length / first)
    powers = jnp.arange(1.0, cells + 1.0)

    def closer(growth: jax.Array) -> jax.Array:
        slope = jnp.sum(powers * jax.nn.softmax(growth * powers))
        return growth - (jax.nn.logsumexp(growth * powers) - wanted) / slope

    found = jax.lax.fori_loop(0, 30, lambda _, growth: closer(growth), jnp.zeros(()))
    fixed = jax.lax.stop_gradient(found)
    slope = jax.lax.stop_gradient(jnp.sum(powers * jax.nn.softmax(fixed * powers)))
    growth = fixed + (wanted - jax.lax.stop_gradient(jax.nn.logsumexp(fixed * powers))) / slope
    over = growth * cells - _SHRUNK
    growth = jnp.where(over < 0.0, growth * jnp.exp(-((over / _EVENED) ** 4)), growth)
    return jnp.where(length > _LEAST * first, length, jnp.nan) * jax.nn.softmax(growth * powers)


class Shares(NamedTuple):
    """How much of a cell is wire: of its area, shape ``(c, r)``; of each lane through its left and right, lower and upper half,
    shape ``(c, r, LANES)``."""

    area: np.ndarray
    left: np.ndarray
    right: np.ndarray
    lower: np.ndarray
    upper: np.ndarray


@functools.cache
def circle(cells: int) -> Shares:
    """The shares of ``cells`` by ``cells`` cells in the square around a circle."""
    edges = np.linspace(-1.0, 1.0, cells + 1)
    middles = 0.5 * (edges[1:] + edges[:-1])

    def inside(low: np.ndarray, high: np.ndarray, lanes: int) -> np.ndarray:
        """The part inside of lanes from ``low`` to ``high``, one a cell, at so many heights in each row: (column, row, lane)."""
        height = (edges[:-1, None] + (edges[1] - edges[0]) * (np.arange(lanes) + 0.5) / lanes)[None]
        reach = np.sqrt(1.0 - height**2)
        covered = np.minimum(high[:, None, None], reach) - np.maximum(low[:, None, None], -reach)
        return np.maximum(covered, 0.0) / (high - low)[:, None, None]

    area = inside(edges[:-1], edges[1:], 256).mean(axis=2)
    area = np.where(area < 1.0, area * (1.0 + _shortfall(area)), area)
    left, right = inside(edges[:-1], middles, LANES), inside(middles, edges[1:], LANES)
    return Shares(area, left, right, left.transpose(1, 0, 2), right.transpose(1, 0, 2))


def _shortfall(area: np.ndarray) -> float:
    """By how much the cells that are cut have to grow together for the areas to add up to the circle's."""
    cut = area[area < 1.0].sum()
    return (np.pi / 4.0 * area.size - area.sum()) / cut


def place(cells: int, wires: tuple[tuple[int, bool], ...], row: int, shape: tuple[int, int]) -> Shares:
    """The shares on a grid of ``shape`` with squares that begin in the given columns and in the row ``row``."""
    whole = circle(cells)
    placed = [np.zeros((*shape, *part.shape[2:])) for part in whole]
    for start, half in wires:
        for grid, part in zip(placed, whole, strict=True):
            part = part[cells // 2 :] if half else part
            grid[start : start + len(part), row : row + cells] = part
    return Shares(*placed)
