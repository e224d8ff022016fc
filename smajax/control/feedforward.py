"""PID beside the inverse of a hysteresis operator: u = H^-1[r] + PID(r - y) (flexible-actuator paper)."""

from typing import Any

import jax
import jax.numpy as jnp

from smajax.control.controller import AbstractController
from smajax.control.pid import PID
from smajax.hysteresis.operator import AbstractOperator
from smajax.kinks import within


class FeedforwardPID(AbstractController):
    """``inverse`` gives the command that would make the reference, as ``PrandtlIshlinskii.inverse`` does; ``pid`` does the rest.

    The PID has what the feedforward leaves between the limits, so that its integral does not wind up against it.
    """

    pid: PID
    inverse: AbstractOperator

    @property
    def inner(self) -> PID:
        """See ``AbstractController.inner``."""
        return self.pid

    def reset(self, reference: jax.Array, value: jax.Array) -> Any:
        """See ``AbstractController.reset``."""
        return self.pid.reset(reference, value), self.inverse.start(reference), reference

    def step(self, state: Any, reference: jax.Array, value: jax.Array) -> tuple[Any, jax.Array]:
        """See ``AbstractController.step``."""
        inner, operator, last = state
        operator = self.inverse.advance(operator, last, reference, jnp.asarray(self.pid.period))
        ahead = within(self.inverse.output(operator, reference), self.pid.lower, self.pid.upper)
        inner, rest = self.pid.within(inner, reference, value, self.pid.lower - ahead, self.pid.upper - ahead)
        return (inner, operator, reference), ahead + rest
