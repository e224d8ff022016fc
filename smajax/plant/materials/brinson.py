"""Brinson's law in one dimension with corrected kinetics, in a form that needs no memory of reversals.

The published kinetics (brinson1993, chung2007) give the fractions as cosines of a driving variable and restart from the
values at the last reversal. Written as products, each branch says that a *remaining share* falls from 1 at the start of
its band to 0 at the finish:

    reverse     xi               by  f(T - A_s - sigma / C_A)                       over  A_f - A_s
    detwinning  1 - xi_s         by  f(sigma - C_M max(T - M_s, 0) - sigma_s)       over  sigma_f - sigma_s
    twinned     austenite        by  f(M_s - T)                                     over  M_s - M_f

with f(a) = cos^2(pi/2 a/width) and the Clausius-Clapeyron slopes C_A and C_M. The share that remains after a step is
that before it times f(a_1) / f(a_0) if the driving variable rose, and unchanged if it did not. The start of the branch
cancels, so that partial loops need no history, and a step may cross any number of band edges without error. Detwinning
consumes austenite and twinned martensite alike; this is Chung's correction, with which the fractions cannot exceed 1
(Brinson's own expression reaches 1.8).

Source: brinson1993, equations 1 and 14 to 16; chung2007 for the twinned branch below M_s.
"""

from dataclasses import KW_ONLY

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Float

from smajax.numerics.nonsmooth import maximum
from smajax.parameters import parameter
from smajax.plant.materials.base import AbstractMaterial, Fractions, mix
from smajax.plant.materials.cosine_kinetics import DEFAULT_SMOOTHING, cosine_remainder

# Share of its band. A driving variable that moved by less did not move: where nothing changes over a step, rounding
# would otherwise choose the branch, possibly another one for the derivative than for the value. Far above rounding
# (1e-16), far below any effect on a fraction.
_NO_PROGRESS = 1e-12


class Brinson(AbstractMaterial):
    """Brinson's law: two kinds of martensite, cosine kinetics in the relative form (see the module's text)."""

    _: KW_ONLY
    detwinning_start_stress: jax.Array = parameter("Pa", "stress at which detwinning starts at or below M_s", 0.0, 1e9)
    detwinning_finish_stress: jax.Array = parameter(
        "Pa", "stress at which detwinning is complete at or below M_s", 0.0, 2e9
    )
    smoothing: float = eqx.field(static=True, default=DEFAULT_SMOOTHING)

    def evolve(self, fractions: Fractions, temperature: tuple, stress: tuple) -> Fractions:
        """Advance the fractions over a step: the reverse branch first, then the two forward branches, which commute.

        Args:
            fractions: Fractions at the start.
            temperature: Temperatures in degC at start and end.
            stress: Stresses in Pa at start and end.
        """
        before, after = (self._progress(t, s) for t, s in zip(temperature, stress, strict=True))
        reverse, detwinning, twinning = (
            jnp.where(
                a > b + _NO_PROGRESS, cosine_remainder(a, self.smoothing) / cosine_remainder(b, self.smoothing), 1.0
            )
            for b, a in zip(before, after, strict=True)
        )
        detwinned, twinned = fractions.detwinned * reverse, fractions.twinned * reverse
        austenite = (1.0 - detwinned - twinned) * detwinning * twinning
        undetwinned = (1.0 - detwinned) * detwinning
        return Fractions(1.0 - undetwinned, undetwinned - austenite)

    def _progress(self, temperature: jax.Array, stress: jax.Array) -> tuple[jax.Array, jax.Array, jax.Array]:
        """Progress of the three branches' driving variables through their bands: 0 at the start, 1 at the finish."""
        above = temperature - self.martensite_start - self.martensite_shift
        reverse = (
            temperature
            - self.austenite_start
            - self.austenite_shift
            - stress * (1.0 / self.clausius_clapeyron_austenite)
        )
        detwinning = stress - self.clausius_clapeyron_martensite * maximum(above, 0.0) - self.detwinning_start_stress
        # The compiler moves reciprocals of parameters out of the loop over time steps, but not quotients by them.
        return (
            reverse * (1.0 / (self.austenite_finish - self.austenite_start)),
            detwinning * (1.0 / (self.detwinning_finish_stress - self.detwinning_start_stress)),
            -above * (1.0 / (self.martensite_start - self.martensite_finish)),
        )

    def current_transformation_strain(self, stress: Float[Array, "..."]) -> Float[Array, "..."]:
        """Return eps_L at every stress, since martensite that grows under a load is detwinned by it."""
        return jnp.broadcast_to(self.max_transformation_strain, jnp.shape(stress))

    def modulus(self, fractions: Fractions) -> Float[Array, "..."]:
        """Compute Young's modulus in Pa, linear in the martensite fraction. Source: brinson1993, equation 8."""
        return mix(fractions.martensite, self.modulus_austenite, self.modulus_martensite)
