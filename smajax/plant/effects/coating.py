"""Coating or sleeve: a second thermal node around the wire."""

from typing import ClassVar

import jax

from smajax.parameters import parameter
from smajax.plant.effects.base import Shapes, ThermalNode


class Coating(ThermalNode):
    """Thermal node that follows the wire's temperature; heat flow s times the convection at ambient per kelvin."""

    strength: jax.Array = parameter("1", "conduction into the coating over convection", 0.0, 6.0, 0.0)
    time_constant: jax.Array = parameter("s", "time in which the coating follows the wire", 0.2, 60.0, 3.0)
    key = "coating"
    typical: ClassVar[float] = 0.5
    source = "estimate: time constants 0.5 to 10 s, capacities 0.3 to 3 of the wire's"
    remedy = "Measure a bare wire for comparison, or keep the coating and the effect: it is part of the actuator."
    confused_with: ClassVar[tuple[str, ...]] = ("latent-heat", "end-conduction", "heat-capacity")
    shapes: ClassVar[Shapes] = (("time_constant", (1.0, 5.0)),)
