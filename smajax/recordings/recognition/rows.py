"""Header, units and data among the first rows of a table."""

from collections.abc import Sequence
from dataclasses import dataclass

from smajax.recordings.read_options import ReadOptions
from smajax.recordings.readers.base import parse_number
from smajax.recordings.readers.header_rows import is_units_row
from smajax.recordings.readers.time_stamps import find_stamps

# Share of the usual number of values that a row of data has: others of its cells may be blank.
_DATA_SHARE = 0.5
# Texts that programs write in cells without a value.
_MISSING = ("", "nan", "na", "n/a", "null", "none", "-")


@dataclass(frozen=True)
class RowRoles:
    """Where header, units and data are, among the rows of a table.

    Attributes:
        data: Index of the first row of data.
        width: Number of cells of a row of data.
        header: Index of the row of headers; ``None`` without any.
        units: Index of the row of units; ``None`` without any.
    """

    data: int
    width: int
    header: int | None
    units: int | None

    def is_adjacent(self) -> bool:
        """Return whether header, units and data follow each other without a row between."""
        rows = [row for row in (self.header, self.units, self.data) if row is not None]
        return rows == list(range(rows[0], rows[0] + len(rows)))


def count_values(cells: Sequence[str], decimal: str, time_format: str | None = None) -> int:
    """Return the number of cells of a row that are numbers or time stamps.

    Args:
        cells: Texts of the cells.
        decimal: Decimal sign.
        time_format: Format of time stamps; ``None`` for ISO 8601 and times of day.
    """
    return len(_value_places(cells, decimal, time_format))


def _value_places(cells: Sequence[str], decimal: str, time_format: str | None) -> set[int]:
    """Return the numbers of the cells of a row that are numbers or time stamps."""
    numbers = [parse_number(cell, decimal) is not None for cell in cells]
    stamps = find_stamps([["" if number else cell for cell, number in zip(cells, numbers, strict=True)]], time_format)
    return {k for k, is_number in enumerate(numbers) if is_number} | set(stamps)


def find_rows(rows: Sequence[Sequence[str]], options: ReadOptions) -> RowRoles | None:
    """Return where header, units and data are; ``None`` if there is no row of data.

    Args:
        rows: Texts of the cells of the first rows.
        options: Decimal sign and format of time stamps.
    """
    places = [_value_places(cells, options.decimal, options.time_format) for cells in rows]
    counts = [len(values) for values in places]
    if not any(counts):
        return None
    width = usual_width(rows, counts)
    wide = [values for values, cells in zip(places, rows, strict=True) if values and len(cells) == width]
    least = _DATA_SHARE * max(map(len, wide))
    columns = {k for k in range(width) if sum(k in values for values in wide) > _DATA_SHARE * len(wide)}
    is_data = [len(cells) == width and _is_data(cells, count, least) for cells, count in zip(rows, counts, strict=True)]
    # A row of a head, such as "X0 0.0 0.0", has a text where data have a value.
    has_text = [
        any(k not in values and not is_missing(cells[k]) for k in columns if k < len(cells))
        for cells, values in zip(rows, places, strict=True)
    ]
    data = next((k for k, data in enumerate(is_data) if data and not has_text[k]), is_data.index(True))
    header = next((k for k in range(data - 1, -1, -1) if _is_header(rows[k], width, counts[k])), None)
    units = None
    if header is not None and is_units_row(rows[header], len(rows[header])):
        above = next((k for k in range(header - 1, -1, -1) if _is_header(rows[k], width, counts[k])), None)
        header, units = (above, header) if above is not None else (header, None)
    return RowRoles(data, width, header, units)


def usual_width(rows: Sequence[Sequence[str]], counts: Sequence[int]) -> int:
    """Return the number of cells of most rows with values.

    Args:
        rows: Texts of the cells.
        counts: Number of values in each row.
    """
    widths = [len(cells) for cells, count in zip(rows, counts, strict=True) if count]
    return max(sorted(set(widths), reverse=True), key=widths.count)


def is_missing(cell: str) -> bool:
    """Return whether a cell has no value: blank, or a text that says so.

    Args:
        cell: Text of the cell.
    """
    return cell.strip().lower() in _MISSING


def _is_data(cells: Sequence[str], values: int, least: float) -> bool:
    """Return whether a row has enough values; at the least number of them its other cells have to be blank."""
    return values > least or (values == least and sum(not is_missing(cell) for cell in cells) <= values)


def _is_header(cells: Sequence[str], width: int, values: int) -> bool:
    """Return whether a row above the data may be one of names: as many texts as half of the columns, and few values."""
    texts = [cell for cell in cells if cell.strip()]
    return len(texts) - values >= max(_DATA_SHARE * width, 1) and len(cells) <= width + 1
