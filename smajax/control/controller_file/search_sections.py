"""Sections of a controller file about the search for gains: [feedforward], [tune], [limits] and [robust]."""

import math
from collections.abc import Mapping
from pathlib import Path
from typing import Any, NamedTuple

from smajax import parameters
from smajax.control.analysis.case_numbers import MIN_NOISE_CASES
from smajax.control.controller_file.recording_notes import recording_notes
from smajax.control.controller_file.renamed_keys import with_current_parameters
from smajax.control.controller_file.schema import (
    ControllerSection,
    FeedforwardSection,
    LimitsSection,
    RobustSection,
    TuneSection,
)
from smajax.control.loop.closed_loop import ClosedLoop
from smajax.control.loop.gains import gain
from smajax.control.tuning.feedforward_identification import Feedforward
from smajax.control.tuning.objective import TERMS
from smajax.errors import InputError
from smajax.files.rig_file import Rig
from smajax.files.toml import advice, quantity_at, show, validate
from smajax.files.validators import quantity
from smajax.fitting.io_models.problem import Series
from smajax.recordings.read import read_recording

# Objectives that a word names; overshoot alone is none, since a loop that does not move has none.
OBJECTIVES = (*(term for term in TERMS if term != "overshoot"), "settling")
# Weight of the effort in addition to a named objective: without it, the command follows the noise of a real sensor.
# Chosen by trial.
_DEFAULT_EFFORT_WEIGHT = {"effort": 0.01}
# Internal units of the keys of [limits].
LIMIT_UNITS = {"temperature": "degC", "current": "A", "stress": "Pa", "overshoot": "1", "settling": "s"}
# Weight of the overshoot in addition to tracking or ITAE without a limit on overshoot: without it, the error falls at
# the price of the overshoot. Chosen by trial; tests/unit/control/test_case_check.py holds it.
_DEFAULT_OVERSHOOT_WEIGHT = {"overshoot": 1.0}
_TRACKING_OBJECTIVES = ("tracking", "itae")
# Default bounds of a gain, as factors of its start value. Chosen by trial.
_MIN_FACTOR = 0.01
_MAX_FACTOR = 100.0
# Gains that are not tuned unless ``tune.free`` names them: they set the operating point, not the strength of control.
_NOT_FREE = ("tuning_point", "band")


class Robust(NamedTuple):
    """Section [robust]: samples of uncertain parameters (draws).

    Attributes:
        fit: Folder of the fit from whose intervals parameters are drawn; ``None`` for no fit.
        draws: Number of draws that the gains are tuned for.
        check: Number of draws that the gains are checked on.
        vary: Smallest and largest value of parameters that are drawn from ranges, by name, internal units.
    """

    fit: Path | None
    draws: int
    check: int
    vary: Mapping[str, tuple[float, float]]


def read_feedforward(data: Any, path: Path, rig: Rig, head: ControllerSection, units: tuple[str, str]) -> Feedforward:
    """Read [feedforward].

    Args:
        data: The section.
        path: The controller file; paths in it are relative to its folder.
        rig: The rig.
        head: The section [controller].
        units: Unit of the command, and the name of the channel.

    Raises:
        InputError: for a wrong or unsuitable key or value, or a recording that cannot be read.
    """
    section, (unit, channel) = validate(FeedforwardSection, data, "feedforward"), units
    if head.kind not in ("pid", "ppid"):
        raise InputError(
            f'[feedforward] is for kind = "pid" and "ppid": take it out, or change the kind {show(head.kind)}'
        )
    if section.recording is None:
        if section.range is None:
            return Feedforward(section.operators)
        low, high = (quantity_at(end, unit, "feedforward.range") for end in section.range)
        if not low < high:
            raise InputError("feedforward.range: the first command has to be below the second")
        return Feedforward(section.operators, (low, high))
    control = rig.plant.drive.control
    if rig.plant.mechanism.wires != 1 or section.range is not None:
        raise InputError("feedforward.recording is for a rig of one wire, and without a range: take one of them out")
    loop = read_recording(
        path.parent / section.recording,
        required=(control, channel),
        mapping=rig.channels.columns,
        ignore=rig.channels.ignore,
        options=rig.recording,
    )
    series = Series(section.recording, loop.time, loop.channels[control], loop.channels[channel])
    notes = recording_notes(loop, (control, channel), f"the feedforward is fitted to {control} and {channel}")
    return Feedforward(section.operators, measured=series, notes=notes)


def read_bounds(tune: TuneSection, loop: ClosedLoop, units: Mapping[str, str]) -> dict[str, tuple[float, float]]:
    """Return the bounds of the free gains in internal units; by default 0.01 and 100 times the start value.

    Args:
        tune: The section [tune].
        loop: The loop with its start gains.
        units: Unit of each gain by name.

    Raises:
        InputError: for an unknown gain, or bounds that are not positive or do not contain the start value.
    """
    values = {name: float(gain(loop, name)) for name in units}
    free = tune.free
    if free is None:
        free = [name for name, value in values.items() if value > 0.0 and name not in _NOT_FREE]
    for name in [*free, *tune.bounds]:
        if name not in values:
            raise InputError(f"tune: there is no gain '{name}'{advice(name, values, 'the gains are')}")
    for name in tune.bounds:
        if name not in free:
            raise InputError(f"tune.bounds.{name}: {name} is not tuned: add it to tune.free, or take its bounds out")
    bounds = {name: _bounds_of(name, tune, values[name], units[name]) for name in free}
    if not bounds:
        raise InputError("tune.free names no gain, so nothing would be tuned: name one, or take it out")
    return bounds


def _bounds_of(name: str, tune: TuneSection, start: float, unit: str) -> tuple[float, float]:
    """The bounds of one gain, which contain its start value."""
    if name in tune.bounds:
        ends = tune.bounds[name]
        if not isinstance(ends, list) or len(ends) != 2:
            raise InputError(f'tune.bounds: {name} needs two quantities: write {name} = ["...", "..."]')
        low, high = (quantity_at(end, unit, f"tune.bounds.{name}") for end in ends)
    else:
        low, high = _MIN_FACTOR * start, _MAX_FACTOR * start
    if low == high > 0.0:
        raise InputError(f"tune.bounds.{name}: both are equal: take {name} out of tune.free, or widen its bounds")
    if not 0.0 < low <= start <= high:
        raise InputError(
            f"tune: {name} starts at {start:.6g} {unit} and is to be tuned between {low:.6g} and {high:.6g}: "
            "start above 0, and give bounds above 0 that contain the start value"
        )
    return low, high


def read_objective(objective: Any, limits_overshoot: bool = False) -> tuple[dict[str, float], bool]:
    """Return the weights of the objective's terms, and whether the settling time is to be minimised.

    Args:
        objective: The key ``tune.objective``: a word, or a table of weights, which are used as they are.
        limits_overshoot: Whether the overshoot is limited, so that a word does not include its term.

    Raises:
        InputError: for an unknown term, or a weight that is negative or not finite, or if all are 0.
    """
    if isinstance(objective, str):
        if objective not in OBJECTIVES:
            names = advice(objective, OBJECTIVES, "the objectives are")
            raise InputError(f"tune.objective: '{objective}' is not known{names}")
        settling = objective == "settling"
        weights = ({"itae": 1.0} if settling else {objective: 1.0}) | _DEFAULT_EFFORT_WEIGHT
        is_bounded = objective in _TRACKING_OBJECTIVES and not limits_overshoot
        return weights | (_DEFAULT_OVERSHOOT_WEIGHT if is_bounded else {}), settling
    if not isinstance(objective, dict) or not objective:
        raise InputError(
            'tune.objective is a word or a table of weights: write it like "tracking" or { tracking = 1, energy = 0.1 }'
        )
    for name, weight in objective.items():
        if name not in TERMS:
            raise InputError(f"tune.objective: '{name}' is not a term{advice(name, TERMS, 'the terms are')}")
        if isinstance(weight, bool) or not isinstance(weight, int | float) or not 0.0 <= weight < math.inf:
            raise InputError(f"tune.objective: the weight {name} = {show(weight)} is not a number of 0 or more")
    if not any(objective.values()):
        raise InputError("tune.objective: no weight is above 0, so nothing would be minimised: give one")
    return {name: float(weight) for name, weight in objective.items()}, False


def read_check(tune: TuneSection) -> int:
    """Return the number of draws of the noise on which the gains are judged; 1 stands for the file's own rollout only.

    Args:
        tune: The section [tune].

    Raises:
        InputError: for a number above 1 that is too small for a statement on 95 % of all draws.
    """
    if 1 < tune.check < MIN_NOISE_CASES:
        raise InputError(
            f"tune.check = {tune.check} is too small to judge 95 % of all draws of the noise: "
            f"give {MIN_NOISE_CASES} or more, or 1 for the rollout of the file only"
        )
    return tune.check


def read_limits(data: Any, rest_temperature: float) -> dict[str, float]:
    """Return the limits by name in internal units.

    Args:
        data: The section [limits].
        rest_temperature: Largest temperature of the wires at rest, degC.

    Raises:
        InputError: for a wrong key or quantity, or a limit that cannot be kept.
    """
    section = validate(LimitsSection, data, "limits")
    limits = {
        key: quantity_at(value, LIMIT_UNITS[key], f"limits.{key}")
        for key, value in section.model_dump().items()
        if value is not None
    }
    if isinstance(section.overshoot, int | float) and section.overshoot > 1.0:
        raise InputError(
            f"limits.overshoot = {show(section.overshoot)} is {100.0 * section.overshoot:g} % of a step: write it with "
            f'its unit, like "{section.overshoot:g} %"'
        )
    for key, value in limits.items():
        if key != "temperature" and not (value > 0.0 or (key == "overshoot" and value == 0.0)):
            least = "0 or more" if key == "overshoot" else "one above 0"
            raise InputError(f"limits.{key} = {show(getattr(section, key))} is not possible: give {least}")
    if limits.get("temperature", math.inf) <= rest_temperature:
        raise InputError(
            f"limits.temperature = {show(section.temperature)} is not above the {rest_temperature:.6g} degC that the "
            "wire has at rest: give a higher one"
        )
    return limits


def read_robust(data: Any, path: Path, rig: Rig) -> Robust:
    """Read [robust].

    Args:
        data: The section.
        path: The controller file; paths in it are relative to its folder.
        rig: The rig.

    Raises:
        InputError: for a wrong key, an unknown parameter or an empty range, or if there is neither fit nor range.
    """
    section = validate(RobustSection, data, "robust")
    vary = {}
    for name, ends in with_current_parameters(section.vary, "robust.vary").items():
        if not isinstance(ends, list) or len(ends) != 2:
            raise InputError(f'robust.vary: {name} needs two quantities: write "{name}" = ["...", "..."]')
        try:
            declared = parameters.declaration(rig.plant, name)
            vary[name] = (quantity(ends[0], declared), quantity(ends[1], declared))
        except InputError as error:
            raise InputError(f"robust.vary: {error}") from None
        if not vary[name][0] <= vary[name][1]:
            raise InputError(f"robust.vary: the range of {name} is empty: put the smaller value first")
    if section.fit is None and not vary:
        raise InputError('[robust] has neither fit = "FOLDER" nor vary = {...}: give at least one of them')
    return Robust(None if section.fit is None else path.parent / section.fit, section.draws, section.check, vary)
