"""A file as a table: named columns of numbers of which nobody knows yet what they mean.

Every format gives its headers first, so that the caller can say which columns are wanted, and then the numbers of those columns. Whatever
cannot be read as a finite number is refused with its row and column, or, if the caller is ``lenient``, comes back as NaN.
"""

import abc
import hashlib
import re
from collections.abc import Sequence
from pathlib import Path

import numpy as np

from smajax.errors import InputError

MEMORY_LIMIT = 2 * 2**30
# Columns of float64 that exist at once, besides the wanted ones, while these are gathered and checked.
_WORKING_COLUMNS = 6
_PLAIN_NUMBER = re.compile(r"[+-]?(\d+\.?\d*|\.\d+)([eE][+-]?\d+)?", re.ASCII)
_COMMA_NUMBER = re.compile(r"[+-]?(\d+,\d*|,\d+)([eE][+-]?\d+)?", re.ASCII)
REPAIR = "correct it, or leave such rows out with --drop-bad-rows"


class Table(abc.ABC):
    """One file: ``headers`` (stripped texts) and ``first_row``, the number of the first row of data as the file's own program shows it."""

    path: Path
    headers: tuple[str, ...]
    first_row: int

    @abc.abstractmethod
    def load(self, wanted: Sequence[int], lenient: bool) -> list[np.ndarray]:
        """The columns with the indices ``wanted`` as float64 arrays (rows,), all finite, or NaN for a bad cell if ``lenient``."""

    @abc.abstractmethod
    def sha256(self) -> str:
        """SHA-256 of the file's bytes, in hexadecimal; to be asked after ``load``."""


def file_sha256(path: Path) -> str:
    with path.open("rb") as file:
        return hashlib.file_digest(file, "sha256").hexdigest()


def refuse_if_too_large(path: Path, rows: float, columns: int) -> None:
    """Refuse, before or while reading, what would not fit into the limit of memory."""
    need = rows * 8 * (columns + _WORKING_COLUMNS)
    if need > MEMORY_LIMIT:
        raise InputError(
            f"{path}: {rows:.3g} rows of {columns} columns need {need / 2**30:.1f} GiB to read, above the limit of "
            f"{MEMORY_LIMIT / 2**30:.3g} GiB: cut the recording into parts, or record fewer rows"
        )


def number_in(text: str, decimal: str) -> float | None:
    """The finite number that ``text`` is, or None. Only digits, sign, decimal sign and exponent count: no ``nan``, no ``1_000``."""
    if decimal == ",":
        text = text.replace(".", "?").replace(",", ".")
    if not _PLAIN_NUMBER.fullmatch(text):
        return None
    number = float(text)
    return number if np.isfinite(number) else None


def why_not_a_number(text: str, decimal: str) -> str:
    """What is wrong with a cell that ``number_in`` refuses, and the cure, to be put behind the cell's place."""
    shown = text if len(text) <= 30 else text[:27] + "..."
    if not text:
        return f"the cell is blank: {REPAIR}"
    if text.lower().strip("+-") in ("nan", "inf", "infinity", "na", "n/a", "#n/a", "null", "none"):
        return f"'{shown}' is not a finite number: {REPAIR}"
    if decimal == "." and _COMMA_NUMBER.fullmatch(text):
        return f"'{shown}' has a decimal comma: set decimal = \",\" under [channels] in the rig"
    if decimal == "," and _PLAIN_NUMBER.fullmatch(text):
        return f"'{shown}' has a decimal point although decimal is \",\": write every number in the same way"
    if _PLAIN_NUMBER.fullmatch(text.replace(",", ".")):
        return f"'{shown}' is too large for a number: {REPAIR}"
    return f"'{shown}' is not a number: {REPAIR}"
