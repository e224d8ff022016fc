"""What merging equal operations, storing repeated values and loops over one axis buy in compiled loops.

    python experiments/speed/compiled_loops.py [--quick] [--json FILE] [--out DIR]

The shipped training recording of the wire that lifts a weight is simulated, and differentiated by all free parameters,
as the package compiles it, without ``smajax.numerics.common_subexpressions``, without
``smajax.numerics.stored_values``, and, where cells have grains, without one axis for all of them: as a wire of one
temperature and one grain, with nine cells, with six grains, with both, and as a batch of designs of one temperature and
one grain. Times of compiled programs are the shortest of several that alternate, in seconds of processor time; those of
compilation, which include tracing, are of one call without any cache.
"""

import contextlib
import sys
import time
from collections.abc import Callable, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any
from unittest import mock

sys.path.insert(0, str(Path(__file__).resolve().parents[2]))  # the checkout: smajax, tests/reference, experiments

from experiments.common.base import Row, arguments, finish, read_shipped, say

import jax
import jax.numpy as jnp

from smajax import parameters
from smajax.numerics import loop_kernels
from smajax.numerics.loop_kernels import jit_with_kernels
from smajax.plant.cells import Cells
from smajax.plant.grains import Grains
from smajax.plant.plant import Plant
from smajax.simulation import sensitivities, time_stepping
from smajax.simulation.inputs import Inputs, discretise
from smajax.simulation.run import simulate_channels

# Share of run time from which the package's way would count as slower.
LIMIT = 0.05
# Designs of the batch, one of the chunks of experiments/speed/against_compiled_loop.py.
DESIGNS = 64
# Relative difference between the designs of the batch.
SPREAD = 0.01
PACKAGE, SEPARATE, REPEATED = "as the package does", "equal operations separate", "values repeated"
NESTED = "an axis each for grains, cells and wires"


def same(function: Callable[..., Any]) -> Callable[..., Any]:
    """Return a function as it is."""
    return function


PATCHES = {
    PACKAGE: (),
    SEPARATE: ((time_stepping, "merge_equal_operations", same), (sensitivities, "merge_equal_operations", same)),
    REPEATED: ((loop_kernels, "store_repeated_values", lambda module, loop: None),),
    NESTED: ((Plant, "_flat_over_grains", lambda plant, values: jnp.broadcast_to(values, plant.fractions_shape)),),
}


def seconds(function: Callable[[], Any]) -> float:
    """Return the processor time of a call, in s."""
    begin = time.process_time()
    jax.block_until_ready(function())
    return time.process_time() - begin


def compare(
    name: str, function: Callable[[jax.Array], jax.Array], at: jax.Array, repeats: int, ways: Sequence[str]
) -> Row:
    """Compile and run a function in several ways.

    Args:
        name: What it computes.
        function: Function of the free parameters.
        at: Their values.
        repeats: Number of runs in each way.
        ways: Keys of ``PATCHES``.
    """
    say(f"{name} ...")
    programs, compilation = {}, {}
    for way in ways:
        jax.clear_caches()
        # A new function, so that JAX does not take the program of another way for it.
        program = programs[way] = jit_with_kernels(lambda values: function(values))
        with contextlib.ExitStack() as stack:
            for patch in PATCHES[way]:
                stack.enter_context(mock.patch.object(*patch))
            compilation[way] = seconds(lambda p=program: p(at))
    times = [{way: seconds(lambda p=p: p(at)) for way, p in programs.items()} for _ in range(repeats)]
    run = {way: min(each[way] for each in times) for way in programs}
    ratios = {
        way: {"run": run[PACKAGE] / run[way], "compilation": compilation[PACKAGE] / compilation[way]}
        for way in ways
        if way != PACKAGE
    }
    compared = (
        f"{ratio['run']:.2f} times that with {way} (compiled in {ratio['compilation']:.2f} times)"
        for way, ratio in ratios.items()
    )
    text = f"{1e3 * run[PACKAGE]:.2f} ms, compiled in {compilation[PACKAGE]:.1f} s: {', '.join(compared)}"
    numbers = {"run": run, "compilation": compilation, "ratios": ratios}
    met = all(ratio["run"] < 1.0 + LIMIT for ratio in ratios.values())
    return Row(name, f"not slower by {100 * LIMIT:.0f} %", text, met, numbers)


def main() -> None:
    """Run the experiment."""
    options = arguments(__doc__)
    jax.config.update("jax_enable_compilation_cache", False)
    rig, recording = read_shipped("dead-weight")
    cells, grains = Cells(count=9), Grains(count=6)
    plants = {
        "one cell of one grain": rig.plant,
        "nine cells": replace(rig.plant, cells=cells),
        "six grains": replace(rig.plant, grains=grains),
        "nine cells of six grains": replace(rig.plant, cells=cells, grains=grains),
    }
    at, repeats = jnp.stack([parameters.get(rig.plant, name) for name in rig.fit.names]), 5 if options.quick else 30
    designs = at * jnp.linspace(1.0 - SPREAD, 1.0 + SPREAD, DESIGNS)[:, None]
    rows = []
    for what, plant in plants.items():
        inputs = discretise(plant, recording, interpolation=rig.interpolation)

        def response(values: jax.Array, plant: Plant = plant, inputs: Inputs = inputs) -> jax.Array:
            changed = parameters.replace(plant, dict(zip(rig.fit.names, values, strict=True)))
            return simulate_channels(changed, inputs, ("displacement",))[0]["displacement"]

        ways = [way for way in PATCHES if way != NESTED or (plant.cells and plant.grains)]
        for kind, function in (("simulation", response), ("derivatives", jax.jacfwd(response))):
            rows.append(compare(f"{what}, {kind}", function, at, repeats, ways))
        if plant is rig.plant:
            rows.append(compare(f"{what}, {DESIGNS} designs", jax.vmap(response), designs, repeats, ways))
    finish(rows, options)


if __name__ == "__main__":
    main()
