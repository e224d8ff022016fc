"""Generalised Prandtl-Ishlinskii operator with tanh envelopes.

    y = p_0 g_l(v) + sum_j p_j F_j[v],     F_j <- max(g_l(v) - r_j, min(g_r(v) + r_j, F_j))

Source: copaci2020, equations 7 to 9, after Al Janaideh, Rakheja and Su, with the envelopes g_l of increasing and g_r of
decreasing input assigned correctly. Each play operator F_j follows the envelope at a distance r_j. Envelopes of
negative height fall: then y falls as v rises, as the strain of a loaded wire does with its temperature, and g_r - r_j
bounds F_j from below, g_l + r_j from above.

``smajax.laws.prandtl_ishlinskii_inverse`` holds the inverse: the input that gives a wanted output.
"""

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Float

from smajax.laws.base import AbstractInputOutputModel
from smajax.numerics.nonsmooth import clip, maximum, minimum

# Distance from the limits -1 and 1 of tanh at which the inverse of an envelope is cut off: far above rounding, and
# small beside any signal. The exported C code uses the same number.
EDGE = 1e-12


class Envelope(eqx.Module):
    """Envelope height tanh(slope v + shift) + middle.

    ``slope`` is positive, and so is ``height`` unless the output falls with the input.
    """

    height: jax.Array
    slope: jax.Array
    shift: jax.Array
    middle: jax.Array

    def __call__(self, value: jax.Array) -> jax.Array:
        """Return the envelope at an input."""
        return self.height * jnp.tanh(self.slope * value + self.shift) + self.middle

    def inverse(self, level: jax.Array) -> jax.Array:
        """Return the input at which the envelope has a level; unreachable levels are replaced by its limits."""
        share = clip((level - self.middle) / self.height, -1.0 + EDGE, 1.0 - EDGE)
        return (jnp.arctanh(share) - self.shift) / self.slope


class PrandtlIshlinskii(AbstractInputOutputModel):
    """Generalised Prandtl-Ishlinskii operator.

    ``direct`` is p_0 > 0; ``thresholds`` r_j >= 0 and ``densities`` p_j >= 0 have the shape ``(m,)``.
    One envelope serves both directions if ``unloading`` is ``None``; the heights of two envelopes have the same sign.
    """

    direct: jax.Array
    thresholds: jax.Array
    densities: jax.Array
    loading: Envelope
    unloading: Envelope | None = None

    def init(self, first: Float[Array, ""]) -> Float[Array, " plays"]:
        """Return the plays on the virgin curve, from 0."""
        return self.update_plays(jnp.zeros_like(self.thresholds), first)

    def step(
        self,
        state: Float[Array, " plays"],
        before: Float[Array, ""],
        after: Float[Array, ""],
        duration: Float[Array, ""],
    ) -> Float[Array, " plays"]:
        """Return the plays after a monotonic change of the input."""
        return self.update_plays(state, after)

    def output(self, state: Float[Array, " plays"], value: Float[Array, ""]) -> Float[Array, ""]:
        """Return the output at an input."""
        return self.direct * self.loading(value) + self.densities @ state

    def update_plays(self, state: Float[Array, " plays"], value: Float[Array, ""]) -> Float[Array, " plays"]:
        """Return the plays after the input has moved monotonically to ``value``."""
        ends = self.loading(value), (self.unloading or self.loading)(value)
        upper, lower = (jnp.where(self.loading.height < 0.0, b, a) for a, b in (ends, ends[::-1]))
        return maximum(upper - self.thresholds, minimum(lower + self.thresholds, state))
