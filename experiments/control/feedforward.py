"""What the inverse of a hysteresis operator adds to a PID on a wire.

    python experiments/control/feedforward.py [--quick] [--json FILE] [--out DIR]

A slow loop of current against displacement, from the exact simulator (tests/reference) with noise, identifies a
Prandtl-Ishlinskii operator with one tanh envelope, whose inverse is exact (krejci2001). A PID alone, a PID with that
inverse (copaci2020), and the inverse alone follow references on the plant of the wire's rig file. The gains of each
are tuned by gradients for the reference on which they are scored, under the same limits of the current. The operator
describes the wire in slow motion only.
"""

from __future__ import annotations

import sys
from dataclasses import replace
from pathlib import Path

sys.path.insert(0, str(Path(__file__).resolve().parents[2]))  # the checkout: smajax, tests/reference, experiments

from experiments.common.base import ROOT, Row, arguments, finish, read_shipped, say
from experiments.common.charts import Chart, Curve, draw

import jax.numpy as jnp
import numpy as np

from smajax.control.controllers.feedforward_pid import FeedforwardPID
from smajax.control.controllers.pid import PID
from smajax.control.loop import references
from smajax.control.loop.allocation import Allocation
from smajax.control.loop.closed_loop import ClosedLoop
from smajax.control.loop.rollout import Scenario
from smajax.control.sampled_plant import SampledPlant
from smajax.control.sensors.sensor_model import SensorModel
from smajax.control.tuning.problem import TuningProblem, simulate_gains
from smajax.control.tuning.tune import tune
from smajax.fitting.io_models.fit import fit_io_model
from smajax.fitting.io_models.problem import Series
from smajax.fitting.io_models.specs import prandtl_ishlinskii_spec
from smajax.laws.prandtl_ishlinskii_inverse import InversePrandtlIshlinskii, inverse_operator
from tests.reference.rig_file import read_rig, simulate

PERIOD, NOISE, LARGEST = 0.02, 5e-6, 0.5  # s, m, A
START = {"kp": 30.0, "ki": 20.0, "kd": 0.3}
WEIGHTS = {"tracking": 1.0, "effort": 0.01}


def identify_inverse() -> tuple[InversePrandtlIshlinskii, float]:
    """Return the inverse of an operator fitted to the last of two slow loops, and the fit's RMSE in m."""
    seconds = np.arange(0.0, 800.0, 1.0)
    current = 0.12 + 0.22 * (1.0 - np.abs(2.0 * ((seconds / 400.0) % 1.0) - 1.0))
    rig = read_rig(ROOT / "data" / "recordings" / "dead-weight" / "rig.toml")
    contraction = simulate(rig, {"time": seconds, "current": current}).position
    last = slice(400, None)
    noisy = contraction[last] + NOISE * np.random.default_rng(0).standard_normal(400)
    series = [Series("slow", seconds[last] - 400.0, current[last], noisy)]
    result = fit_io_model(prandtl_ishlinskii_spec(series, 10, envelopes=1), series, starts=8)
    law = result.model
    return inverse_operator(law), result.rmse  # type: ignore[attr-defined]


def reference_signals(quick: bool) -> dict[str, np.ndarray]:
    """Return the references by name, m."""
    time = references.sample_times(40.0, PERIOD)
    signals = {
        "staircase": references.staircase(time, [4e-3, 7e-3, 2e-3, 5e-3], 10.0),
        "sine, 0.05 Hz": references.sine(time, 1.5e-3, 7.5e-3, 0.05),
        "sine, 0.2 Hz": references.sine(time, 1.5e-3, 7.5e-3, 0.2),
    }
    return dict(list(signals.items())[:2]) if quick else signals


def rmse(problem: TuningProblem, gains: dict[str, float]) -> tuple[float, np.ndarray]:
    """Return the tracking error in m after the first two seconds, and the displacement."""
    value = np.asarray(simulate_gains(problem, gains).channels["displacement"])[0]
    skip = round(2.0 / PERIOD)
    return float(np.sqrt(np.mean((value - np.asarray(problem.reference.values))[skip:] ** 2))), value


def main() -> None:
    """Print the table."""
    args = arguments(__doc__, quick="two of the three references")
    rig, _ = read_shipped("dead-weight")
    sampled = SampledPlant.of(rig.plant, PERIOD)
    inverse, error = identify_inverse()
    rows = [Row("operator on its slow loop", "-", f"RMSE {1e3 * error:.3f} mm", None)]
    for name, reference in reference_signals(args.quick).items():
        scenario = replace(
            Scenario.noiseless(reference, initial_reference=float(reference[0]) if "sine" in name else 0.0),
            draws=jnp.asarray(np.random.default_rng(1).standard_normal(len(reference))),
        )
        pid = PID(*(jnp.asarray(v) for v in (*START.values(), 0.05, 0.0, LARGEST)), period=PERIOD)
        curves = [Curve("reference", PERIOD * np.arange(len(reference))[::5], 1e3 * reference[::5], dashed=True)]
        errors: dict[str, float] = {}
        for label, controller in (("PID", pid), ("PID and inverse", FeedforwardPID(pid, inverse))):
            sensor = SensorModel(jnp.asarray(NOISE), jnp.asarray(0.0))
            loop = ClosedLoop(
                controller, Allocation(jnp.asarray(LARGEST), jnp.asarray(0.0), 1), sensor, channel="displacement"
            )
            problem = TuningProblem.of(sampled, loop, scenario, {n: (g / 100.0, g * 100.0) for n, g in START.items()})
            result = tune(problem, WEIGHTS, {}, starts=1 if args.quick else 3)
            errors[label], value = rmse(problem, result.gains)
            curves.append(Curve(label, curves[0].x, 1e3 * value[::5]))
            if label != "PID":
                errors["inverse alone"], _ = rmse(problem, dict.fromkeys(START, 1e-12))
        text = ", ".join(f"{label} {1e3 * e:.3f} mm" for label, e in errors.items())
        ratio = errors["PID"] / errors["PID and inverse"]
        rows.append(Row(f"{name}: RMSE", "-", text, None, errors))
        rows.append(Row(f"{name}: what the inverse divides the PID's error by", "-", f"{ratio:.2f}", None))
        say(f"{name}: {text}")
        if args.out:
            draw(
                Chart(name, "time [s]", "displacement [mm]", curves),
                args.out,
                f"feedforward_{name.split(',')[0]}_{len(rows)}",
            )
    finish(rows, args)


if __name__ == "__main__":
    main()
