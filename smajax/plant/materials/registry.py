"""The registry of the material laws."""

from smajax.plant.materials.base import AbstractMaterial
from smajax.plant.materials.brinson import Brinson
from smajax.plant.materials.lagoudas import Lagoudas
from smajax.plant.materials.liang_rogers import LiangRogers
from smajax.plant.materials.tanaka import Tanaka
from smajax.plant.registry import Registry

MATERIALS = Registry(
    "material",
    AbstractMaterial,
    lambda: {"brinson": Brinson, "lagoudas": Lagoudas, "tanaka": Tanaka, "liang-rogers": LiangRogers},
)
