"""The PID controller in parallel form, with a filtered derivative, saturation and anti-windup.

    u = K_p e + K_i int e dt + K_d d,     T_f d' + d = e'  (or -y')

sampled by the rectangle rule and backward differences. The output is cut to its limits; while it is, the integral does not grow in that
direction (conditional integration), so that it has nothing to unwind.
"""

from typing import Literal, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp

from smajax.control.controller import AbstractController
from smajax.kinks import within
from smajax.parameters import parameter


class PIDState(NamedTuple):
    """``integral`` in the unit of the command, ``last`` error or value and ``slope``, its filtered rate of change; scalars."""

    integral: jax.Array
    last: jax.Array
    slope: jax.Array


class PID(AbstractController):
    """The controller of the module's text.

    ``derivative_on`` the error a step of the reference kicks the output, on the value it does not.
    """

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
        """See ``AbstractController.inner``."""
        return self

    def reset(self, reference: jax.Array, value: jax.Array) -> PIDState:
        """See ``AbstractController.reset``."""
        return PIDState(jnp.zeros(()), self._seen(reference, value), jnp.zeros(()))

    def step(self, state: PIDState, reference: jax.Array, value: jax.Array) -> tuple[PIDState, jax.Array]:
        """See ``AbstractController.step``."""
        return self.within(state, reference, value, self.lower, self.upper)

    def within(
        self, state: PIDState, reference: jax.Array, value: jax.Array, lower: jax.Array, upper: jax.Array
    ) -> tuple[PIDState, jax.Array]:
        """As ``step``, between other limits: what else acts on the actuator leaves the controller less."""
        slope = self.slope(state, reference, value)
        error = reference - value
        grown = state.integral + self.ki * error * self.period
        wanted = self.kp * error + grown + self.kd * slope
        output = within(wanted, lower, upper)
        pushes = ((wanted > upper) & (grown > state.integral)) | ((wanted < lower) & (grown < state.integral))
        return PIDState(jnp.where(pushes, state.integral, grown), self._seen(reference, value), slope), output

    def slope(self, state: PIDState, reference: jax.Array, value: jax.Array) -> jax.Array:
        """The filtered derivative after this sample."""
        return (self.filter_time * state.slope + self._seen(reference, value) - state.last) / (self.filter_time + self.period)

    def _seen(self, reference: jax.Array, value: jax.Array) -> jax.Array:
        return reference - value if self.derivative_on == "error" else -value
