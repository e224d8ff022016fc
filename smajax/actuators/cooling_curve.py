"""Result of a cooling: temperature of the hottest wire over time, and the heat that is stored and lost."""

from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
from jaxtyping import Array, Float

# Bisections of a step, after which the bracket is at rounding: 2^-60 of the step is below double precision.
_BISECTIONS = 60


class CoolingCurve(NamedTuple):
    """Cooling of a cross-section.

    Attributes:
        time: Times of the steps, shape ``(t,)``, s; the first is 0.
        hottest: Temperature at the centre of the hottest wire, shape ``(t,)``, degC.
        rate: Its rate of change, shape ``(t,)``, K/s.
        stored: Heat above ambient per length in half the section, shape ``(t,)``, J/m.
        lost: Heat lost to the air since the start per length of half the section, shape ``(t,)``, J/m.
        stage_ends: Ends of the stages, shape ``(s,)``, s.
        temperatures: Temperatures of all cells at the ends of the stages, shape ``(s, c, r)``, degC.
    """

    time: jax.Array
    hottest: jax.Array
    rate: jax.Array
    stored: jax.Array
    lost: jax.Array
    stage_ends: jax.Array
    temperatures: jax.Array

    def temperature_at(self, time: Float[Array, ""] | float) -> Float[Array, ""]:
        """Compute the temperature of the hottest wire at a time, by cubic Hermite interpolation between the steps.

        Args:
            time: Time since the start of the cooling, s.

        Returns:
            Temperature in degC.
        """
        k = jnp.clip(jnp.searchsorted(self.time, time, side="right") - 1, 0, len(self.time) - 2)
        return _hottest_within_step(self, k, (time - self.time[k]) / (self.time[k + 1] - self.time[k]))

    def time_to_reach(self, target: Float[Array, ""] | float) -> Float[Array, ""]:
        """Compute the time at which the hottest wire first cools to a temperature.

        Args:
            target: Temperature, degC.

        Returns:
            Time since the start of the cooling in s; infinite if it is later than the end of the curve.
        """
        is_below = self.hottest <= target
        k = jnp.maximum(jnp.argmax(is_below), 1) - 1
        step = self.time[k + 1] - self.time[k]

        def halve(_: jax.Array, ends: tuple[Any, ...]) -> tuple[Any, ...]:
            low, high = ends
            middle = 0.5 * (low + high)
            is_warm = _hottest_within_step(self, k, middle) > target
            return jnp.where(is_warm, middle, low), jnp.where(is_warm, high, middle)

        share = jax.lax.stop_gradient(jax.lax.fori_loop(0, _BISECTIONS, halve, (jnp.zeros(()), jnp.ones(())))[1])
        slope = jax.lax.stop_gradient(
            jax.grad(lambda s: _hottest_within_step(jax.lax.stop_gradient(self), k, s))(share)
        )
        # A Newton step, which carries the derivative.
        excess = _hottest_within_step(self, k, share) - target
        time = self.time[k] + step * (share - excess / jnp.where(slope < 0.0, slope, -1.0))
        time = jnp.where(is_below[0], 0.0, jnp.where(jnp.any(is_below), time, jnp.inf))
        return jnp.where(jnp.isnan(self.hottest[-1]), jnp.nan, time)


def _hottest_within_step(curve: CoolingCurve, k: jax.Array, share: jax.Array) -> jax.Array:
    """Hottest temperature at a share of 0..1 of step ``k``."""
    step, other = curve.time[k + 1] - curve.time[k], 1.0 - share
    ends = other**2 * (1.0 + 2.0 * share) * curve.hottest[k] + share**2 * (3.0 - 2.0 * share) * curve.hottest[k + 1]
    return ends + share * other * step * (other * curve.rate[k] - share * curve.rate[k + 1])
