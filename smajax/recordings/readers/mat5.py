"""Variables of MATLAB files of versions 5 to 7.2, from their data elements (MATLAB's "MAT-File Format", level 5).

The file is read here and not by scipy, whose reader ends the process where a damaged file has a wrong type in a data
element. Nothing is read outside of the bytes of an element, and nothing is inflated beyond the length that it states;
tests/unit/recordings/test_matlab.py compares the values with scipy's.
"""

import contextlib
import dataclasses
import mmap
import struct
import zlib
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import TypeAlias, final

import numpy as np

from smajax.errors import InputError, first_line
from smajax.recordings.readers.base import MEMORY_LIMIT
from smajax.recordings.readers.mat_variables import DAMAGED, Kind, MatVariable, MatVariables

# Types of data elements: those of numbers as types of NumPy, and those of texts as encodings.
_NUMBER_TYPES = {1: "i1", 2: "u1", 3: "i2", 4: "u2", 5: "i4", 6: "u4", 7: "f4", 9: "f8", 12: "i8", 13: "u8"}
_ENCODINGS = {1: "latin-1", 2: "latin-1", 4: "utf-16", 16: "utf-8", 17: "utf-16", 18: "utf-32"}
_INT8, _UINT8, _INT32, _UINT32, _UTF8 = 1, 2, 5, 6, 16
_MATRIX = 14
_COMPRESSED = 15
_NAME_TYPES = (_INT8, _UINT8, _UTF8)
# Classes of arrays; 17 is that of objects such as timetables, which the format leaves undescribed.
_CLASSES = {1: "cell", 2: "struct", 3: "object", 4: "char", 5: "sparse", 6: "double", 7: "single", 8: "int8"}
_CLASSES |= {9: "uint8", 10: "int16", 11: "uint16", 12: "int32", 13: "uint32", 14: "int64", 15: "uint64"}
_CLASSES |= {16: "function", 17: "opaque"}
_KINDS: dict[str, Kind] = {"char": "text", "struct": "struct", "object": "object", "opaque": "object"}
_NUMBERS = ("double", "single", "int8", "uint8", "int16", "uint16", "int32", "uint32", "int64", "uint64")
# Bit of the flags of an array with imaginary parts.
_COMPLEX = 0x0800
# Bytes of the header of such a file, which ends with its version and byte order.
_HEADER_BYTES = 128
# Bytes of a variable that are inflated for its flags, shape and name: at most 63 characters a name.
_HEAD_BYTES = 512
# Bytes of the padding that may follow a compressed element.
_PADDING = 8
# Largest ratio to which deflate can compress (zlib's "Technical Details").
_MAX_RATIO = 1032
# Bytes in memory per byte of a variable that is inflated: the bytes and the values.
_COPIES = 2
# Structs in structs, far above what recordings have.
_MAX_DEPTH = 32

Bytes: TypeAlias = bytes | mmap.mmap


@final
class Mat5Variables(MatVariables):
    """Variables of a file of versions 5 to 7.2.

    Args:
        path: The file.

    Raises:
        InputError: If it is damaged.
    """

    def __init__(self, path: Path):
        self._path = path
        self._variables: dict[str, MatVariable] = {}
        self._spans: dict[str, _Element] = {}
        self._structs: dict[str, tuple[bytes, _Array]] = {}
        with self._bytes() as data:
            self._order: str = _byte_order(data) or "<"
            at = _HEADER_BYTES
            while at < len(data):
                element = _element(data, self._order, at, len(data))
                name, variable = self._head(data, element)
                if "." in name:
                    raise ValueError("the name of a variable has a dot")
                if name:  # the workspace of functions and the data of objects have none
                    self._variables[name], self._spans[name] = variable, element
                at = element.following

    def children(self, name: str = "") -> dict[str, MatVariable]:
        """Return the variables of the file, or the fields of a struct."""
        if not name:
            return self._variables
        _, array = self._array(name)
        return {key: field.variable for key, field in array.fields.items()}

    def values(self, name: str) -> np.ndarray:
        """Return the values of a variable with real numbers."""
        data, array = self._array(name)
        with self._refusing():
            shape, numbers = array.variable.shape, array.numbers
            dtype = np.dtype(self._order + _NUMBER_TYPES[numbers.kind])
            count = numbers.length // dtype.itemsize
            flat = np.frombuffer(data, dtype, count, numbers.begin) if count else np.empty(0)
            return flat.reshape(shape, order="F")

    def text(self, name: str) -> str:
        """Return the value of a variable with a text."""
        data, array = self._array(name)
        with self._refusing():
            numbers = array.numbers
            encoding = _ENCODINGS[numbers.kind]
            if encoding not in ("latin-1", "utf-8"):
                encoding += "-le" if self._order == "<" else "-be"
            return data[numbers.begin : numbers.begin + numbers.length].decode(encoding).strip()

    def _head(self, data: Bytes, element: "_Element") -> tuple[str, MatVariable]:
        """Return name and description of a variable; all of one that is not compressed is checked."""
        if element.kind == _MATRIX:
            array = _read_array(data, self._order, element)
            return array.name, array.variable
        if element.kind != _COMPRESSED:
            raise ValueError(f"it has a data element of type {element.kind}")
        head = zlib.decompressobj().decompress(data[element.begin : element.end], _HEAD_BYTES)
        inner = _element(head, self._order, 0)
        if inner.kind != _MATRIX:
            raise ValueError(f"it has a compressed data element of type {inner.kind}")
        name, variable, _, _ = _read_head(head, self._order, inner)
        return name, variable

    def _array(self, name: str) -> tuple[bytes, "_Array"]:
        """Return the bytes of the variable that has a name like ``run.current``, and where its parts are in them."""
        first, *fields = name.split(".")
        if first in self._structs:
            content, array = self._structs[first]
        else:
            with self._bytes() as data:
                content = self._content(data, self._spans[first])
                array = _read_array(content, self._order, _element(content, self._order, 0, len(content)))
                if array.variable != self._variables[first]:
                    raise ValueError("it changes while it is read")
            if array.variable.kind == "struct":
                self._structs[first] = content, array
        for field in fields:
            array = array.fields[field]
        return content, array

    def _content(self, data: Bytes, element: "_Element") -> bytes:
        """Return the data element of a variable, which is inflated if it is compressed."""
        if element.kind != _COMPRESSED:
            return data[element.start : element.following]
        packed = data[element.begin : element.end]
        inflater = zlib.decompressobj()
        head = inflater.decompress(packed, _PADDING)
        length = _PADDING + _element(head, self._order, 0).length
        if length * _COPIES > MEMORY_LIMIT:
            size, limit = length * _COPIES / 2**30, MEMORY_LIMIT / 2**30
            problem = f"a variable needs {size:.1f} GiB to read, above the limit of {limit:.3g} GiB"
            raise InputError(f"{self._path}: {problem}: save vectors instead of a struct, or fewer samples")
        if length > _MAX_RATIO * len(packed) + _PADDING:
            raise ValueError("a compressed variable is shorter than it states")
        content = head + inflater.decompress(inflater.unconsumed_tail, length)
        if len(content) < length or not inflater.eof:
            raise ValueError("a compressed variable has another length than it states")
        return content

    @contextlib.contextmanager
    def _bytes(self) -> Iterator[mmap.mmap]:
        """Open the file."""
        with (
            self._refusing(),
            self._path.open("rb") as file,
            mmap.mmap(file.fileno(), 0, access=mmap.ACCESS_READ) as data,
        ):
            yield data

    @contextlib.contextmanager
    def _refusing(self) -> Iterator[None]:
        """Refuse a damaged file."""
        try:
            yield
        except InputError:
            raise
        except (struct.error, zlib.error, ValueError, LookupError) as error:
            is_said = type(error) in (ValueError, zlib.error)
            problem = f"the file is not readable as MATLAB data ({first_line(error) if is_said else DAMAGED})"
            raise InputError(f"{self._path}: {problem}: save it again with '-v7'") from None


@dataclasses.dataclass(frozen=True)
class _Element:
    """A data element.

    Attributes:
        kind: Its type.
        start: Where its tag begins.
        begin: Where its data begin.
        length: Bytes of its data.
        following: Where the next element begins.
    """

    kind: int
    start: int
    begin: int
    length: int
    following: int

    @property
    def end(self) -> int:
        """Where its data end."""
        return self.begin + self.length


_NOTHING = _Element(9, 0, 0, 0, 0)


@dataclasses.dataclass(frozen=True)
class _Array:
    """An array of a file.

    Attributes:
        name: Its name; empty for a field.
        variable: What it is.
        numbers: Element of its real numbers or its text.
        fields: Fields of a struct; those of an array of structs are cells.
    """

    name: str
    variable: MatVariable
    numbers: _Element = _NOTHING
    fields: Mapping[str, "_Array"] = dataclasses.field(default_factory=dict)


def is_version_5(path: Path) -> bool:
    """Return whether a file is one of MATLAB of versions 5 to 7.2.

    Args:
        path: The file.
    """
    with path.open("rb") as file:
        return _byte_order(file.read(_HEADER_BYTES)) is not None


def _byte_order(data: Bytes) -> str | None:
    """Return the byte order of a file of versions 5 to 7.2 for ``struct``; ``None`` for another file."""
    order = {b"IM": "<", b"MI": ">"}.get(bytes(data[126:128]))
    return order if data[124:126] == {"<": b"\0\1", ">": b"\1\0"}.get(order or "") else None


def _element(data: Bytes, order: str, at: int, end: int | None = None) -> _Element:
    """Return the data element at a place; one that does not end before ``end`` is damaged."""
    kind, length = struct.unpack_from(order + "II", data, at)
    if kind >> 16:  # a small element, with its data in the tag
        element = _Element(kind & 0xFFFF, at, at + 4, kind >> 16, at + 8)
    else:
        padding = -length % 8 if kind != _COMPRESSED else 0
        element = _Element(kind, at, at + 8, length, at + 8 + length + padding)
    if end is not None and (element.end > min(end, element.following) or element.following > end + _PADDING):
        raise ValueError(DAMAGED)
    return element


def _expect(element: _Element, kinds: tuple[int, ...], length: int | None = None) -> _Element:
    """Return a data element that has one of some types, and a length."""
    if element.kind not in kinds or (length is not None and element.length != length):
        raise ValueError(DAMAGED)
    return element


def _read_head(data: Bytes, order: str, array: _Element) -> tuple[str, MatVariable, int, int]:
    """Return name and description of an array, its flags, and where its content begins."""
    end = min(array.end, len(data))
    flags_element = _expect(_element(data, order, array.begin, end), (_UINT32,), 8)
    (flags,) = struct.unpack_from(order + "I", data, flags_element.begin)
    class_name = _CLASSES.get(flags & 0xFF, "unknown")
    at = flags_element.following
    shape: tuple[int, ...] = (1, 1)
    if class_name != "opaque":
        dimensions = _expect(_element(data, order, at, end), (_INT32, _UINT32))
        shape = struct.unpack_from(f"{order}{dimensions.length // 4}i", data, dimensions.begin)
        if len(shape) < 2 or min(shape) < 0 or dimensions.length % 4:
            raise ValueError("an array has no shape")
        at = dimensions.following
    texts = []
    for _ in range(3 if class_name == "opaque" else 1):
        element = _expect(_element(data, order, at, end), _NAME_TYPES)
        texts.append(bytes(data[element.begin : element.end]).decode(_ENCODINGS[element.kind], "replace"))
        at = element.following
    if class_name == "opaque":
        return texts[0], MatVariable("object", shape, texts[2]), flags, at
    is_real = class_name in _NUMBERS and not flags & _COMPLEX
    name = "complex" if flags & _COMPLEX else class_name
    variable = MatVariable("numbers" if is_real else _KINDS.get(class_name, "other"), shape, name)
    return texts[0], variable, flags, at


def _read_array(data: Bytes, order: str, array: _Element, depth: int = 0) -> _Array:
    """Return an array, whose data elements are checked if their values may be read."""
    _expect(array, (_MATRIX,))
    if depth > _MAX_DEPTH:
        raise ValueError(f"structs are nested more than {_MAX_DEPTH} times")
    if not array.length:  # a field without a value
        return _Array("", MatVariable("numbers", (0, 0), "double"))
    name, variable, _, at = _read_head(data, order, array)
    if variable.kind == "numbers" and at == array.end and not variable.size:
        return _Array(name, variable)
    if variable.kind == "numbers":
        numbers = _expect(_element(data, order, at, array.end), tuple(_NUMBER_TYPES))
        if numbers.length != variable.size * int(_NUMBER_TYPES[numbers.kind][1]):
            raise ValueError(f"an array has another number of values than its shape {variable.shape}")
        return _Array(name, variable, numbers)
    if variable.kind == "text":
        return _Array(name, variable, _expect(_element(data, order, at, array.end), tuple(_ENCODINGS)))
    if variable.kind == "struct":
        return _Array(name, variable, fields=_read_fields(data, order, array.end, at, variable, depth))
    return _Array(name, variable)


def _read_fields(data: Bytes, order: str, end: int, at: int, variable: MatVariable, depth: int) -> dict[str, _Array]:
    """Return the fields of a struct."""
    length = _expect(_element(data, order, at, end), (_INT32, _UINT32), 4)
    (characters,) = struct.unpack_from(order + "i", data, length.begin)
    texts = _expect(_element(data, order, length.following, end), _NAME_TYPES)
    if characters <= 0 or texts.length % characters:
        raise ValueError("the names of a struct's fields are damaged")
    names = [
        bytes(data[at : at + characters]).partition(b"\0")[0].decode("latin-1")
        for at in range(texts.begin, texts.end, characters)
    ]
    if any("." in name for name in names):
        raise ValueError("the name of a field has a dot")
    fields: dict[str, _Array] = {}
    at = texts.following
    for _ in range(variable.size if names else 0):
        for name in names:
            element = _element(data, order, at, end)
            fields[name] = _read_array(data, order, element, depth + 1)
            at = element.following
    if variable.size == 1:
        return fields
    return dict.fromkeys(names, _Array("", MatVariable("other", variable.shape, "cell")))
