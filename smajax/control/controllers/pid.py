"""PID controller in parallel form, with a filtered derivative, output saturation and anti-windup.

    u = K_p e + I + K_d d,     I' = K_i e,     T_f d' + d = e'  (or -y'),     e = r - y

sampled with period h by the rectangle rule and backward differences,

    I_k = I_(k-1) + K_i h e_k
    d_k = (T_f d_(k-1) + e_k - e_(k-1)) / (T_f + h)
    u_k = K_p e_k + I_k + K_d d_k, limited to lower .. upper

Anti-windup by conditional integration: the integral keeps its value, I_k = I_(k-1), at a sample at which the output is
saturated and the integral would grow in the direction of the saturation.

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

    Attributes:
        integral: Integral term I, in the unit of the command.
        last_signal: Differentiated signal at the last sample (the error, or minus the value), in the channel's unit.
        derivative: Filtered derivative d of that signal, in the channel's unit per second.
    """

    integral: Float[Array, ""]
    last_signal: Float[Array, ""]
    derivative: Float[Array, ""]


class PID(AbstractController):
    """PID controller in parallel form, with a filtered derivative, output saturation and anti-windup.

    Attributes:
        kp: Proportional gain K_p.
        ki: Integral gain K_i.
        kd: Derivative gain K_d.
        filter_time: Time constant T_f of the derivative's filter, s.
        lower: Smallest output.
        upper: Largest output.
        period: Period h of the samples, s.
        derivative_on: Differentiated signal: the error, or minus the value, which avoids a kick of the output at a jump
            of the reference.
    """

    kp: jax.Array = parameter("u/y", "proportional gain", 0.0)
    ki: jax.Array = parameter("u/y/s", "integral gain", 0.0, default=0.0)
    kd: jax.Array = parameter("u s/y", "derivative gain", 0.0, default=0.0)
    filter_time: jax.Array = parameter("s", "time constant of the derivative's filter", 0.0, default=0.0)
    lower: jax.Array = parameter("u", "least output", default=0.0)
    upper: jax.Array = parameter("u", "largest output", default=1.0)
    period: float = eqx.field(static=True, kw_only=True)
    derivative_on: Literal["error", "value"] = eqx.field(static=True, kw_only=True, default="error")

    def reset(self, reference: Float[Array, ""], value: Float[Array, ""]) -> PIDState:
        """Return the state at rest: no integral and no derivative."""
        return PIDState(jnp.zeros(()), self._differentiated_signal(reference, value), jnp.zeros(()))

    def step(
        self, state: PIDState, reference: Float[Array, ""], value: Float[Array, ""]
    ) -> tuple[PIDState, Float[Array, ""]]:
        """Take one sample within the controller's own limits; return the state and the command."""
        return self.step_within(state, reference, value, self.lower, self.upper)

    def step_within(
        self,
        state: PIDState,
        reference: Float[Array, ""],
        value: Float[Array, ""],
        lower: Float[Array, ""],
        upper: Float[Array, ""],
    ) -> tuple[PIDState, Float[Array, ""]]:
        """Take one sample within other limits, for instance where a feedforward uses a part of the actuator's range.

        Args:
            state: State after the previous sample.
            reference: Reference at this sample, in the channel's unit.
            value: Measured value at this sample, in the channel's unit.
            lower: Smallest output at this sample.
            upper: Largest output at this sample.

        Returns:
            The state after this sample, and the saturated output.
        """
        derivative = self.filtered_derivative(state, reference, value)
        error = reference - value
        integral = state.integral + self.ki * error * self.period
        unsaturated = self.kp * error + integral + self.kd * derivative
        output = clip(unsaturated, lower, upper)
        integral = anti_windup(state.integral, integral, unsaturated, lower, upper)
        return PIDState(integral, self._differentiated_signal(reference, value), derivative), output

    def filtered_derivative(
        self, state: PIDState, reference: Float[Array, ""], value: Float[Array, ""]
    ) -> Float[Array, ""]:
        """Return the filtered derivative at this sample.

        Args:
            state: State after the previous sample.
            reference: Reference at this sample, in the channel's unit.
            value: Measured value at this sample, in the channel's unit.

        Returns:
            d_k = (T_f d_(k-1) + e_k - e_(k-1)) / (T_f + h), in the channel's unit per second.
        """
        signal = self._differentiated_signal(reference, value)
        return (self.filter_time * state.derivative + signal - state.last_signal) / (self.filter_time + self.period)

    def _differentiated_signal(self, reference: Float[Array, ""], value: Float[Array, ""]) -> Float[Array, ""]:
        return reference - value if self.derivative_on == "error" else -value


def anti_windup(
    integral: Float[Array, ""],
    next_integral: Float[Array, ""],
    unsaturated: Float[Array, ""],
    lower: Float[Array, ""],
    upper: Float[Array, ""],
) -> Float[Array, ""]:
    """Return the integral of a sample with anti-windup by conditional integration.

    Args:
        integral: Integral of the previous sample.
        next_integral: Integral of this sample without anti-windup.
        unsaturated: Output of this sample before saturation.
        lower: Smallest output.
        upper: Largest output.

    Returns:
        ``integral`` if the output is saturated and the integral would grow in the direction of the saturation, else
        ``next_integral``.

    Source: astrom1995, chapter 3 (conditional integration).
    """
    winds_up = ((unsaturated > upper) & (next_integral > integral)) | (
        (unsaturated < lower) & (next_integral < integral)
    )
    return jnp.where(winds_up, integral, next_integral)
