"""Reader of JSON: lines with an object each (.jsonl, .ndjson), and .json files with a list of rows or with columns.

A key is the header of a column; keys of nested objects are joined by points (``imu.angle``), and elements of lists are
numbered from 0 (``force.0``). The number of a row is that of its line, or of its place in a list, from 1.
"""

import itertools
import json
import math
import sys
from array import array
from collections.abc import Collection, Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any, final

import numpy as np

from smajax.errors import InputError, first_line, shortened, suggestion
from smajax.recordings.read_options import ReadOptions
from smajax.recordings.readers.base import (
    MEMORY_LIMIT,
    Table,
    file_sha256,
    number_error,
    parse_number,
    refuse_if_too_large,
    row_error,
)
from smajax.recordings.readers.encoding import decode_row, open_as_utf8
from smajax.recordings.readers.header_rows import replaced_headers
from smajax.recordings.readers.time_stamps import ROWS_WITH_STAMPS, StampColumn, find_stamps

LINE_SUFFIXES = (".jsonl", ".ndjson")
# Bytes in memory per byte of a .json file, which is parsed as a whole: chosen from lists of small objects.
_COPIES = 12
# Rows after which the memory of the columns is checked.
_ROWS_PER_CHECK = 10_000
# Types of cells that are numbers, and the largest of them.
_NUMBERS = frozenset((int, float))
_LARGEST = sys.float_info.max


@final
class JsonTable(Table):
    """Columns of a JSON file; the row of a line has its number.

    Args:
        path: The file.
        options: Options of reading.
    """

    def __init__(self, path: Path, options: ReadOptions):
        self.path = path
        self._options = options
        self.first_row: int = options.skip_rows + 1
        self._columns: dict[str, array[float]] = {}
        self._rows = 0
        self._named_lists = False
        # First bad row, and first bad cell of each column, with its row.
        self._bad_row: tuple[int, InputError] | None = None
        self._bad_cells: dict[str, tuple[int, InputError]] = {}
        self._first_stamps: dict[str, tuple[StampColumn, int, str]] = {}
        rows = self._lines() if path.suffix.lower() in LINE_SUFFIXES else self._items()
        for row, value in enumerate(itertools.islice(rows, options.skip_rows, None), self.first_row):
            self._add(row, value)
            if row % _ROWS_PER_CHECK == 0:
                refuse_if_too_large(path, row, len(self._columns))
        if not self._columns:
            error = self._bad_row[1] if self._bad_row else InputError(f"{path}: there are no rows: record at least two")
            raise error
        self._keys = tuple(self._columns)
        self.headers: tuple[str, ...] = self._keys if self._named_lists else replaced_headers(path, self._keys, options)
        self.stamps: Mapping[int, StampColumn] = {
            k: self._first_stamps[key][0] for k, key in enumerate(self._keys) if key in self._first_stamps
        }

    def load(self, indices: Sequence[int], lenient: bool) -> list[np.ndarray]:
        """Return columns of numbers."""
        keys = [self._keys[index] for index in indices]
        for index, key in zip(indices, keys, strict=True):
            if key in self._first_stamps and index not in self.stamps:
                _, row, text = self._first_stamps[key]
                raise number_error(f"{self.path}: row {row}, column '{key}'", text, self._options.decimal)
        for key in keys:
            self._fill(key, self.first_row + self._rows)
        errors = [self._bad_row] if self._bad_row else []
        errors += [self._bad_cells[key] for key in keys if key in self._bad_cells]
        if errors and not lenient:
            raise min(errors, key=lambda pair: pair[0])[1]
        return self.unwrap_stamps(indices, [np.array(self._columns[key]) for key in keys])

    def sha256(self) -> str:
        """Return the SHA-256 of the file in hexadecimal."""
        return file_sha256(self.path)

    def _lines(self) -> Iterator[Any]:
        """Yield the value of each line, or the error of one that is none; blank lines at the end are left out."""
        blank = 0
        with open_as_utf8(self.path, self._options.encoding) as file:
            for number, line in enumerate(file, 1):
                if not line.strip():
                    blank += 1
                    continue
                for row in range(number - blank, number):
                    yield row_error(f"{self.path}: row {row}: the row is blank")
                blank = 0
                try:
                    yield json.loads(decode_row(line, self._options.encoding))
                except (ValueError, RecursionError) as error:
                    yield row_error(f"{self.path}: row {number}: the line is not JSON ({_reason(error)})")

    def _items(self) -> Iterator[Any]:
        """Yield the rows of a .json file."""
        if self.path.stat().st_size * _COPIES > MEMORY_LIMIT:
            cure = "save the rows as JSON lines, one object a line, in a file ending in .jsonl"
            raise InputError(
                f"{self.path}: a .json file above {MEMORY_LIMIT / _COPIES / 2**20:.0f} MiB is not read: {cure}"
            )
        with open_as_utf8(self.path, self._options.encoding) as file:
            text = file.read()
        try:
            data = json.loads(decode_row(text, self._options.encoding))
        except (ValueError, RecursionError) as error:
            line = f" line {error.lineno}:" if isinstance(error, json.JSONDecodeError) else ""
            cure = "save it again, or name it .jsonl if each line is an object"
            raise InputError(f"{self.path}:{line} the file is not JSON ({_reason(error)}): {cure}") from None
        for key in (self._options.variable or "").split(".") if self._options.variable else ():
            data = self._member(data, key)
        yield from self._rows_of(data)

    def _member(self, data: Any, key: str) -> Any:
        members = list(data) if isinstance(data, dict) else []
        if key not in members:
            hint = suggestion(key, members)
            members_text = f"it has {', '.join(members)}" if members else "its value is no object"
            problem = f"there is no member '{key}' for variable = \"{self._options.variable}\"{hint}"
            raise InputError(f"{self.path}: {problem}: {members_text}, so correct variable")
        return data[key]

    def _rows_of(self, data: Any) -> Iterator[Any]:
        """Yield the rows of a list of rows, of columns, or of a table as pandas writes it."""
        if isinstance(data, list):
            yield from data
            return
        if isinstance(data, dict) and isinstance(data.get("columns"), list) and isinstance(data.get("data"), list):
            names = [str(name) for name in data["columns"]]
            for number, row in enumerate(data["data"], 1):
                yield _named(f"{self.path}: row {number}", row, names)
            return
        columns = _columns(data)
        if not columns:
            lists = (
                [key for key, value in data.items() if isinstance(value, list | dict)] if isinstance(data, dict) else []
            )
            cure = "save a list of objects, or an object with a list for each column"
            cure += f', or name its member with the rows, as in variable = "{lists[0]}"' if lists else ""
            raise InputError(f"{self.path}: the file has neither rows nor columns of one length: {cure}")
        for values in zip(*columns.values(), strict=True):
            yield dict(zip(columns, values, strict=True))

    def _add(self, row: int, value: Any) -> None:
        """Append a row to the columns."""
        self._rows += 1
        place = f"{self.path}: row {row}"
        if isinstance(value, list) and self._options.columns is not None:
            value = _named(place, value, self._options.columns)
            self._named_lists = True
        if not isinstance(value, dict | InputError):
            kind = "a list" if isinstance(value, list) else f"'{shortened(json.dumps(value))}'"
            hint = ", or columns are named" if isinstance(value, list) else ""
            value = row_error(f'{place}: the row is {kind} and not an object such as {{"time [s]": 0.0, ...}}{hint}')
        if isinstance(value, InputError):
            self._bad_row = self._bad_row or (row, value)
            value = {}
        if value.keys() == self._columns.keys() and _are_finite(value.values()):  # the same, but fast
            for key, number in value.items():
                column = self._columns[key]
                if len(column) < row - self.first_row:
                    self._fill(key, row)
                column.append(number)
            return
        for key, cell in dict(_leaves(value)).items():
            self._columns.setdefault(key, array("d"))
            self._fill(key, row)
            self._columns[key].append(self._number(row, key, cell))

    def _fill(self, key: str, row: int) -> None:
        """Fill a column up to a row that is not filled, so that rows take no time for keys that they do not have."""
        column = self._columns[key]
        missing = row - self.first_row - len(column)
        if not missing:
            return
        first = row - missing
        if key not in self._bad_cells and (self._bad_row is None or self._bad_row[0] > first):
            error = row_error(f"{self.path}: row {first}, column '{key}': the row has no such key")
            self._bad_cells[key] = (first, error)
        column.extend(itertools.repeat(np.nan, missing))

    def _number(self, row: int, key: str, cell: Any) -> float:
        """Return the number in a cell, seconds for a time stamp, or NaN; the first bad one of a column is stored."""
        number = None
        text = cell.strip() if isinstance(cell, str) else ""
        if isinstance(cell, str):
            if row < self.first_row + ROWS_WITH_STAMPS and key not in self._first_stamps:
                stamp = find_stamps([[text]], self._options.time_format).get(0)
                self._first_stamps |= {key: (stamp, row, text)} if stamp else {}
            is_stamp = key in self._first_stamps
            number = self._first_stamps[key][0].seconds(text) if is_stamp else parse_number(text, self._options.decimal)
        elif isinstance(cell, int | float) and not isinstance(cell, bool) and abs(cell) <= _LARGEST:
            number = float(cell)
        if number is not None:
            return number
        if key not in self._bad_cells:
            text = text if isinstance(cell, str) or cell is None else json.dumps(cell)
            error = number_error(f"{self.path}: row {row}, column '{key}'", text, self._options.decimal)
            self._bad_cells[key] = (row, error)
        return np.nan


def _are_finite(cells: Collection[Any]) -> bool:
    """Return whether all cells are finite numbers."""
    try:
        return _NUMBERS.issuperset(map(type, cells)) and all(map(math.isfinite, cells))
    except OverflowError:  # an integer that is too large
        return False


def _named(place: str, row: Any, names: Sequence[str]) -> Any:
    """Return a list as an object with the names of its columns, or the error of another row."""
    if not isinstance(row, list) or len(row) != len(names):
        count = len(row) if isinstance(row, list) else 0
        return row_error(f"{place}: the row has {count} cells, and {len(names)} columns are named")
    return {name: value for name, value in zip(names, row, strict=True) if name != "-"}


def _columns(data: Any) -> Mapping[str, Sequence[Any]]:
    """Return the columns of an object with a list for each, or with an object of rows for each; none if it has none."""
    values = list(data.values()) if isinstance(data, dict) else []
    if values and all(isinstance(value, list) and len(value) == len(values[0]) for value in values):
        return data
    if values and all(isinstance(value, dict) and value.keys() == values[0].keys() for value in values):
        return {key: list(value.values()) for key, value in data.items()}
    return {}


def _leaves(value: Any, name: str = "") -> Iterator[tuple[str, Any]]:
    """Yield the name and value of each cell of a row."""
    if isinstance(value, dict | list):
        items = value.items() if isinstance(value, dict) else enumerate(value)
        for key, part in items:
            yield from _leaves(part, f"{name}.{key}" if name else str(key).strip())
    else:
        yield name, value


def _reason(error: Exception) -> str:
    if isinstance(error, json.JSONDecodeError):
        return f"{error.msg} at character {error.colno}"
    return "it is nested too deeply" if isinstance(error, RecursionError) else first_line(error)
