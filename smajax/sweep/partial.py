"""The folder in which a sweep's chunks lie until it has ended: what it belongs to, and that one run alone works on it."""

import contextlib
import hashlib
import json
import os
import shutil
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any

from smajax.errors import InputError
from smajax.toml_file import write_text

try:
    import fcntl
except ImportError:  # where there are no such locks, two runs are not told from each other
    fcntl = None

_SCHEMA, _OWN, _LOCK = "smajax.sweep-partial/1", "sweep.json", "lock"


def digest(header: Mapping[str, Any]) -> str:
    """What tells a sweep from every other one."""
    return hashlib.sha256(json.dumps(header, sort_keys=True).encode()).hexdigest()


def _beside(out: Path) -> Path:
    return out.with_name(out.name + ".partial")


def begun(out: Path) -> bool:
    """Whether a run into ``out`` has begun and not ended."""
    return _beside(out).exists()


@contextlib.contextmanager
def partial_folder(out: Path, header: Mapping[str, Any], *, resume: bool) -> Iterator[Path]:
    """The folder of chunks beside ``out``, made if it is not there, and this run's own within.

    InputError if there is one that may not be gone on with, or if another run is at work on it. What fails before its first chunk leaves
    none.
    """
    folder = _beside(out)
    if folder.exists() and not (folder.is_dir() and ((folder / _OWN).is_file() or all(map(_unfinished, folder.iterdir())))):
        raise InputError(f"{folder}: smajax keeps its chunks there and did not make it: remove it, or name another --out")
    try:
        folder.mkdir(parents=True, exist_ok=True)
        lock = os.open(folder / _LOCK, os.O_CREAT | os.O_RDWR)
    except OSError as error:
        raise InputError(f"{folder}: the folder cannot be made ({error.strerror or error}): name another --out") from None
    try:
        _lock(lock, folder)
        _check(folder, header, resume=resume)
        try:
            write_text(folder / _OWN, json.dumps(_of(header)) + "\n")
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
        raise InputError(f"{folder}: another run is at work on it: wait until that has ended, or name another --out") from None
    except OSError:  # a disk without locks
        pass


def _check(folder: Path, header: Mapping[str, Any], *, resume: bool) -> None:
    try:
        held = json.loads((folder / _OWN).read_text("utf-8"))
    except (OSError, ValueError):
        held = None
    count = len(list(folder.glob("chunk-*.parquet")))
    if not resume and count:
        raise InputError(f"{folder}: {count} chunks of an earlier run are there: add --resume to go on, or remove the folder")
    if held != _of(header) and count:
        raise InputError(
            f"{folder}: its {count} chunks are of another sweep (file, rig, input or a version changed): remove it, or undo that"
        )


def _of(header: Mapping[str, Any]) -> dict[str, str]:
    return {"schema": _SCHEMA, "header": digest(header)}


def _unfinished(path: Path) -> bool:
    """Whether a killed run may have left it before it had said what the folder belongs to, or half written."""
    return path.name == _LOCK or (path.name.startswith((f".{_OWN}.", ".chunk-")) and path.name.endswith(".part"))
