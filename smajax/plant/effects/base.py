"""Base classes of the effects: one for each stage of the plant, with the hooks that an effect may override.

An effect is a nested extension of the plant: with strength 0 it is absent. It derives from the base class of its stage
and overrides the hooks that it needs. Hooks are pure functions. The value of a hook is added to that of the stage, so
effects can be combined. An effect may keep a state in the plant's memory (``initial_memory``,
``update_memory``).

The derivative with respect to the strength has to exist at 0, and to be finite and different from 0. A dead zone or a
saturation is therefore written with the sign of the motion, not with a threshold.
"""

from typing import Any, ClassVar, TypeAlias

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Float

from smajax.parameters import CheckedModule, declarations
from smajax.plant.effects.memory import first_order_lag
from smajax.plant.effects.stage_context import StageContext, WireState, ambient_at
from smajax.plant.materials.base import AbstractMaterial, Fractions

# Names of declared fields, each with the values that a search tries.
Shapes: TypeAlias = tuple[tuple[str, tuple[float, ...]], ...]


class AbstractEffect(CheckedModule):
    """Base class of all effects.

    An effect derives from the base class of its stage: ``DriveEffect``, ``HeatEffect`` (or ``ThermalNode``),
    ``MaterialEffect``, ``MechanismEffect`` or ``SensorEffect``. It must have the declared parameter ``strength``, the
    class attributes ``key`` and ``typical``, and at least one hook of that base class; all other attributes have
    defaults. A complete effect, heat that leaks into a holder::

        class HolderLeak(sma.effects.HeatEffect):
            strength: jax.Array = sma.parameter("W/m^3/K", "heat loss per kelvin", 0.0, 1e6, 0.0)
            key = "holder-leak"
            typical = 1e5  # a usual strength, in the unit of strength
            source = "estimate"
            confused_with = ("end-conduction",)
            needs = ("one wire",)

            def power(self, state, memory, context):
                return -self.strength * (state.temperature - context.environment.ambient)

    Attributes:
        strength: Strength, declared by the effect with ``smajax.parameter``; its bounds are the plausible range, and
            its default is 0. Obligatory.
        key: Name in rig files (``[effects.KEY]``) and in reports. Obligatory.
        stage: Stage of the plant on which it acts; the base class has it.
        typical: A usual strength, not 0. Obligatory.
        source: Origin of the usual strength; for readers only.
        remedy: What to do about the effect on the bench, or how to determine it; for readers only.
        confused_with: Keys of known effects that explain similar residuals; that one of two effects names the other is
            enough.
        needs: Capabilities without which a rig cannot have or show the effect, such as ``("two wires",)``: words of
            ``smajax.effects.CAPABILITIES``, which ``Plant.capabilities`` explains.
        excluded_by: Capabilities with which a rig cannot have the effect, such as ``("prescribed strain or stress",)``
            for a play of the transmission, which a test frame has not.
        other_channels: Channels that ``displacement`` or ``reading`` uses in addition to the one that it changes.
        shapes: Further declared fields, such as a time constant, with the values that a search tries (an ``instant`` as
            a share of the recording's length, a ``place`` as a share of the largest recorded motion):
            ``(("onset", (0.01, 0.02)),)`` for a field ``onset``.
        all_or_nothing: Whether it is there completely or not at all, as a rigid stop is: a search then starts at its
            typical strength, because a small share of it is of another form.
        no_mean_effect: For an effect that only adds scatter, the reason why it cannot be detected in the mean of a
            residual.
        absorbed_from: Share of its influence that free parameters have to compensate for it to count as absorbed. It is
            lower if the remaining share depends on nominal values that are not measured.
        obstacle_to_rates: What prevents a vector field (``smajax.simulation.vector_field``), in words that follow
            "has"; empty if there are rates.
    """

    key: ClassVar[str]
    stage: ClassVar[str]
    typical: ClassVar[float]
    source: ClassVar[str] = ""
    remedy: ClassVar[str] = ""
    confused_with: ClassVar[tuple[str, ...]] = ()
    needs: ClassVar[tuple[str, ...]] = ()
    excluded_by: ClassVar[tuple[str, ...]] = ()
    other_channels: ClassVar[tuple[str, ...]] = ()
    shapes: ClassVar[Shapes] = ()
    all_or_nothing: ClassVar[bool] = False
    no_mean_effect: ClassVar[str] = ""
    # Everything but rounding and the linearisation's own error; chosen by trial, tests/unit/diagnosis holds it.
    absorbed_from: ClassVar[float] = 1.0 - 1e-7
    obstacle_to_rates: ClassVar[str] = ""
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
        """Return the reason why a rig cannot have or show the effect.

        Args:
            capabilities: Capabilities of the rig (``Plant.capabilities``).

        Returns:
            The reason; empty if there is none.
        """
        missing, excluding = sorted(set(cls.needs) - capabilities), sorted(set(cls.excluded_by) & capabilities)
        reasons = [f"it needs {', '.join(missing)}"] * bool(missing)
        reasons += [f"it cannot be where a rig has {', '.join(excluding)}"] * bool(excluding)
        return cls.no_mean_effect or "; ".join(reasons)

    def initial_memory(self, state: WireState, context: StageContext) -> Any:
        """Return the effect's memory at the first row; by default none.

        Args:
            state: The wires at the first row.
            context: Other parts of the plant.

        Returns:
            The memory, a pytree.
        """
        return ()

    def update_memory(
        self, memory: Any, before: WireState, after: WireState, step: Float[Array, ""], context: StageContext
    ) -> Any:
        """Return the memory at the end of a step; by default that at the start.

        Args:
            memory: The memory at the start; what is returned has its structure and shapes.
            before: The wires at the start.
            after: The wires at the end.
            step: Duration, s.
            context: Other parts of the plant.
        """
        return memory


class DriveEffect(AbstractEffect):
    """Effect between the recorded input and the current in the wire."""

    stage = "drive"

    def signal(self, signal: Float[Array, " wires"], resistance: Float[Array, " wires"]) -> Float[Array, " wires"]:
        """Compute the addition to the recorded inputs.

        Args:
            signal: The recorded inputs, in the unit of the drive.
            resistance: Resistance of the wires over that of austenite.
        """
        return jnp.zeros_like(signal)

    def voltage(self, current: Float[Array, "..."]) -> Float[Array, "..."]:
        """Compute the addition to the measured voltages in V.

        Args:
            current: Currents in the wires, A.
        """
        return jnp.zeros_like(current)


class HeatEffect(AbstractEffect):
    """Effect on the heat balance of a wire.

    Attributes:
        surroundings: Recorded channels that it reads from the state, in addition to the ambient temperature:
            ``("fan",)``. A recording without them has no such effect.
    """

    stage = "heat"
    surroundings: ClassVar[tuple[str, ...]] = ()

    def begin_step(self, memory: Any, time: Float[Array, ""], step: Float[Array, ""]) -> Any:
        """Return the memory that is constant during a step.

        Args:
            memory: The memory at the start of the step.
            time: Time at the start, s.
            step: Duration, s.
        """
        return memory

    def power(self, state: WireState, memory: Any, context: StageContext) -> Float[Array, " wires"]:
        """Compute the heat added to the wires in W/m^3.

        Args:
            state: The wires.
            memory: The effect's memory.
            context: Other parts of the plant.
        """
        return jnp.zeros_like(state.temperature)

    def capacity(self, martensite: Float[Array, " wires"]) -> Float[Array, " wires"]:
        """Compute the added heat capacity, as a share of the capacity.

        Args:
            martensite: Martensite fractions.
        """
        return jnp.zeros_like(martensite)

    def specimen_offset(self, memory: Any) -> Float[Array, "..."]:
        """Compute how far the wires are above a prescribed temperature, in K; called only where it is prescribed.

        Args:
            memory: The effect's memory at the start of a step; the offset is that at its end.

        Returns:
            The offset, shape ``(wires,)`` or a scalar.
        """
        return jnp.zeros(())

    def enthalpy(self, state: WireState, context: StageContext) -> Float[Array, " wires"]:
        """Compute the heat stored in addition to capacity times temperature, in J/m^3: a function of the state only.

        Args:
            state: The wires.
            context: Other parts of the plant.
        """
        return jnp.zeros_like(state.temperature)


class ThermalNode(HeatEffect):
    """Second thermal node that exchanges heat with the wire.

    The heat flow per kelvin between wire and node is the strength s times the wire's conductance G at ambient
    temperature. The node's excess u over ambient follows ``steady_share`` of the wire's excess with ``time_constant``
    tau:

        q = -s G (T - T_ambient - u)        tau du/dt = steady_share (T - T_ambient) - u - tau dT_ambient/dt

    The last term is 0 unless a recorded ambient temperature changes: the temperature of the node is T_ambient + u.
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
        ambient = [ambient_at(state, context) for state in (before, after)]
        first, last = (
            self.steady_share * (state.temperature - at) for state, at in zip((before, after), ambient, strict=True)
        )
        if after.ambient is None:
            return first_order_lag(memory, first, last, step, self.time_constant)
        ends = (memory + ambient[0], first + ambient[0], last + ambient[1])
        return first_order_lag(*ends, step, self.time_constant) - ambient[1]

    def power(self, state: WireState, memory: Float[Array, " wires"], context: StageContext) -> Float[Array, " wires"]:
        """Compute the heat flow from the node into the wires, W/m^3."""
        per_kelvin = context.heat.conductance(context.environment.ambient, context.wire)
        return -self.strength * per_kelvin * (state.temperature - context.environment.ambient - memory)


class MaterialEffect(AbstractEffect):
    """Effect on the material law."""

    stage = "material"

    def shift(self, state: WireState, context: StageContext) -> Float[Array, " wires"]:
        """Compute the shift of all four transformation temperatures in K.

        Args:
            state: The wires at the start of a step.
            context: Other parts of the plant.
        """
        return jnp.zeros_like(state.temperature)

    def reverse_shift(self, state: WireState, context: StageContext) -> Float[Array, " wires"]:
        """Compute the shift of austenite start and finish alone, in K, in addition to that of ``shift``.

        Args:
            state: The wires at the start of a step.
            context: Other parts of the plant.
        """
        return jnp.zeros_like(state.temperature)

    def modify_material(self, material: AbstractMaterial) -> AbstractMaterial:
        """Return the material law with changed parameters.

        Args:
            material: The material law.
        """
        return material

    def modify_fractions(self, before: Fractions, after: Fractions) -> Fractions:
        """Return the fractions at the end of a step, in place of those of the material law.

        Args:
            before: Fractions at the start.
            after: Fractions at the end by the material law.
        """
        return after

    def strain(self, state: WireState, memory: Any, context: StageContext) -> Float[Array, " wires"]:
        """Compute the added strain.

        Args:
            state: The wires.
            memory: The effect's memory.
            context: Other parts of the plant.
        """
        return jnp.zeros_like(state.temperature)

    def resistivity(self, state: WireState, context: StageContext) -> Float[Array, " wires"]:
        """Compute the added resistivity, as a share of the resistivity.

        Args:
            state: The wires.
            context: Other parts of the plant.
        """
        return jnp.zeros_like(state.temperature)


class MechanismEffect(AbstractEffect):
    """Effect on the forces, or on the transmission of the motion to its sensor.

    Attributes:
        has_drag: Whether it has a stress that opposes the contraction (``drag``). An effect with a drag also has
            ``needs = ("drag",)``.
    """

    stage = "mechanism"
    has_drag: ClassVar[bool] = False

    def drag(
        self, before: WireState, after: WireState, memory: Any, step: Float[Array, ""], context: StageContext
    ) -> Float[Array, ""]:
        """Compute the stress in Pa that opposes the contraction; called only if ``has_drag`` is set.

        It is added to the stress of the wire, so a positive drag hinders the contraction, like a larger load, and
        friction changes its sign with the direction of the motion. A force F in N along the wire, positive against the
        contraction, is the drag F / ``context.wire.force_per_stress``: F over the cross-section of a straight wire.
        With two wires half of it is added to the stress of wire 1, and half is subtracted from that of wire 2. No
        stress falls below 0.

        Args:
            before: The wires at the start of a step.
            after: The wires at the end.
            memory: The effect's memory at the end.
            step: Duration, s.
            context: Other parts of the plant.
        """
        return jnp.zeros(())

    def displacement(
        self, motion: Float[Array, " rows"], channels: dict[str, jax.Array], time: Float[Array, " rows"]
    ) -> Float[Array, " rows"]:
        """Compute the addition to the series of the mechanism's coordinate, in m at the wire.

        Args:
            motion: The coordinate at the recorded rows, in m at the wire.
            channels: Series by channel, with those of ``other_channels`` among them.
            time: Times of the rows, s.
        """
        return jnp.zeros_like(motion)


class SensorEffect(AbstractEffect):
    """Effect on the recorded series of one channel.

    Attributes:
        channel: Name of the channel; empty for the mechanism's coordinate.
    """

    stage = "sensor"
    channel: ClassVar[str] = ""

    def reading(
        self, series: Float[Array, " rows"], channels: dict[str, jax.Array], time: Float[Array, " rows"]
    ) -> Float[Array, " rows"]:
        """Compute the addition to the series of the channel; that of the coordinate is in m at the wire.

        Args:
            series: The channel at the recorded rows.
            channels: Series by channel, with those of ``other_channels`` among them.
            time: Times of the rows, s.
        """
        return jnp.zeros_like(series)
