"""Notes on a recording for its rig: channels that are recorded and not used, and inputs that never change."""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from smajax.channels import channel_of, channel_unit, numbered
from smajax.files.fit_settings import FitSettings
from smajax.files.rig_kinds import rig_phrase
from smajax.plant.effects import catalogue
from smajax.plant.heat import PrescribedTemperature
from smajax.plant.plant import Plant
from smajax.plant.stages import SURROUNDINGS
from smajax.recordings.recording import Recording
from smajax.units import as_text, from_si

_AMBIENT = "environment.ambient"
_PHASES = ("austenite", "martensite")


def with_notes(plant: Plant, fit: FitSettings, kind: str, recording: Recording) -> Recording:
    """Return a recording with notes on channels that are recorded and not used, and on inputs that never change.

    Args:
        plant: The plant.
        fit: Settings of the fit.
        kind: Kind of the rig.
        recording: The recording; notes that it has stay.
    """
    notes = (
        *recording.notes,
        *_constant_inputs(plant, recording),
        *_surroundings(plant, fit, recording),
        *_self_sensing(plant, fit),
        *_unused(plant, fit, kind, recording),
    )
    notes = tuple(dict.fromkeys(notes))  # a recording may be read twice
    return recording if notes == recording.notes else replace(recording, notes=notes)


def _constant_inputs(plant: Plant, recording: Recording) -> list[str]:
    """Sentences on electrical inputs that never change, or on a path on which nothing changes."""
    electrical = numbered(plant.drive.control, plant.mechanism.wires) if plant.drive.control else ()
    names = [name for name in plant.signals if _is_constant(recording, name)]
    if not electrical:
        everything = len(names) == len(plant.signals)
        return [f"{' and '.join(names)} never change{'s' * (len(names) == 1)}"] if names and everything else []
    constant = [name for name in names if name in electrical]
    if len(constant) == len(electrical) and not any(recording.channels[name][0] for name in constant):
        are = "is" if len(constant) == 1 else "are"
        return [f"{' and '.join(constant)} {are} 0 in every row: nothing heats the wire{'s' * (len(constant) > 1)}"]
    return [f"{name} is {_value_text(recording, name)} in every row" for name in constant]


def _is_constant(recording: Recording, name: str) -> bool:
    values = recording.channels.get(name)
    return values is not None and bool(np.all(values == values[0]))


def _value_text(recording: Recording, name: str) -> str:
    """The first value of a channel in the unit of the recording."""
    unit = recording.units.get(name, channel_unit(name))
    value = f"{float(from_si(recording.channels[name][:1], unit, channel_unit(name))[0]):.5g}"
    return value if unit == "1" else f"{value} {unit}"


def _surroundings(plant: Plant, fit: FitSettings, recording: Recording) -> list[str]:
    """Sentences on recorded surroundings that replace a parameter, or need an effect."""
    notes, driving = [], plant.driving_channels(recording.channels)
    if "ambient" in driving and _AMBIENT in fit.names:
        notes.append(
            f"the heat balance follows the recorded ambient temperature in place of {_AMBIENT}, which is free and sets "
            "only the reference of the thermal strain here: take it out of [fit]"
        )
    for name in SURROUNDINGS:
        if name not in recording.channels or name in driving or _is_prescribed(plant):
            continue
        effects = [key for key, effect in catalogue().items() if name in getattr(effect, "surroundings", ())]
        if effects:
            notes.append(f"{name} is recorded and not used: add [effects.{effects[0]}], whose strength can be fitted")
    return notes


def _self_sensing(plant: Plant, fit: FitSettings) -> list[str]:
    """A sentence on an observed resistance, whose sign depends on the order of the resistivities of the phases."""
    if not any(channel_of(channel) == "resistance" for channel in fit.observe):
        return []
    austenite, martensite = (float(getattr(plant.material, f"resistivity_{phase}")) for phase in _PHASES)
    values = f"{as_text(austenite, 'ohm m')} and {as_text(martensite, 'ohm m')}"
    names = "material.resistivity_austenite and material.resistivity_martensite"
    if austenite == martensite:
        return [
            f"{names} are both {as_text(austenite, 'ohm m')}, so that the resistance does not show the transformation"
        ]
    change = "rises" if austenite > martensite else "falls"
    return [
        f"with {names} of {values} the modelled resistance {change} as the wire transforms to austenite: where the "
        "recorded one does the opposite, exchange the two, since a fit from this order may end at a wrong minimum"
    ]


def _unused(plant: Plant, fit: FitSettings, kind: str, recording: Recording) -> list[str]:
    """Sentences on recorded channels that are neither inputs nor fitted."""
    driving = plant.driving_channels(recording.channels)
    others = [c for c in recording.channels if c not in driving and c not in fit.observe]
    outputs = [c for c in others if c in plant.observable]
    foreign = [c for c in others if c not in outputs and (_is_prescribed(plant) or not _needs_effect(c))]
    notes = []
    if foreign:
        notes.append(
            f"recorded and not used, since {rig_phrase(kind)} has no such input or output: {', '.join(foreign)}"
        )
    if outputs:
        notes.append(
            f"recorded and not fitted, since [fit] observe does not name {_them(outputs)}: {', '.join(outputs)}"
        )
    return notes


def _is_prescribed(plant: Plant) -> bool:
    """Whether the temperature is prescribed, so that no effect on the heat balance changes anything."""
    return isinstance(plant.heat, PrescribedTemperature)


def _needs_effect(channel: str) -> bool:
    return any(channel in getattr(effect, "surroundings", ()) for effect in catalogue().values())


def _them(channels: Sequence[str]) -> str:
    return "it" if len(channels) == 1 else "them"
