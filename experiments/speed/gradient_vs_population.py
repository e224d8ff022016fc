"""What gradients buy.

The fit against population searches on one compiled simulator, and what simulations, Jacobians and commands cost.

The recording is data/recordings/dead-weight/train.csv, made by the exact simulator in tests/reference and not by
smajax. Walls leave compiling out except where the row says otherwise. ``--quick`` takes the recording's first 20 s
for the searches, stops them at their goal, and takes fewer seeds and sizes.
"""

import argparse
import math
import sys
from collections.abc import Callable, Sequence
from pathlib import Path

sys.path.insert(0, str(Path(__file__).resolve().parents[2]))  # the checkout: smajax, tests/reference, experiments

from experiments.common.base import Row, arguments, finish, say, shipped
from experiments.common.charts import Chart, Curve, draw
from experiments.common.speed import command_row, growth_rows, jacobian_row, loop_rows

import numpy as np

from smajax.fitting import baselines
from smajax.fitting.baselines import BaselineResult
from smajax.fitting.problem import Problem, build_problem

NEAR = 1.01  # "to within 1 % of the best RMSE known"


class Contest:
    """One problem, and all that was searched on it. Costs become RMSEs in the recording's unit."""

    def __init__(self, name: str, seconds: float | None, free: Sequence[str] | None = None):
        rig, recording = shipped(name)
        if seconds is not None:
            recording = recording.slice(recording.time[0], recording.time[0] + seconds)
        settings = rig.fit if free is None else _Only(rig.fit, free)
        self.problem: Problem = build_problem(rig.plant, [recording], settings, interpolation=rig.interpolation)
        channel = rig.fit.observe[0]
        self.unit = {"m": "mm", "rad": "deg"}[_si(channel)]
        in_unit = {"mm": 1e3, "deg": 180 / math.pi}[self.unit]
        self._scale = in_unit / float(self.problem.data.weight[0, 0, 0]) / math.sqrt(len(recording))
        self.starts, self.samples = rig.fit.starts, len(recording)
        self.searches: dict[str, list[BaselineResult]] = {}

    def run(
        self, search: Callable[..., BaselineResult], seeds: Sequence[int], **options: object
    ) -> list[BaselineResult]:
        """Runs a search from each seed and files it under its name."""
        found = [search(self.problem, seed=seed, **options) for seed in seeds]
        self.searches.setdefault(found[0].name, []).extend(found)
        say(
            f"{found[0].name}: RMSE {', '.join(f'{self.rmse(s.cost):.4g}' for s in found)} {self.unit}, "
            f"{found[0].wall_time:.2f} s"
        )
        return found

    def rmse(self, cost: float) -> float:
        """In the channel's unit."""
        return self._scale * math.sqrt(cost)

    @property
    def goal(self) -> float:
        """The cost at 1 % above the least RMSE that any search found."""
        return NEAR**2 * min(s.cost for found in self.searches.values() for s in found)


class _Only:
    """Fit settings with other free parameters."""

    def __init__(self, settings: object, free: Sequence[str]):
        self._settings, self.free = settings, tuple(free)

    def __getattr__(self, name: str) -> object:
        return getattr(self._settings, name)


def _si(channel: str) -> str:
    from smajax.channels import channel_unit

    return channel_unit(channel)


def _median_reach(found: Sequence[BaselineResult], cost: float) -> tuple[float, float]:
    """Median simulations and seconds to a cost; infinite where most searches never get there."""
    reached = [s.effort_to_reach(cost) or (math.inf, math.inf) for s in found]
    return float(np.median([n for n, _ in reached])), float(np.median([w for _, w in reached]))


def evolution_rows(contest: Contest, quick: bool) -> list[Row]:
    """Row 1: wall time to within 1 % of the best RMSE known, against SciPy's differential evolution."""
    starts, seeds = f"gradient, {contest.starts} starts", [0] if quick else [0, 1, 2]
    for seed in seeds:  # before and after each long search, since the machine's speed wanders
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
    for mine, theirs, target in (
        (starts, "SciPy DE", ">= 100x less wall time, never a worse RMSE"),
        ("gradient", "SciPy DE", ">= 100x less wall time, never a worse RMSE"),
        (starts, "SciPy DE, batched", "-"),
        (starts, "evosax CMA_ES", "-"),
    ):
        ours, others = contest.searches[mine], contest.searches[theirs]
        (few, fast), (many, slow) = _median_reach(ours, contest.goal), _median_reach(others, contest.goal)
        rmse, rival = (max(contest.rmse(s.cost) for s in ours), min(contest.rmse(s.cost) for s in others))
        met = bool(slow >= 100 * fast and rmse <= rival * 1.0001) if target != "-" else None
        rows.append(
            Row(
                f"{mine} against {theirs}, to within 1 % of the best RMSE",
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


def genetic_row(contest: Contest, what: str, seeds: Sequence[int]) -> Row:
    """Row 2: simulations against the genetic algorithm at fast_rotary_actuator's settings."""
    fits = contest.searches.get("gradient") or contest.run(baselines.run_gradient_search, [0])
    bred = contest.run(baselines.run_genetic_algorithm, seeds)
    best, median = min(s.cost for s in bred), float(np.median([s.cost for s in bred]))
    ours = fits[0]
    below = next((n for n, _, cost in ours.history if cost < best), math.inf)
    ratio, whole = bred[0].simulations / below, bred[0].simulations / ours.simulations
    return Row(
        f"{what}: gradient from the nominal values against the genetic algorithm ({len(bred)} seeds)",
        ">= 20x fewer simulations and a lower RMSE",
        f"{ratio:.0f}x to below the best of its RMSEs ({below:.0f} against {bred[0].simulations}), {whole:.0f}x "
        "to its own end "
        f"({ours.simulations}); RMSE {contest.rmse(ours.cost):.4g} {contest.unit}, its best "
        f"{contest.rmse(best):.4g}, median "
        f"{contest.rmse(median):.4g} {contest.unit}",
        bool(ratio >= 20 and ours.cost < best),
        {
            "simulations": below,
            "simulations_to_the_end": ours.simulations,
            "other_simulations": bred[0].simulations,
            "rmse": contest.rmse(ours.cost),
            "other_rmse": [contest.rmse(s.cost) for s in bred],
        },
    )


def pictures(contest: Contest, args: argparse.Namespace) -> None:
    """Best RMSE over time and over simulations, one curve a method: its first seed."""
    for axis, label, name in ((1, "wall time in s, compiling left out", "time"), (0, "simulations", "simulations")):
        curves = []
        for method, found in contest.searches.items():
            rows = found[0].history
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
    """Runs all rows."""
    args = arguments(__doc__.splitlines()[0])
    contest = Contest("dead-weight", 20.0 if args.quick else None)
    rows = evolution_rows(contest, args.quick)
    rows.append(genetic_row(contest, "dead weight, six parameters", range(2 if args.quick else 10)))
    paper = Contest("rotary", 20.0 if args.quick else None, ["heat.h0", "heat.h2"])
    rows.append(genetic_row(paper, "rotary, h0 and h2 as in the paper", range(2 if args.quick else 10)))
    rows.append(jacobian_row(args.quick))
    rows += loop_rows(args.quick)
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
        for name, found in contest.searches.items()
        for i, s in enumerate(found)
    ]
    finish(rows, args, searches=searches, unit=contest.unit)


if __name__ == "__main__":
    main()
