"""ASTM E3097 temperatures and strains of measured cycles, next to what ASMADA reads off the same files (its values.

Its authors' program).

    python experiments/measured/astm_properties.py [--data DIR] [--quick] [--json FILE] [--out DIR]

DIR holds asmada-cyclic, a hundred cycles under one stress, and nasa-bigelow-nitihf, one cycle each under six
stresses. On the first, means are compared with how much the cycles scatter. On the second there is one cycle to a
stress, and the two programs differ by definition: where a transformation ends slowly, a tangent at its steepest place
ends it early, and a symmetrical sigmoid through all rows, which ASMADA lays, late. So M_f, which ends slowly there,
comes out some kelvins above, and the interval, which tells of noise, need not hold the other's.
"""

from __future__ import annotations

import sys
import time
from pathlib import Path

sys.path.insert(0, str(Path(__file__).resolve().parents[2]))  # the checkout: smajax, tests/reference, experiments

from experiments.common.base import Row, arguments, finish, refuse

import numpy as np

from smajax.properties.thermal_cycles import PROPERTY_NAMES, TEMPERATURE_NAMES, analyse_cycles, mean_properties

LABELS = dict(zip(TEMPERATURE_NAMES, ("M_s", "M_f", "A_s", "A_f"), strict=True))
CYCLIC = (122.90, 94.26, 113.09, 128.11, 0.03440, 0.03791, 12.02, 33.85)
TOOK = 1.2  # s
BY_STRESS = {
    7: None,
    50: (182.6, 166.2, 202.9, 215.2),
    100: (186.8, 168.9, 205.8, 218.5),
    200: (198.5, 175.1, 212.2, 225.8),
    300: (212.1, 182.0, 218.7, 236.6),
    400: (227.3, 188.8, 225.9, 255.1),
}


def main() -> None:
    """Prints the table."""
    args = arguments(__doc__, data=".", quick="the hundred cycles only")
    finish([*cyclic(args.data), *([] if args.quick else by_stress(args.data))], args)


def cyclic(data: Path) -> list[Row]:
    """Means over the cycles of one long recording."""
    columns = read(data / "asmada-cyclic" / "Example Test Data.txt")
    began = time.process_time()
    found, refused = analyse_cycles("cycles", columns[:, 0], columns[:, 1], smooth=9)
    seconds, means, rows = time.process_time() - began, mean_properties(found), []
    for name, theirs in zip(PROPERTY_NAMES, CYCLIC, strict=True):
        mean, scatter = means[name], float(np.std([c.values[name].value for c in found]))
        told = f"{mean.value:.5g} ({mean.lower95:.5g} .. {mean.upper95:.5g}); cycles scatter by {scatter:.2g}"
        rows.append(
            Row(
                f"hundred cycles, {name}: ASMADA {theirs:g}",
                "within the scatter",
                told,
                abs(mean.value - theirs) < scatter,
            )
        )
    rows.append(Row("hundred cycles, read: ASMADA 99 of 100", "-", f"{len(found)} read, {len(refused)} refused", None))
    what = f"hundred cycles, CPU time: ASMADA {TOOK:g} s, without intervals, on another machine"
    return [*rows, Row(what, "-", f"{seconds:.1f} s with", None)]


def by_stress(data: Path) -> list[Row]:
    """One cycle under each stress."""
    rows = []
    for stress, theirs in BY_STRESS.items():
        columns = read(data / "nasa-bigelow-nitihf" / f"{stress} MPa.txt")
        found, refused = analyse_cycles(f"{stress} MPa", columns[:, 0], columns[:, 1] / 100)
        if not found:
            rows.append(Row(f"NiTiHf, {stress} MPa", "a value or a sentence", refused[0], True))
            continue
        for k, name in enumerate(TEMPERATURE_NAMES):
            one = found[0].values[name]
            told = f"{one.value:.1f} ({one.lower95:.1f} .. {one.upper95:.1f}) degC"
            what = f"NiTiHf, {stress} MPa, {LABELS[name]}: ASMADA"
            if theirs is None:
                rows.append(Row(f"{what} none", "a value or a sentence", told, bool(np.isfinite(one.value))))
            else:
                rows.append(Row(f"{what} {theirs[k]:g}", "-", f"{told}, {one.value - theirs[k]:+.1f} K", None))
    return rows


def read(path: Path) -> np.ndarray:
    """The columns of a file without a header: temperature, strain, stress."""
    if not path.is_file():
        refuse(f"{path} is not there: give the folder of asmada-cyclic and nasa-bigelow-nitihf by --data")
    return np.loadtxt(path)


if __name__ == "__main__":
    main()
