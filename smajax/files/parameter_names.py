"""Parameter names of all rigs, from the declarations of all stages."""

from collections.abc import Iterator

import equinox as eqx

from smajax.channels import channel_of
from smajax.files.rig_kinds import HEATS, KINDS, MATERIALS, parts_of
from smajax.parameters import TIES, Declaration, declarations
from smajax.plant.coil import Coil
from smajax.plant.drive import DRIVES
from smajax.plant.sensor import Sensor
from smajax.plant.wire import Environment, Initial, Wire


def owners() -> Iterator[tuple[str, type[eqx.Module], str]]:
    """Yield every parameter section that a rig file may have.

    Returns:
        Tuples of the section's name, its class, and the choice in the rig file that selects this class, in words.
    """
    yield from (("wire", Wire, "a straight wire"), ("wire", Coil, "a coiled wire"))
    yield from (("environment", Environment, ""), ("initial", Initial, ""))
    yield from (("drive", drive, f'control = "{control}"') for control, drive in DRIVES.items())
    yield from (("heat", heat, words) for words, heat in HEATS.items())
    yield from (("material", material, f'model = "{model}"') for model, material in MATERIALS.items())
    for kind, mechanism in KINDS.items():
        yield from ((section, part, f'kind = "{kind}"') for section, part in parts_of(mechanism).items())


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
        sensor = Sensor.identity((channel,) if channel_of(channel) else ()).declarations()
        return [sensor[key]] if key in sensor else []
    keys = {member.partition(".")[2] for member in TIES.get(name, (name,))}
    tables = {part: declarations(part) for other, part, _ in owners() if other == section}
    matches = [next(table[k] for k in table if k in keys) for table in tables.values() if keys <= table.keys()]
    return list(dict.fromkeys(matches))


def all_parameter_names() -> list[str]:
    """Return all parameter names of all rigs except those of sensors."""
    names = [f"{section}.{key}" for section, part, _ in owners() for key in declarations(part)]
    return list(dict.fromkeys(names + list(TIES)))
