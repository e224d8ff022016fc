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
    [observer]                        # optional: the guard knows the temperature from the wire's power; or kind = "extended"
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
from smajax.control.objective import TERMS
from smajax.control.pid import PID
from smajax.control.ppid import PPID
from smajax.control.rollout import Loop, Scenario
from smajax.control.slow_loop import Feedforward
from smajax.errors import InputError
from smajax.fit.operator_problem import Series
from smajax.rig import Rig
from smajax.rig_schema import one_of, quantity
from smajax.scenario_file import read_scenario
from smajax.sensing_file import arrays, read_sensing
from smajax.toml_file import STRICT, advice, check_schema, parse, quantity_at, read_text, show, validate
from smajax.units import CHANNELS, numbered

KINDS = {"pid": PID, "bpid": BPID, "ppid": PPID, "adaptive-pid": AdaptivePID}
OBJECTIVES = (*TERMS, "settling")
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
    heard = read_sensing(data, rig, (command, difference), period, max(upper, -lower))
    loop = Loop(
        _controller(head, period, (lower, upper)),
        Allocation(*arrays(upper, 0.0), wires=driven.wires, second=jnp.asarray(-lower) if driven.wires == 2 else None),
        **heard._asdict(),
        channel=channel,
    )
    loop, units = _with_gains(loop, head.kind, data["gains"], (command, difference))
    rest = driven.read(driven.start(), jnp.zeros(driven.wires))
    scenario = read_scenario(data, path.parent, rig, (channel, unit, period), float(rest[channel]), tune.seed)
    if not scenario.changes and not np.ptp(np.append(np.asarray(scenario.reference), float(rest[channel]))) > 0.0:
        raise InputError("reference: it stays where the rig rests, so that there is nothing to follow: give it another level")
    weights, settle = _objective(tune.objective)
    limits = _limits(data.get("limits", {}), max(float(rest[n]) for n in numbered("temperature", driven.wires)))
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
    pid = PID(*arrays(0.0, 0.0, 0.0, 0.0, *output), period=period, derivative_on=cast(Any, head.derivative_on))
    if head.kind == "bpid":
        return BPID(pid)
    if head.kind == "ppid":
        return PPID(pid, *arrays(0.0, 0.0))
    if head.kind == "adaptive-pid":
        return AdaptivePID(pid, law=cast(Any, head.law))
    return pid


def _with_gains(loop: Loop, kind: str, given: Any, units: tuple[str, str]) -> tuple[Loop, dict[str, str]]:
    """The loop with its gains, and the unit of each."""
    declared = gains_of(loop)
    named = {name: unit_of(name, loop, *units) for name in declared}
    if not isinstance(given, dict):
        raise InputError("[gains] is a section, not a value: write the gains below a line [gains]")
    values = {}
    for name, value in given.items():
        if name not in declared:
            raise InputError(f"gains.{name} is not known{advice(name, declared, f'those of {kind} are')}")
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


def _limits(data: Any, warm: float) -> dict[str, float]:
    """The limits by name; ``warm`` is the temperature of the wires at rest, degC."""
    given = validate(_Limits, data, "limits")
    units = {"temperature": "degC", "current": "A", "stress": "Pa", "overshoot": "1", "settling": "s"}
    found = {k: quantity_at(v, units[k], f"limits.{k}") for k, v in given.model_dump().items() if v is not None}
    for key, value in found.items():
        if key != "temperature" and not (value > 0.0 or (key == "overshoot" and value == 0.0)):
            least = "0 or more" if key == "overshoot" else "one above 0"
            raise InputError(f"limits.{key} = {show(getattr(given, key))} is not possible: give {least}")
    if found.get("temperature", math.inf) <= warm:
        told = f"limits.temperature = {show(given.temperature)} is not above the {warm:.6g} degC that the wire has at rest"
        raise InputError(f"{told}: give a higher one")
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
