"""Messages of ROS bags: .bag of ROS 1, and .db3 of ROS 2; needs rosbags, the extra ``ros``."""

import itertools
from collections.abc import Collection, Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Any, final

from smajax.errors import InputError, first_line
from smajax.recordings.readers.messages import MessageFile


def import_rosbags(path: Path) -> Any:
    """Return the package that decodes messages of ROS.

    Args:
        path: The file, for the message.

    Raises:
        InputError: If it is not installed.
    """
    try:
        import rosbags.highlevel
        import rosbags.typesys
    except ImportError:
        cure = 'run pip install "smajax[ros]", or export the topics as CSV'
        raise InputError(f"{path}: ROS messages need rosbags: {cure}") from None
    return rosbags


@final
class BagFile(MessageFile):
    """Messages of a bag; a bag of ROS 2 that has no definitions of its messages may have those of ROS itself only.

    Args:
        path: The file.
    """

    def __init__(self, path: Path):
        self._path = path
        self._rosbags = import_rosbags(path)
        self.undecoded: dict[str, str] = {}
        topics: dict[str, None] = {}
        with self._open() as reader:
            for connection in reader.connections:
                if not isinstance(connection.topic, str):  # a damaged row of the database
                    raise ValueError("a topic has no name")
                for _, _, data in itertools.islice(reader.messages([connection]), 1):
                    try:
                        reader.deserialize(data, connection.msgtype)
                    except Exception:  # a type that the bag does not define raises one of several
                        self.undecoded[connection.topic] = f"{connection.msgtype}, which the bag does not define"
                topics[connection.topic] = None
        self.topics: Sequence[str] = tuple(topic for topic in topics if topic not in self.undecoded)

    def messages(self, topics: Collection[str]) -> Iterator[tuple[str, int, Any]]:
        """Yield topic, time in ns and content of each message."""
        with self._open() as reader:
            connections = [connection for connection in reader.connections if connection.topic in topics]
            for connection, time, data in reader.messages(connections) if connections else ():
                yield connection.topic, time, reader.deserialize(data, connection.msgtype)

    @contextmanager
    def _open(self) -> Iterator[Any]:
        """Open the bag."""
        typesys, highlevel = self._rosbags.typesys, self._rosbags.highlevel
        try:
            default = typesys.get_typestore(typesys.Stores.LATEST)
            with highlevel.AnyReader([self._path], default_typestore=default) as reader:
                yield reader
        except InputError:
            raise
        except Exception as error:  # damaged bags raise different types, of SQLite as well
            problem = f"the file is not readable as a ROS bag ({first_line(error)})"
            cure = "recover it with 'rosbag reindex' or 'ros2 bag reindex', or export the topics as CSV"
            raise InputError(f"{self._path}: {problem}: {cure}") from None
