"""One step of a plant as a differentiable function, by the implicit function theorem at its solved end.

The search for the end of a step is not differentiated. At the end z the residual r(z, p) is zero, where p are the state
at the start, the inputs, the duration and the plant. Therefore dz = -(dr/dz)^-1 (dr/dp) dp, and the state at the end
follows from dz and dp. ``implicit_step`` solves the step and has this derivative; ``differentiable_step`` has it at an
end that was solved before. Both have derivatives of first order only. ``twice_differentiable_step`` takes Newton steps
from the solved end with a constant Jacobian: each step makes one more order of the derivative exact, so that a Jacobian
of the step (that of a Kalman filter) is itself differentiable.
"""

from typing import Any

import equinox as eqx
import jax
from jax.flatten_util import ravel_pytree
from jaxtyping import Array, Bool, Float

from smajax.numerics.dense import solve_dense
from smajax.numerics.derivative_order import first_order_only, nondifferentiable
from smajax.numerics.implicit_differentiation import implicit_jvp
from smajax.plant.state import State
from smajax.plant.step_equations import StepEquations
from smajax.plant.step_solver import StepSolver


@eqx.filter_custom_jvp
def implicit_step(
    plant: StepSolver,
    state: State,
    before: Float[Array, " signals"],
    after: Float[Array, " signals"],
    duration: Float[Array, ""],
) -> tuple[State, Bool[Array, ""]]:
    """Solve a step; differentiable once, in both modes, in all arguments.

    Args:
        plant: The plant.
        state: The state at the start of the step.
        before: Signals at the start.
        after: Signals at the end; they are linear over the step.
        duration: Duration of the step, s.

    Returns:
        The state at the end, and whether the step could not be solved.

    Raises:
        DerivativeError: When a second derivative is taken.
    """
    return plant.solve_step(state, before, after, duration)


@implicit_step.def_jvp
def _implicit_step_jvp(primals: tuple[Any, ...], tangents: tuple[Any, ...]) -> tuple[Any, ...]:
    primals = nondifferentiable(primals, first_order_only("a plant's step"))
    plant, *arguments = primals
    state_at_end, failed = plant.solve_step(*arguments)
    return (state_at_end, failed), (_tangent_at(state_at_end.step_unknowns, primals, tangents, state_at_end), None)


@eqx.filter_custom_jvp
def differentiable_step(
    plant: StepEquations,
    state: State,
    signal: Float[Array, " signals"],
    duration: Float[Array, ""],
    end: Float[Array, " unknowns"],
) -> State:
    """Compute the state after a step under a constant signal; differentiable once, in both modes.

    Args:
        plant: The plant.
        state: The state at the start of the step.
        signal: Signals, constant over the step.
        duration: Duration of the step, s.
        end: Solution of the step's residual (temperatures, then unknowns); its derivative follows from the other
            arguments.

    Returns:
        The state at the end of the step.

    Raises:
        DerivativeError: When a second derivative is taken.
    """
    return plant.step_residual(state, signal, signal, duration, end)[1]


@differentiable_step.def_jvp
def _differentiable_step_jvp(primals: tuple[Any, ...], tangents: tuple[Any, ...]) -> tuple[Any, ...]:
    primals = nondifferentiable(primals, first_order_only("a plant's step"))
    (plant, state, signal, duration, end), (plant_dot, state_dot, signal_dot, duration_dot, _) = primals, tangents
    state_at_end = differentiable_step(plant, state, signal, duration, end)
    steps = (plant, state, signal, signal, duration)
    step_tangents = (plant_dot, state_dot, signal_dot, signal_dot, duration_dot)
    return state_at_end, _tangent_at(end, steps, step_tangents, state_at_end)


def _tangent_at(
    end: Float[Array, " unknowns"], primals: tuple[Any, ...], tangents: tuple[Any, ...], state_at_end: State
) -> State:
    """The tangent of the state at the end, from those of plant, state, signals at start and end, and duration."""

    def step_residual(
        z: jax.Array, plant: StepEquations, start: State, before: jax.Array, after: jax.Array, duration: jax.Array
    ) -> tuple[jax.Array, jax.Array]:
        residual, state = plant.step_residual(start, before, after, duration, z)
        return residual, ravel_pytree(state)[0]

    return ravel_pytree(state_at_end)[1](implicit_jvp(step_residual, end, primals, tangents))


def twice_differentiable_step(
    plant: StepEquations,
    state: State,
    signal: Float[Array, " signals"],
    duration: Float[Array, ""],
    end: Float[Array, " unknowns"],
) -> State:
    """Compute the state after a step under a constant signal; differentiable twice, with three times the residuals.

    Args:
        plant: The plant.
        state: The state at the start of the step.
        signal: Signals, constant over the step.
        duration: Duration of the step, s.
        end: Solution of the step's residual (temperatures, then unknowns); its derivative follows from the other
            arguments.

    Returns:
        The state at the end of the step.
    """
    end, constants = jax.lax.stop_gradient((end, (plant, state, signal)))
    fixed_plant, fixed_state, fixed_signal = constants
    jacobian = jax.jacfwd(lambda z: fixed_plant.step_residual(fixed_state, fixed_signal, fixed_signal, duration, z)[0])(
        end
    )
    for _ in range(2):
        end = end - solve_dense(jacobian, plant.step_residual(state, signal, signal, duration, end)[0])
    return plant.step_residual(state, signal, signal, duration, end)[1]
