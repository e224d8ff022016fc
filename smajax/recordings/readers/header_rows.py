"""The rows before the data of a text file or sheet: headers, and units in a row of their own."""

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

from smajax.errors import InputError
from smajax.recordings.read_options import ReadOptions
from smajax.recordings.readers.base import parse_number
from smajax.recordings.readers.time_stamps import is_like_stamp
from smajax.unit_parser import UnknownUnitError, parse_unit

# Brackets in which programs write a unit.
_BRACKETS = "[]()<>"


@dataclass(frozen=True)
class HeaderRows:
    """The headers of a table.

    Attributes:
        headers: Header of each column, with the unit of a row of units.
        rows: Rows before the data: 0 without any, 1 with headers, 2 with units as well.
        notes: Sentences on what was recognised.
    """

    headers: tuple[str, ...]
    rows: int
    notes: tuple[str, ...] = ()


def has_header(cells: Sequence[str], options: ReadOptions) -> bool:
    """Return whether a row is one of headers.

    Args:
        cells: Texts of the first row that is not skipped.
        options: Options of reading; without ``header`` it is one unless columns are named and a cell is a number or
            time stamp.
    """
    if options.header is not None:
        return options.header
    return options.columns is None or not any(is_value(cell, options.decimal) for cell in cells)


def is_value(cell: str, decimal: str) -> bool:
    """Return whether the text of a cell is data: a number or a time stamp.

    Args:
        cell: Text of the cell.
        decimal: Decimal sign.
    """
    return parse_number(cell, decimal) is not None or cell.lower() == "nan" or is_like_stamp(cell)


def read_header_rows(place: str, row: int, rows: Sequence[Sequence[str]], options: ReadOptions) -> HeaderRows:
    """Return the headers of a table.

    Args:
        place: The file or sheet, for messages.
        row: Number of the first row.
        rows: Texts of the cells of the first rows that are not skipped.
        options: Options of reading.

    Raises:
        InputError: If the headers do not fit the row.
    """
    first = rows[0] if rows else ()
    count = int(has_header(first, options))
    headers = _named(place, row, first, options) if options.columns is not None else tuple(first)
    next_row = rows[count] if len(rows) > count else ()
    if options.units_row is False or (options.units_row is None and not is_units_row(next_row, len(headers))):
        return HeaderRows(headers, count)
    number = row + count
    if len(next_row) != len(headers):
        problem = f"the row of units has {len(next_row)} cells and the header {len(headers)}"
        raise InputError(f"{place}: row {number}: {problem}: give every column a unit, or a blank cell")
    with_units = tuple(_with_unit(place, number, header, unit) for header, unit in zip(headers, next_row, strict=True))
    recognised = options.units_row is None
    note = (f"row {number} was read as units",) if recognised else ()
    return HeaderRows(with_units, count + 1, note)


def _named(place: str, row: int, cells: Sequence[str], options: ReadOptions) -> tuple[str, ...]:
    """Return the headers of the caller, if they fit the first row, with the units of those that they replace."""
    headers = options.columns or ()
    if len(cells) != len(headers):
        count = f"the row has {len(cells)} cells, and {len(headers)} columns are named"
        cure = "name every column, with - for one to ignore, or set skip_rows if the table begins further down"
        raise InputError(f"{place}: row {row}: {count}: {cure}", code="columns-count", cure=cure)
    return _with_units_of(headers, cells) if has_header(cells, options) else headers


def replaced_headers(path: Path, headers: Sequence[str], options: ReadOptions) -> tuple[str, ...]:
    """Return the headers of a file that is no text, or those of the caller in their place.

    Args:
        path: The file, for the message.
        headers: Headers in the file.
        options: Options of reading.

    Raises:
        InputError: If other columns are named than the file has.
    """
    if options.columns is None:
        return tuple(headers)
    if len(options.columns) != len(headers):
        has = f"the file has {len(headers)} ({', '.join(headers)})"
        problem = f"the number of named columns is {len(options.columns)}, and {has}"
        cure = "name every column, with - for one to leave out"
        raise InputError(f"{path}: {problem}: {cure}", code="columns-number", cure=cure)
    return _with_units_of(options.columns, headers)


def _with_units_of(names: Sequence[str], headers: Sequence[str]) -> tuple[str, ...]:
    """Return names with the units of the headers that they replace, unless they have one."""
    units = [header[header.find("[") :] if header.endswith("]") and "[" in header else "" for header in headers]
    return tuple(
        f"{name} {unit}" if unit and "[" not in name and name != "-" else name
        for name, unit in zip(names, units, strict=True)
    )


def is_units_row(cells: Sequence[str], width: int) -> bool:
    """Return whether a row has a unit in each cell that is not blank.

    Args:
        cells: Texts of the cells.
        width: Number of columns.
    """
    texts = [cell.strip(_BRACKETS + " ") for cell in cells]
    filled = [text for text in texts if text not in ("", "-")]
    return len(cells) == width and bool(filled) and all(_is_unit(text) for text in filled)


def _is_unit(text: str) -> bool:
    if parse_number(text, ".") is not None or parse_number(text, ",") is not None:
        return False
    try:
        parse_unit(text)
    except (UnknownUnitError, InputError, ValueError):
        return False
    return text.lower() != "nan"


def _with_unit(place: str, row: int, header: str, unit: str) -> str:
    """Return a header with the unit below it."""
    text = unit.strip(_BRACKETS + " ")
    if text in ("", "-"):
        return header
    name, bracket, own = header.partition("[")
    own = own.rstrip("] ")
    if not bracket:
        return f"{name.strip()} [{text}]"
    if own.strip() != text:
        problem = f"the header '{header}' and the unit '{text}' below it differ"
        raise InputError(f"{place}: row {row}: {problem}: correct one of the two, or give units_row = false")
    return header
