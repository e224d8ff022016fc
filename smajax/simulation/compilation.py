"""Compile-time machinery of the simulation: blocks of steps, states as flat rows, and steps that are traced once.

- Blocks: a simulation that may end early (``end_index``) takes ``BLOCK`` steps at a time and ends with a block. The
  last block is filled up with steps of duration 0.
- Flat states: a trajectory stores each state as one row of numbers. A state has many small arrays; storing each of them
  separately would cost as much as some of the equations of a step.
- Steps traced once: ``traced_step`` and ``traced_step_residual`` are separate jitted functions, so that all programs
  share one trace; tracing a step takes longer than compiling some of these programs.

None of this changes a result. The equations of a step are those of ``Plant.step_residual``.
"""

from collections.abc import Callable
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
from jax.flatten_util import ravel_pytree
from jaxtyping import Array, Float, Int

from smajax.plant.plant import Plant
from smajax.plant.state import State
from smajax.simulation.inputs import Inputs

# Steps in a block. Chosen by trial for speed: smaller blocks incur a loop's overhead more often, larger ones simulate
# further beyond ``end_index``.
BLOCK = 64

traced_step: Callable[..., Any] = eqx.filter_jit(lambda plant, *step: plant.solve_step(*step))
traced_step_residual: Callable[..., Any] = eqx.filter_jit(lambda plant, *step: plant.step_residual(*step))


def in_blocks(rows: jax.Array, filling: jax.Array) -> jax.Array:
    """Arrange rows of steps in blocks.

    Args:
        rows: One row per step, shape ``(steps, ...)``.
        filling: Row that fills up the last block, shape ``(...)``.

    Returns:
        The rows, shape ``(blocks, BLOCK, ...)``.
    """
    count = rows.shape[0]
    filled = jnp.concatenate([rows, jnp.broadcast_to(filling, (-count % BLOCK, *rows.shape[1:]))])
    return filled.reshape(-1, BLOCK, *rows.shape[1:])


def block_count(end_index: Int[Array, ""]) -> Int[Array, ""]:
    """Count the blocks up to a grid point, at least one.

    Args:
        end_index: The grid point.
    """
    return jnp.maximum(1, -(-end_index // BLOCK))


def flatten_state(plant: Plant, state: State, signal: Float[Array, " signals"]) -> Float[Array, " size"]:
    """Flatten a state into one row of numbers; an output function (``time_stepping.OutputFunction``).

    Args:
        plant: The plant; not used.
        state: The state.
        signal: Signals at the same instant; not used.
    """
    return ravel_pytree(state)[0]


def state_unflattener(plant: Plant, inputs: Inputs) -> Callable[[Float[Array, " size"]], State]:
    """Return the inverse of ``flatten_state``: the function from a row of numbers to a state.

    Args:
        plant: The plant, which determines the structure of its states.
        inputs: Its inputs on a grid.
    """
    shape = jax.eval_shape(plant.init, inputs.sample_signals[0])
    return ravel_pytree(jax.tree.map(lambda leaf: jnp.zeros(leaf.shape, leaf.dtype), shape))[1]
