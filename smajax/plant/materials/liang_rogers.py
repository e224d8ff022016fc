"""Law of Liang and Rogers: cosine kinetics of one martensite fraction.

    forward    1 - xi = cos^2(pi/2 p)    p = (M_s + sigma / C_M - T) / (M_s - M_f)
    reverse    xi = cos^2(pi/2 q)        q = (T - A_s - sigma / C_A) / (A_f - A_s)

for a transformation that starts from one phase; ``smajax.plant.materials.one_fraction`` has the form for partial ones.

Source: liang1990.
"""

from jaxtyping import Array, Float

from smajax.plant.materials.cosine_kinetics import DEFAULT_SMOOTHING, cosine_remainder
from smajax.plant.materials.one_fraction import AbstractOneFraction


class LiangRogers(AbstractOneFraction):
    """Law of Liang and Rogers: 1 - xi = cos^2(pi/2 p) forward, xi = cos^2(pi/2 q) reverse.

    Source: liang1990.
    """

    def remainder(self, start: Float[Array, "..."], end: Float[Array, "..."]) -> Float[Array, "..."]:
        """Compute the ratio of cos^2(pi/2 progress) at the end of a step to that at the start."""
        return cosine_remainder(end, DEFAULT_SMOOTHING) / cosine_remainder(start, DEFAULT_SMOOTHING)
