"""controller.toml: which controller steers which channel, what it should do there, and what is tuned.

    [controller]
    kind = "pid"                      # pid, bpid, ppid, adaptive-pid
    period = "20 ms"
    output = ["0 A", "0.5 A"]         # limits of the command
    [gains]                           # where the search starts
    kp = "30 A/m"
    [feedforward]                     # optional: the inverse of an operator that is fitted to a slow loop
    operators = 10
    [reference]
    kind = "staircase"                # step, staircase, sine, recorded
    ...
    [tune]
    objective = "tracking"            # tracking, itae, settling, or weights of several
    [limits]
    temperature = "110 degC"
    [guard]                           # optional: what keeps the wire below a temperature whatever the controller wants
    limit = "115 degC"
    kp = "0.05 A/K"
    [observer]                        # optional: the guard knows the temperature from the wire's power
    trust = "0.2 1/s"                 # and corrects it by a thermocouple
    [meters]                          # optional: what guard and observer hear
    temperature = { noise = "0.5 K", lag = "1 s" }

Quantities carry units; the gains' follow from the drive and the channel. Every mistake is one sentence that names file and key.
"""

import math
from collections.abc import Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Annotated, Any, NamedTuple, cast

import jax.numpy as jnp
import numpy as np
from pydantic import BaseModel, Field

from smajax import parameters, recording
from smajax.control import metrics
from smajax.control.adaptive import AdaptivePID
from smajax.control.allocation import Allocation
from smajax.control.bpid import BPID
from smajax.control.controller import AbstractController
from smajax.control.driven import DrivenPlant
from smajax.control.gains import gain, unit_of, with_gains
from smajax.control.gains import gains as gains_of
from smajax.control.guard import TemperatureGuard
from smajax.control.meters import Meters
from smajax.control.objective import TERMS
from smajax.control.observers import ThermalObserver
from smajax.control.pid import PID
from smajax.control.ppid import PPID
from smajax.control.rollout import Loop, Scenario
from smajax.control.sensing import Sensing
from smajax.control.slow_loop import Feedforward
from smajax.errors import InputError
from smajax.fit.operator_problem import Series
from smajax.rig import Rig
from smajax.rig_schema import as_text, one_of, quantity
from smajax.scenario_file import read_scenario
from smajax.toml_file import STRICT, advice, check_schema, parse, quantity_at, read_text, show, validate
from smajax.units import CHANNELS

KINDS = {"pid": PID, "bpid": BPID, "ppid": PPID, "adaptive-pid": AdaptivePID}
OBJECTIVES = (*TERMS, "settling")
_LATEST = 10_000  # periods of delay
# What counts beside the objective unless weights are given: a real sensor would punish gains that shake the wire.
_CALM = {"effort": 0.01}
_SECTIONS = (
    "schema", "controller", "gains", "feedforward", "reference", "tune", "limits", "sensor", "guard", "observer", "meters", "robust",
    "change",
)  # fmt: skip


class _Controller(BaseModel):
    model_config = STRICT
    kind: Annotated[str, one_of(KINDS)] = "pid"
    period: str = Field(examples=['"20 ms"'])
    output: list[Any] = Field(min_length=2, max_length=2, examples=['["0 A", "0.5 A"]'])
    channel: str | None = Field(None, examples=['"displacement"'])
    derivative_on: Annotated[str, one_of(("error", "value"))] = "error"
    law: Annotated[str, one_of(("gradient", "printed"))] = "gradient"
    carrier: Any = Field(None, examples=['"100 Hz"'])


class _Feedforward(BaseModel):
    model_config = STRICT
    operators: int = Field(10, ge=1, le=100, examples=["10"])
    range: list[Any] | None = Field(None, min_length=2, max_length=2, examples=['["0.1 A", "0.35 A"]'])
    recording: str | None = Field(None, examples=['"slow.csv"'])


class _Tune(BaseModel):
    model_config = STRICT
    free: list[str] | None = Field(None, examples=['["kp", "ki"]'])
    objective: Any = Field("tracking", examples=['"tracking"'])
    bounds: dict[str, Any] = Field({}, examples=['{ kp = ["1 A/m", "500 A/m"] }'])
    starts: int = Field(4, ge=1, le=1000, examples=["4"])
    seed: int = Field(0, ge=0, le=2**32 - 1, examples=["0"])
    band: Any = Field("2 %", examples=['"2 %"'])


class _Limits(BaseModel):
    model_config = STRICT
    temperature: Any = Field(None, examples=['"110 degC"'])
    current: Any = Field(None, examples=['"0.4 A"'])
    stress: Any = Field(None, examples=['"200 MPa"'])
    overshoot: Any = Field(None, examples=['"2 %"'])
    settling: Any = Field(None, examples=['"5 s"'])


class _Sensor(BaseModel):
    model_config = STRICT
    noise: Any = Field(None, examples=['"0.01 mm"'])
    quantum: Any = Field(None, examples=['"0.005 mm"'])
    delay: Any = Field(None, examples=['"20 ms"'])


class _Guard(BaseModel):
    model_config = STRICT
    limit: Any = Field(examples=['"110 degC"'])
    kp: Any = Field(examples=['"0.05 A/K"'])
    ki: Any = Field(None, examples=['"0.01 A/K/s"'])


class _Observer(BaseModel):
    model_config = STRICT
    a1: Any = Field(None, examples=['"12 K/J"'])
    a2: Any = Field(None, examples=['"-0.8 1/s"'])
    exponent: int = Field(1, ge=1, le=6, examples=["2"])
    trust: Any = Field(None, examples=['"0.2 1/s"'])


class _Thermocouple(_Sensor):
    lag: Any = Field(None, examples=['"1 s"'])


class _Meters(BaseModel):
    model_config = STRICT
    voltage: Any = Field(None, examples=['{ noise = "10 mV", quantum = "5 mV" }'])
    current: Any = Field(None, examples=['{ noise = "2 mA", delay = "20 ms" }'])
    temperature: Any = Field(None, examples=['{ noise = "0.5 K", lag = "1 s" }'])


class _Robust(BaseModel):
    model_config = STRICT
    fit: str | None = Field(None, examples=['"result"'])
    draws: int = Field(8, ge=1, le=4096, examples=["8"])
    check: int = Field(64, ge=1, le=100_000, examples=["500"])
    vary: dict[str, Any] = Field({}, examples=['{ "environment.ambient" = ["15 degC", "30 degC"] }'])


class Robust(NamedTuple):
    """Draws to tune for and to check on, from the fit in a folder (``None``: no fit) and from ranges of parameters (internal units)."""

    fit: Path | None
    draws: int
    check: int
    vary: Mapping[str, tuple[float, float]]


@dataclass(frozen=True, eq=False)
class ControllerFile:
    """What a controller file says, in internal units; ``bounds`` name the free gains, ``weights`` are of the objective's terms."""

    name: str
    driven: DrivenPlant
    loop: Loop
    scenario: Scenario
    units: Mapping[str, str]
    bounds: Mapping[str, tuple[float, float]]
    weights: Mapping[str, float]
    settle: bool
    limits: Mapping[str, float]
    feedforward: Feedforward | None
    band: float
    starts: int
    seed: int
    robust: Robust | None


def read_controller(path: Path, rig: Rig) -> ControllerFile:
    """Reads and checks a controller file for a rig. InputError: one sentence with file, section and key, and the cure."""
    data = parse(read_text(path, "controller"), str(path))
    try:
        return _read(data, path, rig)
    except InputError as error:
        raise InputError(f"{path}: {error}") from None


def _read(data: Mapping[str, Any], path: Path, rig: Rig) -> ControllerFile:
    for key in data:
        if key not in _SECTIONS:
            raise InputError(f"[{key}] is not a section of a controller{advice(key, _SECTIONS[1:], 'the sections are')}")
    check_schema(data)
    for needed, example in (("controller", 'kind = "pid"'), ("gains", 'kp = "..."'), ("reference", 'kind = "step"')):
        if needed not in data:
            raise InputError(f"the section [{needed}] is missing: add it, with lines like {example}")
    head = validate(_Controller, data["controller"], "controller")
    tune = validate(_Tune, data.get("tune", {}), "tune")
    plant, period = rig.plant, quantity_at(head.period, "s", "controller.period", least=1e-6)
    channel = head.channel or plant.mechanism.coordinate
    if channel not in plant.observable or channel not in CHANNELS:
        known = [c for c in plant.observable if c in CHANNELS]
        raise InputError(f"controller.channel: '{channel}' cannot be steered here{advice(channel, known, 'the channels are')}")
    carrier = None if head.carrier is None else quantity_at(head.carrier, "Hz", "controller.carrier", least=1e-3)
    try:
        driven = DrivenPlant.of(plant, period, carrier=carrier)
    except InputError as error:
        raise InputError(f"controller{'.carrier' if carrier else ''}: {error}") from None
    command, unit = CHANNELS[plant.drive.control].unit, CHANNELS[channel].unit
    difference = "K" if unit == "degC" else unit
    lower, upper = (quantity_at(v, command, "controller.output") for v in head.output)
    if plant.drive.control == "duty" and max(-lower, upper) > 1.0:
        raise InputError(
            f"controller.output: a duty is a share of the supply, and {show(head.output[1])} is beyond 1: write 0 to 1, or '0 %' to '100 %'"
        )
    if not lower < upper:
        raise InputError("controller.output: the first limit has to be below the second")
    if driven.wires == 1 and lower < 0.0:
        raise InputError(f"controller.output: a wire cannot be cooled by its drive: make the least output {show('0 ' + command)} or more")
    if driven.wires == 2 and not lower < 0.0 < upper:
        raise InputError(
            "controller.output: above 0 it heats the first wire, below 0 the second: give a least output below 0 and one above"
        )
    if head.kind != "adaptive-pid" and "law" in data["controller"]:
        raise InputError('controller.law belongs to kind = "adaptive-pid": take it out, or change the kind')
    guard = None
    if "guard" in data:
        given = validate(_Guard, data["guard"], "guard")
        kp, ki = (_positive(v, f"{command}/K{over}", f"guard.{k}") for v, k, over in ((given.kp, "kp", ""), (given.ki, "ki", "/s")))
        if not kp + ki > 0.0:
            raise InputError("guard.kp and guard.ki are 0, so that the guard would never let a command through: give guard.kp a value")
        guard = TemperatureGuard(PID(*_arrays(kp, ki, 0.0, 0.0, 0.0, max(upper, -lower)), period=period), jnp.asarray(
            quantity_at(given.limit, "degC", "guard.limit", least=float(plant.environment.ambient))
        ))  # fmt: skip
    observer = _observer(data["observer"], rig, guard, period) if "observer" in data else None
    loop = Loop(
        _controller(head, period, (lower, upper)),
        Allocation(*_arrays(upper, 0.0), wires=driven.wires, second=jnp.asarray(-lower) if driven.wires == 2 else None),
        _sensing(validate(_Sensor, data.get("sensor", {}), "sensor"), difference, period, "sensor"),
        guard,
        observer,
        _meters(data["meters"], guard, observer, period) if "meters" in data else None,
        channel=channel,
    )
    loop, units = _with_gains(loop, head.kind, data["gains"], (command, difference))
    rest = float(driven.read(driven.start(), jnp.zeros(driven.wires))[channel])
    scenario = read_scenario(data, path.parent, rig, (channel, unit, period), rest, tune.seed)
    weights, settle = _objective(tune.objective)
    limits = _limits(data.get("limits", {}))
    if not metrics.jumps(np.asarray(scenario.reference), float(scenario.before), period).rows:
        if settle:
            raise InputError("tune.objective: the reference never jumps and holds, so that nothing settles: ask for tracking instead")
        if idle := [k for k in ("overshoot", "settling") if k in limits]:
            raise InputError(f"limits.{idle[0]}: the reference never jumps and holds, so that there is nothing to limit: take it out")
    return ControllerFile(
        name=path.name,
        driven=driven,
        loop=loop,
        scenario=scenario,
        units=units,
        bounds=_bounds(tune, loop, units),
        weights=weights,
        settle=settle,
        limits=limits,
        feedforward=_feedforward(data["feedforward"], path, rig, (head, command, channel)) if "feedforward" in data else None,
        band=quantity_at(tune.band, "1", "tune.band", least=1e-4),
        starts=tune.starts,
        seed=tune.seed,
        robust=_robust(data["robust"], path, rig) if "robust" in data else None,
    )


def _controller(head: _Controller, period: float, output: tuple[float, float]) -> AbstractController:
    """The controller, its gains still 0."""
    pid = PID(*_arrays(0.0, 0.0, 0.0, 0.0, *output), period=period, derivative_on=cast(Any, head.derivative_on))
    if head.kind == "bpid":
        return BPID(pid)
    if head.kind == "ppid":
        return PPID(pid, *_arrays(0.0, 0.0))
    if head.kind == "adaptive-pid":
        return AdaptivePID(pid, law=cast(Any, head.law))
    return pid


def _sensing(given: _Sensor, unit: str, period: float, place: str) -> Sensing:
    """A sensor's noise, steps and delay; ``unit`` is that of the first two."""
    noise, quantum = (_positive(v, unit, f"{place}.{k}") for k, v in (("noise", given.noise), ("quantum", given.quantum)))
    wait = _positive(given.delay, "s", f"{place}.delay") / period
    if wait > _LATEST:
        raise InputError(f"{place}.delay = {show(given.delay)} is too long: give {_LATEST * period:g} s or less")
    if abs(wait - round(wait)) > 1e-6 * max(wait, 1.0):
        ends = [as_text(period * n, "s") for n in (math.floor(wait), math.ceil(wait))]
        raise InputError(f"{place}.delay = {show(given.delay)} is not a whole number of controller.period: give {ends[0]} or {ends[1]}")
    return Sensing(jnp.asarray(noise), jnp.asarray(quantum), round(wait))


def _observer(data: Any, rig: Rig, guard: TemperatureGuard | None, period: float) -> ThermalObserver:
    """What tells the guard the temperature; what is not given is what the rig's convection and capacity say at the guard's limit."""
    given = validate(_Observer, data, "observer")
    if guard is None:
        raise InputError(
            "[observer] tells a guard the wire's temperature, and there is none: add a section [guard], or take [observer] out"
        )
    if (given.a1 is None) != (given.a2 is None):
        raise InputError(f"observer.{'a1' if given.a1 is None else 'a2'} is missing: give both a1 and a2, or neither for those of the rig")
    own = ThermalObserver.of(rig.plant, float(guard.limit), period, _positive(given.trust, "1/s", "observer.trust"))
    if given.a1 is None:
        if given.exponent != 1:
            raise InputError(f"observer.exponent = {show(given.exponent)} goes with an a1 and an a2 of its own: give both, or take it out")
        return _steady(own, guard, given)
    a1 = quantity_at(given.a1, "K/J", "observer.a1")
    if not a1 > 0.0:
        raise InputError(f"observer.a1 = {show(given.a1)} would not warm a wire by its power: give one above 0")
    a2 = quantity_at(given.a2, "1/s" if given.exponent == 1 else f"K^{1 - given.exponent}/s", "observer.a2")
    if not a2 < 0.0:
        raise InputError(f"observer.a2 = {show(given.a2)} would warm the wire without power: give one below 0")
    return _steady(replace(own, **dict(zip(("a1", "a2", "exponent"), _arrays(a1, a2, given.exponent), strict=True))), guard, given)


def _steady(observer: ThermalObserver, guard: TemperatureGuard, given: _Observer) -> ThermalObserver:
    """The observer, if at the guard's limit it forgets no more than all within a period."""
    excess, exponent = float(guard.limit - observer.ambient), float(observer.exponent)
    loses, trusts = -exponent * float(observer.a2) * excess ** (exponent - 1.0), float(observer.gain)
    if observer.period * (loses + trusts) > 1.0:
        key = "trust" if trusts > loses else "a2"
        what = f"observer.{key} = {show(getattr(given, key))}" if getattr(given, key) is not None else "the rig, as [observer] has it,"
        most = as_text(1.0 / (loses + trusts), "s")
        raise InputError(f"{what} acts faster than controller.period: give a smaller one, or a period of at most {most}")
    return observer


def _meters(data: Any, guard: TemperatureGuard | None, observer: ThermalObserver | None, period: float) -> Meters:
    given = validate(_Meters, data, "meters")
    if guard is None:
        raise InputError("[meters] are what a guard and its observer hear, and there is none: add a section [guard], or take [meters] out")
    each, lag = {}, 0.0
    for kind, unit in (("voltage", "V"), ("current", "A"), ("temperature", "K")):
        told = getattr(given, kind)
        if told is None:
            continue
        if kind != "temperature" and observer is None:
            raise InputError(f"meters.{kind}: nothing hears it without an observer: add a section [observer], or take it out")
        if kind == "temperature" and observer is not None and not float(observer.gain) > 0.0:
            raise InputError("meters.temperature: the observer trusts no thermocouple: give observer.trust a value, or take it out")
        one = validate(_Thermocouple if kind == "temperature" else _Sensor, told, f"meters.{kind}")
        each[kind] = _sensing(one, unit, period, f"meters.{kind}")
        if isinstance(one, _Thermocouple):
            lag = _positive(one.lag, "s", "meters.temperature.lag")
    if not each:
        raise InputError('[meters] names none: add a line like temperature = { noise = "0.5 K", lag = "1 s" }, or take the section out')
    return Meters(each, period, *_arrays(lag))


def _with_gains(loop: Loop, kind: str, given: Any, units: tuple[str, str]) -> tuple[Loop, dict[str, str]]:
    """The loop with its gains, and the unit of each."""
    declared = gains_of(loop)
    named = {name: unit_of(name, loop, *units) for name in declared}
    if not isinstance(given, dict):
        raise InputError("[gains] is a section, not a value: write the gains below a line [gains]")
    values = {}
    for name, value in given.items():
        if name not in declared:
            raise InputError(f"gains.{name} is not known{advice(name, declared, f'the gains of a {kind} are')}")
        try:
            values[name] = quantity(value, replace(declared[name], unit=named[name]))
        except InputError as error:
            raise InputError(f"gains.{name}: {error}") from None
    if not any(values.get(name) for name in gains_of(loop.controller)):
        raise InputError(f"[gains] holds no gain above 0: give at least kp, in {named['kp']}")
    return with_gains(loop, values), named


def _feedforward(data: Any, path: Path, rig: Rig, around: tuple[_Controller, str, str]) -> Feedforward:
    given, (head, unit, channel) = validate(_Feedforward, data, "feedforward"), around
    if head.kind not in ("pid", "ppid"):
        raise InputError(f'[feedforward] is for kind = "pid" and "ppid": take it out, or change the kind {show(head.kind)}')
    if given.recording is None:
        if given.range is None:
            return Feedforward(given.operators)
        low, high = (quantity_at(v, unit, "feedforward.range") for v in given.range)
        if not low < high:
            raise InputError("feedforward.range: the first command has to be below the second")
        return Feedforward(given.operators, (low, high))
    control = rig.plant.drive.control
    if rig.plant.mechanism.wires != 1 or given.range is not None:
        raise InputError("feedforward.recording is for a rig of one wire, and without a range: take one of them out")
    loop = recording.read(path.parent / given.recording, required=(control, channel), mapping=rig.channels.columns)
    series = Series(given.recording, loop.time, loop.channels[control], loop.channels[channel])
    return Feedforward(given.operators, measured=series)


def _bounds(tune: _Tune, loop: Loop, units: Mapping[str, str]) -> dict[str, tuple[float, float]]:
    """The free gains and their ends: where none are given, a hundredth and a hundred times the start value."""
    values = {name: float(gain(loop, name)) for name in units}
    free = tune.free if tune.free is not None else [n for n, v in values.items() if v > 0.0 and n not in ("tuning_point", "band")]
    for name in [*free, *tune.bounds]:
        if name not in values:
            raise InputError(f"tune: there is no gain '{name}'{advice(name, values, 'the gains are')}")
    if held := [name for name in tune.bounds if name not in free]:
        raise InputError(f"tune.bounds.{held[0]}: {held[0]} is not tuned: add it to tune.free, or take its bounds out")
    ends = {}
    for name in free:
        if name in tune.bounds:
            given = tune.bounds[name]
            if not isinstance(given, list) or len(given) != 2:
                raise InputError(f'tune.bounds: {name} needs two quantities: write {name} = ["...", "..."]')
            low, high = (quantity_at(v, units[name], f"tune.bounds.{name}") for v in given)
        else:
            low, high = 0.01 * values[name], 100.0 * values[name]
        if low == high > 0.0:
            raise InputError(f"tune.bounds.{name} leaves it no room: take {name} out of tune.free, or widen its bounds")
        if not 0.0 < low <= values[name] <= high:
            raise InputError(
                f"tune: {name} starts at {values[name]:.6g} {units[name]} and is to be tuned between {low:.6g} and {high:.6g}: "
                "start above 0, and give bounds above 0 that hold the start value"
            )
        ends[name] = (low, high)
    if not ends:
        raise InputError("tune.free names no gain: nothing would be tuned")
    return ends


def _objective(given: Any) -> tuple[dict[str, float], bool]:
    if isinstance(given, str):
        if given not in OBJECTIVES:
            raise InputError(f"tune.objective: '{given}' is not known{advice(given, OBJECTIVES, 'the objectives are')}")
        return ({"itae": 1.0} if given == "settling" else {given: 1.0}) | _CALM, given == "settling"
    if not isinstance(given, dict) or not given:
        raise InputError('tune.objective is a word or a table of weights: write it like "tracking" or { tracking = 1, energy = 0.1 }')
    for name, weight in given.items():
        if name not in TERMS:
            raise InputError(f"tune.objective: '{name}' cannot be weighed{advice(name, TERMS, 'what can be are')}")
        if isinstance(weight, bool) or not isinstance(weight, int | float) or not 0.0 <= weight < math.inf:
            raise InputError(f"tune.objective: the weight {name} = {show(weight)} is not a number of 0 or more")
    if not any(given.values()):
        raise InputError("tune.objective: no weight is above 0, so that nothing is wanted: give one")
    return {name: float(w) for name, w in given.items()}, False


def _limits(data: Any) -> dict[str, float]:
    given = validate(_Limits, data, "limits")
    units = {"temperature": "degC", "current": "A", "stress": "Pa", "overshoot": "1", "settling": "s"}
    found = {k: quantity_at(v, units[k], f"limits.{k}") for k, v in given.model_dump().items() if v is not None}
    for key, value in found.items():
        if key != "temperature" and not (value > 0.0 or (key == "overshoot" and value == 0.0)):
            least = "0 or more" if key == "overshoot" else "one above 0"
            raise InputError(f"limits.{key} = {show(getattr(given, key))} is not possible: give {least}")
    return found


def _robust(data: Any, path: Path, rig: Rig) -> Robust:
    given = validate(_Robust, data, "robust")
    vary = {}
    for name, ends in given.vary.items():
        if not isinstance(ends, list) or len(ends) != 2:
            raise InputError(f'robust.vary: {name} needs two quantities: write "{name}" = ["...", "..."]')
        try:
            declared = parameters.declaration(rig.plant, name)
            vary[name] = (quantity(ends[0], declared), quantity(ends[1], declared))
        except InputError as error:
            raise InputError(f"robust.vary: {error}") from None
        if not vary[name][0] <= vary[name][1]:
            raise InputError(f"robust.vary: the range of {name} is empty: put the smaller value first")
    if given.fit is None and not vary:
        raise InputError('[robust] says neither fit = "FOLDER" nor vary = {...}: name what may be different')
    return Robust(None if given.fit is None else path.parent / given.fit, given.draws, given.check, vary)


def _arrays(*values: float) -> tuple[Any, ...]:
    return tuple(jnp.asarray(v, jnp.float64) for v in values)


def _positive(value: Any, unit: str, place: str) -> float:
    return 0.0 if value is None else quantity_at(value, unit, place, least=0.0)
