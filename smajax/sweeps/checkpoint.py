"""The folder ``NAME.partial`` with the finished chunks of a sweep until it ends; one run at a time works on it."""

import contextlib
import hashlib
import json
import os
import shutil
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any

from smajax.errors import InputError
from smajax.files.toml import write_text

try:
    import fcntl
except ImportError:  # on systems without such locks two runs into one folder are not detected
    fcntl = None

_SCHEMA = "smajax.sweep-partial/1"
# The file that says which sweep a folder belongs to, and the file that a run locks.
_IDENTITY = "sweep.json"
_LOCK = "lock"


def digest(header: Mapping[str, Any]) -> str:
    """Return the SHA-256 digest that identifies a sweep by its header."""
    return hashlib.sha256(json.dumps(header, sort_keys=True).encode()).hexdigest()


def _folder_of(out: Path) -> Path:
    return out.with_name(out.name + ".partial")


def has_checkpoint(out: Path) -> bool:
    """Return whether a run into ``out`` has begun and not ended."""
    return _folder_of(out).exists()


@contextlib.contextmanager
def checkpoint_folder(out: Path, header: Mapping[str, Any], *, resume: bool) -> Iterator[Path]:
    """Open the folder of chunks next to a result folder, locked for this run; it is made if it is not there.

    A run that fails before its first chunk leaves no folder.

    Args:
        out: Result folder of the sweep.
        header: ``SweepFile.header`` of the sweep.
        resume: Whether chunks of an earlier run may be there.

    Raises:
        InputError: if the folder is not a checkpoint, belongs to another sweep, holds chunks without ``resume``, cannot
            be made, or is in use by another run.
    """
    folder = _folder_of(out)
    if folder.exists() and not (
        folder.is_dir() and ((folder / _IDENTITY).is_file() or all(map(_is_leftover, folder.iterdir())))
    ):
        raise InputError(
            f"{folder}: smajax keeps its chunks there and did not make it: remove it, or name another --out"
        )
    try:
        folder.mkdir(parents=True, exist_ok=True)
        lock = os.open(folder / _LOCK, os.O_CREAT | os.O_RDWR)
    except OSError as error:
        raise InputError(
            f"{folder}: the folder cannot be made ({error.strerror or error}): name another --out"
        ) from None
    try:
        _lock(lock, folder)
        _check(folder, header, resume=resume)
        try:
            write_text(folder / _IDENTITY, json.dumps(_identity(header)) + "\n")
            yield folder
        except Exception:
            if not any(folder.glob("chunk-*.parquet")):
                shutil.rmtree(folder, ignore_errors=True)
            raise
    finally:
        os.close(lock)


def _lock(lock: int, folder: Path) -> None:
    if fcntl is None:
        return
    try:
        fcntl.flock(lock, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except BlockingIOError:
        raise InputError(
            f"{folder}: another run is at work on it: wait until that has ended, or name another --out"
        ) from None
    except OSError:  # a file system without locks
        pass


def _check(folder: Path, header: Mapping[str, Any], *, resume: bool) -> None:
    try:
        identity = json.loads((folder / _IDENTITY).read_text("utf-8"))
    except (OSError, ValueError):
        identity = None
    count = len(list(folder.glob("chunk-*.parquet")))
    if not resume and count:
        raise InputError(
            f"{folder}: {count} chunks of an earlier run are there: add --resume to go on, or remove the folder"
        )
    if identity != _identity(header) and count:
        raise InputError(
            f"{folder}: its {count} chunks are of another sweep (file, rig, input or a version changed): remove it, "
            "or undo that"
        )


def _identity(header: Mapping[str, Any]) -> dict[str, str]:
    return {"schema": _SCHEMA, "header": digest(header)}


def _is_leftover(path: Path) -> bool:
    """Whether a killed run may have left the file before it wrote the folder's identity, or half written."""
    return path.name == _LOCK or (path.name.startswith((f".{_IDENTITY}.", ".chunk-")) and path.name.endswith(".part"))
