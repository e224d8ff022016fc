"""What a recording is read from: a path, a table in memory, or a recording that is already read."""

import os
from collections.abc import Mapping, Sequence
from typing import Any, Protocol, TypeAlias

from numpy.typing import ArrayLike, NDArray

from smajax.recordings.recording import Recording

# Name of a recording without a file; further ones are "recording 2" and so on.
DEFAULT_NAME = "recording"
# What messages ask for.
TAKES = "give a path, a DataFrame, a dictionary of columns, an array with headers, or a Recording"


class DataFrameLike(Protocol):
    """A table of pandas, polars or pyarrow, recognised by its attributes without importing the package."""

    @property
    def columns(self) -> Any:
        """The columns, or their headers."""
        ...

    def __getitem__(self, key: Any, /) -> Any: ...


RecordingSource: TypeAlias = str | os.PathLike[str] | Recording | Mapping[str, ArrayLike] | DataFrameLike | NDArray[Any]


def as_source_list(sources: RecordingSource | Sequence[RecordingSource]) -> list[Any]:
    """Return one source, or a list or tuple of them, as a list.

    Args:
        sources: A source, or several in a list or tuple.
    """
    return list(sources) if isinstance(sources, list | tuple) else [sources]


def is_path(source: Any) -> bool:
    """Return whether a source is a path."""
    return isinstance(source, str | os.PathLike)


def is_recording_source(source: Any) -> bool:
    """Return whether a source is of a type from which a recording may be read.

    Args:
        source: The source.
    """
    if is_path(source) or isinstance(source, Recording | Mapping):
        return True
    return any(hasattr(source, name) for name in ("columns", "column_names", "__array__"))
