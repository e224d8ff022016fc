"""Tables: files and objects as named columns of numbers that are not yet assigned to channels.

A table first reads its headers, so that the caller can choose columns, and then the numbers of these columns. A cell
that is not a finite number is an error with its row and column, or NaN if the caller is ``lenient``.
"""

import abc
import hashlib
import re
from collections.abc import Mapping, Sequence
from pathlib import Path
from types import MappingProxyType
from typing import Any

import numpy as np

from smajax.errors import InputError, shortened
from smajax.recordings.readers.time_stamps import StampColumn, is_like_stamp

# Bytes that reading a file may take; tests/unit/recordings/test_recording.py reads ten million rows within it.
MEMORY_LIMIT = 2 * 2**30
# Columns of float64 that are in memory in addition to those that are read, while these are joined and checked.
_WORKING_COLUMNS = 6
# Possessive quantifiers (++): a cell of a hundred thousand digits is refused as fast as it is read.
_PLAIN_NUMBER = re.compile(r"[+-]?(\d++\.?\d*+|\.\d++)([eE][+-]?\d++)?", re.ASCII)
_COMMA_NUMBER = re.compile(r"[+-]?(\d++,\d*+|,\d++)([eE][+-]?\d++)?", re.ASCII)
# Texts of cells by which programs mark missing values and values that are not finite.
_NOT_FINITE = ("nan", "inf", "infinity", "na", "n/a", "#n/a", "null", "none")


def repair_hint(drop_option: str) -> str:
    """Return the cure for a bad row.

    Args:
        drop_option: The option that leaves such rows out.
    """
    return f"correct it, or leave such rows out with {drop_option}"


REPAIR_HINT = repair_hint("--drop-bad-rows")


class Table(abc.ABC):
    """A file, or an object in memory, as a table.

    Attributes:
        headers: Header of each column, without white space at its ends.
        first_row: Number of the first row of data, counted as in the program that the format belongs to.
        drop_option: The option that leaves bad rows out, for messages.
        notes: Sentences on what was recognised or left out.
        stamps: Readers of the columns of time stamps that were recognised, by the number of the column; the caller
            removes those that are not the time.
        label: Name of the sheet where there are several tables in a file, else empty.
        label_kind: What the label names.
        implied_time: Number of a column of times that is not one of the file, such as those of message stamps; it is
            left out where another column is the time.
        leaves_out_unknown: Whether columns that are no channels are left out, and named in the notes, in place of an
            error; for files of a whole machine, such as a ROS bag.
        first_cells: Cells of the first rows of data of a text file or sheet, in which dates are looked for.
    """

    drop_option = "--drop-bad-rows"
    headers: tuple[str, ...]
    first_row: int
    notes: tuple[str, ...] = ()
    stamps: Mapping[int, StampColumn] = MappingProxyType({})
    label: str = ""
    label_kind: str = "sheet"
    implied_time: int | None = None
    leaves_out_unknown = False
    first_cells: Sequence[Sequence[Any]] = ()

    @abc.abstractmethod
    def load(self, indices: Sequence[int], lenient: bool) -> list[np.ndarray]:
        """Return columns as float64 arrays (rows,).

        Args:
            indices: Numbers of the columns, from 0.
            lenient: Whether a bad cell is NaN instead of an error.

        Raises:
            InputError: If a cell is bad, or the columns do not fit into the memory limit.
        """

    def unwrap_stamps(self, indices: Sequence[int], columns: list[np.ndarray]) -> list[np.ndarray]:
        """Return columns in which times of day continue after midnight.

        Args:
            indices: Numbers of the columns.
            columns: Their values, shape ``(rows,)``.
        """
        stamps = [self.stamps.get(index) for index in indices]
        return [c if s is None else s.unwrapped(c) for s, c in zip(stamps, columns, strict=True)]

    @abc.abstractmethod
    def sha256(self) -> str:
        """Return the SHA-256 of the file in hexadecimal; valid after ``load``."""


def file_sha256(path: Path) -> str:
    """Return the SHA-256 of a file in hexadecimal."""
    with path.open("rb") as file:
        return hashlib.file_digest(file, "sha256").hexdigest()


def refuse_if_too_large(path: Path | str, rows: float, columns: int) -> None:
    """Check that a table fits into the memory limit, before or while it is read.

    Args:
        path: The file, or the name of the object, for the message.
        rows: Number of rows, or an estimate.
        columns: Number of columns that are read.

    Raises:
        InputError: If it does not fit.
    """
    need = rows * 8 * (columns + _WORKING_COLUMNS)
    if need > MEMORY_LIMIT:
        size = f"{rows:.3g} rows of {columns} columns need {need / 2**30:.1f} GiB to read"
        limit = f"above the limit of {MEMORY_LIMIT / 2**30:.3g} GiB"
        raise InputError(f"{path}: {size}, {limit}: cut the recording into parts, or record fewer rows")


def parse_number(text: str, decimal: str) -> float | None:
    """Return the finite number in a cell, or ``None``.

    Args:
        text: Text of the cell: digits with an optional sign, decimal sign and exponent.
        decimal: Decimal sign, ``.`` or ``,``.
    """
    if decimal == ",":
        text = text.replace(".", "?").replace(",", ".")
    if not _PLAIN_NUMBER.fullmatch(text):
        return None
    number = float(text)
    return number if np.isfinite(number) else None


def row_error(problem: str) -> InputError:
    """Return the error of a row that can be left out.

    Args:
        problem: The sentence without the cure.
    """
    return InputError(f"{problem}: {REPAIR_HINT}", code="bad-row", cure=REPAIR_HINT)


def number_error(place: str, text: str, decimal: str, *, first: bool = False) -> InputError:
    """Return the error of a cell that ``parse_number`` refuses.

    Args:
        place: The cell's place, with which the sentence begins.
        text: Text of the cell.
        decimal: Decimal sign, ``.`` or ``,``.
        first: Whether the cell is in the first row of data, which may be one of units.
    """
    shown = shortened(text)
    if not text:
        return row_error(f"{place}: the cell is blank")
    if text.lower().strip("+-") in _NOT_FINITE:
        return row_error(f"{place}: '{shown}' is not a finite number")
    if decimal == "." and _COMMA_NUMBER.fullmatch(text):
        cure = 'set decimal = "," under [recording] in the rig'
        return InputError(f"{place}: '{shown}' has a decimal comma: {cure}", code="decimal", cure=cure)
    if decimal == "," and _PLAIN_NUMBER.fullmatch(text):
        problem = f"'{shown}' has a decimal point although decimal is \",\""
        return InputError(f"{place}: {problem}: write every number in the same way", code="mixed-decimals")
    if _PLAIN_NUMBER.fullmatch(text.replace(",", ".")):
        return row_error(f"{place}: '{shown}' is too large for a number")
    if is_like_stamp(text):
        cure = 'give its format, as in time_format = "%d.%m.%Y %H:%M:%S" under [recording] in the rig, or correct it'
        return InputError(f"{place}: '{shown}' is a time stamp of another format: {cure}", code="stamp", cure=cure)
    if first:
        cure = f"set units_row = true under [recording] in the rig if the row has units, else {REPAIR_HINT}"
        return InputError(f"{place}: '{shown}' is not a number: {cure}", code="bad-first-row", cure=cure)
    return row_error(f"{place}: '{shown}' is not a number")
