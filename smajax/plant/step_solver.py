"""The search for the end of an implicit step: the first guess, Newton's method, and one more Newton step.

The search is not differentiated: ``StepEquations.step_residual`` evaluates the equations at the solved end, and the
implicit function theorem gives the derivatives (``smajax.plant.implicit_step``, ``smajax.simulation.sensitivities``).
"""

from collections.abc import Callable
from typing import Any

import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float

from smajax.numerics import newton
from smajax.numerics.dense import combine, solve_dense
from smajax.numerics.derivative_order import nondifferentiable
from smajax.plant.effects.base import MechanismEffect
from smajax.plant.heat import PrescribedTemperature
from smajax.plant.state import State
from smajax.plant.step_equations import StepEquations

_NO_DERIVATIVE = "solve_step has no derivative: use Plant.step, which has one"


class StepSolver(StepEquations):
    """A plant that solves the equations of its steps."""

    def solve_step(
        self,
        state: State,
        before: Float[Array, " signals"],
        after: Float[Array, " signals"],
        step: Float[Array, ""],
    ) -> tuple[State, Bool[Array, ""]]:
        """Advance the state by one step, without derivatives; ``Plant.step`` has them.

        For callers that differentiate ``step_residual`` at the solved end themselves.

        Args:
            state: The state at the start of the step.
            before: Signals at the start.
            after: Signals at the end; they are linear over the step.
            step: Duration, s.

        Returns:
            The state at the end, and whether the step could not be solved.

        Raises:
            DerivativeError: When it is differentiated.
        """
        return StepSolver._search(*nondifferentiable((self, state, before, after, step), _NO_DERIVATIVE))

    def _search(
        self,
        state: State,
        before: Float[Array, " signals"],
        after: Float[Array, " signals"],
        step: Float[Array, ""],
    ) -> tuple[State, Bool[Array, ""]]:
        """Solve a step (``solve_step``); its derivatives are not those of the solution."""
        state = self._begin_step(state, step)
        rate = self._net_heat(self._wire_state(state), state.memory, before)
        guess = jnp.concatenate([self._predicted_temperature(state, rate, after, step).ravel(), state.unknown])
        constants = (self, state, rate, before, after, step)
        if isinstance(self.heat, PrescribedTemperature) and not self.mechanism.unknowns:
            end, failed = guess, jnp.asarray(False)
        else:
            local = self.cells is not None
            end, failed = self._solve(
                lambda z, coarse: StepSolver._residual(*constants, z, coarse=coarse, local=local)[0], guess
            )
        if self.cells is not None:
            end = end + newton.newton_step(lambda z: StepSolver._residual(*constants, z, local=True)[0], end)[2]
            return StepSolver._residual(*constants, end)[1], failed
        (residual, state_at_end), jacobian_product = jax.linearize(lambda z: StepSolver._residual(*constants, z), end)
        return newton_corrected(state_at_end, residual, jacobian_product), failed

    def _predicted_temperature(
        self, state: State, rate: Float[Array, "*cells wires"], after: Float[Array, " signals"], step: Float[Array, ""]
    ) -> Float[Array, "*cells wires"]:
        """First guess of the temperature at the end of a step: an explicit Euler step."""
        if isinstance(self.heat, PrescribedTemperature):
            return self._specimen_temperature(self._prescribed_channels(after), state.memory)
        martensite = self._mean_over_grains(state.fractions).martensite
        return state.temperature + step * rate / self._heat_capacity(martensite)

    def _solve(
        self,
        residual: Callable[[Float[Array, " unknowns"], bool], Float[Array, " unknowns"]],
        guess: Float[Array, " unknowns"],
    ) -> tuple[Float[Array, " unknowns"], Bool[Array, ""]]:
        """Solve ``residual(z, coarse) = 0`` from ``guess``: the solution, and whether the search failed."""
        wires = self.temperatures

        def solve_with_friction() -> tuple[Float[Array, " unknowns"], Bool[Array, ""]]:
            # The last Newton step must not cross a nonsmooth point of the friction, so the search uses the exact
            # balances.
            return newton.solve_with_friction(lambda z: residual(z, False), guess, wires)

        if self.mechanism.has_dry_friction:
            return solve_with_friction()
        if not self._has_drag:
            # The balance of temperatures alone, without latent heat, is so nearly linear over a step that one Newton
            # step and the last one are sufficient.
            search = newton.solve if self.mechanism.unknowns or self.all_effects else newton.single_step
            return search(lambda z: residual(z, True), guess, wires)
        # A drag is an additional unknown. Without friction it is 0, and without it the search takes fewer iterations.
        no_drag = jnp.zeros(1)

        def solve_without_drag() -> tuple[Float[Array, " unknowns"], Bool[Array, ""]]:
            end, failed = newton.solve(lambda z: residual(jnp.concatenate([z, no_drag]), True)[:-1], guess[:-1], wires)
            return jnp.concatenate([end, no_drag]), failed

        strengths = jnp.stack([e.strength for e in self._effects_of(MechanismEffect) if e.has_drag])
        return jax.lax.cond(jnp.any(strengths != 0.0), solve_with_friction, solve_without_drag)


def newton_corrected(state: State, residual: Float[Array, " unknowns"], jacobian_product: Callable[..., Any]) -> State:
    """Compute the state after one more Newton step.

    The Jacobian is not differentiated, so the derivative of the result is that of the implicit function.

    Args:
        state: The state that follows from the unknowns.
        residual: The residual there, shape ``(unknowns,)``.
        jacobian_product: The linearised residual and state there.
    """
    size = residual.shape[0]
    jacobian, state_per_unknown = jax.vmap(jacobian_product, out_axes=-1)(jnp.eye(size))
    change = -solve_dense(jacobian, residual)
    return jax.tree.map(lambda s, d: s + combine(d, change), state, state_per_unknown)
