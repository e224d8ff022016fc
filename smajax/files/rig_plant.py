"""Plant of a rig: stages with their values, effects and sensors."""

import math
from collections.abc import Collection, Iterable, Mapping
from typing import Any

from smajax import parameters
from smajax.files.rig_classes import rig_classes
from smajax.files.rig_kinds import Stages
from smajax.parameters import as_float, declarations
from smajax.plant.effects.base import AbstractEffect
from smajax.plant.mechanisms.base import OWN_SECTION
from smajax.plant.mechanisms.rotary import MasslessRotary, Rotary
from smajax.plant.plant import Plant
from smajax.plant.sensor import Sensor


def build_plant(stages: Stages, values: Mapping[str, float], free: Collection[str]) -> Plant:
    """Build the plant with a sensor that has no channels yet.

    A pulley with two wires is massless if it has neither inertia nor damping and none of the two is fitted. A sheath
    with neither friction nor heat conduction is omitted if none of its parameters is fitted.

    Args:
        stages: Classes of the stages.
        values: Values by leaf, in internal units.
        free: Names of the parameters that are fitted.
    """

    def build(section: str, part: type[Any], **fields: Any) -> Any:
        keys = [key for key in declarations(part) if f"{section}.{key}" in values]
        return part(**{key: as_float(values[f"{section}.{key}"]) for key in keys}, **fields)

    mechanism = stages.mechanism
    if mechanism is Rotary and not any(values.get(n) or n in free for n in ("pulley.inertia", "pulley.damping")):
        mechanism = MasslessRotary
    sections = stages.mechanism.rig_sections()
    mechanism_parts = {section: build(section, part) for section, part in sections.items() if section != OWN_SECTION}
    if "sheath" in mechanism_parts:
        has_effect = values.get("sheath.friction") or values.get("sheath.conductance_ratio")
        if not has_effect and not any(n.startswith("sheath.") for n in free):
            mechanism_parts["sheath"] = None
    stage_classes = {"drive": stages.drive, "heat": stages.heat, **stages.parts}
    counts = {section: {"count": count} for section, count in stages.structure._asdict().items()}
    parts = {
        section: build(section, part, **counts.get(section, {}))
        for section, part in stage_classes.items()
        if section not in sections
    }
    return Plant(mechanism=build(OWN_SECTION, mechanism, **mechanism_parts), sensor=Sensor.identity(()), **parts)


def build_effects(
    values: Mapping[str, Mapping[str, float]], capabilities: frozenset[str]
) -> tuple[tuple[AbstractEffect, ...], dict[str, str]]:
    """Build effects.

    Args:
        values: Values by key of the effect and name of the parameter.
        capabilities: Capabilities of the plant, its observed channels and the surroundings that a recording may have,
            as ``Plant.capabilities`` returns them.

    Returns:
        The effects, and the reasons, by key, why others do not apply to this rig.
    """
    effects, misplaced = [], {}
    for key, numbers in values.items():
        effect = rig_classes().effects[key]
        if reason := effect.unavailable_reason(capabilities):
            misplaced[key] = reason
            continue
        effects.append(effect(**{n: as_float(v) for n, v in numbers.items()}))
    return tuple(effects), misplaced


def build_sensor(channels: Iterable[str], plant: Plant, values: Mapping[str, float]) -> Sensor:
    """Build the sensor.

    Args:
        channels: Channels; those that the plant does not have are ignored.
        plant: The plant.
        values: Gains and offsets by parameter name, ``sensor.CHANNEL_gain`` (1 by default) and
            ``sensor.CHANNEL_offset`` (0 by default).
    """
    observable = [channel for channel in dict.fromkeys(channels) if channel in plant.observable]
    gain = {channel: as_float(float(values.get(f"sensor.{channel}_gain", 1.0))) for channel in observable}
    offset = {channel: as_float(float(values.get(f"sensor.{channel}_offset", 0.0))) for channel in observable}
    return Sensor(gain, offset)


def value_of(plant: Plant, name: str) -> float | None:
    """Return the value of a parameter in its internal unit.

    Args:
        plant: The plant.
        name: Name of the parameter.

    Returns:
        The value; ``None`` if the plant has no such parameter, or if it is an initial state that the plant derives.
    """
    if name not in parameters.all_declarations(plant):
        return None
    value = float(parameters.get(plant, name))
    return None if math.isnan(value) else value
