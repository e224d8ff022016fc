"""Text of rig files: the values of a plant, its channels and its fit as TOML."""

from typing import Any

from smajax import parameters
from smajax.channels import channel_unit
from smajax.files.channel_settings import ChannelSettings
from smajax.files.fit_settings import INPUT_NOISE_NONE, FitSettings
from smajax.files.rig_plant import value_of
from smajax.files.rig_schema import PRESCRIBED_TEMPERATURE
from smajax.files.toml import render_toml
from smajax.parameters import TIES, declarations
from smajax.plant.plant import Plant
from smajax.recordings.read_options import ReadOptions
from smajax.units import as_text


def rig_toml(
    kind: str,
    interpolation: str,
    plant: Plant,
    channels: ChannelSettings,
    fit: FitSettings,
    recording: ReadOptions,
) -> str:
    """Return the text of a rig file with the value of every parameter; reading it gives the same plant.

    Args:
        kind: Kind of the rig.
        interpolation: Interpolation of the inputs between samples, ``hold`` or ``linear``.
        plant: The plant.
        channels: The section ``[channels]``.
        fit: The section ``[fit]``.
        recording: The section ``[recording]``.
    """
    control = plant.drive.control or (None if kind == "path" else PRESCRIBED_TEMPERATURE)
    head = {"kind": kind, "control": control, "interpolation": interpolation}
    data: dict[str, Any] = {"schema": 1, "rig": head}
    for section, part in parameters.sections(plant).items():
        home, _, key = section.partition(".")
        table = _section_table(plant, section, list(declarations(part)))
        data |= {home: data.get(home, {}) | {key: table}} if key else {section: table}
    if plant.cells is not None:
        data["wire"] |= {"cells": plant.cells.count}
    if plant.grains is not None:
        data["material"] |= {"grains": plant.grains.count}
    data["sensor"] = _section_table(plant, "sensor", list(plant.sensor.declarations()))
    data["channels"] = channels.table()
    data["recording"] = recording.table()
    data["fit"] = _fit_table(fit, plant)
    return render_toml({key: value for key, value in data.items() if value != {}})


def _section_table(plant: Plant, section: str, keys: list[str]) -> dict[str, Any]:
    """Return a section as a table of quantities; a tie whose members are equal is written as one key."""
    values = {f"{section}.{key}": value_of(plant, f"{section}.{key}") for key in keys}
    for tie, members in TIES.items():
        if tie.startswith(f"{section}.") and len({values.get(member) for member in members}) == 1:
            values = {tie if n == members[0] else n: value for n, value in values.items() if n not in members[1:]}
    units = {n: d.unit for n, d in parameters.all_declarations(plant).items()}
    return {n.rsplit(".", 1)[1]: as_text(value, units[n]) for n, value in values.items() if value is not None}


def _fit_table(fit: FitSettings, plant: Plant) -> dict[str, Any]:
    units = {n: d.unit for n, d in parameters.all_declarations(plant).items()}
    return {
        "model": fit.model,
        **{key: list(getattr(fit, key)) for key in ("free", "per_recording", "initial") if getattr(fit, key)},
        "observe": list(fit.observe),
        "starts": fit.starts,
        "seed": fit.seed,
        "bounds": {n: [as_text(end, units[n]) for end in span] for n, span in fit.bounds.items()} or None,
        "noise": {c: as_text(value, channel_unit(c, difference=True)) for c, value in fit.noise.items()} or None,
        "input_noise": _input_noise_text(fit.input_noise, plant),
    }


def _input_noise_text(noise: float | None, plant: Plant) -> str | None:
    """The noise of the electrical inputs' meter as it is read; ``None`` where it is estimated."""
    if noise is None:
        return None
    return as_text(noise, channel_unit(plant.drive.control)) if noise else INPUT_NOISE_NONE
