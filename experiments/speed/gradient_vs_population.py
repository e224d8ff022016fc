"""Cost of fits by gradients against population searches, its growth with the data, and the time of a command.

    python experiments/speed/gradient_vs_population.py [--quick] [--json FILE] [--out DIR]

All searches use the same compiled simulator. The recording is data/recordings/dead-weight/train.csv, made by the exact
simulator in tests/reference, which shares no code with smajax. Wall times exclude compilation except where the row says
otherwise. A row compares the genetic algorithm at the settings of fast_rotary_actuator. ``--quick`` takes the
recording's first 20 s for the searches, stops them at their goal, and takes fewer seeds and sizes.
"""

import argparse
import math
import sys
from collections.abc import Callable, Sequence
from pathlib import Path

sys.path.insert(0, str(Path(__file__).resolve().parents[2]))  # the checkout: smajax, tests/reference, experiments

from experiments.common.base import Row, arguments, finish, read_shipped, say
from experiments.common.charts import Chart, Curve, draw
from experiments.common.speed import command_row, growth_rows

import numpy as np

from smajax.fitting import baselines
from smajax.fitting.baselines import BaselineResult
from smajax.fitting.problem import Problem, build_problem

GOAL_FACTOR = 1.01  # of the RMSE: the goal is 1 % above the best one


class Contest:
    """One fit problem, and all searches that were run on it; costs are converted to RMSE in the recording's unit."""

    def __init__(self, name: str, seconds: float | None, free: Sequence[str] | None = None):
        rig, recording = read_shipped(name)
        if seconds is not None:
            recording = recording.slice(recording.time[0], recording.time[0] + seconds)
        settings = rig.fit if free is None else _FreeParameters(rig.fit, free)
        self.problem: Problem = build_problem(rig.plant, [recording], settings, interpolation=rig.interpolation)
        channel = rig.fit.observe[0]
        self.unit = {"m": "mm", "rad": "deg"}[_si_unit(channel)]
        in_unit = {"mm": 1e3, "deg": 180 / math.pi}[self.unit]
        self._scale = in_unit / float(self.problem.data.weight[0, 0, 0]) / math.sqrt(len(recording))
        self.starts, self.samples = rig.fit.starts, len(recording)
        self.searches: dict[str, list[BaselineResult]] = {}

    def run(
        self, search: Callable[..., BaselineResult], seeds: Sequence[int], **options: object
    ) -> list[BaselineResult]:
        """Run a search from each seed, and file the results under its name.

        Args:
            search: The search.
            seeds: The seeds.
            options: Further arguments of the search.
        """
        results = [search(self.problem, seed=seed, **options) for seed in seeds]
        self.searches.setdefault(results[0].name, []).extend(results)
        say(
            f"{results[0].name}: RMSE {', '.join(f'{self.rmse(s.cost):.4g}' for s in results)} {self.unit}, "
            f"{results[0].wall_time:.2f} s"
        )
        return results

    def rmse(self, cost: float) -> float:
        """Return the RMSE of a cost, in the channel's unit."""
        return self._scale * math.sqrt(cost)

    @property
    def goal(self) -> float:
        """The cost at 1 % above the least RMSE of all searches."""
        return GOAL_FACTOR**2 * min(s.cost for results in self.searches.values() for s in results)


class _FreeParameters:
    """Fit settings with other free parameters."""

    def __init__(self, settings: object, free: Sequence[str]):
        self._settings, self.free = settings, tuple(free)

    def __getattr__(self, name: str) -> object:
        return getattr(self._settings, name)


def _si_unit(channel: str) -> str:
    from smajax.channels import channel_unit

    return channel_unit(channel)


def _median_reach(results: Sequence[BaselineResult], cost: float) -> tuple[float, float]:
    """Return median simulations and seconds to a cost; infinite where most searches never reach it."""
    efforts = [s.effort_to_reach(cost) or (math.inf, math.inf) for s in results]
    return float(np.median([n for n, _ in efforts])), float(np.median([w for _, w in efforts]))


def evolution_rows(contest: Contest, quick: bool) -> list[Row]:
    """Compare the wall time to within 1 % of the best RMSE with that of SciPy's differential evolution."""
    starts, seeds = f"gradient, {contest.starts} starts", [0] if quick else [0, 1, 2]
    for seed in seeds:  # before and after each long search, since the machine's speed varies
        contest.run(baselines.run_gradient_search, [seed] * 4)
        contest.run(baselines.run_gradient_search, [seed] * 4, starts=contest.starts)
        contest.run(baselines.run_differential_evolution, [seed], budget=60_000, target=contest.goal if quick else None)
    contest.run(baselines.run_gradient_search, [0] * 4)
    contest.run(baselines.run_gradient_search, [0] * 4, starts=contest.starts)
    contest.run(
        baselines.run_differential_evolution,
        seeds,
        vectorized=True,
        budget=60_000,
        target=contest.goal if quick else None,
    )
    contest.run(baselines.run_evosax, seeds, budget=15_000, target=contest.goal)
    rows = []
    for our_method, their_method, target in (
        (starts, "SciPy DE", ">= 100x less wall time, never a worse RMSE"),
        ("gradient", "SciPy DE", ">= 100x less wall time, never a worse RMSE"),
        (starts, "SciPy DE, batched", "-"),
        (starts, "evosax CMA_ES", "-"),
    ):
        ours, others = contest.searches[our_method], contest.searches[their_method]
        (few, fast), (many, slow) = _median_reach(ours, contest.goal), _median_reach(others, contest.goal)
        rmse = max(contest.rmse(s.cost) for s in ours)
        rival = min(contest.rmse(s.cost) for s in others)
        met = bool(slow >= 100 * fast and rmse <= rival * 1.0001) if target != "-" else None
        rows.append(
            Row(
                f"{our_method} against {their_method}, to within 1 % of the best RMSE",
                target,
                f"{slow / fast:.0f}x ({fast:.3g} s against {slow:.3g} s, {few:.0f} against {many:.0f} simulations); "
                f"worst RMSE {rmse:.5g} {contest.unit}, its best {rival:.5g} {contest.unit}",
                met,
                {
                    "seconds": fast,
                    "other_seconds": slow,
                    "simulations": few,
                    "other_simulations": many,
                    "rmse": rmse,
                    "other_rmse": rival,
                },
            )
        )
    return rows


def genetic_row(contest: Contest, label: str, seeds: Sequence[int]) -> Row:
    """Compare the simulations with those of the genetic algorithm at the settings of fast_rotary_actuator.

    Args:
        contest: The fit problem.
        label: Name of the row.
        seeds: Seeds of the genetic algorithm.
    """
    fits = contest.searches.get("gradient") or contest.run(baselines.run_gradient_search, [0])
    genetic = contest.run(baselines.run_genetic_algorithm, seeds)
    best = min(s.cost for s in genetic)
    median = float(np.median([s.cost for s in genetic]))
    ours = fits[0]
    simulations_below = next((n for n, _, cost in ours.history if cost < best), math.inf)
    ratio = genetic[0].simulations / simulations_below
    whole = genetic[0].simulations / ours.simulations
    return Row(
        f"{label}: gradient from the nominal values against the genetic algorithm ({len(genetic)} seeds)",
        ">= 20x fewer simulations and a lower RMSE",
        f"{ratio:.0f}x to below the best of its RMSEs ({simulations_below:.0f} against {genetic[0].simulations}), "
        f"{whole:.0f}x to its own end ({ours.simulations}); RMSE {contest.rmse(ours.cost):.4g} {contest.unit}, "
        f"its best {contest.rmse(best):.4g}, median {contest.rmse(median):.4g} {contest.unit}",
        bool(ratio >= 20 and ours.cost < best),
        {
            "simulations": simulations_below,
            "simulations_to_the_end": ours.simulations,
            "other_simulations": genetic[0].simulations,
            "rmse": contest.rmse(ours.cost),
            "other_rmse": [contest.rmse(s.cost) for s in genetic],
        },
    )


def pictures(contest: Contest, args: argparse.Namespace) -> None:
    """Draw the best RMSE over time and over simulations, one curve a method, from its first seed."""
    for axis, label, name in ((1, "wall time in s, compiling left out", "time"), (0, "simulations", "simulations")):
        curves = []
        for method, results in contest.searches.items():
            rows = results[0].history
            curves.append(Curve(method, [r[axis] for r in rows], [contest.rmse(r[2]) for r in rows], steps=True))
        ends = [min(x for c in curves for x in c.x), max(x for c in curves for x in c.x)]
        curves.append(Curve("1 % above the best", ends, [contest.rmse(contest.goal)] * 2, dashed=True))
        title = f"Six parameters, {contest.samples} samples: best RMSE so far"
        draw(
            Chart(title, label, f"RMSE in {contest.unit}", curves, log_x=True, log_y=True),
            args.out,
            f"gradient_vs_population_{name}",
        )


def main() -> None:
    """Print the table."""
    args = arguments((__doc__ or "").splitlines()[0])
    contest = Contest("dead-weight", 20.0 if args.quick else None)
    rows = evolution_rows(contest, args.quick)
    rows.append(genetic_row(contest, "dead weight, six parameters", range(2 if args.quick else 10)))
    paper = Contest("rotary", 20.0 if args.quick else None, ["heat.h0", "heat.h2"])
    rows.append(genetic_row(paper, "rotary, h0 and h2 as in the paper", range(2 if args.quick else 10)))
    rows += growth_rows(args.quick)
    rows.append(command_row(args.quick))
    if args.out:
        pictures(contest, args)
    searches = [
        {
            "method": name,
            "run": i,
            "ended": s.end_reason,
            "compile": s.compile_time,
            "rmse": contest.rmse(s.cost),
            "history": s.history,
        }
        for name, results in contest.searches.items()
        for i, s in enumerate(results)
    ]
    finish(rows, args, searches=searches, unit=contest.unit)


if __name__ == "__main__":
    main()
