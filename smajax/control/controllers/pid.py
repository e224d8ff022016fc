"""PID controller in parallel form, with a filtered derivative, output saturation and anti-windup.

    u = K_p e + K_i int e dt + K_d d,     T_f d' + d = e'  (or -y')

sampled by the rectangle rule and backward differences. Anti-windup by conditional integration: while the output is
saturated, the integral does not grow in the direction of the saturation.

Source: astrom1995, chapter 3 (discretisation, derivative filter, conditional integration).
"""

from typing import Literal, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Float

from smajax.control.controllers.base import AbstractController
from smajax.numerics.nonsmooth import clip
from smajax.parameters import parameter


class PIDState(NamedTuple):
    """State of a PID, scalars.

    ``integral`` is in the unit of the command; ``last_signal`` is the differentiated signal at the last sample (the
    error or minus the value), ``derivative`` its filtered rate of change.
    """

    integral: Float[Array, ""]
    last_signal: Float[Array, ""]
    derivative: Float[Array, ""]


class PID(AbstractController):
    """PID controller in parallel form; with ``derivative_on = "value"`` a jump of the reference gives no kick."""

    kp: jax.Array = parameter("u/y", "proportional gain", 0.0)
    ki: jax.Array = parameter("u/y/s", "integral gain", 0.0, default=0.0)
    kd: jax.Array = parameter("u s/y", "derivative gain", 0.0, default=0.0)
    filter_time: jax.Array = parameter("s", "time constant of the derivative's filter", 0.0, default=0.0)
    lower: jax.Array = parameter("u", "least output", default=0.0)
    upper: jax.Array = parameter("u", "largest output", default=1.0)
    period: float = eqx.field(static=True, kw_only=True)
    derivative_on: Literal["error", "value"] = eqx.field(static=True, kw_only=True, default="error")

    @property
    def inner(self) -> "PID":
        """The controller itself."""
        return self

    def reset(self, reference: Float[Array, ""], value: Float[Array, ""]) -> PIDState:
        """Return the state at rest: no integral and no derivative."""
        return PIDState(jnp.zeros(()), self._differentiated(reference, value), jnp.zeros(()))

    def step(
        self, state: PIDState, reference: Float[Array, ""], value: Float[Array, ""]
    ) -> tuple[PIDState, Float[Array, ""]]:
        """Take one sample within the controller's own limits; returns the state and the command."""
        return self.step_within(state, reference, value, self.lower, self.upper)

    def step_within(
        self,
        state: PIDState,
        reference: Float[Array, ""],
        value: Float[Array, ""],
        lower: Float[Array, ""],
        upper: Float[Array, ""],
    ) -> tuple[PIDState, Float[Array, ""]]:
        """Take one sample between other limits, for instance where a feedforward uses a part of the actuator's range.

        Args:
            state: State after the previous sample.
            reference: Reference at this sample.
            value: Measured value at this sample.
            lower: Smallest output of this sample.
            upper: Largest output of this sample.

        Returns:
            The state after this sample, and the saturated output.
        """
        derivative = self.filtered_derivative(state, reference, value)
        error = reference - value
        integral = state.integral + self.ki * error * self.period
        unsaturated = self.kp * error + integral + self.kd * derivative
        output = clip(unsaturated, lower, upper)
        winds_up = ((unsaturated > upper) & (integral > state.integral)) | (
            (unsaturated < lower) & (integral < state.integral)
        )
        signal = self._differentiated(reference, value)
        return PIDState(jnp.where(winds_up, state.integral, integral), signal, derivative), output

    def filtered_derivative(
        self, state: PIDState, reference: Float[Array, ""], value: Float[Array, ""]
    ) -> Float[Array, ""]:
        """Return the filtered derivative after this sample, in the channel's unit per second."""
        return (self.filter_time * state.derivative + self._differentiated(reference, value) - state.last_signal) / (
            self.filter_time + self.period
        )

    def _differentiated(self, reference: jax.Array, value: jax.Array) -> jax.Array:
        return reference - value if self.derivative_on == "error" else -value
