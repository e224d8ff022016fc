"""Layout of a text file: encoding, delimiter, decimal sign, rows before the data, format of time stamps."""

import csv
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

from smajax.errors import InputError, shortened
from smajax.recordings.read_options import ReadOptions
from smajax.recordings.readers.encoding import decode_row, open_as_utf8, utf16_of
from smajax.recordings.readers.quoted_rows import are_rows_quoted, divide_row
from smajax.recordings.recognition.findings import Finding, Question
from smajax.recordings.recognition.row_findings import header_findings
from smajax.recordings.recognition.rows import RowRoles, count_values, find_rows, usual_width
from smajax.recordings.recognition.stamp_formats import find_time_format

# Rows and bytes of a row that are looked at: enough for long heads of instruments.
_ROWS_LOOKED_AT = 300
_LONGEST_ROW = 2**16
# Delimiters that are tried, with their names.
_DELIMITERS = {",": "commas", ";": "semicolons", "\t": "tabs", "|": "vertical bars", " ": "spaces"}
# Rows that a table needs to be recognised.
_MIN_ROWS = 2


@dataclass(frozen=True)
class Layout:
    """Layout of a file.

    Attributes:
        options: Options of reading with what was recognised.
        findings: What was recognised, with reasons.
        questions: What is doubtful.
        named: Whether the columns have names, in the file or by the caller.
    """

    options: ReadOptions
    findings: tuple[Finding, ...] = ()
    questions: tuple[Question, ...] = ()
    named: bool = True


def recognise_text(path: Path, options: ReadOptions, fixed: Sequence[str]) -> Layout:
    """Return the layout of a text file.

    Args:
        path: The file.
        options: Options of reading.
        fixed: Names of the options that the caller gave, which stay.

    Raises:
        InputError: If the file is not a table.
    """
    lines = _first_lines(path, options.encoding)
    encoding = _encoding_finding(path, options.encoding)
    options, separators = _recognise_separators(path, lines, options, fixed)
    rows = _divided(lines, options.delimiter)
    skipped = options.skip_rows
    roles = find_rows(rows[skipped:], options)
    data = rows[skipped + roles.data :] if roles else []
    options, questions = find_time_format(data, options, fixed)
    roles = find_rows(rows[skipped:], options)
    if roles is None:
        raise _no_table(path, lines)
    roles = _shifted(roles, skipped)
    options, findings, named = header_findings(rows, roles, options, fixed)
    return Layout(options, (*encoding, *separators, *findings), questions, named)


def _first_lines(path: Path, encoding: str | None) -> list[str]:
    with open_as_utf8(path, encoding) as file:
        lines = [file.readline(_LONGEST_ROW) for _ in range(_ROWS_LOOKED_AT)]
    try:
        return [decode_row(line, encoding).rstrip("\r\n") for line in lines if line]
    except UnicodeDecodeError:
        cure = "name the encoding by --encoding, or save the file as UTF-8"
        raise InputError(f"{path}: a row is neither UTF-8 nor cp1252: {cure}") from None


def _encoding_finding(path: Path, encoding: str | None) -> tuple[Finding, ...]:
    """Return a finding on an encoding that is not UTF-8."""
    if encoding is not None:
        return (Finding("encoding", encoding, "it was given"),)
    with path.open("rb") as file:
        head = file.read(_LONGEST_ROW)
    head = head[: head.rfind(b"\n") + 1] if len(head) == _LONGEST_ROW else head
    wide = utf16_of(head)
    if wide:
        return (Finding("encoding", wide.upper(), "every other byte is zero, or the file begins with its mark"),)
    try:
        head.decode("utf-8")
    except UnicodeDecodeError as error:
        byte = f"the byte 0x{head[error.start]:02x} is not UTF-8"
        return (
            Finding("encoding", "cp1252", f"{byte} and is '{head[error.start : error.start + 1].decode('cp1252')}'"),
        )
    return ()


def _recognise_separators(
    path: Path, lines: Sequence[str], options: ReadOptions, fixed: Sequence[str]
) -> tuple[ReadOptions, tuple[Finding, ...]]:
    """Return the options with the delimiter and the decimal sign by which most cells are values."""
    delimiters = [options.delimiter] if "delimiter" in fixed else list(_DELIMITERS)
    decimals = [options.decimal] if "decimal" in fixed else [".", ","]
    pairs = [(d, p) for d in delimiters for p in decimals if d != p]
    scores = {pair: _score(lines[options.skip_rows :], *pair, options.time_format) for pair in pairs}
    best = max(pairs, key=lambda pair: scores[pair])
    if not scores[best][0]:
        raise _no_table(path, lines)
    delimiter, decimal = best
    width, rows = scores[best][2], scores[best][3]
    name = _DELIMITERS.get(delimiter, repr(delimiter))
    findings = [Finding("columns", f"separated by {name}", f"they divide {rows} of the first rows into {width} cells")]
    if "delimiter" in fixed:
        findings = [Finding("columns", f"separated by {name}", "it was given")]
    if decimal != ".":
        findings.append(Finding("decimal sign", "comma", "with it the cells are numbers, and none has a point"))
    return options.replace(delimiter=delimiter, decimal=decimal), tuple(findings)


def _score(
    lines: Sequence[str], delimiter: str, decimal: str, time_format: str | None
) -> tuple[float, float, int, int]:
    """Return share of cells that are values, whether there are several, number of cells, and rows that have it."""
    rows = _divided(lines, delimiter)
    counts = [count_values(cells, decimal, time_format) for cells in rows]
    if not any(counts):
        return 0.0, 0.0, 0, 0
    width = usual_width(rows, counts)
    data = [(cells, n) for cells, n in zip(rows, counts, strict=True) if len(cells) == width and n]
    if len(data) < min(_MIN_ROWS, len(lines)):
        return 0.0, 0.0, 0, 0
    filled = sum(sum(1 for cell in cells if cell.strip()) for cells, _ in data)
    share = sum(n for _, n in data) / max(filled, 1)
    # A row of one cell that is a number says little; rows that are divided count more.
    return share * len(data) / max(sum(1 for n in counts if n), 1), float(width > 1), width, len(data)


def _divided(lines: Sequence[str], delimiter: str) -> list[list[str]]:
    """Return the cells of rows, as the reader divides them; none of a row that it cannot divide."""
    rows = []
    quoted = are_rows_quoted(lines, delimiter)
    for line in lines:
        try:
            rows.append(divide_row(line, delimiter, quoted))
        except csv.Error:
            rows.append([])
    return rows


def _shifted(roles: RowRoles, rows: int) -> RowRoles:
    """Return the roles counted from the first row of the file."""

    def shifted(row: int | None) -> int | None:
        return None if row is None else row + rows

    return RowRoles(roles.data + rows, roles.width, shifted(roles.header), shifted(roles.units))


def _no_table(path: Path, lines: Sequence[str]) -> InputError:
    """Return the error of a file without rows of numbers."""
    example = f" (row 1 is '{shortened(lines[0])}')" if lines else ""
    cure = "save the recording as a table, one row per sample"
    return InputError(f"{path}: no row of numbers was recognised in the first {len(lines)} rows{example}: {cure}")
