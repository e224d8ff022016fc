"""Temperature limiter: a PID of the wire's temperature, whose output is the largest command that the wire may get.

A wire whose temperature is not known gets no command, see ``DropoutHold``.

Source: ali2026 (temperature PID that only heats).
"""

from typing import NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Float

from smajax.control.controllers.pid import PID, PIDState
from smajax.control.sensors.dropout_hold import DropoutHold
from smajax.numerics.nonsmooth import maximum, minimum


class TemperatureLimiterState(NamedTuple):
    """State of the PID, and the hold of the temperature in degC."""

    inner: PIDState
    hold: DropoutHold


class TemperatureLimiter(eqx.Module):
    """Limiter with the set temperature ``limit`` in degC: far below it allows the full command, above it none."""

    pid: PID
    limit: jax.Array

    def reset(self, temperature: Float[Array, ""]) -> TemperatureLimiterState:
        """Return the state at rest at a temperature in degC."""
        hold = DropoutHold.init(temperature)
        return TemperatureLimiterState(self.pid.reset(self.limit, hold.value), hold)

    def step(
        self, state: TemperatureLimiterState, temperature: Float[Array, ""], command: Float[Array, ""]
    ) -> tuple[TemperatureLimiterState, Float[Array, ""]]:
        """Take one sample of one wire.

        Args:
            state: State after the previous sample.
            temperature: Temperature at this sample, degC; NaN: not known.
            command: Command that the wire would get.

        Returns:
            The state after this sample, and the command cut to what the wire may get.
        """
        hold = state.hold.update(temperature, self.pid.period)
        pid_state, allowed = self.pid.step(state.inner, self.limit, hold.value)
        inner = jax.tree.map(lambda a, b: jnp.where(hold.timed_out, a, b), state.inner, pid_state)
        return TemperatureLimiterState(inner, hold), minimum(
            command, jnp.where(hold.timed_out, 0.0, maximum(allowed, 0.0))
        )
