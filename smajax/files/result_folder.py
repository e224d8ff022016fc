"""Result folders: written under a temporary name, flushed to the disk, and moved into place by one rename.

A run that is killed at any moment leaves the old folder or the new one, never a partial one. A hidden folder
``.NAME.XXXXXXXX.part`` may remain next to it; a later run into the same folder removes it. A folder is replaced only
if smajax wrote it and it holds no other files; ``run.json`` lists the files of a run.
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
from smajax.recordings.paths import FileWriteError, check_output_path, replacing, unreadable

SCHEMA = "smajax.run/1"
_RUN = "run.json"
# Age in s from which a hidden folder counts as left by a killed run: writing one takes seconds. Chosen by trial;
# tested in tests/unit/files/test_result_folder.py.
_STALE_AFTER = 3600.0
# Files that file managers create in a folder.
_SYSTEM_FILES = frozenset({".DS_Store", "Thumbs.db", "desktop.ini"})
# AT_FDCWD and RENAME_EXCHANGE of Linux; RENAME_SWAP of macOS has the value of RENAME_EXCHANGE.
_AT_CWD = -100
_EXCHANGE = 2
# Random bytes in the name of a hidden folder, two characters each.
_TOKEN_BYTES = 4


def check_output_folder(out: Path) -> Path:
    """Return the absolute path of a result folder, checked before any computation.

    Raises:
        InputError: If results cannot be written there, or would replace files that smajax did not write.
    """
    place = check_output_path(out, "--out")
    here = _working_folder()
    if here is not None and (place == here or place in here.parents):
        raise InputError(f"{out}: this is the folder you are in: name a folder for --out that smajax can make")
    if place.exists() and not place.is_dir():
        raise InputError(f"{out}: this is a file: name a folder for --out")
    if place.is_dir() and (stray := _stray(place)):
        cure = "name another folder for --out, since writing there would delete its files"
        raise InputError(f"{out}: {stray}: {cure}")
    parent = next((folder for folder in place.parents if folder.exists()), Path(place.anchor))
    if not parent.is_dir() or not os.access(parent, os.W_OK | os.X_OK):
        raise InputError(f"{out}: nothing can be written in {parent}: name a folder for --out elsewhere")
    return place


def _working_folder() -> Path | None:
    """Return the folder that the process is in; ``None`` where it was deleted: absolute paths do not need it."""
    try:
        return Path.cwd()
    except OSError:
        return None


def write_folder(out: Path, run: Mapping[str, Any], fill: Callable[[Path], None]) -> None:
    """Write a result folder, completely or not at all.

    Args:
        out: The folder.
        run: Content of run.json, to which the list of files is added.
        fill: Function that writes the other files into the folder that is passed to it.

    Raises:
        InputError: If the folder holds files that smajax did not write, or the files cannot be written.
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
    except (OSError, FileWriteError) as error:
        reason = error.reason if isinstance(error, FileWriteError) else error.strerror or error
        raise InputError(f"{out}: the result cannot be written ({reason}): make room, or name another --out") from None
    finally:
        shutil.rmtree(part, ignore_errors=True)


def replace_file(path: Path, text: str) -> None:
    """Replace one file of a finished result folder, completely or not at all.

    Args:
        path: The file.
        text: Its new text.

    Raises:
        InputError: If it cannot be written.
    """
    folder = path.parent
    with replacing(path, folder.with_name(f".{folder.name}.{secrets.token_hex(_TOKEN_BYTES)}.part")) as part:
        part.write_text(text, "utf-8")
        _flush(part)


def read_json(folder: Path, name: str) -> dict[str, Any]:
    """Read a JSON document of a result folder.

    Args:
        folder: The result folder.
        name: Name of the file.

    Raises:
        InputError: If the file is missing, or smajax did not write it.
    """
    path = folder / name
    if not folder.is_dir():
        raise InputError(f"{folder}: there is no such folder: name one that smajax wrote")
    if not path.is_file():
        raise InputError(f"{folder}: this is not a result folder, since it has no {name}: name one that smajax wrote")
    try:
        document = json.loads(path.read_text("utf-8"))
    except OSError as error:
        raise unreadable(path, error) from None
    except ValueError:
        cure = "the file was changed since smajax wrote it, run the command again"
        raise InputError(f"{path}: this is not JSON: {cure}") from None
    if not isinstance(document, dict) or not str(document.get("schema", "")).startswith("smajax."):
        raise InputError(f"{path}: smajax did not write this file: name a result folder of smajax")
    return document


def _stray(folder: Path) -> str:
    """Return why a folder must not be replaced; an empty text if it has no files but those of a run."""
    names = {path.name for path in folder.iterdir()} - _SYSTEM_FILES
    if not names:
        return ""
    try:
        run = read_json(folder, _RUN)
    except InputError:
        return "this folder is not a result of smajax"
    run_files = run.get("files")
    if not str(run["schema"]).startswith("smajax.run/") or not isinstance(run_files, list):
        return "this folder is not a result of smajax"
    others = sorted(names - {str(name) for name in run_files})
    return f"this folder holds '{others[0]}', which smajax did not write" if others else ""


def _put(part: Path, place: Path) -> None:
    """Move the new folder into its place; if the system can exchange two folders, the place is never empty."""
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
    """Swap two folders in one step; return whether the system and the disk support it."""
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
    """Remove the hidden folders of killed runs; a recent one may belong to a run that is still writing."""
    for part in _parts(place):
        with contextlib.suppress(OSError):
            if time.time() - part.stat().st_mtime > _STALE_AFTER:
                shutil.rmtree(part, ignore_errors=True) if part.is_dir() else part.unlink()


def _parts(place: Path) -> Iterator[Path]:
    """Yield the hidden files and folders that runs into this place have written."""
    start, end = f".{place.name}.", ".part"
    length = len(start) + 2 * _TOKEN_BYTES + len(end)
    for path in place.parent.iterdir():
        if path.name.startswith(start) and path.name.endswith(end) and len(path.name) == length:
            yield path


def _flush(path: Path) -> None:
    """Flush a file or the entries of a folder to the disk; Windows cannot flush folders."""
    if sys.platform == "win32" and path.is_dir():
        return
    # Windows flushes only what is open for writing.
    descriptor = os.open(path, os.O_RDONLY if path.is_dir() else os.O_RDWR)
    try:
        os.fsync(descriptor)
    finally:
        os.close(descriptor)
