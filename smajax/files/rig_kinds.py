"""Kinds of rigs, and the stages of the plant of each.

The sections of a rig file are the parts of the plant that its kind, control and model select. A new kind, material or
law of convection is one entry in a table.
"""

import dataclasses
from collections.abc import Iterable, Mapping
from typing import get_args

import equinox as eqx

from smajax.parameters import TIES, Declaration, declarations
from smajax.plant.coil import Coil
from smajax.plant.convection import PolynomialConvection, PowerLawConvection
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
# Classes of wires by kind of rig; the wire of any other kind is straight.
WIRES: Mapping[str, type[AbstractWire]] = dict.fromkeys(
    ("coil-dead-weight", "coil-bias-spring", "coil-antagonistic", "hip"), Coil
)
MATERIALS: Mapping[str, type[AbstractMaterial]] = {
    "brinson": Brinson,
    "lagoudas": Lagoudas,
    "tanaka": Tanaka,
    "liang-rogers": LiangRogers,
}
# Laws of convection by the choice in the rig file that selects them, in words.
HEATS: Mapping[str, type[AbstractHeat]] = {
    "h(T) as a polynomial": PolynomialConvection,
    "an exponent in h(T)": PowerLawConvection,
}
# Defaults by kind. A path is that of a material point: the size of the wire only scales force and resistance.
DEFAULTS: Mapping[str, Mapping[str, float]] = {"path": {"wire.diameter": 1e-3, "wire.length": 1.0}}


@dataclasses.dataclass(frozen=True)
class Stages:
    """Classes of the stages of a plant.

    Attributes:
        kind: Kind of the rig.
        mechanism: Class of the mechanism.
        drive: Class of the drive.
        heat: Class of the heat balance.
        material: Class of the material law.
    """

    kind: str
    mechanism: type[AbstractMechanism]
    drive: type[AbstractDrive]
    heat: type[AbstractHeat]
    material: type[AbstractMaterial]

    @property
    def parts(self) -> dict[str, type[eqx.Module]]:
        """Classes by parameter section; a stage without parameters has no section."""
        specific = {"drive": self.drive, "heat": self.heat, "material": self.material, **parts_of(self.mechanism)}
        shared = {"wire": WIRES.get(self.kind, Wire), "environment": Environment, "initial": Initial}
        return {section: part for section, part in (specific | shared).items() if declarations(part)}

    @property
    def inert(self) -> frozenset[str]:
        """Names of parameters that the plant has and this kind of rig does not use."""
        return frozenset({"initial.temperature"} if self.heat is PrescribedTemperature else ())

    def table(self) -> dict[str, Declaration]:
        """Return the declarations by parameter name, ties after their members; sensors are not included."""
        leaves = {
            f"{section}.{key}": d for section, part in self.parts.items() for key, d in declarations(part).items()
        }
        leaves = {name: d for name, d in leaves.items() if name not in self.inert}
        return leaves | {
            tie: leaves[members[0]] for tie, members in TIES.items() if all(member in leaves for member in members)
        }

    def keys(self, section: str) -> dict[str, Declaration]:
        """Return the declarations of a section by key, with the ties."""
        return {name.split(".", 1)[1]: d for name, d in self.table().items() if name.startswith(f"{section}.")}


def choose_stages(kind: str, control: str | None, model: str, observe: Iterable[str], exponent: bool) -> Stages:
    """Return the classes of the stages of a rig.

    Args:
        kind: Kind of the rig; a path prescribes the recorded strain if its stress is observed, else the recorded
            stress.
        control: Electrical input, a key of ``DRIVES``; not used for a path.
        model: Material law, a key of ``MATERIALS``.
        observe: Channels that are fitted.
        exponent: Whether h(T) has an exponent.
    """
    if kind == "path":
        mechanism = TestingMachine if "stress" in observe else StressPath
        return Stages(kind, mechanism, NoDrive, PrescribedTemperature, MATERIALS[model])
    return Stages(
        kind,
        KINDS[kind],
        DRIVES[control or ""],
        PowerLawConvection if exponent else PolynomialConvection,
        MATERIALS[model],
    )


def parts_of(mechanism: type[AbstractMechanism]) -> dict[str, type[eqx.Module]]:
    """Return the sections of a mechanism, such as ``load`` or ``pulley``, with their classes."""
    field_types = [(f.name, part) for f in dataclasses.fields(mechanism) for part in (f.type, *get_args(f.type))]
    return {name: part for name, part in field_types if isinstance(part, type) and issubclass(part, eqx.Module)}


def rig_phrase(kind: str) -> str:
    """Return a kind of rig with its article: "a dead-weight rig", "an antagonistic-rotary rig"."""
    return f"{'an' if kind[0] in 'aeiou' else 'a'} {kind} rig"
