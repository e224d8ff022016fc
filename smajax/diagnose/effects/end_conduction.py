"""Conduction into crimps that warm up slowly."""

import jax

from smajax.parameters import parameter
from smajax.plant.effect import SecondNode


class EndConduction(SecondNode):
    """Heat flows into the crimps, s times the convection at ambient; they warm up to half the wire's excess."""

    strength: jax.Array = parameter("1", "conduction to the crimps over convection", 0.0, 0.6, 0.0)
    time_constant: jax.Array = parameter("s", "time in which the crimps warm up", 2.0, 500.0, 30.0)
    key = "end-conduction"
    typical = 0.08
    source = "fin length sqrt(k d / 4 h): 4 mm at each end of a 0.25 mm wire"
    confused_with = ("ambient-drift", "coating")
    shapes = (("time_constant", (15.0, 60.0)),)
    share = 0.5
