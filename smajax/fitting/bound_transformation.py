"""Unbounded unknowns for solvers that know no bounds.

Each bounded unknown v is a function of an unbounded one u, whose slope at the start v_0 is 1, so that a step has the
same size in both:

    both bounds       v = low + w s(logit(q) + (u - v_0) / (w q (1 - q))),    w = high - low,    q = (v_0 - low) / w
    a lower bound     v = low + d exp((u - v_0) / d),                         d = v_0 - low
    an upper bound    v = high - d exp((v_0 - u) / d),                        d = high - v_0

with the logistic function s. At the start u = v_0. Since v reaches a bound only where u is infinite, a start at a bound
is moved inside, and a solver needs damping, as Levenberg-Marquardt has, to end near a bound.
"""

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

# A start nearer to a bound than this share of the distance of the bounds, or this distance where there is one bound, is
# moved there: the slope of v is almost 0 next to a bound. In scaled units, in which parameters are of order one. Chosen
# by trial; tests/unit/fitting/test_solvers.py holds it.
_MIN_SHARE = 1e-3


class BoundTransformation(eqx.Module):
    """Function from unbounded unknowns u to bounded ones v; all arrays have the shape ``(p,)``.

    Attributes:
        start: Start of both, moved inside the bounds.
        lower: Lower bounds.
        upper: Upper bounds.
    """

    start: np.ndarray
    lower: np.ndarray
    upper: np.ndarray

    def __init__(self, start: np.ndarray, lower: np.ndarray, upper: np.ndarray):
        """Make the transformation.

        Args:
            start: Start of the bounded unknowns.
            lower: Lower bounds; infinite where there are none.
            upper: Upper bounds; equal to the lower ones for fixed unknowns.
        """
        width = np.where(np.isfinite(upper - lower), upper - lower, 2.0)
        margin = _MIN_SHARE * np.maximum(width, 0.0)
        margin = np.where(np.isfinite(upper - lower), margin, _MIN_SHARE)
        self.start = np.clip(start, lower + margin, upper - margin)
        self.lower, self.upper = np.asarray(lower, float), np.asarray(upper, float)

    def __call__(self, unbounded: Float[Array, " p"]) -> Float[Array, " p"]:
        """Return the bounded unknowns of unbounded ones."""
        low, high = jnp.isfinite(self.lower), jnp.isfinite(self.upper)
        fixed, both = self.lower >= self.upper, low & high & (self.lower < self.upper)
        # Where a formula does not apply, its numbers are harmless ones, so that no derivative is NaN.
        lower, upper = jnp.where(low, self.lower, 0.0), jnp.where(high, self.upper, 1.0)
        width = jnp.where(both, upper - lower, 1.0)
        share = jnp.where(both, (self.start - lower) / width, 0.5)
        change = unbounded - self.start
        logistic = jax.scipy.special.logit(share) + jnp.where(both, change, 0.0) / (width * share * (1.0 - share))
        inside = lower + width * jax.nn.sigmoid(logistic)
        one_sided = (low ^ high) & ~fixed
        distance = jnp.where(one_sided, jnp.where(low, self.start - lower, upper - self.start), 1.0)
        sign = jnp.where(low, 1.0, -1.0)
        beyond = jnp.where(low, lower, upper) + sign * distance * jnp.exp(
            jnp.where(one_sided, sign * change, 0.0) / distance
        )
        bounded = jnp.where(both, inside, jnp.where(one_sided, beyond, unbounded))
        return jnp.where(fixed, self.lower, bounded)
