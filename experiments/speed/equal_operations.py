"""What merging equal operations before compilation buys.

    python experiments/speed/equal_operations.py [--quick] [--json FILE] [--out DIR]

The shipped training recording of the wire that lifts a weight is simulated, and differentiated by all free parameters,
with and without ``smajax.numerics.common_subexpressions``: as a wire of one temperature and one grain, and with nine
cells of six grains. Times of compiled programs are the shortest of several that alternate, in seconds of processor
time; those of compilation, which include tracing, are of one call without any cache.
"""

import sys
import time
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any
from unittest import mock

sys.path.insert(0, str(Path(__file__).resolve().parents[2]))  # the checkout: smajax, tests/reference, experiments

from experiments.common.base import Row, arguments, finish, read_shipped, say

import jax
import jax.numpy as jnp

from smajax import parameters
from smajax.numerics.loop_kernels import jit_with_kernels
from smajax.plant.cells import Cells
from smajax.plant.grains import Grains
from smajax.plant.plant import Plant
from smajax.simulation import sensitivities, time_stepping
from smajax.simulation.inputs import Inputs, discretise
from smajax.simulation.run import simulate_channels

# Share of run time from which merging would count as slower.
LIMIT = 0.05
MERGED, SEPARATE = "merged", "separate"


def seconds(function: Callable[[], Any]) -> float:
    """Return the processor time of a call, in s."""
    begin = time.process_time()
    jax.block_until_ready(function())
    return time.process_time() - begin


def compare(name: str, function: Callable[[jax.Array], jax.Array], at: jax.Array, repeats: int) -> Row:
    """Compile and run a function in both ways.

    Args:
        name: What it computes.
        function: Function of the free parameters.
        at: Their values.
        repeats: Number of runs in each way.
    """
    say(f"{name} ...")
    programs, compilation = {}, {}
    for way in (MERGED, SEPARATE):
        jax.clear_caches()
        # A new function, so that JAX does not take the program of the other way for it.
        program = programs[way] = jit_with_kernels(lambda values: function(values))
        if way == MERGED:
            compilation[way] = seconds(lambda p=program: p(at))
            continue
        with (
            mock.patch.object(time_stepping, "merge_equal_operations", lambda f: f),
            mock.patch.object(sensitivities, "merge_equal_operations", lambda f: f),
        ):
            compilation[way] = seconds(lambda p=program: p(at))
    times = [{way: seconds(lambda p=p: p(at)) for way, p in programs.items()} for _ in range(repeats)]
    run = {way: min(each[way] for each in times) for way in programs}
    ratios = {"run": run[MERGED] / run[SEPARATE], "compilation": compilation[MERGED] / compilation[SEPARATE]}
    text = (
        f"{1e3 * run[MERGED]:.2f} ms against {1e3 * run[SEPARATE]:.2f} ms ({ratios['run']:.2f} times), compiled in "
        f"{compilation[MERGED]:.1f} s against {compilation[SEPARATE]:.1f} s ({ratios['compilation']:.2f} times)"
    )
    numbers = {"run": run, "compilation": compilation, "ratios": ratios}
    return Row(name, f"not slower by {100 * LIMIT:.0f} %", text, ratios["run"] < 1.0 + LIMIT, numbers)


def main() -> None:
    """Run the experiment."""
    options = arguments(__doc__)
    jax.config.update("jax_enable_compilation_cache", False)
    rig, recording = read_shipped("dead-weight")
    structured = replace(rig.plant, cells=Cells(count=9), grains=Grains(count=6))
    at = jnp.stack([parameters.get(rig.plant, name) for name in rig.fit.names])
    rows = []
    for what, plant in (("one cell of one grain", rig.plant), ("nine cells of six grains", structured)):
        inputs = discretise(plant, recording, interpolation=rig.interpolation)

        def response(values: jax.Array, plant: Plant = plant, inputs: Inputs = inputs) -> jax.Array:
            changed = parameters.replace(plant, dict(zip(rig.fit.names, values, strict=True)))
            return simulate_channels(changed, inputs, ("displacement",))[0]["displacement"]

        for kind, function in (("simulation", response), ("derivatives", jax.jacfwd(response))):
            rows.append(compare(f"{what}, {kind}", function, at, 5 if options.quick else 30))
    finish(rows, options)


if __name__ == "__main__":
    main()
