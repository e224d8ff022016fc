"""Workbooks of Excel: archives that are checked before they are unpacked, and rows of their sheets.

openpyxl's own iteration over rows trusts the dimension that a sheet states, fills gaps between numbers of rows without
a limit, and drops rows and cells that are out of order. So the rows are taken from its parser of sheets, and checked
here.
"""

import contextlib
import io
import warnings
import zipfile
from collections.abc import Generator, Iterator
from pathlib import Path
from typing import Any
from xml.parsers import expat

from smajax.errors import InputError, first_line
from smajax.recordings.readers.base import MEMORY_LIMIT

# Rows and columns of a sheet of Excel 2007 and later (Microsoft, "Excel specifications and limits").
MAX_ROWS = 1_048_576
MAX_COLUMNS = 16_384
# Bytes of the parts that openpyxl holds in memory as a whole, such as the shared texts: about ten times as many then.
_MAX_HELD_BYTES = MEMORY_LIMIT // 10
# Sheets compress 5 to 30 times, constant columns up to 60 times (measured), and a repeated tag 1,000 times. A part of
# this size that compresses more than this is no sheet of measurements; openpyxl takes 4 s for as many bytes of styles.
_BOMB_BYTES = 2**19
_BOMB_RATIO = 200
# Bytes before the first element of a part, in which a document type would stand.
_PROLOG_BYTES = 2**16
_PIECE_BYTES = 2**10


class Workbook:
    """A workbook whose rows are read one after another.

    Args:
        path: The file.

    Raises:
        InputError: If it is not a workbook, is damaged, or unpacks to more than the memory limit.

    Attributes:
        names: Names of the sheets with cells, which excludes charts.
    """

    def __init__(self, path: Path):
        self.path = path
        try:
            from openpyxl.reader.excel import ExcelReader
        except ImportError:
            cure = 'run pip install "smajax[io]", or save the sheet as CSV'
            raise InputError(f"{path}: Excel files need openpyxl: {cure}") from None
        with _reading(path):
            _refuse_above(path, "the workbook", path.stat().st_size, MEMORY_LIMIT)
            # A copy in memory, since openpyxl does not close a file that it cannot read.
            packed = io.BytesIO(path.read_bytes())
            with zipfile.ZipFile(packed) as archive:
                _check_archive(path, archive)
            reader = ExcelReader(packed, read_only=True, data_only=True)
            reader.read()
            listed = [sheet.name for sheet in reader.parser.sheets]
            self._book: Any = reader.wb
            self._sheets: dict[str, Any] = {sheet.title: sheet for sheet in self._book.worksheets}
            titles = self._book.sheetnames
        self.names: tuple[str, ...] = tuple(self._sheets)
        missing = [name for name in listed if name not in titles]
        problem = f"there is no part for its sheet '{missing[0]}'" if missing else ""
        problem = problem or ("two sheets have one name" if len(set(titles)) < len(titles) else "")
        problem = problem or ("" if self.names else "it has no sheet with cells")
        if problem:
            raise _unreadable(path, problem)

    def rows(self, name: str, first: int = 1, count: int = MAX_ROWS) -> Iterator[list[Any]]:
        """Yield the values of each row of a sheet, also of blank ones before its last row.

        Args:
            name: Name of the sheet.
            first: Number of the first row.
            count: Largest number of rows.

        Raises:
            InputError: If the sheet is damaged, has rows out of order, or is larger than one of Excel.
        """
        number = first
        with contextlib.closing(self._parsed_rows(name)) as parsed_rows:
            for row, values in parsed_rows:
                for blank in range(number, min(row, first + count)):
                    yield []
                    number = blank + 1
                if number >= first + count:
                    return
                if row == number:
                    yield values
                    number += 1

    def has_rows(self, name: str, count: int) -> bool:
        """Return whether one of the first rows of a sheet has a cell that is not blank, or the sheet is damaged.

        Args:
            name: Name of the sheet.
            count: Number of rows.
        """
        try:
            return any(value not in (None, "") for row in self.rows(name, count=count) for value in row)
        except InputError:  # the sheet is named when it is read
            return True

    def _parsed_rows(self, name: str) -> Generator[tuple[int, list[Any]], None, None]:
        """Yield the number and the values of each row that the sheet has."""
        from openpyxl.worksheet._reader import WorkSheetParser

        book, sheet = self._book, self._sheets[name]
        place, last = f"{self.path}: sheet '{name}'", 0
        with _reading(self.path):
            source = sheet._get_source()
        with source:
            parser = WorkSheetParser(
                source,
                sheet._shared_strings,
                data_only=True,
                epoch=book.epoch,
                date_formats=book._date_formats,
                timedelta_formats=book._timedelta_formats,
            )
            rows = parser.parse()
            while True:
                with _reading(self.path):  # not around the yield, since the caller's errors are its own
                    parsed = next(rows, None)
                if parsed is None:
                    return
                row, cells = parsed
                if not 0 < row <= MAX_ROWS:
                    raise _unreadable(place, f"row {row} is not one of 1 to {MAX_ROWS}")
                if row <= last:
                    raise _unreadable(place, f"row {row} comes after row {last}")
                yield row, _values(place, row, cells)
                last = row


@contextlib.contextmanager
def _reading(path: Path | str) -> Iterator[None]:
    """Refuse a workbook that zipfile or openpyxl cannot read: damaged ones raise errors of many types."""
    try:
        with warnings.catch_warnings(action="ignore"):  # openpyxl warns about styles and extensions
            yield
    except InputError:
        raise
    except Exception as error:
        raise _unreadable(path, first_line(error)) from None


def _unreadable(path: Path | str, reason: str) -> InputError:
    return InputError(f"{path}: the file is not readable as a workbook ({reason}): save it again, or as CSV")


def _values(place: str, row: int, cells: list[dict[str, Any]]) -> list[Any]:
    """Return the values of the cells of a row by column; blank cells are ``None``."""
    width = max((cell["column"] for cell in cells), default=0)
    if width > MAX_COLUMNS:
        raise _unreadable(place, f"row {row} has {width} columns, above {MAX_COLUMNS}")
    values: list[Any] = [None] * width
    for cell in cells:
        if cell["row"] != row:
            raise _unreadable(place, f"a cell of row {cell['row']} is in row {row}")
        values[cell["column"] - 1] = cell["value"]
    return values


def _check_archive(path: Path, archive: zipfile.ZipFile) -> None:
    """Refuse an archive that unpacks to more than is read, before more than the beginnings of its parts is unpacked."""
    entries = archive.infolist()
    _refuse_above(path, "the workbook", sum(entry.file_size for entry in entries), MEMORY_LIMIT)
    for entry in entries:
        if entry.file_size > max(_BOMB_BYTES, _BOMB_RATIO * entry.compress_size):
            problem = f"its part '{entry.filename}' of {entry.compress_size} bytes unpacks to {entry.file_size} bytes"
            raise InputError(f"{path}: {problem}, as no sheet of measurements does: save the sheet as CSV")
    roots = {entry: _root_element(path, archive, entry) for entry in entries}
    held = sum(entry.file_size for entry, root in roots.items() if root not in ("", "worksheet"))
    _refuse_above(path, "the workbook without its sheets", held, _MAX_HELD_BYTES)


def _refuse_above(path: Path, what: str, size: int, limit: int) -> None:
    if size > limit:
        sizes = f"{size / 2**30:.1f} GiB, above the limit of {limit / 2**30:.3g} GiB"
        raise InputError(f"{path}: {what} needs {sizes}: save the sheet as CSV")


def _root_element(path: Path, archive: zipfile.ZipFile, entry: zipfile.ZipInfo) -> str:
    """Return the name of the first element of a part; empty for a picture.

    A part with a document type, whose entities could grow without a limit, is refused: no workbook has one (ECMA-376).
    """
    parser, names, types = expat.ParserCreate(namespace_separator=" "), [], []
    parser.StartDoctypeDeclHandler = lambda *_: types.append(True)
    parser.StartElementHandler = lambda name, _: names.append(name.rpartition(" ")[2])
    with archive.open(entry) as part:
        try:
            for _ in range(_PROLOG_BYTES // _PIECE_BYTES):
                piece = part.read(_PIECE_BYTES)
                parser.Parse(piece, not piece)
                if names or types or not piece:
                    break
        except expat.ExpatError:  # a picture, or damage that is named when the part is read
            if not types:
                return names[0] if names else ""
    if types or not names:
        problem = "has a document type" if types else "does not begin with an element"
        raise _unreadable(path, f"its part '{entry.filename}' {problem}")
    return names[0]
