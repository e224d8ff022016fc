"""Kinds of rigs, and the stages of the plant of each.

The sections of a rig file are the parts of the plant that its kind, control and model select. Kinds and material laws
are in the registries ``smajax.plant.mechanisms.registry`` and ``smajax.plant.materials.registry``.
"""

import dataclasses
from collections.abc import Iterable, Mapping
from typing import Any

from smajax.channels import driving_signals, observable_channels
from smajax.errors import InputError
from smajax.files.rig_classes import rig_classes
from smajax.files.rig_schema import PRESCRIBED_TEMPERATURE
from smajax.files.rig_structure import UNIFORM, Structure
from smajax.parameters.definitions import Declaration, declarations, tie_declarations

# Kinds of rigs whose wire is a coil; the wire of any other kind is that of its mechanism.
_COILED = ("coil-dead-weight", "coil-bias-spring", "coil-antagonistic", "hip")
# Laws of convection, by the name of the class, and the choice in the rig file that selects each, in words.
HEATS: Mapping[str, str] = {
    "PolynomialConvection": "h(T) as a polynomial",
    "PowerLawConvection": "an exponent in h(T)",
}
# Defaults by kind. A path is that of a material point: the size of the wire only scales force and resistance.
DEFAULTS: Mapping[str, Mapping[str, float]] = {"path": {"wire.diameter": 1e-3, "wire.length": 1.0}}


@dataclasses.dataclass(frozen=True)
class Stages:
    """Classes of the stages of a plant, or their tables.

    Attributes:
        kind: Kind of the rig.
        mechanism: Class of the mechanism.
        drive: Class of the drive.
        heat: Class of the heat balance.
        material: Class of the material law.
        structure: Numbers of cells and grains.
    """

    kind: str
    mechanism: type[Any]
    drive: type[Any]
    heat: type[Any]
    material: type[Any]
    structure: Structure = UNIFORM

    @property
    def parts(self) -> dict[str, type[Any]]:
        """Classes by parameter section; a stage without parameters has no section."""
        sections = self.mechanism.rig_sections()
        specific = {"drive": self.drive, "heat": self.heat, "material": self.material, **sections}
        classes = rig_classes().parts
        wire = classes["Coil"] if self.kind in _COILED else self.mechanism.wire_class
        shared = {"wire": wire, "environment": classes["Environment"], "initial": classes["Initial"]}
        every = (specific | shared).items()
        parts: dict[str, type[Any]] = {section: part for section, part in every if declarations(part)}
        if self.structure.cells > 1:
            parts["cells"] = classes["Cells"]
        if self.structure.grains > 1:
            parts["grains"] = classes["Grains"]
        return parts

    @property
    def observable(self) -> tuple[str, ...]:
        """Channels that the plant computes."""
        return observable_channels(self.mechanism.wires, self.mechanism.coordinate, self.mechanism.extra_channels)

    @property
    def signals(self) -> tuple[str, ...]:
        """Recorded channels that drive the plant."""
        mechanism = self.mechanism
        return driving_signals(self.drive.control, mechanism.wires, self.is_prescribed, mechanism.prescribed)

    @property
    def is_prescribed(self) -> bool:
        """Whether the wire has the recorded temperature."""
        return self.heat is rig_classes().parts["PrescribedTemperature"]

    @property
    def inert(self) -> frozenset[str]:
        """Names of parameters that the plant has and this kind of rig does not use."""
        return frozenset({"initial.temperature"} if self.is_prescribed else ())

    def table(self) -> dict[str, Declaration]:
        """Return the declarations by parameter name, ties after their members; sensors are not included."""
        leaves = {
            f"{section}.{key}": d for section, part in self.parts.items() for key, d in declarations(part).items()
        }
        leaves = {name: d for name, d in leaves.items() if name not in self.inert}
        return leaves | tie_declarations(leaves)

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
        kind: Kind of the rig, a key of ``RigClasses.mechanisms``; a path prescribes the recorded strain if its stress
            is observed, else the recorded stress.
        control: Electrical input, a key of ``RigClasses.drives``, or ``PRESCRIBED_TEMPERATURE`` for a wire that follows
            its recorded temperature; not used for a path.
        model: Material law, a key of ``RigClasses.materials``.
        observe: Channels that are fitted.
        exponent: Whether h(T) has an exponent.
        structure: Numbers of cells and grains.

    Raises:
        InputError: If a temperature is prescribed and the rig has several wires or cells.
    """
    classes = rig_classes()
    mechanisms, parts, material = classes.mechanisms, classes.parts, classes.materials[model]
    if structure.cells > 1 and (kind == "path" or control == PRESCRIBED_TEMPERATURE):
        cure = "remove it, since the recording has the temperature of the wire"
        raise InputError(f"wire.cells = {structure.cells} does not apply where the temperature is prescribed: {cure}")
    if kind == "path":
        mechanism = mechanisms["testing-machine" if "stress" in observe else "path"]
        return Stages(kind, mechanism, parts["NoDrive"], parts["PrescribedTemperature"], material, structure)
    if control == PRESCRIBED_TEMPERATURE:
        if mechanisms[kind].wires != 1:
            problem = f'rig.control = "{control}" prescribes one temperature, and {rig_phrase(kind)} has several wires'
            raise InputError(f'{problem}: name the electrical input, as in control = "current"')
        return Stages(kind, mechanisms[kind], parts["NoDrive"], parts["PrescribedTemperature"], material, structure)
    heat = parts["PowerLawConvection" if exponent else "PolynomialConvection"]
    return Stages(kind, mechanisms[kind], classes.drives[control or ""], heat, material, structure)


def rig_phrase(kind: str) -> str:
    """Return a kind of rig with its article: "a dead-weight rig", "an antagonistic-rotary rig"."""
    return f"{'an' if kind[0] in 'aeiou' else 'a'} {kind} rig"
