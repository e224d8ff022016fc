"""Stress-strain loops of a superelastic wire at 0, 40 and 100 degC, measured by others: fit 0 and 100, predict 40.

    python experiments/measured/superelastic.py [--data DIR] [--quick] [--json FILE] [--out DIR]

DIR holds one workbook a temperature, ``pseudoelastic_...C.xlsx``.

- Columns are found by their headers: those of the 40 degC workbook are shifted. Stress is load over area and strain
  extensometer over gauge length, since the sheets' own columns of them are partly absolute values and partly zeroed.
- A row whose extensometer reads more than 10 % is a dropout, and left out (one row, with 41.76 %, in the workbook of
  0 degC).
- A loop starts where the wire is last under its preload (3 N) before it is stretched: earlier warming and cooling are
  cut. The clock of 40 degC is reset twice; a row counts as a second, as in the other two.
- The wire is slack where the load reads about -4 N (-30 MPa), because it cannot push. That is assumed to be the load
  cell's zero: the median of the negative readings of the fitted loops is subtracted from all loads, and what is still
  negative is set to zero.
- Every twelfth row is fitted; all rows are scored.

Each fitted loop is divided into twelve stretches, and the middle one of every three selects effects. Models are fitted
to the other stretches, which include both ends of the loop, and simulated through these. Neither loop can be held out
as a whole, since two temperatures are needed to determine what depends on temperature, and neither can the last third
of a loop, since the wire turns back only there. The loop at 40 degC is only predicted. Effects are added one by one by
``experiments.common.greedy_search``; ``EXCLUDED`` lists those that these data cannot show.
"""

from __future__ import annotations

import dataclasses
import sys
from collections.abc import Sequence
from pathlib import Path

sys.path.insert(0, str(Path(__file__).resolve().parents[2]))  # the checkout: smajax, tests/reference, experiments

from experiments.common.base import Row, agreement, arguments, estimate_rows, finish, refuse, workbook
from experiments.common.charts import Chart, Curve, draw
from experiments.common.greedy_search import (
    Outcome,
    Search,
    count_scored_rows,
    path_recording,
    rms,
    round_rows,
    search_and_predict,
)

import numpy as np

from smajax.diagnosis.data_split import DataSplit
from smajax.fitting.result import FitResult
from smajax.recordings.recording import Recording

FITTED, HELD = (0, 100), 40  # degC: fitted loops, held-out loop
DROPOUT = 0.10  # strain above which a row is a dropout
PRELOAD = 3.0  # N
THINNED = 12  # distance of the fitted rows
STRETCHES = 12  # of a fitted loop; the middle one of every three selects effects
TARGET = 33.0  # MPa
EXCLUDED = {
    "encoder-gain": "the strain is prescribed",
    "encoder-drift": "the strain is prescribed",
    "sensor-lag": "the strain is prescribed",
    "ratcheting": "one cycle",
    "functional-fatigue": "one cycle",
    "transformation-shift": "one cycle",
    "time-skew": "the strain is prescribed",
    "backlash": "the strain is prescribed",
    "clausius-asymmetry": "both slopes are free",
    "resistivity-strain": "no resistance",
    "resistivity-temperature": "no resistance",
}
RIG = """
schema = 1
[rig]
kind = "path"
[material]
martensite_start = "-40 degC"
martensite_finish = "-80 degC"
austenite_start = "-20 degC"
austenite_finish = "0 degC"
clausius_clapeyron_austenite = "5.7 MPa/K"
clausius_clapeyron_martensite = "5.7 MPa/K"
modulus_austenite = "60 GPa"
modulus_martensite = "30 GPa"
detwinning_start_stress = "50 MPa"
detwinning_finish_stress = "150 MPa"
max_transformation_strain = "3.5 %"
[fit]
free = ["material.martensite_start", "material.austenite_start", "material.austenite_finish",
        "material.clausius_clapeyron_austenite",
        "material.clausius_clapeyron_martensite", "material.modulus_austenite", "material.modulus_martensite",
        "material.detwinning_finish_stress", "material.max_transformation_strain", "wire.prestrain"]
observe = ["stress"]
noise = { stress = "10 MPa" }
starts = 4
[fit.bounds]
"material.austenite_start" = ["-100 degC", "-5 degC"]
"material.austenite_finish" = ["-5 degC", "60 degC"]
"material.martensite_start" = ["-79 degC", "20 degC"]
"material.detwinning_finish_stress" = ["51 MPa", "600 MPa"]
"material.modulus_austenite" = ["15 GPa", "120 GPa"]
"material.modulus_martensite" = ["10 GPa", "100 GPa"]
"material.clausius_clapeyron_austenite" = ["3 MPa/K", "12 MPa/K"]
"material.clausius_clapeyron_martensite" = ["3 MPa/K", "12 MPa/K"]
"material.max_transformation_strain" = ["1.5 %", "7 %"]
"wire.prestrain" = ["-1 %", "1 %"]
"""


@dataclasses.dataclass(frozen=True)
class Loop:
    """One stress-strain loop.

    Attributes:
        temperature: Temperature, degC, shape ``(n,)``.
        load: Load, N, shape ``(n,)``.
        strain: Strain, shape ``(n,)``.
        area: Cross-section, m^2.
        dropouts: Number of dropouts, which are left out.
    """

    temperature: np.ndarray
    load: np.ndarray
    strain: np.ndarray
    area: float
    dropouts: int

    def recording(self, name: str, zero: float, rows: np.ndarray) -> Recording:
        """Return some rows as a path whose time is the row number.

        Args:
            name: Name of the recording.
            zero: Reading of the load cell without load, N.
            rows: Row numbers.
        """
        stress = np.maximum(self.load[rows] - zero, 0.0) / self.area
        channels = {"temperature": self.temperature[rows], "strain": self.strain[rows], "stress": stress}
        return path_recording(name, rows, channels)


def read_loop(path: Path) -> Loop:
    """Read the loop of a workbook."""
    rows = next(iter(workbook(path).values()))
    header_rows = [k for k, row in enumerate(rows[:20]) if any(str(cell).strip().startswith("Laser") for cell in row)]
    if not header_rows:
        refuse(f"{path}: none of the first rows has a header 'Laser' with 'Load', 'Temperature', 'Area' and 'Lo'")
    header = [str(cell).split("(")[0].strip() for cell in rows[header_rows[0]]]
    missing = [name for name in ("Load", "Temperature", "Area", "Lo") if name not in header]
    if missing:
        refuse(
            f"{path}: row {header_rows[0] + 1} has no header '{missing[0]}'; it has "
            f"{', '.join(h for h in header if h != 'None')}"
        )
    columns = {name: header.index(name) for name in ("Load", "Temperature", "Laser", "Area", "Lo")}
    body = [row for row in rows[header_rows[0] + 1 :] if len(row) > max(columns.values())]
    constants = {
        name: [row[columns[name]] for row in body if isinstance(row[columns[name]], int | float)]
        for name in ("Area", "Lo")
    }
    cells = [[row[columns[name]] for name in ("Temperature", "Load", "Laser")] for row in body]
    table = np.array([c for c in cells if all(isinstance(v, int | float) for v in c)], float)
    if len(table) < 100 or not constants["Area"] or not constants["Lo"]:
        refuse(
            f"{path}: {len(table)} rows of numbers, {len(constants['Area'])} areas, {len(constants['Lo'])} gauge "
            "lengths: 100, 1 and 1 are needed"
        )
    table[:, 2] /= constants["Lo"][0]
    valid = table[:, 2] < DROPOUT
    valid_rows = table[valid]
    unloaded = np.flatnonzero(valid_rows[: np.argmax(valid_rows[:, 2]), 1] < PRELOAD)
    loop = valid_rows[unloaded[-1] if len(unloaded) else 0 :]
    return Loop(loop[:, 0], loop[:, 1], loop[:, 2], constants["Area"][0] * 1e-6, int(np.sum(~valid)))


def load_zero(loops: dict[int, Loop]) -> float:
    """Return the load cell's reading of a slack wire, N: the median of the negative readings of the fitted loops."""
    return float(np.median(np.concatenate([loops[t].load[loops[t].load < 0.0] for t in FITTED])))


def selection_rows(loop: Loop, rows: np.ndarray) -> np.ndarray:
    """Return which rows of a fitted loop lie in the stretches that select effects."""
    return (rows * STRETCHES // len(loop.load)) % 3 == 1


def train_part(loops: dict[int, Loop], every: int) -> DataSplit:
    """Return the training part.

    It includes the row of the largest strain, so that each loop turns where it did.
    """
    zero, parts = load_zero(loops), []
    for t in FITTED:
        rows = np.arange(0, len(loops[t].load), every)
        rows = np.union1d(rows[~selection_rows(loops[t], rows)], [int(np.argmax(loops[t].strain))])
        parts.append(loops[t].recording(f"{t} degC", zero, rows))
    return DataSplit(tuple(parts))


def select_part(loops: dict[int, Loop], every: int) -> DataSplit:
    """Return the selection part."""
    recordings = fitted_part(loops, every).recordings
    return DataSplit(
        recordings, tuple(selection_rows(loops[t], r.time.astype(int)) for t, r in zip(FITTED, recordings, strict=True))
    )


def fitted_part(loops: dict[int, Loop], every: int) -> DataSplit:
    """Return training and selection part together, for the last fits."""
    zero = load_zero(loops)
    return DataSplit(
        tuple(loops[t].recording(f"{t} degC", zero, np.arange(0, len(loops[t].load), every)) for t in FITTED)
    )


def holdout_part(loops: dict[int, Loop]) -> DataSplit:
    """Return the held-out part, with all its rows."""
    return DataSplit((loops[HELD].recording(f"{HELD} degC", load_zero(loops), np.arange(len(loops[HELD].load))),))


def interpolate_loops(loops: dict[int, Loop]) -> np.ndarray:
    """Return the residual in Pa of the naive forecast: stress interpolated in temperature from the fitted loops.

    The loops are compared at the same strain of the same branch.
    """
    zero, held_out = load_zero(loops), loops[HELD]
    low, high = (loops[t] for t in FITTED)
    share = (HELD - FITTED[0]) / (FITTED[1] - FITTED[0])

    def branches(loop: Loop) -> list[np.ndarray]:
        return np.split(np.arange(len(loop.strain)), [int(np.argmax(loop.strain)) + 1])

    residuals = []
    for k, rows in enumerate(branches(held_out)):
        forecast = 0.0
        for loop, weight in ((low, 1.0 - share), (high, share)):
            reference = branches(loop)[k]
            reference = reference[np.argsort(loop.strain[reference])]
            forecast = forecast + weight * np.interp(
                held_out.strain[rows], loop.strain[reference], np.maximum(loop.load[reference] - zero, 0.0) / loop.area
            )
        residuals.append(np.maximum(held_out.load[rows] - zero, 0.0) / held_out.area - forecast)
    return np.concatenate(residuals)


def pictures(held_out: DataSplit, fits: Sequence[FitResult], residuals: Sequence[np.ndarray], folder: Path) -> None:
    """Draw the held-out loop without and with effects, and the fitted loops with all of them.

    Args:
        held_out: Held-out part.
        fits: Fits of the base model and of the growing sets of effects.
        residuals: Their residuals in the held-out part, Pa.
        folder: Where the pictures go.
    """
    strain, stress = (held_out.recordings[0].channels[c] * f for c, f in (("strain", 100.0), ("stress", 1e-6)))
    curves = [Curve("measured", strain, stress)]
    for label, r in (("without effects", residuals[0]), (f"with {len(fits) - 1} effects", residuals[-1])):
        curves.append(Curve(label, strain, stress - r / 1e6, dashed=True))
    draw(
        Chart(f"{HELD} degC, held out", "strain [%]", "stress [MPa]", curves),
        folder,
        "measured_superelastic_held",
    )
    for response in fits[-1].responses:
        strain = 100 * response.recording.channels["strain"]
        stress = response.recording.channels["stress"] / 1e6
        curves = [
            Curve("measured", strain, stress),
            Curve("model", strain, response.model["stress"] / 1e6, dashed=True),
        ]
        name = response.recording.name.split()[0]
        chart = Chart(f"{response.recording.name}, fitted", "strain [%]", "stress [MPa]", curves)
        draw(chart, folder, f"measured_superelastic_{name}")


def score_rows(outcome: Outcome, loops: dict[int, Loop]) -> list[Row]:
    """Return the RMSE fitted and held out, by the number of effects, and that of the naive forecast."""
    rows = []
    fits, residuals = outcome.fits, outcome.residuals
    for label, result, r in zip(outcome.labels(), fits, residuals, strict=True):
        for response in result.responses:
            rows.append(
                Row(
                    f"{label}: RMSE fitted, {response.recording.name}",
                    "-",
                    f"{response.rmse('stress') / 1e6:.1f} MPa",
                    None,
                )
            )
        rows.append(
            Row(f"{label}: held out, {HELD} degC", "-", f"{rms(r) / 1e6:.1f} MPa", None, {"rmse_MPa": rms(r) / 1e6})
        )
    ours = rms(residuals[-1]) / 1e6
    naive = rms(interpolate_loops(loops)) / 1e6
    rows.append(
        Row(
            f"all effects: held out, {HELD} degC",
            f"<= {TARGET:g} MPa",
            f"{ours:.1f} MPa",
            ours <= TARGET,
            {"rmse_MPa": ours},
        )
    )
    rows.append(Row("naive forecast, between the fitted loops", "-", f"{naive:.1f} MPa", None, {"rmse_MPa": naive}))
    rows.append(
        Row(
            "all effects against the naive forecast",
            "below it",
            f"{ours:.1f} MPa against {naive:.1f} MPa",
            ours < naive,
        )
    )
    return rows


def main() -> None:
    """Print the table."""
    args = arguments(
        __doc__, data="tamu-muscle-superelastic", quick="every 24th row, one effect, one round, two start points"
    )
    paths = {t: args.data / f"pseudoelastic_{t}C.xlsx" for t in (*FITTED, HELD)}
    for path in paths.values():
        if not path.is_file():
            refuse(f"{path} is not a file: give the folder of pseudoelastic_...C.xlsx by --data")
    loops = {t: read_loop(path) for t, path in paths.items()}
    every = 2 * THINNED if args.quick else THINNED
    search = Search(RIG, "stress", train_part(loops, every), select_part(loops, every), 30 if args.quick else 50)
    final = fitted_part(loops, every)
    held_out = holdout_part(loops)
    candidates = [c for c in search.candidates(EXCLUDED) if not args.quick or c.label == "slip"]
    rounds, starts, times = (1, 1, 2) if args.quick else (5, 4, 5)
    outcome = search_and_predict(search, final, held_out, candidates, rounds=rounds, starts=starts, times=times)
    fits, residuals = outcome.fits, outcome.residuals
    zero = load_zero(loops)

    parts = (
        f"train eight twelfths of the loops at {FITTED[0]} and {FITTED[1]} degC, select the other four, held "
        f"out {HELD} degC"
    )
    rows = [
        Row("parts", "-", parts, None),
        Row("rows fitted", "-", f"every {every}. row: {count_scored_rows(final)}", None),
        Row("rows scored", "-", f"all: {count_scored_rows(held_out)}", None),
        Row(
            "rows left out as dropouts",
            "-",
            ", ".join(f"{loop.dropouts} at {t} degC" for t, loop in loops.items()),
            None,
        ),
        Row("zero of the load cell, subtracted", "-", f"{zero:.2f} N, {zero / loops[HELD].area / 1e6:.1f} MPa", None),
        Row("not tried: they cannot show here", "-", ", ".join(f"{k} ({v})" for k, v in EXCLUDED.items()), None),
        *round_rows(outcome.rounds, lambda error: f"{error / 1e6:.1f} MPa"),
    ]
    rows += score_rows(outcome, loops)
    rows.append(dataclasses.replace(agreement(outcome.bases), what="base model: is it the best that it can do?"))
    rows += estimate_rows(fits[-1])
    if args.out:
        pictures(held_out, fits, residuals, args.out)
    finish(rows, args)


if __name__ == "__main__":
    main()
