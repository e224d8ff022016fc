"""A Joule-heated wire under sinusoidal strain, measured by others: fit four runs of a workbook, predict the other four.

    python experiments/measured_muscle_electric.py [--data DIR] [--workbook NAME] [--quick] [--json FILE] [--out DIR]

Each sheet is one run, named "<duty of the heating>%, <its phase>%". The temperature was not measured, and the column of power is a
nominal schedule: it is laid out anew here on the heater's own clock of 21.0 s a period. One constant of each run is fitted, the strain at
which the wire comes taut; for a held-out run it is set by its first cycle, and the score counts the later cycles only.

Without a temperature these data cannot decide every parameter. The Clausius-Clapeyron coefficients are held, since temperature has no scale
but theirs, and so is the modulus of austenite, which otherwise runs to its bound along a valley where different starts end apart.
"""

from __future__ import annotations

import argparse
import dataclasses
import sys
import warnings
from pathlib import Path

import numpy as np
from _common import ROOT, Row, agreement, finish, from_elsewhere, say
from _figures import Chart, Curve, draw
from _trace import Closed, close_loop, effect_rows

from smajax.diagnose.bench import Part
from smajax.fit.fit import Response, fit, respond
from smajax.recording import Recording
from smajax.rig import parse_rig

TRAIN = ("69%, -25%", "69%, 25%", "50%, 0%", "50%, 50%")
STRAIN_PERIOD, HEAT_PERIOD, POWER = 21.18, 21.0, 2.08
SELECT = "50%, 50%"
BASE_MPA, REACH_MPA = 57.0, 35.0  # small models fitted by plain least squares, without and with effects
RIG = """
schema = 1
[rig]
kind = "testing-machine"
control = "power"
interpolation = "hold"
[drive]
gain = "0.6"
[material]
martensite_start = "45 degC"
martensite_finish = "15 degC"
austenite_start = "35 degC"
austenite_finish = "75 degC"
clausius_clapeyron_austenite = "7 MPa/K"
clausius_clapeyron_martensite = "7 MPa/K"
modulus_austenite = "35 GPa"
modulus_martensite = "30 GPa"
detwinning_start_stress = "40 MPa"
detwinning_finish_stress = "150 MPa"
max_strain = "2 %"
[heat]
h0 = "160 W/m^2/K"
capacity = "3 MJ/m^3/K"
[wire]
diameter = "0.4 mm"
length = "100 mm"
prestrain = "1 %"
[environment]
ambient = "25 degC"
[fit]
free = ["drive.gain", "heat.h0", "material.martensite_start", "material.martensite_finish", "material.austenite_start",
        "material.austenite_finish", "material.modulus_martensite", "material.detwinning_start_stress",
        "material.detwinning_finish_stress", "material.max_strain", "material.thermal_expansion"]
per_recording = ["wire.prestrain"]
observe = ["stress"]
noise = { stress = "30 MPa" }
starts = 10
[fit.bounds]
"drive.gain" = ["0.05", "5"]
"heat.h0" = ["30 W/m^2/K", "600 W/m^2/K"]
"material.martensite_start" = ["30 degC", "200 degC"]
"material.martensite_finish" = ["-100 degC", "30 degC"]
"material.austenite_start" = ["-75 degC", "50 degC"]
"material.austenite_finish" = ["50 degC", "300 degC"]
"material.modulus_martensite" = ["15 GPa", "80 GPa"]
"material.detwinning_start_stress" = ["0 MPa", "80 MPa"]
"material.detwinning_finish_stress" = ["80 MPa", "500 MPa"]
"material.max_strain" = ["0.2 %", "6 %"]
"material.thermal_expansion" = ["-3e-4 1/K", "3e-4 1/K"]
"wire.prestrain" = ["-1 %", "8 %"]
"""


def heating(run: str, time: np.ndarray) -> np.ndarray:
    """Nominal power of a run from its name, W, as the mean over each sample's interval."""
    duty, phase = (float(part.strip(" %")) / 100 for part in run.split(","))
    ends = np.append(time, time[-1] + 0.1)
    fine = ends[:-1, None] + np.diff(ends)[:, None] * (np.arange(20) + 0.5) / 20
    turn = (fine - HEAT_PERIOD * (0.25 + phase)) / HEAT_PERIOD
    return POWER * np.mean(turn - np.floor(turn) < duty, axis=1)


def read_runs(path: Path) -> dict[str, Recording]:
    """The runs of a workbook by sheet; what lies before a reset of the clock is cut, rows in which time stands still are left out."""
    try:
        import openpyxl
    except ImportError:
        sys.exit('reading a workbook needs openpyxl: pip install "smajax[io]"')
    with warnings.catch_warnings():
        warnings.filterwarnings("ignore", message="Unknown extension")
        book = openpyxl.load_workbook(path, read_only=True, data_only=True)
        sheets = {name: list(book[name].iter_rows(values_only=True)) for name in book.sheetnames if "%" in name}
    runs = {}
    for name, rows in sheets.items():
        cells = [[row[1], row[3], row[6]] for row in rows[6:] if len(row) > 6]
        table = np.array([c for c in cells if all(isinstance(v, int | float) for v in c)], float)
        resets = np.flatnonzero(np.diff(table[:, 0]) < 0)
        table = table[resets[-1] + 1 :] if len(resets) else table
        table = table[np.append(True, np.diff(table[:, 0]) > 0)]
        channels = {"power": heating(name, table[:, 0]), "strain": table[:, 1] / 100, "stress": table[:, 2] * 1e6}
        runs[name] = Recording.from_arrays(name, table[:, 0], channels, {"power": "W", "strain": "%", "stress": "MPa"})
    return runs


def late(response: Response) -> np.ndarray:
    """Residual in MPa from the second cycle on."""
    return response.residual("stress")[response.recording.time >= STRAIN_PERIOD] / 1e6


def traced(train: list[Recording], held: list[Recording]) -> Closed:
    """The loop closed: effects are searched for on all runs fitted but one, which selects; then all of them are fitted again."""

    def part(runs: list[Recording]) -> Part:
        first = [r.time < STRAIN_PERIOD for r in runs]
        return Part(tuple(runs), tuple(~f for f in first), tuple(first))

    parts = [Part(tuple(r for r in train if r.name != SELECT)), part([r for r in train if r.name == SELECT]), part(held)]
    return close_loop(parse_rig(RIG, "muscle.toml"), parts, Part(tuple(train)), say, starts=6, step=0.11)


def main() -> None:
    """Prints the table."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--data", type=Path, default=ROOT.parent / "shared" / "data" / "tamu-muscle-electric")
    parser.add_argument("--workbook", default="Period_21.xlsx")
    parser.add_argument("--quick", action="store_true", help="four starts, sixty steps, and no search for effects")
    parser.add_argument("--json", type=Path, metavar="FILE")
    parser.add_argument("--out", type=Path, metavar="DIR")
    args = parser.parse_args()
    path = args.data / args.workbook
    if not path.is_file():
        print(f"{path} is no file: give the folder of the workbook by --data and its name by --workbook", file=sys.stderr)
        sys.exit(2)
    runs = read_runs(path)
    missing = [name for name in TRAIN if name not in runs]
    if missing:
        print(f"{path} has no sheet '{missing[0]}'; it has {', '.join(runs)}", file=sys.stderr)
        sys.exit(2)
    rig = parse_rig(RIG, "muscle.toml")
    settings = dataclasses.replace(rig.fit, starts=4) if args.quick else rig.fit
    train, held = [runs[n] for n in TRAIN], [r for n, r in runs.items() if n not in TRAIN]
    say(f"fitting {len(train)} runs from {settings.starts} starts")
    fits = from_elsewhere(rig, train, settings, 1 if args.quick else 10, step=0.11, max_steps=60 if args.quick else 200)
    result = fits[0]
    say("setting the constants of the held-out runs by their first cycles")
    first = [r.slice(0.0, STRAIN_PERIOD) for r in held]
    tuned = fit(result.plant, first, dataclasses.replace(rig.fit, free=(), starts=1), step=0.11)
    responses, _ = respond(tuned.plants, held, ["holdout"] * len(held), ("stress",), "hold", 0.11)
    rows = []
    for role, group in (("train", result.responses), ("held out", responses)):
        for response in group:
            rmse = float(np.sqrt(np.mean(late(response) ** 2)))
            rows.append(
                Row(f"{role}: {response.recording.name}, cycles from the second on", "-", f"{rmse:.1f} MPa", None, {"rmse_MPa": rmse})
            )
        pooled = float(np.sqrt(np.mean(np.concatenate([late(r) for r in group]) ** 2)))
        target, met = (f"<= {BASE_MPA:.0f} MPa", pooled <= BASE_MPA) if role == "held out" else ("-", None)
        rows.append(Row(f"{role}: all together", target, f"{pooled:.1f} MPa", met, {"rmse_MPa": pooled}))
    if not args.quick:
        say("tracing the residual")
        closed = traced(train, held)
        _, _, fitted, predicted = (v / 1e6 for v in closed.rmse("stress"))
        what = f"held out, with {' + '.join(closed.refit.hypothesis.keys) or 'no effect'}: all together"
        reached = {"train_MPa": fitted, "rmse_MPa": predicted}
        rows.append(Row(what, f"<= {REACH_MPA:.0f} MPa", f"{predicted:.1f} MPa ({fitted:.1f} fitted)", predicted <= REACH_MPA, reached))
        rows += effect_rows(closed, f"{SELECT} selecting: ")
    rows.append(agreement(fits))
    for estimate in result.estimates:
        ends = (
            "held at its bound"
            if estimate.at_bound
            else f"{estimate.lower95:.5g} .. {estimate.upper95:.5g}"
            if estimate.lower95 is not None
            else "-"
        )
        rows.append(Row(estimate.name, "-", f"{estimate.estimate:.5g} {estimate.unit} ({ends})", None))
    for group in result.indistinct:
        rows.append(
            Row(
                "cannot be told apart",
                "-",
                f"{', '.join(group.parameters)} together leave {100 * group.shrink:.1f} % of their effect",
                None,
            )
        )
    if args.out:
        args.out.mkdir(parents=True, exist_ok=True)
        for response in (*result.responses, *responses):
            time, measured = response.recording.time, response.recording.channels["stress"] / 1e6
            curves = [Curve("measured", time, measured), Curve("model", time, response.model["stress"] / 1e6, dashed=True)]
            name = response.recording.name.replace("%", "").replace(", ", "_").replace("-", "minus")
            draw(
                Chart(f"{response.recording.name} ({response.role})", "time [s]", "stress [MPa]", curves),
                args.out,
                f"measured_muscle_{name}",
            )
    finish("measured_muscle_electric", rows, args)


if __name__ == "__main__":
    main()
