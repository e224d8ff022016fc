"""Temperature limiter: a PID of the wire's temperature, whose output is the largest allowed command of the wire.

A wire whose temperature is missing for longer than ``DROPOUT_TIMEOUT`` gets no command.

Source: ali2026 (temperature PID that only heats).
"""

from typing import Any, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Float

from smajax.control.controllers.pid import PID, PIDState
from smajax.control.sensors.dropout_hold import DROPOUT_TIMEOUT, DropoutHold
from smajax.numerics.nonsmooth import maximum, minimum


class TemperatureLimiterState(NamedTuple):
    """State of the limiter of one wire.

    Attributes:
        inner: State of the PID.
        hold: Hold of the temperature, degC.
    """

    inner: PIDState
    hold: DropoutHold


class TemperatureLimiter(eqx.Module):
    """Temperature limiter: far below the limit it allows the full command, above the limit none.

    Attributes:
        pid: PID of the temperature; its error is the limit minus the temperature, its output the allowed command.
        limit: Setpoint of the temperature, a scalar, degC.
        timeout: Time for which a temperature may be missing before the wire gets no command, s.
    """

    pid: PID
    limit: jax.Array
    timeout: Any = DROPOUT_TIMEOUT

    def reset(self, temperature: Float[Array, ""]) -> TemperatureLimiterState:
        """Return the state at rest at a temperature in degC."""
        hold = DropoutHold.init(temperature, timeout=self.timeout)
        return TemperatureLimiterState(self.pid.reset(self.limit, hold.value), hold)

    def step(
        self, state: TemperatureLimiterState, temperature: Float[Array, ""], command: Float[Array, ""]
    ) -> tuple[TemperatureLimiterState, Float[Array, ""]]:
        """Take one sample of one wire.

        Args:
            state: State after the previous sample.
            temperature: Temperature at this sample, degC; NaN: not measured.
            command: Command of the wire without the limiter.

        Returns:
            The state after this sample, and the smaller one of ``command`` and the allowed command.
        """
        hold = state.hold.update(temperature, self.pid.period)
        pid_state, allowed = self.pid.step(state.inner, self.limit, hold.value)
        timed_out = hold.has_timed_out(self.timeout)
        inner = jax.tree.map(lambda a, b: jnp.where(timed_out, a, b), state.inner, pid_state)
        return TemperatureLimiterState(inner, hold), minimum(command, jnp.where(timed_out, 0.0, maximum(allowed, 0.0)))
