"""The closed loop: everything between the reference and the wires, and its rollout on a plant.

``ClosedLoop`` has the controller, the sensors, the estimator, the temperature limiter and the ``Allocation`` of one
command to the wires; ``rollout`` simulates it over a ``Scenario``, differentiable in plant, gains and scenario.
The module ``gains`` has the tunable parameters by name, the module ``references`` steps, staircases and sines.
"""

from smajax.control.loop.allocation import Allocation
from smajax.control.loop.closed_loop import ClosedLoop, Measurement
from smajax.control.loop.rollout import Rollout, Scenario, rollout, simulate_loop
from smajax.control.loop.temperature_limiter import TemperatureLimiter

__all__ = [
    "Allocation",
    "ClosedLoop",
    "Measurement",
    "Rollout",
    "Scenario",
    "TemperatureLimiter",
    "rollout",
    "simulate_loop",
]
