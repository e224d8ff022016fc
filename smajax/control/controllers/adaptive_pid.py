"""Adaptive PID: gains that change with the error from sample to sample.

    printed      K_p += g_p e       K_i += g_i K_i int e dt     K_d += g_d K_d de/dt
    gradient     K_p += g_p e e     K_i += g_i e int e dt       K_d += g_d e de/dt

The printed law is linear in the error, so that K_p is a second integral of the error. The gradient law (MIT rule) is
what the paper describes in words. Both keep each gain between 0 and a largest value.

Source: ali2026 (printed law); wittenmark1995, chapter 5 (MIT rule).
"""

from typing import Literal, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Float

from smajax.control.controllers.base import AbstractController
from smajax.control.controllers.pid import PID, PIDState
from smajax.numerics.nonsmooth import clip
from smajax.parameters import parameter


class AdaptiveState(NamedTuple):
    """State of an adaptive PID, scalars.

    Attributes:
        inner: State of the PID.
        error_integral: Integral of the error, channel unit times s.
        kp: Current proportional gain.
        ki: Current integral gain.
        kd: Current derivative gain.
    """

    inner: PIDState
    error_integral: Float[Array, ""]
    kp: Float[Array, ""]
    ki: Float[Array, ""]
    kd: Float[Array, ""]


class AdaptivePID(AbstractController):
    """PID whose gains are adapted at each sample.

    Attributes:
        pid: The PID with the start gains.
        rate_p: Adaptation rate of the proportional gain per sample.
        rate_i: Adaptation rate of the integral gain per sample.
        rate_d: Adaptation rate of the derivative gain per sample.
        growth: Upper bound of each gain, as a multiple of its start value.
        law: The printed law or the gradient law.
    """

    pid: PID
    rate_p: jax.Array = parameter(
        "1", "adaptation of the proportional gain per sample, in internal units", 0.0, default=0.0
    )
    rate_i: jax.Array = parameter(
        "1", "adaptation of the integral gain per sample, in internal units", 0.0, default=0.0
    )
    rate_d: jax.Array = parameter(
        "1", "adaptation of the derivative gain per sample, in internal units", 0.0, default=0.0
    )
    growth: float = eqx.field(static=True, default=10.0)
    law: Literal["printed", "gradient"] = eqx.field(static=True, default="gradient")

    @property
    def inner(self) -> PID:
        """The PID with the start gains."""
        return self.pid

    def reset(self, reference: Float[Array, ""], value: Float[Array, ""]) -> AdaptiveState:
        """Return the state at rest, with the start gains."""
        return AdaptiveState(self.pid.reset(reference, value), jnp.zeros(()), self.pid.kp, self.pid.ki, self.pid.kd)

    def step(
        self, state: AdaptiveState, reference: Float[Array, ""], value: Float[Array, ""]
    ) -> tuple[AdaptiveState, Float[Array, ""]]:
        """Adapt the gains and take one sample of the PID with them; return the state and the command."""
        error, derivative = reference - value, self.pid.filtered_derivative(state.inner, reference, value)
        error_integral = state.error_integral + error * self.pid.period
        factors = (1.0, state.ki, state.kd) if self.law == "printed" else (error, error, error)
        adapted = (
            state.kp + self.rate_p * factors[0] * error,
            state.ki + self.rate_i * factors[1] * error_integral,
            state.kd + self.rate_d * factors[2] * derivative,
        )
        initial = (self.pid.kp, self.pid.ki, self.pid.kd)
        kp, ki, kd = (clip(new, 0.0, self.growth * start) for new, start in zip(adapted, initial, strict=True))
        pid = eqx.tree_at(lambda p: (p.kp, p.ki, p.kd), self.pid, (kp, ki, kd))
        inner, output = pid.step(state.inner, reference, value)
        return AdaptiveState(inner, error_integral, kp, ki, kd), output
