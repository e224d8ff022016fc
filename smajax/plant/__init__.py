"""The plant: a rig's differentiable model, drive -> heat -> material -> mechanism -> sensor.

``plant`` has the plant's initial state, its step in time and its readings; ``step_equations`` the equations of an
implicit step, ``stages`` those of each stage with its effects, ``state`` the state, ``implicit_step`` the step's
derivatives. The stages themselves are ``drive``, ``heat`` with ``convection``, ``materials``, ``mechanisms`` and
``sensor``; ``wire`` and ``coil`` are the wire's geometries, ``effects`` what may be added to a stage.
"""

from smajax.numerics import jax_setup as jax_setup
from smajax.plant.plant import Plant
from smajax.plant.state import State

__all__ = ["Plant", "State"]
