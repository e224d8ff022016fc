"""``prediction.csv``: what was measured and what the model gives, row by row and recording by recording.

Columns: ``recording, role, time [s]`` (``row`` if the recordings have no clock), then each recorded channel as ``name [unit]`` in the unit
of its column, with the model's as ``name_model [unit]`` beside it where the model gives that channel. A cell is empty where a recording
lacks the channel, and where a simulation failed.
"""

import csv
import io
import re
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from itertools import pairwise
from pathlib import Path

import numpy as np

from smajax.errors import InputError
from smajax.recording import Floats, canonical_of
from smajax.units import CHANNELS, channel_of, from_si, to_si

_MODEL = "_model"
_HEADER = re.compile(r"(?P<name>[^\[\]]+?) \[(?P<unit>[^\[\]]*)\]")
# Of what the model gives beyond the recorded channels, these say most about it.
_TELLING = ("temperature", "stress", "strain")


@dataclass(frozen=True, eq=False)
class Series:
    """One recording with its model: arrays ``(n,)`` in ``units``, by channel; ``time`` has its unit there too, or is the row number."""

    name: str
    role: str
    time: Floats
    units: Mapping[str, str]
    measured: Mapping[str, Floats]
    model: Mapping[str, Floats]

    @property
    def clock(self) -> bool:
        """Whether ``time`` is a time."""
        return "time" in self.units

    def residual(self, channel: str) -> Floats:
        """Measured minus model."""
        return self.measured[channel] - self.model[channel]


def modelled_channels(observable: Iterable[str], signals: Iterable[str], recorded: Iterable[str]) -> list[str]:
    """The channels of the model that go into the table: all that were recorded, and temperature, stress and strain."""
    driving, there = set(signals), set(recorded)
    return [c for c in observable if c not in driving and (c in there or channel_of(c) in _TELLING)]


def to_series(name: str, role: str, time: Floats, measured: Mapping, model: Mapping, units: Mapping[str, str], *, clock: bool) -> Series:
    """A series from arrays in SI and degC; ``units`` are those of the file's columns, other channels get a usual one."""
    shown = {channel: units.get(channel) or usual_unit(channel) for channel in [*measured, *model]}
    if clock:
        shown = {"time": units.get("time", "s")} | shown
        time = from_si(time, shown["time"], "s")
    converted = [{c: _in_unit(np.asarray(v, float), shown[c], c) for c, v in side.items()} for side in (measured, model)]
    return Series(name, role, time, shown, *converted)


def usual_unit(channel: str) -> str:
    """The unit in which a channel is shown that no recording has."""
    kind = channel_of(channel) or channel
    return {"strain": "%", "displacement": "mm", "angle": "deg", "temperature": "degC"}.get(kind, CHANNELS[kind].units[0])


def write(path: Path, series: Sequence[Series]) -> None:
    """Writes the table. All series have a clock, or none; the first one's units hold for all of a channel's column."""
    clock = series[0].clock
    units: dict[str, str] = {}
    for one in series:
        for channel, unit in one.units.items():
            units.setdefault(channel, unit)
    channels = [c for c in units if c != "time"]
    recorded = [c for c in channels if any(c in s.measured for s in series)]
    modelled = [c for c in channels if any(c in s.model for s in series)]
    columns = []
    for channel in channels:
        columns += [(channel, False)] if channel in recorded else []
        columns += [(channel, True)] if channel in modelled else []
    head = ["recording", "role", f"time [{units['time']}]" if clock else "row"]
    head += [f"{c}{_MODEL if model else ''} [{units[c]}]" for c, model in columns]
    with path.open("w", encoding="utf-8", newline="") as file:
        csv.writer(file, lineterminator="\n").writerow(head)
        for one in series:
            prefix = io.StringIO()
            csv.writer(prefix, lineterminator="").writerow([one.name, one.role])
            cells = [list(map(repr, one.time.tolist())) if clock else list(map(str, range(len(one.time))))]
            for channel, model in columns:
                values = (one.model if model else one.measured).get(channel)
                cells.append([""] * len(one.time) if values is None else _texts(values, one.units[channel], units[channel], channel, model))
            file.writelines(f"{prefix.getvalue()},{','.join(row)}\n" for row in zip(*cells, strict=True))


def read(path: Path) -> list[Series]:
    """The series of a table that ``write`` wrote, in order. InputError if it is not one."""
    try:
        with path.open(encoding="utf-8", newline="") as file:
            rows = csv.reader(file)
            head = next(rows)
            body = list(rows)
        matches = [_HEADER.fullmatch(text) for text in head[3:]]
        if head[:2] != ["recording", "role"] or not all(matches) or not body:
            raise ValueError
        columns = [(m["name"], m["unit"]) for m in matches if m]
        clock = _HEADER.fullmatch(head[2])
        names = [tuple(row[:2]) for row in body]
        starts = [0, *(i for i in range(1, len(names)) if names[i] != names[i - 1]), len(names)]
        numbers = np.array([[float(cell) if cell else np.nan for cell in row[2:]] for row in body])
    except OSError as error:
        raise InputError(f"{path}: the file cannot be read ({error.strerror or error}): check the result folder") from None
    except (ValueError, StopIteration, IndexError, csv.Error):
        raise InputError(f"{path}: this is not a table of predictions as smajax writes it: run the fit again") from None
    found = []
    for first, last in pairwise(starts):
        units = {"time": clock["unit"]} if clock else {}
        measured, model = {}, {}
        for k, (name, unit) in enumerate(columns):
            values = numbers[first:last, k + 1]
            if np.all(np.isnan(values)):
                continue
            channel = name.removesuffix(_MODEL)
            units[channel] = unit
            (model if name.endswith(_MODEL) else measured)[channel] = values
        found.append(Series(names[first][0], names[first][1], numbers[first:last, 0], units, measured, model))
    return found


def _texts(values: Floats, unit: str, wanted: str, channel: str, model: bool) -> list[str]:
    """Cells of a column: measurements as the shortest text of the same float, the model's to ten digits."""
    if unit != wanted:
        values = _in_unit(to_si(values, unit, canonical_of(channel)), wanted, channel)
    return ["" if v != v else f"{v:.10g}" if model else repr(v) for v in values.tolist()]


def _in_unit(values: Floats, unit: str, channel: str) -> Floats:
    """Values in SI or degC in another unit; what is not finite becomes NaN."""
    result = np.full(values.shape, np.nan)
    good = np.isfinite(values)
    result[good] = from_si(values[good], unit, canonical_of(channel))
    return result
