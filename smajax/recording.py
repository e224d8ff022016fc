"""Recording: one measured time series, or one path through states, with named channels in SI units.

A recording file has one header row, ``name [unit]`` per column, and numbers below (tables/ reads the formats). Reading checks all that can
be known without the rig, so that whatever comes after can trust it: every channel known and convertible, every number finite, time
running on. A bad file ends in one sentence with file, row and column. Nothing is dropped unless asked for, and then it is counted.
"""

import os
import re
from collections.abc import Callable, Collection, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from types import MappingProxyType
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from smajax.errors import InputError, nearest
from smajax.plausible import check_scale
from smajax.tables import open_table
from smajax.tables.base import REPAIR
from smajax.units import CHANNELS, channel_of, conversion, from_si, to_si

Floats = NDArray[np.float64]

_HEADER = re.compile(r"(?P<name>[^\[\]]*?)\s*(?:\[(?P<unit>[^\[\]]*)\])?")
# What people write at the head of a column when they mean one of our channels; used for advice only.
_SLIPS = 2  # rows whose time runs back: more are rows out of order
_MEANT = {"t": "time", "i": "current", "u": "voltage", "v": "voltage", "p": "power", "pwm": "duty", "temp": "temperature", "f": "force"}
_ROWS_LISTED = 5
_ROWS_WRITTEN_AT_ONCE = 65536


@dataclass(frozen=True)
class ChannelMap:
    """Where a channel comes from, as ``[channels]`` in a rig says it: the column's header, its unit, and whether its scale is unusual.

    Without ``unit`` the header has to have one. ``any_scale`` switches off the check against the values that benches give.
    """

    column: str
    unit: str | None = None
    any_scale: bool = False


@dataclass(frozen=True, eq=False)
class Recording:
    """A recording with n rows.

    ``time`` (n,) is in s and strictly increasing, or the row number 0, 1, 2, ... if the recording is a path without a clock.
    ``channels`` maps names (``current``, ``current_2``) to read-only arrays (n,) in SI units, temperatures in degC.
    ``units`` are those of the columns in the file, in which results are reported; it has ``time`` too, if there is a clock.
    A channel made of arrays may be NaN at rows at which it was not measured; a file that is read has a number in every row.
    ``sha256`` is that of the file's bytes (empty if there was no file), ``notes`` lists what was changed on request.
    """

    name: str
    time: Floats
    channels: Mapping[str, Floats]
    units: Mapping[str, str]
    sha256: str = ""
    has_clock: bool = True
    notes: tuple[str, ...] = ()

    def __post_init__(self) -> None:
        for name, values in self.channels.items():
            if values.shape != self.time.shape:
                raise InputError(f"{self.name}: channel '{name}' has shape {values.shape} and time {self.time.shape}: make them equal")
        object.__setattr__(self, "time", _read_only(self.time))
        object.__setattr__(self, "channels", MappingProxyType({name: _read_only(values) for name, values in self.channels.items()}))
        object.__setattr__(self, "units", MappingProxyType(dict(self.units)))

    @classmethod
    def from_arrays(cls, name: str, time: Floats | None, channels: Mapping[str, Floats], units: Mapping[str, str]) -> "Recording":
        """A recording of arrays (n,) in SI units (degC), reported in ``units``; without ``time`` a path.

        Values are rounded to what a column of float64 in these units can hold, so that written and read again they stay what they are.
        """
        units = {channel: units.get(channel, canonical_of(channel)) for channel in ([] if time is None else ["time"]) + list(channels)}
        held = {channel: _as_in_file(np.asarray(values, float), channel, units[channel]) for channel, values in channels.items()}
        if time is None:
            return cls(name, np.arange(len(next(iter(held.values()))), dtype=float), held, units, has_clock=False)
        return cls(name, _as_in_file(np.asarray(time, float), "time", units["time"]), held, units)

    def __len__(self) -> int:
        return len(self.time)

    def slice(self, start: float, stop: float) -> "Recording":
        """The rows with start <= time < stop (s; row numbers if there is no clock), with their times as they are."""
        first, last = np.searchsorted(self.time, (start, stop))
        unit = "s" if self.has_clock else "rows"
        if last <= first:
            ends = f"from {self.time[0]:g} to {self.time[-1]:g} {unit}"
            raise InputError(f"{self.name}: no row lies in [{start:g}, {stop:g}) {unit}: the recording runs {ends}, choose a part of that")
        channels = {name: values[first:last] for name, values in self.channels.items()}
        note = f"cut to {last - first} of {len(self)} rows, {start:g} <= time < {stop:g} {unit}"
        return replace(self, time=self.time[first:last], channels=channels, notes=(*self.notes, note))

    def resample(self, step: float, hold: Collection[str] = ()) -> "Recording":
        """The recording at every ``step`` (s) from its first time on: channels in ``hold`` keep their last sample, others are linear."""
        if not self.has_clock:
            raise InputError(f"{self.name}: a path without a clock cannot be resampled in time: give it a time column")
        if not (step > 0 and np.isfinite(step)):
            raise InputError(f"{self.name}: a step of {step} s is not possible: give a positive one")
        count = int(np.floor((self.time[-1] - self.time[0]) / step * (1 + 1e-12))) + 1
        if count > 100_000_000:
            raise InputError(f"{self.name}: a step of {step:g} s makes {count} rows: give a larger one")
        times = self.time[0] + step * np.arange(count)
        unknown = [name for name in hold if name not in self.channels]
        if unknown:
            raise InputError(f"{self.name}: there is no channel '{unknown[0]}' to hold{nearest(unknown[0], self.channels)}: name one of it")
        channels = {name: inputs_at(self, [name], times, "hold" if name in hold else "linear")[:, 0] for name in self.channels}
        made = Recording.from_arrays(self.name, times, channels, self.units)
        return replace(made, sha256=self.sha256, notes=(*self.notes, f"resampled from {len(self)} rows to {count}, every {step:g} s"))

    def write(self, path: str | Path) -> None:
        """Write a .csv or .parquet file, in the recording's units, which ``read`` takes back to the same floats; complete or not at all."""
        path = Path(path)
        columns = {"time": self.time} if self.has_clock else {}
        columns |= self.channels
        in_file = {
            f"{name} [{self.units[name]}]": from_si(values, self.units[name], canonical_of(name)) for name, values in columns.items()
        }
        part = path.with_name(f".{path.name}.{os.getpid()}.part")
        try:
            if path.suffix.lower() == ".parquet":
                _write_parquet(part, in_file)
            elif path.suffix.lower() in (".csv", ".txt"):
                _write_csv(part, in_file)
            else:
                raise InputError(f"{path}: recordings are written as .csv or .parquet: choose one of these endings")
            os.replace(part, path)
        except OSError as error:
            raise InputError(f"{path}: the file cannot be written ({error.strerror or error}): check the folder") from None
        finally:
            part.unlink(missing_ok=True)


@dataclass(frozen=True)
class _Column:
    """A wanted column of a file: the channel ``name`` with its ``unit`` there."""

    index: int
    header: str
    name: str
    unit: str
    any_scale: bool = False
    mapped: bool = False
    note: str = ""


def read(
    path: str | Path,
    *,
    mapping: Mapping[str, ChannelMap] | None = None,
    ignore: Sequence[str] = (),
    required: Sequence[str] = (),
    observed: Sequence[str] = (),
    clock: bool = True,
    skip_rows: int = 0,
    delimiter: str = ",",
    decimal: str = ".",
    sheet: str | None = None,
    headers: Sequence[str] | None = None,
    drop_bad_rows: bool = False,
) -> Recording:
    """Read and check the recording in ``path`` (.csv, .txt, .mat, .parquet, .xlsx).

    ``mapping`` names the columns of channels whose headers are not ``name [unit]``, ``ignore`` the columns that are left out on purpose;
    every other column has to be a known channel. ``required`` and ``observed`` channels have to be there, observed ones have to change.
    ``headers`` are those of a text file without a header row. Without ``clock`` the recording may do without time. ``drop_bad_rows``
    leaves out rows that are ragged, blank or unreadable in a wanted column, or whose time does not increase, and notes how many and
    which. Raises InputError: one sentence, the place, the cure.
    """
    path = Path(path)
    table = open_table(path, skip_rows=skip_rows, delimiter=delimiter, decimal=decimal, sheet=sheet, headers=headers)
    columns = _assign(path, table.headers, mapping or {}, ignore)
    _require(path, columns, [*required, *observed, *(["time"] if clock else [])], mapping or {})
    try:
        values = dict(zip((c.name for c in columns), table.load([c.index for c in columns], drop_bad_rows), strict=True))
    except OSError as error:
        raise InputError(f"{path}: the file cannot be read to its end ({error.strerror or error}): copy it anew") from None
    rows, notes = None, tuple(column.note for column in columns if column.note)
    if drop_bad_rows:
        rows, dropped = _good_rows(path, values, table.first_row)
        notes += dropped
        if rows is not None:
            values = {name: column[rows] for name, column in values.items()}

    def place(column: _Column, i: int) -> str:
        return f"{path}: row {table.first_row + int(i if rows is None else rows[i])}, column '{column.header}'"

    with np.errstate(over="ignore", invalid="ignore"):
        _check(path, columns, values, observed, place)
        for column in columns:
            if conversion(column.unit, canonical_of(column.name)) != (1, 0):
                values[column.name] = to_si(values[column.name], column.unit, canonical_of(column.name))
            if not np.isfinite(values[column.name]).all():
                raise InputError(f"{path}: column '{column.header}': numbers too large for {canonical_of(column.name)}: correct the unit")
    has_clock = "time" in values
    time = values.pop("time") if has_clock else np.arange(len(next(iter(values.values()))), dtype=float)
    units = {column.name: column.unit for column in columns}
    return Recording(path.name, time, values, units, table.sha256(), has_clock, notes)


def inputs_at(recording: Recording, names: Sequence[str], times: Floats, interpolation: Literal["hold", "linear"]) -> Floats:
    """The channels ``names`` at ``times`` (m,), as an array (m, len(names)) in SI units.

    ``hold`` gives the last sample at or before each time; a time that misses a sample by rounding (1e-6 of the shortest step) counts as
    at it. Outside the recording the first and the last sample hold.
    """
    missing = [name for name in names if name not in recording.channels]
    if missing:
        raise InputError(f"{recording.name}: there is no channel '{missing[0]}'{nearest(missing[0], recording.channels)}: name one of it")
    times = np.asarray(times, float)
    result = np.empty((len(times), len(names)))
    if interpolation == "hold":
        shortest = np.diff(recording.time).min() if len(recording) > 1 else 0.0
        slack = max(1e-6 * shortest, 4 * np.spacing(abs(recording.time).max()))
        last = np.searchsorted(recording.time, times + slack, side="right") - 1
        for i, name in enumerate(names):
            result[:, i] = recording.channels[name][np.maximum(last, 0)]
    elif interpolation == "linear":
        for i, name in enumerate(names):
            result[:, i] = np.interp(times, recording.time, recording.channels[name])
    else:
        raise InputError(f"interpolation = '{interpolation}' is not known: it is 'hold' or 'linear'")
    return result


def canonical_of(name: str) -> str:
    """The unit that the channel ``name`` has inside smajax."""
    kind = channel_of(name)
    if kind is None:
        raise InputError(f"'{name}' is not a known channel{_advice(name)}: the known ones are {', '.join(CHANNELS)}, and NAME_1, NAME_2")
    return CHANNELS[kind].unit


def _advice(name: str) -> str:
    if re.search(r"_0+\d*$", name) and channel_of(name.rpartition("_")[0]):
        return f" (did you mean '{name.rpartition('_')[0]}_1'?)"
    base, _, number = name.lower().rpartition("_") if re.search(r"_\d+$", name) else (name.lower(), "", "")
    meant = _MEANT.get(base)
    suffix = f"_{number}" if number else ""
    return f" (did you mean '{meant}{suffix}'?)" if meant else nearest(base + suffix, [known + suffix for known in CHANNELS])


def _assign(path: Path, headers: Sequence[str], mapping: Mapping[str, ChannelMap], ignore: Sequence[str]) -> list[_Column]:
    """Which columns are which channels, in the order of the file; every header is a channel, mapped or ignored, or it is refused."""
    columns: list[_Column] = []
    for name in mapping:
        if channel_of(name) is None:
            raise InputError(f"{path}: [channels] {name} in the rig is not a known channel{_advice(name)}: choose of {', '.join(CHANNELS)}")
    for index, header in enumerate(headers):
        match = _HEADER.fullmatch(header)
        name, unit = (match["name"], match["unit"]) if match else (header, None)
        mapped = {channel: source for channel, source in mapping.items() if source.column in (header, name)}
        if header in ignore or name in ignore:
            if mapped:
                raise InputError(f"{path}: column '{header}' is both ignored and mapped to {next(iter(mapped))}: decide for one of them")
            continue
        if not header:
            raise InputError(f"{path}: column {index + 1} has no header: write one like 'current [A]', or take the column out")
        for channel, source in mapped.items():
            used = _unit_of(path, header, channel, source.unit or unit)
            note = f"column '{header}' was read in {used}, as the rig says" if unit and unit.strip() != used else ""
            columns.append(_Column(index, header, channel, used, source.any_scale, True, note))
        if not mapped:
            if channel_of(name) is None:
                known = [other for other in headers if channel_of(other.partition("[")[0].strip()) or other in ignore]
                lower = "" if known or mapping else ", or set skip_rows if the header comes further down"
                raise InputError(
                    f"{path}: column '{header}' is not a known channel{_advice(name)}: rename it, map it under [channels] in the rig, "
                    f'or leave it out with [channels] ignore = ["{header}"]{lower}'
                )
            columns.append(_Column(index, header, name, _unit_of(path, header, name, unit)))
    first_of: dict[str, _Column] = {}
    for column in columns:
        first = first_of.setdefault(column.name, column)
        if first is not column:
            both = f"columns {first.index + 1} ('{first.header}') and {column.index + 1} ('{column.header}')"
            raise InputError(f"{path}: {both} are both {column.name}: number them {column.name}_1 and {column.name}_2, or ignore one")
    if not columns:
        raise InputError(f"{path}: every column is ignored: leave at least one in, of {', '.join(headers)}")
    return columns


def _unit_of(path: Path, header: str, name: str, unit: str | None) -> str:
    canonical = canonical_of(name)
    if not unit or not unit.strip():
        if canonical == "1":
            return "1"
        example = f"{name} [{CHANNELS[channel_of(name) or name].units[0]}]"
        raise InputError(f"{path}: column '{header}' has no unit: write the header like '{example}', or give the unit under [channels]")
    try:
        conversion(unit.strip(), canonical)
    except InputError as error:
        raise InputError(f"{path}: column '{header}': {error}") from None
    return unit.strip()


def _require(path: Path, columns: Sequence[_Column], names: Sequence[str], mapping: Mapping[str, ChannelMap]) -> None:
    there = [column.name for column in columns]
    for name in names:
        if channel_of(name) is None:
            raise InputError(f"{path}: '{name}' is not a known channel{_advice(name)}: choose of {', '.join(CHANNELS)}")
        if name not in there:
            source = f", which the rig maps to column '{mapping[name].column}'," if name in mapping else ""
            example = f"{name} [{CHANNELS[channel_of(name) or name].units[0]}]"
            raise InputError(
                f"{path}: the channel {name}{source} is missing{nearest(name, there)}: the file has {', '.join(there)}, so add a column "
                f"'{example}' or map one to {name} under [channels] in the rig"
            )


def _good_rows(path: Path, values: Mapping[str, Floats], first_row: int) -> tuple[NDArray[np.intp] | None, tuple[str, ...]]:
    """The indices of the rows to keep (None for all) and the notes on the others."""
    readable = np.all([np.isfinite(column) for column in values.values()], axis=0)
    good = readable.copy()
    if "time" in values:
        time = np.where(readable, values["time"], -np.inf)
        good[1:] &= time[1:] > np.maximum.accumulate(time)[:-1]
    if good.all():
        return None, ()
    if 2 * np.count_nonzero(good) < len(good):
        raise InputError(
            f"{path}: {np.count_nonzero(~good)} of {len(good)} rows are bad, the first of them row {first_row + int(np.argmin(good))}, "
            "too many to drop: correct the file"
        )
    notes = []
    for what, bad in (("with a blank or unreadable cell", ~readable), ("in which time does not increase", readable & ~good)):
        if bad.any():
            where = np.flatnonzero(bad)
            listed = ", ".join(str(first_row + i) for i in where[:_ROWS_LISTED])
            more = f" and {len(where) - _ROWS_LISTED} more" if len(where) > _ROWS_LISTED else ""
            notes.append(f"{len(where)} of {len(good)} rows {what} dropped on request: row {listed}{more}")
    return np.flatnonzero(good), tuple(notes)


def _check(
    path: Path, columns: Sequence[_Column], values: Mapping[str, Floats], observed: Sequence[str], place: Callable[[_Column, int], str]
) -> None:
    """Refuse what cannot be a recording: a single row, time that does not run on, a dead sensor, a wrong scale."""
    rows = len(values[columns[0].name])
    if rows < 2:
        raise InputError(f"{path}: the recording has a single row of data: record at least two")
    peaks: dict[str | None, float] = {}
    for column in columns:
        one, unit = values[column.name], column.unit
        peak = np.abs(to_si(np.array([one.min(), one.max()]), unit, canonical_of(column.name))).max()
        peaks[channel_of(column.name)] = max(peak, peaks.get(channel_of(column.name), 0.0))
    for column in columns:
        one = values[column.name]
        if column.name == "time":
            wrong = np.flatnonzero(one[1:] <= one[:-1])
            if wrong.size:
                i = int(wrong[0]) + 1
                what = f"stands still at {one[i]:.15g}" if one[i] == one[i - 1] else f"runs back from {one[i - 1]:.15g} to {one[i]:.15g}"
                cure = "sort the rows by time, or leave such rows out with --drop-bad-rows" if wrong.size > _SLIPS else REPAIR
                raise InputError(f"{place(column, i)}: time {what} {column.unit}: {cure}")
        if not column.any_scale:
            cure = f'[channels] {column.name} to unit = "{{unit}}"' if column.mapped else f"the header to '{column.name} [{{unit}}]'"
            check_scale(one, column.name, column.unit, peaks[channel_of(column.name)], lambda i, column=column: place(column, i), cure)
        if column.name in observed and one.min() == one.max():
            raise InputError(
                f"{path}: column '{column.header}': the observed channel {column.name} is {one[0]:.15g} {column.unit} in all {rows} rows: "
                "check the sensor, or take it out of [fit] observe"
            )


def _as_in_file(values: Floats, name: str, unit: str) -> Floats:
    return to_si(from_si(values, unit, canonical_of(name)), unit, canonical_of(name))


def _read_only(values: Floats) -> Floats:
    view = values.view()
    view.flags.writeable = False
    return view


def _write_csv(path: Path, columns: Mapping[str, Floats]) -> None:
    with path.open("w", encoding="utf-8", newline="\n") as file:
        file.write(",".join(columns) + "\n")
        for start in range(0, len(next(iter(columns.values()))), _ROWS_WRITTEN_AT_ONCE):
            texts = [map(repr, column[start : start + _ROWS_WRITTEN_AT_ONCE].tolist()) for column in columns.values()]
            file.writelines(",".join(row) + "\n" for row in zip(*texts, strict=True))


def _write_parquet(path: Path, columns: Mapping[str, Floats]) -> None:
    from smajax.tables.parquet import pyarrow_parquet

    parquet = pyarrow_parquet(path)
    import pyarrow

    parquet.write_table(pyarrow.table(dict(columns)), path)
