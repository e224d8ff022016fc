"""Mechanisms: the loads of the wires, and the force balance that the stresses satisfy.

``base`` has the base class, ``single_wire`` those of mechanisms with one wire: a hanging weight (``dead_weight``), a
spring (``bias_spring``), a prescribed strain (``testing_machine``) or a prescribed stress (``stress_path``). A limb is
turned by a tendon (``limb``), optionally in a Bowden cable with capstan friction (``sheath``). Two antagonistic wires
turn a pulley or a link (``rotary``). ``pulley`` has the rotational inertia and damping. ``registry`` has the mechanisms
by the kinds of rigs.
"""

from smajax.plant.mechanisms.base import AbstractMechanism, MechanismContext
from smajax.plant.mechanisms.bias_spring import BiasSpring, Spring
from smajax.plant.mechanisms.dead_weight import DeadWeight, Load
from smajax.plant.mechanisms.limb import Limb, TendonLimb, Transmission
from smajax.plant.mechanisms.pulley import Pulley
from smajax.plant.mechanisms.rotary import Joint, Link, MasslessRotary, Rotary
from smajax.plant.mechanisms.sheath import Sheath
from smajax.plant.mechanisms.single_wire import AbstractDisplacement, AbstractElasticLoad, AbstractMaterialPoint
from smajax.plant.mechanisms.stress_path import StressPath
from smajax.plant.mechanisms.testing_machine import TestingMachine

__all__ = [
    "AbstractDisplacement",
    "AbstractElasticLoad",
    "AbstractMaterialPoint",
    "AbstractMechanism",
    "BiasSpring",
    "DeadWeight",
    "Joint",
    "Limb",
    "Link",
    "Load",
    "MasslessRotary",
    "MechanismContext",
    "Pulley",
    "Rotary",
    "Sheath",
    "Spring",
    "StressPath",
    "TendonLimb",
    "TestingMachine",
    "Transmission",
]
