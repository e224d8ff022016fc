"""Inertial measurement unit as the sensor of an angle: gyroscope, tilt sensor and Kalman filter."""

from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp

from smajax.control.estimators.angle_kalman_filter import AngleKalmanFilter, AngleState
from smajax.control.sensors.sensor_model import quantise


class ImuSensor(eqx.Module):
    """Sensor of an angle by an ``AngleKalmanFilter`` from a gyroscope and a tilt sensor on the moving link.

    The sensors have noise of standard deviation ``rate_noise`` (rad/s) and ``tilt_noise`` (rad), steps of
    ``rate_quantum`` and ``tilt_quantum`` (0: none), and the gyroscope a ``bias`` (rad/s). The draw of a sample is the
    noise of the tilt, and one sample later that of the gyroscope. The estimate arrives ``delay`` samples later. Apart
    from that, the response to the angle is 1, which ``smajax.control.analysis.margins`` uses.
    """

    filter: AngleKalmanFilter
    rate_noise: jax.Array
    tilt_noise: jax.Array
    bias: jax.Array
    rate_quantum: jax.Array = eqx.field(default=0.0, converter=jnp.asarray)
    tilt_quantum: jax.Array = eqx.field(default=0.0, converter=jnp.asarray)
    delay: int = eqx.field(static=True, default=0)

    @property
    def noise(self) -> jax.Array:
        """Standard deviation of the tilt's noise, rad."""
        return self.tilt_noise

    def reset(self, value: jax.Array) -> tuple[AngleState, jax.Array, jax.Array, jax.Array]:
        """Return the state at rest: filter, last angle, last draw (0), and delayed angles, oldest first."""
        return (
            self.filter.reset(value),
            jnp.asarray(value, jnp.float64),
            jnp.zeros(()),
            jnp.full(self.delay, value, jnp.float64),
        )

    def step(
        self, state: tuple[AngleState, jax.Array, jax.Array, jax.Array], value: jax.Array, draw: jax.Array
    ) -> tuple[Any, jax.Array]:
        """Take one sample.

        Args:
            state: State after the previous sample.
            value: True angle, rad, a scalar.
            draw: Standard normal number of this sample, a scalar.

        Returns:
            The state after this sample, and the estimated angle, delayed.
        """
        filter_state, last_value, last_draw, delayed = state
        rate = quantise(
            (value - last_value) / self.filter.period + self.bias + self.rate_noise * last_draw, self.rate_quantum
        )
        tilt = quantise(value + self.tilt_noise * draw, self.tilt_quantum)
        filter_state = self.filter.step(filter_state, rate, tilt)
        angles = jnp.append(delayed, filter_state.mean[0])
        return (filter_state, value, jnp.asarray(draw, jnp.float64), angles[1:]), angles[0]
