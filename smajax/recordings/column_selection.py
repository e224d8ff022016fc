"""Columns that are left out before the others are assigned to channels: dates, implied times, and unmapped ones."""

from collections.abc import Mapping, Sequence
from pathlib import Path

from smajax.channels import channel_of
from smajax.errors import InputError, suggestion
from smajax.recordings.column_mapping import ChannelMap, name_and_unit
from smajax.recordings.read_options import ReadOptions
from smajax.recordings.readers.base import Table
from smajax.recordings.readers.time_stamps import StampColumn, is_like_stamp, join

# Header of a column of dates that is recognised, in any case.
_DATE_HEADER = "date"
# Name by which ``columns`` leaves a column out.
_LEFT_OUT = "-"
# Columns that a note lists by name, followed by the number of the others; chosen to keep the note on one line.
_COLUMNS_LISTED = 6


def select_columns(
    origin: Path | str, table: Table, mapping: Mapping[str, ChannelMap], ignore: Sequence[str], options: ReadOptions
) -> tuple[set[int], tuple[str, ...]]:
    """Return the numbers of the columns that are left out, and notes on them.

    A date next to times of day is joined to these, in ``table.stamps``.

    Args:
        origin: The file, or the name of the object, for messages.
        table: The table.
        mapping: Columns of channels, as in the rig file.
        ignore: Headers that are not read.
        options: Options of reading.

    Raises:
        InputError: If the column of dates is missing or has none, or no column of a bag is mapped.
    """
    times = [index for index, header in enumerate(table.headers) if _is_time(header, mapping)]
    implied = table.implied_time
    skipped = {implied} if implied is not None and any(index != implied for index in times) else set()
    blank = () if "" in ignore else _blank_columns(table)
    skipped |= set(blank)
    notes = tuple(f"column {k + 1}, with neither a header nor values in the first rows, was left out" for k in blank)
    if options.columns is not None:
        skipped |= {index for index, header in enumerate(table.headers) if header == _LEFT_OUT}
    date = _join_date(origin, table, times, ignore, options)
    if date is not None:
        skipped.add(date)
        pair = f"columns '{table.headers[date]}' and '{table.headers[times[0]]}'"
        pair = f"columns '{table.headers[date]}' and '{table.headers[times[0]]}'"
        notes = (*notes, f"{pair} were joined to date and time")
    if not table.leaves_out_unknown:
        return skipped, notes
    known = {index for index, header in enumerate(table.headers) if _is_channel(header, mapping)} | {implied}
    ignored = {k for k, header in enumerate(table.headers) if header in ignore or name_and_unit(header)[0] in ignore}
    unknown = [index for index in range(len(table.headers)) if index not in known | ignored]
    if unknown and known <= {implied}:
        names = _listed([table.headers[index] for index in unknown])
        example = table.headers[unknown[0]]
        cure = f'map one to a channel, as in force = {{column = "{example}", unit = "N"}} under [channels] in the rig'
        message = f"{origin}: no field is mapped to a channel: it has {names}: {cure}"
        raise InputError(message, code="no-column-mapped", cure=cure)
    if unknown:
        names = _listed([table.headers[index] for index in unknown])
        notes += (f"{len(unknown)} fields that are not mapped to channels were left out: {names}",)
    return skipped | set(unknown), notes


def _blank_columns(table: Table) -> list[int]:
    """Return the numbers of the columns that a delimiter at the end of each row makes, without header and values."""
    if not table.first_cells:
        return []
    blank = [index for index, header in enumerate(table.headers) if index and not header]
    return [k for k in blank if not any(k < len(cells) and cells[k] not in ("", None) for cells in table.first_cells)]


def _is_time(header: str, mapping: Mapping[str, ChannelMap]) -> bool:
    names = (header, name_and_unit(header)[0])
    return mapping["time"].column in names if "time" in mapping else names[1] == "time"


def _is_channel(header: str, mapping: Mapping[str, ChannelMap]) -> bool:
    names = (header, name_and_unit(header)[0])
    return channel_of(names[1]) is not None or any(source.column in names for source in mapping.values())


def _join_date(
    origin: Path | str, table: Table, times: Sequence[int], ignore: Sequence[str], options: ReadOptions
) -> int | None:
    """Return the number of the column of dates whose dates were joined to the times of day, if there is one."""
    name = options.date_column
    dates = [
        index
        for index, header in enumerate(table.headers)
        if header not in ignore
        and (header.lower() == _DATE_HEADER if name is None else name in (header, name_and_unit(header)[0]))
    ]
    if name is not None and not table.first_cells:
        if dates:
            cure = "join the dates to the times of day in one column, and leave date_column out"
            raise InputError(f"{origin}: date_column is for text files and workbooks: {cure}")
        return None
    if name is not None and not dates:
        hint = suggestion(name, table.headers)
        raise InputError(
            f"{origin}: there is no column '{name}' for date_column{hint}: it has {_listed(table.headers)}"
        )
    if not dates or len(times) != 1 or dates[0] == times[0]:
        return None
    date, time = dates[0], times[0]
    for cells in table.first_cells:
        if max(date, time) >= len(cells):
            continue
        first = join(cells[date], cells[time], options.time_format)
        if first is not None:
            stamps = {index: stamp for index, stamp in table.stamps.items() if index != date}
            table.stamps = stamps | {time: StampColumn(options.time_format, first, date)}
            return date
    is_stamp = any(date < len(cells) and is_like_stamp(str(cells[date])) for cells in table.first_cells)
    if name is None and not (is_stamp and time in table.stamps):
        return None
    problem = f"columns '{table.headers[date]}' and '{table.headers[time]}' are not read as date and time of day"
    cure = 'give the format of both with a space between, as in time_format = "%d.%m.%Y %H:%M:%S" under [recording]'
    raise InputError(f"{origin}: row {table.first_row}: {problem}: {cure}", code="date-format", cure=cure)


def _listed(names: Sequence[str]) -> str:
    more = len(names) - _COLUMNS_LISTED
    return ", ".join(names[:_COLUMNS_LISTED]) + (f" and {more} more" if more > 0 else "")
