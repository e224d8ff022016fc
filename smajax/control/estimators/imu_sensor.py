"""Inertial measurement unit as the sensor of an angle: gyroscope, tilt sensor and Kalman filter."""

from typing import NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Float

from smajax.control.estimators.angle_kalman_filter import AngleKalmanFilter, AngleState
from smajax.control.sensors.base import AbstractSensor
from smajax.control.sensors.sensor_model import quantise


class ImuState(NamedTuple):
    """State of the sensor.

    Attributes:
        filter: State of the Kalman filter.
        last_angle: Exact angle at the last sample, a scalar, rad.
        last_draw: Standard normal number of the last sample, a scalar.
        delayed: Estimates that are still delayed, oldest first, shape ``(delay,)``, rad.
    """

    filter: AngleState
    last_angle: jax.Array
    last_draw: jax.Array
    delayed: jax.Array


class ImuSensor(AbstractSensor):
    """Sensor of an angle by an ``AngleKalmanFilter`` from a gyroscope and a tilt sensor on the moving link.

    The draw of a sample is the noise of the tilt, and one sample later that of the gyroscope.

    Attributes:
        filter: The Kalman filter.
        rate_noise: Standard deviation of the gyroscope's noise, a scalar, rad/s.
        tilt_noise: Standard deviation of the tilt's noise, a scalar, rad.
        bias: Bias of the gyroscope, a scalar, rad/s.
        rate_quantum: Step of the gyroscope's quantisation, a scalar, rad/s; 0: none.
        tilt_quantum: Step of the tilt's quantisation, a scalar, rad; 0: none.
        delay: Delay of the estimate, samples.
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
        """Standard deviation of the tilt's noise, a scalar, rad."""
        return self.tilt_noise

    @property
    def sampling_period(self) -> float:
        """Period of the samples, s: that of the filter."""
        return self.filter.period

    def reset(self, value: Float[Array, ""]) -> ImuState:
        """Return the state of a sensor whose angle has been ``value``, in rad."""
        return ImuState(
            self.filter.reset(value),
            jnp.asarray(value, jnp.float64),
            jnp.zeros(()),
            jnp.full(self.delay, value, jnp.float64),
        )

    def step(
        self, state: ImuState, value: Float[Array, ""], draw: Float[Array, ""]
    ) -> tuple[ImuState, Float[Array, ""]]:
        """Take one sample.

        Args:
            state: State after the previous sample.
            value: Exact angle, rad.
            draw: Standard normal number of this sample.

        Returns:
            The state after this sample, and the estimated angle, delayed, rad.
        """
        filter_state, last_angle, last_draw, delayed = state
        rate = quantise(
            (value - last_angle) / self.filter.period + self.bias + self.rate_noise * last_draw, self.rate_quantum
        )
        tilt = quantise(value + self.tilt_noise * draw, self.tilt_quantum)
        filter_state = self.filter.step(filter_state, rate, tilt)
        angles = jnp.append(delayed, filter_state.mean[0])
        return ImuState(filter_state, value, jnp.asarray(draw, jnp.float64), angles[1:]), angles[0]
