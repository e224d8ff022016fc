"""The folder of a run's results: written next to its place, flushed to the disk, and put there by one rename.

A run that is killed at any moment leaves the old folder or the new one, never half of one. A hidden folder
``.NAME.XXXXXXXX.part`` may remain next to it, which a later run into the same place removes. A folder is replaced only
if smajax wrote it and nothing else was put into it; ``run.json`` lists what a run wrote.
"""

import contextlib
import ctypes
import json
import os
import secrets
import shutil
import sys
import time
from collections.abc import Callable, Iterator, Mapping
from pathlib import Path
from typing import Any

from smajax.errors import InputError

SCHEMA = "smajax.run/1"
_RUN = "run.json"
# Age in s from which a hidden folder is that of a killed run: writing one takes seconds. Chosen by trial;
# tests/unit/files/test_result_folder.py holds it.
_STALE_AFTER = 3600.0
# Files that file managers put into a folder.
_SYSTEM_FILES = frozenset({".DS_Store", "Thumbs.db", "desktop.ini"})
# AT_FDCWD and RENAME_EXCHANGE of Linux, and RENAME_SWAP of macOS, which has the same value.
_AT_CWD = -100
_EXCHANGE = 2
# Random bytes in the name of a hidden folder, which has two characters for each.
_TOKEN_BYTES = 4


def check_output_folder(out: Path) -> Path:
    """Return the absolute path of a folder for results; call it before any work is done.

    Raises:
        InputError: with the cure, if a result must not be written there.
    """
    place = Path(os.path.abspath(out)).resolve()
    if place == Path.cwd() or place in Path.cwd().parents:
        raise InputError(f"{out}: this is the folder you are in: name a folder for --out that smajax can make")
    if place.exists() and not place.is_dir():
        raise InputError(f"{out}: this is a file: name a folder for --out")
    if place.is_dir() and (stray := _stray(place)):
        cure = "name another folder for --out, since writing there would delete what it holds"
        raise InputError(f"{out}: {stray}: {cure}")
    above = next((folder for folder in place.parents if folder.exists()), Path(place.anchor))
    if not above.is_dir() or not os.access(above, os.W_OK | os.X_OK):
        raise InputError(f"{out}: nothing can be written in {above}: name a folder for --out elsewhere")
    return place


def write_folder(out: Path, run: Mapping[str, Any], fill: Callable[[Path], None]) -> None:
    """Write a result folder, completely or not at all.

    Args:
        out: The folder.
        run: Content of run.json, which gets the list of files.
        fill: Writes the files into the folder that it is called with.

    Raises:
        InputError: if the place is taken by something else, or the disk does not take the files.
    """
    place = check_output_folder(out)
    part = place.with_name(f".{place.name}.{secrets.token_hex(_TOKEN_BYTES)}.part")
    try:
        place.parent.mkdir(parents=True, exist_ok=True)
        _remove_stale(place)
        part.mkdir()
        fill(part)
        files = sorted([*(path.name for path in part.iterdir()), _RUN])
        text = json.dumps({"schema": SCHEMA, **run, "files": files}, indent=2, ensure_ascii=False, allow_nan=False)
        (part / _RUN).write_text(text + "\n", "utf-8")
        for path in [*part.iterdir(), part]:
            _flush(path)
        _put(part, check_output_folder(out))
        _flush(place.parent)
    except OSError as error:
        reason = error.strerror or error
        raise InputError(f"{out}: the result cannot be written ({reason}): make room, or name another --out") from None
    finally:
        shutil.rmtree(part, ignore_errors=True)


def replace_file(path: Path, text: str) -> None:
    """Replace one file of a finished folder, completely or not at all."""
    part = path.parent.with_name(f".{path.parent.name}.{secrets.token_hex(_TOKEN_BYTES)}.part")
    try:
        part.write_text(text, "utf-8")
        _flush(part)
        os.replace(part, path)
    except OSError as error:
        raise InputError(f"{path}: the file cannot be written ({error.strerror or error}): check the folder") from None
    finally:
        part.unlink(missing_ok=True)


def read_json(folder: Path, name: str) -> dict[str, Any]:
    """Return a JSON document of a result folder.

    Raises:
        InputError: if it is not there or not complete.
    """
    path = folder / name
    if not folder.is_dir():
        raise InputError(f"{folder}: there is no such folder: name one that smajax wrote")
    if not path.is_file():
        raise InputError(f"{folder}: this is no result folder, as it has no {name}: name one that smajax wrote")
    try:
        document = json.loads(path.read_text("utf-8"))
    except OSError as error:
        reason = error.strerror or error
        raise InputError(f"{path}: the file cannot be read ({reason}): check its permissions") from None
    except ValueError:
        changed = "the file was changed since smajax wrote it, run the command again"
        raise InputError(f"{path}: this is not JSON: {changed}") from None
    if not isinstance(document, dict) or not str(document.get("schema", "")).startswith("smajax."):
        raise InputError(f"{path}: this file is not one that smajax wrote: name a result folder of smajax")
    return document


def _stray(folder: Path) -> str:
    """Return why a folder must not be replaced; empty if it is empty, or holds what a run wrote and nothing else."""
    there = {path.name for path in folder.iterdir()} - _SYSTEM_FILES
    if not there:
        return ""
    try:
        run = read_json(folder, _RUN)
    except InputError:
        return "this folder is not a result of smajax"
    listed = run.get("files")
    if not str(run["schema"]).startswith("smajax.run/") or not isinstance(listed, list):
        return "this folder is not a result of smajax"
    added = sorted(there - {str(name) for name in listed})
    return f"this folder holds '{added[0]}', which smajax did not write" if added else ""


def _put(part: Path, place: Path) -> None:
    """Put the new folder in its place; where the system can exchange two folders at once, there is always one."""
    if not place.exists():
        os.rename(part, place)
    elif not _exchange(part, place):
        aside = place.with_name(f".{place.name}.{secrets.token_hex(_TOKEN_BYTES)}.part")
        os.rename(place, aside)
        try:
            os.rename(part, place)
        except OSError:
            os.rename(aside, place)
            raise
        shutil.rmtree(aside, ignore_errors=True)


def _exchange(first: Path, second: Path) -> bool:
    """Swap two folders in one step; return whether this system and this disk can."""
    if sys.platform == "win32":
        return False
    names = os.fsencode(first), os.fsencode(second)
    library = ctypes.CDLL(None, use_errno=True)
    if sys.platform == "darwin" and hasattr(library, "renamex_np"):
        return library.renamex_np(*names, ctypes.c_uint(_EXCHANGE)) == 0
    if hasattr(library, "renameat2"):
        return library.renameat2(_AT_CWD, names[0], _AT_CWD, names[1], ctypes.c_uint(_EXCHANGE)) == 0
    return False


def _remove_stale(place: Path) -> None:
    """Remove what killed runs left next to this place; recent ones may belong to a run that is still writing."""
    for part in _parts(place):
        with contextlib.suppress(OSError):
            if time.time() - part.stat().st_mtime > _STALE_AFTER:
                shutil.rmtree(part, ignore_errors=True) if part.is_dir() else part.unlink()


def _parts(place: Path) -> Iterator[Path]:
    start, end = f".{place.name}.", ".part"
    length = len(start) + 2 * _TOKEN_BYTES + len(end)
    for path in place.parent.iterdir():
        if path.name.startswith(start) and path.name.endswith(end) and len(path.name) == length:
            yield path


def _flush(path: Path) -> None:
    """Flush a file or a folder's entries to the disk; Windows cannot do so for folders."""
    if sys.platform == "win32" and path.is_dir():
        return
    descriptor = os.open(path, os.O_RDONLY)
    try:
        os.fsync(descriptor)
    finally:
        os.close(descriptor)
