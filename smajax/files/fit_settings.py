"""The section ``[fit]`` of a rig file: free parameters with their bounds, and fitted channels with their noise."""

import math
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any, NamedTuple, Protocol

from smajax import parameters
from smajax.channels import NOISE_EXAMPLES, channel_of, channel_unit
from smajax.errors import InputError, suggestion
from smajax.files.rig_classes import rig_classes
from smajax.files.rig_kinds import rig_phrase
from smajax.files.rig_schema import FitSection
from smajax.files.toml import flatten_keys, show
from smajax.parameters import TIES
from smajax.parameters.definitions import Declaration
from smajax.units import as_text, parse_quantity

# Default number of starting points of a fit. Chosen by trial.
_STARTS = 4
# Free parameters above which there is one starting point for each; chosen by trial, tests/unit/files/test_rig_file.py
# holds it.
_MAX_PARAMETERS_OF_DEFAULT_STARTS = 10

# Words of ``input_noise`` for inputs that are exact, and for noise that is estimated.
INPUT_NOISE_NONE = "none"
INPUT_NOISE_ESTIMATED = "estimated"


@dataclass(frozen=True)
class FitSettings:
    """The section ``[fit]``, checked against the plant.

    Attributes:
        model: Name of the material law.
        free: Parameters with one value for all recordings.
        per_recording: Parameters with a value for each recording, whether or not they are in ``free``.
        initial: Initial states that are free: temperature, detwinned, twinned.
        bounds: Bounds in internal units by parameter name.
        observe: Channels that are fitted.
        noise: Standard deviations in SI (K) by channel.
        starts: Number of starting points.
        seed: Seed of the random starting points.
        input_noise: Standard deviation of the noise of the electrical inputs' meter, SI; 0 if they are exact, and
            ``None`` if it is estimated.
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
    input_noise: float | None = None

    @property
    def names(self) -> tuple[str, ...]:
        """Names of all parameters that a fit may change."""
        return tuple(dict.fromkeys([*self.free, *self.per_recording, *(f"initial.{state}" for state in self.initial)]))


class PlantChannels(Protocol):
    """Channels of a plant, or of the stages of one."""

    @property
    def observable(self) -> tuple[str, ...]:
        """Channels that it computes."""
        ...

    @property
    def signals(self) -> tuple[str, ...]:
        """Recorded channels that drive it."""
        ...


class FittedPlant(NamedTuple):
    """What the settings of a fit need of a plant.

    Attributes:
        table: Declarations of its parameters by name, without those that its kind of rig does not use.
        observable: Channels that it computes.
        control: Electrical input; empty if it has none.
        nominal: Returns the nominal value of a parameter; NaN if the plant derives it.
    """

    table: Mapping[str, Declaration]
    observable: Sequence[str]
    control: str
    nominal: Callable[[str], float]


def observed_channels(fit: FitSection, kind: str) -> tuple[str, ...]:
    """Return the channels that are fitted: those in the file, else the default of this kind of rig.

    Args:
        fit: The section of the file.
        kind: Kind of the rig; the default is its coordinate, or the stress if that is prescribed.

    Raises:
        InputError: If the list in the file is empty or has a channel twice.
    """
    if fit.observe is None:
        mechanism = rig_classes().mechanisms[kind]
        return ("stress" if mechanism.coordinate in mechanism.prescribed else mechanism.coordinate,)
    if not fit.observe:
        cure = 'name at least one channel, as in observe = ["displacement"], or leave the line out'
        raise InputError(f"fit.observe is empty: {cure}")
    refuse_duplicates(fit.observe, "fit.observe")
    return tuple(fit.observe)


def channels_of_sensors(names: Iterable[str]) -> list[str]:
    """Return the channels whose sensor gain or offset is among the parameter names."""
    keys = [name.removeprefix("sensor.") for name in names if name.startswith("sensor.")]
    return [key.rpartition("_")[0] for key in keys if channel_of(key.rpartition("_")[0])]


def check_observed(observe: Sequence[str], plant: PlantChannels, kind: str) -> None:
    """Check that the fitted channels are outputs of the plant.

    Args:
        observe: Channels that are fitted.
        plant: The plant, or its stages.
        kind: Kind of the rig, for messages.

    Raises:
        InputError: If a channel is an input of the plant, or not one of its channels.
    """
    outputs = [channel for channel in plant.observable if channel not in plant.signals]
    for channel in observe:
        if channel in plant.signals:
            problem = f"fit.observe has {channel}, which drives this {kind} rig"
            raise InputError(f"{problem}: observe one of {', '.join(outputs)}")
        if channel not in outputs:
            problem = f"fit.observe has '{channel}', which is not an output of {rig_phrase(kind)}"
            raise InputError(f"{problem}{suggestion(channel, outputs)}: its outputs are {', '.join(outputs)}")


def fit_settings(
    fit: FitSection,
    observe: tuple[str, ...],
    plant: FittedPlant,
    set_bounds: Mapping[str, tuple[float, float]],
) -> FitSettings:
    """Return the settings, checked against the plant.

    Args:
        fit: The section of the file.
        observe: Channels that are fitted.
        plant: The parameters and channels of the plant.
        set_bounds: Bounds ``(low, high)`` of the parameter set by name, used where the rig file has none.

    Raises:
        InputError: If a name, a bound or a noise is not valid for this plant.
    """
    table = plant.table
    states = [name.removeprefix("initial.") for name in table if name.startswith("initial.")]
    # An initial state may be in `free` or in `initial`, with or without its section; it is moved to `initial`.
    initial_in_free = [name.removeprefix("initial.") for name in fit.free if name.startswith("initial.")]
    initial = [name.removeprefix("initial.") for name in fit.initial] + initial_in_free
    free = [name for name in fit.free if not name.startswith("initial.")]
    _check_names(free, table, "fit.free")
    _check_names(fit.per_recording, table, "fit.per_recording")
    for state in initial:
        if state not in states:
            problem = f"fit.initial has '{state}', which is not an initial state of this rig"
            raise InputError(f"{problem}{suggestion(state, states)}: it can be {', '.join(states)}")
    refuse_duplicates(initial, "fit.initial")
    _refuse_overlap([*dict.fromkeys([*free, *fit.per_recording])])
    bounds = _read_bounds(fit.bounds, plant)
    names = {*free, *fit.per_recording, *(f"initial.{state}" for state in initial)}
    bounds = {name: span for name, span in set_bounds.items() if name in names} | bounds
    noise = _read_noise(fit.noise, observe, plant)
    starts = fit.starts or (_STARTS if len(names) <= _MAX_PARAMETERS_OF_DEFAULT_STARTS else len(names))
    input_noise = read_input_noise(fit.input_noise, plant.control, "fit.input_noise")
    return FitSettings(
        fit.model,
        tuple(free),
        tuple(fit.per_recording),
        tuple(initial),
        bounds,
        observe,
        noise,
        starts,
        fit.seed,
        input_noise,
    )


def read_input_noise(text: Any, control: str, place: str) -> float | None:
    """Read the noise of the electrical inputs' meter.

    Args:
        text: Its standard deviation as a quantity, ``none`` for exact inputs, or ``estimated``.
        control: Electrical input of the rig, which determines the unit; empty if it has none.
        place: Section and key, or argument, for messages.

    Returns:
        The standard deviation, SI; 0 for exact inputs, ``None`` if it is estimated.

    Raises:
        InputError: If it is no quantity of this unit, is not positive, or the rig has no electrical input.
    """
    if text in (INPUT_NOISE_ESTIMATED, None):
        return None
    if text == INPUT_NOISE_NONE:
        return 0.0
    if not control:
        raise InputError(f"{place} = {show(text)}, and this rig has no electrical input: leave it out")
    cure = f'give a standard deviation such as "{NOISE_EXAMPLES[control]}", "none" or "estimated"'
    try:
        deviation = parse_quantity(text, channel_unit(control))
    except InputError as error:
        raise InputError(f"{place}: {error}; or {cure}") from None
    if not 0.0 < deviation < math.inf:
        raise InputError(f"{place} = {show(text)} is not positive: {cure}")
    return deviation


def refuse_duplicates(names: Sequence[str], place: str) -> None:
    """Refuse a list that has a name twice.

    Args:
        names: The list.
        place: Its section and key, for the message.

    Raises:
        InputError: If it has one.
    """
    for i, name in enumerate(names):
        if name in names[:i]:
            raise InputError(f"{place} lists {name} twice: remove one of them")


def _check_names(names: Sequence[str], table: Mapping[str, Declaration], place: str) -> None:
    """Refuse names that are not parameters of the plant."""
    refuse_duplicates(names, place)
    for name in names:
        if name not in table:
            same_key = [other for other in table if other.split(".", 1)[1] == name.rpartition(".")[2]]
            hint = f" (did you mean '{same_key[0]}'?)" if same_key else suggestion(name, table)
            problem = f"{place} has '{name}', which is not a parameter of this rig{hint}"
            raise InputError(f"{problem}: name it by section and key, as in heat.h0")


def _refuse_overlap(names: Sequence[str]) -> None:
    """Refuse a tie together with one of its members."""
    for tie in (name for name in names if name in TIES):
        for member in TIES[tie]:
            if member in names:
                raise InputError(f"fit.free has {tie} and {member}, which it contains: keep only one of them")


def _read_bounds(bounds: Mapping[str, Any], plant: FittedPlant) -> dict[str, tuple[float, float]]:
    spans, table = {}, plant.table
    for name, ends in flatten_keys(bounds).items():
        _check_names([name], table, "fit.bounds")
        low, high = _read_span(name, ends, table[name])
        for member in parameters.expand([name]):
            nominal = plant.nominal(member)
            if not math.isnan(nominal) and not low <= nominal <= high:
                value = as_text(nominal, table[name].unit)
                problem = f"fit.bounds of {name}, {show(ends)}, exclude its nominal value {value}"
                example = as_text(0.5 * (low + high), table[name].unit)
                cure = f"widen them, or set {member} to a value within them, such as {example}"
                raise InputError(f"{problem}: {cure}")
        spans[name] = (low, high)
    return spans


def _read_span(name: str, ends: Any, declaration: Declaration) -> tuple[float, float]:
    """Return the bounds of one parameter in its internal unit."""
    if not isinstance(ends, list) or len(ends) != 2:
        cure = 'write two quantities like ["50 W/m^2/K", "200 W/m^2/K"]'
        raise InputError(f"fit.bounds of {name} = {show(ends)} are not a pair: {cure}")
    try:
        low, high = (parse_quantity(end, declaration.unit) for end in ends)
    except InputError as error:
        raise InputError(f"fit.bounds of {name}: {error}") from None
    if not low < high:
        in_reverse = "are in the wrong order: put the smaller one first"
        problem = in_reverse if low > high else "are equal: move them apart"
        raise InputError(f"fit.bounds of {name}, {show(ends)}, {problem}")
    for end, text in ((low, ends[0]), (high, ends[1])):
        if not declaration.lower <= end <= declaration.upper:
            limit = as_text(declaration.lower if end < declaration.lower else declaration.upper, declaration.unit)
            problem = f"{show(text)} is beyond {limit}, the limit of the model"
            raise InputError(f"fit.bounds of {name}: {problem}: stay within it")
    return low, high


def _read_noise(noise: Mapping[str, Any], observe: Sequence[str], plant: FittedPlant) -> dict[str, float]:
    deviations = {}
    for channel, text in noise.items():
        if channel not in plant.observable:
            hint = suggestion(channel, observe) or suggestion(channel, plant.observable)
            problem = f"fit.noise has '{channel}', which is not a channel of this rig{hint}"
            raise InputError(f"{problem}: name one of fit.observe")
        try:
            deviations[channel] = parse_quantity(text, channel_unit(channel, difference=True))
        except InputError as error:
            raise InputError(f"fit.noise of {channel}: {error}") from None
        if deviations[channel] <= 0:
            cure = "give its standard deviation, or leave it out"
            raise InputError(f"fit.noise of {channel} = {show(text)} is not positive: {cure}")
    return deviations
