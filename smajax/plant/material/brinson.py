"""Brinson's one-dimensional law with corrected kinetics, written so that it needs no memory of where a transformation began.

The published kinetics (Brinson 1993; Chung, Heo, Lee 2007) give the fractions as cosines of a driving variable and restart from the values
at the last reversal. Multiplied out, each branch says that a *remaining share* falls from 1 at the start of its band to 0 at the finish:

    reverse     xi               by  f(T - A_s - sigma / C_A)                       over  A_f - A_s
    detwinning  1 - xi_s         by  f(sigma - C_M max(T - M_s, 0) - sigma_s)       over  sigma_f - sigma_s
    twinned     austenite        by  f(M_s - T)                                     over  M_s - M_f

with f(a) = cos^2(pi/2 a/width). What remains after a step is what remained before it times f(a_1) / f(a_0) if the driving variable rose,
and unchanged if it did not. The start of the leg cancels, so partial loops need no history, and a step may cross any number of band edges
without error. Detwinning takes austenite and twinned martensite alike; this is Chung's correction, under which the fractions cannot pass 1
(Brinson's own expression reaches 1.8).

f is kept from reaching 0 by ``smoothing``: a share of that size never transforms, and the ratio and its derivatives stay finite at the
finish.
"""

import math
from dataclasses import KW_ONLY
from functools import partial

import equinox as eqx
import jax
import jax.numpy as jnp

from smajax.kinks import larger, within
from smajax.parameters import parameter
from smajax.plant.material.base import AbstractMaterial, Fractions, mix

# sin(pi/2 m) = m * P(m^2) on [0, 1], interpolated at the Chebyshev points of m^2, relative error below 5e-16. The library's cosine does not
# vectorise on a CPU: batches would take six times as long.
_SINE = (
    1.5707963267948963,
    -0.6459640975062273,
    0.0796926262457332,
    -0.004681754131665194,
    0.00016044117004586423,
    -3.598811286059924e-06,
    5.688354048912463e-08,
    -6.450375339764774e-10,
)

# A driving variable that moved by less, as a share of its band, did not move. Where nothing changes over a step, rounding would else pick
# the branch, and might pick another one for the derivative than for the value.
_STILL = 1e-12


def _sine(share: jax.Array) -> jax.Array:
    """sin(pi/2 share) for a share of 0..1."""
    square = share * share
    series = jnp.full_like(square, _SINE[-1])
    for coefficient in _SINE[-2::-1]:
        series = series * square + coefficient
    return share * series


@partial(jax.custom_jvp, nondiff_argnums=(1,))
def remaining(progress: jax.Array, smoothing: float) -> jax.Array:
    """Share left to transform, cos^2(pi/2 progress), for progress clipped to 0..1, and never below ``smoothing``."""
    sine = _sine(1.0 - within(progress, 0.0, 1.0))
    return smoothing + (1.0 - smoothing) * sine * sine


@remaining.defjvp
def _remaining_jvp(smoothing: float, primals: tuple, tangents: tuple) -> tuple[jax.Array, jax.Array]:
    """By hand, since the derivative of a cosine is a sine, and that of its series costs twice as much."""
    (progress,), (tangent,) = primals, tangents
    done = within(progress, 0.0, 1.0)
    sine, cosine = _sine(1.0 - done), _sine(done)
    slope = jnp.where((progress > 0.0) & (progress < 1.0), -(1.0 - smoothing) * math.pi * sine * cosine, 0.0)
    return smoothing + (1.0 - smoothing) * sine * sine, slope * tangent


class Brinson(AbstractMaterial):
    """Brinson's law: linear mixture of the phases, cosine kinetics in the relative form (see the module's text).

    Source: Brinson 1993 eq. 1, 14-16; Chung, Heo, Lee 2007 for the twinned branch below M_s.
    """

    _: KW_ONLY
    detwinning_start_stress: jax.Array = parameter("Pa", "stress at which detwinning starts at or below M_s", 0.0, 1e9)
    detwinning_finish_stress: jax.Array = parameter("Pa", "stress at which detwinning is complete at or below M_s", 0.0, 2e9)
    smoothing: float = eqx.field(static=True, default=1e-9)

    def evolve(self, fractions: Fractions, temperature: tuple, stress: tuple) -> Fractions:
        """See ``AbstractMaterial.evolve``; reverse transformation first, then the two forward branches, which commute."""
        before, after = (self._progress(t, s) for t, s in zip(temperature, stress, strict=True))
        reverse, detwinning, twinning = (
            jnp.where(a > b + _STILL, remaining(a, self.smoothing) / remaining(b, self.smoothing), 1.0)
            for b, a in zip(before, after, strict=True)
        )
        detwinned, twinned = fractions.detwinned * reverse, fractions.twinned * reverse
        austenite = (1.0 - detwinned - twinned) * detwinning * twinning
        undetwinned = (1.0 - detwinned) * detwinning
        return Fractions(1.0 - undetwinned, undetwinned - austenite)

    def _progress(self, temperature: jax.Array, stress: jax.Array) -> tuple[jax.Array, jax.Array, jax.Array]:
        """How far into their bands the driving variables of the three branches are: 0 at the start, 1 at the finish."""
        above = temperature - self.martensite_start - self.martensite_shift
        reverse = temperature - self.austenite_start - self.austenite_shift - stress * (1.0 / self.clausius_clapeyron_austenite)
        detwinning = stress - self.clausius_clapeyron_martensite * larger(above, 0.0) - self.detwinning_start_stress
        # Reciprocals of parameters leave the time loop; quotients by them would not.
        return (
            reverse * (1.0 / (self.austenite_finish - self.austenite_start)),
            detwinning * (1.0 / (self.detwinning_finish_stress - self.detwinning_start_stress)),
            -above * (1.0 / (self.martensite_start - self.martensite_finish)),
        )

    def grown_strain(self, stress: jax.Array) -> jax.Array:
        """See ``AbstractMaterial.grown_strain``: eps_L, since what grows under a load is detwinned by it."""
        return jnp.broadcast_to(self.max_strain, jnp.shape(stress))

    def modulus(self, fractions: Fractions) -> jax.Array:
        """Young's modulus, linear in the martensite fraction (Brinson 1993 eq. 8), Pa."""
        return mix(fractions.martensite, self.modulus_austenite, self.modulus_martensite)
