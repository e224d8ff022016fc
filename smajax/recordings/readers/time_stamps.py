"""Time stamps: dates of ISO 8601, times of day, and formats that are named, as seconds since the first one."""

import datetime
import re
from collections.abc import Callable, Sequence
from typing import Any, final

import numpy as np
from numpy.typing import NDArray

from smajax.recordings.read_options import DATE_DIRECTIVES

_TIME_OF_DAY = re.compile(r"(\d{1,2}):(\d{2})(?::(\d{2})(?:[.,](\d{1,9}))?)?", re.ASCII)
_DATE = re.compile(r"\d{4}-\d{2}-\d{2}", re.ASCII)
# Texts that are probably stamps in another format: three numbers with marks between.
_LIKE_STAMP = re.compile(r"\d+\s*[:/.-]\s*\d+\s*[:/.-]\s*\d+", re.ASCII)
_SECONDS_PER_DAY = 86_400
# Rows of data that are looked at for time stamps, since the first ones may be corrupt.
ROWS_WITH_STAMPS = 5
# Part of a day by which a time of day has to go back to count as the next day, so that a clock that is set back by
# hours is still seen as one that decreases.
_MIDNIGHT = 0.5


@final
class StampColumn:
    """Reader of the cells of a column of time stamps.

    Args:
        time_format: Format with the directives of ``strptime``; ``None`` for ISO 8601 and times of day.
        first: Text of the first stamp, from which the seconds are counted.
        date_index: Number of the column that has the dates, where the cells are times of day; ``first`` is then the
            date of ``join``.
    """

    def __init__(self, time_format: str | None, first: Any, date_index: int | None = None):
        self._parse: Callable[[Any], datetime.datetime | None] = _parser(time_format)
        self._time_format = time_format
        self._date_index = date_index
        self.is_time_of_day: bool = date_index is None and (
            isinstance(first, datetime.time)
            or (isinstance(first, str) and time_format is None and bool(_TIME_OF_DAY.fullmatch(first)))
            or (time_format is not None and not any(word in time_format for word in DATE_DIRECTIVES))
        )
        start = self._parse(first)
        if start is None:
            raise ValueError(f"{first!r} is not a time stamp")
        self._start: datetime.datetime = start

    def seconds(self, cell: Any) -> float | None:
        """Return the seconds since the first stamp; ``None`` for a cell that is not a stamp of this kind.

        Args:
            cell: Text of the cell, or a date or time of a workbook.
        """
        stamp = self._parse(cell)
        if stamp is None or (stamp.tzinfo is None) != (self._start.tzinfo is None):
            return None
        return (stamp - self._start).total_seconds()

    def seconds_in_row(self, cells: Sequence[Any], index: int) -> float | None:
        """Return the seconds since the first stamp, with the date of another column where there is one.

        Args:
            cells: Cells of the row.
            index: Number of the column.
        """
        cell = cells[index] if index < len(cells) else None
        if self._date_index is None:
            return self.seconds(cell)
        date = cells[self._date_index] if self._date_index < len(cells) else None
        stamp = join(date, cell, self._time_format)
        return None if stamp is None else self.seconds(stamp)

    def text_in_row(self, cells: Sequence[Any], index: int) -> str:
        """Return the text of a stamp for messages, with the date of another column where there is one.

        Args:
            cells: Cells of the row.
            index: Number of the column.
        """
        indices = [index] if self._date_index is None else [self._date_index, index]
        return " ".join(str(cells[k]) for k in indices if k < len(cells) and cells[k] is not None)

    def unwrapped(self, seconds: NDArray[np.float64]) -> NDArray[np.float64]:
        """Return times of day that continue after midnight.

        Args:
            seconds: Seconds, shape ``(rows,)``; NaN where a cell could not be read.
        """
        if not self.is_time_of_day:
            return seconds
        readable = np.flatnonzero(np.isfinite(seconds))
        days = np.cumsum(np.diff(seconds[readable], prepend=seconds[readable][:1]) < -_MIDNIGHT * _SECONDS_PER_DAY)
        result = seconds.copy()
        result[readable] += days * _SECONDS_PER_DAY
        return result


def find_stamps(rows: Sequence[Sequence[Any]], time_format: str | None) -> dict[int, StampColumn]:
    """Return readers of the columns that have a time stamp in one of the rows, by the number of the column.

    Args:
        rows: Cells of the first rows of data.
        time_format: Format with the directives of ``strptime``; ``None`` for ISO 8601 and times of day.
    """
    parse = _parser(time_format)
    columns: dict[int, StampColumn] = {}
    for cells in rows:
        for index, cell in enumerate(cells):
            if index not in columns and parse(cell) is not None:
                columns[index] = StampColumn(time_format, cell)
    return columns


def join(date: Any, time: Any, time_format: str | None) -> datetime.datetime | None:
    """Return the date and time of two cells, or ``None``.

    Args:
        date: Text of a date, or a date of a workbook.
        time: Text of a time of day, or a time of a workbook.
        time_format: Format of both texts with a space between; ``None`` for ISO 8601 and times of day.
    """
    if isinstance(date, str) and isinstance(time, str):
        if time_format is not None:
            return _parser(time_format)(f"{date} {time}")
        if _DATE.fullmatch(date) and _TIME_OF_DAY.fullmatch(time):
            try:
                return datetime.datetime.fromisoformat(f"{date} {'0' if time[1] == ':' else ''}{time}")
            except ValueError:
                return None
    day, time_of_day = _parse_plain(date), _parse_plain(time)
    is_day = not (isinstance(date, datetime.time) or (isinstance(date, str) and _TIME_OF_DAY.fullmatch(date)))
    if day is None or time_of_day is None or not is_day:
        return None
    return datetime.datetime.combine(day.date(), time_of_day.time())


def seconds_of_times(times: NDArray[Any]) -> NDArray[np.float64]:
    """Return dates as seconds since the first, and durations as seconds; NaN where there is none.

    Args:
        times: Array of ``datetime64`` or ``timedelta64``, shape ``(rows,)``.
    """
    valid = np.flatnonzero(~np.isnat(times))
    if times.dtype.kind == "M" and valid.size:
        times = times - times[valid[0]]
    times = times.astype("timedelta64[ns]")
    return np.where(np.isnat(times), np.nan, times / np.timedelta64(1, "s"))


def is_like_stamp(text: str) -> bool:
    """Return whether a text is probably a time stamp, in any format.

    Args:
        text: Text of a cell.
    """
    return bool(_LIKE_STAMP.match(text))


def _parser(time_format: str | None) -> Callable[[Any], datetime.datetime | None]:
    """Return the function that reads a cell as a date; a time of day is one of day 1."""

    def parse(cell: Any) -> datetime.datetime | None:
        if isinstance(cell, datetime.datetime):
            return cell
        if isinstance(cell, datetime.date):
            return datetime.datetime.combine(cell, datetime.time())
        if isinstance(cell, datetime.time):
            return datetime.datetime.combine(datetime.date.min, cell)
        if not isinstance(cell, str):
            return None
        try:
            if time_format is not None:
                return datetime.datetime.strptime(cell, time_format)
            match = _TIME_OF_DAY.fullmatch(cell)
            if match:
                hours, minutes, seconds, fraction = match.groups()
                microseconds = int((fraction or "0").ljust(6, "0")[:6])
                return datetime.datetime(1, 1, 1, int(hours), int(minutes), int(seconds or 0), microseconds)
            return datetime.datetime.fromisoformat(cell) if _DATE.match(cell) else None
        except ValueError:
            return None

    return parse


_parse_plain = _parser(None)
