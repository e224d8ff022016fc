"""Twelve design tasks: is the answer feasible on the exact simulator with its margin, and how good is it?

    python experiments/speed/design_tasks.py [--quick] [--json FILE] [--out DIR]

Each task is a sweep of 512 designs with a refinement, as the command runs it, with the limits of the material and a
margin of the ambient temperature. Its answer is simulated by the exact simulator of tests/reference, which shares no
code with smajax, at all corners of the margin: every constraint must hold. The best of 100,000 other samples of the
same space is that which satisfies the same constraints with the same margin. About 30 minutes on two cores; --quick
takes two tasks and 2,000 samples.
"""

import sys
import tempfile
import time
from pathlib import Path

sys.path.insert(0, str(Path(__file__).resolve().parents[2]))  # the checkout: smajax, tests/reference, experiments

from experiments.common.base import Row, arguments, finish, say
from experiments.common.design_tasks import TASKS, DesignTask, exact_with_margins

import numpy as np

from smajax.api.sweep import sweep
from smajax.files.rig_file import parse_rig
from smajax.numerics.ensemble import parallel_batches
from smajax.report.shown_values import format_value
from smajax.sweeps.chunks import evaluate_designs, split_into_chunks
from smajax.sweeps.design_input import design_input
from smajax.sweeps.margins import HIGHEST, LOWEST
from smajax.sweeps.pareto import feasible_mask
from smajax.sweeps.problem import AbstractSweepProblem
from smajax.sweeps.space import draw_designs
from smajax.sweeps.sweep_file import SweepFile, read_sweep

DESIGNS = 512
SAMPLES = 100_000
SEED = 1  # another than that of the sweep, so that the samples are others
SUBSTEPS = 20  # as the tests of the metrics
# Largest loss against the best sample.
LOSS = 0.02
# Designs with margin that are simulated at a time, in the order of the objective, until one is feasible.
BATCH = 256


def main() -> None:
    """Print the table."""
    args = arguments(__doc__ or "")
    tasks, samples = (TASKS[:2], 2_000) if args.quick else (TASKS, SAMPLES)
    rows = []
    for task in tasks:
        began = time.perf_counter()
        rows += [task_row(task, samples)]
        say(f"{rows[-1].what}: {rows[-1].measured} ({time.perf_counter() - began:.0f} s)")
    met = sum(row.met for row in rows)
    rows.append(Row("tasks with both", "all", f"{met} of {len(rows)}", met == len(rows)))
    finish(rows, args, samples=samples, designs=DESIGNS)


def task_row(task: DesignTask, samples: int) -> Row:
    """Return the row of a task.

    Args:
        task: The task.
        samples: Number of samples with which its answer is compared.
    """
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        (folder / "rig.toml").write_text(task.rig_text(), "utf-8")
        (folder / "sweep.toml").write_text(task.sweep_text(DESIGNS), "utf-8")
        description, study = read_sweep(folder / "sweep.toml"), sweep(folder / "sweep.toml")
    metric, goal = next(iter(description.objectives.items()))
    sign = -1.0 if goal == "max" else 1.0
    problem = description.problem()
    sampled = best_sample(description, problem, samples, metric, sign)
    target = f"feasible with its margin, within {100 * LOSS:.0f} % of the best of {samples:,}"
    answers = [entry for entry in study.refined if entry["better"]] + list(study.pareto)
    if not answers:
        return Row(task.title, target, "no answer", False, {"sampled": sampled})
    answer = min(answers, key=lambda entry: sign * float(entry["metrics"][metric]))
    slack, exact = exact_slack(description, problem, answer)
    unit, value = problem.units[metric], float(answer["metrics"][metric])
    words = f"{metric} {format_value(value, unit)}, exactly {format_value(exact[metric], unit)}; nearest constraint: "
    tightest = min(slack, key=lambda n: slack[n])
    words += f"{tightest} {100 * slack[tightest]:+.3f} %"
    loss = -np.inf if sampled is None else sign * (value - sampled) / abs(sampled)
    words += f"; best sample: {'none' if sampled is None else format_value(sampled, unit)}"
    words += "" if sampled is None else f" ({100 * abs(loss):.1f} % {'worse' if loss < 0 else 'better'})"
    feasible = slack[tightest] >= 0.0
    numbers = {"answer": answer["parameters"], "value": value, "exact": exact, "slack": slack, "sampled": sampled}
    return Row(task.title, target, words, bool(feasible and loss <= LOSS), numbers)


def exact_slack(
    description: SweepFile, problem: AbstractSweepProblem, answer: dict
) -> tuple[dict[str, float], dict[str, float]]:
    """Return the distance of each constraint from its bound, relative to it, and the exact metrics without deviations.

    Args:
        description: The sweep.
        problem: Problem that maps a design to its metrics.
        answer: Entry of the answer in sweep.json.
    """
    design = np.array([answer["parameters"][axis.name] for axis in description.axes])
    content = design_input(description.subject, problem, description.axes, design)
    rig, margins = parse_rig(content.rig), description.margins
    scenarios = [dict(zip(margins.names, row, strict=True)) for row in margins.deviations]
    results = exact_with_margins(rig.plant, content.recording, rig.interpolation, content.cycles, scenarios, SUBSTEPS)
    slack = {}
    for name, (low, high) in description.constraints.items():
        values = np.array([result[name.removeprefix(LOWEST).removeprefix(HIGHEST)] for result in results])
        if np.isfinite(low):
            slack[name] = float((values.min() - low) / abs(low))
        if np.isfinite(high):
            slack[name] = float((high - values.max()) / abs(high))
    return slack, results[0]


def best_sample(
    description: SweepFile, problem: AbstractSweepProblem, count: int, metric: str, sign: float
) -> float | None:
    """Return the best value of the objective of the samples that satisfy all constraints; ``None`` if none does.

    Every value with margin is at least as far as that without, so that the samples that violate a constraint without
    margin need no simulation with it.

    Args:
        description: The sweep.
        problem: Problem with margins.
        count: Number of samples.
        metric: The objective.
        sign: 1 for an objective to minimise, -1 for one to maximise.
    """
    designs = draw_designs(description.axes, "sobol", count, SEED)
    plain = description.subject.problem(problem.names, description.metrics)
    limits: dict[str, tuple[float, float]] = {}
    for name, (low, high) in description.constraints.items():
        base = name.removeprefix(LOWEST).removeprefix(HIGHEST)
        before = limits.get(base, (-np.inf, np.inf))
        limits[base] = (max(low, before[0]), min(high, before[1]))
    columns = evaluate(plain, designs)
    rows = np.flatnonzero(feasible_mask(columns, limits))
    rows = rows[np.argsort(sign * columns[metric][rows], kind="stable")]
    for first in range(0, len(rows), BATCH):
        part = rows[first : first + BATCH]
        values = evaluate(problem, designs[part])
        feasible = feasible_mask(values, description.constraints)
        if feasible.any():
            return float(sign * np.min(sign * values[metric][feasible]))
    return None


def evaluate(problem: AbstractSweepProblem, designs: np.ndarray) -> dict[str, np.ndarray]:
    """Return the columns of designs, as a sweep computes them.

    Args:
        problem: Maps a design to its metrics.
        designs: The designs, shape ``(m, axes)``.
    """
    parts, rows = [], []
    for chunk in split_into_chunks(problem, designs, len(designs)):
        parts.append(
            evaluate_designs(problem, chunk.designs, chunk.steps, workers=parallel_batches(), new_program=True)
        )
        rows.append(chunk.rows)
    order = np.argsort(np.concatenate(rows))
    return {n: np.concatenate([part[n] for part in parts])[order] for n in parts[0]}


if __name__ == "__main__":
    main()
