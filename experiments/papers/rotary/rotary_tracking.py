"""Tracking with two wires on a pulley: gains tuned on a fitted plant, then tried on the exact simulator.

    python experiments/papers/rotary/rotary_tracking.py [--quick] [--json FILE] [--out DIR]

Source: fast_rotary_actuator, for the wires (its table 1) and the h(T) of three cooling modes (its table 4): free air,
fan low, fan high. In each mode the exact simulator (tests/reference, which shares no code with smajax) makes a noisy
recording, with wires that differ from the rig file's, and the plant is fitted to it. A PID at 100 Hz has one command
for both wires, and a co-contraction in addition. It is tuned through its closed loop for a slow sine, with five times
the weight on its moves as on the error, the encoder's noise and steps, and gains up to a tenth off. (If the sine is as
fast as the cooling allows, or moves count less, the best gains are close to oscillation, and chance decides among
them.) The improvement on the fitted plant is compared with that on the exact simulator, which has its own
implementation of the controller, also with noise for which nothing was tuned.

Differential evolution (storn1997), with the same compiled rollouts, the same objective and twenty times as many of
them, and Nelder and Mead's simplex search for the same four gains. At last the co-contraction is removed, and the other
three gains are tuned again.
"""

from __future__ import annotations

import sys
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path

sys.path.insert(0, str(Path(__file__).resolve().parents[3]))  # the checkout: smajax, tests/reference, experiments

from experiments.common.base import ROOT, Row, arguments, finish, say
from experiments.common.charts import Chart, Curve, draw
from experiments.common.gain_searches import (
    differential_evolution,
    nelder_mead,
    rollouts_to_optimum,
    verdict_under_budget,
)
from experiments.common.reference import reference_material

import jax.numpy as jnp
import numpy as np

from smajax.control.controllers.pid import PID
from smajax.control.loop import references
from smajax.control.loop.allocation import Allocation
from smajax.control.loop.closed_loop import ClosedLoop
from smajax.control.loop.rollout import Scenario
from smajax.control.sampled_plant import SampledPlant
from smajax.control.sensors.sensor_model import SensorModel
from smajax.control.tuning.problem import GAIN_SPREAD, TuningProblem, noise_draws, simulate_gains
from smajax.control.tuning.tune import TuningResult, tune
from smajax.files.parameter_sets import read_parameters
from smajax.files.rig_file import Rig, parse_rig
from smajax.fitting.fit import fit
from smajax.recordings.recording import Recording
from tests.reference.closed_loop import Pid, turn
from tests.reference.rig_file import RigFile
from tests.reference.rig_file import simulate as simulate_exactly
from tests.reference.wire import Wire, polynomial_heat

RIG = """
schema = 1
[rig]
kind = "antagonistic-rotary"
control = "current"
[material]
set = "rotary-table1"
[heat]
h0 = "200 W/m^2/K"
h2 = "0.01 W/m^2/K^3"
capacity = "2.046 MJ/m^3/K"
[wire]
diameter = "0.2 mm"
length = "0.5 m"
prestrain = "2 %"
[pulley]
radius = "20 mm"
[environment]
ambient = "20 degC"
[fit]
free = ["heat.h0", "heat.h2", "material.max_transformation_strain", "material.austenite_shift",
        "material.martensite_shift"]
bounds = { "heat.h0" = ["10 W/m^2/K", "1000 W/m^2/K"], "heat.h2" = ["0 W/m^2/K^3", "1 W/m^2/K^3"] }
observe = ["angle"]
starts = 6
"""
# Factors and shifts of the truth that the rig file does not have, in addition to h(T).
TRUTH = {"max_transformation_strain": 0.985, "austenite_shift": -1.4, "martensite_shift": 0.8}
NOISE = np.radians(0.06)
QUANTUM = np.radians(0.025)
PERIOD, FILTER_TIME = 0.01, 0.03
AMPLITUDE, CYCLES = np.radians(12.0), 2
WEIGHTS = {"tracking": 1.0, "effort": 5.0}


@dataclass(frozen=True)
class Mode:
    """A cooling mode.

    Attributes:
        table: Name of its parameter table.
        current: Lowest and highest current of the recording, A.
        largest: Largest current of the controller, A.
        frequency: Frequency of the sine, Hz.
    """

    table: str
    current: tuple[float, float]
    largest: float
    frequency: float


MODES = {
    "free": Mode("rotary-table4-free-second", (0.3, 0.5), 0.6, 0.05),
    "low": Mode("rotary-table4-low-second", (0.6, 1.0), 1.2, 0.1),
    "high": Mode("rotary-table4-high-second", (0.8, 1.3), 1.6, 0.2),
}


def make_rigs(mode: Mode) -> tuple[Rig, RigFile]:
    """Return the rig with nominal values, and the truth."""
    rig = parse_rig(RIG, "rotary.toml")
    material = reference_material(rig.plant)
    table = {k: e.value for k, e in read_parameters(ROOT / "data" / "parameters" / f"{mode.table}.toml").items()}
    heat = polynomial_heat(table["heat.h0"], 2.046e6, h2=table["heat.h2"])
    wire = Wire(0.2e-3, 0.5, 0.02, 20.0)
    truth = RigFile("antagonistic-rotary", "current", "hold", material, heat, wire, {"radius": 0.02}, ("angle",))
    return rig, truth.changed(**TRUTH)


def make_recording(mode: Mode, truth: RigFile, seed: int) -> Recording:
    """Simulate 40 s of the truth, the wires alternating faster than half a sine, with the encoder's noise and steps.

    Args:
        mode: The cooling mode.
        truth: The rig of the exact simulator.
        seed: Seed of inputs and noise.
    """
    rng = np.random.default_rng(seed)
    time = np.arange(2001) / 50.0
    currents = np.zeros((len(time), 2))
    begin = 0.0
    turn = 0
    while begin <= time[-1]:
        span = rng.uniform(0.075, 0.3) / mode.frequency
        pause = rng.uniform(0.015, 0.15) / mode.frequency if rng.random() < 0.4 else 0.0
        inside = (time >= begin) & (time < begin + span)
        currents[inside, turn % 2] = rng.uniform(*mode.current)
        begin = begin + span + pause
        turn = turn + 1
    position = simulate_exactly(
        truth, {"time": time, "current_1": currents[:, 0], "current_2": currents[:, 1]}
    ).position
    angle = QUANTUM * np.round((position + NOISE * rng.standard_normal(len(time))) / QUANTUM)
    channels = {"current_1": currents[:, 0], "current_2": currents[:, 1], "angle": angle}
    return Recording.from_arrays("train", time, channels, {"current_1": "A", "current_2": "A", "angle": "deg"})


def make_scenario(mode: Mode, seed: int = 1) -> Scenario:
    """Return a sine about the middle, from there."""
    time = references.sample_times(CYCLES / mode.frequency, PERIOD)
    draws = np.random.default_rng(seed).standard_normal(len(time))
    wave = AMPLITUDE * np.sin(2.0 * np.pi * mode.frequency * time)
    return Scenario(jnp.asarray(wave), jnp.asarray(0.0), jnp.asarray(draws), {})


def start_gains(mode: Mode) -> dict[str, float]:
    """Return start gains (A/rad, A/rad/s, A s/rad, A), which track without oscillation in all modes.

    They are three tenths of the largest current at the amplitude, an integral time of 0.4 s, a derivative time of
    10 ms, and four tenths of the largest current in both wires.
    """
    kp = 0.3 * mode.largest / AMPLITUDE
    return {"kp": kp, "ki": 2.5 * kp, "kd": 0.01 * kp, "co_contraction": 0.4 * mode.largest}


def make_problem(mode: Mode, rig: Rig, start: dict[str, float]) -> TuningProblem:
    """Return the tuning problem of a rig's plant.

    Without a co-contraction in ``start``, the wires are heated in turn only.

    Args:
        mode: The cooling mode.
        rig: The rig.
        start: Start gains by name.
    """
    limits = (-mode.largest, mode.largest)
    pid = PID(*(jnp.asarray(v) for v in (start["kp"], start["ki"], start["kd"], FILTER_TIME, *limits)), period=PERIOD)
    pair = Allocation(jnp.asarray(mode.largest), jnp.asarray(start.get("co_contraction", 0.0)), 2)
    loop = ClosedLoop(pid, pair, SensorModel(jnp.asarray(NOISE), jnp.asarray(QUANTUM)), channel="angle")
    bounds = {name: (value / 100.0, value * 100.0) for name, value in start.items()}
    if "co_contraction" in start:
        bounds["co_contraction"] = (0.01 * mode.largest, mode.largest)
    scenario = make_scenario(mode)
    return TuningProblem.of(
        SampledPlant.of(rig.plant, PERIOD),
        loop,
        scenario,
        bounds,
        draws=noise_draws(loop, scenario),
        spread=GAIN_SPREAD,
    )


def simulate_exact(
    mode: Mode, truth: RigFile, gains: dict[str, float], scenario: Scenario
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return angle, temperatures and commands on the exact simulator.

    Args:
        mode: The cooling mode.
        truth: The rig of the exact simulator.
        gains: The gains by name.
        scenario: Reference and noise.
    """
    pid = Pid(gains["kp"], gains["ki"], gains["kd"], FILTER_TIME, -mode.largest, mode.largest, PERIOD)
    noise = NOISE * np.asarray(scenario.draws)
    return turn(truth, pid, gains.get("co_contraction", 0.0), np.asarray(scenario.reference), noise, QUANTUM)


def rmse(angle: np.ndarray, scenario: Scenario) -> float:
    """Return the tracking error, degrees."""
    return float(np.degrees(np.sqrt(np.mean((angle - np.asarray(scenario.reference)) ** 2))))


def search_rows(
    name: str, mode: Mode, truth: RigFile, problem: TuningProblem, ours: TuningResult, quick: bool
) -> list[Row]:
    """Compare differential evolution and Nelder-Mead with our search, on the same rollouts.

    Args:
        name: Name of the mode.
        mode: The cooling mode.
        truth: The rig of the exact simulator.
        problem: The tuning problem.
        ours: Result of our search.
        quick: Whether the budgets are a fifth.
    """
    scenario, rows = make_scenario(mode), []
    budget = (4 if quick else 20) * ours.rollouts
    optimum_rollouts = rollouts_to_optimum(ours)
    for label, search in (("differential evolution", differential_evolution), ("Nelder-Mead", nelder_mead)):
        theirs = search(problem, WEIGHTS, ours, budget)
        error = rmse(
            simulate_exact(mode, truth, {n: float(v) for n, v in problem.gains(theirs.point).items()}, scenario)[0],
            scenario,
        )
        text = f"objective {theirs.cost:.3f} of ours, exact simulator {error:.3f} deg, in {budget:,} rollouts"
        population = search is differential_evolution
        rows.append(
            Row(
                f"{name}, {label}",
                ">= 0.99 of ours" if population else "-",
                text,
                verdict_under_budget(theirs.cost >= 0.99, quick) if population else None,
            )
        )
        text = (
            f"{theirs.reached / optimum_rollouts:.1f}x"
            if theirs.reached
            else f"> {budget / optimum_rollouts:.0f}x: not reached"
        )
        text += f" of the {optimum_rollouts} after which ours were"
        is_slow = theirs.reached is None or theirs.reached >= 20 * optimum_rollouts
        met = verdict_under_budget(is_slow, quick) if population else None
        rows.append(Row(f"{name}, its rollouts to within 1 % of ours", ">= 20x" if population else "-", text, met))
        say(f"{name}, {label}: {rows[-2].measured}; {text}")
    return rows


def pictures(name: str, scenario: Scenario, runs: Sequence[tuple], folder: Path) -> None:
    """Draw the reference and the angle of the exact simulator with the start and the tuned gains.

    Args:
        name: Name of the mode.
        scenario: Reference and noise.
        runs: Angle, temperatures and commands with the start and the tuned gains.
        folder: Where the pictures go.
    """
    time = PERIOD * np.arange(len(scenario.reference))
    curves = [Curve("reference", time[::2], np.degrees(scenario.reference)[::2], dashed=True)]
    curves += [
        Curve(w, time[::2], np.degrees(t[0])[::2]) for w, t in zip(("start gains", "tuned gains"), runs, strict=True)
    ]
    draw(
        Chart(f"{name} on the exact simulator", "time [s]", "angle [deg]", curves),
        folder,
        f"rotary_tracking_{name}",
    )


def fit_mode(name: str, mode: Mode) -> tuple[Rig, RigFile]:
    """Return the rig with the plant fitted to a recording of the truth, and the truth."""
    rig, truth = make_rigs(mode)
    fitted = fit(rig.plant, [make_recording(mode, truth, list(MODES).index(name))], rig.fit)
    say(f"{name}: fitted to {np.degrees(fitted.rmse('angle') or np.nan):.3f} deg")
    rig = replace(rig, plant=fitted.plant)
    return rig, truth


def mode_rows(name: str, mode: Mode, quick: bool, folder: Path | None) -> list[Row]:
    """Fit one cooling mode, tune its gains, try them on the exact simulator, and compare other searches.

    Args:
        name: Name of the mode.
        mode: The cooling mode.
        quick: Whether the budgets are a fifth.
        folder: Where the pictures go; ``None`` for none.
    """
    rig, truth = fit_mode(name, mode)
    start = start_gains(mode)
    scenario = make_scenario(mode)
    other_scenario = make_scenario(mode, seed=2)
    problem = make_problem(mode, rig, start)
    tuned = tune(problem, WEIGHTS, {}, starts=2)
    gain_sets = (start, tuned.gains)
    fitted_errors = [rmse(np.asarray(simulate_gains(problem, g).channels["angle"])[0], scenario) for g in gain_sets]
    runs = [simulate_exact(mode, truth, g, scenario) for g in gain_sets]
    exact_errors = [rmse(t[0], scenario) for t in runs]
    other_noise_errors = [rmse(simulate_exact(mode, truth, g, other_scenario)[0], other_scenario) for g in gain_sets]
    share, other_share = (
        (e[0] - e[1]) / (fitted_errors[0] - fitted_errors[1]) for e in (exact_errors, other_noise_errors)
    )
    gains = ", ".join(f"{n} {g:.3g}" for n, g in tuned.gains.items())
    hottest = runs[1][1].max()
    rows = [
        Row(f"{name}, gains (A, rad, s)", "-", gains, None, tuned.gains),
        Row(
            f"{name}, fitted plant",
            "-",
            f"{fitted_errors[0]:.3f} -> {fitted_errors[1]:.3f} deg in {tuned.rollouts} rollouts",
            None,
        ),
        Row(
            f"{name}, exact simulator",
            "-",
            f"{exact_errors[0]:.3f} -> {exact_errors[1]:.3f} deg, hottest {hottest:.0f} degC",
            None,
        ),
        Row(
            f"{name}, improvement kept",
            ">= 95 %",
            f"{100 * share:.1f} %",
            share >= 0.95,
            {"promised": fitted_errors, "kept": exact_errors},
        ),
        Row(
            f"{name}, improvement kept, other noise",
            ">= 95 %",
            f"{100 * other_share:.1f} %",
            other_share >= 0.95,
            {"kept": other_noise_errors},
        ),
    ]
    rows += search_rows(name, mode, truth, problem, tuned, quick)
    rows.append(alone_row(name, mode, rig, truth, exact_errors[1]))
    if folder:
        pictures(name, scenario, runs, folder)
    return rows


def alone_row(name: str, mode: Mode, rig: Rig, truth: RigFile, error: float) -> Row:
    """Tune the gains without the co-contraction.

    Args:
        name: Name of the mode.
        mode: The cooling mode.
        rig: The rig with the fitted plant.
        truth: The rig of the exact simulator.
        error: Tracking error with the co-contraction, degrees.
    """
    scenario = make_scenario(mode)
    start = {n: g for n, g in start_gains(mode).items() if n != "co_contraction"}
    tuned = tune(make_problem(mode, rig, start), WEIGHTS, {}, starts=2)
    error_alone = rmse(simulate_exact(mode, truth, tuned.gains, scenario)[0], scenario)
    text = f"{error_alone:.3f} deg on the exact simulator, {error_alone / error:.1f}x"
    return Row(f"{name}, tuned without co-contraction", "-", text, None, tuned.gains)


def main() -> None:
    """Print the table."""
    args = arguments(__doc__, quick="the fan's low setting only, gradients alone, a fifth of the budgets")
    rows: list[Row] = []
    for name in ["low"] if args.quick else MODES:
        rows += mode_rows(name, MODES[name], args.quick, args.out)
    finish(rows, args)


if __name__ == "__main__":
    main()
