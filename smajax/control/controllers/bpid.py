"""BPID controller: a PID whose output passes a bilinear compensator.

For a plant y' = -a y + b u + eta u y, whose gain grows with its output, the law

    u = v (1 + K_b y_0) / (1 + K_b y),     K_b = eta / b,

makes the loop linear in the PID's output v, with the gain that the plant has at y_0, the value at which the PID was
tuned.

Source: copaci2020 (name of the controller; its formula is not printed there and is derived here from the plant above).
"""

from typing import Any

import jax
from jaxtyping import Array, Float

from smajax.control.controllers.around_pid import AbstractControllerAroundPID
from smajax.control.controllers.pid import PID, PIDState
from smajax.numerics.nonsmooth import maximum
from smajax.parameters import parameter

# Lower bound of 1 + K_b y: the compensator multiplies the PID's output by at most twenty (for a tuning point at 0).
# Chosen by trial; tests/unit/control/test_control.py compares it with the C header.
MIN_DENOMINATOR = 0.05


class BPID(AbstractControllerAroundPID):
    """PID with a bilinear compensator; the limits of the PID apply to the output of the compensator.

    Attributes:
        pid: The PID before the compensator.
        kb: Bilinear gain K_b, 1 over the channel's unit.
        tuning_point: Value y_0 at which the PID was tuned, in the channel's unit.
    """

    pid: PID
    kb: jax.Array = parameter("1/y", "bilinear gain", default=0.0)
    tuning_point: jax.Array = parameter("y", "value at which the PID was tuned", default=0.0)

    def constants(self) -> dict[str, Any]:
        """Return the fixed constants: those of the PID, and ``least``, the lower bound of 1 + K_b y."""
        return super().constants() | {"least": MIN_DENOMINATOR}

    def reset(self, reference: Float[Array, ""], value: Float[Array, ""]) -> PIDState:
        """Return the state at rest, that of the PID."""
        return self.pid.reset(reference, value)

    def step(
        self, state: PIDState, reference: Float[Array, ""], value: Float[Array, ""]
    ) -> tuple[PIDState, Float[Array, ""]]:
        """Take one sample of the PID; return its state and the compensated command."""
        at_tuning_point, at_value = (maximum(1.0 + self.kb * y, MIN_DENOMINATOR) for y in (self.tuning_point, value))
        factor = at_tuning_point / at_value
        state, output = self.pid.step_within(state, reference, value, self.pid.lower / factor, self.pid.upper / factor)
        return state, factor * output
