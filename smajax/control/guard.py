"""A guard against overheating: a temperature PID that only heats (hip paper), and what it allows is the most that a wire gets."""

import equinox as eqx
import jax

from smajax.control.pid import PID, PIDState
from smajax.kinks import larger, smaller

BLIND = 1.0  # s without a temperature after which exported guards do not heat


class TemperatureGuard(eqx.Module):
    """``pid`` steers the wire's temperature to its limit, in degC: far below, it allows the full command, above, none."""

    pid: PID
    limit: jax.Array

    def reset(self, temperature: jax.Array) -> PIDState:
        """The state at rest at a temperature; scalar."""
        return self.pid.reset(self.limit, temperature)

    def step(self, state: PIDState, temperature: jax.Array, command: jax.Array) -> tuple[PIDState, jax.Array]:
        """The state after a sample, and the command cut to what the wire may get."""
        state, allowed = self.pid.step(state, self.limit, temperature)
        return state, smaller(command, larger(allowed, 0.0))
