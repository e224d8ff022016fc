"""Rigs of the reference simulator (tests/reference), made from those of smajax."""

from smajax.plant.plant import Plant
from tests.reference.brinson import Material


def reference_material(plant: Plant) -> Material:
    """Return the material of a plant, as the reference simulator has it."""
    return Material(**{name: float(getattr(plant.material, name)) for name in Material._fields})
