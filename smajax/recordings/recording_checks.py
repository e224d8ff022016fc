"""Checks of a recording that is already read, or was made from arrays: it needs the channels of a rig, too."""

import dataclasses
from collections.abc import Mapping, Sequence
from typing import Literal

import numpy as np

from smajax.channels import channel_unit
from smajax.errors import InputError
from smajax.recordings.bad_rows import good_rows, split_rows
from smajax.recordings.column_mapping import ChannelMap, FileColumn, require_channels
from smajax.recordings.readers.base import repair_hint
from smajax.recordings.readers.memory import MemoryTable, content_sha256
from smajax.recordings.recording import Recording
from smajax.recordings.value_checks import check_changes, check_row_count, check_time


def check_recording(
    recording: Recording, names: Sequence[str], observed: Sequence[str], mapping: Mapping[str, ChannelMap]
) -> Recording:
    """Check that a recording can be used; its values are in internal units, whose scale is not checked again.

    Args:
        recording: The recording.
        names: Required channels, with ``time`` if it must have a clock, which then increases from row to row.
        observed: Channels that must change; they may be NaN in rows in which they were not measured.
        mapping: Column and unit by channel, as in the rig file, for messages.

    Returns:
        The recording, with the SHA-256 of its content if it came from no file.

    Raises:
        InputError: If a channel is missing, time does not increase, an input is not finite, or an observed channel is
            constant.
    """
    values = ({"time": recording.time} if recording.has_clock else {}) | dict(recording.channels)
    columns = {
        name: FileColumn(k, f"{name} [{channel_unit(name)}]", name, channel_unit(name)) for k, name in enumerate(values)
    }
    require_channels(recording.name, list(columns.values()), names, mapping)
    check_row_count(recording.name, len(recording))
    for name in dict.fromkeys(["time", *names]):
        if name not in values:
            continue
        header = columns[name].header
        missing = np.flatnonzero(~np.isfinite(values[name]))
        if missing.size and name not in observed:
            place, cure = f"{recording.name}: row {missing[0]}, column '{header}'", repair_hint(MemoryTable.drop_option)
            raise InputError(f"{place}: the value {values[name][missing[0]]} is not a finite number: {cure}")
        if missing.size == len(recording):
            raise InputError(f"{recording.name}: column '{header}': no value is a finite number: correct them")
        if name in observed:
            check_changes(recording.name, columns[name], values[name][np.isfinite(values[name])])

    def time_place(row: int) -> str:
        return f"{recording.name}: row {row}, column 'time [s]'"

    check_time(recording.time, "s", time_place, MemoryTable.drop_option, may_repeat="time" not in names)
    if recording.sha256:
        return recording
    headers = [column.header for column in columns.values()]
    return dataclasses.replace(recording, sha256=content_sha256(headers, list(values.values())))


def parts_without_bad_rows(
    recording: Recording, names: Sequence[str], on_bad_rows: Literal["drop", "split"], may_repeat: bool = False
) -> list[Recording]:
    """Return a recording without the rows in which a channel is not finite or time does not increase.

    Args:
        recording: The recording.
        names: Channels that have to be finite.
        on_bad_rows: ``drop`` leaves the other rows out; ``split`` also begins a recording where the clock begins again.
        may_repeat: Whether a time may be that of the row before, as in a path.

    Raises:
        InputError: If most rows are to be dropped, or no part has two rows.
    """
    values = {n: recording.channels[n] for n in names if n in recording.channels}
    values |= {"time": recording.time} if recording.has_clock else {}
    if not values:
        return [recording]
    if on_bad_rows == "drop":
        parts = [good_rows(recording.name, values, 0, may_repeat)]
    else:
        parts = split_rows(recording.name, values, 0, may_repeat)
    result = []
    for k, (rows, notes) in enumerate(parts, 1):
        if rows is None:
            return [recording]
        name = recording.name if len(parts) == 1 else f"{recording.name} part {k}"
        channels = {n: column[rows] for n, column in recording.channels.items()}
        time = recording.time[rows] if recording.has_clock else np.arange(len(rows), dtype=float)
        notes = (*recording.notes, *notes)
        result.append(dataclasses.replace(recording, name=name, time=time, channels=channels, notes=notes))
    return result
