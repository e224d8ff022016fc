"""Adaptive PID: gains that change with the error from sample to sample.

    printed      K_p += g_p e       K_i += g_i K_i int e dt     K_d += g_d K_d de/dt
    gradient     K_p += g_p e e     K_i += g_i e int e dt       K_d += g_d e de/dt

The printed law is linear in the error, so that K_p is a second integral of the error. The gradient law (MIT rule) is
what the paper describes in words. Both keep each gain between 0 and a multiple of its start value, so that a gain that
starts at 0 cannot adapt.

Source: ali2026 (printed law); wittenmark1995, chapter 5 (MIT rule).
"""

from typing import Literal, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from smajax.control.controllers.around_pid import AbstractControllerAroundPID
from smajax.control.controllers.pid import PID, PIDState
from smajax.errors import InputError
from smajax.numerics.nonsmooth import clip
from smajax.parameters import parameter
from smajax.parameters.checks import is_concrete


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


class AdaptivePID(AbstractControllerAroundPID):
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

    def __check_init__(self) -> None:
        self.check_gains()

    def check_gains(self) -> None:
        """Check that each gain with an adaptation rate starts above 0.

        Raises:
            InputError: if one starts at 0: its largest value is a multiple of its start value, so it could never adapt.
        """
        for name in ("p", "i", "d"):
            start, rate = getattr(self.pid, f"k{name}"), getattr(self, f"rate_{name}")
            is_checked = is_concrete(start) and is_concrete(rate)
            if is_checked and np.any((np.asarray(rate) > 0.0) & (np.asarray(start) <= 0.0)):
                raise InputError(
                    f"k{name} starts at 0 and has the adaptation rate rate_{name}, and a gain grows up to "
                    f"{self.growth:g} times its start value: give k{name} a value above 0, or leave rate_{name} out"
                )

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
