"""Which constrained search finds the best gains within limits?

    python experiments/control/search_methods.py [--tasks N] [--quick] [--json FILE] [--out DIR]

The tasks are those of random_tuning_tasks.py: a wire, load, reference, noise and limits, drawn at random. Each search
minimises the same objective within the same limits, for the same eight members (draws of the noise, one member without
noise, ambient temperatures). A search that uses gradients gets those of the logarithm of the cost and of the largest
violation of each limit, and begins at the start gains and at the best of 32 points that cover the box. The table counts
the tasks whose limits a search keeps, its cost over the best one of all searches, and its rollouts; a forward-mode
Jacobian counts as one rollout and one for each gain. --quick takes two tasks.
"""

import math
import sys
import tempfile
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any, NamedTuple

sys.path.insert(0, str(Path(__file__).resolve().parents[2]))  # the checkout: smajax, tests/reference, experiments

from experiments.common.base import Row, arguments, finish, say
from experiments.common.tuning_tasks import random_task, write_files

import jax
import jax.numpy as jnp
import numpy as np
import optimistix
import scipy.optimize
import scipy.stats

from smajax.control.analysis.cases import ambient_members
from smajax.control.controller_file.read import read_controller
from smajax.control.tuning.constrained import constrained
from smajax.control.tuning.objective import Objective, make_objective
from smajax.control.tuning.population import evolve_population
from smajax.control.tuning.problem import TuningProblem, noise_draws
from smajax.control.tuning.search import Candidate, GainSearch, rank
from smajax.files.rig_file import read_rig
from smajax.numerics.loop_kernels import jit_with_kernels

TASKS = 10
# Points that cover the box, the best of which is the second start.
SCAN = 32
# Largest number of evaluations of a search with gradients, from each start.
EVALUATIONS = 40
# Augmented Lagrangian: number of updates of the multipliers, steps between them, and growth of the penalty.
UPDATES, STEPS, GROWTH = 6, 8, 4.0
# A cost that replaces one that is not finite, so that a line search turns back.
LARGE = 50.0


def main() -> None:
    """Print the table."""
    args = arguments(
        __doc__ or "",
        quick="two tasks",
        more={"--tasks": {"type": int, "default": TASKS, "metavar": "N", "help": "number of tasks"}},
    )
    numbers = range(2 if args.quick else args.tasks)
    results = [compare(number) for number in numbers]
    finish(rows_of(results), args, words=f" --tasks {args.tasks}" if args.tasks != TASKS and not args.quick else "")


class Found(NamedTuple):
    """What a search found.

    Attributes:
        violation: Total violation of the limits.
        cost: The cost.
        rollouts: Number of rollouts.
        seconds: Run time with the compilation of programs that no search before it in the table has compiled.
    """

    violation: float
    cost: float
    rollouts: int
    seconds: float


def compare(number: int) -> dict[str, Found]:
    """Return what each search finds for a task."""
    task = random_task(number)
    with tempfile.TemporaryDirectory() as folder:
        rig_path, controller = write_files(task, Path(folder))
        settings = read_controller(controller, read_rig(rig_path))
    noise = noise_draws(settings.loop, settings.scenario).at[-1].set(0.0)
    members = ambient_members(settings, len(noise), {})
    problem = TuningProblem.of(settings.system, settings.loop, settings.scenario, settings.bounds, members, noise)
    objective = make_objective(settings.weights, settings.limits)
    found = {}
    for name, method in METHODS.items():
        search = GainSearch(problem, objective, lambda count, cost: None)
        began = time.perf_counter()
        method(search)
        best = min(search.evaluated, key=rank)
        found[name] = Found(best.violation, best.cost, search.rollouts, time.perf_counter() - began)
        say(f"{task.words}: {name}: {found[name]}")
    return found


@jit_with_kernels
def _values_and_slopes(
    problem: TuningProblem, point: jax.Array, objective: Objective, scale: jax.Array
) -> tuple[jax.Array, jax.Array]:
    """Logarithm of the cost and largest violation of each limit, shape ``(6,)``, and their derivatives."""

    def values(point: jax.Array) -> jax.Array:
        evaluated = problem.objective_terms(point, objective)
        terms = jnp.mean(jnp.sum(evaluated.terms**2, axis=2), axis=0)
        cost = jnp.sum(terms * objective.weights / scale)
        return jnp.concatenate([jnp.log(cost)[None], jnp.max(evaluated.violations, axis=(0, 2))])

    return values(point), jax.jacfwd(values)(point)


class Smooth:
    """The values of a point and their derivatives, evaluated once."""

    def __init__(self, search: GainSearch) -> None:
        self.search = search
        self.limited = np.isfinite(np.asarray(search.objective.limits))
        self.known: dict[bytes, tuple[np.ndarray, np.ndarray]] = {}

    def at(self, point: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Return logarithm of the cost and violations, shape ``(1 + k,)``, and their Jacobian."""
        key = point.tobytes()
        if key not in self.known:
            search = self.search
            row = jnp.asarray(np.clip(point, 0.0, 1.0))
            values, slopes = _values_and_slopes(search.problem, row, search.objective, jnp.asarray(search.scale))
            search.rollouts += search.problem.count * (1 + len(point))
            numbers, jacobian = np.asarray(values), np.asarray(slopes)
            keep = np.concatenate([[True], self.limited])
            usable = np.all(np.isfinite(numbers)) and np.all(np.isfinite(jacobian))
            violation = float(np.sum(np.maximum(numbers[1:], 0.0))) if np.max(numbers[1:]) > 1e-3 else 0.0
            if usable:
                search.record(Candidate(violation, math.exp(numbers[0]), np.asarray(row), numbers[1:]))
            self.known[key] = (
                (numbers[keep], jacobian[keep])
                if usable
                else (np.full(int(np.sum(keep)), LARGE), np.zeros((int(np.sum(keep)), len(point))))
            )
        return self.known[key]


def starts(search: GainSearch) -> list[np.ndarray]:
    """Return the start gains and the best of points that cover the box, in the unit box."""
    size = len(search.problem.start)
    points = scipy.stats.qmc.Sobol(size, scramble=False).random(SCAN) + 0.5 / SCAN
    found = search.candidates(points)
    return [np.asarray(search.problem.start), min(found, key=rank).point]


def by_scipy(search: GainSearch, method: str, options: dict[str, Any]) -> None:
    """Minimise by a constrained search of SciPy with gradients."""
    for start in starts(search):
        smooth = Smooth(search)
        constraint = scipy.optimize.NonlinearConstraint(
            lambda x, s=smooth: s.at(x)[0][1:], -np.inf, 0.0, jac=lambda x, s=smooth: s.at(x)[1][1:]
        )
        scipy.optimize.minimize(
            lambda x, s=smooth: (s.at(x)[0][0], s.at(x)[1][0]),
            start,
            jac=True,
            method=method,
            bounds=scipy.optimize.Bounds(0.0, 1.0, keep_feasible=method == "trust-constr"),
            constraints=[constraint],  # every task has a limit
            options=options,
        )


def by_optimistix(search: GainSearch) -> None:
    """Minimise an augmented Lagrangian by optimistix' BFGS; a point of the box is the sine of an unbounded one."""
    keep = np.isfinite(np.asarray(search.objective.limits))
    problem, objective, scale = search.problem, search.objective, jnp.asarray(search.scale)
    solver = optimistix.BFGS(rtol=1e-3, atol=1e-3)
    for start in starts(search):
        multipliers, penalty, last = np.zeros(len(keep)), 1.0, math.inf
        free = jnp.arcsin(2.0 * jnp.clip(jnp.asarray(start), 0.02, 0.98) - 1.0)
        for _ in range(UPDATES):
            arguments = (problem, objective, scale, jnp.asarray(multipliers), jnp.asarray(penalty))
            solution = optimistix.minimise(_lagrangian, solver, free, arguments, max_steps=STEPS, throw=False)
            # Each step of BFGS evaluates the value, and its gradient where it is accepted.
            search.rollouts += 3 * problem.count * int(solution.stats["num_steps"])
            free = jnp.where(jnp.all(jnp.isfinite(solution.value)), solution.value, free)
            candidate = search.candidates(np.asarray(0.5 * (1.0 + jnp.sin(free)))[None])[0]
            if candidate.violation > 0.5 * last:
                penalty *= GROWTH
            last = candidate.violation
            bounded = np.where(keep, np.minimum(candidate.violations, 1e3), 0.0)
            multipliers = np.maximum(multipliers + penalty * bounded, 0.0)


def _lagrangian(free: jax.Array, arguments: Any) -> jax.Array:
    """Logarithm of the cost with the augmented Lagrangian's terms of the limits."""
    problem, objective, scale, multipliers, penalty = arguments
    evaluated = problem.objective_terms(0.5 * (1.0 + jnp.sin(free)), objective)
    terms = jnp.mean(jnp.sum(evaluated.terms**2, axis=2), axis=0)
    violations = jnp.max(evaluated.violations, axis=(0, 2))
    beyond = jnp.maximum(violations + multipliers / penalty, 0.0)
    return jnp.log(jnp.sum(terms * objective.weights / scale)) + 0.5 * penalty * jnp.sum(beyond**2)


def then_population(method: Callable[[GainSearch], None]) -> Callable[[GainSearch], None]:
    """Return a search that is followed by a population and by quadratic models from its best point."""

    def run(search: GainSearch) -> None:
        method(search)
        found = evolve_population(search, min(search.evaluated, key=rank).point)
        search.search_by_cobyqa(found.point, search.problem, 0.04, 0.004, 40)

    return run


def ours(search: GainSearch) -> None:
    """Search as ``smajax tune`` does before its population."""
    constrained(search, np.asarray(search.problem.start)[None])


METHODS: dict[str, Callable[[GainSearch], None]] = {
    "quadratic models (COBYQA), then a population: smajax tune": then_population(ours),
    "quadratic models (COBYQA)": ours,
    "SLSQP": lambda s: by_scipy(s, "SLSQP", {"maxiter": EVALUATIONS, "ftol": 1e-4}),
    "trust-constr": lambda s: by_scipy(
        s, "trust-constr", {"maxiter": EVALUATIONS, "initial_tr_radius": 0.1, "xtol": 1e-3, "gtol": 1e-4}
    ),
    "augmented Lagrangian, optimistix' BFGS": by_optimistix,
    "SLSQP, then a population": then_population(lambda s: by_scipy(s, "SLSQP", {"maxiter": EVALUATIONS, "ftol": 1e-4})),
}


def rows_of(results: list[dict[str, Found]]) -> list[Row]:
    """Return the rows of the table."""
    least = [min((f.cost for f in result.values() if f.violation == 0.0), default=math.nan) for result in results]
    rows = []
    for name in METHODS:
        found = [result[name] for result in results]
        kept = [f.cost / best for f, best in zip(found, least, strict=True) if f.violation == 0.0]
        text = f"limits kept in {len(kept)} of {len(found)}"
        if kept:
            text += f"; cost over the least: median {np.median(kept):.3f}, largest {max(kept):.3f}"
        text += f"; {np.median([f.rollouts for f in found]):,.0f} rollouts"
        text += f", {np.median([f.seconds for f in found]):.1f} s"
        rows.append(Row(name, "-", text, None, {"tasks": [f._asdict() for f in found]}))
    return rows


if __name__ == "__main__":
    main()
