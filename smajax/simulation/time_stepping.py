"""Time stepping of a plant: ``Plant.step`` as a diffrax solver.

``integrate`` takes all steps of a grid and computes an output at every grid point. It is not differentiable:
``smajax.simulation.sensitivities`` adds the derivatives.
"""

from collections.abc import Callable
from typing import Any, cast

import diffrax as dfx
import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float, Int

from smajax.plant.plant import Plant
from smajax.plant.state import State
from smajax.simulation.compilation import BLOCK, block_count, in_blocks, traced_step
from smajax.simulation.inputs import Inputs
from smajax.simulation.status import MELTING_TEMPERATURE, SimulationStatus

# An output of the plant, a state and the signals at one grid point.
OutputFunction = Callable[[Plant, State, jax.Array], Any]


class _EmptyTerm(dfx.AbstractTerm):
    """A term without content: the plant is in ``args``, and the solver computes the increments itself."""

    def vf(self, t: Any, y: Any, args: Any) -> Any:
        return y

    def contr(self, t0: Any, t1: Any, **kwargs: Any) -> Any:
        return t1 - t0

    def prod(self, vf: Any, control: Any) -> Any:
        return vf


class _PlantSolver(dfx.AbstractSolver):
    """``Plant.step`` as a diffrax solver that takes one block of steps at a time.

    ``y`` holds the outputs of the last block. The solver state counts the blocks, and carries the plant's state, the
    number of steps that could not be solved, and the highest temperature so far (NaN as soon as any temperature is
    NaN).
    """

    output_fn: OutputFunction = eqx.field(static=True)
    term_structure = _EmptyTerm
    interpolation_cls = dfx.LocalLinearInterpolation

    def order(self, terms: Any) -> int:
        return 2

    def init(self, terms: Any, t0: Any, t1: Any, y0: Any, args: Any) -> Any:
        _, _, start = args
        return jnp.asarray(0), (start, jnp.asarray(0), jnp.max(start.temperature))

    def step(self, terms: Any, t0: Any, t1: Any, y0: Any, args: Any, solver_state: Any, made_jump: Any) -> tuple:
        plant, rows, _ = args
        block, carry = solver_state

        def single(carry: tuple, row: tuple) -> tuple:
            state, unsolved, hottest = carry
            before, after, signal, duration = row
            state, failed = traced_step(plant, state, before, after, duration)
            carry = state, unsolved + failed, jnp.maximum(hottest, jnp.max(state.temperature))
            return carry, self.output_fn(plant, state, signal)

        carry, y1 = jax.lax.scan(single, carry, jax.tree.map(lambda leaf: leaf[block], rows))
        return y1, None, dict(y0=y0, y1=y1), (block + 1, carry), dfx.RESULTS.successful

    def func(self, terms: Any, t0: Any, y0: Any, args: Any) -> Any:
        return y0


def integrate(
    plant: Plant, inputs: Inputs, output_fn: OutputFunction, end_index: Any = None
) -> tuple[Any, Int[Array, ""]]:
    """Take all steps of a grid.

    Args:
        plant: The plant.
        inputs: Its inputs on the grid.
        output_fn: Output of the plant, a state and the signals; any pytree.
        end_index: Grid point at which the simulation may end; outputs after its block are infinite.

    Returns:
        The outputs at all grid points, leaves of shape ``(grid, ...)``, and the status code.
    """
    start = plant.init(inputs.sample_signals[0])
    count = inputs.time.shape[0] - 1
    blocks = -(-count // BLOCK)
    last = inputs.after[-1]
    rows = (
        in_blocks(inputs.before, last),
        in_blocks(inputs.after, last),
        in_blocks(grid_signals(inputs)[1:], last),
        in_blocks(jnp.diff(inputs.time), jnp.zeros(())),
    )
    first, structure = jax.tree.flatten(output_fn(plant, start, inputs.sample_signals[0]))
    solution = dfx.diffeqsolve(
        _EmptyTerm(),
        _PlantSolver(lambda *arguments: jax.tree.leaves(output_fn(*arguments))),  # diffrax takes no empty nodes
        0.0,
        float(blocks) if end_index is None else block_count(end_index).astype(float),
        1.0,  # the solver's clock counts blocks
        [jnp.broadcast_to(leaf, (BLOCK, *leaf.shape)) for leaf in first],
        args=(plant, rows, start),
        stepsize_controller=dfx.ConstantStepSize(),
        saveat=dfx.SaveAt(steps=True, solver_state=True),
        max_steps=blocks,
        adjoint=dfx.ForwardMode(),
        throw=False,
    )
    later, (_, carry) = cast(tuple, (solution.ys, solution.solver_state))
    outputs = [
        jnp.concatenate([a[None], b.reshape(blocks * BLOCK, *a.shape)[:count]])
        for a, b in zip(first, later, strict=True)
    ]
    return jax.tree.unflatten(structure, outputs), simulation_status(*carry)


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
