"""Checks of recordings against their rig before a fit: an offset, a sign, a clock, a unit.

The rig is simulated with the values of its file. What a check needs of these values is coarse, a sign or a power of
ten, so that it holds where they are only near those of the wire.
"""

import dataclasses
import math
from collections import Counter
from collections.abc import Callable, Collection, Mapping, Sequence

import numpy as np

from smajax.channels import CHANNELS, channel_of, channel_unit
from smajax.fitting.bench_responses import MECHANICAL, BenchResponse, bench_responses
from smajax.fitting.bench_scales import ScaleDoubt, scale_doubt
from smajax.fitting.noise import difference_noise
from smajax.fitting.residual_offsets import ZERO_AS_INSTALLED, ResidualOffset
from smajax.fitting.unknowns import Settings
from smajax.plant.plant import Plant
from smajax.recordings.recording import Recording
from smajax.units import conversion

# Thresholds without a stated reason were chosen by trial, so that no shipped recording and none of the public ones
# has a finding, and spoiled ones have theirs (tests/unit/fitting/test_bench_checks.py).
# Least offset as a share of a channel's range.
_MIN_OFFSET = 0.01
# Least offset in standard errors of the median of the first rows: by chance in one of 15,000 recordings.
_MIN_OFFSET_ERRORS = 4.0
# Standard error of a median in that of a mean, for normal noise: the root of pi / 2.
_MEDIAN_ERROR = math.sqrt(0.5 * math.pi)
# Quantiles that stand for the lowest and highest values, so that no single row decides.
_LOW, _HIGH = 0.01, 0.99
# First rows count as at rest while the model stays within this share of its range. Chosen by trial.
_AT_REST = 5e-3
# Correlation with the model below which a channel has the other sign.
_MAX_CORRELATION = -0.5
# Least motion relative to the model's: a wire that only expands has 2 % of the strain of a transformation.
_MIN_MOTION = 0.05
# A factor is a power of ten if its logarithm is this close to a whole number: a factor of 1.6 either way.
_POWER_TOLERANCE = 0.2
# Any other factor counts from here on, either way: alloys transform by 2 to 8 %, a factor of two from what is usual.
_LARGE_FACTOR = 5.0
# Correlation from which the shape of a recording is the model's, so that their ratio says something.
_SAME_SHAPE = 0.8
# K. Distance of a temperature at rest from the rig's from which its unit is in doubt, and distance within which another
# unit explains it: that of a room over a year.
_FAR_AT_REST, _NEAR_AT_REST = 20.0, 8.0
# Smallest last digit of an offset in the unit of its column; chosen so that the text stays short.
_LEAST_DIGIT = 1e-6
# Difference of the offsets of two recordings, in standard deviations of their noise, from which each has its own.
# Chosen by trial; tests/unit/fitting/test_bench_checks.py has an example of each.
OWN_OFFSETS = 10.0
# Recordings that one sentence names.
_NAMED = 3


@dataclasses.dataclass(frozen=True)
class BenchFinding:
    """What a recording shows about its own bench.

    Attributes:
        code: ``offset``, ``sign``, ``unit``, ``input`` or ``clock``.
        channel: Channel that it is about.
        recordings: Names of the recordings that show it.
        text: The finding, without the recordings.
        remedy: What to do.
        values: Offsets by recording, internal unit; empty for other codes.
        noise: Noise of the channel, internal unit.
    """

    code: str
    channel: str
    recordings: tuple[str, ...]
    text: str
    remedy: str
    values: tuple[float, ...] = ()
    noise: float = 0.0

    @property
    def sentence(self) -> str:
        """The finding with its remedy as one sentence that names its recordings."""
        return f"{self._names}: {self.text}: {self.remedy}."

    @property
    def fitted_sentence(self) -> str:
        """The finding of an offset that is fitted."""
        return f"{self._names}: {self.text}: sensor.{self.channel}_offset is free, as --auto asks."

    @property
    def unfitted_sentence(self) -> str:
        """The finding of an offset that no training recording shows, so that a fit cannot find it."""
        return f"{self._names}: {self.text}: no training recording shows it, so that it is not fitted."

    @property
    def _names(self) -> str:
        more = f" and {len(self.recordings) - _NAMED} more" if len(self.recordings) > _NAMED else ""
        return ", ".join(self.recordings[:_NAMED]) + more


def bench_findings(plant: Plant, recordings: Sequence[Recording], settings: Settings) -> list[BenchFinding]:
    """Find what recordings show about the bench: an offset, a reversed sign, a clock or a unit that is not the rig's.

    Args:
        plant: The plant with the values of the rig.
        recordings: The recordings.
        settings: Settings of the fit; what is free explains nothing here.

    Returns:
        The findings, each with the recordings that show it; none where the recordings agree with the rig.
    """
    free = {*settings.free, *settings.per_recording}
    found: list[BenchFinding] = []
    for recording, response in zip(recordings, bench_responses(plant, recordings), strict=True):
        doubt = scale_doubt(plant, recording, response, settings.observe, free)
        if doubt is not None:
            found.append(_scale_finding(recording, doubt))
            continue
        for channel in settings.observe:
            if channel_of(channel) in MECHANICAL:
                found += _channel_findings(plant, recording, response, channel, settings)
            elif channel_of(channel) == "temperature":
                found += _thermometer_findings(recording, response, channel)
    return _joined(found)


def _joined(found: Sequence[BenchFinding]) -> list[BenchFinding]:
    """One finding for each code, channel and offset, with the recordings that show it."""
    groups: dict[tuple[str, str, float], BenchFinding] = {}
    for finding in found:
        key = finding.code, finding.channel, _nearest_offset(finding, groups.values())
        first = groups.get(key)
        if first is None:
            groups[key] = finding
        else:
            names, values = first.recordings + finding.recordings, first.values + finding.values
            groups[key] = dataclasses.replace(first, recordings=names, values=values)
    offsets = Counter(finding.channel for finding in groups.values() if finding.code == "offset")
    # One offset under [channels] would hold for all recordings.
    return [
        dataclasses.replace(finding, remedy=_freed(finding.channel))
        if finding.code == "offset" and offsets[finding.channel] > 1
        else finding
        for finding in groups.values()
    ]


def _freed(channel: str) -> str:
    return f"free sensor.{channel}_offset, which fit --auto (auto=True) does"


def _nearest_offset(finding: BenchFinding, groups: Collection[BenchFinding]) -> float:
    """The offset of the first finding that has the same one within the noise, or its own; 0 for other findings."""
    if not finding.values:
        return 0.0
    firsts = (other.values[0] for other in groups if (other.code, other.channel) == (finding.code, finding.channel))
    near = (value for value in firsts if abs(value - finding.values[0]) <= OWN_OFFSETS * finding.noise)
    return next(near, finding.values[0])


def _scale_finding(recording: Recording, doubt: ScaleDoubt) -> BenchFinding:
    return BenchFinding(doubt.code, doubt.channel, (recording.name,), doubt.text, doubt.remedy)


def _channel_findings(
    plant: Plant, recording: Recording, response: BenchResponse, channel: str, settings: Settings
) -> list[BenchFinding]:
    """Findings on one mechanical channel: its sign, its scale, its offset."""
    measured, model = recording.channels[channel], response.channels[channel]
    rows = np.isfinite(measured) & np.isfinite(model)
    if np.sum(rows) < 2 or not np.ptp(model[rows]) or not np.ptp(measured[rows]):
        return []
    names, findings = (recording.name,), []
    gain_is_free = f"sensor.{channel}_gain" in (*settings.free, *settings.per_recording)
    reversed_sign = _is_reversed(plant, response, channel, measured[rows], rows)
    if reversed_sign:
        falls = (
            "falls when the wire is heated" if _one_wire_contracts(plant, channel) else "falls where the rig's rises"
        )
        rule = CHANNELS[channel_of(channel) or channel].description.rpartition(", ")[2]
        rule = "contraction is positive" if rule == "positive when the wire shortens" else rule
        remedy = f"give {channel} factor = -1 under [channels]"
        findings.append(BenchFinding("sign", channel, names, f"{channel} {falls}: {rule}", remedy))
    factor = _factor(measured[rows], model[rows])
    if response.transforms and not gain_is_free and factor is not None:
        times = f"a {_ORDINALS[factor]} of" if factor in _ORDINALS else f"{float(f'{factor:.2g}'):g} times"
        unit = recording.units.get(channel, channel_unit(channel))
        text = f"{channel} is {times} what the rig's values give"
        findings.append(BenchFinding("unit", channel, names, text, f"check its unit, which is read as {unit}"))
    offset = _offset(plant, recording, response, channel, -1.0 if reversed_sign else 1.0)
    if offset is not None and not _explains_offset(settings, channel):
        findings.append(_offset_finding(recording, channel, *offset, reversed_sign))
    return findings


_ORDINALS = {0.1: "tenth", 0.01: "hundredth", 0.001: "thousandth", 1e-6: "millionth"}


def _one_wire_contracts(plant: Plant, channel: str) -> bool:
    """Whether a channel is the displacement of one wire, which rises where the wire is heated."""
    return plant.mechanism.wires == 1 and channel == "displacement"


def _is_reversed(plant: Plant, response: BenchResponse, channel: str, measured: np.ndarray, rows: np.ndarray) -> bool:
    """Whether a channel falls where the model rises, or where its only wire is heated if nothing transforms."""
    model = response.channels[channel][rows]
    if response.transforms:
        large = float(np.std(measured)) > _MIN_MOTION * float(np.std(model))
        return large and float(np.corrcoef(measured, model)[0, 1]) < _MAX_CORRELATION
    temperature = response.temperature[rows, 0]
    if not _one_wire_contracts(plant, channel) or not np.ptp(temperature):
        return False
    full = float(plant.effective_material.max_transformation_strain * plant.wire.motion_per_strain)
    return bool(np.ptp(measured) > _MIN_MOTION * full and np.corrcoef(measured, temperature)[0, 1] < _MAX_CORRELATION)


def _factor(measured: np.ndarray, model: np.ndarray) -> float | None:
    """Factor between a channel and the model of the same shape, a power of ten if it is near one; ``None`` if usual."""
    if abs(float(np.corrcoef(measured, model)[0, 1])) < _SAME_SHAPE:
        return None
    power = math.log10(float(np.std(measured)) / float(np.std(model)))
    whole = round(power)
    if whole and abs(power - whole) <= _POWER_TOLERANCE:
        return 10.0**whole
    return 10.0**power if abs(power) > math.log10(_LARGE_FACTOR) else None


# Temperatures in degC whose numbers are those of another unit, by what the unit is.
_THERMOMETERS: Mapping[str, Callable[[float], float]] = {
    "degF": lambda value: (value - 32.0) / 1.8,
    "K": lambda value: value - 273.15,
}


def _thermometer_findings(recording: Recording, response: BenchResponse, channel: str) -> list[BenchFinding]:
    """A temperature that begins far from the rig's, where another unit would begin near it."""
    first = _first_rows(recording.channels[channel], response.channels[channel])
    if first is None or abs(first[0] - first[1]) < _FAR_AT_REST:
        return []
    unit = recording.units.get(channel, channel_unit(channel))
    number = float((first[0] - conversion(unit, "degC")[1]) / conversion(unit, "degC")[0])
    for other, in_celsius in _THERMOMETERS.items():
        if other != unit and abs(in_celsius(number) - first[1]) <= _NEAR_AT_REST:
            text = f"{channel} begins at {number:.1f} {unit} where the rig is at {first[1]:.1f} degC, as in {other}"
            remedy = f"check its unit, which is read as {unit}"
            return [BenchFinding("unit", channel, (recording.name,), text, remedy)]
    return []


def _first_rows(measured: np.ndarray, model: np.ndarray) -> tuple[float, float, int] | None:
    """Median of a channel while its model is at rest, the model there, and the rows; ``None`` where not finite."""
    moved = np.abs(model - model[0]) > _AT_REST * np.ptp(model)
    rest = int(np.argmax(moved)) if np.any(moved) else len(model)
    first = measured[: max(rest, 1)]
    rows = int(np.sum(np.isfinite(first)))
    return (float(np.nanmedian(first)), float(model[0]), rows) if rows and np.isfinite(model[0]) else None


def _offset(
    plant: Plant, recording: Recording, response: BenchResponse, channel: str, sign: float
) -> tuple[float, float] | None:
    """Offset of a channel that is 0 as installed, and its error, internal unit; ``None`` where there is none.

    The first rows and the side of rest of the whole recording have to be off by as much: a wire that is warm at first
    comes back to 0.
    """
    if channel_of(channel) not in ZERO_AS_INSTALLED or channel.rpartition("_")[2].isdigit():
        return None
    measured, model = sign * recording.channels[channel], response.channels[channel]
    first = _first_rows(measured, model)
    if first is None:
        return None
    offset = first[0] - first[1]
    noise = difference_noise(recording.channels[channel])
    noisy = model + noise * np.random.default_rng(0).standard_normal(len(model))  # quantiles have the noise's, too
    quantiles = (_LOW,) if plant.mechanism.wires == 1 else (_LOW, _HIGH)
    others = [float(np.nanquantile(measured, q) - np.nanquantile(noisy, q)) for q in quantiles]
    least = min(abs(value) for value in (offset, *others))
    error = noise * (_MEDIAN_ERROR / math.sqrt(first[2]) if first[2] > 1 else 1.0)
    threshold = max(_MIN_OFFSET * float(np.nanmax(measured) - np.nanmin(measured)), _MIN_OFFSET_ERRORS * error)
    if least < threshold or len({math.copysign(1.0, value) for value in (offset, *others)}) > 1:
        return None
    return sign * offset, error


def _explains_offset(settings: Settings, channel: str) -> bool:
    """Whether the offset or the state at the start is free already."""
    names = (*settings.free, *settings.per_recording)
    return (
        f"sensor.{channel}_offset" in names
        or any(name.startswith("initial.") for name in names)
        or bool(settings.initial)
    )


def _offset_finding(
    recording: Recording, channel: str, offset: float, error: float, reversed_sign: bool
) -> BenchFinding:
    unit = recording.units.get(channel, channel_unit(channel))
    noise = difference_noise(recording.channels[channel])
    exact = float(_offset_text(recording, channel, offset, error))
    subtracted = exact * (1 if reversed_sign else -1)
    return BenchFinding(
        "offset",
        channel,
        (recording.name,),
        f"{channel} begins at {float(f'{exact:.3g}'):g} {unit} where the rig is at 0",
        f"{_freed(channel)}, or subtract it by offset = {subtracted:.10g} of {channel} under [channels]",
        (offset,),
        noise,
    )


def _offset_text(recording: Recording, channel: str, offset: float, error: float) -> str:
    """An offset in the unit of the column, rounded by less than its error, so that the rounding is no offset."""
    scale = float(1 / conversion(recording.units.get(channel, channel_unit(channel)), channel_unit(channel))[0])
    digits = max(0, math.ceil(-math.log10(max(2.0 * error * scale, _LEAST_DIGIT))))
    return f"{offset * scale:.{digits}f}"


def residual_findings(
    recordings: Sequence[Recording], offsets: Sequence[ResidualOffset], floor: Mapping[str, float], remedy: str
) -> list[BenchFinding]:
    """Return the offsets that a fit shows; they may be too small for the checks before it.

    Args:
        recordings: The training recordings.
        offsets: Offsets that explain the residual.
        floor: Noise of the residual by channel, SI.
        remedy: What to do in addition to freeing the offset.
    """
    found = []
    for channel, values, share in offsets:
        noise, unit = floor[channel], recordings[0].units.get(channel, channel_unit(channel))
        shown = [_offset_text(r, channel, value, noise) for r, value in zip(recordings, values, strict=True)]
        amounts = f"an offset of {channel} of {' and '.join(shown[:_NAMED])} {unit}"
        text = f"{amounts} explains {100.0 * share:.0f} % of what the residual has above its noise"
        names, advice = tuple(r.name for r in recordings), f"free sensor.{channel}_offset, {remedy}"
        error = noise / math.sqrt(min(len(r) for r in recordings))  # all rows of a recording show its offset
        found.append(BenchFinding("offset", channel, names, text, advice, values, error))
    return found
