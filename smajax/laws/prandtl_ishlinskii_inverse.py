"""Inverse of the Prandtl-Ishlinskii operator: the input for a required output.

With one envelope g and positive densities the operator is a classical Prandtl-Ishlinskii operator of g(v), with direct
weight p_0, thresholds r_j and densities p_j. Its inverse is again such an operator, with the direct weight 1 / p_0 and

    s_j = p_0 + p_1 + ... + p_j                        slope of the initial loading curve beyond r_j
    thresholds   r'_j = sum_i<=j s_(i-1) (r_i - r_(i-1))      with r_0 = 0
    densities    p'_j = 1 / s_j - 1 / s_(j-1) = -p_j / (s_j s_(j-1))

Two envelopes have no known closed form. But all parts of y rise with v, or all fall, so exactly one input gives the
required output from the present plays; bisection finds it between the ends of the envelopes.

Source: krejci2001.
"""

from typing import Any

import jax
import jax.numpy as jnp
from jax.core import Tracer
from jaxtyping import Array, Float

from smajax.errors import InputError
from smajax.laws.base import AbstractInputOutputModel
from smajax.laws.prandtl_ishlinskii import EDGE, Envelope, PrandtlIshlinskii
from smajax.numerics.nonsmooth import maximum, minimum

# Bisections, after which the bracket is at rounding: 2^-60 of the range of inputs.
_BISECTIONS = 60


class InversePrandtlIshlinskii(AbstractInputOutputModel):
    """Inverse of an operator with one envelope: plays on the required output, then the inverse of the envelope.

    Attributes:
        direct: Weight 1 / p_0 of the direct part.
        thresholds: Thresholds r'_j, shape ``(m,)``, in the unit of the output.
        densities: Weights p'_j, shape ``(m,)``, at most 0.
        envelope: Envelope of the operator, whose inverse is applied last.
    """

    direct: jax.Array
    thresholds: jax.Array
    densities: jax.Array
    envelope: Envelope

    @classmethod
    def from_operator(cls, operator: PrandtlIshlinskii) -> "InversePrandtlIshlinskii":
        """Compute the inverse of an operator in closed form.

        Args:
            operator: The operator, with one envelope.

        Source: krejci2001.
        """
        order = jnp.argsort(operator.thresholds)
        thresholds, densities = operator.thresholds[order], operator.densities[order]
        slope_below = operator.direct + jnp.cumsum(densities) - densities  # slope up to each threshold
        gaps = jnp.diff(thresholds, prepend=0.0)
        return cls(
            direct=1.0 / operator.direct,
            thresholds=jnp.cumsum(slope_below * gaps),
            densities=-densities / ((slope_below + densities) * slope_below),
            envelope=operator.loading,
        )

    def init(self, first: Float[Array, ""]) -> Float[Array, " plays"]:
        """Return the plays at the first required output, from plays of 0."""
        return self._update_plays(jnp.zeros_like(self.thresholds), first)

    def step(
        self,
        state: Float[Array, " plays"],
        before: Float[Array, ""],
        after: Float[Array, ""],
        duration: Float[Array, ""],
    ) -> Float[Array, " plays"]:
        """Return the plays after a monotonic change of the required output."""
        return self._update_plays(state, after)

    def output(self, state: Float[Array, " plays"], value: Float[Array, ""]) -> Float[Array, ""]:
        """Compute the input that gives the output ``value``."""
        return self.envelope.inverse(self.direct * value + self.densities @ state)

    def _update_plays(self, plays: jax.Array, value: jax.Array) -> jax.Array:
        return maximum(value - self.thresholds, minimum(value + self.thresholds, plays))


class NumericalInverse(AbstractInputOutputModel):
    """Inverse of an operator with two envelopes, by bisection.

    The state holds the operator's plays and the input that gives the required output.
    """

    operator: PrandtlIshlinskii

    def init(self, first: Float[Array, ""]) -> tuple[jax.Array, jax.Array]:
        """Return the operator's plays and input at the first required output."""
        return self._solve(jnp.zeros_like(self.operator.thresholds), first)

    def step(
        self, state: tuple[Any, ...], before: Float[Array, ""], after: Float[Array, ""], duration: Float[Array, ""]
    ) -> tuple[jax.Array, jax.Array]:
        """Return the operator's plays and input at the next required output."""
        return self._solve(state[0], after)

    def output(self, state: tuple[Any, ...], value: Float[Array, ""]) -> Float[Array, ""]:
        """Return the input that gives the output ``value``."""
        return state[1]

    def _solve(self, plays: jax.Array, target: jax.Array) -> tuple[jax.Array, jax.Array]:
        operator = self.operator

        def residual(v: jax.Array) -> jax.Array:
            return operator.output(operator.update_plays(plays, v), v) - target

        direction = jnp.sign(operator.loading.height)  # -1 where the output falls with the input

        def halve(_: jax.Array, ends: tuple[jax.Array, jax.Array]) -> tuple[jax.Array, jax.Array]:
            middle = 0.5 * (ends[0] + ends[1])
            is_low = direction * residual(middle) < 0.0
            return jnp.where(is_low, middle, ends[0]), jnp.where(is_low, ends[1], middle)

        limits = jnp.stack(
            [
                envelope.inverse(jnp.asarray([-jnp.inf, jnp.inf]))
                for envelope in (operator.loading, operator.unloading or operator.loading)
            ]
        )
        bracket = (jnp.min(limits), jnp.max(limits))
        root = jax.lax.stop_gradient(sum(jax.lax.fori_loop(0, _BISECTIONS, halve, bracket)) * 0.5)
        # A last Newton step carries the derivative of the implicit function.
        error, slope = jax.jvp(residual, (root,), (jnp.ones_like(root),))
        is_steep = jnp.abs(slope) > EDGE
        value = root - jnp.where(is_steep, error / jnp.where(is_steep, slope, 1.0), 0.0)
        return operator.update_plays(plays, value), value


def inverse_operator(operator: PrandtlIshlinskii) -> InversePrandtlIshlinskii | NumericalInverse:
    """Return the model that maps a required output to the input; outputs out of reach give the nearest input.

    Args:
        operator: The operator to invert.

    Returns:
        The inverse in closed form for one envelope, the numerical inverse for two.

    Raises:
        InputError: If ``direct`` is not positive, since many inputs within the plays' dead bands then give one output;
            if a threshold or a density is negative, or one envelope rises and the other falls, since the operator is
            then not monotonic.
    """
    for name, values in (("thresholds", operator.thresholds), ("densities", operator.densities)):
        if not isinstance(values, Tracer) and not bool(jnp.all(values >= 0.0)):
            raise InputError(
                f"the operator has no known inverse, since some of its {name} are negative: give none below 0"
            )
    if not isinstance(operator.direct, Tracer) and not bool(jnp.all(operator.direct > 0.0)):
        raise InputError(
            "the operator has no inverse, since its direct part p_0 is 0 and its plays do not move after a turn: "
            "give p_0 > 0"
        )
    if operator.unloading is None:
        return InversePrandtlIshlinskii.from_operator(operator)
    product = operator.loading.height * operator.unloading.height
    if not isinstance(product, Tracer) and not bool(product > 0.0):
        raise InputError(
            "the operator has no known inverse, since one envelope rises and the other falls: "
            "give both heights one sign"
        )
    return NumericalInverse(operator)
