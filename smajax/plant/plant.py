"""The plant: the five stages put together, and one step of them in time.

A step is implicit. Its unknowns are the wires' temperatures and the mechanism's unknowns at its end; its equations are the heat balance
of each wire and the balance of the mechanism, both evaluated with the fractions that the material law gives at that end. So heat, phase
fractions, stress and motion agree with each other within the instant. ``Plant.advance`` solves them by Newton's method with a Jacobian of
at most five columns. The derivative of the solution is that of one last Newton step with the Jacobian held fixed, which is the implicit
function theorem and costs one evaluation: exact to first order in forward and in reverse mode, however many iterations were needed.
"""

from collections.abc import Callable
from typing import Any, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp

from smajax.plant.drive import AbstractDrive, resistance
from smajax.plant.heat import AbstractHeat, PrescribedTemperature
from smajax.plant.material.base import AbstractMaterial, Fractions
from smajax.plant.mechanism import AbstractMechanism, Surroundings
from smajax.plant.sensor import Sensor
from smajax.plant.wire import Environment, Initial, Wire

_ITERATIONS = 40
# A last Newton step follows the loop, so the loop may stop where that step's error, quadratic in these, is below rounding of any recording.
_TEMPERATURE_TOLERANCE = 1e-3
_STRESS_TOLERANCE = 1e3


class State(NamedTuple):
    """The plant's state at one instant: arrays of shape ``(wires,)``, the mechanism's ``unknown``, and ``motion``, what it remembers."""

    temperature: jax.Array
    fractions: Fractions
    stress: jax.Array
    unknown: jax.Array
    motion: Any


class Plant(eqx.Module):
    """A rig's differentiable model. Parameters are the float leaves, named as in ``smajax.parameters``."""

    wire: Wire
    environment: Environment
    initial: Initial
    drive: AbstractDrive
    heat: AbstractHeat
    material: AbstractMaterial
    mechanism: AbstractMechanism
    sensor: Sensor

    @property
    def signals(self) -> tuple[str, ...]:
        """The recorded channels that drive the plant, in the order of the columns of ``signal`` below."""
        wires = self.mechanism.wires
        control = [self.drive.control] if self.drive.control else []
        if wires > 1:
            control = [f"{c}_{i + 1}" for c in control for i in range(wires)]
        temperature = ["temperature"] if isinstance(self.heat, PrescribedTemperature) else []
        return (*control, *temperature, *self.mechanism.prescribed)

    @property
    def observable(self) -> tuple[str, ...]:
        """The channels that ``outputs`` gives."""
        wires = self.mechanism.wires
        each = ("temperature", "stress", "force", "resistance", "current", "voltage", "power")
        names = each if wires == 1 else tuple(f"{c}_{i + 1}" for c in each for i in range(wires))
        strain = ("strain",) if wires == 1 else tuple(f"strain_{i + 1}" for i in range(wires))
        torque = ("torque",) if self.mechanism.coordinate == "angle" else ()
        return tuple(dict.fromkeys((self.mechanism.coordinate, *strain, *names, *torque)))

    def start(self, signal: jax.Array) -> State:
        """The state at the first row, whose signals are given, shape ``(signals,)``: as installed, at rest, in equilibrium."""
        around = self._around()
        prescribed = self._prescribed(signal)
        resting = self.environment.ambient if self.initial.temperature is None else self.initial.temperature
        temperature = jnp.broadcast_to(prescribed.get("temperature", resting), (self.mechanism.wires,))
        installed = self.mechanism.fractions(self.material, temperature, prescribed, around)
        detwinned = installed.detwinned if self.initial.detwinned is None else jnp.broadcast_to(self.initial.detwinned, temperature.shape)
        twinned = jnp.minimum(installed.twinned, 1.0 - detwinned)
        if self.initial.twinned is not None:
            twinned = jnp.broadcast_to(self.initial.twinned, temperature.shape)
        fractions = Fractions(detwinned, twinned)
        unknown = self.mechanism.unloaded(prescribed, around)
        stress = self.mechanism.stress(unknown, prescribed, around)
        strain = self.material.strain(fractions, temperature, stress, self.environment.ambient)
        state = State(temperature, fractions, stress, unknown, self.mechanism.start(strain))
        # Under a known load the state is in equilibrium as it stands; a prescribed strain first has to be met, in a step of no duration.
        return self.advance(state, signal, signal, jnp.zeros(()))[0] if "strain" in prescribed else state

    def advance(self, state: State, before: jax.Array, after: jax.Array, step: jax.Array) -> tuple[State, jax.Array]:
        """The state ``step`` seconds on, the signals going from ``before`` to ``after``, each of shape ``(signals,)``.

        Also says whether the step could not be solved: a boolean scalar.
        """
        rate = self._rate(state.temperature, state.fractions, before)
        guess = jnp.concatenate([self._predict(state, rate, after, step), state.unknown])
        given = jax.lax.stop_gradient((self, state, rate, before, after, step))
        if isinstance(self.heat, PrescribedTemperature) and not self.mechanism.unknowns:
            end, failed = guess, jnp.asarray(False)
        else:
            end, failed = _search(lambda z: Plant._residual(*given, z, coarse=True)[0], jax.lax.stop_gradient(guess), self.mechanism.wires)
        return self.arrive(state, before, after, step, end), failed

    def arrive(self, state: State, before: jax.Array, after: jax.Array, step: jax.Array, end: jax.Array) -> State:
        """The state at the end of a step whose solution ``end`` (temperatures, then unknowns) is known, as a function of all else.

        One Newton step from ``end`` with the Jacobian held fixed: what is left of the search's error goes with it, and its derivative is
        that of the implicit function.
        """
        end = jax.lax.stop_gradient(end)
        rate = self._rate(state.temperature, state.fractions, before)
        given = (self, state, rate, before, after, step)
        frozen = jax.lax.stop_gradient(given)
        _, push = jax.linearize(lambda z: Plant._residual(*frozen, z), end)
        slope, per_end = jax.vmap(push, out_axes=-1)(jnp.eye(end.shape[0]))
        value, state = Plant._residual(*given, end)
        last = -_linear(slope, value)
        return jax.tree.map(lambda s, d: s + sum(d[..., i] * last[i] for i in range(len(last))), state, per_end)

    def outputs(self, state: State, signal: jax.Array) -> dict[str, jax.Array]:
        """The observable channels at one instant as the sensors give them, in SI and degC, scalars."""
        wires = self.mechanism.wires
        around = self._around()
        strain = self.material.strain(state.fractions, state.temperature, state.stress, self.environment.ambient)
        resistivity = self.material.resistivity(state.fractions)
        current = self.drive.current(self._control(signal), resistivity, self.wire)
        ohms = resistance(resistivity, self.wire)
        each = {
            "temperature": state.temperature,
            "stress": state.stress,
            "strain": strain,
            "force": state.stress * self.wire.area,
            "resistance": ohms,
            "current": current,
            "voltage": current * ohms,
            "power": self.drive.joule(self._control(signal), resistivity, self.wire) * self.wire.area * self.wire.length,
        }
        values = {c if wires == 1 else f"{c}_{i + 1}": jnp.broadcast_to(v, (wires,))[i] for c, v in each.items() for i in range(wires)}
        values.update(self.mechanism.channels(strain, state.stress, state.motion, around))
        return {c: self.sensor.read(c, v) for c, v in values.items()}

    def _around(self) -> Surroundings:
        return Surroundings(self.wire, self.environment, self.material.modulus(Fractions(jnp.zeros(()), jnp.zeros(()))))

    def _control(self, signal: jax.Array) -> jax.Array:
        return signal[: self.mechanism.wires] if self.drive.control else jnp.zeros((self.mechanism.wires,))

    def _prescribed(self, signal: jax.Array) -> dict[str, jax.Array]:
        skip = self.mechanism.wires if self.drive.control else 0
        return {name: signal[skip + i] for i, name in enumerate(self.signals[skip:])}

    def _rate(self, temperature: jax.Array, fractions: Fractions, signal: jax.Array) -> jax.Array:
        joule = self.drive.joule(self._control(signal), self.material.resistivity(fractions), self.wire)
        return self.heat.rate(joule, temperature, self.wire, self.environment)

    def _predict(self, state: State, rate: jax.Array, after: jax.Array, step: jax.Array) -> jax.Array:
        if isinstance(self.heat, PrescribedTemperature):
            return jnp.broadcast_to(self._prescribed(after)["temperature"], state.temperature.shape)
        return state.temperature + step * rate / self.heat.capacity(state.fractions.martensite)

    def _residual(
        self,
        state: State,
        rate: jax.Array,
        before: jax.Array,
        after: jax.Array,
        step: jax.Array,
        end: jax.Array,
        coarse: bool = False,
    ) -> tuple[jax.Array, State]:
        """What is left of the balances (K and Pa) if the step ends at ``end``, and the state there.

        ``coarse`` holds the heat by the trapezoidal rule: near enough to search by, since the last Newton step closes what is between them.
        """
        around, prescribed = self._around(), self._prescribed(after)
        unknown = end[self.mechanism.wires :]
        temperature = end[: self.mechanism.wires]
        if "temperature" in prescribed:
            temperature = jnp.broadcast_to(prescribed["temperature"], temperature.shape)
        stress = self.mechanism.stress(unknown, prescribed, around)
        fractions = self.material.evolve(state.fractions, (state.temperature, temperature), (state.stress, stress))
        strain = self.material.strain(fractions, temperature, stress, self.environment.ambient)
        if isinstance(self.heat, PrescribedTemperature):
            heat = end[: self.mechanism.wires] - temperature
        else:
            last = self._rate(temperature, fractions, after)
            ends = (state.temperature, temperature)
            if coarse:
                capacity = self.heat.capacity(0.5 * (state.fractions.martensite + fractions.martensite))
                heat = ends[1] - ends[0] - 0.5 * step * (rate + last) / capacity
                balance = self.mechanism.balance(unknown, strain, state.motion, prescribed, around, step)
                return jnp.concatenate([heat, balance]), State(temperature, fractions, stress, unknown, state.motion)
            half = self.heat.halfway(ends, (state.fractions.martensite, fractions.martensite), (rate, last), step)
            between = self.material.evolve(state.fractions, (ends[0], half), (state.stress, 0.5 * (state.stress + stress)))
            rates = (rate, self._rate(half, between, 0.5 * (before + after)), last)
            martensite = (state.fractions.martensite, between.martensite, fractions.martensite)
            heat = self.heat.balance(ends, martensite, rates, step)
        balance = self.mechanism.balance(unknown, strain, state.motion, prescribed, around, step)
        motion = self.mechanism.move(unknown, strain, state.motion, around, step)
        return jnp.concatenate([heat, balance]), State(temperature, fractions, stress, unknown, motion)


def _search(residual: Callable, guess: jax.Array, wires: int) -> tuple[jax.Array, jax.Array]:
    """Solves ``residual(z) = 0`` by Newton's method with halving; says whether it failed. Not differentiable.

    The first ``wires`` unknowns are temperatures in K, the rest stresses in Pa. Temperatures alone are so nearly linear over a step that
    one iteration, and the one in ``arrive``, do.
    """
    size = guess.shape[0]
    scale = jnp.where(jnp.arange(size) < wires, _TEMPERATURE_TOLERANCE, _STRESS_TOLERANCE)

    def newton(z: jax.Array) -> tuple[jax.Array, jax.Array]:
        value, push = jax.linearize(residual, z)
        return value, -_linear(jax.vmap(push, out_axes=-1)(jnp.eye(size)), value)

    def norm(value: jax.Array) -> jax.Array:
        return jnp.max(jnp.abs(value) / scale)

    def unsolved(carry: tuple) -> jax.Array:
        _, _, change, count, _ = carry
        return (norm(change) > 1.0) & (count < _ITERATIONS)

    def iterate(carry: tuple) -> tuple:
        z, error, change, count, fraction = carry
        trial = z + fraction * change
        value, new = newton(trial)
        better = norm(value) <= error
        return (
            jnp.where(better, trial, z),
            jnp.where(better, norm(value), error),
            jnp.where(better, new, change),
            count + 1,
            jnp.where(better, 1.0, 0.5 * fraction),
        )

    if size == wires:
        change = newton(guess)[1]
        return guess + change, ~jnp.all(jnp.isfinite(change))
    start = (guess, jnp.asarray(jnp.inf), jnp.full_like(guess, 0.0), 0, jnp.asarray(1.0))
    z, _, change, count, _ = jax.lax.while_loop(unsolved, iterate, iterate(start))
    return z + change, (count >= _ITERATIONS) | ~jnp.all(jnp.isfinite(change))


def _linear(matrix: jax.Array, right: jax.Array) -> jax.Array:
    """Solves a system of up to five equations by elimination without pivoting, which its positive diagonal allows."""
    size = right.shape[0]
    rows = [[matrix[i, j] for j in range(size)] + [right[i]] for i in range(size)]
    for k in range(size):
        for i in range(k + 1, size):
            factor = rows[i][k] / rows[k][k]
            rows[i] = [a - factor * b for a, b in zip(rows[i], rows[k], strict=True)]
    answer = [right[0]] * size
    for i in reversed(range(size)):
        answer[i] = (rows[i][size] - sum(rows[i][j] * answer[j] for j in range(i + 1, size))) / rows[i][i]
    return jnp.stack(answer)
