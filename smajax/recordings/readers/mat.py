"""Reader of MATLAB .mat files (up to version 7.2) with one vector per channel, named like the channel.

The units are those in the rig file, or in a struct ``units`` of the file with one text per channel:
``units.current = 'A'``.
"""

import mmap
import struct
from collections.abc import Sequence
from pathlib import Path
from typing import Any, final

import numpy as np

from smajax.errors import InputError, first_line
from smajax.recordings.readers.base import Table, file_sha256, refuse_if_too_large, row_error

# Types of the data elements of a version 5 file (MATLAB's "MAT-File Format").
_MATRIX = 14
_COMPRESSED = 15
_ELEMENTS = {1, 2, 3, 4, 5, 6, 7, 9, 12, 13, _MATRIX, _COMPRESSED, 16, 17, 18}
# Bytes of the header of such a file, which ends with its version and byte order.
_HEADER_BYTES = 128


@final
class MatTable(Table):
    """Vectors of a MATLAB file; the first sample is row 1."""

    first_row = 1

    def __init__(self, path: Path):
        self.path = path
        with path.open("rb") as file, mmap.mmap(file.fileno(), 0, access=mmap.ACCESS_READ) as data:
            intact = _is_intact(data)
        if not intact:
            raise InputError(
                f"{path}: the file is not readable as MATLAB data (it is damaged): save it again with '-v7'"
            )
        shapes = self._call_scipy("whosmat")
        self._names = [name for name, _, _ in shapes if name != "units" and not name.startswith("__")]
        self._rows = {name: int(np.prod(shape, dtype=float)) for name, shape, _ in shapes}
        if not self._names:
            raise InputError(
                f"{path}: the file has no variables: save one vector per channel, such as time and current"
            )
        units = self._units() if any(name == "units" for name, _, _ in shapes) else {}
        self.headers: tuple[str, ...] = tuple(
            f"{name} [{units[name]}]" if name in units else name for name in self._names
        )

    def load(self, indices: Sequence[int], lenient: bool) -> list[np.ndarray]:
        """Return variables as columns."""
        names = [self._names[index] for index in indices]
        refuse_if_too_large(self.path, max((self._rows[name] for name in names), default=0), len(names))
        variables = self._call_scipy("loadmat", variable_names=names, squeeze_me=True)
        columns = [self._column(name, np.asarray(variables[name]), lenient) for name in names]
        for name, column in zip(names, columns, strict=True):
            if len(column) != len(columns[0]):
                raise InputError(
                    f"{self.path}: variable '{name}' has {len(column)} values and '{names[0]}' {len(columns[0])}: "
                    "give every channel one value per sample"
                )
        return columns

    def sha256(self) -> str:
        """Return the SHA-256 of the file in hexadecimal."""
        return file_sha256(self.path)

    def _call_scipy(self, function: str, **options: Any) -> Any:
        import scipy.io

        try:
            return getattr(scipy.io, function)(str(self.path), **options)
        except NotImplementedError:
            raise InputError(f"{self.path}: the file is of MATLAB version 7.3: save it with save(..., '-v7')") from None
        except Exception as error:  # a damaged file raises one of a dozen types, from struct.error to zlib.error
            problem = f"the file is not readable as MATLAB data ({first_line(error)})"
            raise InputError(f"{self.path}: {problem}: save it again with '-v7'") from None

    def _units(self) -> dict[str, str]:
        texts = np.asarray(self._call_scipy("loadmat", variable_names=["units"], squeeze_me=True)["units"])
        names = texts.dtype.names
        if names is None or texts.shape != ():
            problem = "variable 'units' is not a struct with one text per channel"
            raise InputError(f"{self.path}: {problem}: set units.time = 's' and so on")
        return {name: str(texts[name]).strip() for name in names}

    def _column(self, name: str, values: np.ndarray, lenient: bool) -> np.ndarray:
        place = f"{self.path}: variable '{name}'"
        if values.dtype.kind not in "iuf":
            problem = f"the values are not real numbers (type {values.dtype.name})"
            raise InputError(f"{place}: {problem}: save a vector of doubles")
        if values.ndim > 1:
            problem = f"the array of shape {values.shape} is not a vector"
            raise InputError(f"{place}: {problem}: save one vector per channel")
        numbers = np.array(values, float, ndmin=1)
        if not numbers.size:
            raise InputError(f"{place}: the vector is empty: record at least two samples")
        bad = np.flatnonzero(~np.isfinite(numbers))
        if bad.size and not lenient:
            raise row_error(f"{self.path}: row {bad[0] + 1}, column '{name}': the value is not finite")
        numbers[bad] = np.nan
        return numbers


def _is_intact(data: bytes | mmap.mmap) -> bool:
    """Return whether the data elements of a version 5 file have valid types and nest; scipy's reader may crash if not.

    A data element has 4 + 4 bytes for type and length, or 2 + 2 for a small one, and is padded to a multiple of 8 bytes
    (MATLAB's "MAT-File Format", level 5).
    """
    order = {b"IM": "<", b"MI": ">"}.get(data[126:128])
    if order is None or data[124:126] not in (b"\0\1", b"\1\0"):
        return True  # another version: scipy refuses it, or reads it in another way
    spans = [(_HEADER_BYTES, len(data))]
    while spans:
        at, end = spans.pop()
        while at < end:
            if at + 8 > end:
                return False
            kind, length = struct.unpack_from(order + "II", data, at)
            if kind >> 16:
                kind, length, begin = kind & 0xFFFF, kind >> 16, at + 4
                following = at + 8
            else:
                begin = at + 8
                following = begin + length + (-length % 8 if kind != _COMPRESSED else 0)
            if kind not in _ELEMENTS or begin + length > end or (begin == at + 4 and length > 4):
                return False
            if kind == _MATRIX:
                spans.append((begin, begin + length))
            at = following
    return True
