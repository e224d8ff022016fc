"""One thermal cycle of a wire at several constant stresses, measured by others: fit all levels but one, predict that one.

    python experiments/measured_isobaric.py [--data DIR] [--holdout MPA | --each] [--quick] [--json FILE] [--out DIR]

DIR holds one text file a level, ``...MPa.txt``, with columns temperature (degC), strain (fraction, or percent: told apart by size) and
stress (MPa). The stress is that of the file's name, since the column is the noisy measured one. Strain was zeroed by those who recorded
it, so each level has an offset; that of the held-out level is the one with which the model meets its hottest row, where the recording was
zeroed.
"""

from __future__ import annotations

import argparse
import dataclasses
import re
import sys
from pathlib import Path

import numpy as np
from _common import ROOT, Row, agreement, finish, from_elsewhere, say
from _figures import Chart, Curve, draw

from smajax import parameters
from smajax.fit.fit import Fit, respond
from smajax.recording import Recording
from smajax.rig import parse_rig

RIG = """
schema = 1
[rig]
kind = "path"
[material]
martensite_start = "60 degC"
martensite_finish = "0 degC"
austenite_start = "70 degC"
austenite_finish = "95 degC"
clausius_clapeyron_austenite = "8 MPa/K"
clausius_clapeyron_martensite = "7.5 MPa/K"
modulus_austenite = "60 GPa"
modulus_martensite = "30 GPa"
detwinning_start_stress = "0 MPa"
detwinning_finish_stress = "110 MPa"
max_strain = "4.3 %"
[fit]
free = ["material.martensite_start", "material.austenite_start", "material.austenite_finish", "material.clausius_clapeyron_austenite",
        "material.clausius_clapeyron_martensite", "material.modulus_martensite",
        "material.detwinning_finish_stress", "material.max_strain", "material.thermal_expansion_austenite",
        "material.thermal_expansion_martensite"]
per_recording = ["sensor.strain_offset"]
observe = ["strain"]
noise = { strain = "0.1 %" }
starts = 10
[fit.bounds]
"material.austenite_start" = ["20 degC", "78 degC"]
"material.austenite_finish" = ["78 degC", "160 degC"]
"material.martensite_start" = ["1 degC", "130 degC"]
"material.detwinning_finish_stress" = ["5 MPa", "400 MPa"]
"material.modulus_martensite" = ["5 GPa", "200 GPa"]
"material.clausius_clapeyron_austenite" = ["4 MPa/K", "16 MPa/K"]
"material.clausius_clapeyron_martensite" = ["4 MPa/K", "16 MPa/K"]
"material.max_strain" = ["1.5 %", "7 %"]
"material.thermal_expansion_austenite" = ["-3e-4 1/K", "3e-4 1/K"]
"material.thermal_expansion_martensite" = ["-3e-4 1/K", "3e-4 1/K"]
"""
BASE_PERCENT = 0.20  # small cosine model fitted by plain least squares to the Flexinol levels, held out at 150 MPa


def read_levels(folder: Path) -> dict[int, Recording]:
    """The recordings of a folder by stress in MPa."""
    levels = {}
    for path in sorted(folder.glob("*MPa.txt")):
        found = re.search(r"(\d+)\s*MPa", path.name)
        if not found:
            continue
        columns = np.loadtxt(path, ndmin=2)
        if columns.shape[1] < 2 or len(columns) < 20:
            sys.exit(f"{path}: {columns.shape[1]} columns and {len(columns)} rows: temperature, strain and stress are needed")
        strain = columns[:, 1] / (100.0 if np.ptp(columns[:, 1]) > 0.3 else 1.0)
        stress = np.full(len(columns), int(found[1]) * 1e6)
        channels = {"temperature": columns[:, 0], "stress": stress, "strain": strain}
        levels[int(found[1])] = Recording.from_arrays(path.name, None, channels, {"temperature": "degC", "stress": "MPa", "strain": "%"})
    return dict(sorted(levels.items()))


def hold_out(levels: dict[int, Recording], level: int, times: int) -> tuple[list[Fit], np.ndarray]:
    """The fits to all other levels from ``times`` start points, best first, and the best one's residual at ``level`` (fraction)."""
    rig = parse_rig(RIG, "isobaric.toml")
    fits = from_elsewhere(rig, [r for k, r in levels.items() if k != level], rig.fit, times, max_steps=200)
    result = fits[0]
    plant = parameters.replace(result.plant, {"sensor.strain_offset": 0.0})
    response = respond([plant], [levels[level]], ["holdout"], ("strain",), "hold", None)[0][0]
    hottest = int(np.argmax(levels[level].channels["temperature"]))
    residual = response.residual("strain")
    return fits, residual - residual[hottest]


def main() -> None:
    """Prints the table."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--data", type=Path, default=ROOT.parent / "shared" / "data" / "tamu-flexinol-isobaric")
    parser.add_argument("--holdout", type=int, default=150, metavar="MPA")
    parser.add_argument("--each", action="store_true", help="hold out each level in turn")
    parser.add_argument("--quick", action="store_true", help="one level only, whatever --each says")
    parser.add_argument("--json", type=Path, metavar="FILE")
    parser.add_argument("--out", type=Path, metavar="DIR")
    args = parser.parse_args()
    if not args.data.is_dir():
        print(f"{args.data} is no folder: give one with ...MPa.txt files by --data", file=sys.stderr)
        sys.exit(2)
    levels = read_levels(args.data)
    if args.holdout not in levels or len(levels) < 3:
        print(
            f"{args.data} has the levels {', '.join(map(str, levels)) or 'none'} MPa: --holdout needs one of at least three",
            file=sys.stderr,
        )
        sys.exit(2)
    rows = []
    for level in [args.holdout] if args.quick or not args.each else list(levels):
        say(f"holding out {level} MPa")
        fits, residual = hold_out(levels, level, 3 if args.quick else 10)
        result = fits[0]
        train, held = 100 * (result.rmse("strain") or np.nan), 100 * float(np.sqrt(np.mean(residual**2)))
        known = level == 150 and args.data.name == "tamu-flexinol-isobaric"
        rows.append(
            Row(
                f"{level} MPa held out: RMSE train / held out",
                f"<= {BASE_PERCENT} % held out" if known else "-",
                f"{train:.3f} % / {held:.3f} %",
                held <= BASE_PERCENT if known else None,
                {"train_percent": train, "held_percent": held},
            )
        )
        same = agreement(fits)
        rows.append(dataclasses.replace(same, what=f"{level} MPa held out: {same.what}"))
        for estimate in result.estimates:
            if "@" not in estimate.name:
                ends = (
                    "held at its bound"
                    if estimate.at_bound
                    else f"{estimate.lower95:.5g} .. {estimate.upper95:.5g}"
                    if estimate.lower95
                    else "-"
                )
                rows.append(Row(f"{level} MPa held out: {estimate.name}", "-", f"{estimate.estimate:.5g} {estimate.unit} ({ends})", None))
        for group in result.indistinct:
            what = f"{', '.join(group.parameters)} together leave {100 * group.shrink:.1f} % of their effect"
            rows.append(Row(f"{level} MPa held out: cannot be told apart", "-", what, None))
        temperature = levels[level].channels["temperature"]
        warm = temperature > np.median(temperature)
        heating = np.arange(len(temperature)) <= np.argmax(temperature)
        parts = {
            "heating, warmer half": heating & warm, "heating, colder half": heating & ~warm,
            "cooling, warmer half": ~heating & warm, "cooling, colder half": ~heating & ~warm,
        }  # fmt: skip
        shares = {k: float(np.sum(residual[m] ** 2) / np.sum(residual**2)) for k, m in parts.items() if np.any(m)}
        lives = ", ".join(f"{100 * v:.0f} % {k}" for k, v in sorted(shares.items(), key=lambda kv: -kv[1]))
        rows.append(Row(f"{level} MPa held out: where the residual lives", "-", lives, None, shares))
        if args.out:
            args.out.mkdir(parents=True, exist_ok=True)
            measured = 100 * levels[level].channels["strain"]
            curves = [Curve("measured", temperature, measured), Curve("model", temperature, measured - 100 * residual, dashed=True)]
            draw(Chart(f"{level} MPa, held out", "temperature [degC]", "strain [%]", curves), args.out, f"measured_isobaric_{level}")
            lines = [Curve(f"{level} MPa", np.arange(len(residual)), 100 * residual)]
            draw(Chart("Held-out residual", "row", "measured - model [%]", lines), args.out, f"measured_isobaric_{level}_residual")
    finish("measured_isobaric", rows, args)


if __name__ == "__main__":
    main()
