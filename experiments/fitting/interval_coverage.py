"""Do the 95 % intervals contain the truth as often as they say, under autocorrelated noise?
 The exact reference simulator lifts the dead weight of the shipped rig under one current; each repetition adds
another draw of noise, a first-order autoregression (correlation 0.7 from sample to sample), and fits five parameters.
Intervals that took the noise for white are counted, too.
"""

from __future__ import annotations

import math
import sys
from pathlib import Path

sys.path.insert(0, str(Path(__file__).resolve().parents[2]))  # the checkout: smajax, tests/reference, experiments

from experiments.common.base import Row, arguments, finish, say

import numpy as np

from smajax.files.rig_file import parse_rig
from smajax.fitting import intervals as uncertainty
from smajax.fitting.fit import fit
from smajax.recordings.recording import Recording
from tests.reference import rigs
from tests.reference.brinson import Material
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


def main() -> None:
    """Prints the table."""
    args = arguments(__doc__.splitlines()[0])
    repeats = 60 if args.quick else 200
    rig = parse_rig(RIG, "coverage.toml")
    time = np.arange(1500) / 25.0
    levels = np.random.default_rng(3).uniform(0.2, 0.4, 15)
    levels[1::3] = 0.0
    current = np.repeat(levels, 100)
    material = Material(**{k: float(getattr(rig.plant.material, k)) for k in Material._fields})
    exact = rigs.dead_weight(
        material,
        Heat(100.6, 0.0, 0.001, 2.0, 2.046e6, 2.046e6, 0.0),
        Wire(0.15e-3, 0.23, 0.0, 20.0),
        0.2,
        time,
        current,
        interpolation="hold",
    ).position
    inside, white = [], []
    for k in range(repeats):
        if k % 20 == 0:
            say(f"{k} of {repeats}")
        draw = np.random.default_rng(1000 + k).standard_normal(len(time) + 100)
        noise = np.zeros(len(draw))
        for j in range(1, len(draw)):
            noise[j] = 0.7 * noise[j - 1] + math.sqrt(1 - 0.49) * draw[j]
        made = Recording.from_arrays(
            "made",
            time,
            {"current": current, "displacement": exact + 2e-5 * noise[100:]},
            {"current": "A", "displacement": "mm"},
        )
        result = fit(rig.plant, [made], rig.fit)
        inside.append([e.lower95 <= TRUTH[e.name] <= e.upper95 for e in result.estimates])
        deviation = np.sqrt(np.diag(result.covariance))
        ratio = math.sqrt(_white_share(made.channels["displacement"] - result.responses[0].model["displacement"]))
        white.append(
            [
                abs(e.estimate - TRUTH[e.name]) < 1.96 * d * ratio
                for e, d in zip(result.estimates, deviation, strict=True)
            ]
        )
    rows = []
    for i, name in enumerate(TRUTH):
        share, naive = float(np.mean([row[i] for row in inside])), float(np.mean([row[i] for row in white]))
        rows.append(
            Row(
                name,
                "90 to 98 %",
                f"{100 * share:.1f} % of {repeats}; {100 * naive:.1f} % had the noise been taken for white",
                0.90 <= share <= 0.98,
                {"coverage": share, "coverage_white": naive},
            )
        )
    overall = float(np.mean(inside))
    rows.append(
        Row("all parameters", "90 to 98 %", f"{100 * overall:.1f} %", 0.90 <= overall <= 0.98, {"coverage": overall})
    )
    finish(rows, args, repeats=repeats)


def _white_share(residual: np.ndarray) -> float:
    """Variance over the residual's spectral density at frequency zero.

    What white noise would make of a slow column's variance.
    """
    coefficients, innovation = uncertainty.fit_autoregression(residual)
    return float(np.var(residual) / uncertainty.autoregressive_spectrum(coefficients, innovation, np.zeros(1))[0])


if __name__ == "__main__":
    main()
