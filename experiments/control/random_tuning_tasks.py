"""Random tuning tasks: do the printed limits hold on the exact simulator, with noise that no search has seen?

    python experiments/control/random_tuning_tasks.py [--tasks N] [--de] [--quick] [--json FILE] [--out DIR]

Each task is a wire with its load, reference, noise and limits, drawn at random; ``smajax tune`` finds the gains. The
exact simulator of tests/reference, which shares no code with smajax, runs its own PID controller with these gains 20
times, with fresh noise and ambient temperatures within 3 K. A limit counts where the command printed it as kept.
``--de`` also searches each task by differential evolution with 20 times the rollouts, for the same objective, limits
and members, and judges its gains in the same way: usual margins are preferred, the limits are checked on the command's
cases, and the exact simulator runs them. This takes several minutes for a task. With ``--out`` each task is appended to
DIR/cases.jsonl when it ends, and tasks that are there are not run again. --quick takes two tasks.
"""

import sys
import tempfile
import time
from pathlib import Path
from typing import Any

sys.path.insert(0, str(Path(__file__).resolve().parents[2]))  # the checkout: smajax, tests/reference, experiments

from experiments.common.base import Row, add_case, arguments, finish, read_cases, say, total_seconds
from experiments.common.tuning_tasks import DRAWS, ExactRun, TuningTask, exact_runs, random_task, write_files

import numpy as np
import scipy.optimize

from smajax.api.tune import TuningStudy, tune
from smajax.control.analysis.case_check import CaseCheck, check_cases
from smajax.control.analysis.cases import make_cases
from smajax.control.analysis.closed_loop_checks import evaluate_gains
from smajax.control.controller_file.read import ControllerFile
from smajax.control.loop.gains import gain, gains
from smajax.control.tuning.controller_problem import tuning_problem
from smajax.control.tuning.margin_backoff import reduce_loop_gain
from smajax.control.tuning.objective import make_objective
from smajax.control.tuning.problem import TuningProblem, has_noise
from smajax.control.tuning.search import Candidate, GainSearch, rank
from smajax.control.tuning.tune import TuningResult
from smajax.control.tuning.tune import tune as tune_gains

TASKS = 50
# Share of all runs, and number of the runs of each task, that keep the limits which were printed as kept.
SHARE, LEAST = 0.95, 17
# Largest distance of the exact tracking error from the printed one.
PERFORMANCE = 0.1
# Rollouts of differential evolution over those of the tuning, and its population for each gain.
BUDGET = 20
POPULATION = 15
_VIOLATION_PENALTY = 1e3
# Ratio of a tracking error or cost to that of differential evolution that counts as no worse: the same gains differ by
# as much from one set of 20 draws of the noise to the next.
AS_GOOD = 1.01


def main() -> None:
    """Print the table."""
    options = {
        "--tasks": {"type": int, "default": TASKS, "metavar": "N", "help": "number of tasks"},
        "--de": {"action": "store_true", "help": "compare with differential evolution"},
    }
    args = arguments(__doc__ or "", quick="two tasks", more=options)
    tasks = [random_task(k) for k in range(2 if args.quick else args.tasks)]
    done = {case["task"]: case for case in read_cases(args.out)}
    resumed, results = bool(done), []
    for task in tasks:
        began = time.perf_counter()
        if task.words not in done:
            done[task.words] = judge(task, args.de) | {"seconds": time.perf_counter() - began}
            add_case(args.out, done[task.words])
            say(f"{task.words}: {done[task.words]['words']} ({done[task.words]['seconds']:.0f} s)")
        results.append(done[task.words])
    words = f" --tasks {args.tasks}" if args.tasks != TASKS and not args.quick else ""
    words += " --de" if args.de else ""
    finish(rows_of(results), args, words=words, resumed=resumed, seconds=total_seconds(results))


def judge(task: TuningTask, evolve: bool) -> dict[str, Any]:
    """Return the numbers of a task, with a text.

    Args:
        task: The task.
        evolve: Whether differential evolution is compared.
    """
    with tempfile.TemporaryDirectory() as folder:
        study = tune(*write_files(task, Path(folder)))
    check, metrics = study.document["case_check"], study.document["metrics"]["tuned"]
    printed = {name: limit for name, limit in task.limits.items() if name not in check["beyond"]}
    runs = exact_runs(task, study.gains)
    ratio = float(np.median([run.rmse for run in runs])) / metrics["rmse"]
    numbers: dict[str, Any] = {
        "task": task.words,
        "kept": sum(keeps(run, printed) for run in runs) if printed else None,
        "missed": sorted(check["beyond"]),
        "exit_code": study.exit_code,
        "ratio": ratio,
        "rollouts": study.document["rollouts"],
        "retunings": check["retunings"],
    }
    words = f"{numbers['kept']} of {DRAWS} runs" if printed else "no limit printed as kept"
    if numbers["missed"]:
        words += f", printed as not met: {' and '.join(numbers['missed'])}"
    words += f"; RMSE {1e3 * metrics['rmse']:.3f} mm printed, {ratio:.3f} of it on the exact simulator"
    if evolve:
        numbers |= evolution(task, study, runs)
        words += f"; differential evolution: {numbers['evolution_kept']} of {DRAWS} runs; RMSE over its RMSE "
        words += f"{numbers['evolution_ratio']:.3f}"
        if numbers["evolution_cost_ratio"] is not None:
            words += f", cost over its cost before margins are preferred {numbers['evolution_cost_ratio']:.3f}"
        if numbers["evolution_missed"]:
            words += f", missed in its check: {' and '.join(numbers['evolution_missed'])}"
    return numbers | {"words": words}


def keeps(run: ExactRun, limits: dict[str, float]) -> bool:
    """Return whether a run keeps all limits."""
    return all(run.keeps(name, limit) for name, limit in limits.items())


def evolution(task: TuningTask, study: TuningStudy, tuned: list[ExactRun]) -> dict[str, Any]:
    """Return how gains of differential evolution with twenty times the rollouts do, judged as those of the command."""
    assert study.result is not None
    settings: ControllerFile = study.result.settings
    problem = tuning_problem(settings, {}, settings.seed)
    search = GainSearch(problem, make_objective(settings.weights, settings.limits), lambda count, cost: None)
    best = evolved(search, BUDGET * study.document["rollouts"])
    own = search.candidates(tune_gains(problem, settings.weights, settings.limits, population="all").point[None])[0]
    result, check = judged(settings, problem, search, best)
    values = {name: float(gain(settings.loop, name)) for name in gains(settings.loop)} | result.gains
    runs = exact_runs(task, values)
    ratio = float(np.median([run.rmse for run in tuned])) / float(np.median([run.rmse for run in runs]))
    return {
        "evolution_kept": sum(keeps(run, task.limits) for run in runs),
        "evolution_missed": sorted(check.beyond),
        "evolution_ratio": ratio,
        "evolution_cost_ratio": own.cost / best.cost if rank(own)[0] == rank(best)[0] else None,
    }


def evolved(search: GainSearch, rollouts: int) -> Candidate:
    """Return the best candidate of differential evolution with a number of rollouts."""
    problem = search.problem

    def cost(points: np.ndarray) -> np.ndarray:
        found = search.candidates(np.atleast_2d(points.T))
        return np.array([c.cost + _VIOLATION_PENALTY * c.violation for c in found])

    size = POPULATION * len(problem.names)
    scipy.optimize.differential_evolution(
        cost,
        [(0.0, 1.0)] * len(problem.names),
        popsize=POPULATION,
        maxiter=max(rollouts // (size * problem.count) - 1, 1),
        rng=0,
        polish=False,
        tol=0.0,
        vectorized=True,
        updating="deferred",
    )
    return min(search.evaluated, key=rank)


def judged(
    settings: ControllerFile, problem: TuningProblem, search: GainSearch, best: Candidate
) -> tuple[TuningResult, CaseCheck]:
    """Return gains with usual margins, where these cost little, and their check on cases, as the command does."""
    result = TuningResult(
        point=best.point,
        gains={name: float(value) for name, value in problem.gains(best.point).items()},
        terms={},
        violations={},
        feasible=best.violation == 0.0,
        settling=float("nan"),
        rollouts=search.rollouts,
        history=(),
    )
    result, _ = reduce_loop_gain(settings, problem, result, evaluate_gains(settings, result.gains))
    cases = make_cases(settings, {}, has_noise(settings.loop), settings.seed, 0, settings.check)
    return result, check_cases(settings, result.gains, cases)


def rows_of(results: list[dict[str, Any]]) -> list[Row]:
    """Return the rows of the table."""
    rows = [
        Row(
            result["task"],
            f">= {LEAST} of {DRAWS}",
            result["words"],
            None if result["kept"] is None else result["kept"] >= LEAST,
            {key: value for key, value in result.items() if key not in ("task", "words")},
        )
        for result in results
    ]
    printed = [result["kept"] for result in results if result["kept"] is not None]
    kept, total = sum(printed), DRAWS * len(printed)
    refused = sum(bool(result["missed"]) for result in results)
    ratios = np.array([result["ratio"] for result in results])
    near = int(np.sum(np.abs(ratios - 1.0) <= PERFORMANCE))
    rows += [
        Row(
            "runs that keep the limits printed as kept",
            f">= {100 * SHARE:.0f} %",
            f"{kept} of {total}",
            kept >= SHARE * total,
        ),
        Row(
            "tasks with enough such runs",
            "all",
            f"{sum(k >= LEAST for k in printed)} of {len(printed)}",
            min(printed, default=DRAWS) >= LEAST,
        ),
        Row("tasks with a limit printed as not met", "-", f"{refused} of {len(results)}", None),
        Row(
            "tasks whose RMSE is within 10 % of the printed one",
            "all",
            f"{near} of {len(results)}",
            near == len(results),
        ),
    ]
    return rows + (evolution_rows(results) if results and "evolution_kept" in results[0] else [])


def evolution_rows(results: list[dict[str, Any]]) -> list[Row]:
    """Return the rows that compare the command with differential evolution."""
    runs = DRAWS * len(results)
    own = sum(result["kept"] or 0 for result in results)
    theirs = sum(result["evolution_kept"] for result in results)
    ratios = {result["task"]: result["evolution_ratio"] for result in results}
    ratio = float(np.median(list(ratios.values())))
    judged = [ratios[result["task"]] for result in results if not result["evolution_missed"]]
    costs = [result["evolution_cost_ratio"] for result in results if result["evolution_cost_ratio"] is not None]
    failing = sum(bool(result["evolution_missed"]) for result in results)
    where = "against differential evolution with 20 times the rollouts"
    return [
        Row(f"runs that keep the limits, {where}", "no fewer", f"{own} and {theirs} of {runs}", own >= theirs),
        Row("tasks in which gains of differential evolution miss a limit in the check", "-", str(failing), None),
        Row(f"median of the RMSE over its RMSE, {where}", f"<= {AS_GOOD}", f"{ratio:.3f}", ratio <= AS_GOOD),
        Row(
            "the same where its gains keep the limits in the check, as those of the command do",
            f"<= {AS_GOOD}",
            f"{np.median(judged):.3f} ({len(judged)} tasks, worst {max(judged):.3f})" if judged else "-",
            float(np.median(judged)) <= AS_GOOD if judged else None,
        ),
        Row(
            "the median for the cost that both minimise, before margins are preferred",
            f"<= {AS_GOOD}",
            f"{np.median(costs):.3f} ({len(costs)} tasks, worst {max(costs):.3f})",
            float(np.median(costs)) <= AS_GOOD,
        ),
    ]


if __name__ == "__main__":
    main()
