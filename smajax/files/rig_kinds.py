"""Kinds of rigs, and the stages of the plant of each.

The sections of a rig file are the parts of the plant that its kind, control and model select. Kinds and material laws
are in the registries ``smajax.plant.mechanisms.registry`` and ``smajax.plant.materials.registry``.
"""

import dataclasses
from collections.abc import Iterable, Mapping

import equinox as eqx

from smajax.errors import InputError
from smajax.files.rig_schema import PRESCRIBED_TEMPERATURE
from smajax.files.rig_structure import UNIFORM, Structure
from smajax.parameters import TIES, declarations
from smajax.parameters.definitions import Declaration
from smajax.plant.cells import Cells
from smajax.plant.coil import Coil
from smajax.plant.convection import PolynomialConvection, PowerLawConvection
from smajax.plant.drive import DRIVES, AbstractDrive, NoDrive
from smajax.plant.grains import Grains
from smajax.plant.heat import AbstractHeat, PrescribedTemperature
from smajax.plant.materials.base import AbstractMaterial
from smajax.plant.materials.registry import MATERIALS
from smajax.plant.mechanisms.base import AbstractMechanism
from smajax.plant.mechanisms.registry import MECHANISMS
from smajax.plant.mechanisms.stress_path import StressPath
from smajax.plant.mechanisms.testing_machine import TestingMachine
from smajax.plant.wire import AbstractWire, Environment, Initial

# Classes of wires by kind of rig; the wire of any other kind is that of its mechanism.
WIRES: Mapping[str, type[AbstractWire]] = dict.fromkeys(
    ("coil-dead-weight", "coil-bias-spring", "coil-antagonistic", "hip"), Coil
)
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
        structure: Numbers of cells and grains.
    """

    kind: str
    mechanism: type[AbstractMechanism]
    drive: type[AbstractDrive]
    heat: type[AbstractHeat]
    material: type[AbstractMaterial]
    structure: Structure = UNIFORM

    @property
    def parts(self) -> dict[str, type[eqx.Module]]:
        """Classes by parameter section; a stage without parameters has no section."""
        sections = self.mechanism.rig_sections()
        specific = {"drive": self.drive, "heat": self.heat, "material": self.material, **sections}
        wire = WIRES.get(self.kind, self.mechanism.wire_class)
        shared = {"wire": wire, "environment": Environment, "initial": Initial}
        every = (specific | shared).items()
        parts: dict[str, type[eqx.Module]] = {section: part for section, part in every if declarations(part)}
        if self.structure.cells > 1:
            parts["cells"] = Cells
        if self.structure.grains > 1:
            parts["grains"] = Grains
        return parts

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


def choose_stages(
    kind: str,
    control: str | None,
    model: str,
    observe: Iterable[str],
    exponent: bool,
    structure: Structure = UNIFORM,
) -> Stages:
    """Return the classes of the stages of a rig.

    Args:
        kind: Kind of the rig, a key of ``MECHANISMS``; a path prescribes the recorded strain if its stress is observed,
            else the recorded stress.
        control: Electrical input, a key of ``DRIVES``, or ``PRESCRIBED_TEMPERATURE`` for a wire that follows its
            recorded temperature; not used for a path.
        model: Material law, a key of ``MATERIALS``.
        observe: Channels that are fitted.
        exponent: Whether h(T) has an exponent.
        structure: Numbers of cells and grains.

    Raises:
        InputError: If a temperature is prescribed and the rig has several wires or cells.
    """
    material = MATERIALS[model]
    if structure.cells > 1 and (kind == "path" or control == PRESCRIBED_TEMPERATURE):
        cure = "remove it, since the recording has the temperature of the wire"
        raise InputError(f"wire.cells = {structure.cells} does not apply where the temperature is prescribed: {cure}")
    if kind == "path":
        mechanism = TestingMachine if "stress" in observe else StressPath
        return Stages(kind, mechanism, NoDrive, PrescribedTemperature, material, structure)
    if control == PRESCRIBED_TEMPERATURE:
        if MECHANISMS[kind].wires != 1:
            problem = f'rig.control = "{control}" prescribes one temperature, and {rig_phrase(kind)} has several wires'
            raise InputError(f'{problem}: name the electrical input, as in control = "current"')
        return Stages(kind, MECHANISMS[kind], NoDrive, PrescribedTemperature, material, structure)
    heat = PowerLawConvection if exponent else PolynomialConvection
    return Stages(kind, MECHANISMS[kind], DRIVES[control or ""], heat, material, structure)


def rig_phrase(kind: str) -> str:
    """Return a kind of rig with its article: "a dead-weight rig", "an antagonistic-rotary rig"."""
    return f"{'an' if kind[0] in 'aeiou' else 'a'} {kind} rig"
