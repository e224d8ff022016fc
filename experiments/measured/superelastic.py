"""Stress-strain loops of a superelastic wire at 0, 40 and 100 degC, measured by others: fit 0 and 100, predict 40.

    python experiments/measured/superelastic.py [--data DIR] [--quick] [--json FILE] [--out DIR]

DIR holds one workbook a temperature, ``pseudoelastic_...C.xlsx``. What is done with them:

- Columns are found by their headers: those of the 40 degC workbook are shifted. Stress is load over area and strain
  extensometer over gauge length, since the sheets' own columns of them are partly absolute values and partly zeroed.
- A row whose extensometer reads more than 10 % is a dropout, and left out (one, in the workbook of 0 degC, of 41.76
  %).
- A loop starts where the wire is last under its preload (3 N) before it is stretched: warming and cooling before it
  are cut. The clock of 40 degC is reset twice; a row stands for a second, as in the other two.
- The wire is slack where the load reads about -4 N (-30 MPa), because it cannot push. That is taken for the load
  cell's zero: the median of the negative readings of the fitted loops is subtracted from all loads, and what is still
  negative is zero.
- Every twelfth row is fitted; all rows are scored.

Effects are chosen by the middle one of every three of twelve stretches of each fitted loop: models are fitted to the
other stretches, both ends of the loop among them, and led through these. Neither loop can be spared as a whole, since
it takes two temperatures to know what depends on temperature, and the last third of a loop cannot either, since only
there the wire turns back. The loop at 40 degC is only predicted. Effects are added one after the other by
``experiments.common.greedy_search``. Which ones cannot show here is said in ``WITHOUT``.
"""

from __future__ import annotations

import dataclasses
import sys
from collections.abc import Sequence
from pathlib import Path

sys.path.insert(0, str(Path(__file__).resolve().parents[2]))  # the checkout: smajax, tests/reference, experiments

from experiments.common.base import Row, agreement, arguments, estimate_rows, finish, refuse, workbook
from experiments.common.charts import Chart, Curve, draw
from experiments.common.greedy_search import Outcome, Search, close_loop, path_of, rms, round_rows, scored

import numpy as np

from smajax.diagnosis.data_split import DataSplit
from smajax.fitting.result import FitResult
from smajax.recordings.recording import Recording

FITTED, HELD = (0, 100), 40  # degC
DROPOUT = 0.10  # strain
PRELOAD = 3.0  # N
THINNED = 12  # rows
STRETCHES = 12  # of a fitted loop's rows, the middle one of every three of which chooses between effects
TARGET = 33.0  # MPa
WITHOUT = {
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
    """One loop: temperature (degC), load (N), strain, each of shape ``(n,)``, area (m^2), dropouts left out."""

    temperature: np.ndarray
    load: np.ndarray
    strain: np.ndarray
    area: float
    dropouts: int

    def recording(self, name: str, zero: float, rows: np.ndarray) -> Recording:
        """These rows as a path whose time is the row number, the load counted from ``zero`` (N)."""
        stress = np.maximum(self.load[rows] - zero, 0.0) / self.area
        channels = {"temperature": self.temperature[rows], "strain": self.strain[rows], "stress": stress}
        return path_of(name, rows, channels)


def read_loop(path: Path) -> Loop:
    """The loop of a workbook."""
    rows = next(iter(workbook(path).values()))
    heads = [k for k, row in enumerate(rows[:20]) if any(str(cell).strip().startswith("Laser") for cell in row)]
    if not heads:
        refuse(
            f"{path}: none of the first rows has a header 'Laser' with 'Load', 'Temperature', 'Area' and 'Lo' beside it"
        )
    header = [str(cell).split("(")[0].strip() for cell in rows[heads[0]]]
    missing = [name for name in ("Load", "Temperature", "Area", "Lo") if name not in header]
    if missing:
        refuse(
            f"{path}: row {heads[0] + 1} has no header '{missing[0]}'; it has "
            f"{', '.join(h for h in header if h != 'None')}"
        )
    at = {name: header.index(name) for name in ("Load", "Temperature", "Laser", "Area", "Lo")}
    body = [row for row in rows[heads[0] + 1 :] if len(row) > max(at.values())]
    once = {name: [row[at[name]] for row in body if isinstance(row[at[name]], int | float)] for name in ("Area", "Lo")}
    cells = [[row[at[name]] for name in ("Temperature", "Load", "Laser")] for row in body]
    table = np.array([c for c in cells if all(isinstance(v, int | float) for v in c)], float)
    if len(table) < 100 or not once["Area"] or not once["Lo"]:
        refuse(
            f"{path}: {len(table)} rows of numbers, {len(once['Area'])} areas, {len(once['Lo'])} gauge lengths: "
            "100, 1 and 1 are needed"
        )
    table[:, 2] /= once["Lo"][0]
    sound = table[:, 2] < DROPOUT
    kept = table[sound]
    before = np.flatnonzero(kept[: np.argmax(kept[:, 2]), 1] < PRELOAD)
    loop = kept[before[-1] if len(before) else 0 :]
    return Loop(loop[:, 0], loop[:, 1], loop[:, 2], once["Area"][0] * 1e-6, int(np.sum(~sound)))


def load_zero(loops: dict[int, Loop]) -> float:
    """What the load cell reads where the wire is slack, N: the median of the negative readings of the fitted loops."""
    return float(np.median(np.concatenate([loops[t].load[loops[t].load < 0.0] for t in FITTED])))


def chooses(loop: Loop, rows: np.ndarray) -> np.ndarray:
    """Which rows of a fitted loop lie in the stretches that choose between effects."""
    return (rows * STRETCHES // len(loop.load)) % 3 == 1


def train(loops: dict[int, Loop], every: int) -> DataSplit:
    """What models are fitted to while effects are chosen.

    The row of the largest strain is among it, so that each turns where it did.
    """
    zero, parts = load_zero(loops), []
    for t in FITTED:
        rows = np.arange(0, len(loops[t].load), every)
        rows = np.union1d(rows[~chooses(loops[t], rows)], [int(np.argmax(loops[t].strain))])
        parts.append(loops[t].recording(f"{t} degC", zero, rows))
    return DataSplit(tuple(parts))


def select(loops: dict[int, Loop], every: int) -> DataSplit:
    """What chooses between effects."""
    whole = fitted(loops, every).recordings
    return DataSplit(whole, tuple(chooses(loops[t], r.time.astype(int)) for t, r in zip(FITTED, whole, strict=True)))


def fitted(loops: dict[int, Loop], every: int) -> DataSplit:
    """What the chosen models are fitted to in the end."""
    zero = load_zero(loops)
    return DataSplit(
        tuple(loops[t].recording(f"{t} degC", zero, np.arange(0, len(loops[t].load), every)) for t in FITTED)
    )


def holdout(loops: dict[int, Loop]) -> DataSplit:
    """What is only predicted: all rows of its loop."""
    return DataSplit((loops[HELD].recording(f"{HELD} degC", load_zero(loops), np.arange(len(loops[HELD].load))),))


def between(loops: dict[int, Loop]) -> np.ndarray:
    """Residual in Pa of the held-out loop if its stress were interpolated in temperature from the fitted loops.

    Compared at the same strain, stretching for stretching.
    """
    zero, held = load_zero(loops), loops[HELD]
    low, high = (loops[t] for t in FITTED)
    share = (HELD - FITTED[0]) / (FITTED[1] - FITTED[0])

    def branches(loop: Loop) -> list[np.ndarray]:
        return np.split(np.arange(len(loop.strain)), [int(np.argmax(loop.strain)) + 1])

    left = []
    for k, rows in enumerate(branches(held)):
        said = 0.0
        for loop, weight in ((low, 1.0 - share), (high, share)):
            known = branches(loop)[k]
            known = known[np.argsort(loop.strain[known])]
            said = said + weight * np.interp(
                held.strain[rows], loop.strain[known], np.maximum(loop.load[known] - zero, 0.0) / loop.area
            )
        left.append(np.maximum(held.load[rows] - zero, 0.0) / held.area - said)
    return np.concatenate(left)


def pictures(held: DataSplit, fits: Sequence[FitResult], residuals: Sequence[np.ndarray], folder: Path) -> None:
    """Draw the held-out loop without and with effects, and the fitted loops with all of them."""
    strain, stress = (held.recordings[0].channels[c] * f for c, f in (("strain", 100.0), ("stress", 1e-6)))
    curves = [Curve("measured", strain, stress)]
    for label, r in (("without effects", residuals[0]), (f"with {len(fits) - 1} effects", residuals[-1])):
        curves.append(Curve(label, strain, stress - r / 1e6, dashed=True))
    draw(
        Chart(f"{HELD} degC, held out", "strain [%]", "stress [MPa]", curves),
        folder,
        "measured_superelastic_held",
    )
    for response in fits[-1].responses:
        strain, stress = (100 * response.recording.channels["strain"], response.recording.channels["stress"] / 1e6)
        curves = [
            Curve("measured", strain, stress),
            Curve("model", strain, response.model["stress"] / 1e6, dashed=True),
        ]
        name = response.recording.name.split()[0]
        chart = Chart(f"{response.recording.name}, fitted", "strain [%]", "stress [MPa]", curves)
        draw(chart, folder, f"measured_superelastic_{name}")


def score_rows(found: Outcome, loops: dict[int, Loop]) -> list[Row]:
    """RMSE fitted and held out, by the number of effects, and next to the naive forecast."""
    rows = []
    fits, left = found.fits, found.left
    for label, each, r in zip(found.labels(), fits, left, strict=True):
        for response in each.responses:
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
    ours, naive = rms(left[-1]) / 1e6, rms(between(loops)) / 1e6
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
    """Prints the table."""
    args = arguments(
        __doc__, data="tamu-muscle-superelastic", quick="every 24th row, one effect, one round, two start points"
    )
    paths = {t: args.data / f"pseudoelastic_{t}C.xlsx" for t in (*FITTED, HELD)}
    for path in paths.values():
        if not path.is_file():
            refuse(f"{path} is no file: give the folder of pseudoelastic_...C.xlsx by --data")
    loops = {t: read_loop(path) for t, path in paths.items()}
    every = 2 * THINNED if args.quick else THINNED
    search = Search(RIG, "stress", train(loops, every), select(loops, every), 30 if args.quick else 50)
    final, held = fitted(loops, every), holdout(loops)
    candidates = [c for c in search.candidates(WITHOUT) if not args.quick or c.label == "slip"]
    rounds, starts, times = (1, 1, 2) if args.quick else (5, 4, 5)
    found = close_loop(search, final, held, candidates, rounds=rounds, starts=starts, times=times)
    fits, left = found.fits, found.left
    zero = load_zero(loops)

    parts = (
        f"train eight twelfths of the loops at {FITTED[0]} and {FITTED[1]} degC, select the other four, held "
        f"out {HELD} degC"
    )
    rows = [
        Row("parts", "-", parts, None),
        Row("rows fitted", "-", f"every {every}. row: {scored(final)}", None),
        Row("rows scored", "-", f"all: {scored(held)}", None),
        Row(
            "rows left out as dropouts",
            "-",
            ", ".join(f"{loop.dropouts} at {t} degC" for t, loop in loops.items()),
            None,
        ),
        Row("zero of the load cell, subtracted", "-", f"{zero:.2f} N, {zero / loops[HELD].area / 1e6:.1f} MPa", None),
        Row("not tried: they cannot show here", "-", ", ".join(f"{k} ({v})" for k, v in WITHOUT.items()), None),
        *round_rows(found.rounds, lambda error: f"{error / 1e6:.1f} MPa"),
    ]
    rows += score_rows(found, loops)
    rows.append(dataclasses.replace(agreement(found.bases), what="base model: is it the best that it can do?"))
    rows += estimate_rows(fits[-1])
    if args.out:
        pictures(held, fits, left, args.out)
    finish(rows, args)


if __name__ == "__main__":
    main()
