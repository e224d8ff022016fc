"""Constitutive laws: phase fractions, strain and resistivity of a material point.

``base`` has the common parameters, such as the Clausius-Clapeyron slopes, the strain and the resistivity. The laws are
those of Brinson (``brinson``), Tanaka (``tanaka``), Liang and Rogers (``liang_rogers``) and Lagoudas (``lagoudas``,
with its hardening in ``hardening``). ``cosine_kinetics`` has the kinetics of Brinson's law and of that of Liang and
Rogers, ``one_fraction`` the base class of the laws with one martensite fraction. ``dissipation`` warns if Lagoudas' law
would violate the second law of thermodynamics. ``registry`` has the laws by the names of rig files.
"""

from smajax.plant.materials.base import AbstractMaterial, Fractions
from smajax.plant.materials.brinson import Brinson
from smajax.plant.materials.lagoudas import Lagoudas
from smajax.plant.materials.liang_rogers import LiangRogers
from smajax.plant.materials.one_fraction import AbstractBandKinetics, AbstractOneFraction
from smajax.plant.materials.tanaka import Tanaka

__all__ = [
    "AbstractBandKinetics",
    "AbstractMaterial",
    "AbstractOneFraction",
    "Brinson",
    "Fractions",
    "Lagoudas",
    "LiangRogers",
    "Tanaka",
]
