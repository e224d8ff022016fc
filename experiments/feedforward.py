"""What the inverse of a hysteresis operator adds to a PID on a wire.

    python experiments/feedforward.py [--quick] [--json FILE] [--out DIR]

A slow loop of current against displacement, from the exact simulator (tests/reference) with noise, identifies a Prandtl-Ishlinskii
operator with one tanh envelope, whose inverse is exact. A PID alone, a PID beside that inverse (flexible-actuator paper), and the inverse
alone follow references on the plant of the wire's rig file; the gains of each are tuned by gradients for the reference that they are scored
on, under the same limits of the current. The operator knows the wire as it is when it has time.
"""

from __future__ import annotations

from dataclasses import replace

import jax.numpy as jnp
import numpy as np
from _common import ROOT, Row, arguments, finish, say, shipped
from _figures import Chart, Curve, draw

from smajax.control import references
from smajax.control.allocation import Allocation
from smajax.control.driven import DrivenPlant
from smajax.control.feedforward import FeedforwardPID
from smajax.control.pid import PID
from smajax.control.rollout import Loop, Scenario
from smajax.control.sensing import Sensing
from smajax.control.tune import tune
from smajax.control.tuning import Tuning, roll
from smajax.fit.families import prandtl_ishlinskii
from smajax.fit.operator_problem import Series
from smajax.fit.operators import fit_operator
from smajax.hysteresis.prandtl_ishlinskii import InversePrandtlIshlinskii
from tests.reference.rig_file import read_rig, simulate

PERIOD, NOISE, LARGEST = 0.02, 5e-6, 0.5
START = {"kp": 30.0, "ki": 20.0, "kd": 0.3}
WEIGHTS = {"tracking": 1.0, "effort": 0.01}


def operator() -> tuple[InversePrandtlIshlinskii, float]:
    """The inverse of an operator fitted to the last of two slow loops, and the fit's RMSE in m."""
    seconds = np.arange(0.0, 800.0, 1.0)
    current = 0.12 + 0.22 * (1.0 - np.abs(2.0 * ((seconds / 400.0) % 1.0) - 1.0))
    rig = read_rig(ROOT / "data" / "recordings" / "dead-weight" / "rig.toml")
    lifted = simulate(rig, {"time": seconds, "current": current}).position
    last = slice(400, None)
    noisy = lifted[last] + NOISE * np.random.default_rng(0).standard_normal(400)
    series = [Series("slow", seconds[last] - 400.0, current[last], noisy)]
    found = fit_operator(prandtl_ishlinskii(series, 10, envelopes=1), series, starts=8)
    law = found.law
    return law.inverse(), found.rmse  # type: ignore[attr-defined]


def wanted(quick: bool) -> dict[str, np.ndarray]:
    """References by name."""
    time = references.clock(40.0, PERIOD)
    found = {
        "staircase": references.staircase(time, [4e-3, 7e-3, 2e-3, 5e-3], 10.0),
        "sine, 0.05 Hz": references.sine(time, 1.5e-3, 7.5e-3, 0.05),
        "sine, 0.2 Hz": references.sine(time, 1.5e-3, 7.5e-3, 0.2),
    }
    return dict(list(found.items())[:2]) if quick else found


def rmse(one: Tuning, gains: dict[str, float]) -> tuple[float, np.ndarray]:
    """Tracking error in m after the first two seconds, and the displacement."""
    value = np.asarray(roll(one, gains).channels["displacement"])[0]
    skip = round(2.0 / PERIOD)
    return float(np.sqrt(np.mean((value - np.asarray(one.task.reference))[skip:] ** 2))), value


def main() -> None:
    """Prints the table."""
    args = arguments(__doc__, quick="two of the three references")
    rig, _ = shipped("dead-weight")
    driven = DrivenPlant.of(rig.plant, PERIOD)
    inverse, error = operator()
    rows = [Row("operator on its slow loop", "-", f"RMSE {1e3 * error:.3f} mm", None)]
    for name, reference in wanted(args.quick).items():
        scenario = replace(
            Scenario.quiet(reference, before=float(reference[0]) if "sine" in name else 0.0),
            draws=jnp.asarray(np.random.default_rng(1).standard_normal(len(reference))),
        )
        pid = PID(*(jnp.asarray(v) for v in (*START.values(), 0.05, 0.0, LARGEST)), period=PERIOD)
        curves = [Curve("reference", PERIOD * np.arange(len(reference))[::5], 1e3 * reference[::5], dashed=True)]
        errors: dict[str, float] = {}
        for what, controller in (("PID", pid), ("PID and inverse", FeedforwardPID(pid, inverse))):
            sensing = Sensing(jnp.asarray(NOISE), jnp.asarray(0.0))
            loop = Loop(controller, Allocation(jnp.asarray(LARGEST), jnp.asarray(0.0), 1), sensing, channel="displacement")
            one = Tuning.of(driven, loop, scenario, {n: (g / 100.0, g * 100.0) for n, g in START.items()})
            found = tune(one, WEIGHTS, {}, starts=1 if args.quick else 3)
            errors[what], value = rmse(one, found.gains)
            curves.append(Curve(what, curves[0].x, 1e3 * value[::5]))
            if what != "PID":
                errors["inverse alone"], _ = rmse(one, dict.fromkeys(START, 1e-12))
        text = ", ".join(f"{what} {1e3 * e:.3f} mm" for what, e in errors.items())
        ratio = errors["PID"] / errors["PID and inverse"]
        rows.append(Row(f"{name}: RMSE", "-", text, None, errors))
        rows.append(Row(f"{name}: what the inverse divides the PID's error by", "-", f"{ratio:.2f}", None))
        say(f"{name}: {text}")
        if args.out:
            draw(Chart(name, "time [s]", "displacement [mm]", curves), args.out, f"feedforward_{name.split(',')[0]}_{len(rows)}")
    finish("feedforward", rows, args)


if __name__ == "__main__":
    main()
