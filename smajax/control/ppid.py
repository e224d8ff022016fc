"""PPID: PD while the error is large, feedforward and PI once it is small (Flores; flexible-actuator paper).

    |e| > band     u = K_p e + K_d e'
    |e| <= band    u = u_ff + K_p,rest e + K_i int e dt

The integral begins anew at each switch. The band has a hysteresis: it is left at a larger error than it is entered. The feedforward serves
while the wire contracts (e > 0) and is none while it stretches, when only cooling helps.
"""

from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp

from smajax.control.controller import AbstractController
from smajax.control.pid import PID, PIDState
from smajax.hysteresis.operator import AbstractOperator
from smajax.kinks import within
from smajax.parameters import parameter


class PPID(AbstractController):
    """The controller of the module's text. Of ``pid``, the integral gain serves at rest only, the proportional and derivative before it."""

    pid: PID
    kp_rest: jax.Array = parameter("u/y", "proportional gain within the band", 0.0)
    band: jax.Array = parameter("y", "error below which the loop counts as at rest", 0.0)
    leave: float = eqx.field(static=True, default=1.5)
    inverse: AbstractOperator | None = None

    @property
    def inner(self) -> PID:
        """See ``AbstractController.inner``."""
        return self.pid

    def reset(self, reference: jax.Array, value: jax.Array) -> Any:
        """See ``AbstractController.reset``."""
        operator = () if self.inverse is None else self.inverse.start(reference)
        return self.pid.reset(reference, value), operator, reference, jnp.abs(reference - value) <= self.band

    def step(self, state: Any, reference: jax.Array, value: jax.Array) -> tuple[Any, jax.Array]:
        """See ``AbstractController.step``."""
        inner, operator, last, rested = state
        error = reference - value
        rests = jnp.abs(error) <= jnp.where(rested, self.leave * self.band, self.band)
        ahead = jnp.zeros(())
        if self.inverse is not None:
            operator = self.inverse.advance(operator, last, reference, jnp.asarray(self.pid.period))
            ahead = jnp.where(error > 0.0, within(self.inverse.output(operator, reference), self.pid.lower, self.pid.upper), 0.0)
        inner = PIDState(jnp.where(rests == rested, inner.integral, 0.0), inner.last, inner.slope)
        holding = eqx.tree_at(lambda p: (p.kp, p.kd), self.pid, (self.kp_rest, jnp.zeros(())))
        moving = eqx.tree_at(lambda p: p.ki, self.pid, jnp.zeros(()))
        at_rest, hold = holding.within(inner, reference, value, self.pid.lower - ahead, self.pid.upper - ahead)
        on_the_way, move = moving.step(inner, reference, value)
        inner = jax.tree.map(lambda a, b: jnp.where(rests, a, b), at_rest, on_the_way)
        return (inner, operator, reference, rests), jnp.where(rests, ahead + hold, move)
