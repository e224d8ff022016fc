"""A plant and a controller as what an FMU needs: variables with units, and equations as source text of NumPy.

The plant takes the command of each wire, held over a communication step, which it divides by itself; its parameters are those of the rig,
free to be set, but for the sensors'. The controller takes reference and measurement and gives the command of each wire; its parameters are
the gains. Both use SI units, and degC. Let a co-simulation step the controller before the plant, and it does what a rollout here does.
"""

import dataclasses
import math
from collections.abc import Mapping
from typing import Any, Literal, NamedTuple

import jax
import jax.numpy as jnp

from smajax import parameters
from smajax.control.gains import gain, gains, with_gains
from smajax.control.guard import BLIND
from smajax.control.observers import ThermalObserver
from smajax.control.rollout import Loop
from smajax.control.sensing import perfect
from smajax.fmu.numpy_source import HEADER, numpy_source
from smajax.kinks import within
from smajax.plant.plant import Plant
from smajax.simulate import default_step
from smajax.units import CHANNELS, channel_of, numbered

_ELECTRICAL = ("current", "voltage", "power")


class Variable(NamedTuple):
    """A variable of an FMU; ``direct`` outputs follow the inputs within an instant."""

    name: str
    causality: Literal["input", "output", "parameter"]
    variability: Literal["continuous", "discrete", "tunable", "fixed"]
    unit: str
    meaning: str
    start: float | None = None
    lower: float = -math.inf
    upper: float = math.inf
    direct: bool = False


class Model(NamedTuple):
    """What is packed into an FMU: ``equations`` is source text of ``start``, ``advance`` and ``outputs``.

    ``timing`` is ``{"longest": s}`` for a plant that goes on by steps no longer than that, and ``{"period": s}`` for a controller.
    """

    name: str
    kind: Literal["plant", "controller"]
    meaning: str
    variables: tuple[Variable, ...]
    equations: str
    timing: Mapping[str, float]


def plant_model(plant: Plant, name: str, step: float | None = None) -> Model:
    """The model of a plant, with steps no longer than ``step`` s (default: ``simulate.default_step``).

    Raises ``InputError`` if an effect of the plant has no text in NumPy.
    """
    declared = parameters.declared(plant)
    values = {n: float(parameters.get(plant, n)) for n in declared if n not in parameters.TIES and not n.startswith("sensor.")}
    values = {n: v for n, v in values.items() if not math.isnan(v)}
    variables = [_signal(plant, i) for i in range(len(plant.signals))]
    variables += [
        Variable(n, "output", "continuous", _channel(n).unit, _channel(n).description, direct=_follows(plant, n)) for n in plant.observable
    ]
    variables += [
        Variable(n, "parameter", "fixed" if n.startswith("initial.") else "tunable", d.unit, d.meaning, values[n], d.lower, d.upper)
        for n, d in declared.items()
        if n in values
    ]

    def changed(given: Any) -> Plant:
        return parameters.replace(plant, dict(zip(values, given, strict=True)))

    def start(parameters: Any, inputs: Any) -> Any:
        return changed(parameters).start(_row(inputs))

    def advance(parameters: Any, state: Any, inputs: Any, step: jax.Array) -> Any:
        return changed(parameters).advance(state, _row(inputs), _row(inputs), step)

    def outputs(parameters: Any, state: Any, inputs: Any) -> Any:
        seen = changed(parameters).outputs(state, _row(inputs))
        return [seen[n] for n in plant.observable]

    equations = _equations(start, advance, outputs, list(values.values()), len(plant.signals))
    return Model(name, "plant", f"the plant {name}", tuple(variables), equations, {"longest": step or default_step(plant)})


def controller_model(loop: Loop, units: tuple[str, str], gain_units: Mapping[str, str], name: str) -> Model:
    """The model of a controller with its allocation and its guard; ``units`` are those of command and channel.

    What the loop's sensor and meters do to a measurement is the world's and is left out. A guard listens to ``temperature`` too, and with
    an observer to ``power``. What is measured or wanted and is no number is taken for the last one that was, and the loop begins when
    there has been one; a thermal observer goes without a thermocouple that tells no number. A guard does not heat a wire whose temperature,
    or power where an observer needs that, has been no number for ``BLIND`` seconds.
    """
    loop = dataclasses.replace(loop, sensing=perfect(), meters=None)
    listens = () if loop.guard is None else ("temperature",) if loop.observer is None else ("temperature", "power")
    heard = [n for c in listens for n in numbered(c, loop.allocation.wires) if n != loop.channel]
    channel, declared = _channel(loop.channel), gains(loop)
    told = ["reference", loop.channel, *heard]
    eyes = [told.index(n) for n in numbered(listens[-1], loop.allocation.wires)] if listens else []
    thermal = isinstance(loop.observer, ThermalObserver)
    probes = [thermal and _kind(n) == "temperature" for n in told]
    at_first = [float(loop.observer.ambient) if probe and isinstance(loop.observer, ThermalObserver) else 0.0 for probe in probes]
    variables = [
        Variable("reference", "input", "discrete", units[1], f"what is wanted of: {channel.description}", 0.0),
        Variable("measurement", "input", "discrete", units[1], f"what is measured of: {channel.description}", 0.0),
        *(Variable(n, "input", "discrete", _channel(n).unit, _channel(n).description, 20.0 * (_kind(n) == "temperature")) for n in heard),
        *(Variable(n, "output", "discrete", units[0], "command of the wire") for n in numbered("command", loop.allocation.wires)),
    ]
    values = {n: float(gain(loop, n)) for n in declared}
    variables += [Variable(n, "parameter", "tunable", gain_units[n], d.meaning, values[n], d.lower, d.upper) for n, d in declared.items()]

    def changed(given: Any) -> Loop:
        return with_gains(loop, dict(zip(values, given, strict=True)))

    def seen(inputs: Any) -> dict[str, jax.Array]:
        return {loop.channel: inputs[1]} | dict(zip(heard, inputs[2:], strict=True))

    def kept(inputs: Any, known: Any) -> Any:
        return [jnp.where(jnp.isfinite(now), now, last) for now, last in zip(inputs, known, strict=True)]

    def begins(inputs: Any) -> jax.Array:
        return jnp.where(jnp.isfinite(inputs[0]) & jnp.isfinite(inputs[1]), 1.0, 0.0)

    def start(parameters: Any, inputs: Any) -> Any:
        known = kept(inputs, at_first)
        blind = [jnp.where(jnp.isfinite(inputs[i]), 0.0, BLIND) for i in eyes]
        return (changed(parameters).reset(known[0], seen(known)), jnp.zeros(loop.allocation.wires)), known, blind, begins(inputs)

    def advance(parameters: Any, state: Any, inputs: Any, step: jax.Array) -> Any:
        (inner, _), known, blind, begun = state
        steered, pid = changed(parameters), loop.controller.inner
        known = kept(inputs, known)
        blind = [jnp.where(jnp.isfinite(inputs[i]), 0.0, for_so_long + step) for i, for_so_long in zip(eyes, blind, strict=True)]
        inner = jax.tree.map(lambda a, b: jnp.where(begun > 0.0, a, b), inner, steered.reset(known[0], seen(known)))
        begun = jnp.where(begun > 0.0, begun, begins(inputs))
        told = [jnp.where(jnp.isfinite(now), now, jnp.nan) if probe else v for now, v, probe in zip(inputs, known, probes, strict=True)]
        inner, commands = steered.step(inner, known[0], seen(told), jnp.zeros(()))
        commands = jnp.where(begun > 0.0, commands, steered.allocation(within(jnp.zeros(()), pid.lower, pid.upper)))
        if eyes:
            commands = jnp.where(jnp.stack(blind) >= BLIND, jnp.minimum(commands, 0.0), commands)
        return ((inner, commands), known, blind, begun), jnp.asarray(False)

    def outputs(parameters: Any, state: Any, inputs: Any) -> Any:
        return [state[0][1][i] for i in range(loop.allocation.wires)]

    equations = _equations(start, advance, outputs, list(values.values()), 2 + len(heard))
    meaning = f"a controller of {loop.channel}"
    return Model(name, "controller", meaning, tuple(variables), equations, {"period": loop.controller.inner.period})


def _equations(start: Any, advance: Any, outputs: Any, values: list[float], inputs: int) -> str:
    number = jax.ShapeDtypeStruct((), jnp.float64)
    given = {"parameters": [number] * len(values), "inputs": [number] * inputs}
    state = {"state": jax.eval_shape(start, *given.values())}
    first, last = {"parameters": given["parameters"]} | state, {"inputs": given["inputs"]}
    parts = (
        numpy_source("start", start, given),
        numpy_source("advance", advance, first | last | {"step": number}),
        numpy_source("outputs", outputs, first | last),
    )
    return "\n\n".join((HEADER, *parts))


def _signal(plant: Plant, place: int) -> Variable:
    """The input behind a signal: a command, or what is prescribed."""
    name, wires = plant.signals[place], plant.mechanism.wires
    told = _channel(name)
    if plant.drive.control and place < wires:
        return Variable(numbered("command", wires)[place], "input", "continuous", told.unit, f"commanded {told.description}", 0.0)
    rest = float(plant.environment.ambient) if _kind(name) == "temperature" else 0.0
    return Variable(f"prescribed.{name}", "input", "continuous", told.unit, told.description, rest)


def _follows(plant: Plant, name: str) -> bool:
    return _kind(name) in _ELECTRICAL or bool(plant.mechanism.prescribed) or not plant.drive.control


def _row(inputs: Any) -> jax.Array:
    return jnp.stack(inputs) if inputs else jnp.zeros(0)


def _kind(name: str) -> str:
    return channel_of(name) or name


def _channel(name: str) -> Any:
    return CHANNELS[_kind(name)]
