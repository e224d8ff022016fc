"""Checkpoint of a running sweep: the folder ``NAME.partial`` with its finished chunks, locked by that run."""

import contextlib
import errno
import hashlib
import json
import shutil
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any

from filelock import FileLock, Timeout

from smajax.errors import InputError
from smajax.files.toml import write_text

_SCHEMA = "smajax.sweep-partial/1"
# File that identifies the sweep of a folder, and file that a run locks.
_IDENTITY = "sweep.json"
_LOCK = "lock"
# What the system answers where the folder's file system has no locks, as some network drives.
_NO_LOCKS = (errno.ENOLCK, errno.ENOSYS, errno.EOPNOTSUPP, getattr(errno, "ENOTSUP", errno.EOPNOTSUPP))


def digest(header: Mapping[str, Any]) -> str:
    """Return the SHA-256 digest that identifies a sweep by its header."""
    return hashlib.sha256(json.dumps(header, sort_keys=True).encode()).hexdigest()


def _folder_of(out: Path) -> Path:
    return out.with_name(out.name + ".partial")


def has_checkpoint(out: Path) -> bool:
    """Return whether the result folder ``out`` has a checkpoint of a run that did not end."""
    return _folder_of(out).exists()


@contextlib.contextmanager
def checkpoint_folder(out: Path, header: Mapping[str, Any], *, resume: bool) -> Iterator[Path]:
    """Open the checkpoint folder next to a result folder, locked for this run; it is created if necessary.

    A run that fails before its first chunk leaves no folder.

    Args:
        out: Result folder of the sweep.
        header: ``SweepFile.header`` of the sweep.
        resume: Whether to continue with the chunks of an earlier run.

    Yields:
        The checkpoint folder.

    Raises:
        InputError: If the folder is not a checkpoint, belongs to another sweep, contains chunks without ``resume``,
            cannot be created or locked, or is in use by another run.
    """
    folder = _folder_of(out)
    if folder.exists() and not (
        folder.is_dir() and ((folder / _IDENTITY).is_file() or all(map(_is_leftover, folder.iterdir())))
    ):
        raise InputError(
            f"{folder}: chunks of a sweep belong there, but smajax did not create it: remove it, or name another --out"
        )
    lock = _lock(folder)
    try:
        _check(folder, header, resume=resume)
        try:
            write_text(folder / _IDENTITY, json.dumps(_identity(header)) + "\n")
            yield folder
        except BaseException:  # Ctrl-C before the first chunk as well
            if not any(folder.glob("chunk-*.parquet")):
                shutil.rmtree(folder, ignore_errors=True)
            raise
    finally:
        lock.release()


def _lock(folder: Path) -> FileLock:
    """Create the folder and lock it for this run; where the file system has no locks, it stays unlocked."""
    try:
        folder.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise InputError(
            f"{folder}: the folder cannot be created ({error.strerror or error}): name another --out"
        ) from None
    lock = FileLock(folder / _LOCK, timeout=0)
    try:
        lock.acquire()
    except Timeout:
        raise InputError(
            f"{folder}: another run is using it: wait until that run has ended, or name another --out"
        ) from None
    except NotImplementedError:  # a system without locks
        pass
    except OSError as error:
        if error.errno not in _NO_LOCKS:
            with contextlib.suppress(OSError):
                folder.rmdir()  # unless there are files of an earlier run
            raise InputError(
                f"{folder / _LOCK}: this run cannot lock its folder ({error.strerror or error}): make the folder "
                "writable, or name another --out"
            ) from None
    return lock


def _check(folder: Path, header: Mapping[str, Any], *, resume: bool) -> None:
    try:
        identity = json.loads((folder / _IDENTITY).read_text("utf-8"))
    except (OSError, ValueError):
        identity = None
    count = len(list(folder.glob("chunk-*.parquet")))
    if not resume and count:
        raise InputError(
            f"{folder}: {count} chunks of an earlier run are there: add --resume to continue, or remove the folder"
        )
    if identity != _identity(header) and count:
        raise InputError(
            f"{folder}: its {count} chunks belong to another sweep (the file, rig, input or a version has changed): "
            "remove the folder, or undo the change"
        )


def _identity(header: Mapping[str, Any]) -> dict[str, str]:
    return {"schema": _SCHEMA, "header": digest(header)}


def _is_leftover(path: Path) -> bool:
    """Whether a killed run may have left the file: before it wrote the identity, or while it wrote a file."""
    return path.name == _LOCK or (path.name.startswith((f".{_IDENTITY}.", ".chunk-")) and path.name.endswith(".part"))
