"""Do the 95 % intervals contain the truth as often as they say, under autocorrelated noise?

    python experiments/fitting/interval_coverage.py [--quick] [--json FILE] [--out DIR]

The exact reference simulator lifts the dead weight of the shipped rig under one current. Each repetition adds another
draw of noise, a first-order autoregression (correlation 0.7 from sample to sample), and fits five parameters. Intervals
that assume white noise are counted as well.
"""

from __future__ import annotations

import math
import sys
from pathlib import Path

sys.path.insert(0, str(Path(__file__).resolve().parents[2]))  # the checkout: smajax, tests/reference, experiments

from experiments.common.base import Row, arguments, finish, say
from experiments.common.reference import reference_material

import numpy as np

from smajax.files.rig_file import Rig, parse_rig
from smajax.fitting.autoregression import autoregressive_spectrum, fit_autoregression
from smajax.fitting.fit import fit
from smajax.recordings.recording import Recording
from tests.reference import rigs
from tests.reference.wire import Heat, Wire

RIG = """
schema = 1
[rig]
kind = "dead-weight"
control = "current"
[material]
set = "rotary-table1"
detwinning_finish_stress = "78 MPa"
[heat]
h0 = "105 W/m^2/K"
h2 = "0.001 W/m^2/K^3"
capacity = "2.0 MJ/m^3/K"
[wire]
diameter = "0.15 mm"
length = "230 mm"
[load]
mass = "0.2 kg"
[environment]
ambient = "20 degC"
[fit]
free = ["heat.h0", "heat.capacity", "material.max_transformation_strain", "material.austenite_shift",
        "material.martensite_shift"]
noise = { displacement = "0.02 mm" }
starts = 1
"""
TRUTH = {
    "heat.h0": 100.6,
    "heat.capacity": 2.046e6,
    "material.max_transformation_strain": 0.041,
    "material.austenite_shift": 0.0,
    "material.martensite_shift": 0.0,
}


def make_truth(rig: Rig) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return time (s), current (A) and the exact displacement (m) of the dead weight."""
    time = np.arange(1500) / 25.0
    levels = np.random.default_rng(3).uniform(0.2, 0.4, 15)
    levels[1::3] = 0.0
    current = np.repeat(levels, 100)
    heat = Heat(100.6, 0.0, 0.001, 2.0, 2.046e6, 2.046e6, 0.0)
    wire = Wire(0.15e-3, 0.23, 0.0, 20.0)
    material = reference_material(rig.plant)
    run = rigs.dead_weight(material, heat, wire, 0.2, time, current, interpolation="hold")
    return time, current, run.position


def draw_noise(count: int, seed: int) -> np.ndarray:
    """Draw a first-order autoregression of unit variance, shape ``(count,)``."""
    draw = np.random.default_rng(seed).standard_normal(count + 100)
    noise = np.zeros(len(draw))
    for j in range(1, len(draw)):
        noise[j] = 0.7 * noise[j - 1] + math.sqrt(1 - 0.49) * draw[j]
    return noise[100:]


def coverage(rig: Rig, recording: Recording) -> tuple[list[bool], list[bool]]:
    """Fit a recording, and return which intervals contain the truth, also those that assume white noise."""
    result = fit(rig.plant, [recording], rig.fit)
    covered = [e.lower95 <= TRUTH[e.name] <= e.upper95 for e in result.estimates]
    deviation = np.sqrt(np.diag(result.covariance))
    ratio = math.sqrt(_white_share(recording.channels["displacement"] - result.responses[0].model["displacement"]))
    covered_white = [
        abs(e.estimate - TRUTH[e.name]) < 1.96 * d * ratio for e, d in zip(result.estimates, deviation, strict=True)
    ]
    return covered, covered_white


def main() -> None:
    """Print the table."""
    args = arguments((__doc__ or "").splitlines()[0])
    repeats = 60 if args.quick else 200
    rig = parse_rig(RIG, "coverage.toml")
    time, current, exact = make_truth(rig)
    covered, covered_white = [], []
    for k in range(repeats):
        if k % 20 == 0:
            say(f"{k} of {repeats}")
        channels = {"current": current, "displacement": exact + 2e-5 * draw_noise(len(time), 1000 + k)}
        recording = Recording.from_arrays("made", time, channels, {"current": "A", "displacement": "mm"})
        inside, inside_white = coverage(rig, recording)
        covered.append(inside)
        covered_white.append(inside_white)
    rows = []
    for i, name in enumerate(TRUTH):
        share = float(np.mean([row[i] for row in covered]))
        white_share = float(np.mean([row[i] for row in covered_white]))
        text = f"{100 * share:.1f} % of {repeats}; {100 * white_share:.1f} % had the noise been taken for white"
        numbers = {"coverage": share, "coverage_white": white_share}
        rows.append(Row(name, "90 to 98 %", text, 0.90 <= share <= 0.98, numbers))
    overall = float(np.mean(covered))
    rows.append(
        Row("all parameters", "90 to 98 %", f"{100 * overall:.1f} %", 0.90 <= overall <= 0.98, {"coverage": overall})
    )
    finish(rows, args, repeats=repeats)


def _white_share(residual: np.ndarray) -> float:
    """Return the residual's variance over its spectral density at frequency zero.

    It is the variance that white noise would give a slowly varying estimate, over that of the autocorrelated noise.
    """
    coefficients, innovation = fit_autoregression(residual)
    return float(np.var(residual) / autoregressive_spectrum(coefficients, innovation, np.zeros(1))[0])


if __name__ == "__main__":
    main()
