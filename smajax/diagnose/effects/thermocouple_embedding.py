"""A thermocouple that is embedded beside the wire, so that heat has to cross glue, sleeve or body to reach it."""

import jax

from smajax.parameters import parameter
from smajax.plant.effect import SensorEffect
from smajax.plant.sensor import lagged


class ThermocoupleEmbedding(SensorEffect):
    """Two lags in series: s dT_b/dt = T - T_b in what lies between, s dy/dt = T_b - y behind it.

    Heat that diffuses through a layer arrives late before it arrives slowly, as one lag does not. The lags are alike, since the time that a
    heating pulse takes to arrive tells little but their sum.
    """

    strength: jax.Array = parameter("s", "time constant of each of the two lags", 0.0, 10.0, 0.0)
    key = "thermocouple-embedding"
    typical = 1.0
    source = "a soft arm with embedded wires (public recordings bu-softlimb): it bends most 2 to 5 s before its thermocouples peak"
    confused_with = ("thermocouple-lag", "coating")
    needs = ("temperature observed",)
    channel = "temperature"

    def read(self, series: jax.Array, seen: dict[str, jax.Array], time: jax.Array) -> jax.Array:
        """See ``SensorEffect``."""
        return lagged(lagged(series, time, self.strength), time, self.strength) - series
