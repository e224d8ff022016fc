"""PID with a feedforward by the inverse of a hysteresis operator: u = H^-1[r] + PID(r - y).

Source: copaci2020 (inverse Prandtl-Ishlinskii operator as feedforward); krejci2001 for the inverse.
"""

from typing import Any, NamedTuple

import jax.numpy as jnp
from jaxtyping import Array, Float

from smajax.control.controllers.around_pid import AbstractControllerAroundPID
from smajax.control.controllers.pid import PID, PIDState
from smajax.laws.base import AbstractInputOutputModel
from smajax.numerics.nonsmooth import clip


class FeedforwardState(NamedTuple):
    """State of a PID with feedforward.

    Attributes:
        pid: State of the PID.
        plays: State of the inverse operator; for a Prandtl-Ishlinskii operator its plays, shape ``(plays,)``.
        last_reference: Reference at the last sample, a scalar in the channel's unit.
    """

    pid: PIDState
    plays: Any
    last_reference: Float[Array, ""]


class FeedforwardPID(AbstractControllerAroundPID):
    """Sum of a feedforward and a PID.

    At each sample the output of the PID is limited to the range of the actuator minus the feedforward, so that the
    anti-windup of the PID acts when their sum saturates.

    Attributes:
        pid: The PID, with the limits of the command.
        inverse: Inverse hysteresis operator: the reference is its input, the feedforward command its output.
    """

    pid: PID
    inverse: AbstractInputOutputModel

    def reset(self, reference: Float[Array, ""], value: Float[Array, ""]) -> FeedforwardState:
        """Return the state at rest."""
        return FeedforwardState(self.pid.reset(reference, value), self.inverse.init(reference), reference)

    def step(
        self, state: FeedforwardState, reference: Float[Array, ""], value: Float[Array, ""]
    ) -> tuple[FeedforwardState, Float[Array, ""]]:
        """Take one sample; return the state and the sum of feedforward and PID."""
        pid_state, operator, last_reference = state
        operator = self.inverse.step(operator, last_reference, reference, jnp.asarray(self.pid.period))
        feedforward = clip(self.inverse.output(operator, reference), self.pid.lower, self.pid.upper)
        pid_state, correction = self.pid.step_within(
            pid_state, reference, value, self.pid.lower - feedforward, self.pid.upper - feedforward
        )
        return FeedforwardState(pid_state, operator, reference), feedforward + correction
