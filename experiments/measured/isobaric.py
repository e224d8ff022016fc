"""A thermal cycle of a wire at several constant stresses, measured by others: fit all levels but one, predict that one.

    python experiments/measured/isobaric.py [--data DIR] [--holdout MPA | --each] [--quick] [--json FILE] [--out DIR]

DIR holds one text file a level, ``...MPa.txt``, with columns temperature (degC), strain (fraction, or percent:
distinguished by size) and stress (MPa). The stress is that of the file's name, since the column is a noisy measurement.
If the folder also has the originals from which the text files were resampled (.mat with the curves of a figure), these
are read instead. The strain was zeroed when it was recorded, so each level has an offset; that of the held-out level
makes the model agree with its hottest row, where the recording was zeroed. Start values and bounds come from the
temperatures at which the fitted levels transform. Then effects are selected: they are searched for on all fitted levels
except the one next to the held-out level, which selects, and all fitted levels are fitted again with those accepted.
"""

from __future__ import annotations

import dataclasses
import re
import sys
from collections.abc import Sequence
from pathlib import Path

sys.path.insert(0, str(Path(__file__).resolve().parents[2]))  # the checkout: smajax, tests/reference, experiments

from experiments.common.base import DATA, Row, agreement, arguments, estimate_rows, finish, fit_from_starts, refuse, say
from experiments.common.charts import Chart, Curve, draw
from experiments.common.effect_trace import TraceResult, draw_before_and_after, effect_rows, trace_effects

import numpy as np
import scipy.io

from smajax import parameters
from smajax.diagnosis.data_split import DataSplit
from smajax.files.rig_file import Rig, parse_rig
from smajax.fitting.responses import simulate_responses
from smajax.fitting.result import FitResult
from smajax.recordings.recording import Recording

RIG = """
schema = 1
[rig]
kind = "path"
[material]
martensite_start = "{ms:.1f} degC"
martensite_finish = "{mf:.1f} degC"
austenite_start = "{as_:.1f} degC"
austenite_finish = "{af:.1f} degC"
clausius_clapeyron_austenite = "8 MPa/K"
clausius_clapeyron_martensite = "7.5 MPa/K"
modulus_austenite = "60 GPa"
modulus_martensite = "30 GPa"
detwinning_start_stress = "0 MPa"
detwinning_finish_stress = "110 MPa"
max_transformation_strain = "{stroke:.2f} %"
[fit]
free = ["material.martensite_start", "material.austenite_start", "material.austenite_finish",
        "material.clausius_clapeyron_austenite",
        "material.clausius_clapeyron_martensite", "material.modulus_martensite",
        "material.detwinning_finish_stress", "material.max_transformation_strain",
        "material.thermal_expansion_austenite",
        "material.thermal_expansion_martensite"]
per_recording = ["sensor.strain_offset"]
observe = ["strain"]
noise = {{ strain = "0.1 %" }}
starts = 10
[fit.bounds]
"material.austenite_start" = ["{as_low:.1f} degC", "{heat50:.1f} degC"]
"material.austenite_finish" = ["{heat50:.1f} degC", "{af_high:.1f} degC"]
"material.martensite_start" = ["{ms_low:.1f} degC", "{ms_high:.1f} degC"]
"material.detwinning_finish_stress" = ["5 MPa", "400 MPa"]
"material.modulus_martensite" = ["5 GPa", "200 GPa"]
"material.clausius_clapeyron_austenite" = ["4 MPa/K", "16 MPa/K"]
"material.clausius_clapeyron_martensite" = ["4 MPa/K", "16 MPa/K"]
"material.max_transformation_strain" = ["{strain_low:.2f} %", "{strain_high:.2f} %"]
"material.thermal_expansion_austenite" = ["-3e-4 1/K", "3e-4 1/K"]
"material.thermal_expansion_martensite" = ["-3e-4 1/K", "3e-4 1/K"]
"""
# Variables of a .mat with the curves of a figure, and number of rows into which each curve is averaged.
_TEMPERATURE_KEY, _STRAIN_KEY, _STRETCHES = "Xdata_SampTemp_degC", "Ydata_TrueStrain_pct", 200
# Held-out RMSE in percent of small models by others, without and with effects, by folder and held-out level.
USUAL = ("tamu-flexinol-isobaric", 150)
PEERS = {USUAL: (0.20, 0.075), ("nasa-bigelow-nitihf", 200): (0.112, 0.062)}


def rig_text(levels: Sequence[Recording]) -> str:
    """Return the rig file for some levels, with start values and bounds about the half-transformed states."""
    transitions = np.array([_half_transformation(r) for r in levels])
    stress = np.array([r.channels["stress"][0] for r in levels]) / 1e6
    heat = transitions[:, 0]
    cool = transitions[:, 1]
    band = float(np.median(transitions[:, 2]))
    stroke = float(np.max(transitions[:, 3]))
    transforming = transitions[:, 3] > 0.25 * stroke
    heat50 = float(np.median(heat[transforming] - stress[transforming] / 8.0))
    cool50 = float(np.median(cool[transforming] - stress[transforming] / 7.5))
    values = {
        "ms": cool50 + 7.0,
        "mf": cool50 - 50.0,
        "as_": heat50 - 0.5 * band,
        "af": heat50 + 0.5 * band,
        "stroke": 100 * stroke,
    }
    bounds = {
        "heat50": heat50,
        "as_low": heat50 - 60.0,
        "af_high": heat50 + 80.0,
        "ms_low": cool50 - 49.0,
        "ms_high": cool50 + 70.0,
    }
    bounds |= {"strain_low": 33 * stroke, "strain_high": min(160 * stroke, 12.0)}
    return RIG.format(**values, **bounds)


def _branches(recording: Recording) -> tuple[np.ndarray, np.ndarray]:
    """Return masks of the heating and of the cooling rows; the recording turns once, at its hottest or coldest row."""
    temperature, count = recording.channels["temperature"], len(recording)
    hottest = int(np.argmax(temperature))
    coldest = int(np.argmin(temperature))
    turning_row = hottest if min(hottest, count - 1 - hottest) >= min(coldest, count - 1 - coldest) else coldest
    first = np.arange(count) <= turning_row
    return (first, ~first) if turning_row == hottest else (~first, first)


def _half_transformation(recording: Recording) -> tuple[float, float, float, float]:
    """Return where a recording is half transformed.

    Returns:
        Temperatures on heating and on cooling (degC), three times the spread of the middle half (K), and the stroke.
    """
    temperature, strain = recording.channels["temperature"], recording.channels["strain"]
    stroke = float(np.quantile(strain, 0.98) - np.quantile(strain, 0.02))
    temperatures = []
    for mask in _branches(recording):
        share = (strain[mask] - np.quantile(strain, 0.02)) / stroke
        temperatures.append(
            [
                float(np.median(temperature[mask][np.abs(share - level) <= np.min(np.abs(share - level)) + 0.02]))
                for level in (0.75, 0.5, 0.25)
            ]
        )
    (first, heat, last), (_, cool, _) = temperatures
    return heat, cool, float(np.clip(3.0 * abs(last - first), 6.0, 60.0)), stroke


def read_levels(folder: Path) -> dict[int, Recording]:
    """Read the recordings of a folder by stress in MPa, from the *MPa.txt files or from the originals."""
    tables: dict[int, tuple[str, np.ndarray]] = {}
    for path in sorted(folder.glob("*MPa.txt")):
        match = re.search(r"(\d+)\s*MPa", path.name)
        if not match:
            continue
        columns = np.loadtxt(path, ndmin=2)
        if columns.shape[1] < 2 or len(columns) < 20:
            refuse(
                f"{path}: {columns.shape[1]} columns and {len(columns)} rows: temperature, strain and stress are needed"
            )
        tables[int(match[1])] = (path.name, columns)
    tables |= read_originals(folder, sorted(tables, reverse=True))
    # Over all levels, since some have little strain.
    percent = max((np.ptp(columns[:, 1]) for _, columns in tables.values()), default=0.0) > 0.3
    levels = {}
    for level, (name, columns) in tables.items():
        strain = columns[:, 1] / (100.0 if percent else 1.0)
        stress = np.full(len(columns), level * 1e6)
        channels = {"temperature": columns[:, 0], "stress": stress, "strain": strain}
        levels[level] = Recording.from_arrays(
            name, None, channels, {"temperature": "degC", "stress": "MPa", "strain": "%"}
        )
    return dict(sorted(levels.items()))


def read_originals(folder: Path, levels: Sequence[int]) -> dict[int, tuple[str, np.ndarray]]:
    """Read the curves of a published figure kept as .mat, from the highest stress to the lowest.

    Each level has two curves, heating and cooling, both in the order of the temperature. They have thousands of rows,
    so
    that the means of ``_STRETCHES`` stretches of equal length are taken.

    Returns:
        Name, and temperature and strain, shape ``(n, 2)``, by level.
    """
    for path in sorted(folder.glob("*.mat")):
        document = scipy.io.loadmat(path)
        if not {_TEMPERATURE_KEY, _STRAIN_KEY} <= set(document):
            continue
        curves = [
            np.column_stack([np.ravel(x), np.ravel(y)])
            for x, y in zip(document[_TEMPERATURE_KEY].ravel(), document[_STRAIN_KEY].ravel(), strict=True)
        ]
        if len(curves) != 2 * len(levels):
            refuse(f"{path}: {len(curves)} curves for {len(levels)} files *MPa.txt next to it: each needs two")
        means = [
            np.array([np.mean(stretch, axis=0) for stretch in np.array_split(curve, _STRETCHES)]) for curve in curves
        ]
        return {
            level: (f"{level} MPa of {path.name}", np.vstack([means[2 * k], means[2 * k + 1][::-1]]))
            for k, level in enumerate(levels)
        }
    return {}


def hold_out(levels: dict[int, Recording], level: int, times: int) -> tuple[list[FitResult], np.ndarray]:
    """Fit all other levels, and predict the held-out one.

    Args:
        levels: The recordings by stress, MPa.
        level: The held-out level.
        times: Number of start points.

    Returns:
        The fits, best first, and the best one's residual at the held-out level.
    """
    fitted = [r for k, r in levels.items() if k != level]
    rig = parse_rig(rig_text(fitted), "isobaric.toml")
    fits = fit_from_starts(rig, fitted, rig.fit, times, max_steps=200)
    result = fits[0]
    plant = parameters.replace(result.plant, {"sensor.strain_offset": 0.0})
    response = simulate_responses([plant], [levels[level]], ["holdout"], ("strain",), "hold", None)[0][0]
    hottest = int(np.argmax(levels[level].channels["temperature"]))
    residual = response.residual("strain")
    return fits, residual - residual[hottest]


def split_levels(levels: dict[int, Recording], level: int) -> tuple[int, tuple[DataSplit, ...], DataSplit, Rig]:
    """Split the levels, with one held out and the one next to it selecting.

    Returns:
        The level that selects, training, selection and held-out part, the first two together, and the rig.
    """
    others = [k for k in levels if k != level]
    select = min(others[1:-1] or others, key=lambda k: (abs(k - level), -k))

    def make_part(*stresses: int) -> DataSplit:
        recordings = tuple(levels[k] for k in stresses)
        hottest = tuple(np.arange(len(r)) == np.argmax(r.channels["temperature"]) for r in recordings)
        return DataSplit(recordings, anchor=hottest)

    parts = (make_part(*(k for k in others if k != select)), make_part(select), make_part(level))
    rig = parse_rig(rig_text([levels[k] for k in others]), "isobaric.toml")
    return select, parts, make_part(*others), rig


def trace_residual(levels: dict[int, Recording], level: int) -> tuple[int, TraceResult]:
    """Select effects with a level held out; return the level that selected, and the result."""
    select, parts, whole, rig = split_levels(levels, level)
    return select, trace_effects(rig, parts, whole, say, starts=4)


def repeat_nearest_level(levels: dict[int, Recording], level: int) -> tuple[int, float]:
    """Return the nearest level, and the RMSE (fraction) of the naive forecast that it is repeated.

    The forecast is its strain at the same temperature of the same branch.
    """
    nearest = min((k for k in levels if k != level), key=lambda k: (abs(k - level), -k))
    held_out, neighbour = levels[level], levels[nearest]
    error = np.zeros(len(held_out))
    for held_rows, neighbour_rows in zip(_branches(held_out), _branches(neighbour), strict=True):
        order = np.argsort(neighbour.channels["temperature"][neighbour_rows])
        temperature, strain = (
            neighbour.channels["temperature"][neighbour_rows][order],
            neighbour.channels["strain"][neighbour_rows][order],
        )
        error[held_rows] = (
            np.interp(held_out.channels["temperature"][held_rows], temperature, strain)
            - held_out.channels["strain"][held_rows]
        )
    hottest = int(np.argmax(held_out.channels["temperature"]))
    return nearest, float(np.sqrt(np.mean((error - error[hottest]) ** 2)))


def residual_row(levels: dict[int, Recording], level: int, residual: np.ndarray) -> Row:
    """Return the shares of the held-out residual on heating and cooling, in the warmer and the colder half.

    Args:
        levels: The recordings by stress, MPa.
        level: The held-out level.
        residual: Its residual.
    """
    temperature = levels[level].channels["temperature"]
    warm = temperature > np.median(temperature)
    heating = np.arange(len(temperature)) <= np.argmax(temperature)
    parts = {
        "heating, warmer half": heating & warm,
        "heating, colder half": heating & ~warm,
        "cooling, warmer half": ~heating & warm,
        "cooling, colder half": ~heating & ~warm,
    }
    shares = {k: float(np.sum(residual[m] ** 2) / np.sum(residual**2)) for k, m in parts.items() if np.any(m)}
    text = ", ".join(f"{100 * v:.0f} % {k}" for k, v in sorted(shares.items(), key=lambda kv: -kv[1]))
    return Row(f"{level} MPa held out: where the residual lives", "-", text, None, shares)


def pictures(levels: dict[int, Recording], level: int, residual: np.ndarray, folder: Path) -> None:
    """Draw the held-out level against its temperature, and its residual row by row.

    Args:
        levels: The recordings by stress, MPa.
        level: The held-out level.
        residual: Its residual.
        folder: Where the pictures go.
    """
    temperature = levels[level].channels["temperature"]
    measured = 100 * levels[level].channels["strain"]
    curves = [
        Curve("measured", temperature, measured),
        Curve("model", temperature, measured - 100 * residual, dashed=True),
    ]
    draw(
        Chart(f"{level} MPa, held out", "temperature [degC]", "strain [%]", curves),
        folder,
        f"measured_isobaric_{level}",
    )
    lines = [Curve(f"{level} MPa", np.arange(len(residual)), 100 * residual)]
    draw(
        Chart("Held-out residual", "row", "measured - model [%]", lines),
        folder,
        f"measured_isobaric_{level}_residual",
    )


def main() -> None:
    """Print the table."""
    more = {
        "--holdout": {"type": int, "default": USUAL[1], "metavar": "MPA"},
        "--each": {"action": "store_true", "help": "hold out each level in turn"},
    }
    quick = "one level only, whatever --each says, and no search for effects"
    args = arguments(__doc__, data=USUAL[0], quick=quick, more=more)
    if not args.data.is_dir():
        refuse(f"{args.data} is not a folder: give one with ...MPa.txt files by --data")
    levels = read_levels(args.data)
    if args.holdout not in levels or len(levels) < 3:
        refuse(
            f"{args.data} has the levels {', '.join(map(str, levels)) or 'none'} MPa: --holdout needs one of at "
            "least three"
        )
    rows = []
    for level in [args.holdout] if args.quick or not args.each else list(levels):
        say(f"holding out {level} MPa")
        fits, residual = hold_out(levels, level, 3 if args.quick else 10)
        result = fits[0]
        train = 100 * (result.rmse("strain") or np.nan)
        held_out = 100 * float(np.sqrt(np.mean(residual**2)))
        target, target_with_effects = PEERS.get((args.data.resolve().name, level), (None, None))
        rows.append(_error_row(f"{level} MPa held out: RMSE train / held out", target, train, held_out))
        nearest, naive_error = repeat_nearest_level(levels, level)
        rows.append(
            Row(f"{level} MPa held out: {nearest} MPa repeated, held out", "-", f"{100 * naive_error:.3f} %", None)
        )
        if not args.quick:
            say("tracing the residual")
            select, traced = trace_residual(levels, level)
            *_, train_after, held_out_after = (100 * v for v in traced.rmse("strain"))
            effects = " + ".join(traced.refit.effect_set.keys) or "no effect"
            rows.append(
                _error_row(
                    f"{level} MPa held out, with {effects}: RMSE train / held out",
                    target_with_effects,
                    train_after,
                    held_out_after,
                )
            )
            rows += effect_rows(traced, f"{level} MPa held out, {select} MPa selecting: ")
            if args.out:
                title = f"A Flexinol wire under {level} MPa, to which nothing was fitted"
                draw_before_and_after(levels[level], traced, title, args.out / f"isobaric_{level}_before_after.svg")
        agreement_row = agreement(fits)
        rows.append(dataclasses.replace(agreement_row, what=f"{level} MPa held out: {agreement_row.what}"))
        rows += estimate_rows(result, f"{level} MPa held out: ")
        rows.append(residual_row(levels, level, residual))
        if args.out:
            pictures(levels, level, residual, args.out)
    is_usual = (args.data, args.holdout) == (DATA / USUAL[0], USUAL[1])
    words = "" if is_usual else f" --data {args.data.resolve().name} --holdout {args.holdout}"
    finish(rows, args, words=words + " --each" * args.each)


def _error_row(what: str, target: float | None, train: float, held_out: float) -> Row:
    target_text, met = ("-", None) if target is None else (f"<= {target:g} % held out", held_out <= target)
    return Row(
        what, target_text, f"{train:.3f} % / {held_out:.3f} %", met, {"train_percent": train, "held_percent": held_out}
    )


if __name__ == "__main__":
    main()
