"""Reader of Excel .xlsx files, a sheet with one header row; needs openpyxl, the extra ``io``.

Cells with a formula have the stored result.
"""

from array import array
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any, final

import numpy as np

from smajax.errors import InputError
from smajax.recordings.read_options import ReadOptions
from smajax.recordings.readers.base import Table, file_sha256, number_error, parse_number, refuse_if_too_large
from smajax.recordings.readers.header_rows import read_header_rows
from smajax.recordings.readers.sheets import choose_sheets
from smajax.recordings.readers.time_stamps import ROWS_WITH_STAMPS, StampColumn, find_stamps
from smajax.recordings.readers.workbook import Workbook

# Rows that are looked at for headers, units and time stamps, and for whether a sheet is blank.
_ROWS_LOOKED_AT = 30


def open_sheets(path: Path, options: ReadOptions) -> list["XlsxTable"]:
    """Open the sheets of a workbook that are read: those that are named, all of them, or the first.

    Args:
        path: The file.
        options: Options of reading.

    Raises:
        InputError: If the file is not a workbook, or a sheet is missing or has no header.
    """
    book = Workbook(path)
    filled = [name for name in book.names if book.has_rows(name, _ROWS_LOOKED_AT)]
    names, notes = choose_sheets(path, options, book.names, filled, "sheet")
    tables = []
    for name in names:
        table = XlsxTable(path, options, book, name, several=len(names) > 1)
        table.notes += notes
        tables.append(table)
    return tables


def first_rows(path: Path, count: int) -> dict[str, list[list[str]]]:
    """Return the first rows of each sheet that is not blank, as texts, by the name of the sheet.

    Args:
        path: The workbook.
        count: Number of rows.

    Raises:
        InputError: If the file is not a workbook.
    """
    book = Workbook(path)
    rows = {}
    for name in book.names:
        if book.has_rows(name, _ROWS_LOOKED_AT):
            cells = book.rows(name, count=count)
            rows[name] = [["" if cell is None else str(cell).strip() for cell in row] for row in cells]
    return rows


@final
class XlsxTable(Table):
    """One sheet of a workbook.

    Args:
        path: The file.
        options: Options of reading.
        book: The workbook.
        sheet: Name of the sheet.
        several: Whether several sheets are read, so that messages name this one.
    """

    def __init__(self, path: Path, options: ReadOptions, book: Workbook, sheet: str, *, several: bool = False):
        self.path: str = f"{path}: sheet '{sheet}'" if several else str(path)
        self._file = path
        self._decimal = options.decimal
        self._book, self._sheet = book, sheet
        self.label: str = sheet if several else ""
        number = options.skip_rows + 1
        rows = list(book.rows(sheet, number, _ROWS_LOOKED_AT + 1))
        texts = self._header_texts(rows, number, options)
        result = read_header_rows(self.path, number, texts, options)
        self.headers: tuple[str, ...] = result.headers
        self.notes: tuple[str, ...] = result.notes
        self.first_row: int = number + result.rows
        self.first_cells: Sequence[Sequence[Any]] = rows[result.rows : result.rows + ROWS_WITH_STAMPS]
        self.stamps: Mapping[int, StampColumn] = find_stamps(self.first_cells, options.time_format)

    def load(self, indices: Sequence[int], lenient: bool) -> list[np.ndarray]:
        """Return columns of numbers."""
        columns = [array("d") for _ in indices]
        rows = blank_rows = 0
        width = len(self.headers)
        for cells in self._book.rows(self._sheet, self.first_row):
            blank_rows += 1
            if all(cell is None or cell == "" for cell in cells[:width]):
                continue
            for row_cells in [()] * (blank_rows - 1) + [cells]:
                numbers = self._numbers(row_cells, self.first_row + rows, indices, lenient)
                for column, number in zip(columns, numbers, strict=True):
                    column.append(number)
                rows += 1
            blank_rows = 0
            refuse_if_too_large(self.path, rows, len(indices))
        if not rows:
            problem = f"the sheet ends after the header in row {self.first_row - 1}"
            raise InputError(f"{self.path}: {problem}: record at least two rows of data")
        return self.unwrap_stamps(indices, [np.array(column) for column in columns])

    def sha256(self) -> str:
        """Return the SHA-256 of the file in hexadecimal."""
        return file_sha256(self._file)

    def _header_texts(self, rows: Sequence[Sequence[Any]], number: int, options: ReadOptions) -> list[list[str]]:
        """Return the first rows as texts of the width of the first one, without blank cells at its end."""
        texts = [["" if value is None else str(value).strip() for value in row] for row in rows] or [[]]
        width = max((k + 1 for k, text in enumerate(texts[0]) if text), default=0)
        place = f"{self.path}: row {number}"
        if not width:
            cure = "give names and units, or set skip_rows"
            raise InputError(f"{place}: the row is blank where the header is expected: {cure}")
        is_data = not isinstance(options.columns, tuple) and options.header is not True
        if is_data and all(isinstance(value, int | float) for value in rows[0][:width] if value is not None):
            cure = "begin with cells like 'time [s]', 'current [A]', or set columns under [recording] in the rig"
            message = f"{place}: the header is missing ('{texts[0][0]}' is a number): {cure}"
            raise InputError(message, code="header-missing", cure=cure)
        return [row[:width] + [""] * (width - len(row)) for row in texts]

    def _numbers(self, cells: Sequence[Any], row: int, indices: Sequence[int], lenient: bool) -> list[float]:
        numbers = []
        stripped = [cell.strip() if isinstance(cell, str) else cell for cell in cells] if self.stamps else ()
        for index in indices:
            cell = cells[index] if index < len(cells) else None
            text = "" if cell is None else str(cell).strip()
            is_number = isinstance(cell, int | float) and not isinstance(cell, bool)
            stamps = self.stamps.get(index)
            if stamps is not None:
                number, text = stamps.seconds_in_row(stripped, index), stamps.text_in_row(stripped, index)
            else:
                number = parse_number(repr(cell) if is_number else text, "." if is_number else self._decimal)
            if number is None and not lenient:
                place = f"{self.path}: row {row}, column '{self.headers[index]}'"
                raise number_error(place, text, self._decimal, first=row == self.first_row)
            numbers.append(np.nan if number is None else number)
        return numbers
