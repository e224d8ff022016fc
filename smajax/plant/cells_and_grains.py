"""A plant's wires as cells and grains: means over them, and hooks of effects for each of them.

Temperatures have the shape ``(cells, wires)`` and fractions ``(grains, cells, wires)``, without the axes that there are
not. For an effect on heat or material each cell is a wire; all other effects get means over the lengths of the wires.
"""

import functools
import math
from collections.abc import Callable
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Float

from smajax.plant.cells import CellGeometry, Cells
from smajax.plant.effects.base import AbstractEffect, HeatEffect, MaterialEffect, StageContext, WireState
from smajax.plant.grains import Grains
from smajax.plant.heat import AbstractHeat
from smajax.plant.materials.base import AbstractMaterial, Fractions
from smajax.plant.mechanisms.base import AbstractMechanism
from smajax.plant.wire import AbstractWire, Environment

# Key of the temperature of the clamps in a state's memory.
CLAMP = "clamp"
# Axis of the cells in the entries of a ``WireState``.
_CELL_AXES = WireState(None, 0, 0, None, None, 0, None, None)  # pyright: ignore[reportArgumentType]


class PreparedParts(eqx.Module):
    """What the equations need of cells and grains that does not change over a simulation.

    Attributes:
        cell_geometry: What follows from the cells and the other parts; ``None`` without cells.
        grain_law: The law of all grains of all cells, with one entry in each array for each of them
            (``CellsAndGrains._flat_over_grains``); ``None`` without grains, or where it changes from step to step.
    """

    cell_geometry: CellGeometry | None
    grain_law: AbstractMaterial | None


class CellsAndGrains(eqx.Module):
    """Cells and grains of the wires of a plant.

    Attributes:
        cells: Cells along each wire; by default none, so that a wire has one temperature.
        grains: Grains in each cell; by default none, so that all of it follows the law at the same temperatures.
        prepared_parts: What follows from the parameters, if it was computed before (``prepared``).
    """

    cells: Cells | None = eqx.field(default=None, kw_only=True)
    grains: Grains | None = eqx.field(default=None, kw_only=True)
    prepared_parts: PreparedParts | None = eqx.field(default=None, kw_only=True)
    wire: eqx.AbstractVar[AbstractWire]
    environment: eqx.AbstractVar[Environment]
    heat: eqx.AbstractVar[AbstractHeat]
    mechanism: eqx.AbstractVar[AbstractMechanism]

    @property
    def temperature_shape(self) -> tuple[int, ...]:
        """Shape of the temperatures of a state: ``(wires,)``, with cells ``(cells, wires)``."""
        cells = () if self.cells is None else (self.cells.simulated,)
        return (*cells, self.mechanism.wires)

    @property
    def temperatures(self) -> int:
        """Number of temperatures of a state."""
        return math.prod(self.temperature_shape)

    @property
    def fractions_shape(self) -> tuple[int, ...]:
        """Shape of the fractions of a state: ``(wires,)``, with an axis for the cells and one for the grains before."""
        grains = () if self.grains is None else (self.grains.count,)
        return (*grains, *self.temperature_shape)

    @property
    def _geometry(self) -> CellGeometry:
        """What the equations need of the cells; only with cells."""
        assert self.cells is not None
        if self.prepared_parts is not None and self.prepared_parts.cell_geometry is not None:
            return self.prepared_parts.cell_geometry
        grains = None if self.grains is None else self.grains.count
        return self.cells.geometry(self.wire, self.heat, self.environment, grains)

    def _along_wire(self, values: Float[Array, "*cells wires"]) -> Float[Array, " wires"]:
        """The mean of a quantity of the cells over the length of each wire."""
        if self.cells is None:
            return values
        return self._geometry.shares @ values

    def _per_cell(self, values: Float[Array, " wires"]) -> Float[Array, "*cells wires"]:
        """A quantity that is equal along each wire, for all its cells."""
        return values if self.cells is None else jnp.broadcast_to(values, self.temperature_shape)

    def _mean_over_grains(self, fractions: Fractions) -> Fractions:
        """The fractions of the cells: the mean of those of their grains."""
        if self.grains is None:
            return fractions
        return Fractions(*(jnp.mean(fraction, axis=0) for fraction in fractions))

    def _whole_wires(self, wire_state: WireState) -> WireState:
        """The wires with the means over their lengths, for effects on the mechanism and the sensors."""
        if self.cells is None:
            return wire_state
        return wire_state._replace(
            temperature=self._along_wire(wire_state.temperature),
            fractions=Fractions(*map(self._along_wire, wire_state.fractions)),
            accumulated_transformation=self._along_wire(wire_state.accumulated_transformation),
        )

    def _flat_over_grains(self, values: Float[Array, "..."]) -> Float[Array, "*all_grains"]:
        """A quantity of the grains, of the cells or of the wires for all grains, with cells along one axis.

        A compiled loop over one axis is faster than nested ones over a few grains, cells and wires: with nine cells of
        six grains a simulation takes 0.63 times the time (experiments/speed/compiled_loops.py).
        """
        each = jnp.broadcast_to(values, self.fractions_shape)
        return each if self.cells is None else each.ravel()

    def _law_of_grains(self, material: AbstractMaterial) -> AbstractMaterial:
        """The law of all grains from that of the wire, with arrays like those of ``_flat_over_grains``."""
        assert self.grains is not None
        if jnp.ndim(material.austenite_shift):  # of each cell, by an effect
            flat = self._flat_over_grains(material.austenite_shift)
            material = eqx.tree_at(lambda law: law.austenite_shift, material, flat)
        per_grain = self.grains.shifts.T.reshape(2, -1, *(1,) * len(self.temperature_shape))
        first, other = map(self._flat_over_grains, per_grain)
        return self.grains.material_of(material, (first, other))

    def _grain_temperatures(self, temperature: Float[Array, "*cells wires"]) -> Float[Array, "*grains wires"]:
        """The temperatures of all grains, which are spread over the lengths of the cells."""
        if self.grains is None:
            return temperature
        if self.cells is None:
            return jnp.broadcast_to(temperature, (self.grains.count, *temperature.shape))
        weights = self._geometry.grain_weights
        assert weights is not None
        return jnp.sum(weights[..., None] * temperature[None, None], axis=2)

    def _mean_slope(self, slope: Float[Array, "*grains wires"]) -> Float[Array, "*slopes wires"]:
        """The derivatives of a mean over the grains of each cell by the temperatures of all cells (second axis).

        Without grains, or where all grains have the temperature of their cell, those by the temperature of the cell.
        """
        if self.grains is None or self.cells is None:
            return slope
        weights = self._geometry.grain_weights
        assert weights is not None
        return jnp.einsum("giw,gij->ijw", slope, weights) / self.grains.count

    def _change_in_cells(
        self, slope: Float[Array, "*slopes wires"], temperature: Float[Array, "*cells wires"]
    ) -> Float[Array, "*cells wires"]:
        """The change of a mean over grains with the temperatures of the cells, from its ``_mean_slope``."""
        return slope * temperature if slope.ndim == temperature.ndim else jnp.sum(slope * temperature[None], axis=1)

    def _for_grains(self, values: Float[Array, "*cells wires"]) -> Float[Array, "*grains wires"]:
        """A quantity of the cells with an axis for the grains, if there are any."""
        return values if self.grains is None else values[None]

    def _each_cell(self, hook: Callable[..., Any], *arguments: Any) -> Any:
        """Call a hook of an effect on heat or material, for which each cell is a wire."""
        if self.cells is None:
            return hook(*arguments)
        axes = tuple(map(_cell_axes, arguments))
        return jax.vmap(hook, in_axes=axes, axis_size=self.cells.simulated)(*arguments)

    def _hook(self, effect: AbstractEffect, name: str) -> Callable[..., Any]:
        """A hook of an effect: of one on heat or material for each cell, of all others for the whole wires."""
        method = getattr(effect, name)
        if self.cells is None or isinstance(effect, HeatEffect | MaterialEffect):
            return functools.partial(self._each_cell, method)

        def on_whole_wires(*arguments: Any) -> Any:
            return method(*(self._whole_wires(a) if isinstance(a, WireState) else a for a in arguments))

        return on_whole_wires

    def _clamp_temperature(
        self, memory: dict[str, Any], first: WireState, last: WireState, step: Float[Array, ""]
    ) -> dict[str, Any]:
        """The entry of the clamps in a state's memory after a step; none without cells."""
        if self.cells is None:
            return {}
        ends = first.temperature[0], last.temperature[0]
        ambient: Any = tuple(self.environment.ambient if at.ambient is None else at.ambient for at in (first, last))
        parts = self._geometry, self.wire
        return {CLAMP: self.cells.clamp_temperature(memory[CLAMP], ends, ambient, step, *parts)}


def _cell_axes(argument: Any) -> Any:
    """Axis of the cells in the leaves of an argument of a hook; ``None`` where there is none."""
    if isinstance(argument, WireState):
        return _CELL_AXES
    if isinstance(argument, StageContext):
        return None
    return jax.tree.map(lambda leaf: 0 if jnp.ndim(leaf) else None, argument)


def shifts_reverse(effect: MaterialEffect) -> bool:
    """Return whether an effect shifts the reverse transformation, by the state at the start of a step.

    Args:
        effect: The effect.
    """
    return type(effect).reverse_shift is not MaterialEffect.reverse_shift
