"""The plant: its initial state, its time step, and the readings of its sensors.

A step is implicit. ``smajax.plant.step_equations`` has its unknowns and equations, ``smajax.plant.step_solver`` the
search for their solution, and ``smajax.plant.implicit_step`` the derivatives of the solution.
"""

from typing import Any

import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float

from smajax.channels import numbered, observable_channels
from smajax.numerics.derivative_order import once_differentiable
from smajax.numerics.nonsmooth import minimum
from smajax.plant.cells_and_grains import CLAMP
from smajax.plant.drive import resistance
from smajax.plant.effects.base import DriveEffect, MechanismEffect, SensorEffect, WireState
from smajax.plant.effects.hook_results import checked_result
from smajax.plant.heat import PrescribedTemperature
from smajax.plant.implicit_step import implicit_step
from smajax.plant.materials.base import AbstractMaterial, Fractions
from smajax.plant.state import State
from smajax.plant.step_solver import StepSolver, newton_corrected


class Plant(StepSolver):
    """Differentiable model of a rig: drive, heat, material, mechanism and sensors, and the effects that act on them.

    The parameters are the float leaves; ``smajax.parameters`` reads and sets them by name. A ``signal`` is the vector
    of the recorded channels that drive the plant at one instant, in the order of ``signals``. A plant without a file,
    in SI units and degC::

        plant = sma.Plant(
            wire=sma.Wire(diameter=0.15e-3, length=0.23),
            material=sma.load_material("rotary-table1"),
            mechanism=sma.mechanisms.DeadWeight(sma.mechanisms.Load(mass=0.2)),
            drive=sma.CurrentDrive(),
            heat=sma.PolynomialConvection(h0=100.0),
            effects=(sma.effects.LatentHeat(strength=1e8),),
        )

    Attributes:
        wire: Geometry of the wires: ``Wire`` or ``Coil``.
        drive: Recorded input: ``CurrentDrive``, ``VoltageDrive``, ``PowerDrive``, ``DutyDrive``, ``NoDrive``.
        heat: Heat balance: ``PolynomialConvection``, ``PowerLawConvection``, or a ``PrescribedTemperature``.
        material: Constitutive law, one of ``smajax.materials``; ``load_material`` makes one with shipped values.
        mechanism: Load of the wires, one of ``smajax.mechanisms``.
        effects: Effects that are added to the stages, of the classes in ``smajax.effects``; by default none.
        cells: Cells along each wire (``smajax.plant.cells``); by default none, so that a wire has one temperature.
        grains: Grains in each cell (``smajax.plant.grains``); by default none.
        environment: ``Environment``: ambient temperature and gravity.
        initial: ``Initial``: temperature and fractions at the first row; by default as installed, at rest.
        sensor: ``Sensor``: gains and offsets of channels; by default each is read as it is.
        interpolation: Electrical inputs between the samples of a recording: ``"hold"`` (the default) or ``"linear"``; a
            plant of a rig file has that of the file.
    """

    @property
    def longest_step(self) -> jax.Array | float:
        """The longest step in s that resolves the mechanism's own motion."""
        return self.mechanism.longest_step(self._mechanism_context())

    @property
    def observable(self) -> tuple[str, ...]:
        """Names of the channels that ``observe`` computes."""
        mechanism = self.mechanism
        return observable_channels(mechanism.wires, mechanism.coordinate, mechanism.extra_channels)

    def init(self, signal: Float[Array, " signals"]) -> State:
        """Compute the state at the first sample: as installed, at rest, in equilibrium.

        Args:
            signal: Signals at the first sample.

        Returns:
            The state; differentiable in the plant and in the signals.
        """
        context, prescribed = self._mechanism_context(), self._prescribed_channels(signal)
        ambient = prescribed.get("ambient", self.environment.ambient)
        resting = ambient if self.initial.temperature is None else self.initial.temperature
        temperature = jnp.broadcast_to(prescribed.get("temperature", resting), self.temperature_shape)
        fractions = self._initial_fractions(temperature, prescribed)
        unknown = self.mechanism.initial_unknowns(prescribed, context)
        stress = self.mechanism.stress(unknown, prescribed, context)
        mean = self._mean_over_grains(fractions)
        strain = self._along_wire(
            self.effective_material.strain(mean, temperature, self._per_cell(stress), self.environment.ambient)
        )
        if self._has_drag:
            unknown = jnp.append(unknown, 0.0)
        memory: dict[str, Any] = {}
        if self.all_effects:
            wire_state = WireState(
                jnp.zeros(()),
                temperature,
                mean,
                stress,
                self.mechanism.contraction(strain),
                jnp.zeros_like(temperature),
            )
            strain, memory = self._initial_memory(self._in_surroundings(wire_state, prescribed))
        if self.cells is not None:
            memory[CLAMP] = jnp.broadcast_to(ambient, (self.mechanism.wires,))
        state = State(temperature, fractions, stress, unknown, self.mechanism.initial_motion(strain), memory)
        # Under a known load the state is in equilibrium already; a prescribed strain takes a step of zero duration.
        return _equilibrium(self, state, signal) if "strain" in prescribed else state

    def _initial_fractions(self, temperature: Float[Array, "*cells wires"], prescribed: dict[str, Any]) -> Fractions:
        """The fractions of all grains as installed, or as ``initial`` gives them."""
        shape = self.fractions_shape
        uniform, context = temperature.reshape(-1, self.mechanism.wires)[0], self._mechanism_context()

        def installed_with(law: AbstractMaterial) -> Fractions:
            return self.mechanism.fractions(law, uniform, prescribed, context)

        grains, law = self.grains, self.effective_material
        if grains is None:
            installed = installed_with(law)
        else:
            installed = jax.vmap(lambda *each: installed_with(grains.material_of(law, each)))(*grains.shifts.T)
            # All cells start alike.
            installed = Fractions(*(f.reshape(shape[0], *(1,) * (len(shape) - 2), -1) for f in installed))
        installed = Fractions(*(jnp.broadcast_to(f, shape) for f in installed))
        detwinned = (
            installed.detwinned if self.initial.detwinned is None else jnp.broadcast_to(self.initial.detwinned, shape)
        )
        twinned = minimum(installed.twinned, 1.0 - detwinned)
        if self.initial.twinned is not None:
            twinned = jnp.broadcast_to(self.initial.twinned, shape)
        return Fractions(detwinned, twinned)

    def _initial_memory(self, wire_state: WireState) -> tuple[Float[Array, " wires"], dict[str, Any]]:
        """Strains of the wires with the terms of the effects, and the memory of the effects at the start."""
        context = self._stage_context(wire_state.ambient)

        def initial_memory() -> dict[str, Any]:
            return {e.key: self._hook(e, "initial_memory")(wire_state, context) for e in self.all_effects}

        strain = self._strain(wire_state, initial_memory())
        wire_state = wire_state._replace(contraction=self.mechanism.contraction(strain))
        memory = initial_memory()
        return strain, memory | self._shared_memory(wire_state)

    def step(
        self,
        state: State,
        before: Float[Array, " signals"],
        after: Float[Array, " signals"],
        step: Float[Array, ""],
    ) -> tuple[State, Bool[Array, ""]]:
        """Advance the state by one step; differentiable once, in both modes, in all arguments and in the plant.

        Args:
            state: The state at the start of the step.
            before: Signals at the start.
            after: Signals at the end; they are linear over the step.
            step: Duration, s.

        Returns:
            The state at the end, and whether the step could not be solved.

        Raises:
            DerivativeError: When a second derivative is taken.
        """
        return implicit_step(self, state, before, after, step)

    def observe(self, state: State, signal: Float[Array, " signals"]) -> dict[str, Float[Array, ""]]:
        """Compute the channels at one instant, as their sensors read them.

        Args:
            state: The state.
            signal: Signals at the same instant.

        Returns:
            Scalars by channel, in SI and degC, of temperature, stress, strain, force, resistance, current, voltage and
            power of each wire, and the channels of the mechanism.
        """
        wires = self.mechanism.wires
        wire_state = self._wire_state(state)
        strain = self._strain(wire_state, state.memory)
        resistivity = self._along_wire(self._resistivity(wire_state))
        control = self._electrical_input(signal, resistivity)
        current = self.drive.current(control, resistivity, self.wire)
        ohms = resistance(resistivity, self.wire)
        each = {
            "temperature": self._measured_temperature(state.temperature),
            "stress": state.stress,
            "strain": strain,
            "force": state.stress * self.wire.force_per_stress,
            "resistance": ohms,
            "current": current,
            "voltage": current * ohms
            + sum(
                checked_result(e, "voltage", e.voltage(current), current.shape, "wires")
                for e in self._effects_of(DriveEffect)
            ),
            "power": self.drive.joule(control, resistivity, self.wire) * self.wire.area * self.wire.length,
        }
        values = {
            n: jnp.broadcast_to(v, (wires,))[i] for c, v in each.items() for i, n in enumerate(numbered(c, wires))
        }
        values.update(self.mechanism.channels(strain, state.stress, state.motion, self._mechanism_context()))
        return {c: self.sensor.read(c, v) for c, v in values.items()}

    def _measured_temperature(self, temperature: Float[Array, "*cells wires"]) -> Float[Array, " wires"]:
        """The temperatures of the wires where their thermocouples are."""
        if self.cells is None:
            return temperature
        return self.cells.reading(temperature, self._geometry)

    def read_sensors(
        self, series: dict[str, Float[Array, " samples"]], time: Float[Array, " samples"]
    ) -> dict[str, Float[Array, " samples"]]:
        """Apply the effects on the transmission of the motion to its sensor, and on the readings of the sensors.

        Args:
            series: Channels by name, as ``observe`` computes them at each sample.
            time: Times of the samples, s.

        Returns:
            The channels by name, with the effects.
        """
        read, coordinate = dict(series), self.mechanism.coordinate
        metres_per_unit = self.mechanism.wire_motion_per_coordinate
        for e in self._effects_of(MechanismEffect):
            if coordinate in read:
                added = e.displacement(series[coordinate] * metres_per_unit, series, time)
                checked_result(e, "displacement", added, time.shape, "rows")
                read[coordinate] = read[coordinate] + added / metres_per_unit
        seen = dict(read)
        for e in self._effects_of(SensorEffect):
            name, scale = (e.channel, 1.0) if e.channel else (coordinate, metres_per_unit)
            if name in read:
                added = checked_result(e, "reading", e.reading(seen[name] * scale, seen, time), time.shape, "rows")
                read[name] = read[name] + added / scale
        return read

    def capabilities(self, observed: tuple[str, ...]) -> frozenset[str]:
        """List the capabilities that effects may need of a rig (``AbstractEffect.needs``).

        The words are ``clock``; ``one wire`` or ``two wires``; ``spring`` if the mechanism has one; ``drag`` if a
        stress can oppose the contraction (``MechanismEffect.drag``); ``prescribed strain or stress`` of a testing
        machine; ``prescribed temperature``; the electrical input, such as ``current``; the coordinate of the
        mechanism, such as ``displacement`` or ``angle``; and ``CHANNEL observed`` for each observed channel, such as
        ``temperature observed``. That of a recorded surrounding, such as ``fan observed``, counts likewise.
        ``smajax.effects.CAPABILITIES`` has all of them.

        Args:
            observed: Names of the channels that the recordings contain.

        Returns:
            The capabilities; the caller removes ``clock`` if the recordings have no time column.
        """
        control = {self.drive.control} if self.drive.control else set()
        words = control | {"clock", self.mechanism.coordinate, *(f"{c} observed" for c in observed)}
        words |= {"two wires"} if self.mechanism.wires == 2 else {"one wire"}
        words |= {"spring"} if hasattr(self.mechanism, "spring") else set()
        words |= {"prescribed strain or stress"} if self.mechanism.prescribed else set()
        words |= {"prescribed temperature"} if isinstance(self.heat, PrescribedTemperature) else set()
        no_drag = (
            self.mechanism.prescribed
            or self.mechanism.has_dry_friction
            or (self.mechanism.wires == 2 and self.mechanism.unknowns > 1)
        )
        return frozenset(words if no_drag else words | {"drag"})


@once_differentiable("Plant.init under a prescribed strain")
def _equilibrium(plant: Plant, state: State, signal: Float[Array, " signals"]) -> State:
    """The state after a step of zero duration, differentiable."""
    step = jnp.zeros(())
    fixed_plant, fixed_state, fixed_signal = jax.lax.stop_gradient((plant, state, signal))
    solved, _ = fixed_plant.solve_step(fixed_state, fixed_signal, fixed_signal, step)
    end = solved.step_unknowns
    _, jacobian_product = jax.linearize(lambda z: fixed_plant.step_residual(fixed_state, signal, signal, step, z), end)
    residual, state_at_end = plant.step_residual(state, signal, signal, step, end)
    return newton_corrected(state_at_end, residual, jacobian_product)
