"""Reader of ROS bags and MCAP files: a number in the messages of a topic is a column ``/topic.field``.

The columns are the numbers in the first message of each topic, with ``position.0`` for an element of a list. The time
is the stamp in the messages, where all topics that are read have it, else the time at which they were recorded. A row
is a message; topics with other stamps are held or interpolated on request only.
"""

import itertools
from array import array
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import final

import numpy as np
from numpy.typing import NDArray

from smajax.errors import InputError, suggestion
from smajax.recordings.read_options import ReadOptions
from smajax.recordings.readers.base import Table, file_sha256, refuse_if_too_large, row_error
from smajax.recordings.readers.messages import FieldPath, MessageFile, header_stamp, number_at, numeric_fields

_TIME_HEADER = "time [s]"
_NANOSECONDS_PER_SECOND = 1e9
# Largest stamp in ns, the year 2116: of larger ones the differences would not be whole numbers of 64 bits.
_LAST_STAMP = 2**62
# Messages after which the memory of the columns is checked.
_MESSAGES_PER_CHECK = 10_000

Stamps = NDArray[np.int64]


@dataclass
class _Topic:
    """Messages of a topic: times of recording and stamps in ns (0 where a message has none), and columns by number."""

    recorded: "array[int]" = field(default_factory=lambda: array("q"))
    stamps: "array[int]" = field(default_factory=lambda: array("q"))
    columns: "dict[int, array[float]]" = field(default_factory=dict)


@final
class TopicTable(Table):
    """Topics of a ROS bag or MCAP file; the first message that is a row is row 1.

    Args:
        path: The file.
        options: Options of reading.
    """

    leaves_out_unknown = True
    first_row = 1

    def __init__(self, path: Path, options: ReadOptions):
        self.path = path
        self._options = options
        self._file = _open(path)
        if not self._file.topics:
            others = ", ".join(f"{topic} ({reason})" for topic, reason in self._file.undecoded.items())
            problem = f"no topic has messages in JSON or ROS (it has {others})" if others else "there is no message"
            raise InputError(f"{path}: {problem}: record such messages, or export the topics as CSV")
        clock = options.clock_topic
        if clock is not None and clock not in self._file.topics:
            hint = suggestion(clock, self._file.topics)
            raise InputError(f"{path}: there is no topic '{clock}'{hint}: it has {', '.join(self._file.topics)}")
        if clock is None and options.topic_interpolation != "refuse":
            cure = f'name it, as in clock_topic = "{self._file.topics[0]}"'
            raise InputError(f"{path}: topic_interpolation needs the topic whose messages are the rows: {cure}")
        places: dict[str, tuple[str, FieldPath]] = {}
        for topic in self._file.topics:
            for _, _, message in itertools.islice(self._file.messages([topic]), 1):
                places |= {f"{topic}.{name}": (topic, place) for name, place in numeric_fields(message)}
        self._places = list(places.values())
        self.implied_time: int | None = len(self._places)
        self.headers: tuple[str, ...] = (*places, _TIME_HEADER)
        reasons = [f"topic {topic} was left out: its messages are in {r}" for topic, r in self._file.undecoded.items()]
        self.notes = tuple(reasons)

    def load(self, indices: Sequence[int], lenient: bool) -> list[np.ndarray]:
        """Return fields of messages as columns."""
        topics = self._read([index for index in indices if index != self.implied_time])
        for name, topic in topics.items():
            for index, column in topic.columns.items():
                bad = np.flatnonzero(~np.isfinite(column))
                if bad.size and not lenient:
                    place = f"{self.path}: message {bad[0] + 1} of topic {name}, column '{self.headers[index]}'"
                    raise row_error(f"{place}: the message has no finite number there")
        stamps = self._stamps(topics)
        clock = self._clock(stamps)
        rows = self._common_rows(clock, stamps)
        time = stamps[clock][rows]
        columns: dict[int, np.ndarray] = {}
        for name, topic in topics.items():
            is_clock = np.array_equal(stamps[name], stamps[clock])
            for index, values in topic.columns.items():
                numbers = np.array(values)
                columns[index] = numbers[rows] if is_clock else self._interpolated(numbers, stamps[name], time)
        if len(time):
            columns[len(self._places)] = (time - time[0]) / _NANOSECONDS_PER_SECOND
        for name in topics:
            if not np.array_equal(stamps[name], stamps[clock]):
                word = "held" if self._options.topic_interpolation == "hold" else "interpolated linearly"
                self.notes += (f"topic {name} ({len(stamps[name])} messages) was {word} at the stamps of {clock}",)
        return [columns[index] for index in indices]

    def sha256(self) -> str:
        """Return the SHA-256 of the file in hexadecimal."""
        return file_sha256(self.path)

    def _read(self, indices: Sequence[int]) -> dict[str, _Topic]:
        """Return the topics of some columns, and that of the clock."""
        clock = self._options.clock_topic
        if clock is None and not indices:
            clock = self._file.topics[0]
        topics: dict[str, _Topic] = {} if clock is None else {clock: _Topic()}
        for index in indices:
            topics.setdefault(self._places[index][0], _Topic()).columns[index] = array("d")
        for count, (name, time, message) in enumerate(self._file.messages(list(topics)), 1):
            topic = topics[name]
            stamp = header_stamp(message) or 0
            if not all(isinstance(value, int) and 0 <= value <= _LAST_STAMP for value in (time, stamp)):
                cure = "correct it, or export the topics as CSV"
                raise InputError(f"{self.path}: message {count} of topic {name} has an impossible stamp: {cure}")
            topic.recorded.append(time)
            topic.stamps.append(stamp)
            for index, column in topic.columns.items():
                column.append(number_at(message, self._places[index][1]))
            if count % _MESSAGES_PER_CHECK == 0:
                refuse_if_too_large(self.path, count, len(indices))
        return topics

    def _stamps(self, topics: Mapping[str, _Topic]) -> dict[str, Stamps]:
        """Return the stamps of each topic in ns: those in the messages, or the times of recording if some have none."""
        without = [name for name, topic in topics.items() if not all(topic.stamps)]
        if without:
            self.notes += (f"time is when messages were recorded, since those of {without[0]} have no stamp",)
        else:
            self.notes += ("time is the stamp in the messages",)
        return {name: np.array(t.recorded if without else t.stamps, np.int64) for name, t in topics.items()}

    def _clock(self, stamps: Mapping[str, Stamps]) -> str:
        """Return the topic whose messages are the rows; other stamps are refused unless they may be interpolated."""
        clock = self._options.clock_topic or next(iter(stamps))
        if not len(stamps[clock]):
            raise InputError(f"{self.path}: topic {clock} has no messages: name another as clock_topic")
        others = [name for name, values in stamps.items() if not np.array_equal(values, stamps[clock])]
        if others and self._options.topic_interpolation == "refuse":
            counts = " and ".join(f"{name} ({len(stamps[name])} messages)" for name in (clock, others[0]))
            options = f'clock_topic = "{clock}" and topic_interpolation = "hold" or "linear" under [recording]'
            cure = f"set {options} in the rig, or map fields of one topic only"
            message = f"{self.path}: columns are of topics {counts} with different stamps: {cure}"
            raise InputError(message, code="topic-stamps", cure=cure, topic=clock)
        for name in others:
            back = np.flatnonzero(np.diff(stamps[name]) < 0)
            if back.size:
                problem = f"the stamp of message {back[0] + 2} of topic {name} is before that of the one before"
                raise InputError(f"{self.path}: {problem}: make it the clock_topic, or map fields of one topic only")
        return clock

    def _common_rows(self, clock: str, stamps: Mapping[str, Stamps]) -> slice:
        """Return the rows of the clock from the first message of each other topic, and to the last if interpolated."""
        time = stamps[clock]
        others = [values for name, values in stamps.items() if name != clock and len(values)]
        first = max((np.searchsorted(time, values[0], "left") for values in others), default=0)
        end = len(time)
        if self._options.topic_interpolation == "linear":
            end = min((int(np.searchsorted(time, values[-1], "right")) for values in others), default=end)
        if end - first < len(time) and others:
            if end <= first:
                raise InputError(f"{self.path}: no message of {clock} is between those of the other topics: map others")
            problem = f"{len(time) - (end - first)} of {len(time)} messages of {clock} were left out"
            self.notes: tuple[str, ...] = (*self.notes, f"{problem}, since another topic has none before or after them")
            self.first_row: int = 1 + int(first)
        return slice(int(first), end)

    def _interpolated(self, values: np.ndarray, stamps: Stamps, time: Stamps) -> np.ndarray:
        """Return values of a topic at the stamps of the rows."""
        if self._options.topic_interpolation == "linear":
            start = time[0]
            return np.interp((time - start).astype(float), (stamps - start).astype(float), values)
        return values[np.searchsorted(stamps, time, "right") - 1]


def _open(path: Path) -> MessageFile:
    """Return the messages of a file."""
    if path.suffix.lower() == ".mcap":
        from smajax.recordings.readers.mcap import McapFile

        return McapFile(path)
    from smajax.recordings.readers.bag import BagFile

    return BagFile(path)
