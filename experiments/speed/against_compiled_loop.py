"""Speed of the numbers at equal accuracy: against a loop that numba compiles, and derivatives against simulations.

    python experiments/speed/against_compiled_loop.py [--quick] [--json FILE] [--out DIR]

The loop (tests/reference/fast_loop.py) has the exact kinetics over a step and a second-order step of the heat balance.
It takes as many steps a sample as it needs for an error, against the exact simulator of tests/reference, that is no
larger than that of smajax; both are then timed in turn. The recording is data/recordings/dead-weight/train.csv. Wall
times exclude compilation. ``--quick`` repeats less, and takes fewer sizes of a batch.
"""

import sys
from collections.abc import Callable
from functools import partial
from pathlib import Path
from typing import Any

sys.path.insert(0, str(Path(__file__).resolve().parents[2]))  # the checkout: smajax, tests/reference, experiments

from experiments.common.base import Row, arguments, finish, medians, read_shipped, refuse, say
from experiments.common.positioning import FOLDER, WIRES, make_problem, make_rig
from experiments.common.speed import fit_problem, linearise_residual, ready, simulate_residual

import jax
import jax.numpy as jnp
import numpy as np

from smajax import parameters
from smajax.control.tuning.objective import Objective, make_objective
from smajax.control.tuning.problem import TuningProblem
from smajax.files.rig_file import Rig
from smajax.fitting.problem import Problem
from smajax.numerics.ensemble import share_among_cores
from smajax.numerics.loop_kernels import jit_with_kernels
from smajax.recordings.recording import Recording
from smajax.simulation.inputs import Inputs
from smajax.simulation.run import simulate_batch, simulate_channels
from tests.reference.rig_file import read_rig as read_reference
from tests.reference.rig_file import simulate as simulate_reference

try:
    import numba

    from tests.reference import fast_loop
except ImportError as missing:
    refuse(f"the loop cannot be compiled: {missing}: pip install 'smajax[test]'")

THREADS = 2
DESIGNS = 1024
# Spread of the designs of a batch as a share of each parameter, and in K for temperatures.
SPREAD, TEMPERATURE_SPREAD = 0.05, 2.0
# Largest number of steps a sample that the loop may take.
MOST_STEPS = 64
# Ratios that count as good: one simulation and a design of a batch over the loop's time, the Jacobian of 8 parameters
# over one simulation, the gradient of a closed loop over its rollout, and costs of draws with gradients over the costs.
SINGLE, BATCH, JACOBIAN, GRADIENT, DRAWS = 0.5, 0.5, 3.0, 2.5, 4.0
# Parameters in which the cost of a draw is differentiated.
DIRECTIONS = 4
# Parameters that the fit of the shipped rig does not have, for a Jacobian of eight.
EXTRA_PARAMETERS = ("material.clausius_clapeyron_austenite", "material.clausius_clapeyron_martensite")


class Comparison:
    """The shipped dead weight, simulated by smajax and by the loop.

    Attributes:
        rig: The rig.
        recording: The recording.
        problem: The fit problem of the rig and the recording.
        error: RMS error of smajax against the exact simulator, m.
        loop_error: That of the loop with ``steps``, m.
        steps: Steps a sample with which the loop is as exact.
    """

    def __init__(self) -> None:
        self.rig: Rig
        self.recording: Recording
        self.rig, self.recording = read_shipped("dead-weight")
        self.problem: Problem = fit_problem([self.recording])
        self._current = np.asarray(self.recording.channels["current"])
        self._design = design_of(self.rig.plant, {})
        vector = jnp.asarray(self.problem.nominal)
        ours = np.asarray(self.problem.predict(vector)[0])[0, 0][: len(self.recording)]
        channels = {"time": np.asarray(self.recording.time), "current": self._current}
        exact = simulate_reference(read_reference(FOLDER / "rig.toml"), channels).position
        self.error = float(np.sqrt(np.mean((ours - exact) ** 2)))
        for self.steps in range(1, MOST_STEPS + 1):
            self.loop_error = float(np.sqrt(np.mean((self.loop(self.steps) - exact) ** 2)))
            if self.loop_error <= self.error:
                break
        else:
            refuse(f"the loop errs by {self.loop_error:.3g} m with {MOST_STEPS} steps a sample, more than smajax")

    def loop(self, steps: int) -> np.ndarray:
        """Return the contraction by the loop, m, shape ``(n,)``."""
        return fast_loop.dead_weight(self._design, self.recording.time, self._current, linear=True, substeps=steps)

    def loops(self, designs: np.ndarray) -> np.ndarray:
        """Return the contractions of many designs by the loop, on all threads of numba, m, shape ``(m, n)``."""
        return fast_loop.dead_weight_batch(
            designs, self.recording.time, self._current, linear=True, substeps=self.steps
        )

    @property
    def inputs(self) -> Inputs:
        """The inputs of the recording."""
        return jax.tree.map(lambda leaf: leaf[0], self.problem.data.inputs)


def design_of(plant: Any, values: dict[str, float]) -> Any:
    """Return the parameters of a plant, some of them replaced, as the loop takes them."""
    plant = parameters.replace(plant, values)
    fields = {name.split(".", 1)[1]: float(parameters.get(plant, name)) for name in parameters.all_declarations(plant)}
    for phase in ("austenite", "martensite"):
        for end in ("start", "finish"):
            fields[f"{phase}_{end}"] += fields[f"{phase}_shift"]
    return fast_loop.Design(**{field: fields.get(field, 0.0) for field in fast_loop.Design._fields})


def ratio_row(what: str, target: float, repeats: int, functions: dict[str, Callable[[], Any]]) -> Row:
    """Time two functions in turn, and return the row of the second one's time over that of the first.

    Args:
        what: What is compared.
        target: Largest ratio that counts as good.
        repeats: Number of calls of each.
        functions: The two functions by name.
    """
    seconds = medians(repeats, functions)
    first, second = seconds.values()
    ratio = second / first
    text = f"{ratio:.2f}x ({1e3 * second:.2f} ms against {1e3 * first:.2f} ms)"
    return Row(what, f"<= {target:g}x", text, ratio <= target, {"ratio": ratio, **seconds})


def single_row(comparison: Comparison, repeats: int) -> Row:
    """Time one simulation against the loop."""
    vector = jnp.asarray(comparison.problem.nominal)
    functions = {
        "loop": lambda: comparison.loop(comparison.steps),
        "smajax": ready(simulate_residual, comparison.problem, vector),
    }
    return ratio_row(f"one simulation of {len(comparison.recording)} samples over the loop", SINGLE, repeats, functions)


def drawn_designs(comparison: Comparison) -> dict[str, np.ndarray]:
    """Draw values of the parameters of the fit around those of the rig, shape ``(DESIGNS,)`` each."""
    unknowns = comparison.problem.unknowns
    factors = np.random.default_rng(0).standard_normal((DESIGNS, len(unknowns)))
    return {
        u.name: u.nominal + factors[:, i] * (TEMPERATURE_SPREAD if u.unit == "K" else SPREAD * u.nominal)
        for i, u in enumerate(unknowns)
    }


def batch_row(comparison: Comparison, quick: bool) -> Row:
    """Time a batch of designs, in chunks on one thread and more, against the loop on as many threads."""
    values = drawn_designs(comparison)
    plant, channels = comparison.rig.plant, tuple(comparison.rig.fit.observe)
    designs = np.array([design_of(plant, {n: v[k] for n, v in values.items()}) for k in range(DESIGNS)])
    functions: dict[str, Callable[[], Any]] = {"loop": lambda: comparison.loops(designs)}
    for size in (64,) if quick else (16, 32, 64, 128, 256, 512):
        for threads in (1, THREADS):
            words = f"chunks of {size} on {threads} thread{'s' if threads > 1 else ''}"
            functions[words] = _in_chunks(plant, values, comparison.inputs, channels, size, threads)
    seconds = medians(3 if quick else 7, functions)
    ms = {kind: 1e3 * total / DESIGNS for kind, total in seconds.items()}
    say("batch of designs, ms each: " + ", ".join(f"{kind}: {each:.3f}" for kind, each in ms.items()))
    best = min((kind for kind in ms if kind != "loop"), key=lambda kind: ms[kind])
    ratio = ms[best] / ms["loop"]
    return Row(
        f"a design of a batch of {DESIGNS:,} over the loop on {THREADS} threads",
        f"<= {BATCH:g}x",
        f"{ratio:.2f}x ({ms[best]:.3f} ms in {best}, against {ms['loop']:.3f} ms)",
        ratio <= BATCH,
        {"ratio": ratio, "milliseconds_per_design": ms, "best": best},
    )


def _in_chunks(
    plant: Any, values: dict[str, np.ndarray], inputs: Inputs, channels: tuple[str, ...], size: int, threads: int
) -> Callable[[], Any]:
    chunks = [{n: jnp.asarray(v[k : k + size]) for n, v in values.items()} for k in range(0, DESIGNS, size)]

    def simulate_chunk(chunk: dict[str, jax.Array]) -> np.ndarray:
        return np.asarray(simulate_batch(plant, chunk, inputs, channels)[0][channels[0]])

    return lambda: share_among_cores(simulate_chunk, chunks, workers=threads)


def draws_row(comparison: Comparison, quick: bool) -> Row:
    """Time the costs of draws of parameters on the recording, with their gradients, over the costs alone."""
    plant, inputs, (channel,) = comparison.rig.plant, comparison.inputs, comparison.rig.fit.observe
    drawn = drawn_designs(comparison)
    names = tuple(drawn)[:DIRECTIONS]
    points = np.stack([drawn[name] for name in names], axis=1)
    measured = jnp.asarray(comparison.recording.channels[channel])

    def cost(point: jax.Array) -> jax.Array:
        drawn_plant = parameters.replace(plant, dict(zip(names, point, strict=True)))
        modelled = simulate_channels(drawn_plant, inputs, (channel,))[0][channel]
        return jnp.mean((modelled[: len(measured)] - measured) ** 2)

    def cost_and_gradient(point: jax.Array) -> tuple[jax.Array, jax.Array]:
        return jax.vmap(lambda tangent: jax.jvp(cost, (point,), (tangent,)), out_axes=(None, 0))(jnp.eye(DIRECTIONS))

    programs = {"values": jit_with_kernels(jax.vmap(cost)), "gradients": jit_with_kernels(jax.vmap(cost_and_gradient))}
    functions: dict[str, Callable[[], Any]] = {}
    for size in (16,) if quick else (8, 16, 32, 64):
        parts = [jnp.asarray(points[k : k + size]) for k in range(0, DESIGNS, size)]
        for name, program in programs.items():
            evaluate = partial(_evaluate_parts, program, parts)
            evaluate()
            functions[f"{name} in chunks of {size}"] = evaluate
    ms = {words: 1e3 * total / DESIGNS for words, total in medians(3 if quick else 7, functions).items()}
    say("draws, ms each: " + ", ".join(f"{words}: {each:.3f}" for words, each in ms.items()))
    values, gradients = (min(each for words, each in ms.items() if words.startswith(name)) for name in programs)
    return Row(
        f"costs of {DESIGNS:,} draws on the recording with gradients in {DIRECTIONS} parameters over the costs, "
        f"{THREADS} threads",
        f"<= {DRAWS:g}x",
        f"{gradients / values:.2f}x ({gradients:.3f} ms a draw against {values:.3f} ms)",
        gradients / values <= DRAWS,
        {"ratio": gradients / values, "milliseconds_per_draw": ms},
    )


def _evaluate_parts(program: Callable[[jax.Array], Any], parts: list[jax.Array]) -> list[Any]:
    return share_among_cores(lambda part: jax.block_until_ready(program(part)), parts, workers=THREADS)


def jacobian_row(recording: Recording, repeats: int) -> Row:
    """Time the residual with its Jacobian of eight parameters over one simulation."""
    problem = fit_problem([recording], EXTRA_PARAMETERS)
    vector = jnp.asarray(problem.nominal)
    functions = {
        "simulation": ready(simulate_residual, problem, vector),
        "jacobian": ready(linearise_residual, problem, vector),
    }
    what = f"residual and Jacobian of {len(vector)} parameters over one simulation"
    return ratio_row(what, JACOBIAN, repeats, functions)


@jit_with_kernels
def _cost(problem: TuningProblem, point: jax.Array, objective: Objective) -> jax.Array:
    terms = problem.objective_terms(point, objective).terms
    return jnp.sum(jnp.mean(jnp.sum(terms**2, axis=2), axis=0) * objective.weights)


@jit_with_kernels
def _cost_and_gradient(problem: TuningProblem, point: jax.Array, objective: Objective) -> tuple[jax.Array, jax.Array]:
    return jax.value_and_grad(lambda p: _cost(problem, p, objective))(point)


def gradient_row(repeats: int) -> Row:
    """Time the tracking error of a closed loop of a minute with its gradient in the gains over one rollout."""
    wire = WIRES["0.15 mm"]
    problem, objective = make_problem(wire, make_rig(wire)[0], noisy=False), make_objective({"tracking": 1.0}, {})
    point = jnp.asarray(problem.start)
    functions = {
        "rollout": ready(_cost, problem, point, objective),
        "gradient": ready(_cost_and_gradient, problem, point, objective),
    }
    duration = wire.period * problem.reference.values.shape[0]
    what = f"cost of a loop of {duration:.0f} s with its gradient in {len(problem.names)} gains over one rollout"
    return ratio_row(what, GRADIENT, repeats, functions)


def main() -> None:
    """Print the table."""
    args = arguments(__doc__ or "")
    numba.set_num_threads(min(THREADS, numba.config.NUMBA_NUM_THREADS))
    comparison, repeats = Comparison(), 20 if args.quick else 60
    exactness = Row(
        "RMS error of the contraction against the exact simulator",
        "-",
        f"{1e3 * comparison.error:.3g} mm, the loop's {1e3 * comparison.loop_error:.3g} mm with {comparison.steps} "
        "steps a sample",
        None,
        {"error": comparison.error, "loop_error": comparison.loop_error, "steps_a_sample": comparison.steps},
    )
    rows = [exactness, single_row(comparison, repeats), batch_row(comparison, args.quick)]
    rows += [jacobian_row(comparison.recording, repeats), gradient_row(repeats), draws_row(comparison, args.quick)]
    finish(rows, args)


if __name__ == "__main__":
    main()
