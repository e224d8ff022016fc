"""Messages of MCAP files in JSON, ROS 1 or ROS 2; needs mcap, and for ROS rosbags: the extra ``ros``."""

import json
from collections.abc import Callable, Collection, Iterator, Sequence
from pathlib import Path
from typing import Any, final

from smajax.errors import InputError, first_line
from smajax.recordings.readers.bag import import_rosbags
from smajax.recordings.readers.messages import MessageFile

# Encodings of messages with those of their definitions.
_JSON = ("json",)
_ROS = {("cdr", "ros2msg"), ("cdr", "ros2idl"), ("ros1", "ros1msg")}


@final
class McapFile(MessageFile):
    """Messages of an MCAP file.

    Args:
        path: The file.
    """

    def __init__(self, path: Path):
        self._path = path
        try:
            import mcap.reader
        except ImportError:
            cure = 'run pip install "smajax[ros]", or export the topics as CSV'
            raise InputError(f"{path}: MCAP files need mcap: {cure}") from None
        self._make_reader: Callable[..., Any] = mcap.reader.make_reader
        self._decoders: dict[int, Callable[[bytes], Any]] = {}
        topics: dict[str, None] = {}
        self.undecoded: dict[str, str] = {}
        for channel, schema in self._channels():
            decoder = self._decoder(channel, schema)
            if decoder is None:
                self.undecoded[channel.topic] = channel.message_encoding or "an unknown encoding"
            else:
                self._decoders[channel.id] = decoder
                topics[channel.topic] = None
        self.topics: Sequence[str] = tuple(topic for topic in topics if topic not in self.undecoded)

    def messages(self, topics: Collection[str]) -> Iterator[tuple[str, int, Any]]:
        """Yield topic, time in ns and content of each message."""
        try:
            with self._path.open("rb") as file:
                for _, channel, message in self._make_reader(file).iter_messages(topics=list(topics)):
                    yield channel.topic, message.log_time, self._decoders[channel.id](message.data)
        except InputError:
            raise
        except Exception as error:  # damaged files, and messages that do not fit their definitions, raise many types
            raise self._unreadable(error) from None

    def _channels(self) -> list[tuple[Any, Any]]:
        """Return the channels of the file with their schemas."""
        try:
            with self._path.open("rb") as file:
                summary = self._make_reader(file).get_summary()
                if summary is not None and summary.channels:
                    return [(channel, summary.schemas.get(channel.schema_id)) for channel in summary.channels.values()]
                file.seek(0)
                messages = self._make_reader(file).iter_messages(log_time_order=False)
                return list({channel.id: (channel, schema) for schema, channel, _ in messages}.values())
        except Exception as error:  # as above
            raise self._unreadable(error) from None

    def _decoder(self, channel: Any, schema: Any) -> Callable[[bytes], Any] | None:
        """Return the function that decodes the messages of a channel; ``None`` for another encoding."""
        if channel.message_encoding in _JSON:
            return json.loads
        if schema is None or (channel.message_encoding, schema.encoding) not in _ROS:
            return None
        typesys = import_rosbags(self._path).typesys
        store = typesys.get_typestore(typesys.Stores.EMPTY)
        text = schema.data.decode()
        try:
            definitions = (
                typesys.get_types_from_idl(text)
                if schema.encoding == "ros2idl"
                else typesys.get_types_from_msg(text, schema.name)
            )
            store.register(definitions)
        except Exception:  # a definition that is not understood raises one of several types
            return None
        name = next((name for name in definitions if _short(name) == _short(schema.name)), schema.name)
        decode = store.deserialize_cdr if channel.message_encoding == "cdr" else store.deserialize_ros1
        return lambda data: decode(data, name)

    def _unreadable(self, error: Exception) -> InputError:
        problem = f"the file is not readable as MCAP ({first_line(error)})"
        cure = "recover it with 'mcap recover', or export the topics as CSV"
        return InputError(f"{self._path}: {problem}: {cure}")


def _short(name: str) -> str:
    """Return the name of a type without the folder that ROS 2 puts into it."""
    return name.replace("/msg/", "/")
