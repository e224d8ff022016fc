"""Forward sensitivities of a plant's trajectory, by the implicit function theorem.

The end of a step is a root z of the residual r of ``Plant.step_residual``. Its tangent follows from the Jacobian of the
residual there, and does not depend on the iterations that found the root:

    dz = -(dr/dz)^-1 (dr/d(state) d(state) + dr/d(plant) d(plant) + dr/d(inputs) d(inputs))

The tangents are computed from step to step along a trajectory that was simulated before. They are linear in the
tangents of the plant and of the inputs, so JAX transposes them for reverse mode, with the trajectory as its tape.
"""

from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
from jax.flatten_util import ravel_pytree
from jaxtyping import Array, Float, Int

from smajax.numerics.common_subexpressions import merge_equal_operations
from smajax.numerics.derivative_order import first_order_only, nondifferentiable
from smajax.numerics.implicit_differentiation import implicit_jvp, implicit_jvp_from_jacobian, jvp
from smajax.plant.plant import Plant
from smajax.simulation.compilation import (
    BLOCK,
    block_count,
    flatten_state,
    in_blocks,
    state_unflattener,
    traced_step_residual,
)
from smajax.simulation.inputs import Inputs
from smajax.simulation.time_stepping import OutputFunction, grid_signals, integrate


class Trajectory(eqx.Module):
    """A plant's states at all grid points.

    Attributes:
        flat_states: The states, one row of numbers (``flatten_state``) each, shape ``(grid, size)``.
        status: Status code of the simulation.
    """

    flat_states: Float[Array, "grid size"]
    status: Int[Array, ""]


def simulate_outputs(
    plant: Plant, inputs: Inputs, end_index: Any, output_fn: OutputFunction
) -> tuple[Float[Array, "grid size"], Int[Array, ""]]:
    """Simulate a plant and compute an output at every grid point; differentiable once in the plant and in the inputs.

    Args:
        plant: The plant.
        inputs: Its inputs on a grid.
        end_index: Grid point at which the simulation may end; ``None`` for the last one.
        output_fn: Output of the plant, a state and the signals: one row of numbers, shape ``(size,)``.

    Returns:
        The outputs, shape ``(grid, size)``, and the status code.
    """
    return _simulate_outputs(plant.prepared(), inputs, end_index, output_fn)


@eqx.filter_custom_jvp
def _simulate_outputs(
    plant: Plant, inputs: Inputs, end_index: Any, output_fn: OutputFunction
) -> tuple[Float[Array, "grid size"], Int[Array, ""]]:
    """``simulate_outputs`` of a prepared plant."""
    return integrate(plant, inputs, output_fn, end_index)


@_simulate_outputs.def_jvp
def _simulate_outputs_jvp(primals: tuple[Any, ...], tangents: tuple[Any, ...]) -> tuple[Any, ...]:
    """Simulate the trajectory first, then compute the tangents along it."""
    plant, inputs, end_index, output_fn = nondifferentiable(primals, first_order_only("simulate"))
    trajectory = Trajectory(*integrate(plant, inputs, flatten_state, end_index))
    outputs, output_tangents = _forward_sensitivities(trajectory, output_fn, end_index, (plant, inputs), tangents[:2])
    return (outputs, trajectory.status), (output_tangents, None)


def outputs_along(
    plant: Plant, inputs: Inputs, end_index: Any, output_fn: OutputFunction, trajectory: Trajectory
) -> Float[Array, "grid size"]:
    """Compute an output at every grid point of a trajectory that was simulated before.

    Differentiable once in the plant and in the inputs; the derivative includes that of the trajectory.

    Args:
        plant: The plant.
        inputs: Its inputs on a grid.
        end_index: Grid point at which the simulation may end; ``None`` for the last one.
        output_fn: Output of the plant, a state and the signals: one row of numbers, shape ``(size,)``.
        trajectory: The trajectory of this plant under these inputs.

    Returns:
        The outputs, shape ``(grid, size)``.
    """
    return _outputs_along(plant.prepared(), inputs, end_index, output_fn, trajectory)


@eqx.filter_custom_jvp
def _outputs_along(
    plant: Plant, inputs: Inputs, end_index: Any, output_fn: OutputFunction, trajectory: Trajectory
) -> Float[Array, "grid size"]:
    """``outputs_along`` of a prepared plant."""
    unflatten = state_unflattener(plant, inputs)
    return jax.vmap(lambda row, signal: output_fn(plant, unflatten(row), signal))(
        trajectory.flat_states, grid_signals(inputs)
    )


@_outputs_along.def_jvp
def _outputs_along_jvp(primals: tuple[Any, ...], tangents: tuple[Any, ...]) -> tuple[Any, ...]:
    """Compute the tangents along the trajectory."""
    plant, inputs, end_index, output_fn, trajectory = nondifferentiable(primals, first_order_only("simulate"))
    return _forward_sensitivities(trajectory, output_fn, end_index, (plant, inputs), tangents[:2])


def _forward_sensitivities(
    trajectory: Trajectory,
    output_fn: OutputFunction,
    end_index: Any,
    primals: tuple[Any, ...],
    tangents: tuple[Any, ...],
) -> tuple[jax.Array, jax.Array]:
    """Outputs at the grid points of a trajectory, and their tangents, computed from step to step."""
    (plant, inputs), (plant_tangent, input_tangents), flat = primals, tangents, trajectory.flat_states
    unflatten, signal = state_unflattener(plant, inputs), grid_signals(inputs)

    def output(plant: Plant, row: jax.Array, signal: jax.Array) -> jax.Array:
        return output_fn(plant, unflatten(row), signal)

    def push(tangent: jax.Array, row: tuple[Any, ...]) -> tuple[jax.Array, jax.Array]:
        """One step: tangents of its end and of the output there, from the tangent of its start."""
        start, end, step, step_tangent, signal, signal_tangent = row
        state = unflatten(end)
        root = state.step_unknowns

        def residual(
            root: jax.Array, start: jax.Array, plant: Plant, step: tuple[Any, ...]
        ) -> tuple[jax.Array, jax.Array]:
            balances, state = traced_step_residual(plant, unflatten(start), *step, root)
            return balances, ravel_pytree(state)[0]

        primals, tangents = (start, plant, step), (tangent, plant_tangent, step_tangent)
        if plant.cells is None:
            end_tangent = implicit_jvp(residual, root, primals, tangents)
        else:
            jacobian = jax.lax.stop_gradient(plant.step_jacobian(unflatten(start), *step, root))
            end_tangent = implicit_jvp_from_jacobian(jacobian, residual, root, primals, tangents)
        return end_tangent, jvp(output, (plant, end, signal), (plant_tangent, end_tangent, signal_tangent))

    step, step_tangents, signal_tangents = _step_rows(inputs, input_tangents)
    first_signal = None if input_tangents.sample_signals is None else input_tangents.sample_signals[0]
    first = jvp(
        lambda plant, signal: ravel_pytree(plant.init(signal))[0],
        (plant, inputs.sample_signals[0]),
        (plant_tangent, first_signal),
    )
    later_tangents = None if signal_tangents is None else signal_tangents[1:]
    at_start = jvp(
        output,
        (plant, flat[0], signal[0]),
        (plant_tangent, first, None if signal_tangents is None else signal_tangents[0]),
    )
    rows = flat[:-1], flat[1:], step, step_tangents, signal[1:], later_tangents
    outputs = jax.vmap(lambda row, signal: output(plant, row, signal))(flat, signal)
    later = _scan(merge_equal_operations(push), first, rows, end_index, len(at_start))
    return outputs, jnp.concatenate([at_start[None], later])


def _step_rows(inputs: Inputs, tangents: Any) -> tuple[tuple[Any, ...], tuple[Any, ...], jax.Array | None]:
    """Arguments of all steps, their tangents, and tangents of the signals at the grid points; ``None`` where zero."""
    step = (inputs.before, inputs.after, jnp.diff(inputs.time))
    step_tangents = (tangents.before, tangents.after, None if tangents.time is None else jnp.diff(tangents.time))
    signal_tangents = None
    if tangents.before is not None or tangents.sample_signals is not None:
        signal_tangents = jvp(grid_signals, (inputs,), (tangents,))
    return step, step_tangents, signal_tangents


def _scan(push: Any, first: jax.Array, rows: tuple[Any, ...], end_index: Any, size: int) -> jax.Array:
    """Scan ``push`` over all steps, or in blocks up to ``end_index``; shape ``(grid - 1, size)``, zero after it."""
    if end_index is None:
        return jax.lax.scan(push, first, rows)[1]
    count = rows[0].shape[0]
    # The last block is filled up with copies of the last step, whose tangents are left out.
    blocked = jax.tree.map(lambda leaf: in_blocks(leaf, leaf[-1]), rows)

    def push_block(k: jax.Array, carry: tuple[Any, ...]) -> tuple[Any, ...]:
        tangent, outputs = carry
        tangent, block = jax.lax.scan(push, tangent, jax.tree.map(lambda leaf: leaf[k], blocked))
        return tangent, jax.lax.dynamic_update_slice(outputs, block, (k * BLOCK, 0))

    empty = jnp.zeros((blocked[0].shape[0] * BLOCK, size))
    _, outputs = jax.lax.fori_loop(0, block_count(end_index), push_block, (first, empty))
    return outputs[:count]
