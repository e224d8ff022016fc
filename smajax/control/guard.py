"""A guard against overheating: a temperature PID that only heats (hip paper), and what it allows is the most that a wire gets.

A wire whose temperature is not known gets nothing: see ``LastKnown``.
"""

from typing import NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp

from smajax.control.last_known import LastKnown
from smajax.control.pid import PID, PIDState
from smajax.kinks import larger, smaller


class GuardState(NamedTuple):
    """The PID's state and the temperature as it is known, degC."""

    inner: PIDState
    known: LastKnown


class TemperatureGuard(eqx.Module):
    """``pid`` steers the wire's temperature to its limit, in degC: far below, it allows the full command, above, none."""

    pid: PID
    limit: jax.Array

    def reset(self, temperature: jax.Array) -> GuardState:
        """The state at rest at a temperature; scalar."""
        known = LastKnown.begin(temperature)
        return GuardState(self.pid.reset(self.limit, known.value), known)

    def step(self, state: GuardState, temperature: jax.Array, command: jax.Array) -> tuple[GuardState, jax.Array]:
        """The state after a sample, and the command cut to what the wire may get; ``temperature`` may be no number."""
        known = state.known.after(temperature, self.pid.period)
        later, allowed = self.pid.step(state.inner, self.limit, known.value)
        inner = jax.tree.map(lambda a, b: jnp.where(known.lost, a, b), state.inner, later)
        return GuardState(inner, known), smaller(command, jnp.where(known.lost, 0.0, larger(allowed, 0.0)))
