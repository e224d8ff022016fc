"""Recordings: measured time series, or paths without a clock, with named channels in SI units."""

from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from types import MappingProxyType
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

from smajax.arguments import check_interpolation
from smajax.channels import channel_unit
from smajax.errors import InputError, suggestion
from smajax.recordings.traced_values import is_tracing_error, traced_values_error
from smajax.recordings.write import write_table
from smajax.units import from_si, to_si

Floats = NDArray[np.float64]

# Largest number of rows of a resampled recording: 100 million of one channel take 0.8 GB; more is an error in the step.
_MAX_RESAMPLED_ROWS = 100_000_000
# Relative amount by which the last multiple of the step may exceed the duration, so that rounding keeps the last row.
_STEP_ROUNDING = 1e-12
# Difference between a time and a sample that counts as rounding, as a fraction of the shortest step: times that are
# computed as multiples of a step differ by rounding. Chosen by trial; see tests/unit/recordings/test_recording.py.
_HOLD_SLACK = 1e-6
# Number of float spacings that always counts as rounding.
_HOLD_SPACINGS = 4


@dataclass(frozen=True, eq=False, repr=False)
class Recording:
    """A recording with n rows.

    Attributes:
        name: Name in messages and results.
        time: Times, shape ``(n,)``, in s, strictly increasing; row numbers 0, 1, 2, ... for a path without a clock.
        channels: Read-only arrays, shape ``(n,)``, in SI units (temperatures in degC) by name (``current``,
            ``current_2``). A channel made from arrays may be NaN in rows in which it was not measured; one that was
            read from a file has a number in every row.
        units: Units of the columns in the file, in which results are reported; with ``time`` if there is a clock.
        sha256: SHA-256 of the file, or of the columns in memory, in hexadecimal; empty for arrays until they are read.
        has_clock: Whether ``time`` is a time.
        notes: Sentences on changes that were made on request.
    """

    name: str
    time: Floats
    channels: Mapping[str, Floats]
    units: Mapping[str, str]
    sha256: str = ""
    has_clock: bool = True
    notes: tuple[str, ...] = ()

    def __post_init__(self) -> None:
        time = _as_floats(self.time, f"{self.name}: time")
        channels = {name: _as_floats(v, f"{self.name}: channel '{name}'") for name, v in self.channels.items()}
        for name, values in channels.items():
            if values.shape != time.shape:
                shapes = f"channel '{name}' has shape {values.shape} and time {time.shape}"
                raise InputError(f"{self.name}: {shapes}: make them equal")
        object.__setattr__(self, "time", _read_only(time))
        object.__setattr__(self, "channels", MappingProxyType({n: _read_only(v) for n, v in channels.items()}))
        object.__setattr__(self, "units", MappingProxyType(dict(self.units)))

    @classmethod
    def from_arrays(
        cls,
        name: str,
        time: Floats | None,
        channels: Mapping[str, Floats],
        units: Mapping[str, str] = MappingProxyType({}),
    ) -> "Recording":
        """Return a recording of arrays in SI units (temperatures in degC).

        Values are rounded to those that a column of float64 in ``units`` can represent, so that writing and reading
        returns the same values. JAX cannot trace them: ``discretise`` says how to differentiate in the inputs.

        Args:
            name: Name in messages and results.
            time: Times, shape ``(n,)``, in s, or ``None`` for a path without a clock.
            channels: Arrays, shape ``(n,)``, by channel.
            units: Units in which the channels are written and reported; internal units by default.

        Raises:
            InputError: If there is no channel, a name is unknown, the shapes differ, or values are not numbers, or
                are traced by JAX.
        """
        if not channels:
            raise InputError(f"{name}: there is no channel: give a dictionary with the array of each channel")
        columns = [*([] if time is None else ["time"]), *channels]
        for channel in units:
            channel_unit(channel)  # refuses a name that is not known
        units = {channel: units.get(channel, channel_unit(channel)) for channel in columns}
        rounded = {
            c: _as_in_file(_as_floats(values, f"{name}: channel '{c}'"), c, units[c]) for c, values in channels.items()
        }
        if time is None:
            return cls(name, np.arange(len(next(iter(rounded.values()))), dtype=float), rounded, units, has_clock=False)
        return cls(name, _as_in_file(_as_floats(time, f"{name}: time"), "time", units["time"]), rounded, units)

    def __len__(self) -> int:
        return len(self.time)

    def __repr__(self) -> str:
        time = [self._range_text("time", self.time)] if self.has_clock else ["no time"]
        channels = [self._range_text(name, values) for name, values in self.channels.items()]
        return f"<Recording '{self.name}': {len(self)} rows, {', '.join([*time, *channels])}>"

    def slice(self, start: float, stop: float) -> "Recording":
        """Return the rows with start <= time < stop, with unchanged times.

        Args:
            start: First time in s (row number if there is no clock).
            stop: End of the part in s (row number if there is no clock), which does not belong to it.

        Raises:
            InputError: If there is no such row.
        """
        first, last = np.searchsorted(self.time, (start, stop))
        unit = "s" if self.has_clock else "rows"
        if last <= first:
            ends = f"from {self.time[0]:g} to {self.time[-1]:g} {unit}"
            problem = f"no row lies in [{start:g}, {stop:g}) {unit}"
            raise InputError(f"{self.name}: {problem}: the recording runs {ends}, choose a part of that")
        channels = {name: values[first:last] for name, values in self.channels.items()}
        note = f"cut to {last - first} of {len(self)} rows, {start:g} <= time < {stop:g} {unit}"
        return replace(self, time=self.time[first:last], channels=channels, notes=(*self.notes, note))

    def resample(self, step: float, hold: Collection[str] = ()) -> "Recording":
        """Return the recording with equally spaced times, beginning with its first row.

        Args:
            step: Time between rows in s.
            hold: Channels that keep their last sample; the others are interpolated linearly.

        Raises:
            InputError: If the recording has no clock or no channel to hold, or the step is not possible.
        """
        if not self.has_clock:
            raise InputError(f"{self.name}: a path without a clock cannot be resampled in time: give it a time column")
        if not (step > 0 and np.isfinite(step)):
            raise InputError(f"{self.name}: a step of {step} s is not possible: give a positive one")
        count = int(np.floor((self.time[-1] - self.time[0]) / step * (1 + _STEP_ROUNDING))) + 1
        if count > _MAX_RESAMPLED_ROWS:
            raise InputError(f"{self.name}: a step of {step:g} s makes {count} rows: give a larger one")
        times = self.time[0] + step * np.arange(count)
        unknown = [name for name in hold if name not in self.channels]
        if unknown:
            hint = suggestion(unknown[0], self.channels)
            raise InputError(f"{self.name}: there is no channel '{unknown[0]}' to hold{hint}: name one of its channels")
        channels = {
            name: sample_channels(self, [name], times, "hold" if name in hold else "linear")[:, 0]
            for name in self.channels
        }
        resampled = Recording.from_arrays(self.name, times, channels, self.units)
        note = f"resampled from {len(self)} rows to {count}, every {step:g} s"
        return replace(resampled, sha256=self.sha256, notes=(*self.notes, note))

    def write(self, path: str | Path) -> None:
        """Write a .csv or .parquet file in the units of the recording, completely or not at all.

        Reading the file returns the same floats.

        Raises:
            InputError: For another ending, or if the file cannot be written.
        """
        write_table(Path(path), self._columns())

    def to_pandas(self) -> Any:
        """Return a DataFrame in the units of the recording, with the time as its index; reading it gives the same."""
        import pandas

        columns = self._columns()
        time_header = next(iter(columns))
        index = pandas.Index(columns.pop(time_header), name=time_header) if self.has_clock else None
        return pandas.DataFrame(columns, index=index)

    def _columns(self) -> dict[str, Floats]:
        """Return the columns in the units of the recording by header, with the time first."""
        values = ({"time": self.time} if self.has_clock else {}) | dict(self.channels)
        units = {name: self.units.get(name, channel_unit(name)) for name in values}
        return {f"{n} [{units[n]}]": from_si(column, units[n], channel_unit(n)) for n, column in values.items()}

    def _range_text(self, name: str, values: Floats) -> str:
        """Return a channel, its unit and its range, as text."""
        unit, finite = self.units.get(name, channel_unit(name)), values[np.isfinite(values)]
        if not len(finite):
            return f"{name} [{unit}] without values"
        low, high = from_si(np.array([finite.min(), finite.max()]), unit, channel_unit(name))
        return f"{name} [{unit}] {low:.4g} to {high:.4g}"


def sample_channels(
    recording: Recording, names: Sequence[str], times: Floats, interpolation: Literal["hold", "linear"]
) -> Floats:
    """Return channels at other times.

    Args:
        recording: The recording; before its first and after its last sample, that sample is used.
        names: Channels.
        times: Times, shape ``(m,)``, in s.
        interpolation: ``hold`` for the last sample at or before each time, up to rounding; ``linear`` for linear
            interpolation.

    Returns:
        Values, shape ``(m, len(names))``, in SI units (temperatures in degC).

    Raises:
        InputError: If a channel is missing, or the interpolation is unknown.
    """
    missing = [name for name in names if name not in recording.channels]
    if missing:
        hint = suggestion(missing[0], recording.channels)
        raise InputError(f"{recording.name}: there is no channel '{missing[0]}'{hint}: name one of its channels")
    check_interpolation(interpolation)
    times = np.asarray(times, float)
    result = np.empty((len(times), len(names)))
    if interpolation == "hold":
        shortest = np.diff(recording.time).min() if len(recording) > 1 else 0.0
        slack = max(_HOLD_SLACK * shortest, _HOLD_SPACINGS * np.spacing(abs(recording.time).max()))
        last = np.searchsorted(recording.time, times + slack, side="right") - 1
        for i, name in enumerate(names):
            result[:, i] = recording.channels[name][np.maximum(last, 0)]
    else:
        for i, name in enumerate(names):
            result[:, i] = np.interp(times, recording.time, recording.channels[name])
    return result


def _as_floats(values: Any, place: str) -> Floats:
    """Return values as an array of float64, without a copy where possible."""
    try:
        return np.asarray(values, float)
    except Exception as error:
        if is_tracing_error(error):
            raise traced_values_error(place) from None
        if isinstance(error, TypeError | ValueError):
            raise InputError(f"{place}: the values are not numbers: give an array of floats") from None
        raise


def _as_in_file(values: Floats, name: str, unit: str) -> Floats:
    """Round values to those that a column in ``unit`` can represent."""
    return to_si(from_si(values, unit, channel_unit(name)), unit, channel_unit(name))


def _read_only(values: Floats) -> Floats:
    view = values.view()
    view.flags.writeable = False
    return view
