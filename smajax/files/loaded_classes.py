"""The classes that a rig file selects, from their registries and modules; importing this loads JAX."""

from collections.abc import Mapping
from typing import Any

from smajax.files.class_tables import LazyMapping, RigClasses
from smajax.plant.cells import Cells
from smajax.plant.coil import Coil
from smajax.plant.convection import PolynomialConvection, PowerLawConvection
from smajax.plant.drive import DRIVES, NoDrive
from smajax.plant.effects import catalogue
from smajax.plant.grains import Grains
from smajax.plant.heat import PrescribedTemperature
from smajax.plant.materials.registry import MATERIALS
from smajax.plant.mechanisms.registry import MECHANISMS
from smajax.plant.wire import Environment, Initial, Wire

_PARTS = (
    *(Wire, Coil, Environment, Initial, Cells, Grains),
    *(NoDrive, PolynomialConvection, PowerLawConvection, PrescribedTemperature),
)


def _actuators() -> Mapping[str, Any]:
    from smajax.actuators.registry import ACTUATORS  # slow to import, and not needed to read a rig

    return ACTUATORS


LOADED_CLASSES = RigClasses(
    mechanisms=MECHANISMS,
    materials=MATERIALS,
    drives=DRIVES,
    effects=catalogue(),
    actuators=LazyMapping(_actuators),
    parts={part.__name__: part for part in _PARTS},
)
