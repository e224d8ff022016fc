"""Files of ``smajax init``: a rig file to fill in, and an example."""

import os
import tomllib
from collections.abc import Mapping
from pathlib import Path
from typing import Any, NamedTuple

import tomlkit
from tomlkit.items import Table

from smajax.errors import InputError
from smajax.files.latent_heat_note import template_note
from smajax.recordings.datasets import data_path
from smajax.recordings.paths import check_output_path

# Keys of [rig] that depend on the recording; the template gets those of the example.
_OF_RECORDING = ("control", "interpolation")


# The recordings of an example: fitted, for the choice of effects, and predicted once.
RECORDINGS = ("train.csv", "select.csv", "holdout.csv")


class Example(NamedTuple):
    """Files of ``smajax init``.

    Attributes:
        rig: The commented rig file, to fill in.
        example: The rig of the recordings.
        recordings: The recordings for training, selection and holdout.
        others: A controller and a sweep, where the kind has them.
        note: A note on the rig file; empty if there is none.
    """

    rig: Path
    example: Path
    recordings: tuple[Path, Path, Path]
    others: list[Path]
    note: str


def write_example(kind: str, out: Path) -> Example:
    """Write a commented rig file, and an example: a rig with three recordings of different inputs.

    The files are rig.toml to fill in, the recordings train.csv, select.csv and holdout.csv, and their rig example.toml;
    for some kinds also controller.toml for ``smajax tune`` and sweep.toml for ``smajax sweep``.

    Args:
        kind: Kind of the rig.
        out: Folder of the files; created if necessary.

    Returns:
        The paths of the files, and a note.

    Raises:
        InputError: If one of the files exists (then none is written), or they cannot be written.
    """
    example = _example_of(kind)
    template = tomlkit.parse(data_path("templates", f"{kind}.toml").read_text("utf-8"))
    head, example_head = template["rig"], tomllib.loads((example / "rig.toml").read_text("utf-8"))["rig"]
    for key in _OF_RECORDING:
        if key in example_head and key in head:
            set_value(head, key, example_head[key])
    files = {
        out / "rig.toml": tomlkit.dumps(template).encode(),
        out / "example.toml": (example / "rig.toml").read_bytes(),
        **{out / name: (example / name).read_bytes() for name in RECORDINGS},
    }
    controller = data_path("controllers") / f"{example.name}.toml"
    if controller.is_file():
        files[out / "controller.toml"] = controller.read_bytes()
    sweep = data_path("sweeps") / f"{example.name}.toml"
    if sweep.is_file():
        text = sweep.read_text("utf-8").replace(f"../recordings/{example.name}/rig.toml", "example.toml")
        files[out / "sweep.toml"] = text.encode()
    _write(files, out)
    rig, example_rig, train, select, holdout, *others = files
    return Example(rig, example_rig, (train, select, holdout), others, template_note(template))


def is_actuator_kind(kind: str) -> bool:
    """Return whether a kind is that of an actuator, which has metrics and no recordings."""
    return data_path("actuators", kind, "rig.toml").is_file()


def write_actuator_example(kind: str, out: Path) -> tuple[Path, Path]:
    """Write the commented rig.toml of an actuator, and a sweep.toml.

    Args:
        kind: Kind of the actuator.
        out: Folder of the files; created if necessary.

    Returns:
        The paths of rig.toml and sweep.toml.

    Raises:
        InputError: If one of the files exists (then none is written), or they cannot be written.
    """
    sweep = data_path("sweeps", f"{kind}.toml").read_text("utf-8").replace(f"../actuators/{kind}/", "")
    rig = data_path("actuators", kind, "rig.toml").read_bytes()
    _write({out / "rig.toml": rig, out / "sweep.toml": sweep.encode()}, out)
    return out / "rig.toml", out / "sweep.toml"


def set_value(table: Table, key: str, value: Any) -> None:
    """Set a value whose comment keeps its column.

    Args:
        table: The section.
        key: The key, which the section has.
        value: The new value.
    """
    old: Any = table.item(key)
    gap = len(old.trivia.comment_ws) + len(old.as_string())
    table[key] = value
    new: Any = table.item(key)
    new.trivia.comment_ws = " " * max(gap - len(new.as_string()), 1) if new.trivia.comment else ""


def _write(files: Mapping[Path, bytes], out: Path) -> None:
    """Write files, unless one of them exists."""
    for path in files:
        check_output_path(path, "--out")
        if path.exists():
            cure = "name another folder with --out"
            raise InputError(f"{path}: this file exists and is not overwritten: {cure}")
    try:
        out.mkdir(parents=True, exist_ok=True)
        for path, content in files.items():
            with path.open("xb") as file:
                file.write(content)
                file.flush()
                os.fsync(file.fileno())
    except OSError as error:
        reason = error.strerror or error
        raise InputError(f"{out}: the files cannot be written ({reason}): name another folder with --out") from None


def _example_of(kind: str) -> Path:
    for path in sorted(data_path("recordings").glob("*/rig.toml")):
        if tomllib.loads(path.read_text("utf-8"))["rig"]["kind"] == kind:
            return path.parent
    raise InputError(f"there is no example recording of a {kind} rig")
