"""Kalman filter of an angle from a gyroscope and a tilt sensor.

    theta' = rate - bias + w_r,     bias' = w_b,     tilt = theta + v

With x = (theta, bias), h = (1, 0) and a period dt, one sample is a prediction and a correction:

    x- = A x + (dt rate, 0)     P- = A P A^T + Q     A = [[1, -dt], [0, 1]]
    K = P- h / (h^T P- h + r)   x = x- + K (tilt - h^T x-)     P = P- - K h^T P-

Source: kalman1960; ali2026 (names such a filter without its equations, which are derived here).
"""

import math
from typing import NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
from jax.typing import ArrayLike
from jaxtyping import Array, Float

# Default standard deviations at the start, of the angle (rad) and of the gyroscope's bias (rad/s). Chosen by trial;
# tests/unit/control/test_observers.py holds them.
_ANGLE_DEVIATION = 0.1
_BIAS_DEVIATION = 0.02


class AngleState(NamedTuple):
    """State of the filter.

    Attributes:
        mean: Mean of angle (rad) and bias (rad/s).
        covariance: Covariance of both.
    """

    mean: Float[Array, " 2"]
    covariance: Float[Array, "2 2"]


class AngleKalmanFilter(eqx.Module):
    """Kalman filter of an angle from a rate gyroscope with a drifting bias and the tilt of an accelerometer.

    With the rate alone the angle is not observable: it drifts with the bias.

    Attributes:
        rate_noise: Standard deviation of the gyroscope's noise, a scalar, rad/s.
        bias_process_noise: Standard deviation of the random walk of its bias, a scalar, rad/s per root second.
        tilt_noise: Standard deviation of the tilt's noise, a scalar, rad.
        period: Period of the samples, s.
    """

    rate_noise: jax.Array
    bias_process_noise: jax.Array
    tilt_noise: jax.Array
    period: float = eqx.field(static=True)

    def reset(
        self,
        angle: ArrayLike,
        *,
        angle_deviation: float = _ANGLE_DEVIATION,
        bias_deviation: float = _BIAS_DEVIATION,
    ) -> AngleState:
        """Return the state at the start, with a mean bias of 0.

        Args:
            angle: Mean angle, a scalar, rad.
            angle_deviation: Standard deviation of the angle, rad.
            bias_deviation: Standard deviation of the bias, rad/s.
        """
        return AngleState(
            jnp.stack([jnp.asarray(angle, jnp.float64), jnp.zeros(())]),
            jnp.diag(jnp.asarray([angle_deviation, bias_deviation]) ** 2),
        )

    def step(self, state: AngleState, rate: Float[Array, ""], tilt: Float[Array, ""] | float = math.nan) -> AngleState:
        """Take one sample: predict by the rate, then correct by the tilt.

        Args:
            state: State after the previous sample.
            rate: Measured rate, rad/s.
            tilt: Measured angle, rad; NaN: not measured at this sample.
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
