"""Variables of MATLAB files up to version 7.2, whose values scipy reads.

The list of variables is read here: scipy's reader of damaged files may crash, and it cannot list a file with objects.
"""

import mmap
import struct
import zlib
from collections.abc import Iterator
from pathlib import Path
from typing import Any, final

import numpy as np

from smajax.errors import InputError, first_line
from smajax.recordings.readers.mat_variables import Kind, MatVariable, MatVariables

# Types of the data elements of a version 5 file (MATLAB's "MAT-File Format").
_MATRIX = 14
_COMPRESSED = 15
_ELEMENTS = {1, 2, 3, 4, 5, 6, 7, 9, 12, 13, _MATRIX, _COMPRESSED, 16, 17, 18}
# Classes of arrays in the same format; 17 is that of objects such as timetables, which the format leaves undescribed.
_CLASSES = {1: "cell", 2: "struct", 3: "object", 4: "char", 5: "sparse", 6: "double", 7: "single", 8: "int8"}
_CLASSES |= {9: "uint8", 10: "int16", 11: "uint16", 12: "int32", 13: "uint32", 14: "int64", 15: "uint64"}
_CLASSES |= {16: "function", 17: "opaque"}
_OPAQUE = 17
_KINDS: dict[str, Kind] = {"char": "text", "struct": "struct", "object": "object", "opaque": "object"}
_NUMBERS = ("double", "single", "int8", "uint8", "int16", "uint16", "int32", "uint32", "int64", "uint64")
# Bit of the flags of an array with imaginary parts.
_COMPLEX = 0x0800
# Bytes of the header of such a file, which ends with its version and byte order.
_HEADER_BYTES = 128
# Bytes of a variable that are unpacked for its flags, shape and names: at most 63 characters a name.
_HEAD_BYTES = 512


@final
class Mat5Variables(MatVariables):
    """Variables of a file up to version 7.2.

    Args:
        path: The file.
    """

    def __init__(self, path: Path):
        self._path = path
        with path.open("rb") as file, mmap.mmap(file.fileno(), 0, access=mmap.ACCESS_READ) as data:
            if not is_intact(data):
                problem = "the file is not readable as MATLAB data (it is damaged)"
                raise InputError(f"{path}: {problem}: save it again with '-v7'")
            order = _byte_order(data)
            try:
                self._variables = dict(_heads(data, order)) if order is not None else self._old_variables()
            except (struct.error, zlib.error, UnicodeDecodeError, IndexError) as error:
                raise _unreadable(path, error) from None
        self._structs: dict[str, Any] = {}

    def children(self, name: str = "") -> dict[str, MatVariable]:
        """Return the variables of the file, or the fields of a struct."""
        if not name:
            return self._variables
        fields = self._value(name)
        names = fields.dtype.names or ()
        return {key: _described(fields[key].item() if fields.shape == () else fields[key]) for key in names}

    def values(self, name: str) -> np.ndarray:
        """Return the values of a variable with real numbers."""
        return np.asarray(self._value(name))

    def text(self, name: str) -> str:
        """Return the value of a variable with a text."""
        return str(self._value(name)).strip()

    def _value(self, name: str) -> np.ndarray:
        """Return a variable as scipy reads it, without dimensions of length 1."""
        first, *fields = name.split(".")
        if first not in self._structs:
            value = self._call_scipy("loadmat", variable_names=[first], squeeze_me=True)[first]
            if not fields and np.asarray(value).dtype.names is None:
                return np.asarray(value)
            self._structs[first] = np.asarray(value)
        value = self._structs[first]
        for field in fields:
            value = np.asarray(value[field].item() if value[field].shape == () else value[field])
        return value

    def _old_variables(self) -> dict[str, MatVariable]:
        """Return the variables of a file of version 4."""
        return {
            name: MatVariable("text" if kind == "char" else "numbers", shape, kind)
            for name, shape, kind in self._call_scipy("whosmat")
        }

    def _call_scipy(self, function: str, **options: Any) -> Any:
        import scipy.io

        try:
            return getattr(scipy.io, function)(str(self._path), **options)
        except Exception as error:  # a damaged file raises one of a dozen types, from struct.error to zlib.error
            raise _unreadable(self._path, error) from None


def is_intact(data: bytes | mmap.mmap) -> bool:
    """Return whether the data elements of a version 5 file have valid types and nest; scipy's reader may crash if not.

    A data element has 4 + 4 bytes for type and length, or 2 + 2 for a small one, and is padded to a multiple of 8 bytes
    (MATLAB's "MAT-File Format", level 5).

    Args:
        data: Bytes of the file; those of another version are intact.
    """
    order = _byte_order(data)
    if order is None:
        return True
    spans = [(_HEADER_BYTES, len(data))]
    while spans:
        at, end = spans.pop()
        while at < end:
            if at + 8 > end:
                return False
            kind, begin, length, following = _element(data, order, at)
            if kind not in _ELEMENTS or begin + length > end or (begin == at + 4 and length > 4):
                return False
            if kind == _MATRIX:
                spans.append((begin, begin + length))
            at = following
    return True


def _byte_order(data: bytes | mmap.mmap) -> str | None:
    """Return the byte order of a file of version 5 for ``struct``; ``None`` for another version."""
    order = {b"IM": "<", b"MI": ">"}.get(bytes(data[126:128]))
    return order if data[124:126] in (b"\0\1", b"\1\0") else None


def _element(data: bytes | mmap.mmap, order: str, at: int) -> tuple[int, int, int, int]:
    """Return type, begin and length of a data element, and where the next one begins."""
    kind, length = struct.unpack_from(order + "II", data, at)
    if kind >> 16:
        return kind & 0xFFFF, at + 4, kind >> 16, at + 8
    padding = -length % 8 if kind != _COMPRESSED else 0
    return kind, at + 8, length, at + 8 + length + padding


def _heads(data: mmap.mmap, order: str) -> Iterator[tuple[str, MatVariable]]:
    """Yield name and description of each variable of a file of version 5."""
    at = _HEADER_BYTES
    while at < len(data):
        kind, begin, length, following = _element(data, order, at)
        if kind == _COMPRESSED:
            head = zlib.decompressobj().decompress(data[begin : begin + length], _HEAD_BYTES)
            kind, begin, _, _ = _element(head, order, 0)
        else:
            head, begin = bytes(data[begin : begin + min(length, _HEAD_BYTES)]), 0
        if kind == _MATRIX and begin < len(head):
            name, variable = _head(head[begin:], order)
            if name:  # the workspace of functions and the data of objects have none
                yield name, variable
        at = following


def _head(head: bytes, order: str) -> tuple[str, MatVariable]:
    """Return name and description in the first data elements of a variable: flags, shape, name."""
    _, begin, _, at = _element(head, order, 0)
    (flags,) = struct.unpack_from(order + "I", head, begin)
    class_name = _CLASSES.get(flags & 0xFF, "unknown")
    shape: tuple[int, ...] = ()
    if flags & 0xFF != _OPAQUE:
        _, begin, length, at = _element(head, order, at)
        shape = struct.unpack_from(f"{order}{length // 4}i", head, begin)
    texts = []
    for _ in range(3 if flags & 0xFF == _OPAQUE else 1):
        _, begin, length, at = _element(head, order, at)
        texts.append(head[begin : begin + length].decode("latin-1"))
    if flags & 0xFF == _OPAQUE:
        return texts[0], MatVariable("object", (1, 1), texts[2])
    is_real = class_name in _NUMBERS and not flags & _COMPLEX
    name = "complex" if flags & _COMPLEX else class_name
    return texts[0], MatVariable("numbers" if is_real else _KINDS.get(class_name, "other"), shape, name)


def _described(value: Any) -> MatVariable:
    """Return what a field of a struct is, as scipy reads it."""
    array = np.asarray(value)
    name = "cell" if array.dtype == object else array.dtype.name
    if array.dtype.names is not None:
        is_object = type(value).__name__ in ("MatlabObject", "MatlabOpaque")
        return MatVariable("object" if is_object else "struct", array.shape, "object" if is_object else "struct")
    kind: Kind = "numbers" if array.dtype.kind in "iuf" else "text" if array.dtype.kind in "US" else "other"
    return MatVariable(kind, array.shape, name)


def _unreadable(path: Path, error: Exception) -> InputError:
    problem = f"the file is not readable as MATLAB data ({first_line(error)})"
    return InputError(f"{path}: {problem}: save it again with '-v7'")
