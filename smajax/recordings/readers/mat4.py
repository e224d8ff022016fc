"""Variables of MATLAB files of version 4: full matrices of numbers and texts (MATLAB's "MAT-File Format", level 4)."""

import struct
from pathlib import Path
from typing import final

import numpy as np

from smajax.errors import InputError
from smajax.recordings.readers.mat_variables import DAMAGED, Kind, MatVariable, MatVariables

# Types of numbers and classes of matrices by their digits in the type of a matrix, MOPT.
_TYPES = ("f8", "f4", "i4", "i2", "u2", "u1")
_CLASSES: tuple[tuple[Kind, str], ...] = (("numbers", "double"), ("text", "char"), ("other", "sparse"))
# Byte orders by the thousands of MOPT.
_ORDERS = ("<", ">")
# Five whole numbers: type, rows, columns, whether there are imaginary parts, and the length of the name.
_HEADER = "5i"
_HEADER_BYTES = 20
_LARGEST_TYPE = 1000 * len(_ORDERS)


@final
class Mat4Variables(MatVariables):
    """Variables of a file of version 4.

    Args:
        path: The file.

    Raises:
        InputError: If it is damaged, or no file of MATLAB.
    """

    def __init__(self, path: Path):
        self._path = path
        self._variables: dict[str, MatVariable] = {}
        self._places: dict[str, tuple[int, np.dtype]] = {}
        size, at = path.stat().st_size, 0
        with path.open("rb") as file:
            while at < size:
                file.seek(at)
                header = file.read(_HEADER_BYTES)
                order, dtype, (kind, class_name) = self._type(header)
                _, rows, columns, is_complex, name_length = struct.unpack(order + _HEADER, header)
                begin = at + _HEADER_BYTES + name_length
                at = begin + rows * columns * dtype.itemsize * (2 if is_complex else 1)
                if min(rows, columns) < 0 or name_length < 1 or is_complex not in (0, 1) or at > size:
                    raise self._damaged()
                name = file.read(name_length).partition(b"\0")[0].decode("latin-1")
                shape = (rows, columns)
                is_real = not (is_complex and kind == "numbers")
                self._variables[name] = MatVariable(kind, shape, class_name) if is_real else _complex(shape)
                self._places[name] = begin, dtype

    def children(self, name: str = "") -> dict[str, MatVariable]:
        """Return the variables of the file; there are no structs."""
        return {} if name else self._variables

    def values(self, name: str) -> np.ndarray:
        """Return the values of a variable with real numbers."""
        (begin, dtype), shape = self._places[name], self._variables[name].shape
        values = np.fromfile(self._path, dtype, shape[0] * shape[1], offset=begin)
        if values.size != shape[0] * shape[1]:
            raise self._damaged()
        return values.reshape(shape, order="F")

    def text(self, name: str) -> str:
        """Return the value of a variable with a text, which is stored as numbers of characters."""
        return "".join(chr(int(number)) for number in np.clip(self.values(name).ravel(), 0, 255)).strip()

    def _type(self, header: bytes) -> tuple[str, np.dtype, tuple[Kind, str]]:
        """Return byte order, type of the numbers and class of the matrix with a header."""
        if len(header) == _HEADER_BYTES:
            for order in _ORDERS:
                (number,) = struct.unpack_from(order + "i", header)
                thousands, hundreds, tens, units = (number // 10**k % 10 for k in (3, 2, 1, 0))
                fits = 0 <= number < _LARGEST_TYPE and _ORDERS[thousands] == order and not hundreds
                if fits and tens < len(_TYPES) and units < len(_CLASSES):
                    return order, np.dtype(order + _TYPES[tens]), _CLASSES[units]
        raise self._damaged()

    def _damaged(self) -> InputError:
        problem = f"the file is not readable as MATLAB data ({DAMAGED})"
        return InputError(f"{self._path}: {problem}: save it again with '-v7'")


def _complex(shape: tuple[int, ...]) -> MatVariable:
    return MatVariable("other", shape, "complex")
