"""PPID controller: PD while the error is large, feedforward and PI once it is small.

    |e| > band     u = K_p e + K_d e'
    |e| <= band    u = u_ff + K_p,rest e + K_i int e dt

The integral is reset at each switch. The band has a hysteresis: the error enters it at ``band`` and leaves it at
``exit_factor`` times ``band``. The feedforward acts for e > 0, while the wire has to contract; for e < 0 it is 0, since
a wire is cooled by its surroundings only.

Source: copaci2020; the reset and the hysteresis of the band are added here against chattering.
"""

from typing import Any, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float

from smajax.control.controllers.around_pid import AbstractControllerAroundPID
from smajax.control.controllers.pid import PID, PIDState
from smajax.laws.base import AbstractInputOutputModel
from smajax.numerics.nonsmooth import clip
from smajax.parameters import parameter


class PPIDState(NamedTuple):
    """State of a PPID.

    Attributes:
        pid: State of the PID.
        plays: State of the inverse operator; for a Prandtl-Ishlinskii operator its plays, shape ``(plays,)``. An empty
            tuple without a feedforward.
        last_reference: Reference at the last sample, a scalar in the channel's unit.
        in_band: Whether the error was within the band at the last sample.
    """

    pid: PIDState
    plays: Any
    last_reference: Float[Array, ""]
    in_band: Bool[Array, ""]


class PPID(AbstractControllerAroundPID):
    """Controller that switches between PD and feedforward plus PI.

    Attributes:
        pid: PID whose proportional and derivative gains act outside the band, and whose integral gain acts within it.
        kp_rest: Proportional gain within the band.
        band: Error at which the controller switches to feedforward plus PI, in the channel's unit.
        exit_factor: Error at which it switches back, as a multiple of ``band``.
        inverse: Inverse hysteresis operator, whose output is the feedforward; ``None``: no feedforward.
    """

    pid: PID
    kp_rest: jax.Array = parameter("u/y", "proportional gain within the band", 0.0)
    band: jax.Array = parameter("y", "error below which the loop counts as at rest", 0.0)
    exit_factor: float = eqx.field(static=True, default=1.5)
    inverse: AbstractInputOutputModel | None = None

    def constants(self) -> dict[str, Any]:
        """Return the fixed constants: those of the PID, and ``leave``, which is ``exit_factor``."""
        return self.pid.constants() | {"leave": self.exit_factor}

    def reset(self, reference: Float[Array, ""], value: Float[Array, ""]) -> PPIDState:
        """Return the state at rest."""
        operator = () if self.inverse is None else self.inverse.init(reference)
        return PPIDState(self.pid.reset(reference, value), operator, reference, jnp.abs(reference - value) <= self.band)

    def step(
        self, state: PPIDState, reference: Float[Array, ""], value: Float[Array, ""]
    ) -> tuple[PPIDState, Float[Array, ""]]:
        """Take one sample; return the state and the command."""
        pid_state, operator, last_reference, was_in_band = state
        error = reference - value
        in_band = jnp.abs(error) <= jnp.where(was_in_band, self.exit_factor * self.band, self.band)
        feedforward = jnp.zeros(())
        if self.inverse is not None:
            operator = self.inverse.step(operator, last_reference, reference, jnp.asarray(self.pid.period))
            feedforward = jnp.where(
                error > 0.0, clip(self.inverse.output(operator, reference), self.pid.lower, self.pid.upper), 0.0
            )
        integral = jnp.where(in_band == was_in_band, pid_state.integral, 0.0)
        pid_state = PIDState(integral, pid_state.last_signal, pid_state.derivative)
        pi = eqx.tree_at(lambda p: (p.kp, p.kd), self.pid, (self.kp_rest, jnp.zeros(())))
        pd = eqx.tree_at(lambda p: p.ki, self.pid, jnp.zeros(()))
        pi_state, pi_output = pi.step_within(
            pid_state, reference, value, self.pid.lower - feedforward, self.pid.upper - feedforward
        )
        pd_state, pd_output = pd.step(pid_state, reference, value)
        pid_state = jax.tree.map(lambda a, b: jnp.where(in_band, a, b), pi_state, pd_state)
        return PPIDState(pid_state, operator, reference, in_band), jnp.where(
            in_band, feedforward + pi_output, pd_output
        )
