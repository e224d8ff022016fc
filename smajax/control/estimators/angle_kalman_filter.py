"""Kalman filter of an angle from a gyroscope and a tilt sensor.

    theta' = rate - bias + w_r      bias' = w_b      tilt = theta + v

Source: kalman1960; ali2026 names such a filter without its equations, which are derived here.
"""

import math
from typing import NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Float


class AngleState(NamedTuple):
    """Mean of angle (rad) and bias (rad/s), and their covariance."""

    mean: Float[Array, " 2"]
    covariance: Float[Array, "2 2"]


class AngleKalmanFilter(eqx.Module):
    """Kalman filter of an angle from a rate gyroscope with a drifting bias and the tilt of an accelerometer.

    ``rate_noise`` is the standard deviation of the gyroscope (rad/s), ``bias_process_noise`` that of the random walk of
    its bias (rad/s per root second), ``tilt_noise`` that of the tilt (rad). With the rate alone the angle is not
    observable: it drifts with the bias.
    """

    rate_noise: jax.Array
    bias_process_noise: jax.Array
    tilt_noise: jax.Array
    period: float = eqx.field(static=True)

    def reset(self, angle: jax.Array, *, angle_deviation: float = 0.1, bias_deviation: float = 0.02) -> AngleState:
        """Return the state at the start, with no bias.

        Args:
            angle: Angle, rad, a scalar.
            angle_deviation: Standard deviation of the angle, rad.
            bias_deviation: Standard deviation of the bias, rad/s.
        """
        return AngleState(
            jnp.stack([jnp.asarray(angle, jnp.float64), jnp.zeros(())]),
            jnp.diag(jnp.asarray([angle_deviation, bias_deviation]) ** 2),
        )

    def step(self, state: AngleState, rate: jax.Array, tilt: jax.Array | float = math.nan) -> AngleState:
        """Take one sample: prediction by the rate, correction by the tilt.

        Args:
            state: State after the previous sample.
            rate: Measured rate, rad/s, a scalar.
            tilt: Measured angle, rad, a scalar; NaN: not measured at this sample.
        """
        dt = self.period
        transition = jnp.asarray([[1.0, -dt], [0.0, 1.0]])
        mean = transition @ state.mean + jnp.stack([dt * rate, jnp.zeros(())])
        process_noise = jnp.diag(jnp.stack([(dt * self.rate_noise) ** 2, dt * self.bias_process_noise**2]))
        covariance = transition @ state.covariance @ transition.T + process_noise
        missing = jnp.isnan(tilt)
        gain = jnp.where(missing, 0.0, covariance[:, 0] / (covariance[0, 0] + self.tilt_noise**2))
        mean = mean + gain * jnp.where(missing, 0.0, tilt - mean[0])
        return AngleState(mean, covariance - jnp.outer(gain, covariance[0]))
