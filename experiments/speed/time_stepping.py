"""Time stepping of a plant: a plain scan over the implicit steps, against the same steps as a diffrax solver.

    python experiments/speed/time_stepping.py [--quick] [--json FILE] [--out DIR]

smajax takes its implicit steps in a plain ``jax.lax.scan`` (``smajax.simulation.time_stepping``). The alternative makes
the step a diffrax solver that takes a block of steps at a time, since diffrax's overhead for a step costs more than the
step. Both give the same states, up to rounding. Times of compiled simulations are the shortest of many that alternate,
in seconds of processor time, which other programs on the machine disturb least; those of compilation include tracing.
"""

import sys
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any, cast

sys.path.insert(0, str(Path(__file__).resolve().parents[2]))  # the checkout: smajax, tests/reference, experiments

from experiments.common.base import Row, arguments, finish, read_shipped, say

import diffrax as dfx
import jax
import jax.numpy as jnp

from smajax.numerics.loop_kernels import jit_with_kernels
from smajax.plant.plant import Plant
from smajax.simulation.compilation import BLOCK, flatten_state, in_blocks, traced_step
from smajax.simulation.inputs import Inputs, discretise
from smajax.simulation.time_stepping import grid_signals, integrate

# Share of run time from which the scan would count as slower.
LIMIT = 0.05
# Largest relative difference of two states that counts as rounding: the two programs are compiled differently.
ROUNDING = 1e-9
# Keeps a quotient finite for an entry of the state that stays 0.
TINY = 1e-300


class EmptyTerm(dfx.AbstractTerm):
    """A term without content: the plant is in ``args``, and the solver computes the increments itself."""

    def vf(self, t: Any, y: Any, args: Any) -> Any:
        return y

    def contr(self, t0: Any, t1: Any, **kwargs: Any) -> Any:
        return t1 - t0

    def prod(self, vf: Any, control: Any) -> Any:
        return vf


class BlockSolver(dfx.AbstractSolver):
    """The implicit step as a diffrax solver; ``y`` holds the flat states of the last block."""

    term_structure = EmptyTerm
    interpolation_cls = dfx.LocalLinearInterpolation

    def order(self, terms: Any) -> int:
        return 2

    def init(self, terms: Any, t0: Any, t1: Any, y0: Any, args: Any) -> Any:
        return jnp.asarray(0), (args[2], jnp.asarray(0))

    def step(self, terms: Any, t0: Any, t1: Any, y0: Any, args: Any, solver_state: Any, made_jump: Any) -> tuple:
        plant, rows, _ = args
        block, carry = solver_state

        def single(carry: tuple, row: tuple) -> tuple:
            before, after, signal, duration = row
            state, failed = traced_step(plant, carry[0], before, after, duration)
            return (state, carry[1] + failed), flatten_state(plant, state, signal)

        carry, y1 = jax.lax.scan(single, carry, jax.tree.map(lambda leaf: leaf[block], rows))
        return y1, None, dict(y0=y0, y1=y1), (block + 1, carry), dfx.RESULTS.successful

    def func(self, terms: Any, t0: Any, y0: Any, args: Any) -> Any:
        return y0


def with_diffrax(plant: Plant, inputs: Inputs) -> jax.Array:
    """Return the flat states at all grid points, by ``BlockSolver``."""
    start, last, count = plant.init(inputs.sample_signals[0]), inputs.after[-1], inputs.time.shape[0] - 1
    rows = (
        in_blocks(inputs.before, last),
        in_blocks(inputs.after, last),
        in_blocks(grid_signals(inputs)[1:], last),
        in_blocks(jnp.diff(inputs.time), jnp.zeros(())),
    )
    first, blocks = flatten_state(plant, start, last), -(-count // BLOCK)
    solution = dfx.diffeqsolve(
        EmptyTerm(),
        BlockSolver(),
        0.0,
        float(blocks),
        1.0,  # the solver's clock counts blocks
        jnp.broadcast_to(first, (BLOCK, *first.shape)),
        args=(plant, rows, start),
        stepsize_controller=dfx.ConstantStepSize(),
        saveat=dfx.SaveAt(steps=True),
        max_steps=blocks,
        adjoint=dfx.ForwardMode(),
        throw=False,
    )
    later = cast(jax.Array, solution.ys).reshape(blocks * BLOCK, *first.shape)
    return jnp.concatenate([first[None], later[:count]])


def with_scan(plant: Plant, inputs: Inputs) -> jax.Array:
    """Return the flat states at all grid points, as smajax takes the steps."""
    return integrate(plant, inputs, flatten_state)[0]


def seconds(function: Callable[[], Any]) -> float:
    """Return the processor time of a call, in s."""
    begin = time.process_time()
    jax.block_until_ready(function())
    return time.process_time() - begin


def compare(name: str, repeats: int) -> Row:
    """Compare both on the shipped training recording of a rig.

    Args:
        name: Name of the rig.
        repeats: Number of simulations by each.
    """
    rig, recording = read_shipped(name)
    inputs = discretise(rig.plant, recording, interpolation=rig.interpolation)
    first = rig.plant.init(inputs.sample_signals[0])
    traced_step(rig.plant, first, inputs.before[0], inputs.after[0], jnp.asarray(0.01))  # both find the step traced
    calls = {k: jit_with_kernels(f) for k, f in (("scan", with_scan), ("diffrax", with_diffrax))}
    compilation = {k: seconds(lambda f=f: f(rig.plant, inputs)) for k, f in calls.items()}
    times = [{k: seconds(lambda f=f: f(rig.plant, inputs)) for k, f in calls.items()} for _ in range(repeats)]
    run = {k: min(each[k] for each in times) for k in calls}
    states = {k: f(rig.plant, inputs) for k, f in calls.items()}
    scale = jnp.maximum(jnp.max(jnp.abs(states["scan"]), axis=0), TINY)
    difference = float(jnp.max(jnp.abs(states["scan"] - states["diffrax"]) / scale))
    cost = run["diffrax"] / run["scan"] - 1.0
    text = (
        f"{1e3 * run['scan']:.2f} ms against {1e3 * run['diffrax']:.2f} ms with diffrax ({100 * cost:+.0f} %); "
        f"compiled in {compilation['scan']:.1f} s against {compilation['diffrax']:.1f} s; "
        f"states differ by {difference:.0e}"
    )
    target = f"equal states to {ROUNDING:.0e}, scan not slower by {100 * LIMIT:.0f} %"
    numbers = {"run": run, "compilation": compilation, "steps": len(inputs.time) - 1, "difference": difference}
    return Row(f"{name}, {len(inputs.time) - 1} steps", target, text, difference < ROUNDING and cost > -LIMIT, numbers)


def main() -> None:
    """Run the experiment."""
    options = arguments(__doc__)
    rows = []
    for name in ("dead-weight", "rotary"):
        say(f"{name} ...")
        rows.append(compare(name, 20 if options.quick else 200))
    finish(rows, options)


if __name__ == "__main__":
    main()
