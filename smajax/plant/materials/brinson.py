"""Brinson's law in one dimension with corrected kinetics, in a relative form that needs no memory of reversals.

Martensite is detwinned (xi_s) or twinned (xi_t). The published kinetics give the fractions as cosines of a driving
variable, and start from the values (xi_s0, ...) at the last reversal. The conversion to detwinned martensite, for
example, is

    xi_s = (1 - xi_s0) / 2 cos(pi / (sigma_s - sigma_f) (sigma - sigma_f - C_M (T - M_s))) + (1 + xi_s0) / 2

In other words, the share 1 - xi_s that remains to transform is (1 - xi_s0) f(p). Here f(p) = cos^2(pi/2 p) falls from 1
to 0, and p is the progress of the driving variable through its band, from 0 at the start to 1 at the finish. With the
Clausius-Clapeyron slopes C_A and C_M, the three branches are

    branch        share that remains    progress p
    reverse       xi_s and xi_t         (T - A_s - sigma / C_A) / (A_f - A_s)
    detwinning    1 - xi_s              (sigma - C_M max(T - M_s, 0) - sigma_s) / (sigma_f - sigma_s)
    twinning      1 - xi_s - xi_t       (M_s - T) / (M_s - M_f)

Over a step from p_0 to p_1 the share is multiplied by f(p_1) / f(p_0) if the progress increased, and is unchanged
otherwise. The value at the last reversal cancels: partial loops need no history, and a step may cross any number of
band edges without error. Detwinning consumes austenite and twinned martensite in proportion. This is Chung's
correction, with which the fractions cannot exceed 1 (Brinson's expression reaches 1.8).

Source: brinson1993, equations 1 and 14 to 16; chung2007 for the twinned branch below M_s.
"""

from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp

from smajax.numerics.nonsmooth import maximum
from smajax.parameters import parameter
from smajax.plant.materials.base import NO_PROGRESS, AbstractMaterial, Fractions
from smajax.plant.materials.cosine_kinetics import DEFAULT_SMOOTHING, cosine_remainder


class Brinson(AbstractMaterial):
    """Brinson's law: detwinned and twinned martensite, with cosine kinetics in relative form.

    The equations are in the text of the module, ``smajax.plant.materials.brinson``.

    Source: brinson1993, chung2007.
    """

    detwinning_start_stress: jax.Array = parameter("Pa", "stress at which detwinning starts at or below M_s", 0.0, 1e9)
    detwinning_finish_stress: jax.Array = parameter(
        "Pa", "stress at which detwinning is complete at or below M_s", 0.0, 2e9
    )
    smoothing: float = eqx.field(static=True, default=DEFAULT_SMOOTHING)

    def with_bands(self, reverse: tuple[Any, Any], forward: tuple[Any, Any]) -> "Brinson":
        """Return the law of a grain: above M_s its detwinning band is shifted and narrower like its twinning band.

        Args:
            reverse: Shift of the middle between A_s and A_f, and distance of the two, both over the distance of this
                law.
            forward: The same for M_f and M_s, and for the critical stresses at a temperature above M_s.
        """
        grain = super().with_bands(reverse, forward)
        shift, width = forward
        stresses = self.detwinning_start_stress, self.detwinning_finish_stress
        band = stresses[1] - stresses[0]
        # Above M_s the critical stresses rise by C_M (T - M_s), with the M_s of the grain.
        rise = self.clausius_clapeyron_martensite * (grain.martensite_start - self.martensite_start)
        middle = 0.5 * (stresses[0] + stresses[1]) + rise - shift * band
        return eqx.tree_at(
            lambda law: (law.detwinning_start_stress, law.detwinning_finish_stress),
            grain,
            (middle - 0.5 * width * band, middle + 0.5 * width * band),
        )

    def evolve(self, fractions: Fractions, temperature: tuple[Any, ...], stress: tuple[Any, ...]) -> Fractions:
        """Advance the fractions over a step: the reverse branch first, then the two forward branches, which commute.

        Args:
            fractions: Fractions at the start.
            temperature: Temperatures at start and end, degC.
            stress: Stresses at start and end, Pa.

        Returns:
            Fractions at the end.
        """
        before, after = (self._progress(t, s) for t, s in zip(temperature, stress, strict=True))
        reverse, detwinning, twinning = (
            jnp.where(
                a > b + NO_PROGRESS, cosine_remainder(a, self.smoothing) / cosine_remainder(b, self.smoothing), 1.0
            )
            for b, a in zip(before, after, strict=True)
        )
        detwinned, twinned = fractions.detwinned * reverse, fractions.twinned * reverse
        austenite = (1.0 - detwinned - twinned) * detwinning * twinning
        undetwinned = (1.0 - detwinned) * detwinning
        return Fractions(1.0 - undetwinned, undetwinned - austenite)

    def _progress(self, temperature: jax.Array, stress: jax.Array) -> tuple[jax.Array, jax.Array, jax.Array]:
        """Progress p of the reverse, the detwinning and the twinning branch: 0 at the start, 1 at the finish."""
        above = temperature - self.martensite_start - self.martensite_shift
        detwinning = stress - self.clausius_clapeyron_martensite * maximum(above, 0.0) - self.detwinning_start_stress
        return (
            self._reverse_progress(temperature, stress),
            detwinning * (1.0 / (self.detwinning_finish_stress - self.detwinning_start_stress)),
            -above * (1.0 / (self.martensite_start - self.martensite_finish)),
        )
