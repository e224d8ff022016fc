"""The registry of the mechanisms by the kinds of rigs that have them."""

import dataclasses

from smajax.channels import CHANNELS
from smajax.errors import suggestion
from smajax.plant.mechanisms.base import OWN_SECTION, AbstractMechanism
from smajax.plant.mechanisms.bias_spring import BiasSpring
from smajax.plant.mechanisms.dead_weight import DeadWeight
from smajax.plant.mechanisms.limb import TendonLimb
from smajax.plant.mechanisms.rotary import Joint, Rotary
from smajax.plant.mechanisms.stress_path import StressPath
from smajax.plant.mechanisms.testing_machine import TestingMachine
from smajax.plant.registry import Registry

_SHIPPED: dict[str, type[AbstractMechanism]] = {
    "dead-weight": DeadWeight,
    "bias-spring": BiasSpring,
    "antagonistic-rotary": Rotary,
    "testing-machine": TestingMachine,
    "path": StressPath,
    "coil-dead-weight": DeadWeight,
    "coil-bias-spring": BiasSpring,
    "coil-antagonistic": Rotary,
    "hip": Joint,
    "elbow": TendonLimb,
    "wrist": TendonLimb,
    "glove-finger": TendonLimb,
}


# Sections of a rig file that belong to other parts of it.
_OTHER_SECTIONS = (
    *("rig", "wire", "environment", "initial", "drive", "heat", "material", "effects", "sensor", "channels", "fit"),
    *("schema", OWN_SECTION),
)


def mechanism_problem(name: str, cls: type[AbstractMechanism]) -> str:
    """Return all that is wrong with the class of a mechanism, with the cures; an empty text if nothing is.

    Args:
        name: The kind of rig under which it is registered.
        cls: The class.
    """
    problems = []
    if hasattr(cls, "wires") and cls.wires not in (1, 2):
        problems.append(f"it has {cls.wires!r} wires: write wires = 1 or wires = 2 in the body of the class")
    if hasattr(cls, "unknowns") and not (type(cls.unknowns) is int and cls.unknowns >= 0):
        problems.append(f"it has {cls.unknowns!r} unknowns: write a whole number, such as unknowns = 1")
    coordinate = [cls.coordinate] if hasattr(cls, "coordinate") else []
    for channel in (*coordinate, *getattr(cls, "prescribed", ()), *cls.extra_channels):
        if channel not in CHANNELS:
            hint = suggestion(channel, CHANNELS)
            problems.append(f"'{channel}' is not a channel{hint}: the channels are {', '.join(CHANNELS)}")
    for field in dataclasses.fields(cls):
        if field.name in _OTHER_SECTIONS:
            problems.append(f"its field '{field.name}' has the name of another section of rig files: rename it")
    return "; ".join(problems)


MECHANISMS = Registry("mechanism", AbstractMechanism, lambda: _SHIPPED, mechanism_problem)
