"""A Joule-heated wire under sinusoidal strain, measured by others: fit half the runs of a workbook, predict the others.

    python experiments/measured/muscle_electric.py [--data DIR] [--workbook NAME] [--quick] [--json FILE] [--out DIR]

DIR holds a workbook; of several, --workbook names one. Each sheet is one run, named "<duty of the heating>%, <its
phase>%". The temperature was not measured, and the column of power is a nominal schedule pasted in, whose edges are
off: it is laid out anew here on the heater's own clock, whose period is that of the schedule's edges in whole
seconds. A run whose edges keep another period is left out. One constant of each run is fitted, the strain at which
the wire comes taut; for a held-out run it is set by its first cycle, and the score counts the later cycles only.

Without a temperature these data cannot decide every parameter. The Clausius-Clapeyron coefficients are held, since
temperature has no scale but theirs, and so is the modulus of austenite, which otherwise runs to its bound along a
valley where different starts end apart.
"""

from __future__ import annotations

import dataclasses
import re
import sys
from collections.abc import Sequence
from pathlib import Path

sys.path.insert(0, str(Path(__file__).resolve().parents[2]))  # the checkout: smajax, tests/reference, experiments

from experiments.common.base import (
    DATA,
    Row,
    agreement,
    arguments,
    estimate_rows,
    finish,
    from_elsewhere,
    refuse,
    say,
    workbook,
)
from experiments.common.charts import Chart, Curve, draw
from experiments.common.effect_trace import Closed, close_loop, effect_rows

import numpy as np

from smajax.diagnosis.data_split import DataSplit
from smajax.files.rig_file import parse_rig
from smajax.fitting.fit import fit
from smajax.fitting.responses import simulate_responses
from smajax.fitting.result import Response
from smajax.recordings.recording import Recording

USUAL = "Period_21.xlsx"
TRAIN = (
    "69%, -25%",
    "69%, 25%",
    "50%, 0%",
    "50%, 50%",
)  # where a workbook has these; else every second run. The last one selects.
REACH = {USUAL: (57.0, 35.0)}  # MPa of small models fitted by plain least squares, without and with effects
OFF = 0.02  # share of the period by which a schedule's edges may be off
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
max_transformation_strain = "2 %"
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
        "material.detwinning_finish_stress", "material.max_transformation_strain", "material.thermal_expansion"]
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
"material.max_transformation_strain" = ["0.2 %", "6 %"]
"material.thermal_expansion" = ["-3e-4 1/K", "3e-4 1/K"]
"wire.prestrain" = ["-1 %", "8 %"]
"""


@dataclasses.dataclass(frozen=True)
class Workbook:
    """Runs of a workbook by sheet, periods of strain and heating in s, and the runs left out with the reason."""

    runs: dict[str, Recording]
    strain_period: float
    heat_period: float
    left_out: dict[str, str]


def read_workbook(path: Path) -> Workbook:
    """Reads the sheets that are runs.

    What lies before a reset of the clock is cut, rows in which time stands still are left out.
    """
    tables = {
        name: _table(rows) for name, rows in workbook(path).items() if re.fullmatch(r"\s*[\d.]+%,\s*-?[\d.]+%\s*", name)
    }
    tables = {name: table for name, table in tables.items() if len(table) > 50}
    if len(tables) < 4:
        refuse(f'{path} has {len(tables)} sheets of runs, named as "69%, -25%": at least four are needed')
    spacing = {name: _spacing(table) for name, table in tables.items()}
    heat_period = float(np.round(np.nanmedian(list(spacing.values()))))
    if not heat_period > 0:
        refuse(f"{path}: column I holds no power that goes on and off, so the heater's period is not known")
    left_out = {
        name: f"its power comes on every {each:.1f} s"
        for name, each in spacing.items()
        if not abs(each / heat_period - 1) < OFF
    }
    strain_period = float(np.median([_sine(table[:, 0], table[:, 1], heat_period) for table in tables.values()]))
    runs = {}
    for name, table in tables.items():
        if name not in left_out:
            power = float(np.nanmax(table[:, 3])) * heating(name, table[:, 0], heat_period)
            channels = {"power": power, "strain": table[:, 1] / 100, "stress": table[:, 2] * 1e6}
            runs[name] = Recording.from_arrays(
                name, table[:, 0], channels, {"power": "W", "strain": "%", "stress": "MPa"}
            )
    return Workbook(runs, strain_period, heat_period, left_out)


def heating(run: str, time: np.ndarray, period: float) -> np.ndarray:
    """Share of each sample's interval in which a run is heated, from its name."""
    duty, phase = (float(part.strip(" %")) / 100 for part in run.split(","))
    ends = np.append(time, time[-1] + np.median(np.diff(time)))
    fine = ends[:-1, None] + np.diff(ends)[:, None] * (np.arange(20) + 0.5) / 20
    turn = (fine - period * (0.25 + phase)) / period
    return np.mean(turn - np.floor(turn) < duty, axis=1)


def _table(rows: list[tuple]) -> np.ndarray:
    """Time (s), strain (%), stress (MPa) and nominal power of a sheet's rows: columns B, D, G and I, from row 6 on."""
    cells = [
        [row[i] if isinstance(row[i], int | float) else np.nan for i in (1, 3, 6, 8)]
        for row in rows[5:]
        if len(row) > 8
    ]
    table = np.array(cells, float).reshape(-1, 4)
    table = table[np.all(np.isfinite(table[:, :3]), axis=1)]
    resets = np.flatnonzero(np.diff(table[:, 0]) < 0)
    table = table[resets[-1] + 1 :] if len(resets) else table
    return table[np.append(True, np.diff(table[:, 0]) > 0)] if len(table) else table


def _spacing(table: np.ndarray) -> float:
    """Mean time from one switching on of the nominal power to the next, s; NaN with fewer than two."""
    on = np.nan_to_num(table[:, 3]) > 0
    edges = table[1:, 0][on[1:] & ~on[:-1]]
    return float(np.mean(np.diff(edges))) if len(edges) > 1 else np.nan


def _sine(time: np.ndarray, strain: np.ndarray, near: float) -> float:
    """The period of the sine that fits the strain best, within a tenth of ``near``, s."""

    def left(period: float) -> float:
        turn = 2 * np.pi * time / period
        columns = np.column_stack([np.sin(turn), np.cos(turn), np.ones_like(turn)])
        return float(np.sum((columns @ np.linalg.lstsq(columns, strain, rcond=None)[0] - strain) ** 2))

    return min(np.linspace(0.9 * near, 1.1 * near, 401), key=left)


def late(response: Response, period: float) -> np.ndarray:
    """Residual in MPa from the second cycle of strain on."""
    return response.residual("stress")[response.recording.time >= period] / 1e6


def repeated(recording: Recording, period: float) -> np.ndarray:
    """Residual in MPa, from the second cycle on, of the naive forecast: the first cycle again and again."""
    time, stress = recording.time, recording.channels["stress"] / 1e6
    later = time >= period
    again = np.interp(time[later] % period, time[~later], stress[~later])
    return stress[later] - again


def traced(train: list[Recording], held: list[Recording], period: float) -> Closed:
    """The loop closed.

    Effects are searched for on all runs fitted but the last, which selects; then all of them are fitted again.
    """

    def part(runs: list[Recording]) -> DataSplit:
        first = [r.time < period for r in runs]
        return DataSplit(tuple(runs), tuple(~f for f in first), tuple(first))

    parts = [DataSplit(tuple(train[:-1])), part(train[-1:]), part(held)]
    return close_loop(parse_rig(RIG, "muscle.toml"), parts, DataSplit(tuple(train)), say, starts=6, step=0.11)


def chosen_workbook(folder: Path, name: str | None) -> Path:
    """The workbook that is named, or the usual one, or the only one of a folder. Refuses what leaves a choice open."""
    found = sorted(p.name for p in folder.glob("*.xlsx") if not p.name.startswith("~"))
    name = name or (USUAL if USUAL in found else found[0] if len(found) == 1 else None)
    if name not in found:
        there = f"it holds {', '.join(found)}" if found else "it holds no .xlsx file"
        refuse(
            f"{folder / (name or '*.xlsx')}: no workbook, or no choice of one; {there}: give the folder by "
            "--data, the name by --workbook"
        )
    return folder / name


def score_rows(role: str, group: Sequence[Response], period: float, target_mpa: float | None) -> list[Row]:
    """RMSE of each response from the second cycle on, and of all together.

    Args:
        role: "train" or "held out".
        group: Responses of a fit.
        period: Period of the strain, s.
        target_mpa: What all together should reach, MPa.
    """
    rows = []
    for response in group:
        rmse = float(np.sqrt(np.mean(late(response, period) ** 2)))
        rows.append(
            Row(
                f"{role}: {response.recording.name}, cycles from the second on",
                "-",
                f"{rmse:.1f} MPa",
                None,
                {"rmse_MPa": rmse},
            )
        )
    pooled = float(np.sqrt(np.mean(np.concatenate([late(r, period) for r in group]) ** 2)))
    goal = _goal(target_mpa, pooled)
    rows.append(Row(f"{role}: all together", goal[0], f"{pooled:.1f} MPa", goal[1], {"rmse_MPa": pooled}))
    return rows


def pictures(responses: Sequence[Response], folder: Path) -> None:
    """Draw the measured and the modelled stress of each response."""
    for response in responses:
        time, measured = response.recording.time, response.recording.channels["stress"] / 1e6
        curves = [
            Curve("measured", time, measured),
            Curve("model", time, response.model["stress"] / 1e6, dashed=True),
        ]
        name = response.recording.name.replace("%", "").replace(", ", "_").replace("-", "minus")
        draw(
            Chart(f"{response.recording.name} ({response.role})", "time [s]", "stress [MPa]", curves),
            folder,
            f"measured_muscle_{name}",
        )


def main() -> None:
    """Prints the table."""
    quick = "four starts, sixty steps, and no search for effects"
    args = arguments(__doc__, data="tamu-muscle-electric", quick=quick, more={"--workbook": {"metavar": "NAME"}})
    path = chosen_workbook(args.data, args.workbook)
    book = read_workbook(path)
    runs, period = book.runs, book.strain_period
    names = TRAIN if all(name in runs for name in TRAIN) else tuple(runs)[::2]
    if len(runs) < 4:
        refuse(f"{path} has {len(runs)} runs with the schedule's period: at least four are needed")
    rig = parse_rig(RIG, "muscle.toml")
    settings = dataclasses.replace(rig.fit, starts=4) if args.quick else rig.fit
    train, held = [runs[n] for n in names], [r for n, r in runs.items() if n not in names]
    base_mpa, reach_mpa = REACH.get(path.name, (None, None))
    say(f"fitting {len(train)} runs from {settings.starts} starts")
    fits = from_elsewhere(rig, train, settings, 1 if args.quick else 10, step=0.11, max_steps=60 if args.quick else 200)
    result = fits[0]
    say("setting the constants of the held-out runs by their first cycles")
    first = [r.slice(0.0, period) for r in held]
    tuned = fit(result.plant, first, dataclasses.replace(rig.fit, free=(), starts=1), step=0.11)
    responses, _ = simulate_responses(tuned.plants, held, ["holdout"] * len(held), ("stress",), "hold", 0.11)
    rows = [
        Row("runs fitted, the last one selecting", "-", "; ".join(names), None),
        Row("period of the strain, of the heating", "-", f"{period:.2f} s, {book.heat_period:.0f} s", None),
        *(Row(f"left out: {name}", "-", why, None) for name, why in book.left_out.items()),
    ]
    rows += score_rows("train", result.responses, period, None)
    rows += score_rows("held out", responses, period, base_mpa)
    naive = float(np.sqrt(np.mean(np.concatenate([repeated(r, period) for r in held]) ** 2)))
    rows.append(Row("held out: each run's first cycle repeated", "-", f"{naive:.1f} MPa", None, {"rmse_MPa": naive}))
    if not args.quick:
        say("tracing the residual")
        closed = traced(train, held, period)
        _, _, fitted, predicted = (v / 1e6 for v in closed.rmse("stress"))
        what = f"held out, with {' + '.join(closed.refit.hypothesis.keys) or 'no effect'}: all together"
        reached = {"train_MPa": fitted, "rmse_MPa": predicted}
        goal = _goal(reach_mpa, predicted)
        rows.append(Row(what, goal[0], f"{predicted:.1f} MPa ({fitted:.1f} fitted)", goal[1], reached))
        rows += effect_rows(closed, f"{names[-1]} selecting: ")
    rows.append(agreement(fits))
    rows += estimate_rows(result)
    if args.out:
        pictures((*result.responses, *responses), args.out)
    usual = (args.data, path.name) == (DATA / "tamu-muscle-electric", USUAL)
    finish(
        rows,
        args,
        words="" if usual else f" --data {args.data.resolve().name} --workbook {path.name}",
    )


def _goal(figure: float | None, reached: float) -> tuple[str, bool | None]:
    return ("-", None) if figure is None else (f"<= {figure:.0f} MPa", reached <= figure)


if __name__ == "__main__":
    main()
