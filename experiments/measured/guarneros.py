"""A wire against a force sensor, logged by a micro-controller: fit one log, forecast the second half of others.

    python experiments/measured/guarneros.py [FIT SELECT_AND_HOLDOUT ...] [--quick] [--json FILE] [--write-rig FILE]

FIT and SELECT_AND_HOLDOUT are raw logs: temperature of the wire and of the surroundings in degC, force in counts of a
converter, and the register of a pulse-width modulation, one row each 19 ms. They are read by ``RIG``: a register above
255 is one that is always on. Such values come from corrupt packets, but the wire is heated by them, as the rows "single
rows of a full register" show. Rows are put together into blocks of about a second: means of the input, which keep that
heat, and medians of the readings.

The model is fitted to FIT, without effects and with ``EFFECTS`` together. Further effects are added one by one, as
long as one lowers the error on the first half of SELECT_AND_HOLDOUT by more than 5 %. The second half is forecast at
several horizons with the recorded input. The latest errors of the model correct its
forecasts; how, is chosen on the second half of FIT and the first half of SELECT_AND_HOLDOUT. Several logs may be
named to be forecast; the first of them selects.

These data determine neither the stress in the wire nor its size. Diameter, length, stiffness and preload are nominal,
and every fit has a prior from data sheets (``PRIOR_DEVIATION``).
"""

from __future__ import annotations

import dataclasses
import itertools
import sys
from collections.abc import Sequence
from pathlib import Path

sys.path.insert(0, str(Path(__file__).resolve().parents[2]))  # the checkout: smajax, tests/reference, experiments

from experiments.common.arm_effects import HeatSoak
from experiments.common.base import DATA, Row, arguments, finish, refuse, say
from experiments.common.blocks import block_rows
from experiments.common.effect_fit import NOMINAL_ALLOY, EffectFit, EffectFitter
from experiments.common.forecasts import (
    Correction,
    choose_correction,
    compare,
    cycle_starts,
    last_cycle,
    naive_forecasts,
    rms,
)
from experiments.common.packets import packet_rows

import numpy as np

from smajax.errors import InputError
from smajax.files.rig_file import parse_rig
from smajax.plant.effects import catalogue
from smajax.recordings.recording import Recording

RIG = f"""
schema = 1
[rig]
kind = "bias-spring"
control = "duty"

[recording]
sample_period = "19 ms"                      # the file has no time
on_bad_rows = "drop"                         # rows that the logger cut or garbled; they are counted
[channels]
ignore = ["Temperature derivative"]
temperature = {{column = "SMA temperature", unit = "degC"}}
ambient = {{column = "Ambiente temperature", unit = "degC"}}
force = {{column = "Force sensor", factor = -0.008694436, offset = 7.486899, unit = "N"}}
duty = {{column = "Control input", full_scale = 255, limits = [0, 1]}}

[drive]
supply = "1 V"                               # nominal; the fit has it
{NOMINAL_ALLOY}detwinning_finish_stress = "1 MPa"
[heat]
h0 = "10 W/m^2/K"
capacity = "3 MJ/m^3/K"
[wire]
diameter = "0.5 mm"
length = "100 mm"
[spring]
preload = "0.56 N"
stiffness = "0.17 N/mm"
[fit]
free = ["drive.supply", "heat.h0", "initial.temperature",
        "material.austenite_shift", "material.austenite_finish", "material.martensite_shift",
        "material.martensite_start", "material.max_transformation_strain",
        "sensor.force_offset", "sensor.temperature_offset"]
observe = ["temperature", "force"]
noise = {{ temperature = "1 K", force = "0.03 N" }}
"""

ROWS = 53  # of the log in a block: 1.007 s
HORIZONS = (1, 5, 10, 20)  # s; what moves the readings further ahead is not in the recorded input
FEWEST_BLOCKS = 240  # of a log, some four minutes: both halves then hold several of the longest horizons
CHANNELS = {"temperature": "K", "force": "N"}
DRIFTING = ("force",)  # the zero of the load cell differs from log to log, so that a correction of it does not decay
STEP = 2.0  # s; longer than a block, so that each block is one step
# Standard deviations of the prior about the rig's values (SI, K).
PRIOR_DEVIATION = {
    "drive.supply": 3.0,
    "heat.h0": 20.0,
    "initial.temperature": 1.0,
    "material.austenite_shift": 10.0,
    "material.austenite_finish": 15.0,
    "material.martensite_shift": 10.0,
    "material.martensite_start": 15.0,
    "material.max_transformation_strain": 0.02,
    "sensor.force_offset": 0.05,
    "sensor.temperature_offset": 2.0,
}
# What such a rig has in any case, from physics: they are fitted together, since one that is added alone to a fit that
# has compensated for all of them stays near that fit.
EFFECTS = ("infrared-spot", "latent-heat", "gradual-transformation")
CANDIDATES = (
    *EFFECTS,
    "coating",
    "end-conduction",
    "heat-soak",
    "convection-temperature",
    "heat-capacity",
    "temperature-distribution",
    "minor-loop-shape",
    "creep",
    "thermocouple-lag",
)
# Start points of the base fit: the wire transforms at temperatures that its thermometer reads, or above them.
STARTS = (
    {"material.austenite_shift": -30.0, "material.martensite_shift": -5.0},
    {"material.austenite_shift": -15.0, "drive.supply": 1.5, "heat.h0": 15.0},
    {"drive.supply": 1.5, "heat.h0": 10.0},
)
MIN_CUT = 0.05  # relative cut of the selection part's error that an effect must reach
MOST_ADDED = 3  # effects that are added to ``EFFECTS``
TIMES = 10  # start points that are drawn
STEPS = 60


def read_log(path: Path) -> tuple[Recording, list[Row]]:
    """Read a raw log by the rig, and put its rows together into blocks; return them, and rows on corrupt packets."""
    if not path.is_file():
        refuse(f"{path} is not a file: name a log to fit, and one or more to be forecast")
    try:
        recording = parse_rig(RIG, "guarneros.toml").read(path)
    except InputError as error:
        refuse(str(error))
    for note in recording.notes:
        say(note)
    blocks = block_rows(recording, ROWS, ("duty",))
    if len(blocks) < FEWEST_BLOCKS:
        refuse(f"{path}: {len(recording)} rows are too few: {FEWEST_BLOCKS * ROWS} are needed")
    return blocks, packet_rows(recording, halves(recording)[1])


def halves(log: Recording) -> tuple[slice, slice]:
    """Return the rows of the first and of the second half of a log."""
    middle = len(log) // 2
    return slice(0, middle), slice(middle, len(log))


def errors(fitter: EffectFitter, log: Recording, fitted: EffectFit, rows: slice) -> dict[str, float]:
    """Return the RMSE of each channel of a simulation on some rows, with no reading used."""
    modelled = fitter.predict(log, fitted)
    return {c: rms((log.channels[c] - modelled[c])[rows]) for c in CHANNELS}


def selection_error(fitter: EffectFitter, log: Recording, fitted: EffectFit) -> float:
    """Return the error over the noise on the first half of a log, pooled over the channels."""
    noise = fitter.rig.fit.noise
    parts = [v / noise[c] for c, v in errors(fitter, log, fitted, halves(log)[0]).items()]
    return float(np.sqrt(np.mean(np.square(parts))))


def start_values(fitter: EffectFitter, key: str) -> list[dict[str, float]]:
    """Return the start values of an effect's parameters: a third and all of its usual strength, at its shapes."""
    kind = fitter.kinds[key]
    shapes = [{f"effects.{key}.{name}": values[k] for name, values in kind.shapes} for k in (0, -1)]
    strength = f"effects.{key}.strength"
    return [{strength: 0.3 * kind.typical, **shapes[0]}, {strength: kind.typical, **shapes[1]}]


def search(
    fitter: EffectFitter, fit_log: Recording, select_log: Recording, first: EffectFit
) -> tuple[list[Row], EffectFit]:
    """Add effects one by one, as long as one lowers the error on the selection part by more than ``MIN_CUT``.

    Args:
        fitter: The fits.
        fit_log: The log that is fitted.
        select_log: The log whose first half selects.
        first: The fit to which effects are added.

    Returns:
        A row for each round, and the last fit.
    """
    best, score, rows = first, selection_error(fitter, select_log, first), []
    while len(rows) < MOST_ADDED:
        fits = {}
        for key in fitter.kinds:
            if key not in best.effects:
                starts = [{**best.values, **start} for start in start_values(fitter, key)]
                fits[key] = fitter.fit(fit_log, (*best.effects, key), starts, STEPS)[0]
        scores = {key: selection_error(fitter, select_log, fitted) for key, fitted in fits.items()}
        scores = dict(sorted(scores.items(), key=lambda item: item[1]))
        if not scores:
            break
        key = next(iter(scores))
        accepted = scores[key] < (1 - MIN_CUT) * score
        verdict = f"{key} accepted" if accepted else "none accepted"
        text = f"{score:.3f} before; {', '.join(f'{k} {v:.3f}' for k, v in scores.items())}; {verdict}"
        what = f"effect {len(best.effects) + 1}: error over noise on the selection part"
        rows.append(Row(what, "-", text, None, scores))
        say(f"{what}: {text}")
        if not accepted:
            break
        best, score = fits[key], scores[key]
    return rows, best


def fit_jointly(
    fitter: EffectFitter, fit_log: Recording, select_log: Recording, times: int
) -> tuple[list[Row], EffectFit, EffectFit]:
    """Fit without effects, and with all of ``EFFECTS`` together, each from several start points.

    Args:
        fitter: The fits.
        fit_log: The log that is fitted.
        select_log: The log whose first half selects.
        times: Number of start points that are drawn.

    Returns:
        A row for each of the two, and their best fits.
    """
    rows, fits = [], []
    for effects in ((), EFFECTS):
        starts = [*STARTS, *fitter.draw_starts(effects, times, seed=0)]
        ends = fitter.fit(fit_log, effects, starts, STEPS)
        fits.append(ends[0])
        close = sum(f.cost <= 1.05 * ends[0].cost for f in ends)
        error = selection_error(fitter, select_log, ends[0])
        text = f"{error:.3f}; cost {ends[0].cost:.1f}, within 5 % of it {close} of {len(ends)} start points"
        what = f"{' + '.join(effects) or 'no effect'}: error over noise on the selection part"
        rows.append(Row(what, "-", text, None, {"error": error}))
        say(f"{what}: {text}")
    return rows, *fits


def choose_corrections(
    fitter: EffectFitter, fitted: EffectFit, fit_log: Recording, select_log: Recording
) -> dict[tuple[str, int], Correction]:
    """Return how the latest errors correct the model, by channel and horizon.

    They are chosen on the second half of the fitted log, the part of its cycle that is held out of the others, and on
    the first half of the log that selects.
    """
    period = float(fit_log.time[1] - fit_log.time[0])
    parts = [(fit_log, halves(fit_log)[1]), (select_log, halves(select_log)[0])]
    modelled = [fitter.predict(log, fitted) for log, _ in parts]
    corrections = {}
    for channel, horizon in itertools.product(CHANNELS, HORIZONS):
        series = [(log.channels[channel], m[channel], rows) for (log, rows), m in zip(parts, modelled, strict=True)]
        corrections[channel, horizon] = choose_correction(series, round(horizon / period), period, channel in DRIFTING)
    return corrections


def forecast_rows(
    fitter: EffectFitter,
    fitted: EffectFit,
    log: Recording,
    fit_log: Recording,
    corrections: dict[tuple[str, int], Correction],
) -> list[Row]:
    """Return the errors of the forecasts of the second half of a log at each horizon."""
    period = float(log.time[1] - log.time[0])
    modelled, held = fitter.predict(log, fitted), halves(log)[1]
    rows = []
    for channel, unit in CHANNELS.items():
        values = log.channels[channel]
        earlier = (fit_log.time, fit_log.channels["duty"], fit_log.channels[channel])
        repeated = last_cycle(log.time, log.channels["duty"], values, earlier)
        for horizon in HORIZONS:
            ahead = round(horizon / period)
            naive = {n: s[held] for n, s in naive_forecasts(values, repeated, ahead).items()}
            forecast = corrections[channel, horizon].forecast(values, modelled[channel], ahead, period)[held]
            what = f"{log.name}, held out: {channel}, {horizon} s ahead"
            rows.append(compare(what, values[held], forecast, naive, unit))
    return rows


def simulation_rows(
    fitter: EffectFitter, base: EffectFit, final: EffectFit, fit_log: Recording, logs: Sequence[Recording]
) -> list[Row]:
    """Return the errors of plain simulations, which use no reading, before and after the effects were added."""
    parts = [(f"{fit_log.name}, fitted", fit_log, slice(None))]
    for i, log in enumerate(logs):
        first, second = halves(log)
        parts.append((f"{log.name}, first half ({'selects' if i == 0 else 'not used'})", log, first))
        parts.append((f"{log.name}, held out", log, second))
    rows = []
    for what, log, part in parts:
        before, after = (errors(fitter, log, fitted, part) for fitted in (base, final))
        text = "; ".join(f"{c} {before[c]:.3g} before, {after[c]:.3g} {u} after" for c, u in CHANNELS.items())
        met = all(after[c] < before[c] for c in CHANNELS)
        rows.append(Row(f"{what}: simulation without readings", "lower after", text, met, {"before": before, **after}))
    return rows


def parameter_rows(fitter: EffectFitter, final: EffectFit) -> list[Row]:
    """Return the values of the last fit."""
    rows = []
    for unknown in fitter.first.unknowns:
        if not unknown.name.startswith("effects.") or unknown.name.split(".")[1] in final.effects:
            rows.append(Row(unknown.name, "-", f"{final.values[unknown.name]:.4g} {unknown.unit}", None))
    return rows


def main() -> None:
    """Print the table."""
    folder = DATA / "guarneros-sma-force"
    args = arguments(
        __doc__,
        quick="few start points, and no further effects",
        more={
            "--write-rig": {
                "type": Path,
                "metavar": "FILE",
                "help": "write the rig file for smajax check and fit, and end",
            },
            "logs": {
                "nargs": "*",
                "type": Path,
                "default": [folder / "AB0.csv", folder / "AB1.csv"],
                "metavar": "LOG",
                "help": "the log to fit, and those whose second half is forecast; the first of these selects",
            },
        },
    )
    if args.write_rig:
        args.write_rig.write_text(RIG.lstrip(), encoding="utf-8")
        return
    if len(args.logs) < 2:
        refuse("one log is named: name the one to fit and at least one to be forecast")
    read = [read_log(path) for path in args.logs]
    fit_log, *logs = [log for log, _ in read]
    kinds = {**catalogue(), HeatSoak.key: HeatSoak}
    candidates = EFFECTS if args.quick else CANDIDATES
    rig = parse_rig(RIG, "guarneros.toml")
    fitter = EffectFitter(rig, {k: kinds[k] for k in candidates}, PRIOR_DEVIATION, [fit_log, *logs], STEP)
    rounds, base, joint = fit_jointly(fitter, fit_log, logs[0], 1 if args.quick else TIMES)
    added, final = search(fitter, fit_log, logs[0], joint)
    rounds += added
    corrections = choose_corrections(fitter, final, fit_log, logs[0])
    rows = [row for _, packets in read for row in packets]
    rows += [*rounds, *simulation_rows(fitter, base, final, fit_log, logs)]
    for (channel, horizon), correction in corrections.items():
        what = f"correction of {channel}, {horizon} s ahead"
        rows.append(Row(what, "-", str(correction), None, dataclasses.asdict(correction)))
    for log in logs:
        starts = ", ".join(f"{t:.0f}" for t in cycle_starts(log.time, log.channels["duty"]))
        rows.append(Row(f"{log.name}: heating begins at", "-", f"{starts} s", None))
        rows += forecast_rows(fitter, final, log, fit_log, corrections)
    is_default = args.logs == [folder / "AB0.csv", folder / "AB1.csv"]
    words = "" if is_default else "".join(f" {path.name}" for path in args.logs)
    finish([*rows, *parameter_rows(fitter, final)], args, words=words)


if __name__ == "__main__":
    main()
