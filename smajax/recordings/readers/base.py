"""A file as a table: named columns of numbers whose meaning is not known yet.

Every format gives its headers first, so that the caller can choose columns, and then the numbers of these columns. What
cannot be read as a finite number is refused with its row and column, or, if the caller is ``lenient``, becomes NaN.
"""

import abc
import hashlib
import re
from collections.abc import Sequence
from pathlib import Path

import numpy as np

from smajax.errors import InputError

# Bytes that reading a file may take; tests/unit/recordings/test_recording.py reads ten million rows within it.
MEMORY_LIMIT = 2 * 2**30
# Columns of float64 that exist at once, in addition to those that are read, while these are gathered and checked.
_WORKING_COLUMNS = 6
_PLAIN_NUMBER = re.compile(r"[+-]?(\d+\.?\d*|\.\d+)([eE][+-]?\d+)?", re.ASCII)
_COMMA_NUMBER = re.compile(r"[+-]?(\d+,\d*|,\d+)([eE][+-]?\d+)?", re.ASCII)
# Texts of cells by which programs mark what is missing or not finite.
_NOT_FINITE = ("nan", "inf", "infinity", "na", "n/a", "#n/a", "null", "none")
# Characters of a cell that a message shows.
_SHOWN_CHARACTERS = 30
# Characters of another package's message that a sentence shows.
_MESSAGE_CHARACTERS = 120
REPAIR_HINT = "correct it, or leave such rows out with --drop-bad-rows"


class Table(abc.ABC):
    """A file as a table.

    Attributes:
        path: The file.
        headers: Stripped texts, one a column.
        first_row: Number of the first row of data as the file's own program shows it.
    """

    path: Path
    headers: tuple[str, ...]
    first_row: int

    @abc.abstractmethod
    def load(self, indices: Sequence[int], lenient: bool) -> list[np.ndarray]:
        """Return columns as float64 arrays (rows,).

        Args:
            indices: Numbers of the columns, from 0.
            lenient: Whether a bad cell becomes NaN instead of an error.
        """

    @abc.abstractmethod
    def sha256(self) -> str:
        """Return the SHA-256 of the file's bytes in hexadecimal; call it after ``load``."""


def file_sha256(path: Path) -> str:
    """Return the SHA-256 of a file's bytes in hexadecimal."""
    with path.open("rb") as file:
        return hashlib.file_digest(file, "sha256").hexdigest()


def refuse_if_too_large(path: Path, rows: float, columns: int) -> None:
    """Refuse, before or while reading, what would not fit into the memory limit."""
    need = rows * 8 * (columns + _WORKING_COLUMNS)
    if need > MEMORY_LIMIT:
        size = f"{rows:.3g} rows of {columns} columns need {need / 2**30:.1f} GiB to read"
        limit = f"above the limit of {MEMORY_LIMIT / 2**30:.3g} GiB"
        raise InputError(f"{path}: {size}, {limit}: cut the recording into parts, or record fewer rows")


def parse_number(text: str, decimal: str) -> float | None:
    """Return the finite number of a cell, made of digits, sign, decimal sign and exponent, or ``None``."""
    if decimal == ",":
        text = text.replace(".", "?").replace(",", ".")
    if not _PLAIN_NUMBER.fullmatch(text):
        return None
    number = float(text)
    return number if np.isfinite(number) else None


def number_error(text: str, decimal: str) -> str:
    """Return what is wrong with a cell that ``parse_number`` refuses, and the cure, to follow the cell's place."""
    shown = text if len(text) <= _SHOWN_CHARACTERS else text[: _SHOWN_CHARACTERS - 3] + "..."
    if not text:
        return f"the cell is blank: {REPAIR_HINT}"
    if text.lower().strip("+-") in _NOT_FINITE:
        return f"'{shown}' is not a finite number: {REPAIR_HINT}"
    if decimal == "." and _COMMA_NUMBER.fullmatch(text):
        return f"'{shown}' has a decimal comma: set decimal = \",\" under [channels] in the rig"
    if decimal == "," and _PLAIN_NUMBER.fullmatch(text):
        return f"'{shown}' has a decimal point although decimal is \",\": write every number in the same way"
    if _PLAIN_NUMBER.fullmatch(text.replace(",", ".")):
        return f"'{shown}' is too large for a number: {REPAIR_HINT}"
    return f"'{shown}' is not a number: {REPAIR_HINT}"


def first_line(error: Exception) -> str:
    """Return the beginning of another package's error message, for a sentence."""
    return (str(error).splitlines() or [type(error).__name__])[0][:_MESSAGE_CHARACTERS]
