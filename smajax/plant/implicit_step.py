"""One step of a plant as a differentiable function, by the implicit function theorem at its solved end.

The search for the end of a step is not differentiated. At the end z the residual r(z, p) is zero, where p are the state
at the start, the inputs and the plant. Therefore dz = -(dr/dz)^-1 (dr/dp) dp, and the state at the end follows from dz
and dp. ``differentiable_step`` has this derivative, of first order. ``twice_differentiable_step`` takes Newton steps
from the solved end with a constant Jacobian: each step makes one more order of the derivative exact, so that a Jacobian
of the step (that of a Kalman filter) is itself differentiable.
"""

import equinox as eqx
import jax
from jax.flatten_util import ravel_pytree
from jaxtyping import Array, Float

from smajax.numerics.dense import solve_dense
from smajax.numerics.implicit_differentiation import implicit_jvp
from smajax.plant.plant import Plant
from smajax.plant.state import State


@eqx.filter_custom_jvp
def differentiable_step(
    plant: Plant,
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
        duration: Duration of the step, s; not differentiated.
        end: Solution of the step's residual (temperatures, then unknowns); its derivative follows from the other
            arguments.

    Returns:
        The state at the end of the step.
    """
    return plant.step_residual(state, signal, signal, duration, end)[1]


@differentiable_step.def_jvp
def _differentiable_step_jvp(primals: tuple, tangents: tuple) -> tuple:
    (plant, state, signal, duration, end), (plant_dot, state_dot, signal_dot, _, _) = primals, tangents
    state_at_end = differentiable_step(plant, state, signal, duration, end)

    def step_residual(z: jax.Array, plant: Plant, state: State, signal: jax.Array) -> tuple[jax.Array, jax.Array]:
        residual, state_at_end = plant.step_residual(state, signal, signal, duration, z)
        return residual, ravel_pytree(state_at_end)[0]

    tangent = implicit_jvp(step_residual, end, (plant, state, signal), (plant_dot, state_dot, signal_dot))
    return state_at_end, ravel_pytree(state_at_end)[1](tangent)


def twice_differentiable_step(
    plant: Plant,
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
