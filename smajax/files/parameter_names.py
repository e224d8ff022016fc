"""Parameter names of all rigs, from the declarations of all stages."""

from collections.abc import Iterator, Mapping
from typing import Any

from smajax.channels import channel_of
from smajax.files.rig_classes import rig_classes
from smajax.files.rig_kinds import HEATS
from smajax.parameters import TIES, declarations
from smajax.parameters.definitions import Declaration, sensor_declarations


def owners(*, installed: bool = True) -> Iterator[tuple[str, type[Any], str]]:
    """Yield every parameter section that a rig file may have.

    Args:
        installed: Whether to look for materials and mechanisms of installed packages, too, which takes some time.

    Returns:
        Tuples of the section's name, its class, and the choice in the rig file that selects this class, in words.
    """
    classes = rig_classes()
    parts = classes.parts
    materials, mechanisms = (_every(group, installed) for group in (classes.materials, classes.mechanisms))
    yield from (("wire", parts["Wire"], "a straight wire"), ("wire", parts["Coil"], "a coiled wire"))
    yield from (("environment", parts["Environment"], ""), ("initial", parts["Initial"], ""))
    yield from (("drive", drive, f'control = "{control}"') for control, drive in classes.drives.items())
    yield from (("heat", parts[name], words) for name, words in HEATS.items())
    yield from (("material", material, f'model = "{model}"') for model, material in materials.items())
    yield ("cells", parts["Cells"], "cells under [wire]")
    yield ("grains", parts["Grains"], "grains under [material]")
    for kind, mechanism in mechanisms.items():
        sections = mechanism.rig_sections()
        yield from ((section, part, f'kind = "{kind}"') for section, part in sections.items())


def _every(classes: Mapping[str, Any], installed: bool) -> Mapping[str, Any]:
    """Return the classes of a registry; without those of installed packages that no one has asked for yet."""
    return classes if installed else getattr(classes, "loaded", classes)


def declarations_of(name: str) -> list[Declaration]:
    """Return the declarations of a parameter name in all rigs.

    Args:
        name: Name as ``SECTION.KEY``, or that of a tie.

    Returns:
        The declarations; an empty list for an unknown name, and two for a name such as ``heat.h2`` whose unit depends
        on the law of convection.
    """
    section, _, key = name.partition(".")
    if section == "sensor":
        channel = key.rpartition("_")[0]
        sensor = sensor_declarations((channel,) if channel_of(channel) else ())
        return [sensor[key]] if key in sensor else []
    keys = {member.partition(".")[2] for member in TIES.get(name, (name,))}
    for installed in (False, True):
        tables = {part: declarations(part) for other, part, _ in owners(installed=installed) if other == section}
        matches = [next(table[k] for k in table if k in keys) for table in tables.values() if keys <= table.keys()]
        if matches:
            return list(dict.fromkeys(matches))
    return []


def all_parameter_names() -> list[str]:
    """Return all parameter names of all rigs except those of sensors."""
    names = [f"{section}.{key}" for section, part, _ in owners() for key in declarations(part)]
    return list(dict.fromkeys(names + list(TIES)))
