"""Grid on half a cross-section: its faces lie on the interfaces of the layers and on the square around each wire.

The squares scale with the wire and the gaps with the distances, while the numbers of cells are constant. So one
compiled program serves all dimensions, and every cell keeps its share of the wire (``smajax.actuators.wire_shares``):
temperatures are smooth functions of every dimension. Outside a square the cells grow geometrically, starting from the
size of the cells in the square.
"""

import abc
from typing import NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Float

from smajax.parameters import CheckedModule, parameter

# Logarithm of the last cell over the first, down to which cells shrink towards the end of a narrow gap; chosen by
# trial, tests/unit/actuators/test_cross_section.py holds it (narrow gaps conserve heat).
_SHRINK_LIMIT = -7.0
# Range of the same logarithm below that limit over which the cells become equal again; chosen by trial with it.
_EQUALISING_RANGE = 4.0
# A gap narrower than this share of the adjacent cell is not resolved, since its cells would be dominated by rounding.
# Chosen by trial; the same test holds it.
_SMALLEST_GAP = 1e-3
# Newton iterations on a convex function from 0, which converge quadratically; chosen by trial.
_ITERATIONS = 30


class Columns(NamedTuple):
    """Cells across the section, from the plane of symmetry outwards.

    Attributes:
        widths: Widths of the columns, shape ``(c,)``, m.
        wires: For each wire, the column in which its square begins, and whether only its outer half is in the grid,
            because the wire lies on the plane of symmetry.
        open: Whether the outer side is exposed to the air; otherwise it is a plane of symmetry, too.
    """

    widths: jax.Array
    wires: tuple[tuple[int, bool], ...]
    open: bool


class AbstractPlacement(CheckedModule):
    """Placement of the wires across the section's width."""

    @abc.abstractmethod
    def columns(self, width: Float[Array, ""], diameter: Float[Array, ""], cells: int) -> Columns:
        """Compute the columns of half the section, or of half a part of it that repeats.

        Args:
            width: Width of the section, m.
            diameter: Diameter of the wires, m.
            cells: Number of columns across a wire, even; there are twice as many in each gap next to it.
        """


class EvenWires(AbstractPlacement):
    """Wires in the middle of equal shares of the width.

    All shares cool in the same way, so half a share is simulated; the outer sides of the section count as adiabatic.
    ``count`` may be fractional, and is differentiable.
    """

    count: jax.Array = parameter("1", "number of wires side by side", 1.0, 1000.0, whole=True)

    def columns(self, width: Float[Array, ""], diameter: Float[Array, ""], cells: int) -> Columns:
        """Compute the columns of half a share: half a wire and half a gap."""
        size = diameter / cells
        gap = graded_widths(size, 0.5 * (width / self.count - diameter), 2 * cells)
        return Columns(jnp.concatenate([jnp.broadcast_to(size, (cells // 2,)), gap]), ((0, True),), False)


class SpacedWires(AbstractPlacement):
    """Wires at a constant pitch, in the middle of the section.

    Attributes:
        wires: Number of wires.
        pitch: Distance from wire to wire, m.
    """

    wires: int = eqx.field(static=True)
    pitch: jax.Array = parameter("m", "distance from wire to wire", 1e-6, 1.0)

    def columns(self, width: Float[Array, ""], diameter: Float[Array, ""], cells: int) -> Columns:
        """Compute the columns of half the section."""
        size = diameter / cells
        across = jnp.broadcast_to(size, (cells,))
        between = graded_widths(size, 0.5 * (self.pitch - diameter), 2 * cells)
        margin = graded_widths(size, 0.5 * (width - (self.wires - 1) * self.pitch - diameter), 2 * cells)
        is_odd = self.wires % 2 == 1
        parts = [across[: cells // 2]] if is_odd else [between[::-1], across]
        wires = [(0, True)] if is_odd else [(2 * cells, False)]
        for _ in range((self.wires - 1) // 2):
            parts += [between, between[::-1], across]
            wires.append((sum(map(len, parts)) - cells, False))
        return Columns(jnp.concatenate([*parts, margin]), tuple(wires), True)


def graded_widths(first: Float[Array, ""], length: Float[Array, ""], cells: int) -> Float[Array, " cells"]:
    """Compute the widths of cells that fill a length and grow geometrically: first q, first q^2, and so on.

    The growth factor q is the root of a convex function, found by Newton's method; one Newton step at the root carries
    its derivative. In a gap that is narrow compared with ``first``, q returns to 1 smoothly: a vanishing cell would
    turn rounding errors into heat. The first cell then differs from first q.

    Args:
        first: Width of the cell before the first one, m.
        length: Length to fill, m.
        cells: Number of cells.

    Returns:
        Widths, shape ``(cells,)``, m; NaN for a length of 0.
    """
    target = jnp.log(length / first)
    powers = jnp.arange(1.0, cells + 1.0)

    def iterate(growth: jax.Array) -> jax.Array:
        slope = jnp.sum(powers * jax.nn.softmax(growth * powers))
        return growth - (jax.nn.logsumexp(growth * powers) - target) / slope

    root = jax.lax.fori_loop(0, _ITERATIONS, lambda _, growth: iterate(growth), jnp.zeros(()))
    fixed = jax.lax.stop_gradient(root)
    slope = jax.lax.stop_gradient(jnp.sum(powers * jax.nn.softmax(fixed * powers)))
    growth = fixed + (target - jax.lax.stop_gradient(jax.nn.logsumexp(fixed * powers))) / slope
    excess = growth * cells - _SHRINK_LIMIT
    growth = jnp.where(excess < 0.0, growth * jnp.exp(-((excess / _EQUALISING_RANGE) ** 4)), growth)
    return jnp.where(length > _SMALLEST_GAP * first, length, jnp.nan) * jax.nn.softmax(growth * powers)
