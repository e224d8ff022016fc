"""Checks of a sweep file that need no plant and no actuator; a command makes them before JAX is loaded."""

from collections.abc import Mapping
from pathlib import Path
from typing import Any

from smajax.errors import InputError
from smajax.files.actuator_file import check_actuator_values, is_actuator
from smajax.files.rig_sections import check_rig_sections
from smajax.files.toml import parse_toml, read_text, validate
from smajax.parameters.definitions import Declaration
from smajax.sweeps.axis_sections import read_axes, read_catalogues
from smajax.sweeps.schema import Limit, MarginSection, RefineSection, input_declarations, read_head, read_input


def check_sweep_sections(text: str, path: Path) -> None:
    """Check the text of a sweep file, the file of its rig, and its recording.

    Args:
        text: The text.
        path: The file; relative paths in it start from its folder.

    Raises:
        InputError: As ``smajax.sweeps.sweep_file.read_sweep``.
    """
    data = parse_toml(text, str(path))
    try:
        head = read_head(data)
        declarations = _subject_declarations(path.parent / head.rig, data, path.parent)
        catalogues = read_catalogues(data, path.parent)
        if "margins" in data:
            validate(MarginSection, data["margins"], "margins")
        if declarations is None:
            return
        read_axes(data, declarations, head.sampling, catalogues)
        constraints = data.get("constraints", {})
        for name, limit in constraints.items() if isinstance(constraints, dict) else ():
            validate(Limit, limit, f"constraints.{name}")
        if "refine" in data:
            validate(RefineSection, data["refine"], "refine")
    except InputError as error:
        raise InputError(f"{path}: {error}") from None


def _subject_declarations(path: Path, data: Mapping[str, Any], folder: Path) -> dict[str, Declaration] | None:
    """Return the parameters that can vary; ``None`` where the plant or the whole input is needed to know them."""
    text = read_text(path, "rig")
    if is_actuator(text):
        declarations = check_actuator_values(text, str(path))
        return None if "input" in data else declarations
    rig = check_rig_sections(text, str(path), path.parent)
    settings = read_input(data)
    if settings.recording is not None:
        rig.read(folder / settings.recording, observed=False, changes={})
        return dict(rig.parameters) if rig.clock else None
    has_wave = None not in (settings.shape, settings.amplitude, settings.frequency)
    if not has_wave or not rig.control or rig.prescribed:
        return None
    return {**rig.parameters, **input_declarations(rig.control, settings.shape == "square")}
