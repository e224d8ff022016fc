"""``prediction.csv``: measured and modelled channels, row by row and recording by recording.

Columns: ``recording``, ``role`` and ``time [s]`` (``row`` if the recordings have no clock), then each recorded channel
as ``name [unit]`` in the unit of its column, followed by the model's as ``name_model [unit]`` if the model has that
channel. A cell is empty if a recording lacks the channel, or if the simulation failed there.
"""

import csv
import io
import re
from array import array
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np

from smajax.channels import CHANNELS, channel_of, channel_unit
from smajax.errors import InputError
from smajax.recordings.recording import Floats, Recording
from smajax.units import from_si, to_si

_MODEL_SUFFIX = "_model"
_HEADER = re.compile(r"(?P<name>[^\[\]]+?) \[(?P<unit>[^\[\]]*)\]")
# Name of a series that is one of several for a recording; neither models nor fits have brackets in their names.
_LABEL = re.compile(r"(?P<recording>.*) \((?P<variant>[^()]*)\)", re.DOTALL)
# Channels of the model that are in the table even if they were not recorded.
_INTERNAL_CHANNELS = ("temperature", "stress", "strain")
# Rows whose cells are made at a time: as text a row takes a kilobyte, so that a million of them would take a gigabyte.
_BLOCK = 10_000
_USUAL_UNITS = {"strain": "%", "displacement": "mm", "angle": "deg", "temperature": "degC"}


@dataclass(frozen=True, eq=False)
class Series:
    """Measured and modelled channels of one recording.

    Attributes:
        name: Name of the recording.
        role: Its role, such as ``train`` or ``holdout``.
        time: Times in the unit of ``time``, or row numbers without a clock, shape ``(n,)``.
        units: Units by channel; with that of ``time`` if there is a clock.
        measured: Measured channels by name, in their units, shape ``(n,)`` each.
        model: Modelled channels by name, in their units, shape ``(n,)`` each.
    """

    name: str
    role: str
    time: Floats
    units: Mapping[str, str]
    measured: Mapping[str, Floats]
    model: Mapping[str, Floats]

    @property
    def has_clock(self) -> bool:
        """Whether ``time`` is a time, not a row number."""
        return "time" in self.units

    def residual(self, channel: str) -> Floats:
        """Return the residual, measured minus model, in the channel's unit, shape ``(n,)``."""
        return self.measured[channel] - self.model[channel]


def variant_label(recording: str, variant: str) -> str:
    """Return the name of a series that is one of several for a recording, such as "train.csv (before)"."""
    return f"{recording} ({variant})"


def split_label(label: str) -> tuple[str, str]:
    """Return recording and variant of a name by ``variant_label``; without a variant, the name and an empty text."""
    match = _LABEL.fullmatch(label)
    return (match["recording"], match["variant"]) if match else (label, "")


def modelled_channels(observable: Iterable[str], signals: Iterable[str], recorded: Iterable[str]) -> list[str]:
    """List the model's channels of the table: all that were recorded, and temperature, stress and strain.

    Args:
        observable: Channels that can be observed on the plant.
        signals: Its inputs, which are left out.
        recorded: Channels of the recording.
    """
    inputs, measured = set(signals), set(recorded)
    return [c for c in observable if c not in inputs and (c in measured or channel_of(c) in _INTERNAL_CHANNELS)]


def make_series(
    name: str,
    role: str,
    time: Floats,
    measured: Mapping[str, Any],
    model: Mapping[str, Any],
    units: Mapping[str, str],
    *,
    has_clock: bool,
) -> Series:
    """Make a series from arrays in SI units and degC.

    Args:
        name: Name of the recording.
        role: Its role.
        time: Times in s, or row numbers, shape ``(n,)``.
        measured: Measured channels by name, shape ``(n,)`` each.
        model: Modelled channels by name, shape ``(n,)`` each.
        units: Units of the file's columns; other channels get their usual unit.
        has_clock: Whether ``time`` is a time.
    """
    shown = {channel: units.get(channel) or usual_unit(channel) for channel in [*measured, *model]}
    if has_clock:
        shown = {"time": units.get("time", "s")} | shown
        time = from_si(time, shown["time"], "s")
    converted = [
        {c: _in_unit(np.asarray(v, float), shown[c], c) for c, v in side.items()} for side in (measured, model)
    ]
    return Series(name, role, time, shown, *converted)


def recording_series(recording: Recording, role: str, model: Mapping[str, Any]) -> Series:
    """Make the series of a recording with all its channels.

    Args:
        recording: The recording.
        role: Its role.
        model: Modelled channels by name, in SI units and degC, shape ``(n,)`` each.
    """
    return make_series(
        recording.name,
        role,
        recording.time,
        recording.channels,
        model,
        recording.units,
        has_clock=recording.has_clock,
    )


def usual_unit(channel: str) -> str:
    """Return the unit in which a channel is shown if no recording gives its unit."""
    kind = channel_of(channel) or channel
    return _USUAL_UNITS.get(kind, CHANNELS[kind].units[0])


def write_predictions(path: Path, series: Sequence[Series]) -> None:
    """Write the table of predictions.

    Args:
        path: The file.
        series: The recordings, all with or all without a clock; a column has the first unit of its channel.
    """
    has_clock = series[0].has_clock
    units: dict[str, str] = {}
    for recording in series:
        for channel, unit in recording.units.items():
            units.setdefault(channel, unit)
    columns = _columns([c for c in units if c != "time"], series)
    head = ["recording", "role", f"time [{units['time']}]" if has_clock else "row"]
    head += [f"{c}{_MODEL_SUFFIX if of_model else ''} [{units[c]}]" for c, of_model in columns]
    with path.open("w", encoding="utf-8", newline="") as file:
        csv.writer(file, lineterminator="\n").writerow(head)
        for recording in series:
            file.writelines(_rows(recording, columns, units))


def read_predictions(path: Path) -> list[Series]:
    """Read the table that ``write_predictions`` wrote.

    Returns:
        The series in the order of the table.

    Raises:
        InputError: If the file cannot be read, or is not such a table.
    """
    try:
        with path.open(encoding="utf-8", newline="") as file:
            rows = csv.reader(file)
            head = next(rows)
            names, starts, numbers = _read_rows(rows, len(head))
        matches = [_HEADER.fullmatch(text) for text in head[3:]]
        if head[:2] != ["recording", "role"] or not all(matches) or not names:
            raise ValueError
        columns = [(m["name"], m["unit"]) for m in matches if m]
        clock = _HEADER.fullmatch(head[2])
    except OSError as error:
        raise InputError(
            f"{path}: the file cannot be read ({error.strerror or error}): check the result folder"
        ) from None
    except (ValueError, StopIteration, IndexError, csv.Error):
        raise InputError(f"{path}: this is not a table of predictions as smajax writes it: run the fit again") from None
    units = {"time": clock["unit"]} if clock else {}
    return [
        _series_of(name, numbers[first:last], columns, units)
        for name, (first, last) in zip(names, pairwise(starts), strict=True)
    ]


def _read_rows(rows: Iterator[list[str]], width: int) -> tuple[list[tuple[str, str]], list[int], Floats]:
    """Name and role of each series, the row at which each starts, with the end, and all numbers (rows, columns)."""
    names: list[tuple[str, str]] = []
    starts: list[int] = []
    numbers, count = array("d"), 0
    for row in rows:
        if len(row) != width:
            raise ValueError
        if not names or (row[0], row[1]) != names[-1]:
            names.append((row[0], row[1]))
            starts.append(count)
        numbers.extend([float(cell) if cell else np.nan for cell in row[2:]])
        count += 1
    return names, [*starts, count], np.frombuffer(numbers).reshape(count, width - 2)


def _columns(channels: Sequence[str], series: Sequence[Series]) -> list[tuple[str, bool]]:
    """Channel of each column, and whether it is the model's; the measured channel is first."""
    columns = []
    for channel in channels:
        if any(channel in s.measured for s in series):
            columns.append((channel, False))
        if any(channel in s.model for s in series):
            columns.append((channel, True))
    return columns


def _rows(series: Series, columns: Sequence[tuple[str, bool]], units: Mapping[str, str]) -> Iterator[str]:
    """Lines of the table for one recording."""
    prefix = io.StringIO()
    csv.writer(prefix, lineterminator="").writerow([series.name, series.role])
    for first in range(0, len(series.time), _BLOCK):
        block = slice(first, min(first + _BLOCK, len(series.time)))
        rows = range(block.start, block.stop)
        cells = [list(map(repr, series.time[block].tolist())) if series.has_clock else list(map(str, rows))]
        for channel, of_model in columns:
            values = (series.model if of_model else series.measured).get(channel)
            if values is None:
                cells.append([""] * len(rows))
            else:
                cells.append(_format_cells(values[block], series.units[channel], units[channel], channel, of_model))
        for row in zip(*cells, strict=True):
            yield f"{prefix.getvalue()},{','.join(row)}\n"


def _series_of(
    name_and_role: tuple[str, str], numbers: Floats, columns: Sequence[tuple[str, str]], units: Mapping[str, str]
) -> Series:
    """Series of its rows, shape ``(n, 1 + columns)``; columns without any number are left out."""
    series_units = dict(units)
    measured, model = {}, {}
    for k, (name, unit) in enumerate(columns):
        values = numbers[:, k + 1]
        if np.all(np.isnan(values)):
            continue
        channel = name.removesuffix(_MODEL_SUFFIX)
        series_units[channel] = unit
        (model if name.endswith(_MODEL_SUFFIX) else measured)[channel] = values
    return Series(*name_and_role, numbers[:, 0], series_units, measured, model)


def _format_cells(values: Floats, unit: str, column_unit: str, channel: str, of_model: bool) -> list[str]:
    """Cells of a column: a measurement as the shortest text of the same float, a model value to ten digits."""
    if unit != column_unit:
        values = _in_unit(to_si(values, unit, channel_unit(channel)), column_unit, channel)
    return ["" if v != v else f"{v:.10g}" if of_model else repr(v) for v in values.tolist()]


def _in_unit(values: Floats, unit: str, channel: str) -> Floats:
    """Values in SI or degC converted to another unit; values that are not finite become NaN."""
    result = np.full(values.shape, np.nan)
    finite = np.isfinite(values)
    result[finite] = from_si(values[finite], unit, channel_unit(channel))
    return result
