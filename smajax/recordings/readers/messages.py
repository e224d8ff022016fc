"""Messages of ROS bags and MCAP files: files of messages by topic, their numeric fields, and their stamps."""

import abc
import dataclasses
import sys
from collections.abc import Collection, Iterator, Mapping, Sequence
from typing import Any

import numpy as np

# Elements up to which a list in a message is columns: joints of a robot, but no image or scan.
_MAX_ELEMENTS = 64
# Fields of a message that have its stamp, and the names of their parts in ROS 1, ROS 2 and the schemas of Foxglove.
_STAMPS = ("stamp", "timestamp")
_SECONDS = ("sec", "secs")
_NANOSECONDS = ("nanosec", "nsec", "nsecs")
_NANOSECONDS_PER_SECOND = 1_000_000_000
# Largest number of float64: an integer of JSON may be larger.
_LARGEST = sys.float_info.max

# Keys of the nested parts of a message that lead to a number.
FieldPath = tuple[str | int, ...]


class MessageFile(abc.ABC):
    """A file of messages.

    Attributes:
        topics: Names of the topics whose messages can be decoded.
        undecoded: Reasons why the messages of other topics cannot, by topic.
    """

    topics: Sequence[str]
    undecoded: Mapping[str, str]

    @abc.abstractmethod
    def messages(self, topics: Collection[str]) -> Iterator[tuple[str, int, Any]]:
        """Yield topic, time at which it was recorded in ns, and content of each message, in the order of these times.

        Args:
            topics: Names of the topics.
        """


def numeric_fields(message: Any) -> Iterator[tuple[str, FieldPath]]:
    """Yield name and path of each number in a message, such as ``position.0``, without its stamp.

    Args:
        message: Content: an object of JSON, or a message of ROS.
    """
    for key, value in _items(message):
        is_stamp = key == "header" or (key in _STAMPS and _nanoseconds(value) is not None)
        if not is_stamp:
            yield from _numbers(value, (key,))


def number_at(message: Any, path: FieldPath) -> float:
    """Return a number in a message; NaN where there is none.

    Args:
        message: Content of the message.
        path: Its place.
    """
    for key in path:
        message = _part(message, key)
    if isinstance(message, int | float | np.number | np.bool_) and abs(message) <= _LARGEST:
        return float(message)
    return np.nan


def header_stamp(message: Any) -> int | None:
    """Return the stamp in a message in ns: that of its header, or a field ``stamp`` or ``timestamp``; none if unset.

    Args:
        message: Content of the message.
    """
    for holder in (_part(message, "header"), message):
        for key in _STAMPS:
            nanoseconds = _nanoseconds(_part(holder, key))
            if nanoseconds:
                return nanoseconds
    return None


def _nanoseconds(stamp: Any) -> int | None:
    if stamp is None or isinstance(stamp, int | float | str):
        return None
    seconds, nanoseconds = (
        next((part for key in keys if (part := _part(stamp, key)) is not None), None)
        for keys in (_SECONDS, _NANOSECONDS)
    )
    if isinstance(seconds, int) and isinstance(nanoseconds, int):
        return seconds * _NANOSECONDS_PER_SECOND + nanoseconds
    return None


def _items(value: Any) -> Iterator[tuple[str | int, Any]]:
    """Yield the parts of an object, a message, or a short list."""
    if isinstance(value, dict):
        yield from value.items()
    elif dataclasses.is_dataclass(value):
        yield from ((field.name, getattr(value, field.name)) for field in dataclasses.fields(value))
    elif isinstance(value, list | tuple | np.ndarray) and len(value) <= _MAX_ELEMENTS:
        yield from enumerate(value)


def _part(value: Any, key: str | int) -> Any:
    """Return a part of an object, a message or a list; ``None`` if there is none."""
    if isinstance(value, dict):
        return value.get(key)
    if isinstance(key, str):
        return getattr(value, key, None)
    return value[key] if isinstance(value, list | tuple | np.ndarray) and key < len(value) else None


def _numbers(value: Any, path: FieldPath) -> Iterator[tuple[str, FieldPath]]:
    if value is None or isinstance(value, int | float | np.number | np.bool_):
        yield ".".join(str(key) for key in path), path
    for key, part in _items(value):
        yield from _numbers(part, (*path, key))
