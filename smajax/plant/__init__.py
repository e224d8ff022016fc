"""The plant: a rig's differentiable model, drive -> heat -> material -> mechanism -> sensor.

``plant`` has the initial state, the time step and the observed channels. ``step_equations`` has the equations of an
implicit step, ``stages`` those of each stage with its effects, ``state`` the state, and ``implicit_step`` the
derivatives of a step. The stages are ``drive`` (Joule heat with the resistance of the phases), ``heat`` (heat balance)
with ``convection`` (h(T)), ``materials``, ``mechanisms`` and ``sensor``. ``wire`` and ``coil`` are geometries of the
wire, ``effects`` has optional terms of each stage, such as latent heat, and ``capabilities`` the words for what a rig
can have and show.
"""

from smajax.plant.coil import Coil
from smajax.plant.convection import PolynomialConvection, PowerLawConvection
from smajax.plant.drive import CurrentDrive, DutyDrive, NoDrive, PowerDrive, VoltageDrive
from smajax.plant.heat import PrescribedTemperature
from smajax.plant.plant import Plant
from smajax.plant.sensor import Sensor
from smajax.plant.state import State
from smajax.plant.wire import Environment, Initial, Wire

__all__ = [
    "Coil",
    "CurrentDrive",
    "DutyDrive",
    "Environment",
    "Initial",
    "NoDrive",
    "Plant",
    "PolynomialConvection",
    "PowerDrive",
    "PowerLawConvection",
    "PrescribedTemperature",
    "Sensor",
    "State",
    "VoltageDrive",
    "Wire",
]
