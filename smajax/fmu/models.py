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
from smajax.control.document import observer_document
from smajax.control.gains import gain, gains, with_gains
from smajax.control.rollout import Loop
from smajax.control.sensing import perfect
from smajax.fmu.numpy_source import HEADER, numpy_source
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
    there has been one of both; what happens to a channel, a temperature or a power that stays away is in ``Loop``, guard and observer.
    Raises ``InputError`` for an observer that is not thermal.
    """
    if loop.observer is not None:
        observer_document(loop.observer)
    loop = dataclasses.replace(loop, sensing=perfect(), meters=None, gaps=True)
    listens = () if loop.guard is None else ("temperature",) if loop.observer is None else ("temperature", "power")
    heard = [n for c in listens for n in numbered(c, loop.allocation.wires) if n != loop.channel]
    channel, declared = _channel(loop.channel), gains(loop)
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

    def seen(inputs: Any, begun: jax.Array) -> dict[str, jax.Array]:
        """The channels; the one that is steered counts as lost until a reference is known."""
        return {loop.channel: jnp.where(begun > 0.0, inputs[1], jnp.nan)} | dict(zip(heard, inputs[2:], strict=True))

    def start(parameters: Any, inputs: Any) -> Any:
        known = jnp.isfinite(inputs[0])
        reference, begun = jnp.where(known, inputs[0], 0.0), jnp.where(known, 1.0, 0.0)
        return (changed(parameters).reset(reference, seen(inputs, begun)), jnp.zeros(loop.allocation.wires)), reference, begun

    def advance(parameters: Any, state: Any, inputs: Any, step: jax.Array) -> Any:
        (inner, _), reference, begun = state
        known = jnp.isfinite(inputs[0])
        reference, begun = jnp.where(known, inputs[0], reference), jnp.where(known, 1.0, begun)
        inner, commands = changed(parameters).step(inner, reference, seen(inputs, begun), jnp.zeros(()))
        return ((inner, commands), reference, begun), jnp.asarray(False)

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
