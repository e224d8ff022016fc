"""Kinds of rigs, and the stages of which the plant of each is made.

The sections of a rig file are the parts of the plant that its kind, control and model choose. A new kind, material or
law of convection is one entry in a table.
"""

import dataclasses
from collections.abc import Iterable, Mapping
from typing import get_args

import equinox as eqx

from smajax.parameters import TIES, Declaration, declarations
from smajax.plant.coil import Coil
from smajax.plant.convection import PolynomialHeat, PowerHeat
from smajax.plant.drive import DRIVES, AbstractDrive, NoDrive
from smajax.plant.heat import AbstractHeat, PrescribedTemperature
from smajax.plant.materials.base import AbstractMaterial
from smajax.plant.materials.brinson import Brinson
from smajax.plant.materials.lagoudas import Lagoudas
from smajax.plant.materials.liang_rogers import LiangRogers
from smajax.plant.materials.tanaka import Tanaka
from smajax.plant.mechanisms.base import AbstractMechanism
from smajax.plant.mechanisms.bias_spring import BiasSpring
from smajax.plant.mechanisms.dead_weight import DeadWeight
from smajax.plant.mechanisms.limb import TendonLimb
from smajax.plant.mechanisms.rotary import Joint, Rotary
from smajax.plant.mechanisms.stress_path import StressPath
from smajax.plant.mechanisms.testing_machine import TestingMachine
from smajax.plant.wire import AbstractWire, Environment, Initial, Wire

KINDS: Mapping[str, type[AbstractMechanism]] = {
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
# A wire is straight unless its kind of rig is listed here.
WIRES: Mapping[str, type[AbstractWire]] = dict.fromkeys(
    ("coil-dead-weight", "coil-bias-spring", "coil-antagonistic", "hip"), Coil
)
MATERIALS: Mapping[str, type[AbstractMaterial]] = {
    "brinson": Brinson,
    "lagoudas": Lagoudas,
    "tanaka": Tanaka,
    "liang-rogers": LiangRogers,
}
# Laws of convection by the choice that gives them, in words.
HEATS: Mapping[str, type[AbstractHeat]] = {"h(T) as a polynomial": PolynomialHeat, "an exponent in h(T)": PowerHeat}
# A path is followed by a material point: the size of the wire only scales force and resistance.
DEFAULTS: Mapping[str, Mapping[str, float]] = {"path": {"wire.diameter": 1e-3, "wire.length": 1.0}}


@dataclasses.dataclass(frozen=True)
class Stages:
    """The classes of which a rig's plant is made."""

    kind: str
    mechanism: type[AbstractMechanism]
    drive: type[AbstractDrive]
    heat: type[AbstractHeat]
    material: type[AbstractMaterial]

    @property
    def parts(self) -> dict[str, type[eqx.Module]]:
        """The parameter sections of the rig with their classes; a stage without parameters has no section."""
        chosen = {"drive": self.drive, "heat": self.heat, "material": self.material, **parts_of(self.mechanism)}
        shared = {"wire": WIRES.get(self.kind, Wire), "environment": Environment, "initial": Initial}
        return {section: part for section, part in (chosen | shared).items() if declarations(part)}

    @property
    def inert(self) -> frozenset[str]:
        """Parameters that the plant has and this kind does not use."""
        return frozenset({"initial.temperature"} if self.heat is PrescribedTemperature else ())

    def table(self) -> dict[str, Declaration]:
        """Return the declarations of all parameters except those of sensors by name, each tie after its members."""
        leaves = {
            f"{section}.{key}": d for section, part in self.parts.items() for key, d in declarations(part).items()
        }
        leaves = {name: d for name, d in leaves.items() if name not in self.inert}
        return leaves | {
            tie: leaves[members[0]] for tie, members in TIES.items() if all(member in leaves for member in members)
        }

    def keys(self, section: str) -> dict[str, Declaration]:
        """Return the declarations of a section by key, ties included."""
        return {name.split(".", 1)[1]: d for name, d in self.table().items() if name.startswith(f"{section}.")}


def choose_stages(kind: str, control: str | None, model: str, observe: Iterable[str], exponent: bool) -> Stages:
    """Return the stages of a rig.

    Args:
        kind: Kind of the rig; a path follows the recorded strain where its stress is observed, else the recorded
            stress.
        control: Electrical input.
        model: Material law.
        observe: Channels that are fitted.
        exponent: Whether h(T) has an exponent.
    """
    if kind == "path":
        mechanism = TestingMachine if "stress" in observe else StressPath
        return Stages(kind, mechanism, NoDrive, PrescribedTemperature, MATERIALS[model])
    return Stages(kind, KINDS[kind], DRIVES[control or ""], PowerHeat if exponent else PolynomialHeat, MATERIALS[model])


def parts_of(mechanism: type[AbstractMechanism]) -> dict[str, type[eqx.Module]]:
    """Return the sections that belong to a mechanism, such as ``load`` or ``pulley``, with their classes."""
    named = [(f.name, part) for f in dataclasses.fields(mechanism) for part in (f.type, *get_args(f.type))]
    return {name: part for name, part in named if isinstance(part, type) and issubclass(part, eqx.Module)}


def rig_phrase(kind: str) -> str:
    """Return the kind with its article for a sentence: a dead-weight rig, an antagonistic-rotary rig."""
    return f"{'an' if kind[0] in 'aeiou' else 'a'} {kind} rig"
