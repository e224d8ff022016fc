"""The plant: the five stages put together, and one step of them in time.

A step is implicit. Its unknowns are the wires' temperatures and the mechanism's unknowns at its end; its equations are the heat balance
of each wire and the balance of the mechanism, both evaluated with the fractions that the material law gives at that end. So heat, phase
fractions, stress and motion agree with each other within the instant. ``Plant.advance`` solves them by Newton's method
(``smajax.plant.newton``). Derivatives do not go through the search: ``arrive`` gives the equations at a known end, to which the implicit
function theorem applies (``smajax.simulate``).
"""

from collections.abc import Callable
from typing import Any, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp

from smajax.kinks import smaller
from smajax.plant import newton
from smajax.plant.drive import AbstractDrive, resistance
from smajax.plant.effect import AbstractEffect, DriveEffect, HeatEffect, Instant, MaterialEffect, MechanismEffect, SensorEffect, Where
from smajax.plant.heat import AbstractHeat, PrescribedTemperature
from smajax.plant.material.base import AbstractMaterial, Fractions
from smajax.plant.mechanism import AbstractMechanism, Surroundings
from smajax.plant.sensor import Sensor
from smajax.plant.wire import AbstractWire, Environment, Initial
from smajax.units import numbered


class State(NamedTuple):
    """The plant's state at one instant: arrays of shape ``(wires,)``, the balance's ``unknown``, and what is remembered.

    ``motion`` is what the mechanism remembers, ``memory`` what effects do: time, contraction and travel (see ``Instant``), and of each
    effect its own; empty without effects.
    """

    temperature: jax.Array
    fractions: Fractions
    stress: jax.Array
    unknown: jax.Array
    motion: Any
    memory: dict[str, Any]


class Plant(eqx.Module):
    """A rig's differentiable model. Parameters are the float leaves, named as in ``smajax.parameters``."""

    wire: AbstractWire
    environment: Environment
    initial: Initial
    drive: AbstractDrive
    heat: AbstractHeat
    material: AbstractMaterial
    mechanism: AbstractMechanism
    sensor: Sensor
    effects: tuple[AbstractEffect, ...] = ()

    @property
    def longest_step(self) -> jax.Array | float:
        """The longest step in s that resolves the mechanism's own motion."""
        return self.mechanism.longest_step(self._around())

    @property
    def signals(self) -> tuple[str, ...]:
        """The recorded channels that drive the plant, in the order of the columns of ``signal`` below."""
        wires = self.mechanism.wires
        control = [self.drive.control] if self.drive.control else []
        control = [n for c in control for n in numbered(c, wires)]
        temperature = ["temperature"] if isinstance(self.heat, PrescribedTemperature) else []
        return (*control, *temperature, *self.mechanism.prescribed)

    @property
    def terms(self) -> tuple[AbstractEffect, ...]:
        """The effects that the mechanism always has, and those that were added."""
        return (*self.mechanism.effects, *self.effects)

    @property
    def observable(self) -> tuple[str, ...]:
        """The channels that ``outputs`` gives."""
        wires = self.mechanism.wires
        each = ("temperature", "stress", "force", "resistance", "current", "voltage", "power")
        names = tuple(n for c in each for n in numbered(c, wires))
        strain = numbered("strain", wires)
        return tuple(dict.fromkeys((self.mechanism.coordinate, *strain, *names, *self.mechanism.beside)))

    @property
    def law(self) -> AbstractMaterial:
        """The material law as the wire's geometry shows it: with the elastic modulus between the stress and the strain that it knows."""
        return self.material.stiffened(self.wire.modulus_factor)

    def start(self, signal: jax.Array) -> State:
        """The state at the first row, whose signals are given, shape ``(signals,)``: as installed, at rest, in equilibrium."""
        around = self._around()
        prescribed = self._prescribed(signal)
        resting = self.environment.ambient if self.initial.temperature is None else self.initial.temperature
        temperature = jnp.broadcast_to(prescribed.get("temperature", resting), (self.mechanism.wires,))
        installed = self.mechanism.fractions(self.law, temperature, prescribed, around)
        detwinned = installed.detwinned if self.initial.detwinned is None else jnp.broadcast_to(self.initial.detwinned, temperature.shape)
        twinned = smaller(installed.twinned, 1.0 - detwinned)
        if self.initial.twinned is not None:
            twinned = jnp.broadcast_to(self.initial.twinned, temperature.shape)
        fractions = Fractions(detwinned, twinned)
        unknown = self.mechanism.unloaded(prescribed, around)
        stress = self.mechanism.stress(unknown, prescribed, around)
        strain = self.law.strain(fractions, temperature, stress, self.environment.ambient)
        if self._drags:
            unknown = jnp.append(unknown, 0.0)
        memory: dict[str, Any] = {}
        if self.terms:
            at = Instant(jnp.zeros(()), temperature, fractions, stress, self.mechanism.contraction(strain), jnp.zeros_like(temperature))
            where = self._where()
            strain = self._strain(at, {e.key: e.start(at, where) for e in self.terms})
            at = at._replace(contraction=self.mechanism.contraction(strain))
            memory = {e.key: e.start(at, where) for e in self.terms}
            memory |= {"time": at.time, "contraction": at.contraction, "travel": at.travel}
        state = State(temperature, fractions, stress, unknown, self.mechanism.start(strain), memory)
        # Under a known load the state is in equilibrium as it stands; a prescribed strain first has to be met, in a step of no duration.
        if "strain" not in prescribed:
            return state
        step = jnp.zeros(())
        met, _ = self.advance(state, signal, signal, step)
        end = jax.lax.stop_gradient(jnp.concatenate([met.temperature, met.unknown]))
        _, push = jax.linearize(lambda z: jax.lax.stop_gradient(self).arrive(jax.lax.stop_gradient(state), signal, signal, step, z), end)
        value, landed = self.arrive(state, signal, signal, step, end)
        return _stepped(landed, value, push)

    def advance(self, state: State, before: jax.Array, after: jax.Array, step: jax.Array) -> tuple[State, jax.Array]:
        """The state ``step`` seconds on, the signals going from ``before`` to ``after``, each of shape ``(signals,)``.

        Also says whether the step could not be solved: a boolean scalar. Not differentiable: ``arrive`` is, at a known end.
        """
        state = self._begin(state, step)
        rate = self._rate(self._instant(state), state.memory, before)
        guess = jnp.concatenate([self._predict(state, rate, after, step), state.unknown])
        given = jax.lax.stop_gradient((self, state, rate, before, after, step))
        if isinstance(self.heat, PrescribedTemperature) and not self.mechanism.unknowns:
            end, failed = guess, jnp.asarray(False)
        else:
            end, failed = self._search(lambda z, coarse: Plant._residual(*given, z, coarse=coarse)[0], jax.lax.stop_gradient(guess))
        (value, landed), push = jax.linearize(lambda z: Plant._residual(*given, z), end)
        return _stepped(landed, value, push), failed

    def _search(self, residual: Callable[[jax.Array, bool], jax.Array], guess: jax.Array) -> tuple[jax.Array, jax.Array]:
        """Where the balances ``residual(z, coarse)`` hold, searched from ``guess``; and whether that failed."""
        wires = self.mechanism.wires
        # Where there is dry friction the last step must not lead over its kinks, so that the search takes the exact balances.
        rubbing = lambda: newton.solve_with_friction(lambda z: residual(z, False), guess, wires)  # noqa: E731
        if self.mechanism.sticks:
            return rubbing()
        if not self._drags:
            # Temperatures alone, without latent heat, are so nearly linear over a step that one iteration, and the last one, do.
            search = newton.solve if self.mechanism.unknowns or self.terms else newton.once
            return search(lambda z: residual(z, True), guess, wires)
        # A drag is an unknown of its own. One that is absent is 0, and the others are sooner found without it.
        absent = jnp.zeros(1)

        def free() -> tuple[jax.Array, jax.Array]:
            end, failed = newton.solve(lambda z: residual(jnp.concatenate([z, absent]), True)[:-1], guess[:-1], wires)
            return jnp.concatenate([end, absent]), failed

        drags = jnp.stack([e.strength for e in self._of(MechanismEffect) if e.drags])
        return jax.lax.cond(jnp.any(drags != 0.0), rubbing, free)

    def arrive(self, state: State, before: jax.Array, after: jax.Array, step: jax.Array, end: jax.Array) -> tuple[jax.Array, State]:
        """What is left of a step's balances if it ends at ``end`` (temperatures, then unknowns), and the state there: differentiable."""
        state = self._begin(state, step)
        return self._residual(state, self._rate(self._instant(state), state.memory, before), before, after, step, end)

    def outputs(self, state: State, signal: jax.Array) -> dict[str, jax.Array]:
        """The observable channels at one instant as the sensors give them, in SI and degC, scalars."""
        wires = self.mechanism.wires
        around = self._around()
        at = self._instant(state)
        strain = self._strain(at, state.memory)
        resistivity = self._resistivity(at)
        driven = self._driven(signal, resistivity)
        current = self.drive.current(driven, resistivity, self.wire)
        ohms = resistance(resistivity, self.wire)
        each = {
            "temperature": state.temperature,
            "stress": state.stress,
            "strain": strain,
            "force": state.stress * self.wire.force_per_stress,
            "resistance": ohms,
            "current": current,
            "voltage": current * ohms + sum(e.voltage(current) for e in self._of(DriveEffect)),
            "power": self.drive.joule(driven, resistivity, self.wire) * self.wire.area * self.wire.length,
        }
        values = {n: jnp.broadcast_to(v, (wires,))[i] for c, v in each.items() for i, n in enumerate(numbered(c, wires))}
        values.update(self.mechanism.channels(strain, state.stress, state.motion, around))
        return {c: self.sensor.read(c, v) for c, v in values.items()}

    def _around(self) -> Surroundings:
        return Surroundings(self.wire, self.environment, self.law.modulus(Fractions(jnp.zeros(()), jnp.zeros(()))))

    def _control(self, signal: jax.Array) -> jax.Array:
        return signal[: self.mechanism.wires] if self.drive.control else jnp.zeros((self.mechanism.wires,))

    def _driven(self, signal: jax.Array, resistivity: jax.Array) -> jax.Array:
        """The electrical input as it reaches the wires, shape ``(wires,)``."""
        control, nothing = self._control(signal), jnp.zeros(())
        ratio = resistivity / self.material.resistivity(Fractions(nothing, nothing))
        return control + sum(e.signal(control, ratio) for e in self._of(DriveEffect))

    def _prescribed(self, signal: jax.Array) -> dict[str, jax.Array]:
        skip = self.mechanism.wires if self.drive.control else 0
        return {name: signal[skip + i] for i, name in enumerate(self.signals[skip:])}

    def _of(self, kind: type | tuple[type, ...]) -> tuple:
        return tuple(e for e in self.terms if isinstance(e, kind))

    @property
    def _drags(self) -> bool:
        return any(e.drags for e in self._of(MechanismEffect))

    def _where(self) -> Where:
        return Where(self.wire, self.environment, self.law, self.heat)

    def _instant(self, state: State) -> Instant:
        nothing = jnp.zeros(())
        memory = {"time": nothing, "contraction": nothing, "travel": jnp.zeros_like(state.temperature)} | state.memory
        return Instant(memory["time"], state.temperature, state.fractions, state.stress, memory["contraction"], memory["travel"])

    def _resistivity(self, at: Instant) -> jax.Array:
        base, where = self.material.resistivity(at.fractions), self._where()
        return base + sum(base * e.resistivity(at, where) for e in self._of(MaterialEffect))

    def _strain(self, at: Instant, memory: dict) -> jax.Array:
        where = self._where()
        base = where.material.strain(at.fractions, at.temperature, at.stress, self.environment.ambient)
        return base + sum(e.strain(at, memory[e.key], where) for e in self._of(MaterialEffect))

    def _evolve(self, first: Instant, temperature: jax.Array, stress: jax.Array) -> Fractions:
        where = self._where()
        material, shift = where.material, 0.0
        for e in self._of(MaterialEffect):
            material, shift = e.alter(material), shift + e.shift(first, where)
        fractions = material.evolve(first.fractions, (first.temperature - shift, temperature - shift), (first.stress, stress))
        for e in self._of(MaterialEffect):
            fractions = e.transform(first.fractions, fractions)
        return fractions

    def _capacity(self, martensite: jax.Array) -> jax.Array:
        base = self.heat.capacity(martensite)
        return base + sum(base * e.capacity(martensite) for e in self._of(HeatEffect))

    def _rate(self, at: Instant, memory: dict, signal: jax.Array) -> jax.Array:
        resistivity, where = self._resistivity(at), self._where()
        joule = self.drive.joule(self._driven(signal, resistivity), resistivity, self.wire)
        rate = self.heat.rate(joule, at.temperature, self.wire, self.environment)
        return rate + sum(e.power(at, memory[e.key], where) for e in self._of(HeatEffect))

    def _stored(self, first: Instant, last: Instant) -> jax.Array | float:
        where = self._where()
        return sum((e.enthalpy(last, where) - e.enthalpy(first, where) for e in self._of(HeatEffect)), 0.0)

    def _begin(self, state: State, step: jax.Array) -> State:
        memory = {e.key: e.begin(state.memory[e.key], state.memory["time"], step) for e in self._of(HeatEffect)}
        return state._replace(memory=state.memory | memory)

    def _remember(self, kinds: tuple, memory: dict, first: Instant, last: Instant, step: jax.Array) -> dict:
        where = self._where()
        return {e.key: e.remember(memory[e.key], first, last, step, where) for e in self._of(kinds)}

    def _predict(self, state: State, rate: jax.Array, after: jax.Array, step: jax.Array) -> jax.Array:
        if isinstance(self.heat, PrescribedTemperature):
            return jnp.broadcast_to(self._prescribed(after)["temperature"], state.temperature.shape)
        return state.temperature + step * rate / self._capacity(state.fractions.martensite)

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
        first, wires = self._instant(state), self.mechanism.wires
        unknown = end[wires : wires + self.mechanism.unknowns]
        temperature = end[:wires]
        if "temperature" in prescribed:
            temperature = jnp.broadcast_to(prescribed["temperature"], temperature.shape)
        stress = self.mechanism.stress(unknown, prescribed, around)
        if self._drags:
            stress = self.mechanism.dragged(stress, end[-1])
        fractions = self._evolve(first, temperature, stress)
        last = Instant(first.time + step, temperature, fractions, stress, first.contraction, first.travel)
        memory = dict(state.memory)
        if self.terms:
            moved = jnp.abs(fractions.martensite - first.fractions.martensite)
            last = last._replace(travel=first.travel + moved)
            memory |= self._remember((HeatEffect, MaterialEffect), memory, first, last, step)
        strain = self._strain(last, memory)
        if self.terms:
            last = last._replace(contraction=self.mechanism.contraction(strain))
            memory |= self._remember((MechanismEffect,), memory, first, last, step)
            memory |= {"time": last.time, "contraction": last.contraction, "travel": last.travel}
        if isinstance(self.heat, PrescribedTemperature):
            heat = end[:wires] - temperature
        else:
            heat = self._heat(first, last, state.memory, memory, (rate, before, after), step, coarse)
        balance = self.mechanism.balance(unknown, strain, state.motion, prescribed, around, step)
        motion = self.mechanism.move(unknown, strain, state.motion, around, step)
        rest = [heat, balance]
        if self._drags:
            where = self._where()
            drags = [e.drag(first, last, memory[e.key], step, where) for e in self._of(MechanismEffect) if e.drags]
            rest.append((end[-1] - sum(drags))[None])
        return jnp.concatenate(rest), State(temperature, fractions, stress, end[wires:], motion, memory)

    def _heat(self, first: Instant, last: Instant, memory: dict, later: dict, inputs: tuple, step: jax.Array, coarse: bool) -> jax.Array:
        """Residual of the heat balance in K, shape ``(wires,)``; ``inputs`` are the rate at the start and the signals at both ends."""
        rate, before, after = inputs
        ends = (first.temperature, last.temperature)
        rates = (rate, self._rate(last, later, after))
        capacity = (self._capacity(first.fractions.martensite), self._capacity(last.fractions.martensite))
        stored = self._stored(first, last)
        if coarse:
            return self.heat.trapezoid(ends, capacity, rates, stored, step)
        half = self.heat.halfway(ends, capacity, rates, step)
        stress = 0.5 * (first.stress + last.stress)
        between = self._evolve(first, half, stress)
        middle = Instant(
            first.time + 0.5 * step, half, between, stress,
            0.5 * (first.contraction + last.contraction), 0.5 * (first.travel + last.travel),
        )  # fmt: skip
        remembered = memory | self._remember((HeatEffect,), memory, first, middle, 0.5 * step)
        rates = (rates[0], self._rate(middle, remembered, 0.5 * (before + after)), rates[1])
        return self.heat.balance(ends, (capacity[0], self._capacity(between.martensite), capacity[1]), rates, stored, step)

    def read(self, series: dict[str, jax.Array], time: jax.Array) -> dict[str, jax.Array]:
        """Series of channels as carried to their sensors and read there; each of shape ``(n,)``, as ``time`` in s is."""
        read, coordinate, metres = dict(series), self.mechanism.coordinate, self.mechanism.metres
        for e in self._of(MechanismEffect):
            if coordinate in read:
                read[coordinate] = read[coordinate] + e.carry(series[coordinate] * metres, series, time) / metres
        seen = dict(read)
        for e in self._of(SensorEffect):
            name, scale = (e.channel, 1.0) if e.channel else (coordinate, metres)
            if name in read:
                read[name] = read[name] + e.read(seen[name] * scale, seen, time) / scale
        return read

    def traits(self, observed: tuple[str, ...]) -> frozenset[str]:
        """Words for what effects may need of a rig: see ``AbstractEffect.needs``. Recordings without a clock take that word away."""
        words = {"clock", self.drive.control, self.mechanism.coordinate, *(f"{c} observed" for c in observed)}
        words |= {"two wires"} if self.mechanism.wires == 2 else {"one wire"}
        words |= {"spring"} if hasattr(self.mechanism, "spring") else set()
        words |= {"prescribed strain or stress"} if self.mechanism.prescribed else set()
        quiet = self.mechanism.prescribed or self.mechanism.sticks or (self.mechanism.wires == 2 and self.mechanism.unknowns > 1)
        return frozenset(words if quiet else words | {"drag"})


def _stepped(state: State, value: jax.Array, push: Callable) -> State:
    """The state after one more Newton step, ``push`` being the linearised residual and state there.

    With the Jacobian held fixed its derivative is that of the implicit function.
    """
    size = value.shape[0]
    slope, per_end = jax.vmap(push, out_axes=-1)(jnp.eye(size))
    last = -newton.linear(slope, value)
    return jax.tree.map(lambda s, d: s + sum(d[..., i] * last[i] for i in range(size)), state, per_end)
