"""A sensor of displacement or angle that drifts."""

import jax

from smajax.parameters import parameter
from smajax.plant.effect import SensorEffect


class EncoderDrift(SensorEffect):
    """y = x + s t."""

    strength: jax.Array = parameter("m/s", "drift of the reading", -1e-3, 1e-3, 0.0)
    key = "encoder-drift"
    typical = 2e-6
    source = "estimate: a displacement or angle that drifts with time"
    confused_with = ("ratcheting",)
    needs = ("clock",)

    def read(self, series: jax.Array, seen: dict[str, jax.Array], time: jax.Array) -> jax.Array:
        """See ``SensorEffect``."""
        return self.strength * (time - time[0])
