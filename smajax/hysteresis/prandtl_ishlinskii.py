"""The generalised Prandtl-Ishlinskii operator with tanh envelopes, and its inverse in closed form.

    y = p_0 g_l(v) + sum_j p_j F_j[v],     F_j <- max( g_l(v) - r_j, min( g_r(v) + r_j, F_j ) )

(Al Janaideh, Rakheja, Su; flexible-actuator paper eq. 7-9, with the envelopes g_l of increasing and g_r of decreasing input put where they
belong). Each play operator F_j follows the envelope at a distance r_j. With g_l = g_r = g and positive densities the operator is a
classical one of the input g(v), whose inverse is again of this kind (Krejci, Kuhnen 2001): thresholds and densities of the inverse follow
from sums. With two envelopes the inverse uses that of the direction in which the output goes, which is near but not exact.
"""

import equinox as eqx
import jax
import jax.numpy as jnp

from smajax.hysteresis.operator import AbstractOperator

EDGE = 1e-12


class Envelope(eqx.Module):
    """height tanh(slope v + shift) + middle; ``height`` and ``slope`` are positive."""

    height: jax.Array
    slope: jax.Array
    shift: jax.Array
    middle: jax.Array

    def __call__(self, value: jax.Array) -> jax.Array:
        """The envelope at an input."""
        return self.height * jnp.tanh(self.slope * value + self.shift) + self.middle

    def inverse(self, level: jax.Array) -> jax.Array:
        """The input at which the envelope has a level; levels that it never reaches are taken for its ends."""
        share = jnp.clip((level - self.middle) / self.height, -1.0 + EDGE, 1.0 - EDGE)
        return (jnp.arctanh(share) - self.shift) / self.slope


class PrandtlIshlinskii(AbstractOperator):
    """The operator of the module's text: ``thresholds`` and ``densities`` of shape ``(m,)``, all of them at least 0; ``direct`` is p_0 > 0.

    One envelope serves both directions where ``unloading`` is ``None``. A law with fixed thresholds is one whose fit holds them.
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
        upper, lower = self.loading(value), (self.unloading or self.loading)(value)
        return jnp.maximum(upper - self.thresholds, jnp.minimum(lower + self.thresholds, state))

    def inverse(self) -> "InversePrandtlIshlinskii":
        """The operator that gives the input for a wanted output: for one envelope exactly, as far as that reaches."""
        order = jnp.argsort(self.thresholds)
        thresholds, densities = self.thresholds[order], self.densities[order]
        before = self.direct + jnp.cumsum(densities) - densities  # slope up to each threshold
        gaps = jnp.diff(thresholds, prepend=0.0)
        own = jnp.cumsum(before * gaps)
        return InversePrandtlIshlinskii(
            direct=1.0 / self.direct,
            thresholds=own,
            densities=-densities / ((before + densities) * before),
            loading=self.loading,
            unloading=self.unloading,
        )


class InversePrandtlIshlinskii(AbstractOperator):
    """The inverse: plays on the wanted output itself, then the inverse of the envelope of the direction in which it goes."""

    direct: jax.Array
    thresholds: jax.Array
    densities: jax.Array
    loading: Envelope
    unloading: Envelope | None = None

    def start(self, first: jax.Array) -> tuple[jax.Array, jax.Array]:
        """See ``AbstractOperator.start``: plays, and whether the output falls."""
        return self._play(jnp.zeros_like(self.thresholds), first), jnp.asarray(False)

    def advance(self, state: tuple, before: jax.Array, after: jax.Array, step: jax.Array) -> tuple[jax.Array, jax.Array]:
        """See ``AbstractOperator.advance``."""
        plays, falls = state
        return self._play(plays, after), jnp.where(after == before, falls, after < before)

    def output(self, state: tuple, value: jax.Array) -> jax.Array:
        """See ``AbstractOperator.output``."""
        plays, falls = state
        level = self.direct * value + self.densities @ plays
        rising = self.loading.inverse(level)
        return rising if self.unloading is None else jnp.where(falls, self.unloading.inverse(level), rising)

    def _play(self, plays: jax.Array, value: jax.Array) -> jax.Array:
        return jnp.maximum(value - self.thresholds, jnp.minimum(value + self.thresholds, plays))
