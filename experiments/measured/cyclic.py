"""A hundred thermal cycles of an actuator under constant load, measured by others: fit 2 to 60, predict 61 to 100.

    python experiments/measured/cyclic.py [--data DIR] [--quick] [--json FILE] [--out DIR]

DIR holds one text file with columns temperature (degC) and strain (fraction), without time and without stress.

- Cycle 1 starts from an unknown state and is left out; all parts start with cycle 2. Cycles 2 to 40 train the models
  while effects are selected, 41 to 60 select, the models with the selected effects are fitted to 2 to 60, and 61 to
  100 are only predicted. A selection or held-out part is simulated from cycle 2 on, so that what accumulates over the
  cycles is there, and scored in its own cycles only.
- The temperature scatters by 5 K, and every small reversal would move a rate law back and forth: it is smoothed over
  9 rows. The same smoothed temperature decides which rows lie on a plateau (below 80 or above 200 degC).
- Every third row is fitted (and every hot and cold end); all rows are scored.
- The stress is not given. At one stress its value is absorbed by the transformation temperatures; 300 MPa and 6 MPa/K
  are assumed, so that these temperatures have no meaning of their own.
- There is no clock. Where an effect needs one, a row counts as a second, and its time constant is in rows.

Effects are added one by one by ``experiments.common.greedy_search``; ``EXCLUDED`` lists those that these data cannot
show.
"""

from __future__ import annotations

import dataclasses
import itertools
import sys
from pathlib import Path

sys.path.insert(0, str(Path(__file__).resolve().parents[2]))  # the checkout: smajax, tests/reference, experiments

from experiments.common.base import Row, agreement, arguments, estimate_rows, finish, refuse
from experiments.common.charts import Chart, Curve, draw
from experiments.common.greedy_search import (
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

FILE = "Example Test Data.txt"
FIRST, TRAINED, FITTED, LAST = 2, 40, 60, 100  # first cycle, and the last of training, fitted and held-out part
SMOOTHED = 9  # rows of the moving average of the temperature
THINNED = 3  # distance of the fitted rows
HOT_THRESHOLD = 200.0  # degC, passed once up and once down in each cycle
PLATEAU = (80.0, 200.0)  # degC: rows below or above are on a plateau
TARGETS = (0.065, 0.125)  # % of strain: plateau rows, all rows
STRESS = 300e6  # Pa, assumed
EXCLUDED = {
    "clausius-asymmetry": "one stress",
    "stress-dependent-strain": "one stress",
    "slip": "one stress",
    "encoder-gain": "absorbed by the transformation strain",
    "resistivity-strain": "no resistance",
    "resistivity-temperature": "no resistance",
}
RIG = """
schema = 1
[rig]
kind = "path"
[material]
martensite_start = "80 degC"
martensite_finish = "0 degC"
austenite_start = "55 degC"
austenite_finish = "85 degC"
clausius_clapeyron_austenite = "6 MPa/K"
clausius_clapeyron_martensite = "6 MPa/K"
modulus_austenite = "60 GPa"
modulus_martensite = "60 GPa"
detwinning_start_stress = "0 MPa"
detwinning_finish_stress = "250 MPa"
max_transformation_strain = "3.7 %"
[environment]
ambient = "20 degC"
[fit]
free = ["material.martensite_start", "material.austenite_start", "material.austenite_finish",
        "material.detwinning_finish_stress", "material.max_transformation_strain",
        "material.thermal_expansion_austenite", "material.thermal_expansion_martensite", "sensor.strain_offset"]
observe = ["strain"]
noise = { strain = "0.1 %" }
starts = 4
[fit.bounds]
"material.austenite_start" = ["0 degC", "79 degC"]
"material.austenite_finish" = ["79 degC", "250 degC"]
"material.martensite_start" = ["1 degC", "130 degC"]
"material.detwinning_finish_stress" = ["5 MPa", "300 MPa"]
"material.max_transformation_strain" = ["1.5 %", "7 %"]
"material.thermal_expansion_austenite" = ["-3e-4 1/K", "3e-4 1/K"]
"material.thermal_expansion_martensite" = ["-3e-4 1/K", "3e-4 1/K"]
"""


@dataclasses.dataclass(frozen=True)
class Test:
    """A recording of thermal cycles.

    Attributes:
        temperature: Smoothed temperature, degC, shape ``(n,)``.
        strain: Strain, shape ``(n,)``.
        first: First rows of the cycles, followed by the number of rows.
        hot: Rows of the hot ends.
    """

    temperature: np.ndarray
    strain: np.ndarray
    first: np.ndarray
    hot: np.ndarray

    def rows(self, start: int, stop: int, every: int = 1) -> np.ndarray:
        """Return the row numbers of the cycles ``start`` to ``stop``, thinned, with all hot and cold ends.

        Args:
            start: First cycle.
            stop: Last cycle.
            every: Distance of the rows.
        """
        rows = np.arange(self.first[start - 1], self.first[stop])
        ends = np.concatenate([self.hot, self.first])
        return np.union1d(rows[::every], ends[(ends >= rows[0]) & (ends <= rows[-1])])

    def recording(self, name: str, rows: np.ndarray) -> Recording:
        """Return some rows as a path whose time is the row number."""
        channels = {
            "temperature": self.temperature[rows],
            "stress": np.full(len(rows), STRESS),
            "strain": self.strain[rows],
        }
        return path_recording(name, rows, channels)

    def part(self, name: str, counting: tuple[int, int], every: int = 1) -> DataSplit:
        """Return the cycles from the first one used to ``counting[1]``, scored from ``counting[0]`` on.

        Args:
            name: Name of the recording.
            counting: First and last scored cycle.
            every: Distance of the rows.
        """
        rows = self.rows(FIRST, counting[1], every)
        return DataSplit((self.recording(name, rows),), (rows >= self.first[counting[0] - 1],))


def read_test(path: Path) -> Test:
    """Read the file, smooth the temperature, and cut it into cycles at the coldest row between two hot ends."""
    if not path.is_file():
        refuse(f"{path} is not a file: give the folder of '{FILE}' by --data")
    try:
        columns = np.loadtxt(path, ndmin=2)
    except (ValueError, UnicodeDecodeError) as error:
        refuse(f"{path}: two columns of numbers are needed, temperature and strain: {str(error).splitlines()[0]}")
    if columns.shape[1] != 2 or len(columns) < SMOOTHED or not np.all(np.isfinite(columns)):
        refuse(f"{path}: {columns.shape[1]} columns and {len(columns)} rows: two columns of finite numbers are needed")
    half = SMOOTHED // 2
    temperature = np.convolve(np.pad(columns[:, 0], half, mode="edge"), np.full(SMOOTHED, 1.0 / SMOOTHED), "valid")
    passes = np.flatnonzero(np.diff((temperature > HOT_THRESHOLD).astype(int))) + 1
    hot = [a + int(np.argmax(temperature[a:b])) for a, b in zip(passes[::2], passes[1::2], strict=False)]
    cold = [a + int(np.argmin(temperature[a:b])) for a, b in itertools.pairwise(hot)]
    if len(hot) < LAST:
        refuse(f"{path}: {len(hot)} cycles go above {HOT_THRESHOLD:g} degC and back: {LAST} are needed")
    return Test(temperature, columns[:, 1], np.array([0, *cold, len(temperature)]), np.array(hot))


def train_part(test: Test, every: int) -> DataSplit:
    """Return the training part."""
    return test.part("cycles 2 to 40", (FIRST, TRAINED), every)


def select_part(test: Test, every: int) -> DataSplit:
    """Return the selection part."""
    return test.part("cycles 41 to 60", (TRAINED + 1, FITTED), every)


def fitted_part(test: Test, every: int) -> DataSplit:
    """Return training and selection part together, for the last fits."""
    return test.part("cycles 2 to 60", (FIRST, FITTED), every)


def holdout_part(test: Test) -> DataSplit:
    """Return the held-out part, with all its rows."""
    return test.part("cycles 61 to 100", (FITTED + 1, LAST))


def on_plateau(part: DataSplit) -> np.ndarray:
    """Return which of a part's scored rows lie on a plateau."""
    temperature = np.concatenate(
        [r.channels["temperature"][rows] for r, rows in zip(part.recordings, part.rows(), strict=True)]
    )
    return (temperature < PLATEAU[0]) | (temperature > PLATEAU[1])


def repeat_last_cycle(test: Test) -> np.ndarray:
    """Return the residual of the held-out rows if the last fitted cycle is repeated.

    The forecast is its strain at the same temperature of the same branch.
    """

    def branches(cycle: int) -> list[np.ndarray]:
        return np.split(
            np.arange(test.first[cycle - 1], test.first[cycle]), [test.hot[cycle - 1] + 1 - test.first[cycle - 1]]
        )

    residuals = []
    for cycle in range(FITTED + 1, LAST + 1):
        for reference, rows in zip(branches(FITTED), branches(cycle), strict=True):
            order = reference[np.argsort(test.temperature[reference])]
            residuals.append(
                test.strain[rows] - np.interp(test.temperature[rows], test.temperature[order], test.strain[order])
            )
    return np.concatenate(residuals)


def percent_errors(residuals: np.ndarray, plateau: np.ndarray) -> tuple[float, float]:
    """Return the RMSE in % of strain over plateau rows and over all rows."""
    return 100 * rms(residuals[plateau]), 100 * rms(residuals)


def score_rows(what: str, scores: tuple[float, float], targets: bool = False) -> list[Row]:
    """Return a row each for plateau rows and all rows.

    Args:
        what: Name of the rows.
        scores: RMSE in % of strain.
        targets: Whether the rows have targets.
    """
    names = ("plateau rows", "all rows")
    return [
        Row(
            f"{what}, {name}",
            f"<= {t} %" if targets else "-",
            f"{s:.4f} %",
            s <= t if targets else None,
            {"percent": s},
        )
        for name, s, t in zip(names, scores, TARGETS, strict=True)
    ]


def pictures(folder: Path, test: Test, fits: list[FitResult], residuals: list[np.ndarray]) -> None:
    """Draw the drift of both plateaus over the cycles, and the last cycle, without and with effects.

    Args:
        folder: Where the pictures go.
        test: The recording.
        fits: Fits of the base model and of the growing sets of effects.
        residuals: Their residuals in the held-out part.
    """
    rows = test.rows(FITTED + 1, LAST)
    cycle = np.searchsorted(test.first, rows, side="right")
    for name, plateau in (("hot", test.temperature[rows] > PLATEAU[1]), ("cold", test.temperature[rows] < PLATEAU[0])):
        cycles = np.arange(FITTED + 1, LAST + 1)
        measured = np.array([100 * np.mean(test.strain[rows][plateau & (cycle == n)]) for n in cycles])
        curves = [Curve("measured", cycles, measured)]
        for label, r in (("without effects", residuals[0]), (f"with {len(fits) - 1} effects", residuals[-1])):
            offsets = np.array([100 * np.mean(r[plateau & (cycle == n)]) for n in cycles])
            curves.append(Curve(label, cycles, measured - offsets, dashed=True))
        draw(
            Chart(f"Mean strain of the {name} plateau, held out", "cycle", "strain [%]", curves),
            folder,
            f"measured_cyclic_{name}",
        )
    last = cycle == LAST
    temperature, measured = test.temperature[rows][last], 100 * test.strain[rows][last]
    curves = [Curve("measured", temperature, measured)]
    curves += [Curve("without effects", temperature, measured - 100 * residuals[0][last], dashed=True)]
    curves += [Curve(f"with {len(fits) - 1} effects", temperature, measured - 100 * residuals[-1][last], dashed=True)]
    draw(Chart(f"Cycle {LAST}, held out", "temperature [degC]", "strain [%]", curves), folder, "measured_cyclic_last")


def main() -> None:
    """Print the table."""
    args = arguments(__doc__, data="asmada-cyclic", quick="every twelfth row, one effect, one round, two start points")
    test = read_test(args.data / FILE)
    every = 4 * THINNED if args.quick else THINNED
    search = Search(RIG, "strain", train_part(test, every), select_part(test, every))
    final = fitted_part(test, every)
    held_out = holdout_part(test)
    plateau = on_plateau(held_out)
    candidates = [c for c in search.candidates(EXCLUDED) if not args.quick or c.label == "ratcheting"]
    rounds, starts, times = (1, 1, 2) if args.quick else (6, 4, 10)
    outcome = search_and_predict(search, final, held_out, candidates, rounds=rounds, starts=starts, times=times)
    forecast = percent_errors(repeat_last_cycle(test), plateau)

    rows = [
        Row(
            "parts",
            "-",
            f"train {FIRST} to {TRAINED}, select {TRAINED + 1} to {FITTED}, held out {FITTED + 1} to {LAST}",
            None,
        ),
        Row(
            "rows",
            "-",
            f"every {every}. fitted, {len(final.recordings[0])}; {count_scored_rows(held_out)} scored, "
            f"{int(np.sum(plateau))} on plateaus",
            None,
        ),
        Row("temperature", "-", f"smoothed over {SMOOTHED} rows", None),
        Row("not tried: they cannot show here", "-", ", ".join(f"{k} ({v})" for k, v in EXCLUDED.items()), None),
        *round_rows(outcome.rounds, lambda error: f"{100 * error:.4f} %"),
    ]
    for label, result, r in zip(outcome.labels(), outcome.fits, outcome.residuals, strict=True):
        rows.append(Row(f"{label}: RMSE fitted", "-", f"{100 * (result.rmse('strain') or np.nan):.4f} %", None))
        rows += score_rows(f"{label}: held out", percent_errors(r, plateau))
    scores = percent_errors(outcome.residuals[-1], plateau)
    rows += score_rows("all effects: held out", scores, targets=True)
    rows += score_rows(f"naive forecast, cycle {FITTED} repeated", forecast)
    for name, ours, naive in zip(("plateau rows", "all rows"), scores, forecast, strict=True):
        rows.append(
            Row(
                f"all effects against the naive forecast, {name}",
                "below it",
                f"{ours:.4f} % against {naive:.4f} %",
                ours < naive,
            )
        )
    rows.append(dataclasses.replace(agreement(outcome.bases), what="base model: is it the best that it can do?"))
    rows += estimate_rows(outcome.fits[-1])
    if args.out:
        pictures(args.out, test, outcome.fits, outcome.residuals)
    finish(rows, args)


if __name__ == "__main__":
    main()
