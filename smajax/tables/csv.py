"""CSV: strict, exact, and quick on files of ten million rows.

The file is read in blocks. A block of nothing but plain numbers goes to NumPy's C reader as a whole. Any other block is halved until the
rows that spoil it stand alone, and only these are read cell by cell, which finds the culprit's row and column and understands quotes.
"""

import csv
import hashlib
import io
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import final

import numpy as np

from smajax.errors import InputError
from smajax.tables.base import REPAIR, Table, number_in, refuse_if_too_large, why_not_a_number

BLOCK = 4 * 2**20
_LONGEST_ROW = 2**20
_ROWS_READ_SINGLY = 32
_UTF8_MARK = b"\xef\xbb\xbf"
_NAMES_OF_DELIMITERS = {";": '";"', "\t": '"\\t"', ",": '","', "|": '"|"'}


@final
class CsvTable(Table):
    """A text file with one header row, or with none if ``headers`` are given.

    ``delimiter`` is one character, ``decimal`` is ``.`` or ``,``, ``skip_rows`` rows come first.
    """

    def __init__(self, path: Path, skip_rows: int, delimiter: str, decimal: str, headers: Sequence[str] | None = None):
        self.path, self.delimiter, self.decimal = path, delimiter, decimal
        self._check_dialect(skip_rows)
        self._digest = hashlib.sha256()
        with path.open("rb") as file:
            self._refuse_other_than_text(file.read(BLOCK))
            file.seek(len(_UTF8_MARK) if self._marked else 0)
            for skipped in range(skip_rows):
                if not file.readline():
                    raise InputError(f"{path}: the file has {skipped} rows, and skip_rows = {skip_rows} leaves nothing: lower skip_rows")
            begins = file.tell()
            line = file.readline(_LONGEST_ROW)
            self._data_begins = file.tell() if headers is None else begins
            next_line = file.readline(_LONGEST_ROW)
        self._header_row = skip_rows + 1
        self.first_row = skip_rows + (2 if headers is None else 1)
        self.headers = self._header_in(line, next_line) if headers is None else self._given(headers, line)

    def load(self, wanted: Sequence[int], lenient: bool) -> list[np.ndarray]:
        refuse_if_too_large(self.path, self._likely_rows(), len(wanted))
        parts: list[list[np.ndarray]] = [[] for _ in wanted]
        rows = 0
        for block in self._blocks():
            numbers = self._numbers(block, self.first_row + rows, wanted, lenient)
            rows += len(numbers)
            refuse_if_too_large(self.path, rows, len(wanted))
            for part, column in zip(parts, numbers.T, strict=True):
                part.append(column.copy())
        if not rows:
            raise InputError(f"{self.path}: the file ends after the header in row {self._header_row}: record at least two rows of data")
        columns = []
        for part in parts:
            columns.append(np.concatenate(part))
            part.clear()
        return columns

    def sha256(self) -> str:
        return self._digest.hexdigest()

    def _check_dialect(self, skip_rows: int) -> None:
        if skip_rows < 0:
            raise InputError(f"{self.path}: skip_rows = {skip_rows} is negative: give the number of rows before the header")
        if self.decimal not in (".", ","):
            raise InputError(f'{self.path}: decimal = "{self.decimal}" is not known: it is "." or ","')
        if len(self.delimiter) != 1 or self.delimiter.isalnum() or not self.delimiter.isascii() or self.delimiter in '+-."\r\n':
            raise InputError(f'{self.path}: delimiter = {self.delimiter!r} is not possible: give one such as ",", ";" or "\\t"')
        if self.delimiter == self.decimal:
            raise InputError(f'{self.path}: delimiter and decimal are both "{self.decimal}": set delimiter = ";" or "\\t"')

    def _refuse_other_than_text(self, head: bytes) -> None:
        """A first look at the file: text in UTF-8, with or without its mark, rows ended by a line feed."""
        self._marked = head.startswith(_UTF8_MARK)
        fewer, more = sorted((head[0:2000:2].count(0), head[1:2000:2].count(0)))
        if head.startswith((b"\xff\xfe", b"\xfe\xff")) or more > len(head[:2000]) // 4 > 5 * fewer:
            raise InputError(f"{self.path}: row 1: the text is encoded in UTF-16: save the file as UTF-8")
        if head.startswith(b"PK\x03\x04"):
            raise InputError(f"{self.path}: the file is a workbook or archive and not text: save it as CSV in UTF-8, or name it .xlsx")
        control = head.translate(None, bytes(range(32, 256)) + b"\t\n\r\f")
        if control:
            row = head[: head.index(control[:1])].count(b"\n") + 1
            raise InputError(f"{self.path}: row {row}: the file is binary (byte 0x{control[0]:02x}), not text: save it as CSV in UTF-8")
        if not head[3 * self._marked :].strip():
            raise InputError(f"{self.path}: the file is empty: record a header like 'time [s],current [A]' and rows of numbers")
        if b"\n" not in head and b"\r" in head:
            raise InputError(f"{self.path}: row 1: rows end in a bare carriage return: save the file as Unix or Windows text")

    def _header_in(self, line: bytes, next_line: bytes) -> tuple[str, ...]:
        place = f"{self.path}: row {self._header_row}"
        if len(line) >= _LONGEST_ROW:
            raise InputError(f"{place}: the row is longer than {_LONGEST_ROW} bytes, so this is no table: end every row with a line feed")
        cells = self._cells(line, self._header_row)
        if not any(cells):
            raise InputError(f"{place}: the row is blank where the header is expected: give names and units, or set skip_rows")
        filled = [cell for cell in cells if cell]
        if all(number_in(cell, self.decimal) is not None or cell.lower() == "nan" for cell in filled):
            raise InputError(f"{place}: the header is missing ('{filled[0]}' is a number): begin with a row like 'time [s],current [A]'")
        others = [other for other in _NAMES_OF_DELIMITERS if other != self.delimiter and other in cells[0]]
        if len(cells) == 1 and not others and self.delimiter != " " and self._spaced(next_line):
            raise InputError(f'{place}: the columns are separated by spaces: set delimiter = " " under [channels] in the rig')
        if len(cells) == 1 and others:
            comma = 'and decimal = "," ' if others[0] != "," and b"," in next_line and b"." not in next_line else ""
            raise InputError(
                f"{place}: the columns are separated by {_NAMES_OF_DELIMITERS[others[0]]}: "
                f"set delimiter = {_NAMES_OF_DELIMITERS[others[0]]} {comma}under [channels] in the rig"
            )
        return tuple(cells)

    def _spaced(self, line: bytes) -> bool:
        """Whether a row is several numbers with spaces between; a header of one column may have a space before its unit."""
        parts = line.decode("utf-8", "replace").split(" ")
        found = [part.strip() for part in parts if part.strip()]
        return len(found) > 1 and all(number_in(part, self.decimal) is not None for part in found)

    def _given(self, headers: Sequence[str], line: bytes) -> tuple[str, ...]:
        cells = self._cells(line, self.first_row)
        others = [_NAMES_OF_DELIMITERS[c] for c in _NAMES_OF_DELIMITERS if len(cells) == 1 and c != self.delimiter and c in cells[0]]
        if others:
            raise InputError(f"{self.path}: row {self.first_row}: the columns are separated by {others[0]}: set delimiter = {others[0]}")
        if len(cells) != len(headers):
            told = f"the row has {len(cells)} cells, and {len(headers)} columns are named"
            raise InputError(f"{self.path}: row {self.first_row}: {told}: name every column, those that are not wanted by -")
        if number_in(cells[0], self.decimal) is None:
            raise InputError(f"{self.path}: row {self.first_row}: '{cells[0]}' is not a number: if this is a header, name no columns")
        return tuple(headers)

    def _likely_rows(self) -> float:
        with self.path.open("rb") as file:
            size = file.seek(0, io.SEEK_END) - self._data_begins
            file.seek(self._data_begins)
            sample = file.read(BLOCK)
        return size * max(sample.count(b"\n"), 1) / max(len(sample), 1)

    def _blocks(self) -> Iterator[bytes]:
        """Whole rows, about BLOCK bytes at a time; blank rows at the end of the file are no rows."""
        with self.path.open("rb") as file:
            self._digest.update(file.read(self._data_begins))
            rest = b""
            while piece := file.read(BLOCK):
                self._digest.update(piece)
                rest += piece
                if len(rest) > 2 * BLOCK and b"\n" not in rest:
                    raise InputError(f"{self.path}: a row is longer than {BLOCK} bytes: end every row with a line feed")
                end = len(rest[: rest.rfind(b"\n") + 1].rstrip(b" \r\n" if self.delimiter != " " else b"\r\n"))
                end = rest.find(b"\n", end) + 1 if end else 0
                if end:
                    yield rest[:end].replace(b"\r\n", b"\n")
                rest = rest[end:]
            if rest.strip():
                yield rest.rstrip(b"\r\n").replace(b"\r\n", b"\n") + b"\n"

    def _numbers(self, block: bytes, row: int, wanted: Sequence[int], lenient: bool) -> np.ndarray:
        """The wanted columns (rows, wanted) of a block whose first row has the number ``row``."""
        plain = self._plain_numbers(block)
        if plain is not None:
            return plain[:, wanted]
        rows = block.count(b"\n")
        if rows > _ROWS_READ_SINGLY:
            middle = block.find(b"\n", len(block) // 2) + 1
            if middle < len(block):
                first = self._numbers(block[:middle], row, wanted, lenient)
                return np.concatenate([first, self._numbers(block[middle:], row + len(first), wanted, lenient)])
        lines = block.split(b"\n")[:-1]
        return np.array([self._row(line, row + i, wanted, lenient) for i, line in enumerate(lines)]).reshape(rows, len(wanted))

    def _plain_numbers(self, block: bytes) -> np.ndarray | None:
        """All columns of a block that holds nothing but finite numbers in full rows, else None."""
        allowed = b"0123456789+-eE \n" + self.decimal.encode() + self.delimiter.encode()
        if block.translate(None, allowed) or not block.strip():
            return None
        if self.decimal == ",":
            block = block.replace(b",", b".")
        try:
            numbers = np.loadtxt(io.BytesIO(block), delimiter=self.delimiter, comments=None, ndmin=2)
        except ValueError:
            return None
        whole = numbers.shape == (block.count(b"\n"), len(self.headers)) and bool(np.isfinite(numbers).all())
        return numbers if whole else None

    def _row(self, line: bytes, row: int, wanted: Sequence[int], lenient: bool) -> list[float]:
        """One row, cell by cell; NaN for what is no number, if ``lenient``."""
        place = f"{self.path}: row {row}"
        if len(line) > _LONGEST_ROW:
            raise InputError(f"{place}: the row is longer than {_LONGEST_ROW} bytes: end every row with a line feed")
        try:
            cells = self._cells(line, row)
            if len(cells) != len(self.headers):
                raise InputError(self._why_ragged(place, cells))
        except InputError:
            if lenient:
                return [np.nan] * len(wanted)
            raise
        numbers = []
        for column in wanted:
            number = number_in(cells[column], self.decimal)
            if number is None and not lenient:
                raise InputError(f"{place}, column '{self.headers[column]}': {why_not_a_number(cells[column], self.decimal)}")
            numbers.append(np.nan if number is None else number)
        return numbers

    def _why_ragged(self, place: str, cells: list[str]) -> str:
        if not any(cells):
            return f"{place}: the row is blank: {REPAIR}"
        count = f"{place}: the row has {len(cells)} cells and the header {len(self.headers)}"
        if self.delimiter == "," and len(self.headers) < len(cells) <= 2 * len(self.headers):
            return f"{count}: if the commas are decimal commas, save with another delimiter and set delimiter and decimal under [channels]"
        return f"{count}: {REPAIR}"

    def _cells(self, line: bytes, row: int) -> list[str]:
        try:
            text = line.decode("utf-8").rstrip("\r\n")
            return [cell.strip() for cell in next(csv.reader([text], delimiter=self.delimiter), [""])]
        except UnicodeDecodeError as error:
            odd = line[error.start]
            raise InputError(f"{self.path}: row {row}: the byte 0x{odd:02x} is not UTF-8 text: save the file as UTF-8") from None
        except csv.Error:
            raise InputError(f"{self.path}: row {row}: the row cannot be divided into cells: {REPAIR}") from None
