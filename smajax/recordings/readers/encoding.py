"""Encodings of text files: UTF-8, UTF-16 and cp1252 are distinguished, others are named.

A file in UTF-8, or in cp1252 where it is not UTF-8, is read as it is, row by row. Any other one is first converted to
UTF-8 in memory.
"""

import io
from pathlib import Path
from typing import BinaryIO

from smajax.errors import InputError
from smajax.recordings.readers.base import MEMORY_LIMIT

# Bytes at the beginning of the file that are tested for UTF-16.
_SAMPLE = 2000
# Latin text in UTF-16 has a zero in every other byte, all in even or all in odd places. Half as many zeros are enough,
# and this number has to be more than five times that of the zeros in the other places. Chosen by trial.
_BYTES_PER_ZERO = 4
_ZERO_RATIO = 5
UTF8_MARK = b"\xef\xbb\xbf"
_UTF16_MARKS = (b"\xff\xfe", b"\xfe\xff")
# Bytes in memory per byte of a file that is converted: the bytes, the text (up to four a character), and the result.
_COPIES = 8
# Encodings of which every row can be decoded on its own, since a line feed is a single byte of value 10 in them.
_READ_BY_ROW = ("utf-8", "utf8", "utf-8-sig", "ascii")


def open_as_utf8(path: Path, encoding: str | None) -> BinaryIO:
    """Open a text file for reading bytes in UTF-8 (or cp1252 where ``encoding`` is ``None``), after its mark.

    Args:
        path: The file.
        encoding: Encoding of the file; ``None`` to distinguish UTF-8, UTF-16 and cp1252.

    Raises:
        InputError: If the file is not text in this encoding, or too large to convert.
    """
    with path.open("rb") as file:
        head = file.read(_SAMPLE)
    if encoding is None:
        encoding = utf16_of(head)
    if encoding is None or encoding.lower().replace("_", "-") in _READ_BY_ROW:
        stream = path.open("rb")
        stream.seek(len(UTF8_MARK) if head.startswith(UTF8_MARK) else 0)
        return stream
    if path.stat().st_size * _COPIES > MEMORY_LIMIT:
        limit = MEMORY_LIMIT / _COPIES / 2**30
        raise InputError(f"{path}: a file in {encoding} above {limit:.2g} GiB is not converted: save the file as UTF-8")
    try:
        text = path.read_bytes().decode(encoding)
    except UnicodeError as error:
        cure = 'name the encoding, as in encoding = "cp1252" under [recording] in the rig, or save the file as UTF-8'
        problem = f"the file is not text in {encoding} ({getattr(error, 'reason', error)})"
        raise InputError(f"{path}: {problem}: {cure}", code="encoding", cure=cure) from None
    return io.BytesIO(text.removeprefix("\ufeff").encode("utf-8"))


def decode_row(line: bytes, encoding: str | None) -> str:
    """Return the text of a row of the stream of ``open_as_utf8``.

    Args:
        line: Bytes of the row.
        encoding: Encoding of the file; ``None`` if a row that is not UTF-8 is in cp1252.

    Raises:
        UnicodeDecodeError: If it is neither.
    """
    try:
        return line.decode("utf-8")
    except UnicodeDecodeError:
        if encoding is not None:
            raise
        return line.decode("cp1252")


def utf16_of(head: bytes) -> str | None:
    """Return the encoding of a file that begins like UTF-16, with or without a mark, else ``None``.

    Args:
        head: First bytes of the file.
    """
    if head.startswith(_UTF16_MARKS):
        return "utf-16"
    even, odd = head[0::2].count(0), head[1::2].count(0)
    if max(even, odd) > len(head) // _BYTES_PER_ZERO > _ZERO_RATIO * min(even, odd):
        return "utf-16-le" if odd > even else "utf-16-be"
    return None
