"""Grid on half a cross-section: its faces lie on the interfaces of the layers and on the square around each wire.

Square and gaps scale with the wire and its distances while the numbers of cells stay. So one compiled program serves
all dimensions, and every cell keeps its share of the wire (``smajax.actuators.wire_shares``): temperatures are smooth
in every dimension. Next to the square the cells grow geometrically from its own cell size.
"""

from typing import NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp

from smajax.parameters import parameter

# Down to this logarithm of the last cell over the first, cells shrink freely towards the end of a gap; chosen by trial,
# tests/unit/actuators/test_cross_section.py holds it (narrow gaps conserve heat).
_SHRINK_LIMIT = -7.0
# Range of the same logarithm below that limit over which the cells become equal again; chosen by trial with it.
_EQUALISING_RANGE = 4.0
# A gap narrower than this share of a cell next to it counts as none: rounding would fill it. Chosen by trial; the same
# test holds it.
_SMALLEST_GAP = 1e-3
# Newton iterations on a convex function from 0, which converge quadratically; chosen by trial.
_ITERATIONS = 30


class Columns(NamedTuple):
    """Cells across the section, from the plane of symmetry outwards.

    Attributes:
        widths: Widths of the columns, shape ``(c,)``, m. wires: For each wire, the column in which its square begins,
        and whether it is only the outer half of a wire on the plane of
            symmetry.
        open: Whether the outer side is exposed to the air; otherwise it is a plane of symmetry, too.
    """

    widths: jax.Array
    wires: tuple[tuple[int, bool], ...]
    open: bool


class AbstractPlacement(eqx.Module):
    """Placement of the wires across the section's width."""

    def columns(self, width: jax.Array, diameter: jax.Array, cells: int) -> Columns:
        """Return the columns with ``cells`` (even) across each wire, and twice as many in each gap next to it."""
        raise NotImplementedError


class EvenWires(AbstractPlacement):
    """Wires in the middles of equal shares of the width, which all cool alike: half a share of the section suffices.

    The outer sides of the section then count as adiabatic. ``count`` need not be whole, and is differentiable.
    """

    count: jax.Array = parameter("1", "number of wires side by side", 1.0, 1000.0, whole=True)

    def columns(self, width: jax.Array, diameter: jax.Array, cells: int) -> Columns:
        """Return the columns of half a share: half a wire and half a gap."""
        size = diameter / cells
        gap = graded_widths(size, 0.5 * (width / self.count - diameter), 2 * cells)
        return Columns(jnp.concatenate([jnp.broadcast_to(size, (cells // 2,)), gap]), ((0, True),), False)


class SpacedWires(AbstractPlacement):
    """A number of wires at a pitch, in the middle of the section."""

    wires: int = eqx.field(static=True)
    pitch: jax.Array = parameter("m", "distance from wire to wire", 1e-6, 1.0)

    def columns(self, width: jax.Array, diameter: jax.Array, cells: int) -> Columns:
        """Return the columns of half the section."""
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


def graded_widths(first: jax.Array, length: jax.Array, cells: int) -> jax.Array:
    """Return the widths of cells that fill a length and grow geometrically, shape ``(cells,)``, m.

    They are first q, first q^2, ... q is the root of a convex function, found by Newton's method and differentiated by
    one step of it at the root. In a gap of few cells' size q returns to 1 smoothly, so that no cell vanishes, which
    rounding would turn into heat; the first cell then differs from ``first`` q. NaN for a length of 0.
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
