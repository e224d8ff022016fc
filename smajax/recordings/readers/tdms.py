"""Reader of TDMS files of LabVIEW; needs nptdms, the extra ``io``.

A group is a recording, like a sheet of a workbook; its channels are columns, with the unit of ``unit_string``. Where
no channel is the time, it is that of the waveform properties: ``wf_start_offset + k wf_increment`` for row k.
"""

import datetime
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any, final

import numpy as np

from smajax.errors import InputError, first_line
from smajax.recordings.read_options import ReadOptions
from smajax.recordings.readers.base import Table, file_sha256, refuse_if_too_large, row_error
from smajax.recordings.readers.header_rows import replaced_headers
from smajax.recordings.readers.sheets import choose_sheets
from smajax.recordings.readers.time_stamps import StampColumn, seconds_of_times

_TIME_HEADER = "time [s]"


def open_groups(path: Path, options: ReadOptions) -> list["TdmsTable"]:
    """Open the groups of a file that are read: those that are named by ``sheet``, all of them, or the first with rows.

    Args:
        path: The file.
        options: Options of reading.

    Raises:
        InputError: If the file is not TDMS, or a group is missing or has no channel.
    """
    try:
        import nptdms
    except ImportError:
        cure = 'run pip install "smajax[io]", or export the file as CSV'
        raise InputError(f"{path}: TDMS files need nptdms: {cure}") from None
    try:
        groups = {group.name: group.channels() for group in nptdms.TdmsFile.read_metadata(path).groups()}
    except Exception as error:  # damaged files raise different types
        raise _unreadable(path, error) from None
    filled = [name for name, channels in groups.items() if any(len(channel) for channel in channels)]
    if not filled:
        raise InputError(f"{path}: no group has a channel with values: record at least two rows of data")
    names, notes = choose_sheets(path, options, filled, filled, "group")
    return [TdmsTable(path, name, groups[name], options, notes, several=len(names) > 1) for name in names]


@final
class TdmsTable(Table):
    """A group of a file; the first sample is row 1.

    Args:
        path: The file.
        group: Name of the group.
        channels: Its channels, without their values.
        options: Options of reading.
        notes: Notes on groups that are left out.
        several: Whether several groups are read, so that messages name this one.
    """

    first_row = 1
    label_kind = "group"

    def __init__(
        self,
        path: Path,
        group: str,
        channels: Sequence[Any],
        options: ReadOptions,
        notes: tuple[str, ...],
        *,
        several: bool,
    ):
        self.path: str = f"{path}: group '{group}'" if several else str(path)
        self._file, self._group = path, group
        self.label: str = group if several else ""
        self.notes = notes
        self._channels = list(channels)
        headers = [_header(channel) for channel in channels]
        self.headers: tuple[str, ...] = replaced_headers(path, headers, options)
        self.stamps: Mapping[int, StampColumn] = {
            k: StampColumn(None, datetime.date.min) for k, c in enumerate(channels) if c.dtype.kind in "mM"
        }
        if any(_clock(channel) for channel in channels):
            self.implied_time: int | None = len(self.headers)
            self.headers += (_TIME_HEADER,)

    def load(self, indices: Sequence[int], lenient: bool) -> list[np.ndarray]:
        """Return channels as columns."""
        used = [self._channels[index] for index in indices if index != self.implied_time] or self._channels[:1]
        for channel in used:
            if len(channel) != len(used[0]):
                counts = f"channel '{channel.name}' has {len(channel)} values and '{used[0].name}' {len(used[0])}"
                cure = "put channels of other rates into a group of their own, or ignore one"
                raise InputError(f"{self.path}: {counts}: {cure}")
        rows = len(used[0])
        refuse_if_too_large(self.path, rows, len(indices))
        if not rows:
            raise InputError(f"{self.path}: the channels have no values: record at least two rows of data")
        return [
            self._waveform_times(used, rows) if index == self.implied_time else self._column(index, lenient)
            for index in indices
        ]

    def sha256(self) -> str:
        """Return the SHA-256 of the file in hexadecimal."""
        return file_sha256(self._file)

    def _waveform_times(self, channels: Sequence[Any], rows: int) -> np.ndarray:
        """Return the times of the waveform properties, which have to be those of all channels that are read."""
        clocks = {channel.name: clock for channel in channels if (clock := _clock(channel))}
        if not clocks:
            names = ", ".join(channel.name for channel in channels)
            problem = f"none of the channels that are read ({names}) has a wf_increment"
            raise InputError(
                f"{self.path}: {problem}: name a time channel, or ignore '{_TIME_HEADER}' and set sample_period"
            )
        (first, clock), *others = clocks.items()
        for name, other in others:
            if other != clock:
                shown = [f"{increment:g} s from {start or offset}" for increment, offset, start in (clock, other)]
                problem = f"the clocks of channels '{first}' and '{name}' differ ({shown[0]} and {shown[1]})"
                cure = "put them into groups of their own, or ignore one"
                raise InputError(f"{self.path}: {problem}: {cure}")
        increment, offset, start = clock
        begins = f", from wf_start_time {start}" if start else ""
        self.notes: tuple[str, ...] = (
            *self.notes,
            f"time is every {increment:g} s, as the waveform properties say{begins}",
        )
        return offset + increment * np.arange(rows)

    def _column(self, index: int, lenient: bool) -> np.ndarray:
        import nptdms

        channel, place = self._channels[index], f"{self.path}: column '{self.headers[index]}'"
        try:
            with nptdms.TdmsFile.open(self._file) as file:
                values = np.asarray(file[self._group][channel.name][:])
        except Exception as error:  # damaged files raise different types
            raise _unreadable(self.path, error) from None
        if index in self.stamps:
            values = seconds_of_times(values)
        if values.dtype.kind not in "iuf":
            kind = "texts" if values.dtype.kind in "OUS" else f"of type {values.dtype.name}"
            raise InputError(f"{place}: the values are {kind} and not numbers: record numbers, or ignore the channel")
        numbers = np.array(values, float)
        bad = np.flatnonzero(~np.isfinite(numbers))
        if bad.size and not lenient:
            cell = f"row {bad[0] + 1}, column '{self.headers[index]}'"
            raise row_error(f"{self.path}: {cell}: the value is not finite")
        numbers[bad] = np.nan
        return numbers


def _header(channel: Any) -> str:
    """Return the name of a channel with its unit, if it has one."""
    unit = str(channel.properties.get("unit_string", "")).strip()
    name = channel.name.strip()
    return f"{name} [{unit}]" if unit and not set("[]") & set(name + unit) else name


def _clock(channel: Any) -> tuple[float, float, str] | None:
    """Return increment and offset in s, and the start as text; ``None`` without a waveform."""
    increment = float(channel.properties.get("wf_increment", 0.0))
    if not increment > 0 or not np.isfinite(increment):
        return None
    offset = float(channel.properties.get("wf_start_offset", 0.0))
    return increment, offset, str(channel.properties.get("wf_start_time", ""))


def _unreadable(path: Path | str, error: Exception) -> InputError:
    problem = f"the file is not readable as TDMS ({first_line(error)})"
    return InputError(f"{path}: {problem}: copy it again, or export it as CSV")
