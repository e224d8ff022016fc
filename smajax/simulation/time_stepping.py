"""Time stepping of a plant: all implicit steps of a grid in one scan.

``integrate`` takes all steps of a grid and computes an output at every grid point. It is not differentiable:
``smajax.simulation.sensitivities`` adds the derivatives.
"""

from collections.abc import Callable
from typing import Any, cast

import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float, Int

from smajax.numerics.common_subexpressions import merge_equal_operations
from smajax.plant.plant import Plant
from smajax.plant.state import State
from smajax.simulation.compilation import BLOCK, block_count, in_blocks, traced_step
from smajax.simulation.inputs import Inputs
from smajax.simulation.status import MELTING_TEMPERATURE, SimulationStatus

# An output of the plant, a state and the signals at one grid point.
OutputFunction = Callable[[Plant, State, jax.Array], Any]


def integrate(
    plant: Plant, inputs: Inputs, output_fn: OutputFunction, end_index: Any = None
) -> tuple[Any, Int[Array, ""]]:
    """Take all steps of a grid.

    Args:
        plant: The plant.
        inputs: Its inputs on the grid.
        output_fn: Output of the plant, a state and the signals; any pytree of floating-point arrays.
        end_index: Grid point at which the simulation may end; outputs after its block are infinite.

    Returns:
        The outputs at all grid points, leaves of shape ``(grid, ...)``, and the status code.
    """
    plant = plant.prepared()
    state, signal = plant.init(inputs.sample_signals[0]), inputs.sample_signals[0]
    start = state, jnp.asarray(0), jnp.max(state.temperature)
    rows = inputs.before, inputs.after, grid_signals(inputs)[1:], jnp.diff(inputs.time)

    def advance(carry: tuple[Any, ...], row: tuple[Any, ...]) -> tuple[tuple[Any, ...], Any]:
        # The carry counts the steps that could not be solved, and has the highest temperature so far, which is NaN as
        # soon as any temperature is NaN.
        state, unsolved, hottest = carry
        before, after, signal, duration = row
        state, failed = traced_step(plant, state, before, after, duration)
        carry = state, unsolved + failed, jnp.maximum(hottest, jnp.max(state.temperature))
        return carry, output_fn(plant, state, signal)

    first, merged = output_fn(plant, state, signal), merge_equal_operations(advance)
    if end_index is None:
        carry, later = jax.lax.scan(merged, start, rows)
    else:
        carry, later = _scan_blocks(merged, start, rows, first, end_index)
    return jax.tree.map(lambda a, b: jnp.concatenate([a[None], b]), first, later), simulation_status(
        *cast(tuple[Any, Any, Any], carry)
    )


def _scan_blocks(
    advance: Callable[..., Any], start: tuple[Any, ...], rows: tuple[Any, ...], output: Any, end_index: Int[Array, ""]
) -> tuple[tuple[Any, ...], Any]:
    """Scan in blocks of steps up to the one that holds ``end_index``; the outputs after it are infinite.

    ``output`` is an output at one grid point, which gives the shapes.
    """
    last_signal, count = rows[1][-1], rows[1].shape[0]
    # The last block is filled up with steps of zero duration.
    paddings = last_signal, last_signal, last_signal, jnp.zeros(())
    blocks = [in_blocks(row, padding) for row, padding in zip(rows, paddings, strict=True)]

    def scan_block(k: jax.Array, carry: tuple[Any, ...]) -> tuple[Any, ...]:
        carry, outputs = carry
        carry, block_outputs = jax.lax.scan(advance, carry, tuple(block[k] for block in blocks))
        update = jax.lax.dynamic_update_slice_in_dim
        return carry, jax.tree.map(lambda whole, part: update(whole, part, k * BLOCK, axis=0), outputs, block_outputs)

    padded_count = blocks[0].shape[0] * BLOCK
    empty = jax.tree.map(lambda leaf: jnp.full((padded_count, *leaf.shape), jnp.inf, leaf.dtype), output)
    carry, outputs = jax.lax.fori_loop(0, block_count(end_index), scan_block, (start, empty))
    return carry, jax.tree.map(lambda leaf: leaf[:count], outputs)


def simulation_status(
    final: State, unsolved: Int[Array, ""] | Bool[Array, ""], hottest: Float[Array, ""]
) -> Int[Array, ""]:
    """Compute the status code (``SimulationStatus``) of a simulation or of a step.

    Args:
        final: The state at the end.
        unsolved: Number of steps that could not be solved.
        hottest: Highest temperature, degC; NaN if any temperature was NaN.
    """
    status = jnp.where(unsolved > 0, SimulationStatus.unsolved, SimulationStatus.done)
    # A NaN in a fraction or a motion stays to the end; one in a temperature stays in the highest temperature.
    leaves_finite = [jnp.all(jnp.isfinite(leaf)) for leaf in jax.tree.leaves(final)]
    finite = jnp.all(jnp.asarray(leaves_finite)) & jnp.isfinite(hottest)
    melted = hottest > MELTING_TEMPERATURE
    return jnp.where(finite, jnp.where(melted, SimulationStatus.overheated, status), SimulationStatus.diverged)


def grid_signals(inputs: Inputs) -> Float[Array, "grid signals"]:
    """Return the signals at every grid point; where a held input jumps, those after the jump.

    Args:
        inputs: The inputs.
    """
    return jnp.concatenate([inputs.sample_signals[:1], inputs.before[1:], inputs.sample_signals[-1:]])
