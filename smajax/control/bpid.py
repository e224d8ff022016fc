"""BPID: a PID whose output passes a bilinear compensator (flexible-actuator paper; the form is ours, the paper gives none).

For a plant y' = -a y + b u + eta u y, which heats the easier the further it is, the law

    u = v (1 + K_b y_0) / (1 + K_b y),     K_b = eta / b,

makes the loop linear in the PID's output v, with the gain that it has at the point y_0 at which it was tuned.
"""

import jax

from smajax.control.controller import AbstractController
from smajax.control.pid import PID, PIDState
from smajax.kinks import larger
from smajax.parameters import parameter

LEAST = 0.05  # of 1 + K_b y: below, the compensator would ask for twenty times the PID's output


class BPID(AbstractController):
    """The controller of the module's text; the PID's limits hold for what leaves the compensator."""

    pid: PID
    kb: jax.Array = parameter("1/y", "bilinear gain", default=0.0)
    tuning_point: jax.Array = parameter("y", "value at which the PID was tuned", default=0.0)

    @property
    def inner(self) -> PID:
        """See ``AbstractController.inner``."""
        return self.pid

    def reset(self, reference: jax.Array, value: jax.Array) -> PIDState:
        """See ``AbstractController.reset``."""
        return self.pid.reset(reference, value)

    def step(self, state: PIDState, reference: jax.Array, value: jax.Array) -> tuple[PIDState, jax.Array]:
        """See ``AbstractController.step``."""
        at_point, here = (larger(1.0 + self.kb * y, LEAST) for y in (self.tuning_point, value))
        factor = at_point / here
        state, output = self.pid.within(state, reference, value, self.pid.lower / factor, self.pid.upper / factor)
        return state, factor * output
