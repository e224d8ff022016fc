"""PID gains for the transfer functions of ali2026: the paper's, ours, and those of differential evolution.

    python experiments/papers/hip/hip_gains.py [--quick] [--json FILE] [--out DIR]

Source: ali2026. Flexion and extension of a hip exoskeleton respond to a unit step; the PID has parallel form, and its
derivative acts on the error. The objective is the shortest settling time (2 %) with at most 2 % of overshoot. A rollout
counts as one, a rollout with its derivatives in p gains as 1 + p. The integral gain of the flexion is printed as 1e-5,
with which the loop takes half an hour to settle; 1.178e-4, with the other gains within their rounding, gives the
paper's figures.

Then the same is done at the paper's sampling period of 50 ms, and with the duty between 0 and 1 and a step of 100
degrees; and a curve shows the shortest settling time over the overshoot that is allowed. The sampling period is 10 ms
where it is not 50 ms.
"""

from __future__ import annotations

import sys
import time
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

sys.path.insert(0, str(Path(__file__).resolve().parents[3]))  # the checkout: smajax, tests/reference, experiments

from experiments.common.base import Row, arguments, finish, say
from experiments.common.charts import Chart, Curve, draw

import jax
import jax.numpy as jnp
import numpy as np
import scipy.optimize

from smajax.control.analysis import step_response as metrics
from smajax.control.analysis.margins import stability_margins
from smajax.control.controllers.pid import PID
from smajax.control.loop.allocation import Allocation
from smajax.control.loop.closed_loop import ClosedLoop
from smajax.control.loop.rollout import Scenario
from smajax.control.sampled_plant import SampledTransferFunction
from smajax.control.sensors.sensor_model import ideal_sensor
from smajax.control.tuning.problem import TuningProblem, simulate_gains
from smajax.control.tuning.tune import TuningResult, tune
from smajax.laws.transfer_function import TransferFunction

NO_LIMIT = 1e9  # larger than any command
NAMES = ("kp", "ki", "kd", "filter_time")


@dataclass(frozen=True)
class Case:
    """A transfer function K / (a s^2 + b s + 1) e^(-delay s), with the paper's gains and figures.

    Attributes:
        function: K, a, b and delay.
        published: The printed gains: kp, ki, kd.
        corrected: The gains with the digits that the print has lost.
        published_response: Rise and settling time (s) and overshoot (percent).
        tolerances: Their tolerances: two fractions, and points of percent.
        seconds: Duration of a rollout, s.
        settling: Settling time that our gains should reach, s.
    """

    function: tuple[float, float, float, float]
    published: tuple[float, float, float]
    corrected: tuple[float, float, float]
    published_response: tuple[float, float, float]
    tolerances: tuple[float, float, float]
    seconds: float
    settling: float

    @property
    def target(self) -> str:
        """The paper's figures with their tolerances, in words."""
        (rise, settling, over), (a, b, c) = self.published_response, self.tolerances
        return f"{rise:g} / {settling:g} s, {over:g} %, within {100 * a:g} %, {100 * b:g} %, {c:g} points"

    def met(self, response: metrics.StepResponse) -> bool:
        """Return whether a response agrees with the paper's."""
        (rise, settling, over), (a, b, c) = self.published_response, self.tolerances
        is_close = abs(response.rise / rise - 1.0) <= a and abs(response.settling / settling - 1.0) <= b
        return bool(is_close and abs(100.0 * response.overshoot - over) <= c)


CASES = {
    "flexion": Case(
        function=(648.2, 348.8, 37.35, 6.46),
        published=(0.00518, 1e-5, 0.05697),
        corrected=(0.005175, 1.178e-4, 0.056966),
        published_response=(8.7, 56.8, 6.9),
        tolerances=(0.01, 0.1, 0.2),
        seconds=200.0,
        settling=21.0,
    ),
    "extension": Case(
        function=(0.003174, 281.2, 15.33, 22.4),
        published=(120.3254, 5.7343, 631.2162),
        corrected=(120.3254, 5.7343, 631.2162),
        published_response=(39.3, 290.0, 8.15),
        tolerances=(0.01, 0.01, 0.1),
        seconds=600.0,
        settling=68.5,
    ),
}
PERIOD, PAPER_PERIOD = 0.01, 0.05  # s


def make_problem(
    case: Case,
    gains: tuple[float, ...],
    *,
    size: float = 1.0,
    limits: tuple[float, float] = (-NO_LIMIT, NO_LIMIT),
    seconds: float = 0.0,
    period: float = PERIOD,
) -> TuningProblem:
    """Return the tuning problem of a case; the bounds are a tenth and ten times the start gains, and 0.05 to 1 s.

    Args:
        case: The case.
        gains: Start gains: kp, ki, kd.
        size: Size of the step.
        limits: Limits of the command.
        seconds: Duration, s; that of the case by default.
        period: Sampling period, s.
    """
    gain, second, first, delay = case.function
    tau = np.sqrt(second)
    function = TransferFunction(
        *(jnp.asarray(v) for v in (gain, 0.0, tau, 1.0, first / (2.0 * tau), delay)), structure="underdamped"
    )
    pid = PID(*(jnp.asarray(v) for v in (*gains, 0.06, *limits)), period=period)
    loop = ClosedLoop(pid, Allocation(jnp.asarray(limits[1]), jnp.asarray(0.0), 1), ideal_sensor(), channel="angle")
    bounds = {n: (g / 10.0, g * 10.0) for n, g in zip(NAMES, gains, strict=False)} | {"filter_time": (0.05, 1.0)}
    scenario = Scenario.noiseless(np.full(round((seconds or case.seconds) / period), size))
    return TuningProblem.of(SampledTransferFunction.of(function, "angle", period), loop, scenario, bounds)


def simulate_response(
    problem: TuningProblem, gains: tuple[float, ...], filter_time: float
) -> tuple[metrics.StepResponse, np.ndarray]:
    """Return the response of the loop with some gains, and its angle over time.

    Args:
        problem: The tuning problem.
        gains: kp, ki, kd.
        filter_time: Filter time of the derivative, s.
    """
    value = np.asarray(simulate_gains(problem, gains_by_name(gains, filter_time)).channels["angle"])[0]
    return metrics.step_responses(value, np.asarray(problem.reference.values), problem.jumps, problem.loop.period)[
        0
    ], value


def simulate_named(problem: TuningProblem, gains: Mapping[str, Any]) -> metrics.StepResponse:
    """Return the response of the loop with gains by name."""
    response, _ = simulate_response(problem, tuple(float(gains[n]) for n in NAMES[:3]), float(gains["filter_time"]))
    return response


def gains_by_name(gains: tuple[float, ...], filter_time: float) -> dict[str, jax.Array]:
    """Return the gains by name, as arrays, so that other values need no new compilation."""
    return {n: jnp.asarray(float(v)) for n, v in zip(NAMES, (*gains, filter_time), strict=True)}


def response_text(response: metrics.StepResponse) -> str:
    """Return rise time, settling time and overshoot in words."""
    return f"{response.rise:.2f} / {response.settling:.1f} s, {100 * response.overshoot:.2f} %"


def differential_evolution(problem: TuningProblem, budget: int) -> tuple[np.ndarray, int, list[tuple[int, float]]]:
    """Minimise the settling time by SciPy's differential evolution, with a penalty on overshoot beyond 2 %.

    Returns:
        The best point, the number of rollouts, and the best objective by the number of rollouts.
    """
    history: list[tuple[int, float]] = []
    rollouts = 0

    def cost(x: np.ndarray) -> float:
        nonlocal rollouts
        rollouts += 1
        value = np.asarray(simulate_gains(problem, problem.gains(x)).channels["angle"])[0]
        if not np.all(np.isfinite(value)):
            return 1e6
        response = metrics.step_responses(value, np.asarray(problem.reference.values), problem.jumps, PERIOD)[0]
        total = min(response.settling, 10.0 * problem.reference.since_jump.shape[0] * PERIOD) + 1e4 * max(
            response.overshoot - 0.02, 0.0
        )
        if not history or total < history[-1][1]:
            history.append((rollouts, total))
        return total

    size = 15 * 4
    result = scipy.optimize.differential_evolution(
        cost, [(0.0, 1.0)] * 4, popsize=15, maxiter=budget // size - 1, rng=0, polish=False, tol=0.0
    )
    return result.x, rollouts, history


def published_rows(name: str, case: Case, problem: TuningProblem) -> list[Row]:
    """Return the responses with the paper's gains, as printed and corrected.

    Args:
        name: Name of the case.
        case: The case.
        problem: Its tuning problem.
    """
    printed_problem = make_problem(case, case.corrected, seconds=2000.0 if name == "flexion" else case.seconds)
    printed, _ = simulate_response(printed_problem, case.published, 0.0)
    remark = "" if case.corrected == case.published else ": the integral gain, 0.00001, has lost digits in print"
    rows = [Row(f"{name}, gains as printed", case.target, response_text(printed) + remark, case.met(printed))]
    if case.corrected != case.published:
        corrected, _ = simulate_response(problem, case.corrected, 0.0)
        rows.append(Row(f"{name}, integral gain 1.178e-4", case.target, response_text(corrected), case.met(corrected)))
    return rows


def case_rows(
    name: str, case: Case, quick: bool, curves: dict[str, list[Curve]]
) -> tuple[list[Row], tuple[float, ...]]:
    """Return the rows of one transfer function without limits, and our gains.

    Args:
        name: Name of the case.
        case: The case.
        quick: Whether differential evolution has a smaller budget.
        curves: Curves by case, to which the responses are added.
    """
    problem = make_problem(case, case.corrected)
    rows = published_rows(name, case, problem)
    start = time.perf_counter()
    tuned = tune(problem, {}, {"overshoot": 0.02}, settle=True)
    first_seconds = time.perf_counter() - start
    start = time.perf_counter()
    tune(problem, {}, {"overshoot": 0.02}, settle=True)
    second_seconds = time.perf_counter() - start
    gains = tuple(tuned.gains[n] for n in NAMES)
    ours, value = simulate_response(problem, gains[:3], gains[3])
    met = ours.settling <= case.settling and ours.overshoot <= 0.02
    numbers = {"gains": tuned.gains, "settling": ours.settling, "overshoot": ours.overshoot, "rollouts": tuned.rollouts}
    rows.append(Row(f"{name}, ours", f"<= {case.settling:g} s, <= 2 %", response_text(ours), met, numbers))
    rows.append(Row(f"{name}, our gains", "-", ", ".join(f"{n} {v:.7g}" for n, v in tuned.gains.items()), None))
    rollouts_to_target = next((n for n, s in tuned.history if s <= case.settling), tuned.rollouts)
    rows.append(
        Row(
            f"{name}, rollouts",
            "<= 183",
            f"{tuned.rollouts} in all, {rollouts_to_target} to {case.settling:g} s",
            tuned.rollouts <= 183,
        )
    )
    rows.append(
        Row(f"{name}, seconds", "-", f"{first_seconds:.1f}, compiling included; {second_seconds:.2f} again", None)
    )
    for label, values in (("published", (*case.corrected, 0.06)), ("ours", gains)):
        margins = stability_margins(
            problem.system, problem.loop_with(gains_by_name(values[:3], values[3])), problem.scenario
        )
        text = f"gain {margins.gain:.2f}, phase {margins.phase:.0f} deg, sensitivity {margins.sensitivity:.2f}"
        rows.append(Row(f"{name}, margins, {label}", "-", text, None, margins._asdict()))
    say(f"{name}: {response_text(ours)} in {tuned.rollouts} rollouts")
    point, rollouts, history = differential_evolution(problem, 600 if quick else 3660)
    evolved = simulate_named(problem, problem.gains(point))
    text = f"{response_text(evolved)} in {rollouts:,} rollouts"
    rows.append(Row(f"{name}, differential evolution", "-", text, None, {"way": history}))
    _, published = simulate_response(problem, case.corrected, 0.0)
    seconds = PERIOD * np.arange(len(problem.reference.values))
    curves[name] = [Curve("published", seconds[::20], published[::20]), Curve("ours", seconds[::20], value[::20])]
    return rows + sampled_rows(name, case, gains), gains


def sampled_rows(name: str, case: Case, ours: tuple[float, ...]) -> list[Row]:
    """Return the responses with the paper's sampling period: its gains, ``ours`` for 10 ms, and gains tuned for it.

    Args:
        name: Name of the case.
        case: The case.
        ours: Our gains for 10 ms.
    """
    problem, what = make_problem(case, case.corrected, period=PAPER_PERIOD), f"{name}, every 50 ms"
    tuned = tune(problem, {}, {"overshoot": 0.02}, settle=True)
    paper_gains = tuple(tuned.gains[n] for n in NAMES)
    gain_sets = (("published", (*case.corrected, 0.0)), ("ours for 10 ms", ours), ("ours for 50 ms", paper_gains))
    responses = {label: simulate_response(problem, gains[:3], gains[3])[0] for label, gains in gain_sets}
    rows = [
        Row(f"{what}, {label}", "-", response_text(response), None, response._asdict())
        for label, response in responses.items()
    ]
    text = ", ".join(f"{n} {v:.7g}" for n, v in tuned.gains.items())
    return [
        *rows,
        Row(f"{what}, gains for it", "-", f"{text} in {tuned.rollouts} rollouts", None, {"gains": tuned.gains}),
    ]


def limited_rows(name: str, case: Case, unlimited: tuple[float, ...], quick: bool) -> list[Row]:
    """Tune the gains with the duty between 0 and 1, from the gains that were tuned without limits.

    The flexion steps by 100 degrees, which needs 15 % of the duty. The extension's input has another unit, which the
    paper
    does not state: its unit step is assumed to need the same share of the largest input.

    Args:
        name: Name of the case.
        case: The case.
        unlimited: The gains tuned without limits.
        quick: Whether differential evolution has a smaller budget.
    """
    size, largest = (
        (100.0, 1.0) if name == "flexion" else (1.0, CASES["flexion"].function[0] / 100.0 / case.function[0])
    )
    problem = make_problem(case, unlimited[:3], size=size, limits=(0.0, largest))
    before, _ = simulate_response(problem, case.corrected, 0.0)
    tuned = tune(problem, {}, {"overshoot": 0.02}, settle=True)
    ours, _ = simulate_response(problem, tuple(tuned.gains[n] for n in NAMES[:3]), tuned.gains["filter_time"])
    # Differential evolution searches about the paper's gains, as without limits.
    evolution_problem = make_problem(case, case.corrected, size=size, limits=(0.0, largest))
    point, rollouts, _ = differential_evolution(evolution_problem, 600 if quick else 3660)
    evolved_gains = evolution_problem.gains(point)
    evolved = simulate_named(problem, evolved_gains)
    met = ours.settling <= evolved.settling * (1.0 + 1e-3) and ours.overshoot <= 0.02 and tuned.rollouts <= 183
    label = f"{name}, duty 0..1, {size:g} deg"
    return [
        Row(f"{label}, published", "-", response_text(before), None),
        Row(
            f"{label}, ours",
            "evolution's, 183 rollouts",
            f"{response_text(ours)} in {tuned.rollouts} rollouts",
            met,
            {"gains": tuned.gains},
        ),
        Row(f"{label}, differential evolution", "-", f"{response_text(evolved)} in {rollouts:,} rollouts", None),
    ]


def trade_off(name: str, case: Case, quick: bool) -> tuple[list[Row], Curve]:
    """Return the shortest settling time over the overshoot that is allowed, and the curve of settling over rise time.

    Args:
        name: Name of the case.
        case: The case.
        quick: Only two points.
    """
    points: list[tuple[float, float, float]] = []
    best: TuningResult | None = None
    for over in (0.02, 0.005) if quick else (0.02, 0.015, 0.01, 0.005, 0.002, 0.0):
        problem = make_problem(case, case.corrected)
        starts = [case.corrected] + ([tuple(best.gains[n] for n in NAMES[:3])] if best else [])
        results = [tune(make_problem(case, start), {}, {"overshoot": over}, settle=True) for start in starts]
        best = min(results, key=lambda t: (not t.feasible, t.settling))
        response, _ = simulate_response(problem, tuple(best.gains[n] for n in NAMES[:3]), best.gains["filter_time"])
        points.append((over, response.rise, response.settling))
    text = "; ".join(f"{100 * o:g} %: {r:.1f} / {s:.1f} s" for o, r, s in points)
    return [Row(f"{name}, rise / settling by overshoot", "-", text, None, {"points": points})], Curve(
        name, [r for _, r, _ in points], [s for *_, s in points]
    )


def main() -> None:
    """Print the table."""
    args = arguments(__doc__, quick="600 rollouts for differential evolution, two points of the trade-off")
    rows: list[Row] = []
    curves: dict[str, list[Curve]] = {}
    trade_off_curves = []
    for name, case in CASES.items():
        new_rows, ours = case_rows(name, case, args.quick, curves)
        rows += new_rows + limited_rows(name, case, ours, args.quick)
        new_rows, curve = trade_off(name, case, args.quick)
        rows += new_rows
        trade_off_curves.append(curve)
    if args.out:
        for name, case_curves in curves.items():
            draw(
                Chart(f"Hip, {name}: answer to a unit step", "time [s]", "angle", case_curves),
                args.out,
                f"hip_gains_{name}",
            )
        draw(
            Chart("Settling by rise", "rise [s]", "settling [s]", trade_off_curves, log_x=True, log_y=True),
            args.out,
            "hip_gains_trade_off",
        )
    finish(rows, args)


if __name__ == "__main__":
    main()
