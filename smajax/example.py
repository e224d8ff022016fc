"""``smajax init``: files of a kind of rig to start from."""

import os
import re
import tomllib
from collections.abc import Mapping
from pathlib import Path

from smajax.datasets import shipped
from smajax.errors import InputError

# What the recording decides and the template cannot know.
_OF_RECORDING = ("control", "interpolation")


def write_example(kind: str, out: Path) -> tuple[Path, Path, Path, list[Path]]:
    """Write rig.toml, commented, for one's own wire, and a recording example.csv with the rig example.toml that it was made on.

    Where such a rig can be steered, also controller.toml, for ``smajax tune``, and where there is one, sweep.toml, for ``smajax sweep``.
    Returns the paths, the last two in a list.
    Raises InputError, and writes nothing, if one of them is there already.
    """
    example = _example_of(kind)
    template = shipped("templates", f"{kind}.toml").read_text("utf-8")
    recorded = tomllib.loads((example / "rig.toml").read_text("utf-8"))["rig"]
    for key in _OF_RECORDING:
        if key in recorded:
            template = re.sub(rf'^{key} = "[^"]*"', f'{key} = "{recorded[key]}"', template, count=1, flags=re.MULTILINE)
    files = {
        out / "rig.toml": template.encode(),
        out / "example.toml": (example / "rig.toml").read_bytes(),
        out / "example.csv": (example / "train.csv").read_bytes(),
    }
    controller = shipped("controllers") / f"{example.name}.toml"
    if controller.is_file():
        files[out / "controller.toml"] = controller.read_bytes()
    sweep = shipped("sweeps") / f"{example.name}.toml"
    if sweep.is_file():
        files[out / "sweep.toml"] = sweep.read_text("utf-8").replace(f"../recordings/{example.name}/rig.toml", "example.toml").encode()
    _write(files, out)
    rig, example_rig, recording, *rest = files
    return rig, example_rig, recording, rest


def is_machine(kind: str) -> bool:
    """Whether a kind is a machine's, which has figures of its own and no recordings."""
    return shipped("machines", kind, "rig.toml").is_file()


def write_machine(kind: str, out: Path) -> tuple[Path, Path]:
    """Write a machine's rig.toml, commented, and a sweep.toml of it. Returns the paths. InputError as ``write_example``."""
    sweep = shipped("sweeps", f"{kind}.toml").read_text("utf-8").replace(f"../machines/{kind}/", "")
    rig = shipped("machines", kind, "rig.toml").read_bytes()
    _write({out / "rig.toml": rig, out / "sweep.toml": sweep.encode()}, out)
    return out / "rig.toml", out / "sweep.toml"


def _write(files: Mapping[Path, bytes], out: Path) -> None:
    for path in files:
        if path.exists():
            raise InputError(f"{path}: this file is there already and is not overwritten: name another folder with --out")
    try:
        out.mkdir(parents=True, exist_ok=True)
        for path, content in files.items():
            with path.open("xb") as file:
                file.write(content)
                file.flush()
                os.fsync(file.fileno())
    except OSError as error:
        raise InputError(f"{out}: the files cannot be written ({error.strerror or error}): name another folder with --out") from None


def _example_of(kind: str) -> Path:
    for path in sorted(shipped("recordings").glob("*/rig.toml")):
        if tomllib.loads(path.read_text("utf-8"))["rig"]["kind"] == kind:
            return path.parent
    raise InputError(f"there is no example recording of a {kind} rig")
