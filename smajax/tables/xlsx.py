"""Excel .xlsx: one sheet with one header row. Needs openpyxl, the extra ``io``. Formulas count with their stored results."""

import io
import warnings
import zipfile
from array import array
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any, final

import numpy as np

from smajax.errors import InputError, nearest
from smajax.tables.base import MEMORY_LIMIT, Table, file_sha256, number_in, refuse_if_too_large, why_not_a_number


@final
class XlsxTable(Table):
    def __init__(self, path: Path, skip_rows: int, decimal: str, sheet: str | None):
        self.path, self._decimal = path, decimal
        try:
            import openpyxl
        except ImportError:
            raise InputError(f'{path}: Excel files need openpyxl: run pip install "smajax[io]", or save the sheet as CSV') from None
        try:
            with zipfile.ZipFile(path) as archive:
                unpacked = sum(entry.file_size for entry in archive.infolist())
            # A copy in memory, since openpyxl leaves a file open that it fails on.
            packed = io.BytesIO(path.read_bytes() if unpacked <= MEMORY_LIMIT else b"")
            with warnings.catch_warnings(action="ignore"):  # openpyxl's remarks on styles, which are of no account here
                book = openpyxl.load_workbook(packed, read_only=True, data_only=True) if unpacked <= MEMORY_LIMIT else None
        except Exception as error:  # zip, XML and workbook damage all end differently
            raise self._unreadable(error) from None
        if book is None:
            size, limit = unpacked / 2**30, MEMORY_LIMIT / 2**30
            raise InputError(f"{path}: the workbook unpacks to {size:.1f} GiB, above the limit of {limit:.3g} GiB: save the sheet as CSV")
        if sheet is not None and sheet not in book.sheetnames:
            raise InputError(f"{path}: there is no sheet '{sheet}'{nearest(sheet, book.sheetnames)}: it has {', '.join(book.sheetnames)}")
        self._sheet = book[sheet] if sheet is not None else book.worksheets[0]
        header = next(self._rows(min_row=skip_rows + 1, max_row=skip_rows + 1), ())
        texts = ["" if value is None else str(value).strip() for value in header]
        while texts and not texts[-1]:
            texts.pop()
        place = f"{path}: row {skip_rows + 1}"
        if not texts:
            raise InputError(f"{place}: the row is blank where the header is expected: give names and units, or set skip_rows")
        if all(isinstance(value, int | float) for value in header if value is not None):
            raise InputError(f"{place}: the header is missing ('{texts[0]}' is a number): begin with cells like 'time [s]', 'current [A]'")
        self.headers, self.first_row = tuple(texts), skip_rows + 2

    def load(self, wanted: Sequence[int], lenient: bool) -> list[np.ndarray]:
        columns = [array("d") for _ in wanted]
        rows = blank_rows = 0
        width = len(self.headers)
        for cells in self._rows(min_row=self.first_row, max_col=width):
            blank_rows += 1
            if all(cell is None or cell == "" for cell in cells):
                continue
            for one_row in [()] * (blank_rows - 1) + [cells]:
                for column, number in zip(columns, self._numbers(one_row, self.first_row + rows, wanted, lenient), strict=True):
                    column.append(number)
                rows += 1
            blank_rows = 0
            refuse_if_too_large(self.path, rows, len(wanted))
        if not rows:
            raise InputError(f"{self.path}: the sheet ends after the header in row {self.first_row - 1}: record at least two rows of data")
        return [np.array(column) for column in columns]

    def sha256(self) -> str:
        return file_sha256(self.path)

    def _rows(self, **limits: int) -> Iterator[tuple[Any, ...]]:
        try:
            yield from self._sheet.iter_rows(**limits, values_only=True)
        except Exception as error:  # as above: a sheet is unpacked and parsed while its rows are asked for
            raise self._unreadable(error) from None

    def _unreadable(self, error: Exception) -> InputError:
        shown = (str(error).splitlines() or [type(error).__name__])[0][:120]
        return InputError(f"{self.path}: the file is not readable as a workbook ({shown}): save it again, or as CSV")

    def _numbers(self, cells: Sequence[Any], row: int, wanted: Sequence[int], lenient: bool) -> list[float]:
        numbers = []
        for column in wanted:
            cell = cells[column] if column < len(cells) else None
            text = "" if cell is None else str(cell).strip()
            plain = isinstance(cell, int | float) and not isinstance(cell, bool)
            number = number_in(repr(cell) if plain else text, "." if plain else self._decimal)
            if number is None and not lenient:
                raise InputError(f"{self.path}: row {row}, column '{self.headers[column]}': {why_not_a_number(text, self._decimal)}")
            numbers.append(np.nan if number is None else number)
        return numbers
