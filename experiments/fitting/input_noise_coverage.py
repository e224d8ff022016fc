"""Do the 95 % intervals contain the truth where the recorded current has noise that the wire does not get?

    python experiments/fitting/input_noise_coverage.py [--fits N] [--quick] [--json FILE] [--out DIR]

The exact reference simulator lifts the dead weight of ``interval_coverage.py`` under a current of levels. Each
repetition adds another draw of noise to the displacement, as there, and white noise to the recorded current only: 0,
0.3, 1 and 3 % of 0.33 A. In the last rows a tenth of the repetitions has the same noise as ripple, which the wire gets;
the current is then recorded right.
"""

from __future__ import annotations

import dataclasses
import sys
from collections import Counter
from pathlib import Path

sys.path.insert(0, str(Path(__file__).resolve().parents[2]))  # the checkout: smajax, tests/reference, experiments

from experiments.common.base import Row, arguments, finish, say
from experiments.common.reference import reference_material
from experiments.fitting.interval_coverage import RIG, TRUTH, contains, draw_noise, make_truth

import numpy as np

from smajax.files.rig_file import Rig, parse_rig
from smajax.fitting.fit import fit
from smajax.fitting.result import FitResult
from smajax.recordings.recording import Recording
from tests.reference import rigs
from tests.reference.wire import Heat, Wire

LEVELS = (0.0, 0.003, 0.01, 0.03)
# Current of which the noise is a share, A: 1 mA is 0.3 %.
CURRENT = 0.33
# Least and largest share of the intervals that contain the truth.
TARGET = (0.90, 0.98)
# Repetitions with ripple, each of which needs another simulation.
RIPPLE_SHARE = 0.1


def make_recording(time: np.ndarray, current: np.ndarray, exact: np.ndarray, k: int) -> Recording:
    """Return the recording of repetition ``k``: a recorded current (A) and an exact displacement (m), with noise."""
    channels = {"current": current, "displacement": exact + 2e-5 * draw_noise(len(time), 1000 + k)}
    return Recording.from_arrays("made", time, channels, {"current": "A", "displacement": "mm"})


def ripple_response(rig: Rig, time: np.ndarray, current: np.ndarray) -> np.ndarray:
    """Return the exact displacement (m) of the dead weight under a current (A), held from row to row."""
    heat = Heat(100.6, 0.0, 0.001, 2.0, 2.046e6, 2.046e6, 0.0)
    wire = Wire(0.15e-3, 0.23, 0.0, 20.0)
    material = reference_material(rig.plant)
    return rigs.dead_weight(material, heat, wire, 0.2, time, current, interpolation="hold").position


def covered(result: FitResult) -> list[bool]:
    """Return which intervals contain the truth; none at a bound does."""
    return [contains((e.lower95, e.upper95), TRUTH[e.name]) for e in result.estimates]


def coverage_rows(level: float, corrected: list[FitResult], exact: list[FitResult]) -> list[Row]:
    """Return a row for each parameter, and one for what the noise was taken for."""
    inside, inside_exact = (np.mean([covered(r) for r in results], axis=0) for results in (corrected, exact))
    rows, low, high = [], *TARGET
    for i, name in enumerate(TRUTH):
        share, before = float(inside[i]), float(inside_exact[i])
        text = f"{100 * share:.1f} % of {len(corrected)}; "
        text += f"{100 * before:.1f} % of {len(exact)} with the current as exact"
        what = f"{100 * level:g} %: {name}"
        numbers = {"coverage": share, "coverage_exact": before, "fits": len(corrected)}
        rows.append(Row(what, f"{100 * low:g} to {100 * high:g} %", text, low <= share <= high, numbers))
    kinds = Counter(r.input_noise[0].kind.value for r in corrected)
    counts = ", ".join(f"{kind} {n}" for kind, n in kinds.most_common())
    right = kinds["none" if level == 0.0 else "meter"] / len(corrected)
    return [*rows, Row(f"{100 * level:g} %: taken for", "90 % or more right", counts, right >= TARGET[0], dict(kinds))]


def main() -> None:
    """Print the table."""
    more = {"--fits": {"type": int, "default": 200, "metavar": "N", "help": "fits at each level of noise"}}
    args = arguments((__doc__ or "").splitlines()[0], more=more)
    fits = 12 if args.quick else args.fits
    few = max(2, round(RIPPLE_SHARE * fits))
    rig = parse_rig(RIG, "coverage.toml")
    as_exact = dataclasses.replace(rig.fit, input_noise=0.0)
    time, current, displacement = make_truth(rig)
    rows, ripple_rows = [], []
    for level in LEVELS:
        corrected, exact, ripple = [], [], []
        for k in range(fits):
            if k % 20 == 0:
                say(f"{100 * level:g} %: {k} of {fits}")
            noise = level * CURRENT * np.random.default_rng(k).standard_normal(len(time))
            recording = make_recording(time, current + noise, displacement, k)
            corrected.append(fit(rig.plant, [recording], rig.fit))
            exact.append(fit(rig.plant, [recording], as_exact))
            if level and k < few:
                recording = make_recording(time, current + noise, ripple_response(rig, time, current + noise), k)
                ripple.append(fit(rig.plant, [recording], rig.fit))
        rows += coverage_rows(level, corrected, exact)
        if ripple:
            kinds = Counter(r.input_noise[0].kind.value for r in ripple)
            share = float(np.mean([covered(r) for r in ripple]))
            counts = ", ".join(f"{kind} {n}" for kind, n in kinds.most_common())
            text = f"{counts}; {100 * share:.1f} % of all intervals contain the truth"
            met = kinds["meter"] == 0 and share >= TARGET[0]
            what = f"{100 * level:g} % of ripple: taken for"
            ripple_rows.append(Row(what, "never meter; 90 % or more", text, met, {"coverage": share, **kinds}))
    words = "" if args.fits == 200 else f" --fits {args.fits}"
    finish([*rows, *ripple_rows], args, repeats=fits, words=words)


if __name__ == "__main__":
    main()
