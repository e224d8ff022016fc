"""Adaptive gains against fixed gains while the rig drifts.

    python experiments/control/adaptive_gains.py [--quick] [--json FILE] [--out DIR]

A wire follows a square wave of displacement. After a third of the time a fan is switched on (h0 three times as large)
and the air cools from 20 to 12 degC; after two thirds the load grows by 40 %. One fixed PID is tuned before the drift,
another for all of it. The adaptive laws of ali2026, as printed and by the gradient, start from the gains of the first;
their rates are tuned by gradients for the whole drift. Each controller is scored on another square wave under another
drift, for which none was tuned.
"""

from __future__ import annotations

import sys
from dataclasses import replace
from pathlib import Path

sys.path.insert(0, str(Path(__file__).resolve().parents[2]))  # the checkout: smajax, tests/reference, experiments

from experiments.common.base import Row, arguments, finish, read_shipped, say
from experiments.common.charts import Chart, Curve, draw

import jax.numpy as jnp
import numpy as np

from smajax.control.controllers.adaptive_pid import AdaptivePID
from smajax.control.controllers.base import AbstractController
from smajax.control.controllers.pid import PID
from smajax.control.loop import references
from smajax.control.loop.allocation import Allocation
from smajax.control.loop.closed_loop import ClosedLoop
from smajax.control.loop.gains import with_gains
from smajax.control.loop.rollout import Scenario
from smajax.control.sampled_plant import SampledPlant
from smajax.control.sensors.sensor_model import SensorModel
from smajax.control.tuning.problem import TuningProblem, simulate_gains
from smajax.control.tuning.tune import tune
from smajax.files.rig_file import Rig

PERIOD, NOISE, LARGEST = 0.05, 5e-6, 0.5  # s, m, A
START = {"kp": 30.0, "ki": 20.0, "kd": 0.3}
WEIGHTS = {"tracking": 1.0, "effort": 0.01}


def make_scenario(
    rig: Rig, levels: tuple[float, float], drift: tuple[float, float, float], seed: int, seconds: float
) -> Scenario:
    """Return a square wave between two levels, 6 s each, with a drift of airflow, ambient temperature and load.

    Args:
        rig: The rig.
        levels: Lower and upper level, m.
        drift: Factor of the convection, change of the ambient temperature (K), factor of the load.
        seed: Seed of the sensor's noise.
        seconds: Duration, s.
    """
    time = references.sample_times(seconds, PERIOD)
    reference = np.where((time // 6.0) % 2 == 0, levels[1], levels[0])
    second = time >= seconds / 3.0
    third = time >= 2.0 * seconds / 3.0
    plant = rig.plant
    changes = {
        "heat.h0": float(plant.heat.h0) * np.where(second, drift[0], 1.0),
        "environment.ambient": float(plant.environment.ambient) + np.where(second, drift[1], 0.0),
        "load.mass": float(plant.mechanism.load.mass) * np.where(third, drift[2], 1.0),
    }
    draws = np.random.default_rng(seed).standard_normal(len(time))
    return replace(
        Scenario.noiseless(reference, changes={n: jnp.asarray(v) for n, v in changes.items()}), draws=jnp.asarray(draws)
    )


def make_loop(controller: AbstractController) -> ClosedLoop:
    """Return the loop around a controller."""
    sensor = SensorModel(jnp.asarray(NOISE), jnp.asarray(0.0))
    return ClosedLoop(controller, Allocation(jnp.asarray(LARGEST), jnp.asarray(0.0), 1), sensor, channel="displacement")


def errors(
    sampled: SampledPlant, controller: AbstractController, target_scenario: Scenario, third: int
) -> tuple[list[float], np.ndarray]:
    """Return the RMSE in each third of a scenario, m, and the displacement.

    Args:
        sampled: The sampled plant.
        controller: The controller.
        target_scenario: The scenario.
        third: Number of samples of a third.
    """
    problem = TuningProblem.of(sampled, make_loop(controller), target_scenario, {})
    value = np.asarray(simulate_gains(problem, {}).channels["displacement"])[0]
    squared_error = (value - np.asarray(target_scenario.reference)) ** 2
    return [float(np.sqrt(np.mean(squared_error[k * third : (k + 1) * third]))) for k in range(3)], value


def main() -> None:
    """Print the table."""
    args = arguments(__doc__, quick="half the time")
    rig, _ = read_shipped("dead-weight")
    sampled = SampledPlant.of(rig.plant, PERIOD)
    seconds = 36.0 if args.quick else 108.0
    constant = make_scenario(rig, (2e-3, 6e-3), (1.0, 0.0, 1.0), 0, seconds / 3.0)
    drifting = make_scenario(rig, (2e-3, 6e-3), (3.0, -8.0, 1.4), 0, seconds)
    scored = make_scenario(rig, (3e-3, 7e-3), (2.2, -5.0, 1.25), 1, seconds)
    pid = PID(*(jnp.asarray(v) for v in (*START.values(), 0.05, 0.0, LARGEST)), period=PERIOD)
    bounds = {n: (g / 100.0, g * 100.0) for n, g in START.items()}
    tuned_before = tune(TuningProblem.of(sampled, make_loop(pid), constant, bounds), WEIGHTS, {}, starts=3)
    fixed = with_gains(pid, tuned_before.gains)
    tuned_for_drift = tune(
        TuningProblem.of(
            sampled, make_loop(fixed), drifting, {n: (g / 100.0, g * 100.0) for n, g in tuned_before.gains.items()}
        ),
        WEIGHTS,
        {},
    )
    controllers: dict[str, AbstractController] = {
        "fixed, tuned before the drift": fixed,
        "fixed, tuned for the drift": with_gains(fixed, tuned_for_drift.gains),
    }
    for law in ("printed", "gradient"):
        # At an error of 1 mm these rates change a gain by its own size within about a hundred samples.
        power = 1.0 if law == "printed" else 2.0
        rates = {f"rate_{n[1]}": 1e-2 * tuned_before.gains[n] / 1e-3**power for n in ("kp", "ki")}
        rates["rate_i"] = 1e-2 / 1e-3 if law == "printed" else rates["rate_i"]
        adaptive = AdaptivePID(
            fixed, jnp.asarray(rates["rate_p"]), jnp.asarray(rates["rate_i"]), jnp.asarray(0.0), law=law
        )
        problem = TuningProblem.of(
            sampled, make_loop(adaptive), drifting, {n: (r / 1e4, r * 10.0) for n, r in rates.items()}
        )
        controllers[f"adaptive, {law} law"] = with_gains(
            adaptive, tune(problem, WEIGHTS, {}, starts=1 if args.quick else 3).gains
        )
    rows, curves = [], []
    third = len(scored.reference) // 3
    for name, controller in controllers.items():
        third_errors, value = errors(sampled, controller, scored, third)
        text = ", ".join(f"{1e3 * e:.3f}" for e in third_errors)
        rows.append(
            Row(f"{name}: RMSE before, with the fan, with the load [mm]", "-", text, None, {"rmse": third_errors})
        )
        say(f"{name}: {text}")
        curves.append(Curve(name, PERIOD * np.arange(len(value))[::3], 1e3 * value[::3]))
    if args.out:
        reference = Curve("reference", curves[0].x, 1e3 * np.asarray(scored.reference)[::3], dashed=True)
        draw(
            Chart("Under a drift that nothing was tuned for", "time [s]", "displacement [mm]", [reference, *curves]),
            args.out,
            "adaptive_gains",
        )
    finish(rows, args)


if __name__ == "__main__":
    main()
