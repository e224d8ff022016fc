"""Base classes of the effects: one for each stage of the plant, with the hooks that an effect may override.

An effect is a nested extension of the plant: with strength 0 it is absent. It derives from the base class of its stage
and overrides the hooks that it needs. Hooks are pure functions; what a hook returns is added to what the stage does
without it, so effects can be combined. State of its own is an array in the plant's memory (``initial_memory``,
``update_memory``).

The derivative with respect to the strength has to exist at 0, to be finite, and not to be 0. A dead zone or a
saturation is therefore written with the sign of the motion, not with a threshold.
"""

from typing import Any, ClassVar, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Float

from smajax.parameters import declarations
from smajax.plant.effects.memory import first_order_lag
from smajax.plant.heat import AbstractHeat
from smajax.plant.materials.base import AbstractMaterial, Fractions
from smajax.plant.wire import AbstractWire, Environment


class WireState(NamedTuple):
    """State of the wires that effects see at one instant: arrays of shape ``(wires,)`` except for two scalars.

    ``time`` (s) and ``contraction`` (a strain, positive as the wire shortens) are scalars. Temperatures are in degC,
    stresses in Pa. ``accumulated_transformation`` sums the changes of the martensite fraction in either direction: a
    full cycle counts 2.
    """

    time: jax.Array
    temperature: jax.Array
    fractions: Fractions
    stress: jax.Array
    contraction: jax.Array
    accumulated_transformation: jax.Array


class StageContext(NamedTuple):
    """Parts of the plant that an effect may read."""

    wire: AbstractWire
    environment: Environment
    material: AbstractMaterial
    heat: AbstractHeat


class AbstractEffect(eqx.Module):
    """Base class of all effects.

    ``strength`` is declared by the effect with ``parameter``; its bounds are the plausible range. The class attributes
    are

    - ``key``: name in rig files (``[effects.KEY]``) and in reports;
    - ``typical`` and ``source``: a usual strength, and where that size comes from;
    - ``confused_with``: keys of effects that explain similar residuals;
    - ``needs``: capabilities (words of ``Plant.capabilities``) without which a rig cannot have or show the effect;
    - ``other_channels``: channels that ``displacement`` or ``reading`` uses in addition to the one that it changes;
    - ``shapes``: further declared fields, such as a time constant, with the values that a search tries (an ``instant``
      as a share of the recording's length);
    - ``no_mean_effect``: for an effect that only scatters, why it cannot be found in a residual's mean;
    - ``absorbed_from``: the share of its influence that free parameters have to compensate for it to count as absorbed.
      It is lower where the remaining share rests on nominal values that are not measured.
    """

    key: ClassVar[str]
    stage: ClassVar[str]
    typical: ClassVar[float]
    source: ClassVar[str]
    confused_with: ClassVar[tuple[str, ...]] = ()
    needs: ClassVar[tuple[str, ...]] = ()
    other_channels: ClassVar[tuple[str, ...]] = ()
    shapes: ClassVar[tuple[tuple[str, tuple[float, ...]], ...]] = ()
    no_mean_effect: ClassVar[str] = ""
    # Everything but rounding and the linearisation's own error; chosen by trial, tests/unit/diagnosis holds it.
    absorbed_from: ClassVar[float] = 1.0 - 1e-7
    strength: eqx.AbstractVar[jax.Array]

    @classmethod
    def unit(cls) -> str:
        """Return the internal unit of the strength."""
        return declarations(cls)["strength"].unit

    @classmethod
    def plausible_range(cls) -> tuple[float, float]:
        """Return the smallest and the largest plausible strength."""
        strength = declarations(cls)["strength"]
        return strength.lower, strength.upper

    @classmethod
    def unavailable_reason(cls, capabilities: frozenset[str]) -> str:
        """Say why a rig with these capabilities cannot have or show the effect; empty if it can."""
        missing = sorted(set(cls.needs) - capabilities)
        return cls.no_mean_effect or (f"it needs {', '.join(missing)}" if missing else "")

    def initial_memory(self, state: WireState, context: StageContext) -> Any:
        """Return the effect's memory at the first row; by default none."""
        return ()

    def update_memory(
        self, memory: Any, before: WireState, after: WireState, step: Float[Array, ""], context: StageContext
    ) -> Any:
        """Return the memory after a step of ``step`` seconds from the state ``before`` to the state ``after``."""
        return memory


class DriveEffect(AbstractEffect):
    """Effect between the recorded input and the current in the wire."""

    stage = "drive"

    def signal(self, signal: Float[Array, " wires"], resistance: Float[Array, " wires"]) -> Float[Array, " wires"]:
        """Return what is added to the recorded inputs.

        Args:
            signal: The recorded inputs, in the drive's unit.
            resistance: Resistance of the wires over that of austenite.
        """
        return jnp.zeros_like(signal)

    def voltage(self, current: jax.Array) -> jax.Array:
        """Return what is added to the measured voltage, V, for the wires' currents in A."""
        return jnp.zeros_like(current)


class HeatEffect(AbstractEffect):
    """Effect on the heat balance of a wire."""

    stage = "heat"

    def begin_step(self, memory: Any, time: Float[Array, ""], step: Float[Array, ""]) -> Any:
        """Return the memory that holds throughout the step from ``time`` to ``time + step``."""
        return memory

    def power(self, state: WireState, memory: Any, context: StageContext) -> Float[Array, " wires"]:
        """Return the heat added to the wires, W/m^3."""
        return jnp.zeros_like(state.temperature)

    def capacity(self, martensite: Float[Array, " wires"]) -> Float[Array, " wires"]:
        """Return the added heat capacity as a share of the capacity."""
        return jnp.zeros_like(martensite)

    def enthalpy(self, state: WireState, context: StageContext) -> Float[Array, " wires"]:
        """Return the heat stored in addition to capacity times temperature, J/m^3: a function of the state alone."""
        return jnp.zeros_like(state.temperature)


class ThermalNode(HeatEffect):
    """Second thermal node that exchanges heat with the wire.

    The heat flow per kelvin between wire and node is the strength s times the wire's conductance G at ambient
    temperature. The node's excess u over ambient follows ``steady_share`` of the wire's excess with ``time_constant``
    tau:

        q = -s G (T - T_ambient - u)        tau du/dt = steady_share (T - T_ambient) - u
    """

    steady_share: ClassVar[float] = 1.0
    time_constant: eqx.AbstractVar[jax.Array]

    def initial_memory(self, state: WireState, context: StageContext) -> Float[Array, " wires"]:
        """Return the node's excess over ambient: 0 at the first row."""
        return jnp.zeros_like(state.temperature)

    def update_memory(
        self,
        memory: Float[Array, " wires"],
        before: WireState,
        after: WireState,
        step: Float[Array, ""],
        context: StageContext,
    ) -> Float[Array, " wires"]:
        """Return the node's excess over ambient at the end of the step, K."""
        ambient = context.environment.ambient
        first, last = (self.steady_share * (state.temperature - ambient) for state in (before, after))
        return first_order_lag(memory, first, last, step, self.time_constant)

    def power(self, state: WireState, memory: Float[Array, " wires"], context: StageContext) -> Float[Array, " wires"]:
        """Return the heat flow from the node into the wires, W/m^3."""
        per_kelvin = context.heat.conductance(context.environment.ambient, context.wire)
        return -self.strength * per_kelvin * (state.temperature - context.environment.ambient - memory)


class MaterialEffect(AbstractEffect):
    """Effect on the material law."""

    stage = "material"

    def shift(self, state: WireState, context: StageContext) -> Float[Array, " wires"]:
        """Return what is added to all four transformation temperatures, K."""
        return jnp.zeros_like(state.temperature)

    def modify_material(self, material: AbstractMaterial) -> AbstractMaterial:
        """Return the material law with changed parameters."""
        return material

    def modify_fractions(self, before: Fractions, after: Fractions) -> Fractions:
        """Return the fractions after a step, in place of those that the material law gives (``after``)."""
        return after

    def strain(self, state: WireState, memory: Any, context: StageContext) -> Float[Array, " wires"]:
        """Return what is added to the strain."""
        return jnp.zeros_like(state.temperature)

    def resistivity(self, state: WireState, context: StageContext) -> Float[Array, " wires"]:
        """Return the added resistivity as a share of the resistivity."""
        return jnp.zeros_like(state.temperature)


class MechanismEffect(AbstractEffect):
    """Effect on the forces, or on the transmission of the motion to the place where it is measured."""

    stage = "mechanism"
    has_drag: ClassVar[bool] = False

    def drag(
        self, before: WireState, after: WireState, memory: Any, step: Float[Array, ""], context: StageContext
    ) -> Float[Array, ""]:
        """Return the stress that opposes contraction, Pa; called only if ``has_drag`` is set.

        With two wires it acts on wire 1 against wire 2.
        """
        return jnp.zeros(())

    def displacement(
        self, motion: Float[Array, " rows"], channels: dict[str, jax.Array], time: Float[Array, " rows"]
    ) -> Float[Array, " rows"]:
        """Return what is added to the series of the mechanism's coordinate, in m at the wire.

        Args:
            motion: The coordinate at the recorded rows, in m at the wire.
            channels: Series of the channels named in ``other_channels``.
            time: Times of the rows, s.
        """
        return jnp.zeros_like(motion)


class SensorEffect(AbstractEffect):
    """Effect on the recorded series of one channel: ``channel``, or the mechanism's coordinate if that is empty."""

    stage = "sensor"
    channel: ClassVar[str] = ""

    def reading(
        self, series: Float[Array, " rows"], channels: dict[str, jax.Array], time: Float[Array, " rows"]
    ) -> Float[Array, " rows"]:
        """Return what is added to a channel's series; the coordinate's is in m at the wire.

        Args:
            series: The channel at the recorded rows.
            channels: Series of the channels named in ``other_channels``.
            time: Times of the rows, s.
        """
        return jnp.zeros_like(series)
