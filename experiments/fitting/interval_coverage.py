"""Do the 95 % intervals contain the truth as often as they say, under autocorrelated noise?

    python experiments/fitting/interval_coverage.py [--quick] [--json FILE] [--out DIR]

The exact reference simulator lifts the dead weight of the shipped rig under one current. Each repetition adds another
draw of noise, a first-order autoregression (correlation 0.7 from sample to sample), and fits five parameters. Intervals
that assume white noise are counted as well. Some of the repetitions also compute the profile likelihood of two
parameters: the last rows have the share of profiles that contain the truth, and their ends next to the interval's.
"""

from __future__ import annotations

import math
import sys
from pathlib import Path

sys.path.insert(0, str(Path(__file__).resolve().parents[2]))  # the checkout: smajax, tests/reference, experiments

from experiments.common.base import Row, arguments, finish, say
from experiments.common.reference import reference_material

import numpy as np
from scipy.stats import binom

from smajax.files.rig_file import Rig, parse_rig
from smajax.fitting.autoregression import autoregressive_spectrum, fit_autoregression
from smajax.fitting.fit import fit
from smajax.fitting.profile import crossing, profile_likelihood
from smajax.fitting.result import FitResult
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
# Parameters whose profiles are computed.
PROFILED = ("heat.h0", "material.max_transformation_strain")
# Probability with which the number of intervals that contain the truth is below its target although each contains it
# with a probability of 95 %, and the same for above: with the eight rows of this table, one of about ten tables has
# such a row.
_FALSE_ALARM = 0.01


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


def expected_shares(count: int) -> tuple[float, float]:
    """Return the least and the largest share of ``count`` independent 95 % intervals that contain the truth.

    They are quantiles of the binomial distribution. The mean share of several parameters of the same fits scatters at
    most as much as that of one.
    """
    least, largest = binom.ppf((_FALSE_ALARM, 1.0 - _FALSE_ALARM), count, 0.95) / count
    return float(least), float(largest)


def coverage(result: FitResult, recording: Recording) -> tuple[list[bool], list[bool]]:
    """Return which intervals of a fit contain the truth, also those that assume white noise.

    A parameter without an interval, such as one at a bound, does not count as one whose interval contains the truth.
    """
    covered = [contains((e.lower95, e.upper95), TRUTH[e.name]) for e in result.estimates]
    deviation = np.sqrt(np.diag(result.covariance))
    ratio = math.sqrt(_white_share(recording.channels["displacement"] - result.responses[0].model["displacement"]))
    covered_white = [
        abs(e.estimate - TRUTH[e.name]) < 1.96 * d * ratio for e, d in zip(result.estimates, deviation, strict=True)
    ]
    return covered, covered_white


def contains(ends: tuple[float | None, float | None], value: float) -> bool:
    """Return whether a value is between two ends; false where there is no end."""
    low, high = ends
    return low is not None and high is not None and low <= value <= high


def as_range(ends: tuple[float | None, float | None]) -> str:
    """Return the ends of an interval as text; "none" for an end that was not reached."""
    low, high = ("none" if end is None else f"{end:.6g}" for end in ends)
    return f"from {low} to {high}"


def profile_row(name: str, results: list[FitResult]) -> Row:
    """Return the row of a parameter's profiles: how often they contain the truth, and the ends of the first one."""
    profiles = [profile_likelihood(result, name) for result in results]
    ends = [(profile["lower95"], profile["upper95"]) for profile in profiles]
    share, (least, _) = float(np.mean([contains(e, TRUTH[name]) for e in ends])), expected_shares(len(ends))
    interval = next(e for e in results[0].estimates if e.name == name)
    interval_ends = (interval.lower95, interval.upper95)
    unit = "" if interval.unit == "1" else f" {interval.unit}"
    text = (
        f"{100 * share:.1f} % of {len(results)}; the first {as_range(ends[0])}{unit}, its interval "
        f"{as_range(interval_ends)}"
    )
    numbers = {"coverage": share, "profile": ends[0], "interval": interval_ends}
    return Row(f"profile of {name}", f"{100 * least:.3g} % or more", text, share >= least, numbers)


def end_rows() -> list[Row]:
    """Return the rows of two made profiles whose ends are known, at the nine values that ``smajax fit`` uses."""
    distance = np.linspace(0.0, 3.0, 5)
    steep, flat = distance**2 + 0.5 * distance**4, 3.0 * (1.0 - np.exp(-(distance**2) / 3.0))
    exact = math.sqrt(math.sqrt(1.0 + 2.0 * 3.841458820694124) - 1.0)
    end, none = crossing(distance, steep), crossing(distance, flat)
    met = end is not None and abs(end - exact) < 0.01
    measured = "none" if end is None else f"{end:.3f} sigma"
    return [
        Row("end of a profile that rises as d^2 + d^4 / 2", f"{exact:.3f} sigma", measured, met, {"end": end}),
        Row("end of a profile that saturates at 3", "none", "none" if none is None else f"{none:.3f}", none is None),
    ]


def main() -> None:
    """Print the table."""
    args = arguments((__doc__ or "").splitlines()[0])
    repeats = 60 if args.quick else 200
    rig = parse_rig(RIG, "coverage.toml")
    time, current, exact = make_truth(rig)
    covered, covered_white, results = [], [], []
    for k in range(repeats):
        if k % 20 == 0:
            say(f"{k} of {repeats}")
        channels = {"current": current, "displacement": exact + 2e-5 * draw_noise(len(time), 1000 + k)}
        recording = Recording.from_arrays("made", time, channels, {"current": "A", "displacement": "mm"})
        result = fit(rig.plant, [recording], rig.fit)
        results += [result] if k < repeats // 5 else []
        inside, inside_white = coverage(result, recording)
        covered.append(inside)
        covered_white.append(inside_white)
    rows, (least, largest) = [], expected_shares(repeats)
    target = f"{100 * least:.3g} to {100 * largest:.3g} %"
    for i, name in enumerate(TRUTH):
        share = float(np.mean([row[i] for row in covered]))
        white_share = float(np.mean([row[i] for row in covered_white]))
        text = f"{100 * share:.1f} % of {repeats}; {100 * white_share:.1f} % had the noise been taken for white"
        numbers = {"coverage": share, "coverage_white": white_share}
        rows.append(Row(name, target, text, least <= share <= largest, numbers))
    overall = float(np.mean(covered))
    met = least <= overall <= largest
    rows.append(Row("all parameters", target, f"{100 * overall:.1f} %", met, {"coverage": overall}))
    rows += [profile_row(name, results) for name in PROFILED]
    finish([*rows, *end_rows()], args, repeats=repeats)


def _white_share(residual: np.ndarray) -> float:
    """Return the residual's variance over its spectral density at frequency zero.

    It is the variance that white noise would give a slowly varying estimate, over that of the autocorrelated noise.
    """
    coefficients, innovation = fit_autoregression(residual)
    return float(np.var(residual) / autoregressive_spectrum(coefficients, innovation, np.zeros(1))[0])


if __name__ == "__main__":
    main()
