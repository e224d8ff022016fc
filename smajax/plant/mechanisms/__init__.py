"""Mechanisms: what the wires pull on, and the balance that their stresses satisfy.

``base`` has what all mechanisms share. One wire: a hanging weight (``dead_weight``), a spring (``bias_spring``), a
prescribed strain (``testing_machine``) or a prescribed stress (``stress_path``). A limb turned by a tendon (``limb``),
with a Bowden cable (``sheath``). Two antagonistic wires on a pulley, or on a link (``rotary``). ``pulley`` has the
inertia and damping of all that turns.
"""

from smajax.plant.mechanisms.base import AbstractMechanism
from smajax.plant.mechanisms.bias_spring import BiasSpring, Spring
from smajax.plant.mechanisms.dead_weight import DeadWeight, Load
from smajax.plant.mechanisms.limb import Limb, TendonLimb, Transmission
from smajax.plant.mechanisms.pulley import Pulley
from smajax.plant.mechanisms.rotary import Joint, Link, MasslessRotary, Rotary
from smajax.plant.mechanisms.sheath import Sheath
from smajax.plant.mechanisms.stress_path import StressPath
from smajax.plant.mechanisms.testing_machine import TestingMachine

__all__ = [
    "AbstractMechanism",
    "BiasSpring",
    "DeadWeight",
    "Joint",
    "Limb",
    "Link",
    "Load",
    "MasslessRotary",
    "Pulley",
    "Rotary",
    "Sheath",
    "Spring",
    "StressPath",
    "TendonLimb",
    "TestingMachine",
    "Transmission",
]
