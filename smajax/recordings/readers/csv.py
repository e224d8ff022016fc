"""Reader of CSV and text files: strict, exact, and fast on files with ten million rows.

The file is read in blocks. A block of plain numbers only is parsed as a whole by NumPy's C reader. Any other block is
halved until it has few rows; these are read cell by cell, which handles quotes and finds the row and column of a bad
cell.
"""

import csv
import hashlib
import io
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any, final

import numpy as np

from smajax.errors import InputError, shortened
from smajax.recordings.read_options import ReadOptions, check_delimiter
from smajax.recordings.readers.base import (
    Table,
    file_sha256,
    number_error,
    parse_number,
    refuse_if_too_large,
    row_error,
)
from smajax.recordings.readers.encoding import decode_row, open_as_utf8
from smajax.recordings.readers.header_rows import has_header, is_value, read_header_rows
from smajax.recordings.readers.quoted_rows import QUOTED_ROWS_NOTE, are_rows_quoted, divide_row
from smajax.recordings.readers.time_stamps import ROWS_WITH_STAMPS, StampColumn, find_stamps

# Bytes that are read at a time: no effect on the numbers; large enough that the overhead of a block is negligible.
BLOCK = 4 * 2**20
# Bytes of the longest row: a file with longer ones is not a table.
_LONGEST_ROW = 2**20
# Number of rows up to which a block with other cells than plain numbers is read cell by cell; chosen for speed.
_ROWS_READ_SINGLY = 32
# Rows after the skipped ones that are looked at for headers, units, time stamps and the place of the header.
_ROWS_LOOKED_AT = 30
_DELIMITER_TEXTS = {";": '";"', "\t": '"\\t"', ",": '","', "|": '"|"'}


@final
class CsvTable(Table):
    """A text file.

    Args:
        path: The file.
        options: Options of reading.
    """

    def __init__(self, path: Path, options: ReadOptions):
        self.path: Path = path
        self.delimiter: str = options.delimiter
        self.decimal: str = options.decimal
        self._encoding = options.encoding
        check_delimiter(options, path)
        self._digest = ""
        with open_as_utf8(path, options.encoding) as file:
            start = file.tell()
            self._refuse_other_than_text(file.read(BLOCK))
            file.seek(start)
            for skipped in range(options.skip_rows):
                if not file.readline():
                    problem = f"the file has only {skipped} rows, fewer than skip_rows = {options.skip_rows}"
                    raise InputError(f"{path}: {problem}: lower skip_rows")
            self._data_start = file.tell()
            lines = [file.readline(_LONGEST_ROW) for _ in range(_ROWS_LOOKED_AT)]
        self._header_row = options.skip_rows + 1
        texts = [line.decode("utf-8", "replace").rstrip("\r\n") for line in lines]
        self._quoted_rows = are_rows_quoted(texts, options.delimiter)
        self._read_header_rows([line for line in lines if line], options)

    def _read_header_rows(self, lines: Sequence[bytes], options: ReadOptions) -> None:
        """Read headers, units and the kinds of time stamps from the first rows that are not skipped."""
        first = self._cells(lines[0], self._header_row) if lines else [""]
        if len(lines) == 0 or len(lines[0]) >= _LONGEST_ROW or has_header(first, options):
            first = self._check_header(lines[0] if lines else b"", lines[1] if len(lines) > 1 else b"", options)
        else:
            self._refuse_other_delimiter(f"{self.path}: row {self._header_row}", first, b"")
        cells = [first, *(self._peek(line) for line in lines[1:])]
        if options.columns is None or len(first) == 1:
            self._refuse_title(first, cells)
        result = read_header_rows(str(self.path), self._header_row, cells, options)
        self.headers: tuple[str, ...] = result.headers
        self.notes: tuple[str, ...] = (*((QUOTED_ROWS_NOTE,) * self._quoted_rows), *result.notes)
        self.first_row: int = self._header_row + result.rows
        self._data_start += sum(len(line) for line in lines[: result.rows])
        self.first_cells: Sequence[Sequence[Any]] = cells[result.rows : result.rows + ROWS_WITH_STAMPS]
        self.stamps: Mapping[int, StampColumn] = find_stamps(self.first_cells, options.time_format)

    def load(self, indices: Sequence[int], lenient: bool) -> list[np.ndarray]:
        """Return columns of numbers, which are read block by block."""
        refuse_if_too_large(self.path, self._estimate_rows(), len(indices))
        parts: list[list[np.ndarray]] = [[] for _ in indices]
        rows = 0
        for block in self._blocks():
            numbers = self._numbers(block, self.first_row + rows, indices, lenient)
            rows += len(numbers)
            refuse_if_too_large(self.path, rows, len(indices))
            for part, column in zip(parts, numbers.T, strict=True):
                part.append(column.copy())
        if not rows:
            problem = f"the file ends after the header in row {self._header_row}"
            raise InputError(f"{self.path}: {problem}: record at least two rows of data")
        columns = []
        for part in parts:
            columns.append(np.concatenate(part))
            part.clear()
        return self.unwrap_stamps(indices, columns)

    def sha256(self) -> str:
        """Return the SHA-256 of the file in hexadecimal."""
        return file_sha256(self.path) if not self._digest else self._digest

    def _refuse_other_than_text(self, head: bytes) -> None:
        """Check that the file begins as text in rows with a line feed."""
        if head.startswith(b"PK\x03\x04"):
            cure = "save it as CSV in UTF-8, or name it .xlsx"
            raise InputError(f"{self.path}: the file is a workbook or archive and not text: {cure}")
        control = head.translate(None, bytes(range(32, 256)) + b"\t\n\r\f")
        if control:
            row = head[: head.index(control[:1])].count(b"\n") + 1
            problem = f"the file is binary (byte 0x{control[0]:02x}), not text"
            raise InputError(f"{self.path}: row {row}: {problem}: save it as CSV in UTF-8")
        if not head.strip():
            cure = "record a header like 'time [s],current [A]' and rows of numbers"
            raise InputError(f"{self.path}: the file is empty: {cure}")
        if b"\n" not in head and b"\r" in head:
            cure = "save the file as Unix or Windows text"
            raise InputError(f"{self.path}: row 1: rows end in a bare carriage return: {cure}")

    def _check_header(self, line: bytes, next_line: bytes, options: ReadOptions) -> list[str]:
        """Return the cells of the row of headers, if it is one."""
        place = f"{self.path}: row {self._header_row}"
        if len(line) >= _LONGEST_ROW:
            problem = f"the row is longer than {_LONGEST_ROW} bytes, so this is not a table"
            raise InputError(f"{place}: {problem}: end every row with a line feed")
        cells = self._cells(line, self._header_row)
        if not any(cells):
            cure = "give names and units, or set skip_rows"
            raise InputError(f"{place}: the row is blank where the header is expected: {cure}")
        filled = [cell for cell in cells if cell]
        if options.columns is None and all(is_value(cell, self.decimal) for cell in filled):
            cure = "begin with a row like 'time [s],current [A]', or set columns under [recording] in the rig"
            problem = f"the header is missing ('{filled[0]}' is a {'number' if ':' not in filled[0] else 'time'})"
            raise InputError(f"{place}: {problem}: {cure}", code="header-missing", cure=cure)
        self._refuse_other_delimiter(place, cells, next_line)
        return cells

    def _refuse_title(self, first: Sequence[str], rows: Sequence[Sequence[str]]) -> None:
        """Refuse a line of a title that is not the header, since a row further down has more cells."""
        if len([cell for cell in first if cell]) > 1:
            return
        widths = [len([cell for cell in cells if cell]) for cells in rows]
        later = next((k for k, width in enumerate(widths) if width > 1 and width == max(widths)), 0)
        if not later:
            return
        count = self._header_row - 1 + later
        cure = f"set skip_rows = {count} under [recording] in the rig"
        problem = f"the row has a single cell, '{shortened(first[0])}', and row {count + 1} has {widths[later]}"
        message = f"{self.path}: row {self._header_row}: {problem}: {cure}"
        raise InputError(message, code="title-rows", cure=cure, skip_rows=count)

    def _peek(self, line: bytes) -> list[str]:
        """Return the cells of one of the first rows; none if it cannot be divided into cells."""
        try:
            return self._cells(line, 0)
        except InputError:
            return []

    def _refuse_other_delimiter(self, place: str, cells: Sequence[str], next_line: bytes) -> None:
        """Refuse a header of one cell that another delimiter divides."""
        others = [other for other in _DELIMITER_TEXTS if other != self.delimiter and other in cells[0]]
        if len(cells) == 1 and not others and self.delimiter != " " and self._is_spaced(next_line):
            cure = 'set delimiter = " " under [recording] in the rig'
            problem = "the columns are separated by spaces"
            raise InputError(f"{place}: {problem}: {cure}", code="delimiter", cure=cure, delimiter=" ")
        if len(cells) == 1 and others:
            comma = 'and decimal = "," ' if others[0] != "," and b"," in next_line and b"." not in next_line else ""
            name = _DELIMITER_TEXTS[others[0]]
            cure = f"set delimiter = {name} {comma}under [recording] in the rig"
            raise InputError(
                f"{place}: the columns are separated by {name}: {cure}",
                code="delimiter",
                cure=cure,
                delimiter=name,
                decimal="," if comma else ".",
            )

    def _is_spaced(self, line: bytes) -> bool:
        """Return whether a row is several numbers with spaces between (a header may have a space before its unit)."""
        texts = [part.strip() for part in line.decode("utf-8", "replace").split(" ") if part.strip()]
        return len(texts) > 1 and all(parse_number(text, self.decimal) is not None for text in texts)

    def _estimate_rows(self) -> float:
        """Return the number of rows, estimated from the first block."""
        with open_as_utf8(self.path, self._encoding) as file:
            size = file.seek(0, io.SEEK_END) - self._data_start
            file.seek(self._data_start)
            sample = file.read(BLOCK)
        return size * max(sample.count(b"\n"), 1) / max(len(sample), 1)

    def _blocks(self) -> Iterator[bytes]:
        """Yield whole rows, about BLOCK bytes at a time, without blank rows at the end of the file."""
        with open_as_utf8(self.path, self._encoding) as file:
            digest = hashlib.sha256() if not isinstance(file, io.BytesIO) else None
            if digest:
                file.seek(0)
                digest.update(file.read(self._data_start))
            file.seek(self._data_start)
            pending = b""
            while piece := file.read(BLOCK):
                if digest:
                    digest.update(piece)
                pending += piece
                if len(pending) > 2 * BLOCK and b"\n" not in pending:
                    raise InputError(f"{self.path}: a row is longer than {BLOCK} bytes: end every row with a line feed")
                end = len(pending[: pending.rfind(b"\n") + 1].rstrip(b" \r\n"))
                end = pending.find(b"\n", end) + 1 if end else 0
                if end:
                    yield pending[:end].replace(b"\r\n", b"\n")
                pending = pending[end:]
            if pending.strip():
                yield pending.rstrip(b"\r\n").replace(b"\r\n", b"\n") + b"\n"
            self._digest = digest.hexdigest() if digest else ""

    def _numbers(self, block: bytes, row: int, indices: Sequence[int], lenient: bool) -> np.ndarray:
        """Return an array (rows, len(indices)) of a block whose first row has the number ``row``."""
        plain = None if self.stamps else self._plain_numbers(block)
        if plain is not None:
            return plain[:, indices]
        rows = block.count(b"\n")
        if rows > _ROWS_READ_SINGLY:
            middle = block.find(b"\n", len(block) // 2) + 1
            if middle < len(block):
                first = self._numbers(block[:middle], row, indices, lenient)
                return np.concatenate([first, self._numbers(block[middle:], row + len(first), indices, lenient)])
        lines = block.split(b"\n")[:-1]
        numbers = np.array([self._row(line, row + i, indices, lenient) for i, line in enumerate(lines)])
        return numbers.reshape(rows, len(indices))

    def _plain_numbers(self, block: bytes) -> np.ndarray | None:
        """Return all columns of a block that has only finite numbers in full rows, else ``None``."""
        if self._quoted_rows:
            block = block.replace(b'"', b"")
        allowed = b"0123456789+-eE \n" + self.decimal.encode() + self.delimiter.encode()
        if block.translate(None, allowed) or not block.strip():
            return None
        if self.decimal == ",":
            block = block.replace(b",", b".")
        try:
            delimiter = None if self.delimiter == " " else self.delimiter  # None: one or more spaces
            numbers = np.loadtxt(io.BytesIO(block), delimiter=delimiter, comments=None, ndmin=2)
        except ValueError:
            return None
        is_full = numbers.shape == (block.count(b"\n"), len(self.headers)) and bool(np.isfinite(numbers).all())
        return numbers if is_full else None

    def _row(self, line: bytes, row: int, indices: Sequence[int], lenient: bool) -> list[float]:
        """Read one row cell by cell; if ``lenient``, a cell that is not a number is NaN."""
        place = f"{self.path}: row {row}"
        if len(line) > _LONGEST_ROW:
            raise InputError(f"{place}: the row is longer than {_LONGEST_ROW} bytes: end every row with a line feed")
        try:
            cells = self._cells(line, row)
            if len(cells) == len(self.headers) + 1 and not cells[-1]:  # the row ends with a delimiter
                cells.pop()
            if len(cells) != len(self.headers):
                raise self._ragged_error(place, cells)
        except InputError:
            if lenient:
                return [np.nan] * len(indices)
            raise
        numbers = []
        for index in indices:
            number = self._number(cells, index)
            if number is None and not lenient:
                cell_place = f"{place}, column '{self.headers[index]}'"
                text = self.stamps[index].text_in_row(cells, index) if index in self.stamps else cells[index]
                raise number_error(cell_place, text, self.decimal, first=row == self.first_row)
            numbers.append(np.nan if number is None else number)
        return numbers

    def _number(self, cells: Sequence[str], index: int) -> float | None:
        """Return the number in a cell of a row, seconds for a time stamp, or ``None``."""
        stamps = self.stamps.get(index)
        return parse_number(cells[index], self.decimal) if stamps is None else stamps.seconds_in_row(cells, index)

    def _ragged_error(self, place: str, cells: list[str]) -> InputError:
        if not any(cells):
            return row_error(f"{place}: the row is blank")
        count = f"{place}: the row has {len(cells)} cells and the header {len(self.headers)}"
        if self.delimiter == "," and len(self.headers) < len(cells) <= 2 * len(self.headers):
            cure = "save with another delimiter and set delimiter and decimal under [recording]"
            problem = f"{count}: if the commas are decimal commas"
            return InputError(f"{problem}, {cure}", code="decimal-commas", cure=cure)
        return row_error(count)

    def _cells(self, line: bytes, row: int) -> list[str]:
        try:
            text = decode_row(line, self._encoding).rstrip("\r\n")
            return divide_row(text, self.delimiter, self._quoted_rows)
        except UnicodeDecodeError as error:
            problem = f"the byte 0x{line[error.start]:02x} is not UTF-8 text"
            raise InputError(f"{self.path}: row {row}: {problem}: save the file as UTF-8") from None
        except csv.Error:
            raise row_error(f"{self.path}: row {row}: the row cannot be divided into cells") from None
