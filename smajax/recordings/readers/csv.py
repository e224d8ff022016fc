"""Reader of CSV and text files: strict, exact, and fast on files with ten million rows.

The file is read in blocks. A block of plain numbers only is parsed as a whole by NumPy's C reader. Any other block is
halved until it has few rows; these are read cell by cell, which handles quotes and finds the row and column of a bad
cell.
"""

import csv
import hashlib
import io
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import final

import numpy as np

from smajax.errors import InputError
from smajax.recordings.readers.base import Table, number_error, parse_number, refuse_if_too_large, row_error

# Bytes that are read at a time: no effect on the numbers; large enough that the overhead of a block is negligible.
BLOCK = 4 * 2**20
# Bytes of the longest row: a file with longer ones is not a table.
_LONGEST_ROW = 2**20
# Number of rows up to which a block with other cells than plain numbers is read cell by cell; chosen for speed.
_ROWS_READ_SINGLY = 32
# Bytes at the beginning of the file that are tested for UTF-16.
_ENCODING_SAMPLE = 2000
# Latin text in UTF-16 has a zero in every other byte, all in even or all in odd places. Half as many zeros are enough,
# and this number has to be more than five times that of the zeros in the other places. Chosen by trial.
_BYTES_PER_ZERO = 4
_ZERO_RATIO = 5
_UTF8_MARK = b"\xef\xbb\xbf"
_DELIMITER_TEXTS = {";": '";"', "\t": '"\\t"', ",": '","', "|": '"|"'}


@final
class CsvTable(Table):
    """A text file with one header row.

    Args:
        path: The file.
        skip_rows: Rows before the header.
        delimiter: One character.
        decimal: Decimal sign, ``.`` or ``,``.
        headers: Headers of a file without a header row.
    """

    def __init__(self, path: Path, skip_rows: int, delimiter: str, decimal: str, headers: Sequence[str] | None = None):
        self.path: Path = path
        self.delimiter: str = delimiter
        self.decimal = decimal
        self._check_dialect(skip_rows)
        self._digest = hashlib.sha256()
        with path.open("rb") as file:
            self._refuse_other_than_text(file.read(BLOCK))
            file.seek(len(_UTF8_MARK) if self._marked else 0)
            for skipped in range(skip_rows):
                if not file.readline():
                    problem = f"the file has only {skipped} rows, fewer than skip_rows = {skip_rows}"
                    raise InputError(f"{path}: {problem}: lower skip_rows")
            start = file.tell()
            line = file.readline(_LONGEST_ROW)
            self._data_start = file.tell() if headers is None else start
            next_line = file.readline(_LONGEST_ROW)
        self._header_row = skip_rows + 1
        self.first_row: int = skip_rows + (2 if headers is None else 1)
        self.headers: tuple[str, ...] = (
            self._read_headers(line, next_line) if headers is None else self._check_headers(headers, line)
        )

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
        return columns

    def sha256(self) -> str:
        """Return the SHA-256 of the bytes that ``load`` read."""
        return self._digest.hexdigest()

    def _check_dialect(self, skip_rows: int) -> None:
        if skip_rows < 0:
            cure = "give the number of rows before the header"
            raise InputError(f"{self.path}: skip_rows = {skip_rows} is negative: {cure}")
        if self.decimal not in (".", ","):
            raise InputError(f'{self.path}: decimal = "{self.decimal}" is not known: it is "." or ","')
        single = len(self.delimiter) == 1 and self.delimiter.isascii()
        if not single or self.delimiter.isalnum() or self.delimiter in '+-."\r\n':
            cure = 'give one such as ",", ";" or "\\t"'
            raise InputError(f"{self.path}: delimiter = {self.delimiter!r} is not possible: {cure}")
        if self.delimiter == self.decimal:
            problem = f'delimiter and decimal are both "{self.decimal}"'
            cure = 'set delimiter = ";" or "\\t"'
            raise InputError(f"{self.path}: {problem}: {cure}", code="delimiter-is-decimal", cure=cure)

    def _refuse_other_than_text(self, head: bytes) -> None:
        """Check that the file begins as text in UTF-8, with or without a byte order mark, in rows with a line feed."""
        self._marked = head.startswith(_UTF8_MARK)
        sample = head[:_ENCODING_SAMPLE]
        min_zeros = len(sample) // _BYTES_PER_ZERO
        fewer, more = sorted((sample[0::2].count(0), sample[1::2].count(0)))
        if head.startswith((b"\xff\xfe", b"\xfe\xff")) or more > min_zeros > _ZERO_RATIO * fewer:
            raise InputError(f"{self.path}: row 1: the text is encoded in UTF-16: save the file as UTF-8")
        if head.startswith(b"PK\x03\x04"):
            cure = "save it as CSV in UTF-8, or name it .xlsx"
            raise InputError(f"{self.path}: the file is a workbook or archive and not text: {cure}")
        control = head.translate(None, bytes(range(32, 256)) + b"\t\n\r\f")
        if control:
            row = head[: head.index(control[:1])].count(b"\n") + 1
            problem = f"the file is binary (byte 0x{control[0]:02x}), not text"
            raise InputError(f"{self.path}: row {row}: {problem}: save it as CSV in UTF-8")
        if not head[len(_UTF8_MARK) * self._marked :].strip():
            cure = "record a header like 'time [s],current [A]' and rows of numbers"
            raise InputError(f"{self.path}: the file is empty: {cure}")
        if b"\n" not in head and b"\r" in head:
            cure = "save the file as Unix or Windows text"
            raise InputError(f"{self.path}: row 1: rows end in a bare carriage return: {cure}")

    def _read_headers(self, line: bytes, next_line: bytes) -> tuple[str, ...]:
        place = f"{self.path}: row {self._header_row}"
        if len(line) >= _LONGEST_ROW:
            problem = f"the row is longer than {_LONGEST_ROW} bytes, so this is not a table"
            raise InputError(f"{place}: {problem}: end every row with a line feed")
        cells = self._cells(line, self._header_row)
        if not any(cells):
            cure = "give names and units, or set skip_rows"
            raise InputError(f"{place}: the row is blank where the header is expected: {cure}")
        filled = [cell for cell in cells if cell]
        if all(parse_number(cell, self.decimal) is not None or cell.lower() == "nan" for cell in filled):
            cure = "begin with a row like 'time [s],current [A]'"
            problem = f"the header is missing ('{filled[0]}' is a number)"
            raise InputError(f"{place}: {problem}: {cure}", code="header-missing", cure=cure)
        self._refuse_other_delimiter(place, cells, next_line)
        return tuple(cells)

    def _refuse_other_delimiter(self, place: str, cells: Sequence[str], next_line: bytes) -> None:
        """Refuse a header of one cell that another delimiter divides."""
        others = [other for other in _DELIMITER_TEXTS if other != self.delimiter and other in cells[0]]
        if len(cells) == 1 and not others and self.delimiter != " " and self._is_spaced(next_line):
            cure = 'set delimiter = " " under [channels] in the rig'
            problem = "the columns are separated by spaces"
            raise InputError(f"{place}: {problem}: {cure}", code="delimiter", cure=cure, delimiter=" ")
        if len(cells) == 1 and others:
            comma = 'and decimal = "," ' if others[0] != "," and b"," in next_line and b"." not in next_line else ""
            name = _DELIMITER_TEXTS[others[0]]
            cure = f"set delimiter = {name} {comma}under [channels] in the rig"
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

    def _check_headers(self, headers: Sequence[str], line: bytes) -> tuple[str, ...]:
        """Return the headers of the caller, if they fit the first row of data."""
        place = f"{self.path}: row {self.first_row}"
        cells = self._cells(line, self.first_row)
        others = [text for c, text in _DELIMITER_TEXTS.items() if c != self.delimiter and c in cells[0]]
        if len(cells) == 1 and others:
            problem, cure = f"the columns are separated by {others[0]}", f"set delimiter = {others[0]}"
            raise InputError(f"{place}: {problem}: {cure}", code="delimiter", cure=cure, delimiter=others[0])
        if len(cells) != len(headers):
            count = f"the row has {len(cells)} cells, and {len(headers)} columns are named"
            raise InputError(f"{place}: {count}: name every column, with - for one to ignore")
        if parse_number(cells[0], self.decimal) is None:
            raise InputError(f"{place}: '{cells[0]}' is not a number: if this is a header, name no columns")
        return tuple(headers)

    def _estimate_rows(self) -> float:
        """Return the number of rows, estimated from the first block."""
        with self.path.open("rb") as file:
            size = file.seek(0, io.SEEK_END) - self._data_start
            file.seek(self._data_start)
            sample = file.read(BLOCK)
        return size * max(sample.count(b"\n"), 1) / max(len(sample), 1)

    def _blocks(self) -> Iterator[bytes]:
        """Yield whole rows, about BLOCK bytes at a time, without blank rows at the end of the file."""
        with self.path.open("rb") as file:
            self._digest.update(file.read(self._data_start))
            pending = b""
            while piece := file.read(BLOCK):
                self._digest.update(piece)
                pending += piece
                if len(pending) > 2 * BLOCK and b"\n" not in pending:
                    raise InputError(f"{self.path}: a row is longer than {BLOCK} bytes: end every row with a line feed")
                blank = b" \r\n" if self.delimiter != " " else b"\r\n"
                end = len(pending[: pending.rfind(b"\n") + 1].rstrip(blank))
                end = pending.find(b"\n", end) + 1 if end else 0
                if end:
                    yield pending[:end].replace(b"\r\n", b"\n")
                pending = pending[end:]
            if pending.strip():
                yield pending.rstrip(b"\r\n").replace(b"\r\n", b"\n") + b"\n"

    def _numbers(self, block: bytes, row: int, indices: Sequence[int], lenient: bool) -> np.ndarray:
        """Return an array (rows, len(indices)) of a block whose first row has the number ``row``."""
        plain = self._plain_numbers(block)
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
        allowed = b"0123456789+-eE \n" + self.decimal.encode() + self.delimiter.encode()
        if block.translate(None, allowed) or not block.strip():
            return None
        if self.decimal == ",":
            block = block.replace(b",", b".")
        try:
            numbers = np.loadtxt(io.BytesIO(block), delimiter=self.delimiter, comments=None, ndmin=2)
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
            if len(cells) != len(self.headers):
                raise self._ragged_error(place, cells)
        except InputError:
            if lenient:
                return [np.nan] * len(indices)
            raise
        numbers = []
        for index in indices:
            number = parse_number(cells[index], self.decimal)
            if number is None and not lenient:
                raise number_error(f"{place}, column '{self.headers[index]}'", cells[index], self.decimal)
            numbers.append(np.nan if number is None else number)
        return numbers

    def _ragged_error(self, place: str, cells: list[str]) -> InputError:
        if not any(cells):
            return row_error(f"{place}: the row is blank")
        count = f"{place}: the row has {len(cells)} cells and the header {len(self.headers)}"
        if self.delimiter == "," and len(self.headers) < len(cells) <= 2 * len(self.headers):
            cure = "save with another delimiter and set delimiter and decimal under [channels]"
            problem = f"{count}: if the commas are decimal commas"
            return InputError(f"{problem}, {cure}", code="decimal-commas", cure=cure)
        return row_error(count)

    def _cells(self, line: bytes, row: int) -> list[str]:
        try:
            text = line.decode("utf-8").rstrip("\r\n")
            return [cell.strip() for cell in next(csv.reader([text], delimiter=self.delimiter), [""])]
        except UnicodeDecodeError as error:
            problem = f"the byte 0x{line[error.start]:02x} is not UTF-8 text"
            raise InputError(f"{self.path}: row {row}: {problem}: save the file as UTF-8") from None
        except csv.Error:
            raise row_error(f"{self.path}: row {row}: the row cannot be divided into cells") from None
