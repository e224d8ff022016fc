"""What a rig file says about the fit: which parameters are free, within which bounds, and which channels are fitted with which noise."""

import math
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, fields
from typing import Any

from smajax import parameters
from smajax.errors import InputError, nearest
from smajax.parameters import TIES, Declaration
from smajax.plant.plant import Plant
from smajax.plant.wire import Initial
from smajax.rig_schema import KINDS, FitSection, a_rig, as_text, channel_unit
from smajax.toml_file import show
from smajax.units import channel_of
from smajax.units import parse as parse_quantity

_STARTS, _FEW = 4, 10  # points that a fit begins at by default; of more parameters than a few, one for each


@dataclass(frozen=True)
class FitSettings:
    """The section ``[fit]``. ``bounds`` are in internal units by parameter name, ``noise`` in SI (K) by channel.

    ``free`` parameters have one value for all recordings, ``per_recording`` ones a value for each, whether or not they are in ``free``;
    ``initial`` are the initial states that are free: temperature, detwinned, twinned.
    """

    model: str
    free: tuple[str, ...]
    per_recording: tuple[str, ...]
    initial: tuple[str, ...]
    bounds: Mapping[str, tuple[float, float]]
    observe: tuple[str, ...]
    noise: Mapping[str, float]
    starts: int = _STARTS
    seed: int = 0

    @property
    def names(self) -> tuple[str, ...]:
        """All parameters that a fit may move, by name."""
        return tuple(dict.fromkeys([*self.free, *self.per_recording, *(f"initial.{state}" for state in self.initial)]))


def observed_channels(fit: FitSection, kind: str) -> tuple[str, ...]:
    """The channels that are fitted: those of the file, else the coordinate of this kind of rig."""
    if fit.observe is None:
        return ("stress" if kind == "testing-machine" else KINDS[kind].coordinate,)
    if not fit.observe:
        raise InputError('fit.observe is empty: name at least one channel, as in observe = ["displacement"], or leave the line out')
    refuse_twice(fit.observe, "fit.observe")
    return tuple(fit.observe)


def sensed(names: Iterable[str]) -> list[str]:
    """The channels whose sensor gain or offset is among the parameter names."""
    keys = [name.removeprefix("sensor.") for name in names if name.startswith("sensor.")]
    return [key.rpartition("_")[0] for key in keys if channel_of(key.rpartition("_")[0])]


def check_observed(observe: Sequence[str], plant: Plant, kind: str) -> None:
    """Refuses channels that this plant does not give, or that drive it."""
    possible = [channel for channel in plant.observable if channel not in plant.signals]
    for channel in observe:
        if channel in plant.signals:
            raise InputError(f"fit.observe has {channel}, which drives this {kind} rig: observe one of {', '.join(possible)}")
        if channel not in possible:
            what = f"fit.observe has '{channel}', which {a_rig(kind)} does not give"
            raise InputError(f"{what}{nearest(channel, possible)}: it gives {', '.join(possible)}")


def fit_settings(fit: FitSection, observe: tuple[str, ...], plant: Plant, inert: frozenset[str], set_bounds: Mapping) -> FitSettings:
    """The settings, checked against the plant. ``set_bounds`` hold where the rig gives none, for parameters whose value is the set's."""
    table = {name: d for name, d in parameters.declared(plant).items() if name not in inert}
    states = [f.name for f in fields(Initial) if f"initial.{f.name}" in table]
    # An initial state may stand in either list, with or without its section; it is kept in one place.
    among_free = [name.removeprefix("initial.") for name in fit.free if name.startswith("initial.")]
    initial = [name.removeprefix("initial.") for name in fit.initial] + among_free
    free = [name for name in fit.free if not name.startswith("initial.")]
    _known(free, table, "fit.free")
    _known(fit.per_recording, table, "fit.per_recording")
    for state in initial:
        if state not in states:
            what = f"fit.initial has '{state}', which is no initial state of this rig"
            raise InputError(f"{what}{nearest(state, states)}: it can be {', '.join(states)}")
    refuse_twice(initial, "fit.initial")
    _refuse_overlap([*dict.fromkeys([*free, *fit.per_recording])])
    bounds = _bounds(fit.bounds, table, plant)
    names = {*free, *fit.per_recording, *(f"initial.{state}" for state in initial)}
    bounds = {name: span for name, span in set_bounds.items() if name in names} | bounds
    noise = _noise(fit.noise, observe, plant)
    starts = fit.starts or (_STARTS if len(names) <= _FEW else len(names))
    return FitSettings(fit.model, tuple(free), tuple(fit.per_recording), tuple(initial), bounds, observe, noise, starts, fit.seed)


def refuse_twice(names: Sequence[str], place: str) -> None:
    """Refuses a list in which a name stands twice."""
    for i, name in enumerate(names):
        if name in names[:i]:
            raise InputError(f"{place} lists {name} twice: take one of them out")


def _known(names: Sequence[str], table: Mapping[str, Declaration], place: str) -> None:
    refuse_twice(names, place)
    for name in names:
        if name not in table:
            same_key = [other for other in table if other.split(".", 1)[1] == name.rpartition(".")[2]]
            near = f" (did you mean '{same_key[0]}'?)" if same_key else nearest(name, table)
            raise InputError(f"{place} has '{name}', which is no parameter of this rig{near}: name it by section and key, as in heat.h0")


def _refuse_overlap(names: Sequence[str]) -> None:
    for tie in (name for name in names if name in TIES):
        for member in TIES[tie]:
            if member in names:
                raise InputError(f"fit.free has {tie} and {member}, which it contains: keep the one or the other")


def _bounds(given: Mapping[str, Any], table: Mapping[str, Declaration], plant: Plant) -> dict[str, tuple[float, float]]:
    bounds = {}
    for name, ends in flat(given).items():
        _known([name], table, "fit.bounds")
        declaration = table[name]
        if not isinstance(ends, list) or len(ends) != 2:
            cure = 'write two quantities like ["50 W/m^2/K", "200 W/m^2/K"]'
            raise InputError(f"fit.bounds of {name} = {show(ends)} are not a pair: {cure}")
        try:
            low, high = (parse_quantity(end, declaration.unit) for end in ends)
        except InputError as error:
            raise InputError(f"fit.bounds of {name}: {error}") from None
        if not low < high:
            what = "run backwards: put the smaller one first" if low > high else "leave no room between them: move them apart"
            raise InputError(f"fit.bounds of {name}, {show(ends)}, {what}")
        for end, text in ((low, ends[0]), (high, ends[1])):
            if not declaration.lower <= end <= declaration.upper:
                limit = declaration.lower if end < declaration.lower else declaration.upper
                shown = as_text(limit, declaration.unit)
                raise InputError(f"fit.bounds of {name}: {show(text)} is beyond {shown}, where the model ends: stay within")
        for member in TIES.get(name, (name,)):
            nominal = float(parameters.get(plant, member))
            if not math.isnan(nominal) and not low <= nominal <= high:
                value = as_text(nominal, declaration.unit)
                cure = "widen them, or correct the value"
                raise InputError(f"fit.bounds of {name}, {show(ends)}, leave out its nominal value {value}: {cure}")
        bounds[name] = (low, high)
    return bounds


def _noise(given: Mapping[str, Any], observe: Sequence[str], plant: Plant) -> dict[str, float]:
    noise = {}
    for channel, text in given.items():
        if channel not in plant.observable:
            near = nearest(channel, observe) or nearest(channel, plant.observable)
            raise InputError(f"fit.noise has '{channel}', which is no channel of this rig{near}: name one of fit.observe")
        try:
            noise[channel] = parse_quantity(text, channel_unit(channel, difference=True))
        except InputError as error:
            raise InputError(f"fit.noise of {channel}: {error}") from None
        if noise[channel] <= 0:
            raise InputError(f"fit.noise of {channel} = {show(text)} is not positive: give its standard deviation, or leave it out")
    return noise


def flat(given: Mapping[str, Any]) -> dict[str, Any]:
    """``heat.h0 = [...]`` without quotation marks arrives as a table in a table: both are the same name."""
    found: dict[str, Any] = {}
    for key, value in given.items():
        found |= {f"{key}.{inner}": v for inner, v in flat(value).items()} if isinstance(value, dict) else {key: value}
    return found
