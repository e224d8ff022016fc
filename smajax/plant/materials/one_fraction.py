"""Laws with one martensite fraction, all of which carries strain: those of Tanaka and of Liang and Rogers.

    Tanaka          1 - xi = 0.01^p          xi = 0.01^q          (99 per cent transformed at the finish)
    Liang, Rogers   1 - xi = cos^2(pi/2 p)   xi = cos^2(pi/2 q)

with the progress p = (M_s + sigma / C_M - T) / (M_s - M_f) of the forward transformation, and q = (T - A_s - sigma /
C_A) / (A_f - A_s) of the reverse one, where C_A and C_M are the Clausius-Clapeyron slopes. As published, a
transformation proceeds while the temperature falls or rises, which is wrong if the stress changes as well. Here it
proceeds while p or q itself increases (elahinia2005). The share that remains to transform is multiplied by its ratio
over the step, so partial loops need no memory of reversals, as in ``smajax.plant.materials.brinson``.

Source: tanaka1986, liang1990, elahinia2005.
"""

import abc
from typing import Any

import jax
import jax.numpy as jnp
from jaxtyping import Array, Float

from smajax.numerics.nonsmooth import clip
from smajax.plant.materials.base import NO_PROGRESS, AbstractMaterial, Fractions
from smajax.plant.materials.cosine_kinetics import DEFAULT_SMOOTHING


class AbstractOneFraction(AbstractMaterial):
    """Base class of the laws with one martensite fraction; ``remainder`` is the kinetics of a law.

    Kinetics that are a function of the progress from start to finish are easier to write in ``AbstractBandKinetics``.
    """

    @abc.abstractmethod
    def remainder(self, start: Float[Array, "..."], end: Float[Array, "..."]) -> Float[Array, "..."]:
        """Compute the share that remains to transform at the end of a step over that at its start.

        Args:
            start: Progress p or q at the start of the step; any number, also far below 0 and far above 1.
            end: Progress at the end, larger than at the start.

        Returns:
            The ratio, which has to be finite, with a finite derivative, for all such numbers.
        """

    def evolve(self, fractions: Fractions, temperature: tuple[Any, ...], stress: tuple[Any, ...]) -> Fractions:
        """Advance the fractions over a step: the reverse transformation first, then the forward one.

        Args:
            fractions: Fractions at the start.
            temperature: Temperatures at start and end, degC.
            stress: Stresses at start and end, Pa.

        Returns:
            Fractions at the end.
        """
        before, after = (self._progress(t, s) for t, s in zip(temperature, stress, strict=True))
        reverse, forward = (
            jnp.where(a > b + NO_PROGRESS, self.remainder(b, a), 1.0) for b, a in zip(before, after, strict=True)
        )
        detwinned, twinned = fractions.detwinned * reverse, fractions.twinned * reverse
        return Fractions(1.0 - twinned - (1.0 - detwinned - twinned) * forward, twinned)

    def _progress(self, temperature: jax.Array, stress: jax.Array) -> tuple[jax.Array, jax.Array]:
        """Progress q of the reverse and p of the forward transformation: 0 at the start, 1 at the finish."""
        forward = self.forward_start + stress * (1.0 / self.clausius_clapeyron_martensite) - temperature
        return (
            self._reverse_progress(temperature, stress),
            forward * (1.0 / (self.martensite_start - self.martensite_finish)),
        )


class AbstractBandKinetics(AbstractOneFraction):
    """Base class of laws with one martensite fraction that transform between start and finish temperature alone.

    A law adds one function, ``remaining_share``, and its own parameters.
    """

    @abc.abstractmethod
    def remaining_share(self, progress: Float[Array, "..."]) -> Float[Array, "..."]:
        """Compute the share f that remains to transform: 1 at progress 0, 0 at progress 1, and falling in between.

        Args:
            progress: Progress p or q through the band of the transformation, 0 to 1.
        """

    def remainder(self, start: Float[Array, "..."], end: Float[Array, "..."]) -> Float[Array, "..."]:
        """Compute f(end) / f(start), with f limited to at least ``DEFAULT_SMOOTHING`` so that the ratio is finite."""
        after, before = (
            DEFAULT_SMOOTHING + (1.0 - DEFAULT_SMOOTHING) * self.remaining_share(clip(progress, 0.0, 1.0))
            for progress in (end, start)
        )
        return after / before
