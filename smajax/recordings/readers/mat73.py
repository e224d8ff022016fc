"""Variables of MATLAB files of version 7.3, which are HDF5; needs h5py, the extra ``io``."""

import math
import zlib
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any, final

import numpy as np

from smajax.errors import InputError, first_line
from smajax.recordings.readers.mat_variables import Kind, MatVariable, MatVariables

# Bytes with which a file of version 7.3 begins, and those of HDF5, which come first or after MATLAB's 512.
_MARK = b"MATLAB 7.3 MAT-file"
_HDF5_MARK = b"\x89HDF\r\n\x1a\n"
_USER_BLOCK = 512
# Characters of the longest text that is read, a unit.
_MAX_TEXT = 2**16
# Bytes of the largest chunk of a smaller dataset: far above MATLAB's chunks, which have some kilobytes.
_LARGEST_CHUNK = 16 * 2**20
# Bytes that HDF5's checksum adds to a chunk.
_CHECKSUM_BYTES = 4
_KINDS: dict[str, Kind] = {"char": "text", "struct": "struct", "cell": "other"}
_CLASS_OF_TYPE = {"f": "double", "i": "int64", "u": "uint64"}


def is_version_73(path: Path) -> bool:
    """Return whether a file is a MATLAB file of version 7.3, or HDF5.

    Args:
        path: The file.
    """
    with path.open("rb") as file:
        head = file.read(_USER_BLOCK + len(_HDF5_MARK))
    return head.startswith((_MARK, _HDF5_MARK)) or head[_USER_BLOCK:] == _HDF5_MARK


@final
class Mat73Variables(MatVariables):
    """Variables of a file of version 7.3; its arrays have the order of dimensions reversed.

    Args:
        path: The file.
    """

    def __init__(self, path: Path):
        self._path = path
        with self._open():
            pass

    def children(self, name: str = "") -> dict[str, MatVariable]:
        """Return the variables of the file, or the fields of a struct."""
        with self._open() as file:
            group = file[name.replace(".", "/")] if name else file
            names = [key for key in group if not key.startswith("#")]
            return {key: _described(_member(group, key)) for key in names}

    def values(self, name: str) -> np.ndarray:
        """Return the values of a variable with real numbers."""
        with self._open() as file:
            item = file[name.replace(".", "/")]
            _check_chunks(item)
            return np.asarray(item[()]).T

    def text(self, name: str) -> str:
        """Return the value of a variable with a text, which is stored as numbers of characters."""
        with self._open() as file:
            codes = file[name.replace(".", "/")]
            if codes.size > _MAX_TEXT:
                raise ValueError(f"a text has {codes.size} characters")
            _check_chunks(codes)
            return "".join(chr(int(code)) for code in np.ravel(codes[()].T)).strip()

    @contextmanager
    def _open(self) -> Iterator[Any]:
        try:
            import h5py
        except ImportError:
            cure = "run pip install \"smajax[io]\", or save it with save(..., '-v7')"
            raise InputError(f"{self._path}: MATLAB files of version 7.3 need h5py: {cure}") from None
        try:
            with h5py.File(self._path, "r") as file:
                yield file
        except InputError:
            raise
        except Exception as error:  # h5py raises errors of many types for damaged files
            problem = f"the file is not readable as MATLAB data of version 7.3 ({first_line(error)})"
            raise InputError(f"{self._path}: {problem}: save it again, or with '-v7'") from None


def _member(group: Any, key: str) -> Any:
    """Return a member of a group; one in another file is refused, since that could be of any kind."""
    import h5py

    item = None if isinstance(group.get(key, getlink=True), h5py.ExternalLink) else group.get(key)
    # A soft link may lead through a link to another file.
    is_elsewhere = item is None or item.file.filename != group.file.filename
    if is_elsewhere or (isinstance(item, h5py.Dataset) and (item.external or item.is_virtual)):
        raise ValueError(f"the values of '{key}' are not in the file")
    return item


def _check_chunks(item: Any) -> None:
    """Refuse a dataset whose chunks unpack to more than its values: HDF5 inflates each as a whole, without a limit."""
    import h5py

    if item.chunks is None:
        return
    size = math.prod(item.chunks) * item.dtype.itemsize
    if size > max(_LARGEST_CHUNK, item.nbytes):
        raise ValueError(f"a chunk of {size} bytes has values of {item.nbytes} bytes")
    filters = item.id.get_create_plist()
    kinds = [filters.get_filter(k)[0] for k in range(filters.get_nfilters())]
    if set(kinds) - {h5py.h5z.FILTER_DEFLATE, h5py.h5z.FILTER_SHUFFLE, h5py.h5z.FILTER_FLETCHER32}:
        raise ValueError("its values are compressed in a way that MATLAB does not use")
    if h5py.h5z.FILTER_DEFLATE not in kinds:
        return
    if kinds.count(h5py.h5z.FILTER_DEFLATE) > 1:
        raise ValueError("its values are compressed twice")
    for k in range(item.id.get_num_chunks()):
        chunk = item.id.get_chunk_info(k)
        if chunk.filter_mask >> kinds.index(h5py.h5z.FILTER_DEFLATE) & 1:  # stored without compression
            continue
        inflater = zlib.decompressobj()
        inflater.decompress(item.id.read_direct_chunk(chunk.chunk_offset)[1], size + _CHECKSUM_BYTES)
        if not inflater.eof:
            raise ValueError(f"a chunk does not unpack to its {size} bytes")


def _described(item: Any) -> MatVariable:
    """Return what a dataset or group is."""
    class_name = item.attrs.get("MATLAB_class", b"")
    class_name = class_name.decode() if isinstance(class_name, bytes) else str(class_name)
    if not hasattr(item, "dtype"):
        return MatVariable("struct", (1, 1), class_name or "struct")
    shape = tuple(reversed(item.shape))
    if "MATLAB_object_decode" in item.attrs:
        return MatVariable("object", shape, class_name)
    if "MATLAB_empty" in item.attrs:  # the values are the shape
        return MatVariable(_KINDS.get(class_name, "numbers"), (0, 0), class_name)
    if item.dtype.names is not None:
        return MatVariable("other", shape, "complex")
    kind = _KINDS.get(class_name, "numbers" if item.dtype.kind in _CLASS_OF_TYPE else "other")
    return MatVariable(kind, shape, class_name or _CLASS_OF_TYPE.get(item.dtype.kind, str(item.dtype)))
