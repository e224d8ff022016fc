"""Paths: hints for misspelt ones, and files that are written completely or not at all."""

import contextlib
import os
from collections.abc import Iterator
from pathlib import Path

from smajax.errors import InputError, suggestion


def similar_name(path: Path) -> str:
    """Return `` (did you mean 'x'?)`` for the most similar name in the folder of a missing file, or an empty text."""
    names = [other.name for other in path.parent.iterdir()] if path.parent.is_dir() else []
    return suggestion(path.name, names)


def unreadable(path: Path, error: OSError) -> InputError:
    """Return the error for a file that the system does not let smajax read.

    Args:
        path: The file.
        error: Error of the system.
    """
    reason = error.strerror or error
    return InputError(f"{path}: the file cannot be read ({reason}): check its permissions")


@contextlib.contextmanager
def replacing(path: Path, part: Path | None = None) -> Iterator[Path]:
    """Yield the path of a temporary file that replaces a file when the context ends without an error.

    Args:
        path: The file to write or replace.
        part: The temporary file, on the same disk; a hidden file in the same folder by default.

    Raises:
        InputError: If the file cannot be written.
    """
    part = part or path.with_name(f".{path.name}.{os.getpid()}.part")
    try:
        yield part
        os.replace(part, path)
    except OSError as error:
        raise InputError(f"{path}: the file cannot be written ({error.strerror or error}): check the folder") from None
    finally:
        part.unlink(missing_ok=True)
