"""A wire that positions a weight: gains tuned on a fitted plant, then tried on the exact simulator.

    python experiments/control/wire_position.py [--quick] [--json FILE] [--out DIR]

Two wires, 0.15 and 0.51 mm thick, lift 0.2 and 2.5 kg (1 kg would not stretch the thick one again as it cools). Their
recordings are made by the exact simulator (tests/reference), with noise. The plant is fitted to them, and a PID at 50
and 20 Hz is tuned through its closed loop for a staircase, with eight draws of the sensor's noise and gains up to a
tenth off. The improvement on the fitted plant is compared with that on the exact simulator, which has its own
implementation of the controller.

Differential evolution (storn1997) gets the same compiled rollouts, the same objective, and twenty times as many of
them; it is also compared after as many rollouts and after as much time. Our search begins with one of the eight draws,
so a row shows a population that begins with one draw, too. The command's moves count as much as the error, so that the
best gains do not oscillate. Another row compares the searches where moves hardly count and the best gains do oscillate.

At last, gains tuned for the fitted plant alone are compared with gains tuned for draws of uncertain parameters: those
of the fit, the airflow (h0 from half to two and a half times the fitted value), the ambient temperature (10 to 32 degC)
and the load (3 % either way), with a limit of the wire's temperature that the fitted plant meets without it.
"""

from __future__ import annotations

import sys
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from time import perf_counter

sys.path.insert(0, str(Path(__file__).resolve().parents[2]))  # the checkout: smajax, tests/reference, experiments

from experiments.common.base import Row, arguments, finish, medians, say
from experiments.common.charts import Chart, Curve, draw
from experiments.common.gain_searches import (
    SearchResult,
    differential_evolution,
    evolve_single_member,
    nelder_mead,
    rollouts_to_optimum,
    verdict_under_budget,
)
from experiments.common.positioning import (
    NAMES,
    WIRES,
    Wire,
    make_problem,
    make_recording,
    make_rig,
    rmse,
    simulate_exact,
)

import jax
import jax.numpy as jnp
import numpy as np

from smajax.control.analysis.instability import instability_reason
from smajax.control.tuning.objective import make_objective
from smajax.control.tuning.plant_draws import draw_from_fit, draw_from_ranges
from smajax.control.tuning.problem import TuningProblem, simulate_gains
from smajax.control.tuning.tune import TuningResult, tune
from smajax.files.rig_file import Rig
from smajax.fitting.fit import fit
from smajax.fitting.result import FitResult
from smajax.numerics.loop_kernels import jit_with_kernels
from tests.reference.rig_file import RigFile

WEIGHTS = {"tracking": 1.0, "effort": 1.0}
LOW_EFFORT_WEIGHTS = {"tracking": 1.0, "effort": 0.01}
_DRAWS = 16  # draws for which robust gains are tuned
_MARGIN = 0.5  # K below the limit, for these draws
_LIMIT_SHARE = 0.75  # position of the limit between the peak of the fitted plant and the highest peak of all draws


def gradient_rows(problem: TuningProblem) -> list[Row]:
    """Compare the gradient of the objective with central differences over a minute at 50 Hz, and time it."""
    cost = jit_with_kernels(
        lambda x: jnp.sum(problem.objective_terms(x, make_objective({"tracking": 1.0}, {})).terms[:, 0] ** 2)
    )
    slope, forward = (jit_with_kernels(mode(cost)) for mode in (jax.grad, jax.jacfwd))
    point = jnp.asarray(problem.start)
    gradient = np.asarray(slope(point))
    central = np.array(
        [float(cost(point.at[i].add(1e-4)) - cost(point.at[i].add(-1e-4))) / 2e-4 for i in range(len(point))]
    )
    error = float(np.max(np.abs(gradient - central)) / np.max(np.abs(central)))
    np.testing.assert_allclose(forward(point), gradient, rtol=1e-9, atol=1e-9 * np.max(np.abs(gradient)))
    functions = {"cost": cost, "slope": slope, "forward": forward}
    seconds = medians(15, {name: lambda f=f: f(point).block_until_ready() for name, f in functions.items()})
    ratio = seconds["slope"] / seconds["cost"]
    steps = problem.reference.values.shape[0]
    return [
        Row(f"gradient through {steps} samples against differences", "<= 1e-4", f"{error:.1e}", error <= 1e-4),
        Row(
            "gradient for the gains over a rollout",
            "<= 3x",
            f"{ratio:.2f}x of {1e3 * seconds['cost']:.2f} ms",
            ratio <= 3.0,
            seconds,
        ),
        Row("the same by forward mode", "-", f"{seconds['forward'] / seconds['cost']:.2f}x", None),
    ]


def draw_plants(wire: Wire, rig: Rig, fitted: FitResult, count: int) -> dict[str, np.ndarray]:
    """Draw the uncertain parameters: those of the fit, the airflow, the ambient temperature and the load.

    Args:
        wire: The wire.
        rig: The rig with the fitted plant.
        fitted: The fit.
        count: Number of draws.

    Returns:
        Values by name, shape ``(count,)``.
    """
    rng = np.random.default_rng(3)
    labels = [u.label for u in fitted.problem.unknowns]
    entries = {
        e.name: {
            "estimate": e.estimate,
            "lower95": e.lower95,
            "upper95": e.upper95,
            "at_bound": e.at_bound,
            "bounds": [None, None],
        }
        for e in fitted.estimates
    }
    estimates = {"parameters": entries, "correlations": {"parameters": labels, "matrix": fitted.correlation.tolist()}}
    drawn = draw_from_fit(estimates, labels, count, rng)
    convection = float(rig.plant.heat.h0)
    ranges = {
        "heat.h0": (0.5 * convection, 2.5 * convection),
        "environment.ambient": (10.0, 32.0),
        "load.mass": (0.97 * wire.mass, 1.03 * wire.mass),
    }
    return drawn | draw_from_ranges(ranges, count, rng)


def robust_rows(name: str, wire: Wire, rig: Rig, fitted: FitResult, count: int) -> list[Row]:
    """Compare gains for the fitted plant with gains for draws of uncertain parameters, under a temperature limit.

    Args:
        name: Name of the wire.
        wire: The wire.
        rig: The rig with the fitted plant.
        fitted: The fit.
        count: Number of draws that score the gains.
    """
    drawn = draw_plants(wire, rig, fitted, 2 * count)
    candidates, scored = (
        make_problem(wire, rig, {n: v[half] for n, v in drawn.items()}) for half in (slice(count), slice(count, None))
    )

    def peak_temperatures(tuned: TuningResult, problem: TuningProblem = scored) -> np.ndarray:
        return np.max(np.asarray(simulate_gains(problem, tuned.gains).channels["temperature"]), axis=1)

    nominal = tune(make_problem(wire, rig), WEIGHTS, {})
    nominal_peak = float(
        np.max(np.asarray(simulate_gains(make_problem(wire, rig), nominal.gains).channels["temperature"]))
    )
    limit = round(nominal_peak + _LIMIT_SHARE * (float(np.max(peak_temperatures(nominal))) - nominal_peak), 1)
    # The draws for tuning are not those that score; half of them are arbitrary, half are the hottest.
    tuning_rows = np.append(np.arange(_DRAWS // 2), np.argsort(peak_temperatures(nominal, candidates))[-_DRAWS // 2 :])
    tuning_draws = {n: v[tuning_rows] for n, v in drawn.items()}
    rows = []
    for label, members in (("nominal", None), ("robust", tuning_draws)):
        tuned = tune(make_problem(wire, rig, members), WEIGHTS, {"temperature": limit - (_MARGIN if members else 0.0)})
        peaks = peak_temperatures(tuned)
        rollouts = simulate_gains(scored, tuned.gains)
        value = np.asarray(rollouts.channels["displacement"])
        noiseless = simulate_gains(replace(scored, scenario=scored.scenario.without_noise()), tuned.gains)
        reference = np.asarray(scored.reference.values)
        noiseless_value = np.asarray(noiseless.channels["displacement"])
        command = np.asarray(noiseless.command)
        unstable = sum(
            bool(instability_reason(command[k], reference, noiseless_value[k], 0.5 * wire.current))
            for k in range(count)
        )
        too_hot = int(np.sum(peaks > limit))
        error = 1e3 * np.sqrt(np.mean((value - reference) ** 2, axis=1))
        text = (
            f"{too_hot} beyond {limit:g} degC (hottest {peaks.max():.1f}), {unstable} unstable, of {count} draws; RMSE "
            f"{np.median(error):.3f} mm"
        )
        is_met = None if label == "nominal" else too_hot + unstable == 0
        rows.append(Row(f"{name}, {label} gains", "none" if members else "-", text, is_met, tuned.gains))
        say(f"{name}, {label}: {text}")
    return rows


def search_rows(
    name: str, wire: Wire, truth: RigFile, problem: TuningProblem, ours: TuningResult, quick: bool
) -> list[Row]:
    """Compare differential evolution and Nelder-Mead with our search, on the same rollouts.

    Args:
        name: Name of the wire.
        wire: The wire.
        truth: The rig of the exact simulator.
        problem: The tuning problem.
        ours: Result of our search.
        quick: Whether the budgets are a fifth.
    """
    rows = []
    budget = (4 if quick else 20) * ours.rollouts
    start = perf_counter()
    tune(problem, WEIGHTS, {})
    seconds = perf_counter() - start  # without compilation, as for the others
    population, descent = (
        search(problem, WEIGHTS, ours, budget, seconds) for search in (differential_evolution, nelder_mead)
    )
    ratio, reached = population.cost, population.reached
    their_gains = {n: float(v) for n, v in problem.gains(population.point).items()}
    their_error = rmse(wire, simulate_exact(wire, truth, their_gains)[0])
    text = f"objective {ratio:.3f} of ours, exact simulator {1e3 * their_error:.3f} mm, in {budget:,} rollouts"
    rows.append(
        Row(f"{name}, differential evolution", ">= 0.99 of ours", text, verdict_under_budget(ratio >= 0.99, quick))
    )
    optimum_rollouts = rollouts_to_optimum(ours)
    text = f"{reached / optimum_rollouts:.0f}x" if reached else f"> {budget / optimum_rollouts:.0f}x: not reached"
    rows.append(
        Row(
            f"{name}, its rollouts to within 1 % of ours",
            ">= 20x",
            f"{text} of the {optimum_rollouts} after which ours were",
            verdict_under_budget(reached is None or reached >= 20 * optimum_rollouts, quick),
        )
    )
    single_rollouts = evolve_single_member(problem, WEIGHTS, ours, budget)
    text = (
        f"after {single_rollouts:,} rollouts, {single_rollouts / optimum_rollouts:.1f}x ours"
        if single_rollouts
        else f"not in {budget:,} rollouts"
    )
    rows.append(
        Row(
            f"{name}, differential evolution led by one draw: within 1 % of ours",
            "-",
            text,
            None,
            {"rollouts": single_rollouts},
        )
    )
    simplex_rollouts = descent.reached
    text = f"objective {descent.cost:.3f} of ours; " + (
        f"{simplex_rollouts / optimum_rollouts:.1f}x our rollouts to within 1 %" if simplex_rollouts else "not reached"
    )
    rows.append(Row(f"{name}, Nelder-Mead", "-", text, None))
    rows += equal_budget_rows(name, ours, seconds, population, descent)
    return rows


def equal_budget_rows(
    name: str, ours: TuningResult, seconds: float, population: SearchResult, descent: SearchResult
) -> list[Row]:
    """Compare the other searches with ours after as many rollouts, and after as much time.

    Args:
        name: Name of the wire.
        ours: Result of our search.
        seconds: Its wall time.
        population: Result of differential evolution.
        descent: Result of Nelder and Mead's simplex.
    """
    rows = []
    for budget_text, costs in (
        (f"{ours.rollouts} rollouts", (population.cost_at_equal_rollouts, descent.cost_at_equal_rollouts)),
        (f"{seconds:.1f} s", (population.cost_at_equal_time, descent.cost_at_equal_time)),
    ):
        text = f"differential evolution's objective {costs[0]:.3f} of ours, Nelder-Mead's {costs[1]:.3f}"
        rows.append(Row(f"{name}, in our {budget_text}", ">= 0.99 of ours", text, min(costs) >= 0.99))
    return rows


def pictures(name: str, wire: Wire, problem: TuningProblem, runs: Sequence[tuple], folder: Path) -> None:
    """Draw the reference and the displacement of the exact simulator with the start and the tuned gains.

    Args:
        name: Name of the wire.
        wire: The wire.
        problem: The tuning problem.
        runs: Displacement, temperature and command with the start and the tuned gains.
        folder: Where the pictures go.
    """
    time = wire.period * np.arange(len(runs[0][0]))
    curves = [Curve("reference", time[::5], 1e3 * np.asarray(problem.reference.values)[::5], dashed=True)]
    curves += [Curve(w, time[::5], 1e3 * t[0][::5]) for w, t in zip(("start gains", "tuned gains"), runs, strict=True)]
    draw(
        Chart(f"{name} on the exact simulator", "time [s]", "displacement [mm]", curves),
        folder,
        f"wire_position_{name.split()[0]}",
    )


def wire_rows(name: str, wire: Wire, quick: bool, folder: Path | None) -> tuple[list[Row], Rig, FitResult]:
    """Fit one wire, tune its gains, try them on the exact simulator, and compare other searches.

    Args:
        name: Name of the wire.
        wire: The wire.
        quick: Whether the budgets are a fifth.
        folder: Where the pictures go; ``None`` for none.

    Returns:
        The rows, the rig with the fitted plant, and the fit.
    """
    rig, truth = make_rig(wire)
    fitted = fit(rig.plant, [make_recording(wire, truth)], rig.fit, interpolation=rig.interpolation)
    rig = replace(rig, plant=fitted.plant)
    say(f"{name}: fitted to {1e6 * float(fitted.rmse('displacement') or np.nan):.1f} um")
    problem = make_problem(wire, rig)
    tuned = tune(problem, WEIGHTS, {})
    start = dict(zip(NAMES, wire.start, strict=True))
    gain_sets = (start, tuned.gains)
    fitted_errors = [rmse(wire, np.asarray(simulate_gains(problem, g).channels["displacement"])[0]) for g in gain_sets]
    runs = [simulate_exact(wire, truth, g) for g in gain_sets]
    exact_errors = [rmse(wire, t[0]) for t in runs]
    share = (exact_errors[0] - exact_errors[1]) / (fitted_errors[0] - fitted_errors[1])
    rows = [
        Row(
            f"{name}, fitted plant",
            "-",
            f"{1e3 * fitted_errors[0]:.3f} -> {1e3 * fitted_errors[1]:.3f} mm in {tuned.rollouts} rollouts",
            None,
            tuned.gains,
        ),
        Row(
            f"{name}, exact simulator",
            "-",
            f"{1e3 * exact_errors[0]:.3f} -> {1e3 * exact_errors[1]:.3f} mm, hottest {runs[1][1].max():.0f} degC",
            None,
        ),
        Row(f"{name}, improvement kept", ">= 95 %", f"{100 * share:.1f} %", share >= 0.95),
    ]
    rows += search_rows(name, wire, truth, problem, tuned, quick)
    low_effort = tune(problem, LOW_EFFORT_WEIGHTS, {}, starts=4)
    ratio = differential_evolution(
        problem, LOW_EFFORT_WEIGHTS, low_effort, 20 * low_effort.rollouts if not quick else 4 * tuned.rollouts
    ).cost
    text = f"in {low_effort.rollouts} rollouts; differential evolution's {ratio:.3f} of ours"
    rows.append(Row(f"{name}, moves hardly counted", "-", text, None))
    if folder:
        pictures(name, wire, problem, runs, folder)
    return rows, rig, fitted


def main() -> None:
    """Print the table."""
    args = arguments(__doc__, quick="the thin wire only, a fifth of the budgets, 60 draws")
    rows: list[Row] = []
    for name in list(WIRES)[: 1 if args.quick else None]:
        new_rows, rig, fitted = wire_rows(name, WIRES[name], args.quick, args.out)
        rows += new_rows
        if name == "0.15 mm":
            rows += gradient_rows(make_problem(WIRES[name], rig, noisy=False))
            rows += robust_rows(name, WIRES[name], rig, fitted, 60 if args.quick else 500)
    finish(rows, args)


if __name__ == "__main__":
    main()
