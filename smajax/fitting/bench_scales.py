"""Whether the clock or the electrical input of a recording has a scale with which the rig cannot do what it did."""

import dataclasses
from collections.abc import Collection, Sequence
from typing import NamedTuple

import numpy as np

from smajax.channels import channel_of, channel_unit, numbered
from smajax.fitting.bench_responses import MECHANICAL, SETTLED, BenchResponse, grid_of, response_to
from smajax.fitting.noise import difference_noise
from smajax.plant.plant import Plant
from smajax.recordings.recording import Recording
from smajax.simulation.step_size import wire_time_constant
from smajax.units import from_si

# Thresholds without a stated reason were chosen by trial (tests/unit/fitting/test_bench_checks.py).
# degC. Nickel-titanium is given its shape above this temperature, at which no actuator works.
_HOTTEST = 400.0
# Share of the way from the ambient to the start of austenite below which nothing is heated.
_COLD = 0.25
# Range of a channel in standard deviations of its noise from which it moves.
_MOVES = 20.0
# Least correlation of a recording with the rig at another scale.
_FITS = 0.6
# Share of the variance that the present scale leaves, over that of another one, from which the other one is right.
_BETTER = 2.5
_TIME_FACTORS = (1e-6, 1e-3, 1.0 / 60.0, 60.0, 1e3, 1e6)
# Correlation below which clocks in minutes and in s are tried for one another, and from which one is right.
_POOR, _GOOD = 0.8, 0.9
_INPUT_FACTORS = (0.1, 1e-3, 10.0, 1e3)
_WORDS = {
    1e-6: "a millionth",
    1e-3: "a thousandth",
    1.0 / 60.0: "a sixtieth",
    0.1: "a tenth",
    10.0: "ten times",
    60.0: "sixty times",
    1e3: "a thousand times",
    1e6: "a million times",
}


class ScaleDoubt(NamedTuple):
    """A clock or an input with a doubtful scale: code ``clock`` or ``input``, channel, text and remedy."""

    code: str
    channel: str
    text: str
    remedy: str


class _Scale(NamedTuple):
    """Another scale: of the clock or of the electrical inputs, its factor, and the correlation that it gives."""

    code: str
    factor: float
    correlation: float


def scale_doubt(
    plant: Plant, recording: Recording, response: BenchResponse, observed: Sequence[str], free: Collection[str]
) -> ScaleDoubt | None:
    """Find whether a recording needs another scale of its clock or of its electrical input.

    A wire that would be far too hot, or stays cold while a sensor moves, needs one; so does a recording whose rows are
    far apart compared with the time constant of the wire and that fits the rig on a faster clock only.

    Args:
        plant: The plant with the values of the rig.
        recording: The recording.
        response: The rig's response to it.
        observed: Observed channels.
        free: Names of free parameters; a free gain of the drive explains any size of the input.

    Returns:
        The doubt; ``None`` where there is none.
    """
    channels = [c for c in observed if channel_of(c) in MECHANICAL and _moves(recording.channels[c])]
    if not plant.drive.control or not recording.has_clock or not channels or _is_free(free):
        return None
    correlation = _correlation(recording, response, channels)
    hottest, ambient = _hottest(response), float(plant.environment.ambient)
    name = numbered(plant.drive.control, plant.mechanism.wires)[0]
    if hottest > _HOTTEST:
        best = _best(plant, recording, channels, clocks=(), inputs=[f for f in _INPUT_FACTORS if f < 1.0])
        heats = f"{plant.drive.control} heats the wire to {hottest:,.0f} degC by the rig's values"
        return ScaleDoubt("input", name, heats, _remedy(plant, recording, name, best))
    if hottest - ambient < _COLD * (_austenite_start(plant) - ambient) and not response.transforms:
        inputs = [f for f in _INPUT_FACTORS if f > 1.0]
        best = _best(plant, recording, channels, clocks=[f for f in _TIME_FACTORS if f > 1.0], inputs=inputs)
        heats = f"{plant.drive.control} heats the wire by {hottest - ambient:.2g} K only by the rig's values"
        code, channel = ("clock", "time") if best is not None and best.code == "clock" else ("input", name)
        text = f"{heats}, while {channels[0]} moves by {_range_text(recording, channels[0])}"
        return ScaleDoubt(code, channel, text, _remedy(plant, recording, name, best))
    slow = _slow_clock(plant, recording, channels, correlation)
    return slow or _clock_in_minutes(plant, recording, channels, correlation)


def _slow_clock(plant: Plant, recording: Recording, channels: Sequence[str], correlation: float) -> ScaleDoubt | None:
    """A clock in ms or us that was read as s: rows far apart for the wire, whose motion still lags behind its input."""
    spacing, settling = float(np.median(np.diff(recording.time))), wire_time_constant(plant)
    if spacing < SETTLED * settling:
        return None
    best = _best(plant, recording, channels, clocks=[f for f in _TIME_FACTORS if f < 1.0], inputs=())
    if best is None or (1.0 - correlation**2) < _BETTER * (1.0 - best.correlation**2):
        return None
    text = (
        f"the rows are {spacing:.3g} s apart, {spacing / settling:.0f} time constants of the wire, and {channels[0]} "
        f"follows the rig's values only with {_amount(best.factor)} the time"
    )
    return ScaleDoubt("clock", "time", text, f"check the unit of {_unit_read(recording, 'time')}")


def _clock_in_minutes(
    plant: Plant, recording: Recording, channels: Sequence[str], correlation: float
) -> ScaleDoubt | None:
    """A clock in minutes that was read as s, or the reverse: the rig moves, but not as the recording does."""
    if correlation >= _POOR:
        return None
    best = _best(plant, recording, channels, clocks=(1.0 / 60.0, 60.0), inputs=())
    if best is None or best.correlation < _GOOD or (1.0 - correlation**2) < _BETTER * (1.0 - best.correlation**2):
        return None
    text = f"{channels[0]} follows the rig's values only with {_amount(best.factor)} the time"
    return ScaleDoubt("clock", "time", text, f"check the unit of {_unit_read(recording, 'time')}")


def _is_free(free: Collection[str]) -> bool:
    return any(name.startswith("drive.") or name.startswith("initial.") for name in free)


def _moves(values: np.ndarray) -> bool:
    return bool(np.nanmax(values) - np.nanmin(values) > _MOVES * difference_noise(values))


def _hottest(response: BenchResponse) -> float:
    finite = response.temperature[np.isfinite(response.temperature)]
    return float(np.max(finite)) if len(finite) else np.nan


def _austenite_start(plant: Plant) -> float:
    return float(plant.material.austenite_start) + float(plant.material.austenite_shift)


def _correlation(recording: Recording, response: BenchResponse, channels: Sequence[str]) -> float:
    """Largest correlation of a channel with its model, without its sign; 0 where nothing transforms."""
    if not response.transforms:
        return 0.0
    best = 0.0
    for channel in channels:
        measured, model = recording.channels[channel], response.channels[channel]
        rows = np.isfinite(measured) & np.isfinite(model)
        if np.sum(rows) > 2 and np.ptp(model[rows]):
            best = max(best, abs(float(np.corrcoef(measured[rows], model[rows])[0, 1])))
    return best


def _best(
    plant: Plant, recording: Recording, channels: Sequence[str], *, clocks: Sequence[float], inputs: Sequence[float]
) -> _Scale | None:
    """The scale with which the rig follows a recording best; ``None`` if it does with none."""
    scales = []
    for factor in clocks:
        grid = grid_of(plant, dataclasses.replace(recording, time=recording.time * factor))
        if grid is not None:
            response = response_to(plant, grid, len(recording))
            scales.append(_Scale("clock", factor, _usable(recording, response, channels)))
    grid = grid_of(plant, recording) if inputs else None
    if grid is not None:
        responses = [(factor, response_to(plant, grid.scale(factor), len(recording))) for factor in inputs]
        scales += [_Scale("input", f, _usable(recording, response, channels)) for f, response in responses]
    best = max(scales, key=lambda scale: scale.correlation, default=None)
    return best if best is not None and best.correlation >= _FITS else None


def _usable(recording: Recording, response: BenchResponse, channels: Sequence[str]) -> float:
    """Correlation with the model; 0 for one that is far too hot."""
    return _correlation(recording, response, channels) if _hottest(response) <= _HOTTEST else 0.0


def _remedy(plant: Plant, recording: Recording, name: str, best: _Scale | None) -> str:
    control = plant.drive.control
    if best is None:
        return f"check the units of {control} and time, and wire and heat of the rig"
    channel, what = ("time", "time") if best.code == "clock" else (name, control)
    amount = f"{_amount(best.factor)} the {what}"
    return f"the rig follows the recording with {amount}: check the unit of {_unit_read(recording, channel)}"


def _amount(factor: float) -> str:
    return f"{_WORDS[factor]}{' of' if factor < 1 else ''}"


def _unit_read(recording: Recording, channel: str) -> str:
    return f"{channel}, which is read as {recording.units.get(channel, channel_unit(channel))}"


def _range_text(recording: Recording, channel: str) -> str:
    unit = recording.units.get(channel, channel_unit(channel))
    values = recording.channels[channel]
    ends = from_si(np.array([np.nanmin(values), np.nanmax(values)]), unit, channel_unit(channel))
    return f"{ends[1] - ends[0]:.3g} {unit}"
