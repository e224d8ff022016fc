"""Heat conduction into the crimps at the ends, which warm up slowly."""

from typing import ClassVar

import jax

from smajax.parameters import parameter
from smajax.plant.effects.base import Shapes, ThermalNode


class EndConduction(ThermalNode):
    """Thermal node of the crimps, with half the wire's excess in steady state.

    The heat flow per kelvin is s times the convection at ambient.
    """

    strength: jax.Array = parameter("1", "conduction to the crimps over convection", 0.0, 0.6, 0.0)
    time_constant: jax.Array = parameter("s", "time constant with which the crimps warm up", 2.0, 500.0, 30.0)
    key = "end-conduction"
    typical: ClassVar[float] = 0.08
    source = "fin length sqrt(k d / 4 h): 4 mm at each end of a wire of 0.25 mm diameter"
    remedy = (
        "Use a longer wire, thin leads or insulating clamps; where that is not possible, give the wire cells "
        "(cells under [wire])."
    )
    confused_with: ClassVar[tuple[str, ...]] = ("ambient-drift", "coating")
    shapes: ClassVar[Shapes] = (("time_constant", (15.0, 60.0)),)
    steady_share: ClassVar[float] = 0.5
