"""Noise of a recorded electrical input: how much there is, and whether the wire gets it.

Where the command stays at a level, the recorded input scatters about it. This is noise of the meter, which the wire
does not get, or ripple, which it does, or both. With the share w of its variance that is ripple, the best prediction of
what the wire gets is

    I = mean + w (recorded - mean)

on each plateau (regression calibration): the mean for noise of the meter, the recorded input for ripple. The share is
found from a recorded voltage or resistance, from the size of the meter's noise where it is given, or from the response
of the fitted channels (``smajax.fitting.noisy_inputs``).

Source: carroll2006 (regression calibration).
"""

import dataclasses
import enum
import math
from collections.abc import Sequence

import numpy as np

from smajax.channels import NOISE_EXAMPLES, channel_unit
from smajax.fitting.intervals import covariance_under_autocorrelation, student_quantile
from smajax.fitting.noise import row_noise
from smajax.fitting.plateaus import Plateaus, find_plateaus, pooled_noise
from smajax.fitting.unknowns import Settings
from smajax.plant.plant import Plant
from smajax.recordings.recording import Recording
from smajax.units import as_text, from_si

# Shares of ripple that count as none and as all. Chosen by trial: what the rest does to an estimate is below its
# interval; experiments/fitting/input_noise_coverage.py shows it.
NO_RIPPLE = 0.1
ALL_RIPPLE = 0.9
# Share between the two: an interval of the share has to be on one side of it.
_MIDDLE = 0.5
# Distance of the share's interval below 0 or above 1 from which another error than noise decides it. Chosen by trial.
_IMPOSSIBLE = 0.25
# Share of the cost with the means of the plateaus below which the cost with the recorded inputs decides for ripple
# where the share of the variance does not. Chosen by trial, held by tests/unit/fitting/test_electrical_noise.py.
RIPPLE_COST = 0.8
# Least mean of a plateau in multiples of its noise at which voltage and current are compared: the linear error of the
# ratio is then below 1 %.
_MIN_LEVEL = 10.0
# Channels that show the share w of ripple for each input, with w = first + second * slope, where the slope is that of
# their relative changes over those of the input.
_PARTNERS = {
    "current": (("voltage", 0.0, 1.0), ("resistance", 1.0, 1.0)),
    "voltage": (("current", 0.0, 1.0), ("resistance", 1.0, -1.0)),
}


class NoiseKind(enum.StrEnum):
    """What the scatter of an input on its plateaus is."""

    none = "none"
    meter = "meter"
    ripple = "ripple"
    both = "both"
    undecided = "undecided"
    no_plateaus = "no-plateaus"


@dataclasses.dataclass(frozen=True, eq=False)
class InputNoise:
    """Noise of an electrical input.

    Attributes:
        channel: The input.
        kind: What it is.
        deviation: Standard deviation of a row, SI.
        given: Whether the standard deviation of the meter was given, rather than estimated on plateaus.
        share: Share of the variance that the wire gets; NaN if it is not known.
        plateaus: The plateaus in each training recording.
        mean_deviation: Standard deviation of the mean of n rows times the root of n, SI.
        reason: Why it is of this kind, in words.
    """

    channel: str
    kind: NoiseKind
    deviation: float
    given: bool
    share: float
    plateaus: tuple[Plateaus, ...]
    mean_deviation: float
    reason: str = ""

    @property
    def count(self) -> int:
        """Number of plateaus."""
        return sum(len(p.parts) for p in self.plateaus)

    @property
    def used_share(self) -> float:
        """Share of the deviations from plateaus that the inputs of the fit keep."""
        return self.share if self.kind in (NoiseKind.ripple, NoiseKind.both) else 0.0

    def sentence(self, unit: str = "") -> str:
        """Say how much noise there is, what it is, and what the fit made of it.

        Args:
            unit: Unit of the recording's column, in which it is shown; the internal one by default.
        """
        if self.kind is NoiseKind.none:
            return f"{self.channel} shows no noise."
        internal = channel_unit(self.channel, difference=True)
        size = f"{from_si(self.deviation, unit or internal, internal):.2g} {unit or internal}"
        places = f"{self.count} plateau{'s' * (self.count != 1)}"
        if self.kind is NoiseKind.no_plateaus:
            return self._sentence_without_plateaus(size)
        source = f"{size} as given" if self.given else f"{size}, estimated on {places}"
        treatment = {
            NoiseKind.meter: "noise of the meter: the fit takes the means of the plateaus, and its intervals contain "
            "their error",
            NoiseKind.ripple: "ripple that the wire gets: the fit takes the recorded values",
            NoiseKind.both: f"in part ripple that the wire gets ({100 * self.share:.0f} % of the variance): the fit "
            "takes the means of the plateaus and this share of the scatter, and its intervals contain the rest",
            NoiseKind.undecided: "noise of the meter or ripple that the wire gets, which the recordings do not show: "
            "the fit takes the means of the plateaus, and its intervals contain what the other would change",
        }[self.kind]
        return f"The noise of {self.channel} ({source}) is {treatment}. {self.reason}."

    def _sentence_without_plateaus(self, size: str) -> str:
        where = f"{self.channel} does not stay at levels, on which the noise of a meter shows"
        if self.given:
            return (
                f"{where}: the intervals contain the effect of its noise ({size} as given), and the estimates are not "
                "corrected for it."
            )
        return (
            f"{where}, and scatters by {size} from row to row: estimates and intervals take it as exact. Give the "
            f'noise of its meter, such as input_noise = "{NOISE_EXAMPLES[self.channel.partition("_")[0]]}" under [fit].'
        )


def find_input_noise(plant: Plant, recordings: Sequence[Recording], settings: Settings) -> tuple[InputNoise, ...]:
    """Find the noise of a plant's electrical inputs.

    Args:
        plant: The plant.
        recordings: Training recordings.
        settings: Settings with ``input_noise``.

    Returns:
        The noise of each electrical input; none without such an input, for recordings without a clock, and where
        ``input_noise`` is 0. The kind is ``undecided`` where only the response of the fit can show it.
    """
    given = getattr(settings, "input_noise", None)
    if given == 0.0 or not plant.drive.control or not all(r.has_clock for r in recordings):
        return ()
    channels = [name for name in plant.signals if name.startswith(plant.drive.control)]
    # A simulation refuses a missing value with its row.
    channels = [c for c in channels if all(len(r) > 1 and np.all(np.isfinite(r.channels[c])) for r in recordings)]
    return tuple(_noise_of(channel, recordings, given) for channel in channels)


def corrected_recordings(
    recordings: Sequence[Recording], noises: Sequence[InputNoise], *, training: bool
) -> list[Recording]:
    """Return recordings whose electrical inputs are those that a wire most likely gets.

    Args:
        recordings: The recordings.
        noises: Noise of the inputs.
        training: Whether they are those of the noise; plateaus are found anew in others.
    """
    corrected = list(recordings)
    for noise in noises:
        if noise.count == 0:
            continue
        for k, recording in enumerate(corrected):
            found = noise.plateaus[k] if training else find_plateaus(recording.channels[noise.channel])
            values = found.means + noise.used_share * found.deviations
            corrected[k] = dataclasses.replace(recording, channels={**recording.channels, noise.channel: values})
    return corrected


def with_share(noise: InputNoise, share: float, error: float, source: str) -> InputNoise:
    """Decide what the noise of an input is from the share of its variance that the wire gets.

    Args:
        noise: The noise, undecided.
        share: Estimate of the share.
        error: Half width of its 95 % interval.
        source: What shows the share, as the subject of a sentence.
    """
    low, high = share - error, share + error
    if not math.isfinite(error):
        return dataclasses.replace(noise, reason="The fitted channels do not show which")
    kind, used = NoiseKind.undecided, share
    if high > -_IMPOSSIBLE and low < 1.0 + _IMPOSSIBLE:
        if low <= NO_RIPPLE and high < _MIDDLE:
            kind, used = NoiseKind.meter, 0.0
        elif low > _MIDDLE and high >= ALL_RIPPLE:
            kind, used = NoiseKind.ripple, 1.0
        elif low > NO_RIPPLE and high < ALL_RIPPLE:
            kind = NoiseKind.both
    reason = f"{source} {100 * share:.0f} % of it (95 % interval {100 * low:.0f} to {100 * high:.0f} %)"
    return dataclasses.replace(noise, kind=kind, share=used, reason=reason)


def as_ripple(noises: Sequence[InputNoise], before: Sequence[InputNoise]) -> tuple[InputNoise, ...]:
    """Return noise as ripple where the fitted channels showed that a wire gets a part of it, or nothing clear.

    Args:
        noises: Noise of the inputs.
        before: The same before the fitted channels were asked.
    """
    reason = "The residual is smaller with the recorded values than with the means of its plateaus"
    open_kinds = (NoiseKind.undecided, NoiseKind.both)
    return tuple(
        dataclasses.replace(new, kind=NoiseKind.ripple, share=1.0, reason=reason)
        if old.kind is NoiseKind.undecided and new.kind in open_kinds
        else new
        for new, old in zip(noises, before, strict=True)
    )


def shares(noises: Sequence[InputNoise]) -> list[float]:
    """Return the share of the deviations from plateaus that the inputs of a fit keep, for each input."""
    return [noise.used_share for noise in noises]


def _noise_of(channel: str, recordings: Sequence[Recording], given: float | None) -> InputNoise:
    """Noise of one input."""
    plateaus = tuple(find_plateaus(r.channels[channel]) for r in recordings)
    found = [p for p in plateaus if len(p.parts)]
    if not found:
        size = max(row_noise(r.channels[channel]) for r in recordings) if given is None else given
        kind = NoiseKind.no_plateaus if size else NoiseKind.none
        return InputNoise(channel, kind, size, given is not None, math.nan, plateaus, size)
    deviation, mean_deviation = pooled_noise(found)
    noise = InputNoise(channel, NoiseKind.undecided, deviation, given is not None, math.nan, plateaus, mean_deviation)
    if given is not None:
        seen = as_text(float(f"{deviation:.2g}"), channel_unit(channel, difference=True))
        noise = dataclasses.replace(noise, deviation=given, mean_deviation=max(given, mean_deviation))
        share = min(max(1.0 - (given / deviation) ** 2, 0.0), 1.0)
        kind = NoiseKind.meter if share <= NO_RIPPLE else NoiseKind.ripple if share >= ALL_RIPPLE else NoiseKind.both
        share = {NoiseKind.meter: 0.0, NoiseKind.ripple: 1.0}.get(kind, share)
        return dataclasses.replace(noise, kind=kind, share=share, reason=f"On plateaus it scatters by {seen}")
    electrical = _electrical_share(channel, recordings, plateaus, deviation)
    if electrical is None:
        return noise
    partner, share, error = electrical
    return with_share(noise, share, error, f"The recorded {partner} follows")


def _electrical_share(
    channel: str, recordings: Sequence[Recording], plateaus: Sequence[Plateaus], deviation: float
) -> tuple[str, float, float] | None:
    """Share of the scatter that a recorded voltage, current or resistance follows, and its error; ``None`` without one.

    At a resistance that changes slowly, a ripple of the current by 1 % changes the voltage by 1 %, and noise of the
    meter does not. A resistance that is the quotient of the two falls by 1 % with the latter.
    """
    control, _, wire = channel.partition("_")
    for partner, offset, sign in _PARTNERS.get(control, ()):
        name = f"{partner}_{wire}" if wire else partner
        if not all(name in r.channels for r in recordings):
            continue
        pairs = [_relative_changes(r, channel, name, p, deviation) for r, p in zip(recordings, plateaus, strict=True)]
        drive, response = (np.concatenate(columns) for columns in zip(*pairs, strict=True))
        if len(drive) <= 1 or not np.any(response):
            continue
        slope = float(drive @ response / (drive @ drive))
        rest = response - slope * drive
        variance = covariance_under_autocorrelation([drive[:, None]], [rest], 1)[0, 0]
        return name, offset + sign * slope, student_quantile(len(drive), 1) * math.sqrt(variance)
    return None


def _relative_changes(
    recording: Recording, channel: str, partner: str, plateaus: Plateaus, deviation: float
) -> tuple[np.ndarray, np.ndarray]:
    """Changes from row to row of an input and of another channel, relative to their means on each plateau."""
    columns: tuple[list[np.ndarray], list[np.ndarray]] = ([np.zeros(0)], [np.zeros(0)])
    for first, end in plateaus.parts:
        values, other = (recording.channels[c][first:end] for c in (channel, partner))
        levels = float(np.mean(values)), float(np.mean(other))
        if abs(levels[0]) < _MIN_LEVEL * deviation or not np.all(np.isfinite(other)) or levels[1] == 0.0:
            continue
        columns[0].append(np.diff(values) / levels[0])
        columns[1].append(np.diff(other) / levels[1])
    return np.concatenate(columns[0]), np.concatenate(columns[1])
