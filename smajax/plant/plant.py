"""The plant: its initial state, its time step, and the readings of its sensors.

A step is implicit. Its unknowns and equations are those of ``smajax.plant.step_equations``; ``Plant.step`` solves them
by Newton's method (``smajax.numerics.newton``). The search is not differentiated: ``step_residual`` evaluates the
equations at the solved end, and the implicit function theorem gives the derivatives (``smajax.plant.implicit_step``,
``smajax.simulation.sensitivities``).
"""

from collections.abc import Callable
from typing import Any

import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float

from smajax.channels import numbered
from smajax.numerics import newton
from smajax.numerics.dense import solve_dense
from smajax.numerics.nonsmooth import minimum
from smajax.plant.drive import resistance
from smajax.plant.effects.base import DriveEffect, MechanismEffect, SensorEffect, WireState
from smajax.plant.heat import PrescribedTemperature
from smajax.plant.materials.base import Fractions
from smajax.plant.state import State
from smajax.plant.step_equations import StepEquations

# Channels that every wire has, apart from its strain; ``Plant.observe`` gives each of them.
_WIRE_CHANNELS = ("temperature", "stress", "force", "resistance", "current", "voltage", "power")


class Plant(StepEquations):
    """Differentiable model of a rig: drive, heat, material, mechanism and sensors, and the effects that act on them.

    The parameters are the float leaves; ``smajax.parameters`` reads and sets them by name. A ``signal`` is the vector
    of the recorded channels that drive the plant at one instant, in the order of ``signals``.
    """

    @property
    def longest_step(self) -> jax.Array | float:
        """The longest step in s that resolves the mechanism's own motion."""
        return self.mechanism.longest_step(self._mechanism_context())

    @property
    def observable(self) -> tuple[str, ...]:
        """Names of the channels that ``observe`` computes."""
        wires = self.mechanism.wires
        names = tuple(n for c in _WIRE_CHANNELS for n in numbered(c, wires))
        strain = numbered("strain", wires)
        return tuple(dict.fromkeys((self.mechanism.coordinate, *strain, *names, *self.mechanism.extra_channels)))

    def start(self, signal: Float[Array, " signals"]) -> State:
        """Compute the state at the first sample: as installed, at rest, in equilibrium.

        Args:
            signal: Signals at the first sample.

        Returns:
            The state; differentiable in the plant and in the signals.
        """
        context, prescribed = self._mechanism_context(), self._prescribed_channels(signal)
        resting = self.environment.ambient if self.initial.temperature is None else self.initial.temperature
        temperature = jnp.broadcast_to(prescribed.get("temperature", resting), (self.mechanism.wires,))
        fractions = self._initial_fractions(temperature, prescribed)
        unknown = self.mechanism.initial_unknowns(prescribed, context)
        stress = self.mechanism.stress(unknown, prescribed, context)
        strain = self.effective_material.strain(fractions, temperature, stress, self.environment.ambient)
        if self._has_drag:
            unknown = jnp.append(unknown, 0.0)
        memory: dict[str, Any] = {}
        if self.all_effects:
            strain, memory = self._initial_memory(temperature, fractions, stress, strain)
        state = State(temperature, fractions, stress, unknown, self.mechanism.initial_motion(strain), memory)
        # Under a known load the state is in equilibrium already; a prescribed strain takes a step of zero duration.
        return self._equilibrium(state, signal) if "strain" in prescribed else state

    def _initial_fractions(self, temperature: Float[Array, " wires"], prescribed: dict) -> Fractions:
        """The fractions as installed, or as ``initial`` gives them."""
        installed = self.mechanism.fractions(
            self.effective_material, temperature, prescribed, self._mechanism_context()
        )
        detwinned = (
            installed.detwinned
            if self.initial.detwinned is None
            else jnp.broadcast_to(self.initial.detwinned, temperature.shape)
        )
        twinned = minimum(installed.twinned, 1.0 - detwinned)
        if self.initial.twinned is not None:
            twinned = jnp.broadcast_to(self.initial.twinned, temperature.shape)
        return Fractions(detwinned, twinned)

    def _initial_memory(
        self,
        temperature: Float[Array, " wires"],
        fractions: Fractions,
        stress: Float[Array, " wires"],
        strain: Float[Array, " wires"],
    ) -> tuple[Float[Array, " wires"], dict[str, Any]]:
        """Strains of the wires with the terms of the effects, and the memory of the effects at the start."""
        context = self._stage_context()
        wire_state = WireState(
            jnp.zeros(()),
            temperature,
            fractions,
            stress,
            self.mechanism.contraction(strain),
            jnp.zeros_like(temperature),
        )
        strain = self._strain(wire_state, {e.key: e.initial_memory(wire_state, context) for e in self.all_effects})
        wire_state = wire_state._replace(contraction=self.mechanism.contraction(strain))
        memory = {e.key: e.initial_memory(wire_state, context) for e in self.all_effects}
        return strain, memory | self._shared_memory(wire_state)

    def _equilibrium(self, state: State, signal: Float[Array, " signals"]) -> State:
        """The state after a step of zero duration, differentiable."""
        step = jnp.zeros(())
        solved, _ = self.step(state, signal, signal, step)
        end = jax.lax.stop_gradient(jnp.concatenate([solved.temperature, solved.unknown]))
        _, jacobian_product = jax.linearize(
            lambda z: jax.lax.stop_gradient(self).step_residual(jax.lax.stop_gradient(state), signal, signal, step, z),
            end,
        )
        residual, state_at_end = self.step_residual(state, signal, signal, step, end)
        return _newton_corrected(state_at_end, residual, jacobian_product)

    def step(
        self,
        state: State,
        before: Float[Array, " signals"],
        after: Float[Array, " signals"],
        step: Float[Array, ""],
    ) -> tuple[State, Bool[Array, ""]]:
        """Advance the state by one step. Not differentiable; ``step_residual`` is, at the solved end.

        Args:
            state: The state at the start of the step.
            before: Signals at the start.
            after: Signals at the end; they are linear over the step.
            step: Duration, s.

        Returns:
            The state at the end, and whether the step could not be solved.
        """
        state = self._begin_step(state, step)
        rate = self._net_heat(self._wire_state(state), state.memory, before)
        guess = jnp.concatenate([self._predicted_temperature(state, rate, after, step), state.unknown])
        constants = jax.lax.stop_gradient((self, state, rate, before, after, step))
        if isinstance(self.heat, PrescribedTemperature) and not self.mechanism.unknowns:
            end, failed = guess, jnp.asarray(False)
        else:
            end, failed = self._solve(
                lambda z, coarse: Plant._residual(*constants, z, coarse=coarse)[0], jax.lax.stop_gradient(guess)
            )
        (residual, state_at_end), jacobian_product = jax.linearize(lambda z: Plant._residual(*constants, z), end)
        return _newton_corrected(state_at_end, residual, jacobian_product), failed

    def _predicted_temperature(
        self, state: State, rate: Float[Array, " wires"], after: Float[Array, " signals"], step: Float[Array, ""]
    ) -> Float[Array, " wires"]:
        """First guess of the temperature at the end of a step: an explicit Euler step."""
        if isinstance(self.heat, PrescribedTemperature):
            return jnp.broadcast_to(self._prescribed_channels(after)["temperature"], state.temperature.shape)
        return state.temperature + step * rate / self._heat_capacity(state.fractions.martensite)

    def _solve(
        self,
        residual: Callable[[Float[Array, " unknowns"], bool], Float[Array, " unknowns"]],
        guess: Float[Array, " unknowns"],
    ) -> tuple[Float[Array, " unknowns"], Bool[Array, ""]]:
        """Solve ``residual(z, coarse) = 0`` from ``guess``: the solution, and whether the search failed."""
        wires = self.mechanism.wires

        def solve_with_friction() -> tuple[Float[Array, " unknowns"], Bool[Array, ""]]:
            # The last Newton step must not cross a nonsmooth point of the friction, so the search uses the exact
            # balances.
            return newton.solve_with_friction(lambda z: residual(z, False), guess, wires)

        if self.mechanism.has_dry_friction:
            return solve_with_friction()
        if not self._has_drag:
            # The balance of temperatures alone, without latent heat, is so nearly linear over a step that one Newton
            # step and the last one are sufficient.
            search = newton.solve if self.mechanism.unknowns or self.all_effects else newton.single_step
            return search(lambda z: residual(z, True), guess, wires)
        # A drag is an additional unknown. Without friction it is 0, and without it the search takes fewer iterations.
        no_drag = jnp.zeros(1)

        def solve_without_drag() -> tuple[Float[Array, " unknowns"], Bool[Array, ""]]:
            end, failed = newton.solve(lambda z: residual(jnp.concatenate([z, no_drag]), True)[:-1], guess[:-1], wires)
            return jnp.concatenate([end, no_drag]), failed

        strengths = jnp.stack([e.strength for e in self._effects_of(MechanismEffect) if e.has_drag])
        return jax.lax.cond(jnp.any(strengths != 0.0), solve_with_friction, solve_without_drag)

    def observe(self, state: State, signal: Float[Array, " signals"]) -> dict[str, Float[Array, ""]]:
        """Compute the channels at one instant, as their sensors read them.

        Args:
            state: The state.
            signal: Signals at the same instant.

        Returns:
            Scalars by channel, in SI and degC: temperature, stress, strain, force, resistance, current, voltage and
            power of each wire, and the channels of the mechanism.
        """
        wires = self.mechanism.wires
        wire_state = self._wire_state(state)
        strain = self._strain(wire_state, state.memory)
        resistivity = self._resistivity(wire_state)
        control = self._electrical_input(signal, resistivity)
        current = self.drive.current(control, resistivity, self.wire)
        ohms = resistance(resistivity, self.wire)
        each = {
            "temperature": state.temperature,
            "stress": state.stress,
            "strain": strain,
            "force": state.stress * self.wire.force_per_stress,
            "resistance": ohms,
            "current": current,
            "voltage": current * ohms + sum(e.voltage(current) for e in self._effects_of(DriveEffect)),
            "power": self.drive.joule(control, resistivity, self.wire) * self.wire.area * self.wire.length,
        }
        values = {
            n: jnp.broadcast_to(v, (wires,))[i] for c, v in each.items() for i, n in enumerate(numbered(c, wires))
        }
        values.update(self.mechanism.channels(strain, state.stress, state.motion, self._mechanism_context()))
        return {c: self.sensor.read(c, v) for c, v in values.items()}

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
                read[coordinate] = read[coordinate] + added / metres_per_unit
        seen = dict(read)
        for e in self._effects_of(SensorEffect):
            name, scale = (e.channel, 1.0) if e.channel else (coordinate, metres_per_unit)
            if name in read:
                read[name] = read[name] + e.reading(seen[name] * scale, seen, time) / scale
        return read

    def capabilities(self, observed: tuple[str, ...]) -> frozenset[str]:
        """List the capabilities that effects may need of a rig (``AbstractEffect.needs``), such as ``two wires``.

        Args:
            observed: Names of the channels that the recordings contain.

        Returns:
            The capabilities; the caller removes ``clock`` if the recordings have no time column.
        """
        words = {"clock", self.drive.control, self.mechanism.coordinate, *(f"{c} observed" for c in observed)}
        words |= {"two wires"} if self.mechanism.wires == 2 else {"one wire"}
        words |= {"spring"} if hasattr(self.mechanism, "spring") else set()
        words |= {"prescribed strain or stress"} if self.mechanism.prescribed else set()
        no_drag = (
            self.mechanism.prescribed
            or self.mechanism.has_dry_friction
            or (self.mechanism.wires == 2 and self.mechanism.unknowns > 1)
        )
        return frozenset(words if no_drag else words | {"drag"})


def _newton_corrected(state: State, residual: Float[Array, " unknowns"], jacobian_product: Callable) -> State:
    """The state after one more Newton step; ``jacobian_product`` is the linearised residual and state there.

    The Jacobian is not differentiated, so the derivative of the result is that of the implicit function.
    """
    size = residual.shape[0]
    jacobian, state_per_unknown = jax.vmap(jacobian_product, out_axes=-1)(jnp.eye(size))
    change = -solve_dense(jacobian, residual)
    return jax.tree.map(lambda s, d: s + sum(d[..., i] * change[i] for i in range(size)), state, state_per_unknown)
