"""ASTM E3097 temperatures and strains of measured cycles (astm_e3097), next to those of the program ASMADA.

    python experiments/measured/astm_properties.py [--data DIR] [--quick] [--json FILE] [--out DIR]

DIR holds asmada-cyclic, a hundred cycles under one stress, and nasa-bigelow-nitihf, one cycle each under six stresses.
The values of ASMADA are those of its authors, from the same files. On the first, the difference of the means is
compared with the scatter of the cycles. On the second there is one cycle a stress, and the two programs differ by
definition where a transformation ends slowly: a tangent at the steepest point ends it early, a symmetrical sigmoid
through all rows, as ASMADA fits it, late. So M_f, which ends slowly there, comes out some kelvins higher; the
interval, which describes the noise, need not contain the other value.
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
ASMADA_MEANS = (122.90, 94.26, 113.09, 128.11, 0.03440, 0.03791, 12.02, 33.85)
ASMADA_SECONDS = 1.2  # s
ASMADA_BY_STRESS = {
    7: None,
    50: (182.6, 166.2, 202.9, 215.2),
    100: (186.8, 168.9, 205.8, 218.5),
    200: (198.5, 175.1, 212.2, 225.8),
    300: (212.1, 182.0, 218.7, 236.6),
    400: (227.3, 188.8, 225.9, 255.1),
}


def main() -> None:
    """Print the table."""
    args = arguments(__doc__, data=".", quick="the hundred cycles only")
    finish([*cycle_mean_rows(args.data), *([] if args.quick else stress_rows(args.data))], args)


def cycle_mean_rows(data: Path) -> list[Row]:
    """Compare the means over the cycles of one long recording."""
    columns = read_columns(data / "asmada-cyclic" / "Example Test Data.txt")
    start = time.process_time()
    cycles, refused = analyse_cycles("cycles", columns[:, 0], columns[:, 1], smooth=9)
    seconds = time.process_time() - start
    means = mean_properties(cycles)
    rows = []
    for name, published in zip(PROPERTY_NAMES, ASMADA_MEANS, strict=True):
        mean = means[name]
        scatter = float(np.std([c.values[name].value for c in cycles]))
        text = f"{mean.value:.5g} ({mean.lower95:.5g} .. {mean.upper95:.5g}); cycles scatter by {scatter:.2g}"
        rows.append(
            Row(
                f"hundred cycles, {name}: ASMADA {published:g}",
                "within the scatter",
                text,
                abs(mean.value - published) < scatter,
            )
        )
    rows.append(Row("hundred cycles, read: ASMADA 99 of 100", "-", f"{len(cycles)} read, {len(refused)} refused", None))
    label = f"hundred cycles, CPU time: ASMADA {ASMADA_SECONDS:g} s, without intervals, on another machine"
    return [*rows, Row(label, "-", f"{seconds:.1f} s with", None)]


def stress_rows(data: Path) -> list[Row]:
    """Compare one cycle under each stress."""
    rows = []
    for stress, published in ASMADA_BY_STRESS.items():
        columns = read_columns(data / "nasa-bigelow-nitihf" / f"{stress} MPa.txt")
        cycles, refused = analyse_cycles(f"{stress} MPa", columns[:, 0], columns[:, 1] / 100)
        if not cycles:
            rows.append(Row(f"NiTiHf, {stress} MPa", "a value or a sentence", str(refused[0]), True))
            continue
        for k, name in enumerate(TEMPERATURE_NAMES):
            value = cycles[0].values[name]
            text = f"{value.value:.1f} ({value.lower95:.1f} .. {value.upper95:.1f}) degC"
            label = f"NiTiHf, {stress} MPa, {LABELS[name]}: ASMADA"
            if published is None:
                rows.append(Row(f"{label} none", "a value or a sentence", text, bool(np.isfinite(value.value))))
            else:
                rows.append(Row(f"{label} {published[k]:g}", "-", f"{text}, {value.value - published[k]:+.1f} K", None))
    return rows


def read_columns(path: Path) -> np.ndarray:
    """Read the columns of a file without a header: temperature, strain, stress."""
    if not path.is_file():
        refuse(f"{path} is not there: give the folder of asmada-cyclic and nasa-bigelow-nitihf by --data")
    return np.loadtxt(path)


if __name__ == "__main__":
    main()
