"""Reader of Excel .xlsx files, a sheet with one header row; needs openpyxl, the extra ``io``.

Cells with a formula have the stored result.
"""

import io
import warnings
import zipfile
from array import array
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any, final

import numpy as np

from smajax.errors import InputError, first_line, suggestion
from smajax.recordings.readers.base import (
    MEMORY_LIMIT,
    Table,
    file_sha256,
    number_error,
    parse_number,
    refuse_if_too_large,
)


@final
class XlsxTable(Table):
    """One sheet of a workbook.

    Args:
        path: The file.
        skip_rows: Rows before the header.
        decimal: Decimal sign of cells that hold a number as text.
        sheet: Name of the sheet; the first by default.
    """

    def __init__(self, path: Path, skip_rows: int, decimal: str, sheet: str | None):
        self.path: Path = path
        self._decimal = decimal
        book = self._open()
        if sheet is not None and sheet not in book.sheetnames:
            hint = suggestion(sheet, book.sheetnames)
            raise InputError(f"{path}: there is no sheet '{sheet}'{hint}: it has {', '.join(book.sheetnames)}")
        self._sheet = book[sheet] if sheet is not None else book.worksheets[0]
        self.headers: tuple[str, ...] = self._read_headers(skip_rows + 1)
        self.first_row: int = skip_rows + 2

    def load(self, indices: Sequence[int], lenient: bool) -> list[np.ndarray]:
        """Return columns of numbers."""
        columns = [array("d") for _ in indices]
        rows = blank_rows = 0
        width = len(self.headers)
        for cells in self._rows(min_row=self.first_row, max_col=width):
            blank_rows += 1
            if all(cell is None or cell == "" for cell in cells):
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
        return [np.array(column) for column in columns]

    def sha256(self) -> str:
        """Return the SHA-256 of the file in hexadecimal."""
        return file_sha256(self.path)

    def _open(self) -> Any:
        """Return the workbook."""
        path = self.path
        try:
            import openpyxl
        except ImportError:
            cure = 'run pip install "smajax[io]", or save the sheet as CSV'
            raise InputError(f"{path}: Excel files need openpyxl: {cure}") from None
        try:
            with zipfile.ZipFile(path) as archive:
                unpacked = sum(entry.file_size for entry in archive.infolist())
            fits = unpacked <= MEMORY_LIMIT
            # A copy in memory, since openpyxl does not close a file that it cannot read.
            packed = io.BytesIO(path.read_bytes() if fits else b"")
            with warnings.catch_warnings(action="ignore"):  # openpyxl warns about styles
                book = openpyxl.load_workbook(packed, read_only=True, data_only=True) if fits else None
        except Exception as error:  # damaged archives, XML and workbooks raise different types
            raise self._unreadable(error) from None
        if book is None:
            size, limit = unpacked / 2**30, MEMORY_LIMIT / 2**30
            problem = f"the workbook unpacks to {size:.1f} GiB, above the limit of {limit:.3g} GiB"
            raise InputError(f"{path}: {problem}: save the sheet as CSV")
        return book

    def _read_headers(self, row: int) -> tuple[str, ...]:
        """Return the headers in a row of the sheet, without blank cells at its end."""
        header = next(self._rows(min_row=row, max_row=row), ())
        texts = ["" if value is None else str(value).strip() for value in header]
        while texts and not texts[-1]:
            texts.pop()
        place = f"{self.path}: row {row}"
        if not texts:
            cure = "give names and units, or set skip_rows"
            raise InputError(f"{place}: the row is blank where the header is expected: {cure}")
        if all(isinstance(value, int | float) for value in header if value is not None):
            cure = "begin with cells like 'time [s]', 'current [A]'"
            raise InputError(f"{place}: the header is missing ('{texts[0]}' is a number): {cure}")
        return tuple(texts)

    def _rows(self, **limits: int) -> Iterator[tuple[Any, ...]]:
        try:
            yield from self._sheet.iter_rows(**limits, values_only=True)
        except Exception as error:  # as above: a sheet is unpacked and parsed while its rows are read
            raise self._unreadable(error) from None

    def _unreadable(self, error: Exception) -> InputError:
        problem = f"the file is not readable as a workbook ({first_line(error)})"
        return InputError(f"{self.path}: {problem}: save it again, or as CSV")

    def _numbers(self, cells: Sequence[Any], row: int, indices: Sequence[int], lenient: bool) -> list[float]:
        numbers = []
        for index in indices:
            cell = cells[index] if index < len(cells) else None
            text = "" if cell is None else str(cell).strip()
            is_number = isinstance(cell, int | float) and not isinstance(cell, bool)
            number = parse_number(repr(cell) if is_number else text, "." if is_number else self._decimal)
            if number is None and not lenient:
                place = f"{self.path}: row {row}, column '{self.headers[index]}'"
                raise number_error(place, text, self._decimal)
            numbers.append(np.nan if number is None else number)
        return numbers
