"""Cells along the wire and grains: convergence in their numbers, and what they cost.

    python experiments/speed/cells_and_grains.py [--quick] [--json FILE] [--out DIR]

The shipped wire that lifts a weight is simulated with more and more cells and grains. Errors are root mean squares of
the displacement, relative to its range, against a finer plant. The cost is the processor time of a compiled simulation
and of its derivatives by all free parameters, and that of whole fits from one start without compilation, over those of
one cell and one grain, each the shortest of several. One fit is to a recording simulated by the same plant with
other parameters and noise; the other is to the shipped recording, of a wire of one cell and one grain, to which nine
cells of six grains need more steps.
"""

import sys
import time
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

sys.path.insert(0, str(Path(__file__).resolve().parents[2]))  # the checkout: smajax, tests/reference, experiments

from experiments.common.base import Row, arguments, finish, read_shipped, say

import jax
import jax.numpy as jnp
import numpy as np

from smajax import parameters
from smajax.fitting.fit import fit
from smajax.numerics.loop_kernels import jit_with_kernels
from smajax.plant.cells import Cells
from smajax.plant.grains import Grains
from smajax.plant.plant import Plant
from smajax.recordings.recording import Recording
from smajax.simulation.inputs import Inputs, discretise
from smajax.simulation.run import simulate_channels

# Largest relative error of the recommended numbers: half of the 1 % that a displacement sensor usually resolves.
CONVERGED = 0.005
# Largest cost of nine cells of six grains in a fit.
LARGEST_COST = 10.0
RECOMMENDED = (9, 6)
# True parameters of simulated recordings, which differ from the start values, and the standard deviation of their
# noise, m.
TRUTH = {"heat.h0": 80.0, "material.max_transformation_strain": 0.044, "material.martensite_shift": 3.0}
NOISE = 2e-5


def with_structure(plant: Plant, cells: int, grains: int) -> Plant:
    """Return a plant with cells and grains; 1 for none."""
    return replace(
        plant,
        cells=Cells(count=cells) if cells > 1 else None,
        grains=Grains(count=grains) if grains > 1 else None,
    )


def displacement(plant: Plant, inputs: Inputs) -> np.ndarray:
    """Simulate the displacement at the samples."""
    return np.asarray(
        jit_with_kernels(lambda p: simulate_channels(p, inputs, ("displacement",))[0]["displacement"])(plant)
    )


def shortest(function: Callable[[], Any], repeats: int) -> float:
    """Return the shortest processor time of several calls after a first one, s."""
    jax.block_until_ready(function())
    times = []
    for _ in range(repeats):
        begin = time.process_time()
        jax.block_until_ready(function())
        times.append(time.process_time() - begin)
    return min(times)


def simulated_recording(plant: Plant, recording: Recording, interpolation: str) -> Recording:
    """Return a recording of a plant with the parameters of ``TRUTH``, under the current of another recording."""
    truth = displacement(parameters.replace(plant, TRUTH), discretise(plant, recording, interpolation=interpolation))
    noise = NOISE * np.random.default_rng(0).standard_normal(len(truth))
    channels = {"current": recording.channels["current"], "displacement": truth + noise}
    return Recording.from_arrays("simulated", recording.time, channels)


def convergence(plant: Plant, inputs: Inputs, quick: bool) -> list[Row]:
    """Errors over the numbers of cells and grains, each against a finer plant."""
    rows = []
    for what, numbers, finest, structure in (
        ("cells", (3, 5, 9, 17), 33 if quick else 65, lambda n: (n, 1)),
        ("grains", (2, 4, 6, 12), 24 if quick else 48, lambda k: (1, k)),
    ):
        say(f"convergence in the number of {what} ...")
        exact = displacement(with_structure(plant, *structure(finest)), inputs)
        errors = {}
        for number in numbers:
            difference = displacement(with_structure(plant, *structure(number)), inputs) - exact
            errors[number] = float(np.sqrt(np.mean(difference**2)) / np.ptp(exact))
        recommended = RECOMMENDED[0 if what == "cells" else 1]
        text = ", ".join(f"{number}: {100 * error:.2f} %" for number, error in errors.items())
        falls = all(b < a for a, b in zip(list(errors.values())[:-1], list(errors.values())[1:], strict=True))
        target = f"falling, at most {100 * CONVERGED:g} % with {recommended}"
        met = falls and errors[recommended] <= CONVERGED
        rows.append(Row(f"error with {what}, against {finest}", target, text, met, {"errors": errors}))
    return rows


def cost(rig: Any, recording: Recording, quick: bool) -> list[Row]:
    """Processor times of a simulation, of its derivatives, and of two fits from one start."""
    simulated, shipped = "fit to a simulated recording", "fit to the shipped recording"
    times: dict[str, list[float]] = {"simulation": [], "derivatives": [], simulated: [], shipped: []}
    settings = replace(rig.fit, starts=1)
    for structure in ((1, 1), RECOMMENDED):
        say(f"cost of {structure[0]} cells of {structure[1]} grains ...")
        plant = with_structure(rig.plant, *structure)
        inputs = discretise(plant, recording, interpolation=rig.interpolation)

        def response(values: jax.Array, plant: Plant = plant, inputs: Inputs = inputs) -> jax.Array:
            changed = parameters.replace(plant, dict(zip(rig.fit.names, values, strict=True)))
            return simulate_channels(changed, inputs, ("displacement",))[0]["displacement"]

        at = jnp.stack([parameters.get(plant, name) for name in rig.fit.names])
        for what, function in (("simulation", response), ("derivatives", jax.jacfwd(response))):
            compiled = jit_with_kernels(function)
            times[what].append(shortest(lambda f=compiled, at=at: f(at), 3 if quick else 10))
        for what, data in ((simulated, simulated_recording(plant, recording, rig.interpolation)), (shipped, recording)):
            times[what].append(
                shortest(lambda p=plant, d=data: fit(p, [d], settings, interpolation=rig.interpolation).cost, 3)
            )
    rows = []
    for what, (one, many) in times.items():
        ratio = many / one
        target, met = ("-", None) if what != simulated else (f"at most times {LARGEST_COST:g}", ratio <= LARGEST_COST)
        name = f"cost of {RECOMMENDED[0]} cells of {RECOMMENDED[1]} grains: {what}"
        text = f"{1e3 * one:.1f} ms, times {ratio:.1f}"
        rows.append(Row(name, target, text, met, {"times": [one, many], "ratio": ratio}))
    return rows


def main() -> None:
    """Run the experiment."""
    options = arguments(__doc__)
    rig, recording = read_shipped("dead-weight")
    inputs = discretise(rig.plant, recording, interpolation=rig.interpolation)
    finish([*convergence(rig.plant, inputs, options.quick), *cost(rig, recording, options.quick)], options)


if __name__ == "__main__":
    main()
