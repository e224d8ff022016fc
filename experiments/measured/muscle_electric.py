"""A Joule-heated wire under sinusoidal strain, measured by others: fit half the runs of a workbook, predict the others.

    python experiments/measured/muscle_electric.py [--data DIR] [--workbook NAME] [--quick] [--json FILE] [--out DIR]

DIR holds a workbook; ``--workbook`` names one of several. Each sheet is one run, named "<duty of the heating>%, <its
phase>%". The temperature was not measured, and the column of power is a nominal schedule whose edges are off: it is
rebuilt here on the heater's own clock, whose period is that of the schedule's edges in whole seconds. A run whose edges
have another period is left out. One constant of each run is fitted, the strain at which the wire becomes taut; for a
held-out run it is fitted to the first cycle, and the score counts the later cycles only.

Without a temperature these data cannot determine every parameter. The Clausius-Clapeyron coefficients are fixed, since
they set the scale of the temperature. The modulus of austenite is fixed as well: otherwise it runs to its bound along a
valley in which different starts end at different points.
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
    fit_from_starts,
    refuse,
    say,
    workbook,
)
from experiments.common.charts import Chart, Curve, draw
from experiments.common.effect_trace import TraceResult, effect_rows, trace_effects

import numpy as np

from smajax.diagnosis.data_split import DataSplit
from smajax.files.rig_file import parse_rig
from smajax.fitting.fit import fit
from smajax.fitting.responses import simulate_responses
from smajax.fitting.result import Response
from smajax.recordings.recording import Recording

USUAL = "Period_21.xlsx"
# Fitted runs where a workbook has these, else every second run; the last one selects.
TRAIN = (
    "69%, -25%",
    "69%, 25%",
    "50%, 0%",
    "50%, 50%",
)
TARGETS = {USUAL: (57.0, 35.0)}  # MPa, of small least-squares models, without and with effects
MAX_PERIOD_DEVIATION = 0.02  # relative deviation of a run's switching period from the heater's
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
    """The runs of a workbook.

    Attributes:
        runs: Recordings by sheet.
        strain_period: Period of the strain, s.
        heat_period: Period of the heating, s.
        left_out: Reason by run that is left out.
    """

    runs: dict[str, Recording]
    strain_period: float
    heat_period: float
    left_out: dict[str, str]


def read_workbook(path: Path) -> Workbook:
    """Read the sheets that are runs.

    Rows before a reset of the clock are cut, and rows in which time does not advance.
    """
    tables = {
        name: _table(rows) for name, rows in workbook(path).items() if re.fullmatch(r"\s*[\d.]+%,\s*-?[\d.]+%\s*", name)
    }
    tables = {name: table for name, table in tables.items() if len(table) > 50}
    if len(tables) < 4:
        refuse(f'{path} has {len(tables)} sheets of runs, named as "69%, -25%": at least four are needed')
    switching = {name: _switching_period(table) for name, table in tables.items()}
    heat_period = float(np.round(np.nanmedian(list(switching.values()))))
    if not heat_period > 0:
        refuse(f"{path}: column I holds no power that goes on and off, so the heater's period is not known")
    left_out = {
        name: f"its power comes on every {spacing:.1f} s"
        for name, spacing in switching.items()
        if not abs(spacing / heat_period - 1) < MAX_PERIOD_DEVIATION
    }
    strain_period = float(
        np.median([_strain_period(table[:, 0], table[:, 1], heat_period) for table in tables.values()])
    )
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
    """Return the share of each sample's interval in which a run is heated, from its name.

    Args:
        run: Name of the run.
        time: Times, s, shape ``(n,)``.
        period: Period of the heating, s.
    """
    duty, phase = (float(part.strip(" %")) / 100 for part in run.split(","))
    ends = np.append(time, time[-1] + np.median(np.diff(time)))
    fine = ends[:-1, None] + np.diff(ends)[:, None] * (np.arange(20) + 0.5) / 20
    turns = (fine - period * (0.25 + phase)) / period
    return np.mean(turns - np.floor(turns) < duty, axis=1)


def _table(rows: list[tuple]) -> np.ndarray:
    """Return time (s), strain (%), stress (MPa) and nominal power of a sheet: columns B, D, G and I, from row 6 on."""
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


def _switching_period(table: np.ndarray) -> float:
    """Return the mean time from one switching on of the nominal power to the next, s; NaN with fewer than two."""
    on = np.nan_to_num(table[:, 3]) > 0
    edges = table[1:, 0][on[1:] & ~on[:-1]]
    return float(np.mean(np.diff(edges))) if len(edges) > 1 else np.nan


def _strain_period(time: np.ndarray, strain: np.ndarray, nominal: float) -> float:
    """Return the period in s of the sine that fits the strain best, within a tenth of ``nominal``."""

    def squared_error(period: float) -> float:
        turn = 2 * np.pi * time / period
        columns = np.column_stack([np.sin(turn), np.cos(turn), np.ones_like(turn)])
        return float(np.sum((columns @ np.linalg.lstsq(columns, strain, rcond=None)[0] - strain) ** 2))

    return min(np.linspace(0.9 * nominal, 1.1 * nominal, 401), key=squared_error)


def later_residual(response: Response, period: float) -> np.ndarray:
    """Return the residual in MPa from the second cycle of strain on."""
    return response.residual("stress")[response.recording.time >= period] / 1e6


def repeat_first_cycle(recording: Recording, period: float) -> np.ndarray:
    """Return the residual in MPa, from the second cycle on, of the naive forecast that the first cycle is repeated."""
    time, stress = recording.time, recording.channels["stress"] / 1e6
    later = time >= period
    forecast = np.interp(time[later] % period, time[~later], stress[~later])
    return stress[later] - forecast


def trace_residual(train: list[Recording], held_out: list[Recording], period: float) -> TraceResult:
    """Select effects on all fitted runs but the last, which selects; then fit all of them again.

    Args:
        train: The fitted runs.
        held_out: The held-out runs.
        period: Period of the strain, s.
    """

    def part(runs: list[Recording]) -> DataSplit:
        first_cycles = [r.time < period for r in runs]
        return DataSplit(tuple(runs), tuple(~f for f in first_cycles), tuple(first_cycles))

    parts = [DataSplit(tuple(train[:-1])), part(train[-1:]), part(held_out)]
    return trace_effects(parse_rig(RIG, "muscle.toml"), parts, DataSplit(tuple(train)), say, starts=6, step=0.11)


def choose_workbook(folder: Path, name: str | None) -> Path:
    """Return the workbook that is named, else the usual one, else the only one of a folder.

    Exit where that leaves a choice.
    """
    names = sorted(p.name for p in folder.glob("*.xlsx") if not p.name.startswith("~"))
    name = name or (USUAL if USUAL in names else names[0] if len(names) == 1 else None)
    if name not in names:
        listing = f"it holds {', '.join(names)}" if names else "it holds no .xlsx file"
        refuse(
            f"{folder / (name or '*.xlsx')}: no workbook, or no choice of one; {listing}: give the folder by "
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
        rmse = float(np.sqrt(np.mean(later_residual(response, period) ** 2)))
        rows.append(
            Row(
                f"{role}: {response.recording.name}, cycles from the second on",
                "-",
                f"{rmse:.1f} MPa",
                None,
                {"rmse_MPa": rmse},
            )
        )
    pooled = float(np.sqrt(np.mean(np.concatenate([later_residual(r, period) for r in group]) ** 2)))
    target_and_verdict = _target_and_verdict(target_mpa, pooled)
    rows.append(
        Row(
            f"{role}: all together",
            target_and_verdict[0],
            f"{pooled:.1f} MPa",
            target_and_verdict[1],
            {"rmse_MPa": pooled},
        )
    )
    return rows


def traced_row(traced: TraceResult, target_mpa: float | None) -> Row:
    """Return the RMSE of the held-out runs with the selected effects, MPa."""
    _, _, fitted, predicted = (v / 1e6 for v in traced.rmse("stress"))
    label = f"held out, with {' + '.join(traced.refit.effect_set.keys) or 'no effect'}: all together"
    numbers = {"train_MPa": fitted, "rmse_MPa": predicted}
    target, is_met = _target_and_verdict(target_mpa, predicted)
    return Row(label, target, f"{predicted:.1f} MPa ({fitted:.1f} fitted)", is_met, numbers)


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
    """Print the table."""
    quick = "four starts, sixty steps, and no search for effects"
    args = arguments(__doc__, data="tamu-muscle-electric", quick=quick, more={"--workbook": {"metavar": "NAME"}})
    path = choose_workbook(args.data, args.workbook)
    book = read_workbook(path)
    runs, period = book.runs, book.strain_period
    names = TRAIN if all(name in runs for name in TRAIN) else tuple(runs)[::2]
    if len(runs) < 4:
        refuse(f"{path} has {len(runs)} runs with the schedule's period: at least four are needed")
    rig = parse_rig(RIG, "muscle.toml")
    settings = dataclasses.replace(rig.fit, starts=4) if args.quick else rig.fit
    train = [runs[n] for n in names]
    held_out = [r for n, r in runs.items() if n not in names]
    base_mpa, reach_mpa = TARGETS.get(path.name, (None, None))
    say(f"fitting {len(train)} runs from {settings.starts} starts")
    fits = fit_from_starts(
        rig, train, settings, 1 if args.quick else 10, step=0.11, max_steps=60 if args.quick else 200
    )
    result = fits[0]
    say("setting the constants of the held-out runs by their first cycles")
    first_cycles = [r.slice(0.0, period) for r in held_out]
    first_cycle_fit = fit(result.plant, first_cycles, dataclasses.replace(rig.fit, free=(), starts=1), step=0.11)
    responses, _ = simulate_responses(
        first_cycle_fit.plants, held_out, ["holdout"] * len(held_out), ("stress",), "hold", 0.11
    )
    rows = [
        Row("runs fitted, the last one selecting", "-", "; ".join(names), None),
        Row("period of the strain, of the heating", "-", f"{period:.2f} s, {book.heat_period:.0f} s", None),
        *(Row(f"left out: {name}", "-", reason, None) for name, reason in book.left_out.items()),
    ]
    rows += score_rows("train", result.responses, period, None)
    rows += score_rows("held out", responses, period, base_mpa)
    naive = float(np.sqrt(np.mean(np.concatenate([repeat_first_cycle(r, period) for r in held_out]) ** 2)))
    rows.append(Row("held out: each run's first cycle repeated", "-", f"{naive:.1f} MPa", None, {"rmse_MPa": naive}))
    if not args.quick:
        say("tracing the residual")
        traced = trace_residual(train, held_out, period)
        rows.append(traced_row(traced, reach_mpa))
        rows += effect_rows(traced, f"{names[-1]} selecting: ")
    rows.append(agreement(fits))
    rows += estimate_rows(result)
    if args.out:
        pictures((*result.responses, *responses), args.out)
    is_usual = (args.data, path.name) == (DATA / "tamu-muscle-electric", USUAL)
    finish(
        rows,
        args,
        words="" if is_usual else f" --data {args.data.resolve().name} --workbook {path.name}",
    )


def _target_and_verdict(target: float | None, error: float) -> tuple[str, bool | None]:
    return ("-", None) if target is None else (f"<= {target:.0f} MPa", error <= target)


if __name__ == "__main__":
    main()
