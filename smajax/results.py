"""A run's folder: written beside its place, flushed to the disk, and put there by one rename.

A run that is killed at any moment leaves the old folder or the new one, never half of one. What may be left beside it is a hidden folder
``.NAME.XXXXXXXX.part``, which a later run into the same place removes. A folder is replaced only if smajax wrote it and nobody has put
anything else into it; ``run.json`` lists what a run wrote.
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
_STALE = 3600.0
_LITTER = frozenset({".DS_Store", "Thumbs.db", "desktop.ini"})
_AT_CWD = -100
_EXCHANGE = 2


def check_out(out: Path) -> Path:
    """The folder's absolute path, if a result may be written there. InputError with the cure if not; asked before any work is done."""
    place = Path(os.path.abspath(out)).resolve()
    if place == Path.cwd() or place in Path.cwd().parents:
        raise InputError(f"{out}: this is the folder you are in: name a folder for --out that smajax can make")
    if place.exists() and not place.is_dir():
        raise InputError(f"{out}: this is a file: name a folder for --out")
    if place.is_dir() and (stray := _stray(place)):
        raise InputError(f"{out}: {stray}: name another folder for --out, since writing there would delete what it holds")
    above = next((folder for folder in place.parents if folder.exists()), Path(place.anchor))
    if not above.is_dir() or not os.access(above, os.W_OK | os.X_OK):
        raise InputError(f"{out}: nothing can be written in {above}: name a folder for --out elsewhere")
    return place


def write_folder(out: Path, run: Mapping[str, Any], fill: Callable[[Path], None]) -> None:
    """Write a result folder: ``fill`` writes its files into the folder that it is given, ``run`` becomes run.json.

    Raises InputError if the place is taken by something else, or the disk does not take the files.
    """
    place = check_out(out)
    part = place.with_name(f".{place.name}.{secrets.token_hex(4)}.part")
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
        _put(part, check_out(out))
        _flush(place.parent)
    except OSError as error:
        raise InputError(f"{out}: the result cannot be written ({error.strerror or error}): make room, or name another --out") from None
    finally:
        shutil.rmtree(part, ignore_errors=True)


def replace_file(path: Path, text: str) -> None:
    """Write one file of a finished folder anew, completely or not at all."""
    part = path.parent.with_name(f".{path.parent.name}.{secrets.token_hex(4)}.part")
    try:
        part.write_text(text, "utf-8")
        _flush(part)
        os.replace(part, path)
    except OSError as error:
        raise InputError(f"{path}: the file cannot be written ({error.strerror or error}): check the folder") from None
    finally:
        part.unlink(missing_ok=True)


def read_json(folder: Path, name: str) -> dict[str, Any]:
    """A JSON file of a result folder. InputError if it is not there or not whole."""
    path = folder / name
    if not folder.is_dir():
        raise InputError(f"{folder}: there is no such folder: name one that smajax wrote")
    if not path.is_file():
        raise InputError(f"{folder}: this is no result folder, as it has no {name}: name one that smajax wrote")
    try:
        document = json.loads(path.read_text("utf-8"))
    except OSError as error:
        raise InputError(f"{path}: the file cannot be read ({error.strerror or error}): check its permissions") from None
    except ValueError:
        raise InputError(f"{path}: this is not JSON: the file was changed since smajax wrote it, run the command again") from None
    if not isinstance(document, dict) or not str(document.get("schema", "")).startswith("smajax."):
        raise InputError(f"{path}: this file is not one that smajax wrote: name a result folder of smajax")
    return document


def _stray(folder: Path) -> str:
    """Why a folder must not be replaced; empty if it may be: it is empty, or holds what a run wrote and nothing else."""
    there = {path.name for path in folder.iterdir()} - _LITTER
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
    """Put the new folder in its place. Where the system can exchange two folders at once, the place is never without one."""
    if not place.exists():
        os.rename(part, place)
    elif not _exchange(part, place):
        aside = place.with_name(f".{place.name}.{secrets.token_hex(4)}.part")
        os.rename(place, aside)
        try:
            os.rename(part, place)
        except OSError:
            os.rename(aside, place)
            raise
        shutil.rmtree(aside, ignore_errors=True)


def _exchange(one: Path, other: Path) -> bool:
    """Swap two folders in one step; says whether this system and this disk can."""
    if sys.platform == "win32":
        return False
    names = os.fsencode(one), os.fsencode(other)
    library = ctypes.CDLL(None, use_errno=True)
    if sys.platform == "darwin" and hasattr(library, "renamex_np"):
        return library.renamex_np(*names, ctypes.c_uint(_EXCHANGE)) == 0
    if hasattr(library, "renameat2"):
        return library.renameat2(_AT_CWD, names[0], _AT_CWD, names[1], ctypes.c_uint(_EXCHANGE)) == 0
    return False


def _remove_stale(place: Path) -> None:
    """Remove what killed runs left beside this place; the young ones may belong to a run that is still going."""
    for part in _parts(place):
        with contextlib.suppress(OSError):
            if time.time() - part.stat().st_mtime > _STALE:
                shutil.rmtree(part, ignore_errors=True) if part.is_dir() else part.unlink()


def _parts(place: Path) -> Iterator[Path]:
    start, end = f".{place.name}.", ".part"
    for path in place.parent.iterdir():
        if path.name.startswith(start) and path.name.endswith(end) and len(path.name) == len(start) + 8 + len(end):
            yield path


def _flush(path: Path) -> None:
    """Have the disk take a file or a folder's entries now; not every system can do so for folders."""
    if sys.platform == "win32" and path.is_dir():
        return
    descriptor = os.open(path, os.O_RDONLY)
    try:
        os.fsync(descriptor)
    finally:
        os.close(descriptor)
