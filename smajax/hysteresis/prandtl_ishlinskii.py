"""The generalised Prandtl-Ishlinskii operator with tanh envelopes, and its inverse in closed form.

    y = p_0 g_l(v) + sum_j p_j F_j[v],     F_j <- max( g_l(v) - r_j, min( g_r(v) + r_j, F_j ) )

(Al Janaideh, Rakheja, Su; flexible-actuator paper eq. 7-9, with the envelopes g_l of increasing and g_r of decreasing input put where they
belong). Each play operator F_j follows the envelope at a distance r_j. Envelopes of negative height fall: then y falls as v rises, as the
strain of a loaded wire does with its temperature, and g_r - r_j holds F_j from below, g_l + r_j from above. With g_l = g_r = g and positive
densities the operator is a classical one of the input g(v), whose inverse is again of this kind (Krejci, Kuhnen 2001): thresholds and
densities of the inverse follow from sums. With two envelopes no such form is known; but as all parts of y rise with v, or all fall, one
input gives a wanted output from where the plays stand, and the inverse finds it between the ends of the envelopes.
"""

import equinox as eqx
import jax
import jax.numpy as jnp
from jax.core import Tracer

from smajax.errors import InputError
from smajax.hysteresis.operator import AbstractOperator
from smajax.kinks import larger, smaller, within

EDGE = 1e-12
_HALVINGS = 60


class Envelope(eqx.Module):
    """height tanh(slope v + shift) + middle; ``slope`` is positive, and so is ``height`` unless the output falls with the input."""

    height: jax.Array
    slope: jax.Array
    shift: jax.Array
    middle: jax.Array

    def __call__(self, value: jax.Array) -> jax.Array:
        """The envelope at an input."""
        return self.height * jnp.tanh(self.slope * value + self.shift) + self.middle

    def inverse(self, level: jax.Array) -> jax.Array:
        """The input at which the envelope has a level; levels that it never reaches are taken for its ends."""
        share = within((level - self.middle) / self.height, -1.0 + EDGE, 1.0 - EDGE)
        return (jnp.arctanh(share) - self.shift) / self.slope


class PrandtlIshlinskii(AbstractOperator):
    """The operator of the module's text: ``thresholds`` and ``densities`` of shape ``(m,)``, all of them at least 0; ``direct`` is p_0 > 0.

    One envelope serves both directions where ``unloading`` is ``None``; of two, the heights have one sign. A law with fixed thresholds is
    one whose fit holds them.
    """

    direct: jax.Array
    thresholds: jax.Array
    densities: jax.Array
    loading: Envelope
    unloading: Envelope | None = None

    def start(self, first: jax.Array) -> jax.Array:
        """See ``AbstractOperator.start``: the plays, shape ``(m,)``, on the virgin curve, from 0."""
        return self._play(jnp.zeros_like(self.thresholds), first)

    def advance(self, state: jax.Array, before: jax.Array, after: jax.Array, step: jax.Array) -> jax.Array:
        """See ``AbstractOperator.advance``; the input goes there monotonically."""
        return self._play(state, after)

    def output(self, state: jax.Array, value: jax.Array) -> jax.Array:
        """See ``AbstractOperator.output``."""
        return self.direct * self.loading(value) + self.densities @ state

    def _play(self, state: jax.Array, value: jax.Array) -> jax.Array:
        ends = self.loading(value), (self.unloading or self.loading)(value)
        upper, lower = (jnp.where(self.loading.height < 0.0, b, a) for a, b in (ends, ends[::-1]))
        return larger(upper - self.thresholds, smaller(lower + self.thresholds, state))

    def inverse(self) -> "InversePrandtlIshlinskii | SolvedInverse":
        """The operator that gives the input for a wanted output, as far as that reaches: in closed form for one envelope.

        Raises ``InputError`` where ``direct`` is not positive, since within the plays' dead bands many inputs then give one output, and
        where a threshold or a density is negative, or one envelope rises and the other falls, since the law goes both ways then.
        """
        for what, values in (("thresholds", self.thresholds), ("densities", self.densities)):
            if not isinstance(values, Tracer) and not bool(jnp.all(values >= 0.0)):
                raise InputError(f"the operator has no inverse that is known, since some of its {what} are negative: give none below 0")
        if not isinstance(self.direct, Tracer) and not bool(jnp.all(self.direct > 0.0)):
            raise InputError(
                "the operator has no inverse, since its direct part p_0 is 0 and its plays stand still around each turn: give p_0 > 0"
            )
        if self.unloading is not None:
            opposed = self.loading.height * self.unloading.height
            if not isinstance(opposed, Tracer) and not bool(opposed > 0.0):
                raise InputError(
                    "the operator has no inverse that is known, since one envelope rises and the other falls: give both one sign"
                )
            return SolvedInverse(self)
        order = jnp.argsort(self.thresholds)
        thresholds, densities = self.thresholds[order], self.densities[order]
        before = self.direct + jnp.cumsum(densities) - densities  # slope up to each threshold
        gaps = jnp.diff(thresholds, prepend=0.0)
        own = jnp.cumsum(before * gaps)
        return InversePrandtlIshlinskii(
            direct=1.0 / self.direct,
            thresholds=own,
            densities=-densities / ((before + densities) * before),
            envelope=self.loading,
        )


class InversePrandtlIshlinskii(AbstractOperator):
    """The inverse of an operator with one envelope: plays on the wanted output itself, then the inverse of the envelope."""

    direct: jax.Array
    thresholds: jax.Array
    densities: jax.Array
    envelope: Envelope

    def start(self, first: jax.Array) -> jax.Array:
        """See ``AbstractOperator.start``: the plays."""
        return self._play(jnp.zeros_like(self.thresholds), first)

    def advance(self, state: jax.Array, before: jax.Array, after: jax.Array, step: jax.Array) -> jax.Array:
        """See ``AbstractOperator.advance``."""
        return self._play(state, after)

    def output(self, state: jax.Array, value: jax.Array) -> jax.Array:
        """See ``AbstractOperator.output``."""
        return self.envelope.inverse(self.direct * value + self.densities @ state)

    def _play(self, plays: jax.Array, value: jax.Array) -> jax.Array:
        return larger(value - self.thresholds, smaller(value + self.thresholds, plays))


class SolvedInverse(AbstractOperator):
    """The inverse of an operator with two envelopes: its plays, and the input at which it gives what is wanted."""

    law: PrandtlIshlinskii

    def start(self, first: jax.Array) -> tuple[jax.Array, jax.Array]:
        """See ``AbstractOperator.start``: the law's plays, and its input."""
        return self._follow(jnp.zeros_like(self.law.thresholds), first)

    def advance(self, state: tuple, before: jax.Array, after: jax.Array, step: jax.Array) -> tuple[jax.Array, jax.Array]:
        """See ``AbstractOperator.advance``."""
        return self._follow(state[0], after)

    def output(self, state: tuple, value: jax.Array) -> jax.Array:
        """See ``AbstractOperator.output``."""
        return state[1]

    def _follow(self, plays: jax.Array, wanted: jax.Array) -> tuple[jax.Array, jax.Array]:
        law = self.law

        def left(v: jax.Array) -> jax.Array:
            return law.output(law._play(plays, v), v) - wanted

        way = jnp.sign(law.loading.height)  # -1 where the output falls with the input

        def halve(_: int, ends: tuple[jax.Array, jax.Array]) -> tuple[jax.Array, jax.Array]:
            middle = 0.5 * (ends[0] + ends[1])
            low = way * left(middle) < 0.0
            return jnp.where(low, middle, ends[0]), jnp.where(low, ends[1], middle)

        reached = jnp.stack([e.inverse(jnp.asarray([-jnp.inf, jnp.inf])) for e in (law.loading, law.unloading or law.loading)])
        ends = (jnp.min(reached), jnp.max(reached))
        found = jax.lax.stop_gradient(sum(jax.lax.fori_loop(0, _HALVINGS, halve, ends)) * 0.5)
        # The last step of Newton's method carries the derivative of the implicit function.
        rest, slope = jax.jvp(left, (found,), (jnp.ones_like(found),))
        steep = jnp.abs(slope) > EDGE
        value = found - jnp.where(steep, rest / jnp.where(steep, slope, 1.0), 0.0)
        return law._play(plays, value), value
