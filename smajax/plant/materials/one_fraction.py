"""Laws with one martensite fraction, all of which carries strain: those of Tanaka and of Liang and Rogers.

    Tanaka          1 - xi = 0.01^p          xi = 0.01^q          (99 per cent transformed at the finish)
    Liang, Rogers   1 - xi = cos^2(pi/2 p)   xi = cos^2(pi/2 q)

with p = (M_s + sigma / C_M - T) / (M_s - M_f) in the forward and q = (T - A_s - sigma / C_A) / (A_f - A_s) in the
reverse transformation. As published, a transformation proceeds while the temperature falls or rises, which is wrong
where the stress changes as well. Here it proceeds while p or q itself rises (elahinia2005). The share that remains to
transform is multiplied by its ratio over the step, so that partial loops need no memory, as in ``brinson.py``.

Source: tanaka1986, liang1990, elahinia2005.
"""

import jax
import jax.numpy as jnp
from jaxtyping import Array, Float

from smajax.plant.materials.base import AbstractMaterial, Fractions, mix

# Share of its band. A driving variable that moved by less did not move, as in ``brinson.py``.
_NO_PROGRESS = 1e-12


class AbstractOneFraction(AbstractMaterial):
    """Base class of the laws with one martensite fraction; ``remainder`` is the kinetics of a law."""

    def remainder(self, start: Float[Array, "..."], end: Float[Array, "..."]) -> Float[Array, "..."]:
        """Compute the ratio of the shares that remain to transform at the end and at the start of a step.

        Args:
            start: Progress p or q at the start.
            end: Progress at the end, larger than at the start.
        """
        raise NotImplementedError

    def evolve(self, fractions: Fractions, temperature: tuple, stress: tuple) -> Fractions:
        """Advance the fractions over a step: the reverse transformation first, then the forward one.

        Args:
            fractions: Fractions at the start.
            temperature: Temperatures in degC at start and end.
            stress: Stresses in Pa at start and end.
        """
        before, after = (self._progress(t, s) for t, s in zip(temperature, stress, strict=True))
        reverse, forward = (
            jnp.where(a > b + _NO_PROGRESS, self.remainder(b, a), 1.0) for b, a in zip(before, after, strict=True)
        )
        detwinned, twinned = fractions.detwinned * reverse, fractions.twinned * reverse
        return Fractions(1.0 - twinned - (1.0 - detwinned - twinned) * forward, twinned)

    def _progress(self, temperature: jax.Array, stress: jax.Array) -> tuple[jax.Array, jax.Array]:
        """Progress q of the reverse and p of the forward transformation: 0 at the start, 1 at the finish."""
        reverse = (
            temperature
            - self.austenite_start
            - self.austenite_shift
            - stress * (1.0 / self.clausius_clapeyron_austenite)
        )
        forward = self.forward_start + stress * (1.0 / self.clausius_clapeyron_martensite) - temperature
        return (
            reverse * (1.0 / (self.austenite_finish - self.austenite_start)),
            forward * (1.0 / (self.martensite_start - self.martensite_finish)),
        )

    def current_transformation_strain(self, stress: Float[Array, "..."]) -> Float[Array, "..."]:
        """Return eps_L at every stress."""
        return jnp.broadcast_to(self.max_transformation_strain, jnp.shape(stress))

    def modulus(self, fractions: Fractions) -> Float[Array, "..."]:
        """Compute Young's modulus in Pa, linear in the martensite fraction."""
        return mix(fractions.martensite, self.modulus_austenite, self.modulus_martensite)
