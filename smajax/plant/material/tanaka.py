"""The one-fraction laws of Tanaka (1986) and of Liang and Rogers (1990): all martensite carries strain.

    Tanaka          1 - xi = 0.01^p     xi = 0.01^q          (99 per cent transformed at the finish)
    Liang, Rogers   1 - xi = cos^2(pi/2 p)   xi = cos^2(pi/2 q)

with p = (M_s + sigma / C_M - T) / (M_s - M_f) on the way to martensite and q = (T - A_s - sigma / C_A) / (A_f - A_s) on the way back. As
published, a transformation goes on while the temperature falls or rises, which is wrong where the stress changes, too. Here it goes on
while p or q itself rises: the correction of Elahinia and Ahmadian (2005). What remains to transform is multiplied by its ratio over the
step, so that partial loops need no memory, as in ``brinson.py``.
"""

import math

import jax
import jax.numpy as jnp

from smajax.kinks import larger
from smajax.plant.material.base import AbstractMaterial, Fractions, mix
from smajax.plant.material.brinson import remaining

_STILL = 1e-12
_SMOOTHING = 1e-9


class AbstractOneFraction(AbstractMaterial):
    """A law in which martensite is of one kind; ``left`` says what remains to transform."""

    def left(self, start: jax.Array, end: jax.Array) -> jax.Array:
        """Share of what there is to transform that a step leaves, from progress ``start`` to a larger one ``end``."""
        raise NotImplementedError

    def evolve(self, fractions: Fractions, temperature: tuple, stress: tuple) -> Fractions:
        """See ``AbstractMaterial.evolve``: reverse transformation first, then forward."""
        before, after = (self._progress(t, s) for t, s in zip(temperature, stress, strict=True))
        reverse, forward = (jnp.where(a > b + _STILL, self.left(b, a), 1.0) for b, a in zip(before, after, strict=True))
        detwinned, twinned = fractions.detwinned * reverse, fractions.twinned * reverse
        return Fractions(1.0 - twinned - (1.0 - detwinned - twinned) * forward, twinned)

    def _progress(self, temperature: jax.Array, stress: jax.Array) -> tuple[jax.Array, jax.Array]:
        reverse = temperature - self.austenite_start - self.austenite_shift - stress * (1.0 / self.clausius_clapeyron_austenite)
        forward = self.forward_start + stress * (1.0 / self.clausius_clapeyron_martensite) - temperature
        return (
            reverse * (1.0 / (self.austenite_finish - self.austenite_start)),
            forward * (1.0 / (self.martensite_start - self.martensite_finish)),
        )

    def grown_strain(self, stress: jax.Array) -> jax.Array:
        """See ``AbstractMaterial.grown_strain``: eps_L."""
        return jnp.broadcast_to(self.max_strain, jnp.shape(stress))

    def modulus(self, fractions: Fractions) -> jax.Array:
        """Young's modulus, linear in the martensite fraction, Pa."""
        return mix(fractions.martensite, self.modulus_austenite, self.modulus_martensite)


class Tanaka(AbstractOneFraction):
    """Tanaka's law: exponential kinetics (Tanaka 1986)."""

    def left(self, start: jax.Array, end: jax.Array) -> jax.Array:
        """See ``AbstractOneFraction.left``: 0.01 to the power of the progress made behind the start."""
        return jnp.exp(math.log(0.01) * (larger(end, 0.0) - larger(start, 0.0)))


class LiangRogers(AbstractOneFraction):
    """The law of Liang and Rogers: cosine kinetics (Liang, Rogers 1990)."""

    def left(self, start: jax.Array, end: jax.Array) -> jax.Array:
        """See ``AbstractOneFraction.left``: the ratio of two half cosines."""
        return remaining(end, _SMOOTHING) / remaining(start, _SMOOTHING)
