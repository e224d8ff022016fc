"""Adaptive against fixed gains while the rig drifts.

    python experiments/control/adaptive_gains.py [--quick] [--json FILE] [--out DIR]

A wire follows a square of displacement; after a third of the time a fan is switched on (h0 three times as large) and
the air cools from 20 to 12 degC, after two thirds the load grows by 40 %. A fixed PID is tuned for the rig before;
another for the whole of it; and ali2026's adaptive laws, printed and gradient, get their start gains from the
first and their rates by gradients through the whole of it. Each is scored on another square under another drift,
which nothing was tuned for.
"""

from __future__ import annotations

import sys
from dataclasses import replace
from pathlib import Path

sys.path.insert(0, str(Path(__file__).resolve().parents[2]))  # the checkout: smajax, tests/reference, experiments

from experiments.common.base import Row, arguments, finish, say, shipped
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

PERIOD, NOISE, LARGEST = 0.05, 5e-6, 0.5
START = {"kp": 30.0, "ki": 20.0, "kd": 0.3}
WEIGHTS = {"tracking": 1.0, "effort": 0.01}


def scenario(
    rig: Rig, levels: tuple[float, float], drift: tuple[float, float, float], seed: int, seconds: float
) -> Scenario:
    """A square between two levels, 6 s each, with a drift of airflow (factor), ambient (K) and load (factor).

    No drift if all are none.
    """
    time = references.sample_times(seconds, PERIOD)
    reference = np.where((time // 6.0) % 2 == 0, levels[1], levels[0])
    second, third = time >= seconds / 3.0, time >= 2.0 * seconds / 3.0
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


def loop_of(controller: AbstractController) -> ClosedLoop:
    """The loop around a controller."""
    sensing = SensorModel(jnp.asarray(NOISE), jnp.asarray(0.0))
    return ClosedLoop(
        controller, Allocation(jnp.asarray(LARGEST), jnp.asarray(0.0), 1), sensing, channel="displacement"
    )


def errors(
    driven: SampledPlant, controller: AbstractController, over: Scenario, third: int
) -> tuple[list[float], np.ndarray]:
    """RMSE in m in each third of a scenario, and the displacement."""
    one = TuningProblem.of(driven, loop_of(controller), over, {})
    value = np.asarray(simulate_gains(one, {}).channels["displacement"])[0]
    left = (value - np.asarray(over.reference)) ** 2
    return [float(np.sqrt(np.mean(left[k * third : (k + 1) * third]))) for k in range(3)], value


def main() -> None:
    """Prints the table."""
    args = arguments(__doc__, quick="half the time")
    rig, _ = shipped("dead-weight")
    driven = SampledPlant.of(rig.plant, PERIOD)
    seconds = 36.0 if args.quick else 108.0
    still = scenario(rig, (2e-3, 6e-3), (1.0, 0.0, 1.0), 0, seconds / 3.0)
    drifts = scenario(rig, (2e-3, 6e-3), (3.0, -8.0, 1.4), 0, seconds)
    other = scenario(rig, (3e-3, 7e-3), (2.2, -5.0, 1.25), 1, seconds)
    pid = PID(*(jnp.asarray(v) for v in (*START.values(), 0.05, 0.0, LARGEST)), period=PERIOD)
    bounds = {n: (g / 100.0, g * 100.0) for n, g in START.items()}
    before = tune(TuningProblem.of(driven, loop_of(pid), still, bounds), WEIGHTS, {}, starts=3)
    first = with_gains(pid, before.gains)
    whole = tune(
        TuningProblem.of(driven, loop_of(first), drifts, {n: (g / 100.0, g * 100.0) for n, g in before.gains.items()}),
        WEIGHTS,
        {},
    )
    found: dict[str, AbstractController] = {
        "fixed, tuned before the drift": first,
        "fixed, tuned for the drift": with_gains(first, whole.gains),
    }
    for law in ("printed", "gradient"):
        # Rates that move a gain by its own size within some hundred samples of an error of a millimetre.
        power = 1.0 if law == "printed" else 2.0
        rates = {f"rate_{n[1]}": 1e-2 * before.gains[n] / 1e-3**power for n in ("kp", "ki")}
        rates["rate_i"] = 1e-2 / 1e-3 if law == "printed" else rates["rate_i"]
        adaptive = AdaptivePID(
            first, jnp.asarray(rates["rate_p"]), jnp.asarray(rates["rate_i"]), jnp.asarray(0.0), law=law
        )
        one = TuningProblem.of(driven, loop_of(adaptive), drifts, {n: (r / 1e4, r * 10.0) for n, r in rates.items()})
        found[f"adaptive, {law} law"] = with_gains(
            adaptive, tune(one, WEIGHTS, {}, starts=1 if args.quick else 3).gains
        )
    rows, curves = [], []
    third = len(other.reference) // 3
    for name, controller in found.items():
        each, value = errors(driven, controller, other, third)
        text = ", ".join(f"{1e3 * e:.3f}" for e in each)
        rows.append(Row(f"{name}: RMSE before, with the fan, with the load [mm]", "-", text, None, {"rmse": each}))
        say(f"{name}: {text}")
        curves.append(Curve(name, PERIOD * np.arange(len(value))[::3], 1e3 * value[::3]))
    if args.out:
        reference = Curve("reference", curves[0].x, 1e3 * np.asarray(other.reference)[::3], dashed=True)
        draw(
            Chart("Under a drift that nothing was tuned for", "time [s]", "displacement [mm]", [reference, *curves]),
            args.out,
            "adaptive_gains",
        )
    finish(rows, args)


if __name__ == "__main__":
    main()
