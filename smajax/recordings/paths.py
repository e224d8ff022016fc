"""Paths: hints for misspelt ones, and files that are written completely or not at all."""

import contextlib
import errno
import os
import unicodedata
from collections.abc import Iterator
from pathlib import Path

from smajax.errors import InputError, suggestion

# Categories of Unicode that no name of a file may have: such names break lines, or cannot be written to a document.
_REFUSED = ("Cc", "Cs", "Zl", "Zp")
# What a name of a temporary file has in addition to that of the file, and the longest name in a result folder.
_LONGEST_ADDITION = "." + "x" * 20 + ".part"
_LONGEST_MEMBER = "x" * 40


def check_name(path: Path | str) -> None:
    """Check that the name of a file can be shown and written to a document.

    Args:
        path: The path.

    Raises:
        InputError: If it is not UTF-8, or has a line break or another control character.
    """
    refused = next((c for c in str(path) if unicodedata.category(c) in _REFUSED), None)
    if refused is not None:
        is_half = unicodedata.category(refused) == "Cs"
        kind = "bytes that are not UTF-8" if is_half else "a line break or another control character"
        raise InputError(f"{path}: the name has {kind}: rename it")


def check_output_path(path: Path, option: str) -> Path:
    """Return the absolute path of a file or folder that will be written, checked before any computation.

    Args:
        path: The file or folder.
        option: The option that names it, for the message.

    Raises:
        InputError: If its name cannot be used.
    """
    check_name(path)
    try:
        place = Path(os.path.realpath(path))
        if place.is_symlink():  # a loop: the others are resolved
            raise OSError(errno.ELOOP, os.strerror(errno.ELOOP))
        existing = next(folder for folder in place.parents if folder.exists())
        # The system itself says which names it cannot have, and those of temporary files are longer than this one.
        names = [*place.relative_to(existing).parts, place.name + _LONGEST_ADDITION]
        for path_of_name in (*(existing / name for name in names), place / _LONGEST_MEMBER):
            with contextlib.suppress(FileNotFoundError, NotADirectoryError):
                os.lstat(path_of_name)
    except OSError as error:
        problem = f"the path cannot be used ({error.strerror or error})"
        raise InputError(f"{path}: {problem}: name another one with {option}") from None
    return place


def check_output_file(path: Path, option: str) -> None:
    """Check, before any computation, that a file can be written in a folder that is there.

    Args:
        path: The file.
        option: The option that names it, for the message.

    Raises:
        InputError: If it cannot.
    """
    place = check_output_path(path, option)
    if place.is_dir():
        raise InputError(f"{path}: this is a folder: name a file with {option}")
    if not place.parent.is_dir() or not os.access(place.parent, os.W_OK | os.X_OK):
        raise InputError(f"{path}: nothing can be written in {place.parent}: name a file elsewhere with {option}")


def similar_name(path: Path) -> str:
    """Return `` (did you mean 'x'?)`` for the most similar name in the folder of a missing file, or an empty text."""
    if path.is_symlink():
        return " at the end of this symbolic link"
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


class FileWriteError(InputError):
    """A file that cannot be written.

    Attributes:
        reason: The reason that the operating system gives.
    """

    def __init__(self, path: Path, error: OSError):
        """Create the error.

        Args:
            path: The file.
            error: The error of the system.
        """
        self.reason: str = str(error.strerror or error)
        super().__init__(f"{path}: the file cannot be written ({self.reason}): check the folder")


@contextlib.contextmanager
def replacing(path: Path, part: Path | None = None) -> Iterator[Path]:
    """Yield the path of a temporary file that replaces a file when the context ends without an error.

    Args:
        path: The file to write or replace.
        part: The temporary file, on the same disk; a hidden file in the same folder by default.

    Raises:
        FileWriteError: If the file cannot be written.
    """
    part = part or path.with_name(f".{path.name}.{os.getpid()}.part")
    try:
        yield part
        os.replace(part, path)
    except OSError as error:
        raise FileWriteError(path, error) from None
    finally:
        part.unlink(missing_ok=True)
