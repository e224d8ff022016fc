"""The law of Liang and Rogers: cosine kinetics of one martensite fraction."""

from jaxtyping import Array, Float

from smajax.plant.materials.cosine_kinetics import DEFAULT_SMOOTHING, cosine_remainder
from smajax.plant.materials.one_fraction import AbstractOneFraction


class LiangRogers(AbstractOneFraction):
    """The law of Liang and Rogers: 1 - xi = cos^2(pi/2 p), xi = cos^2(pi/2 q). Source: liang1990."""

    def remainder(self, start: Float[Array, "..."], end: Float[Array, "..."]) -> Float[Array, "..."]:
        """Compute the ratio of the remaining shares: that of cos^2(pi/2 progress) at the end and at the start."""
        return cosine_remainder(end, DEFAULT_SMOOTHING) / cosine_remainder(start, DEFAULT_SMOOTHING)
