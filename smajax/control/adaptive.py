"""The hip paper's adaptive PID: gains that move with the error from sample to sample.

    printed      K_p += g_p e       K_i += g_i K_i int e dt     K_d += g_d K_d de/dt
    gradient     K_p += g_p e e     K_i += g_i e int e dt       K_d += g_d e de/dt

The printed law is linear in the error: K_p becomes a second integrator whose sign follows e. The gradient law (the MIT rule) is what the
paper says that it is. Both are kept within 0 and a largest gain.
"""

from typing import Literal, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp

from smajax.control.controller import AbstractController
from smajax.control.pid import PID, PIDState
from smajax.kinks import within
from smajax.parameters import parameter


class AdaptiveState(NamedTuple):
    """The PID's state, the integral of the error, and the gains as they are now; scalars."""

    inner: PIDState
    summed: jax.Array
    kp: jax.Array
    ki: jax.Array
    kd: jax.Array


class AdaptivePID(AbstractController):
    """The controller of the module's text; it starts from the gains of ``pid``, and none grows beyond ``growth`` times its start."""

    pid: PID
    rate_p: jax.Array = parameter("1", "adaptation of the proportional gain per sample, in internal units", 0.0, default=0.0)
    rate_i: jax.Array = parameter("1", "adaptation of the integral gain per sample, in internal units", 0.0, default=0.0)
    rate_d: jax.Array = parameter("1", "adaptation of the derivative gain per sample, in internal units", 0.0, default=0.0)
    growth: float = eqx.field(static=True, default=10.0)
    law: Literal["printed", "gradient"] = eqx.field(static=True, default="gradient")

    @property
    def inner(self) -> PID:
        """See ``AbstractController.inner``."""
        return self.pid

    def reset(self, reference: jax.Array, value: jax.Array) -> AdaptiveState:
        """See ``AbstractController.reset``."""
        return AdaptiveState(self.pid.reset(reference, value), jnp.zeros(()), self.pid.kp, self.pid.ki, self.pid.kd)

    def step(self, state: AdaptiveState, reference: jax.Array, value: jax.Array) -> tuple[AdaptiveState, jax.Array]:
        """See ``AbstractController.step``."""
        error, slope = reference - value, self.pid.slope(state.inner, reference, value)
        summed = state.summed + error * self.pid.period
        times = (1.0, state.ki, state.kd) if self.law == "printed" else (error, error, error)
        moved = (
            state.kp + self.rate_p * times[0] * error,
            state.ki + self.rate_i * times[1] * summed,
            state.kd + self.rate_d * times[2] * slope,
        )
        first = (self.pid.kp, self.pid.ki, self.pid.kd)
        kp, ki, kd = (within(new, 0.0, self.growth * start) for new, start in zip(moved, first, strict=True))
        now = eqx.tree_at(lambda p: (p.kp, p.ki, p.kd), self.pid, (kp, ki, kd))
        inner, output = now.step(state.inner, reference, value)
        return AdaptiveState(inner, summed, kp, ki, kd), output
