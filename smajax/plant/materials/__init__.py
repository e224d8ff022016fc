"""Constitutive laws: phase fractions, strain and resistivity of a material point.

``base`` has what all laws share. The laws are those of Brinson (``brinson``), Tanaka (``tanaka``), Liang and Rogers
(``liang_rogers``) and Lagoudas (``lagoudas``, with its hardening in ``hardening``). ``cosine_kinetics`` is shared by
Brinson's law and that of Liang and Rogers, ``one_fraction`` by those with one martensite fraction. ``dissipation``
warns where Lagoudas' law would violate the second law.
"""

from smajax.plant.materials.base import AbstractMaterial, Fractions
from smajax.plant.materials.brinson import Brinson
from smajax.plant.materials.lagoudas import Lagoudas
from smajax.plant.materials.liang_rogers import LiangRogers
from smajax.plant.materials.tanaka import Tanaka

__all__ = ["AbstractMaterial", "Brinson", "Fractions", "Lagoudas", "LiangRogers", "Tanaka"]
