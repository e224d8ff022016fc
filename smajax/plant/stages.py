"""The equations of the plant's five stages, each with the effects that act on it.

A stage is a part of the plant: drive, heat, material, mechanism, sensor. An effect adds a term to an equation of its
stage (``smajax.plant.effects``). Each equation is written once here, as the value of the stage plus the terms of its
effects.
"""

import functools
from collections.abc import Collection
from typing import Any, TypeVar

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Float

from smajax.arguments import check_interpolation
from smajax.channels import driving_signals
from smajax.errors import InputError
from smajax.plant.cells_and_grains import CLAMP, CellsAndGrains, PreparedParts, shifts_reverse
from smajax.plant.drive import AbstractDrive
from smajax.plant.effects.base import (
    AbstractEffect,
    DriveEffect,
    HeatEffect,
    MaterialEffect,
    MechanismEffect,
    StageContext,
    WireState,
)
from smajax.plant.effects.hook_results import checked_memory, checked_result, checked_type
from smajax.plant.heat import AbstractHeat, PrescribedTemperature
from smajax.plant.materials.base import AbstractMaterial, Fractions
from smajax.plant.mechanisms.base import AbstractMechanism, MechanismContext
from smajax.plant.own_methods import check_material, check_mechanism, is_checked
from smajax.plant.sensor import Sensor
from smajax.plant.state import State
from smajax.plant.wire import AbstractWire, Environment, Initial

Prepared = TypeVar("Prepared", bound="PlantStages")
# Recorded channels of the surroundings. A ``signal`` may have the first or both of them after the channels of
# ``PlantStages.signals``; NaN stands for one that is not recorded.
SURROUNDINGS = ("ambient", "fan")
# Key of the accumulated transformation in a state's memory; its alphabetical position orders the layout of flat states.
_ACCUMULATED = "transformation"

# Base class of each stage, and what to give in words.
_STAGE_CLASSES: dict[str, tuple[type[eqx.Module], str]] = {
    "wire": (AbstractWire, "a Wire or a Coil"),
    "environment": (Environment, "an Environment"),
    "initial": (Initial, "an Initial"),
    "drive": (AbstractDrive, "a CurrentDrive, VoltageDrive, PowerDrive, DutyDrive or NoDrive"),
    "heat": (AbstractHeat, "a PolynomialConvection, PowerLawConvection or PrescribedTemperature"),
    "material": (AbstractMaterial, "a law of smajax.materials, such as that of load_material"),
    "mechanism": (AbstractMechanism, "one of smajax.mechanisms, such as DeadWeight(Load(mass=0.2))"),
    "sensor": (Sensor, "a Sensor"),
    "effects": (AbstractEffect, "instances of classes of smajax.effects, such as (LatentHeat(strength=1e8),)"),
}


class PlantStages(CellsAndGrains):
    """Parts of a plant, and the equations of its stages with their effects.

    Attributes:
        wire: Geometry of the wire.
        environment: Air around the wire, and gravity; by default at 20 degC and 9.81 m/s^2.
        initial: State at the start; by default that as installed, at rest, at ambient temperature.
        drive: From the electrical input to the Joule heat.
        heat: Heat balance of the wire.
        material: Constitutive law.
        mechanism: Load of the wires.
        sensor: Gains and offsets of the sensors; by default every channel is read as it is.
        effects: Effects that are added to the stages.
        interpolation: Electrical inputs between the samples of a recording: ``hold`` or ``linear``.
    """

    wire: AbstractWire
    environment: Environment = eqx.field(default_factory=Environment, kw_only=True)
    initial: Initial = eqx.field(default_factory=Initial, kw_only=True)
    drive: AbstractDrive
    heat: AbstractHeat
    material: AbstractMaterial
    mechanism: AbstractMechanism
    sensor: Sensor = eqx.field(default_factory=lambda: Sensor.identity(()), kw_only=True)
    effects: tuple[AbstractEffect, ...] = ()
    interpolation: str = eqx.field(static=True, default="hold", kw_only=True)

    def __check_init__(self) -> None:
        """Check the types of the stages, and what the methods of an own material or mechanism take and return.

        Raises:
            InputError: If a stage is of another type; the message names classes that it may be of. If a method takes
                other arguments or returns another shape or type; the message names the class and the method. If the
                interpolation is unknown.
        """
        check_interpolation(self.interpolation)
        if not isinstance(self.effects, tuple | list):
            raise InputError(
                f"{type(self).__name__}: effects is of type {type(self.effects).__name__}: give a tuple, such as "
                "(LatentHeat(strength=1e8),) with a comma, or () for none"
            )
        for name, (base, classes) in _STAGE_CLASSES.items():
            for stage in self.effects if name == "effects" else (getattr(self, name),):
                if not isinstance(stage, base):
                    kind = f"the class {stage.__name__}" if isinstance(stage, type) else f"a {type(stage).__name__}"
                    raise InputError(f"{type(self).__name__}: {name} cannot be {kind}: give {classes}")
        keys = [effect.key for effect in self.effects]
        for key in keys:
            if keys.count(key) > 1:
                raise InputError(f"{type(self).__name__}: effects has '{key}' twice: give each effect once")
        check_material(self.material, self.temperature_shape)
        if is_checked(self.mechanism):
            check_mechanism(self.mechanism, self.effective_material, self._mechanism_context())

    @property
    def signals(self) -> tuple[str, ...]:
        """Names of the recorded channels that drive the plant, in the order of the entries of a ``signal``.

        A signal may have more entries, in the order of ``SURROUNDINGS``: a recorded ambient temperature, which replaces
        ``environment.ambient`` in the heat balance, and the duty of a fan. The reference temperature of the thermal
        strain and of a resistivity stays ``environment.ambient``.
        """
        mechanism, is_prescribed = self.mechanism, isinstance(self.heat, PrescribedTemperature)
        return driving_signals(self.drive.control, mechanism.wires, is_prescribed, mechanism.prescribed)

    @property
    def surroundings(self) -> tuple[str, ...]:
        """Names of the recorded channels of the surroundings that the plant follows where a recording has them."""
        if isinstance(self.heat, PrescribedTemperature):
            return ()
        return tuple(name for name in SURROUNDINGS if name == "ambient" or name in self.required_surroundings)

    @property
    def required_surroundings(self) -> tuple[str, ...]:
        """Names of the recorded channels of the surroundings without which one of the effects is absent."""
        return tuple(dict.fromkeys(name for e in self._effects_of(HeatEffect) for name in e.surroundings))

    def driving_channels(self, *recorded: Collection[str]) -> tuple[str, ...]:
        """Return the channels that drive the plant: its signals, and the recorded surroundings that it follows.

        Args:
            *recorded: Names of the channels of each recording.
        """
        followed = (name for name in self.surroundings if any(name in names for names in recorded))
        return (*self.signals, *followed)

    @property
    def all_effects(self) -> tuple[AbstractEffect, ...]:
        """The effects that the mechanism always has, and those that were added to the plant."""
        return (*self.mechanism.effects, *self.effects)

    @property
    def effective_material(self) -> AbstractMaterial:
        """The material law with the elastic moduli of the wire's geometry (``AbstractWire.modulus_factor``)."""
        return self.material.with_scaled_moduli(self.wire.modulus_factor)

    def _effects_of(self, kind: type[Any] | tuple[type[Any], ...]) -> tuple[Any, ...]:
        return tuple(e for e in self.all_effects if isinstance(e, kind))

    @property
    def _has_drag(self) -> bool:
        """Whether an effect opposes the contraction with a drag, which is then an additional unknown."""
        return any(e.has_drag for e in self._effects_of(MechanismEffect))

    # Parts and states of the plant that stages and effects use.

    def _stage_context(self, ambient: Float[Array, ""] | None = None) -> StageContext:
        """The parts of the plant that effects use, with a recorded ambient temperature if there is one."""
        environment = self.environment
        if ambient is not None:
            environment = eqx.tree_at(lambda e: e.ambient, environment, ambient)
        return StageContext(self.wire, environment, self.effective_material, self.heat)

    def _mechanism_context(self) -> MechanismContext:
        austenite = Fractions(jnp.zeros(()), jnp.zeros(()))
        return MechanismContext(self.wire, self.environment, self.effective_material.modulus(austenite))

    def _wire_state(self, state: State) -> WireState:
        zero = jnp.zeros(())
        memory = {"time": zero, "contraction": zero, _ACCUMULATED: jnp.zeros_like(state.temperature)} | state.memory
        return WireState(
            memory["time"],
            state.temperature,
            self._mean_over_grains(state.fractions),
            state.stress,
            memory["contraction"],
            memory[_ACCUMULATED],
        )

    def _in_surroundings(self, wire_state: WireState, channels: dict[str, Any]) -> WireState:
        """The wires with the recorded surroundings among the channels of ``_prescribed_channels``."""
        return wire_state._replace(**{name: channels[name] for name in SURROUNDINGS if name in channels})

    def _shared_memory(self, wire_state: WireState) -> dict[str, Array]:
        """The entries of a state's memory that all effects share."""
        return {
            "time": wire_state.time,
            "contraction": wire_state.contraction,
            _ACCUMULATED: wire_state.accumulated_transformation,
        }

    def _begin_step(self, state: State, step: Float[Array, ""]) -> State:
        """The state with the memory that heat effects hold constant during a step of ``step`` seconds."""
        memory = state.memory
        begun = {}
        for e in self._effects_of(HeatEffect):
            constant = self._each_cell(e.begin_step, memory[e.key], memory["time"], step)
            begun[e.key] = checked_memory(e, "begin_step", constant, memory[e.key])
        return state._replace(memory=memory | begun)

    def _updated_memory(
        self,
        kinds: type[Any] | tuple[Any, ...],
        memory: dict[str, Any],
        first: WireState,
        last: WireState,
        step: Float[Array, ""],
    ) -> dict[str, Any]:
        """Memory of the effects of some kinds after a step from ``first`` to ``last``, by their keys."""
        context, updated = self._stage_context(last.ambient), {}
        for e in self._effects_of(kinds):
            at_end = self._hook(e, "update_memory")(memory[e.key], first, last, step, context)
            updated[e.key] = checked_memory(e, "update_memory", at_end, memory[e.key])
        return updated

    # Drive.

    def _prescribed_channels(self, signal: Float[Array, " signals"]) -> dict[str, Float[Array, ""]]:
        """The entries of a signal without the electrical input: temperature, strain or stress, and the surroundings."""
        names = self.signals
        skip = self.mechanism.wires if self.drive.control else 0
        channels = {name: signal[skip + i] for i, name in enumerate(names[skip:])}
        recorded = dict(zip(SURROUNDINGS, signal[len(names) :], strict=False)) if signal.shape[0] > len(names) else {}
        constants = {"ambient": self.environment.ambient, "fan": 0.0}
        return channels | {
            name: jnp.where(jnp.isnan(value), constants[name], value) for name, value in recorded.items()
        }

    def _electrical_input(
        self, signal: Float[Array, " signals"], resistivity: Float[Array, " wires"]
    ) -> Float[Array, " wires"]:
        """The electrical input as it reaches the wires."""
        wires, zero = self.mechanism.wires, jnp.zeros(())
        control = signal[:wires] if self.drive.control else jnp.zeros((wires,))
        ratio = resistivity / self.material.resistivity(Fractions(zero, zero))
        return control + sum(
            checked_result(e, "signal", e.signal(control, ratio), control.shape, "wires")
            for e in self._effects_of(DriveEffect)
        )

    # Material.

    def _resistivity(self, wire_state: WireState) -> Float[Array, "*cells wires"]:
        base, context = self.material.resistivity(wire_state.fractions), self._stage_context()
        base = jnp.broadcast_to(base, wire_state.temperature.shape)  # an own law may give one number
        return base + sum(
            base
            * checked_result(e, "resistivity", self._each_cell(e.resistivity, wire_state, context), base.shape, "wires")
            for e in self._effects_of(MaterialEffect)
        )

    def _strain(self, wire_state: WireState, memory: dict[str, Any]) -> Float[Array, " wires"]:
        """The strains of the wires, means over their lengths."""
        context = self._stage_context()
        temperature = wire_state.temperature
        stress = self._per_cell(wire_state.stress)
        base = context.material.strain(wire_state.fractions, temperature, stress, self.environment.ambient)
        strain = base + sum(
            checked_result(
                e, "strain", self._each_cell(e.strain, wire_state, memory[e.key], context), base.shape, "wires"
            )
            for e in self._effects_of(MaterialEffect)
        )
        return self._along_wire(strain)

    def _evolve_fractions(
        self,
        first: WireState,
        fractions: Fractions,
        temperature: Float[Array, "*cells wires"],
        stress: Float[Array, " wires"],
    ) -> Fractions:
        """The fractions of all grains after a step from ``first`` to a temperature and a stress."""
        return self._evolve_grains(first, fractions, self._grain_temperatures(temperature), stress)

    def _evolve_grains(
        self,
        first: WireState,
        fractions: Fractions,
        temperature: Float[Array, "*grains wires"],
        stress: Float[Array, " wires"],
    ) -> Fractions:
        """``_evolve_fractions`` with the temperature of each grain at the end."""
        context, shift = self._stage_context(), None
        for e in self._effects_of(MaterialEffect):
            own = checked_result(e, "shift", self._each_cell(e.shift, first, context), first.temperature.shape, "wires")
            shift = own if shift is None else shift + own
        temperatures = self._grain_temperatures(first.temperature), temperature
        if shift is not None:
            shift = self._for_grains(shift)
            temperatures = temperatures[0] - shift, temperatures[1] - shift
        values = fractions, temperatures, (self._per_cell(first.stress), self._per_cell(stress))
        law = self._law_in_step(first)
        if self.grains is None:
            evolved = law.evolve(*values)
        else:
            evolved = law.evolve(*jax.tree.map(self._flat_over_grains, values))
            evolved = Fractions(*(f.reshape(self.fractions_shape) for f in evolved))
        for e in self._effects_of(MaterialEffect):
            modify = functools.partial(self._each_cell, e.modify_fractions)
            changed = (modify if self.grains is None else jax.vmap(modify))(fractions, evolved)
            checked_type(e, "modify_fractions", changed, Fractions)
            for part, before in zip(changed, evolved, strict=True):
                checked_result(e, "modify_fractions", part, before.shape, "wires")
            evolved = changed
        return evolved

    def _law_in_step(self, first: WireState | None) -> AbstractMaterial:
        """The law of a step that begins at ``first``, with what the effects change; of all grains, if there are any.

        Without an effect that shifts the reverse transformation it is the same in every step, and needs no ``first``.
        """
        if self.prepared_parts is not None and self.prepared_parts.grain_law is not None:
            return self.prepared_parts.grain_law
        context, material = self._stage_context(), self.effective_material
        for e in self._effects_of(MaterialEffect):
            material = checked_type(e, "modify_material", e.modify_material(material), AbstractMaterial)
            if first is not None and shifts_reverse(e):
                own = self._each_cell(e.reverse_shift, first, context)
                own = checked_result(e, "reverse_shift", own, first.temperature.shape, "wires")
                material = eqx.tree_at(lambda law: law.austenite_shift, material, material.austenite_shift + own)
        return material if self.grains is None else self._law_of_grains(material)

    def prepared(self: Prepared) -> Prepared:
        """Return the plant with what does not change over a simulation, so that all of its steps share that.

        A prepared plant is for one simulation: its parameters may not be replaced.
        """
        if self.prepared_parts is not None or (self.cells is None and self.grains is None):
            return self
        is_constant = not any(map(shifts_reverse, self._effects_of(MaterialEffect)))
        law = self._law_in_step(None) if self.grains is not None and is_constant else None
        parts = PreparedParts(None if self.cells is None else self._geometry, law)
        return eqx.tree_at(lambda p: p.prepared_parts, self, parts, is_leaf=lambda leaf: leaf is None)

    # Heat.

    def _specimen_temperature(self, prescribed: dict[str, Any], memory: dict[str, Any]) -> Float[Array, "*cells wires"]:
        """The prescribed temperature of the wires at the end of a step, with the effects' memory at its start."""
        temperature = jnp.broadcast_to(prescribed["temperature"], self.temperature_shape)
        for e in self._effects_of(HeatEffect):
            if type(e).specimen_offset is not HeatEffect.specimen_offset:
                offset = self._each_cell(e.specimen_offset, memory[e.key])
                temperature = temperature + jnp.broadcast_to(offset, temperature.shape)
        return temperature

    def _heat_capacity(self, martensite: Float[Array, "*cells wires"]) -> Float[Array, "*cells wires"]:
        base = self.heat.capacity(martensite)
        return base + sum(
            base * checked_result(e, "capacity", self._each_cell(e.capacity, martensite), martensite.shape, "wires")
            for e in self._effects_of(HeatEffect)
        )

    def _net_heat(
        self, wire_state: WireState, memory: dict[str, Any], signal: Float[Array, " signals"]
    ) -> Float[Array, "*cells wires"]:
        """Net heat into each wire per volume in W/m^3: Joule heat less convection, plus the heat of the effects."""
        resistivity = self._resistivity(wire_state)
        wire_state = self._in_surroundings(wire_state, self._prescribed_channels(signal))
        context = self._stage_context(wire_state.ambient)
        mean = self._along_wire(resistivity)
        joule = self.drive.joule(self._electrical_input(signal, mean), mean, self.wire)
        if self.cells is not None:
            joule = self._per_cell(joule / mean) * resistivity  # one current through cells of different resistivity
        rate = self.heat.net_heat(joule, wire_state.temperature, self.wire, context.environment)
        if self.cells is not None:
            parts = self._geometry, self.wire, self.heat, context.environment.ambient
            rate = rate + self.cells.net_heat(wire_state.temperature, memory[CLAMP], *parts)
        return rate + sum(
            checked_result(
                e, "power", self._each_cell(e.power, wire_state, memory[e.key], context), rate.shape, "wires"
            )
            for e in self._effects_of(HeatEffect)
        )

    def _stored_heat(self, first: WireState, last: WireState) -> Float[Array, "*cells wires"] | float:
        """Heat per volume in J/m^3 stored between two instants in addition to warming, such as latent heat."""
        context, stored = self._stage_context(), 0.0
        for e in self._effects_of(HeatEffect):
            heats = [
                checked_result(e, "enthalpy", self._each_cell(e.enthalpy, w, context), w.temperature.shape, "wires")
                for w in (last, first)
            ]
            stored = stored + (heats[0] - heats[1])
        return stored
