"""Generalised Prandtl-Ishlinskii operator with tanh envelopes.

    y = p_0 g_l(v) + sum_j p_j F_j[v],     F_j <- max(g_l(v) - r_j, min(g_r(v) + r_j, F_j))

v is the input and y the output. Each play operator F_j follows the envelope at a distance r_j: the envelope g_l while
the input increases, g_r while it decreases. With envelopes of negative height y falls as v rises, as the strain of a
loaded wire does with its temperature; then g_r - r_j bounds F_j from below, and g_l + r_j from above.

``smajax.laws.prandtl_ishlinskii_inverse`` has the inverse: the input for a required output.

Source: copaci2020, equations 7 to 9, after Al Janaideh, Rakheja and Su, with the two envelopes assigned correctly.
"""

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Float

from smajax.laws.base import AbstractInputOutputModel
from smajax.numerics.nonsmooth import clip, maximum, minimum

# Distance from the limits -1 and 1 of tanh at which the inverse of an envelope is cut off: far above rounding, and
# small compared with any signal. The exported C code uses the same number.
EDGE = 1e-12


class Envelope(eqx.Module):
    """Envelope g(v) = height tanh(slope v + shift) + middle.

    Attributes:
        height: Half of the envelope's range; negative if the output falls as the input rises.
        slope: Slope of the argument, positive, one over the unit of the input.
        shift: Offset of the argument.
        middle: Middle of the envelope's range.
    """

    height: jax.Array
    slope: jax.Array
    shift: jax.Array
    middle: jax.Array

    def __call__(self, value: Float[Array, "..."]) -> Float[Array, "..."]:
        """Compute the envelope at an input."""
        return self.height * jnp.tanh(self.slope * value + self.shift) + self.middle

    def inverse(self, level: Float[Array, "..."]) -> Float[Array, "..."]:
        """Compute the input at which the envelope has a level.

        Args:
            level: Level of the envelope; levels outside its range are replaced by the nearest limit.
        """
        share = clip((level - self.middle) / self.height, -1.0 + EDGE, 1.0 - EDGE)
        return (jnp.arctanh(share) - self.shift) / self.slope


class PrandtlIshlinskii(AbstractInputOutputModel):
    """Generalised Prandtl-Ishlinskii operator with ``m`` plays.

    Attributes:
        direct: Weight p_0 of the direct part, positive.
        thresholds: Thresholds r_j of the plays, at least 0, shape ``(m,)``.
        densities: Weights p_j of the plays, at least 0, shape ``(m,)``.
        loading: Envelope g_l of increasing input.
        unloading: Envelope g_r of decreasing input, with a height of the same sign; ``None`` if g_l serves both
            directions.
    """

    direct: jax.Array
    thresholds: jax.Array
    densities: jax.Array
    loading: Envelope
    unloading: Envelope | None = None

    def init(self, first: Float[Array, ""]) -> Float[Array, " plays"]:
        """Return the plays on the virgin curve: after a monotonic change of the input from plays of 0."""
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
        """Compute the output p_0 g_l(v) + sum_j p_j F_j."""
        return self.direct * self.loading(value) + self.densities @ state

    def update_plays(self, state: Float[Array, " plays"], value: Float[Array, ""]) -> Float[Array, " plays"]:
        """Compute the plays after a monotonic change of the input: max(g_l(v) - r_j, min(g_r(v) + r_j, F_j)).

        Args:
            state: Plays F_j before the change.
            value: Input v after the change.
        """
        ends = self.loading(value), (self.unloading or self.loading)(value)
        upper, lower = (jnp.where(self.loading.height < 0.0, b, a) for a, b in (ends, ends[::-1]))
        return maximum(upper - self.thresholds, minimum(lower + self.thresholds, state))
