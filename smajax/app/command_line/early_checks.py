"""Checks of a command's files before JAX is loaded, so that a mistake in a path, file or recording is reported at once.

The checks are those that the command makes again when it reads the files, in the same sentences. What needs the plant
itself, or classes of installed packages, is left to the command.
"""

from collections.abc import Iterable, Mapping
from contextlib import nullcontext
from pathlib import Path
from types import MappingProxyType
from typing import TYPE_CHECKING, Any

from smajax.app.loading import exit_on_interrupt

if TYPE_CHECKING:
    from smajax.files.rig_sections import CheckedRig

# Suffix of the table of an earlier sweep, which may be given in place of a TOML file.
_TABLE = ".parquet"
# Bytes of the largest recording that is read for its mistakes first; a command then reads it twice. Chosen so that this
# takes a small share of the time in which JAX is loaded.
_LARGEST_RECORDING = 2**21


def check_files(
    *,
    toml: Mapping[str, Path] | None = None,
    recordings: Iterable[Path | None] = (),
    out: Path | None = None,
    reading: Mapping[str, Any] = MappingProxyType({}),
    observed: bool = True,
) -> None:
    """Check that files can be read and a folder can be written, without JAX.

    Args:
        toml: TOML files by their kind: "rig", "controller" or "sweep"; "file" for one of any kind.
        recordings: Recordings of the rig; ``None`` for one that was not given.
        out: Folder of the results.
        reading: Options of ``ReadOptions`` by name, in place of those of the rig.
        observed: Whether the recordings must have the channels that are fitted.

    Raises:
        InputError: If a file is missing or invalid, or the folder cannot be written.
    """
    exit_on_interrupt()
    from smajax.files.result_folder import check_output_folder
    from smajax.files.toml import parse_toml, read_text
    from smajax.recordings.readers import check_file

    if out is not None:
        check_output_folder(out)
    texts: dict[str, str] = {}
    for kind, path in (toml or {}).items():
        if path.suffix.lower() != _TABLE:
            texts[kind] = read_text(path, "rig" if kind == "file" else kind)
            parse_toml(texts[kind], str(path))
    paths = [path for path in recordings if path is not None]
    for path in paths:
        check_file(path)
    _check_contents({kind: (text, (toml or {})[kind]) for kind, text in texts.items()}, paths, reading, observed)


def _check_contents(
    toml: Mapping[str, tuple[str, Path]], recordings: Iterable[Path], reading: Mapping[str, Any], observed: bool
) -> None:
    """Check the contents of TOML files, each a text and its path, and of recordings of the rig among them."""
    from smajax.files.rig_classes import has_installed_classes, has_registered_classes, without_classes

    if not toml or has_installed_classes():
        return
    with nullcontext() if has_registered_classes() else without_classes():
        rig = None
        for kind, (text, path) in toml.items():
            rig = _check_content(kind, text, path) or rig
        for path in recordings:
            if rig is not None and path.stat().st_size <= _LARGEST_RECORDING:
                rig.read(path, observed=observed, changes=reading)


def _check_content(kind: str, text: str, path: Path) -> "CheckedRig | None":
    """Check the content of a TOML file; that of a rig is returned."""
    if kind == "file":
        from smajax.files.file_kinds import kind_of_file

        kind = kind_of_file(text, str(path))
    if kind == "controller":
        from smajax.control.controller_file.sections import check_controller_sections

        check_controller_sections(text, str(path))
    elif kind == "sweep":
        from smajax.sweeps.section_checks import check_sweep_sections

        check_sweep_sections(text, path)
    elif kind == "actuator":
        from smajax.files.actuator_file import check_actuator_values

        check_actuator_values(text, str(path))
    else:
        from smajax.files.rig_sections import check_rig_sections

        return check_rig_sections(text, str(path), path.parent)
    return None
