"""A wire heated by a constant duty, its thermocouple read in steps of 0.25 K: fit the first half, predict the second.

    python experiments/measured/dongsus.py [LOG] [--quick] [--json FILE] [--write-rig FILE]

LOG is a raw log: time in s, of which one row in six repeats the stamp of the row before, temperature in degC in steps
of 0.25 K, and duty in percent. It is read by ``RIG``; rows with a repeated stamp are left out and counted, and the
others are taken every 0.2 s.

The first half of the heating is fitted. Every third of its blocks of 2 s selects, since its last third in time would
have no part of the beginning, where a sensor's lag shows. An effect is accepted if it lowers the error there by more
than 5 % and by a tenth of the scatter of the steps of 0.25 K. A reading stays on a step for seconds, so that errors of
neighbouring rows are not independent: the noise of a fit is a whole step. The second half is predicted from the
recorded input, without a reading, and at several horizons. There is a single cycle, so that none can be repeated; a
straight line through the last 10 s takes the place of that naive forecast. Last, the model is fitted to the whole
heating, which shows whether its equations or the data of the first half are what is missing.

The wire stays below its transformation. Nothing but its heat balance can be fitted, up to one common factor of heat,
convection and capacity.
"""

from __future__ import annotations

import dataclasses
import sys
from pathlib import Path

sys.path.insert(0, str(Path(__file__).resolve().parents[2]))  # the checkout: smajax, tests/reference, experiments

from experiments.common.arm_effects import HeatSoak
from experiments.common.base import DATA, Row, arguments, finish, refuse, say
from experiments.common.effect_fit import NOMINAL_ALLOY, EffectFit, EffectFitter
from experiments.common.forecasts import choose_correction, compare, naive_forecasts, rms

import numpy as np

from smajax.errors import InputError
from smajax.files.rig_file import parse_rig
from smajax.plant.effects import catalogue
from smajax.recordings.recording import Recording

RIG = f"""
schema = 1
[rig]
kind = "dead-weight"
control = "duty"

[recording]
on_bad_rows = "drop"                         # rows that repeat a time stamp
[channels]
time = {{column = "Time(sec)", unit = "s"}}
temperature = {{column = "Temperature(C)", unit = "degC"}}
duty = {{column = "PWM(%)", unit = "%"}}

[drive]
supply = "1 V"                               # nominal; the fit has it
{NOMINAL_ALLOY}detwinning_finish_stress = "100 MPa"
[heat]
h0 = "30 W/m^2/K"
capacity = "3 MJ/m^3/K"
[wire]
diameter = "0.5 mm"
length = "200 mm"
[load]
mass = "100 g"
[environment]
ambient = "28.75 degC"
[fit]
free = ["drive.supply", "heat.h0", "environment.ambient"]
observe = ["temperature"]
noise = {{ temperature = "0.25 K" }}
"""

PERIOD = 0.2  # s between rows that are fitted
QUANTUM = 0.25  # K, the steps of the thermocouple's converter
FLOOR = QUANTUM / np.sqrt(12)  # K, scatter of a value that is rounded to such steps
HORIZONS = (1, 5, 10)  # s
LINE = 10.0  # s of readings through which the straight line goes
BLOCK = 2.0  # s; every third block of the fitted heating selects
STEP = 0.5  # s
PRIOR_DEVIATION = {"drive.supply": 1.0, "heat.h0": 30.0, "environment.ambient": 0.2}
CANDIDATES = (
    "thermocouple-lag",
    "thermocouple-embedding",
    "coating",
    "end-conduction",
    "heat-soak",
    "convection-temperature",
)
STARTS = ({"drive.supply": 0.5}, {"drive.supply": 1.5, "heat.h0": 60.0}, {"drive.supply": 0.3, "heat.h0": 10.0})
MIN_CUT = 0.05  # relative cut of the selection part's error that an effect must reach
MIN_FALL = 0.1 * FLOOR  # K by which it must fall
MOST_EFFECTS = 3
STEPS = 80


@dataclasses.dataclass(frozen=True)
class Parts:
    """A log with the same rows for each role; its temperature is NaN in rows of another role.

    Attributes:
        whole: All rows.
        train: Rest, and two of three blocks of the first half of the heating.
        select: The other blocks of that half.
        fitted: Both.
        early: Rest, and the first two thirds of that half in time.
        third: End of the first two thirds of that half, s.
        held: Rows of the second half.
        notes: Sentences on rows that were left out.
    """

    whole: Recording
    train: Recording
    select: Recording
    fitted: Recording
    early: Recording
    third: float
    held: np.ndarray
    notes: tuple[str, ...]


def read_parts(path: Path) -> Parts:
    """Read a log by the rig and cut it into its parts."""
    if not path.is_file():
        refuse(f"{path} is not a file: name a log with time, temperature and duty")
    try:
        recording = parse_rig(RIG, "dongsus.toml").read(path)
    except InputError as error:
        refuse(str(error))
    whole = recording.resample(PERIOD, hold=tuple(recording.channels))
    heated = whole.time[whole.channels["duty"] > 0]
    if len(heated) < 5 * LINE / PERIOD / 2:
        refuse(f"{path}: it is heated for {len(heated) * PERIOD:.0f} s: {2.5 * LINE:.0f} s are needed")
    half = (heated[0] + heated[-1]) / 2
    third = float(heated[0] + (half - heated[0]) * 2 / 3)
    selects = (whole.time >= heated[0]) & (np.floor((whole.time - heated[0]) / BLOCK) % 3 == 2)

    def with_rows(rows: np.ndarray) -> Recording:
        temperature = np.where(rows, whole.channels["temperature"], np.nan)
        return dataclasses.replace(whole, channels={**whole.channels, "temperature": temperature})

    time = whole.time
    return Parts(
        whole,
        with_rows((time < half) & ~selects),
        with_rows((time < half) & selects),
        with_rows(time < half),
        with_rows(time < third),
        third,
        (time >= half) & (time <= heated[-1]),
        recording.notes,
    )


def error(fitter: EffectFitter, part: Recording, fitted: EffectFit) -> float:
    """Return the RMSE of a simulation in K where the temperature of a part is not NaN."""
    return rms(part.channels["temperature"] - fitter.predict(part, fitted)["temperature"])


def search(fitter: EffectFitter, parts: Parts, rounds: int) -> tuple[list[Row], EffectFit, EffectFit]:
    """Add effects one by one, as long as one lowers the error on the selection part enough.

    Returns:
        A row for each round, the base fit, and the last fit.
    """
    base = fitter.fit(parts.train, (), STARTS, STEPS)[0]
    best, score, rows = base, error(fitter, parts.select, base), []
    for number in range(1, rounds + 1):
        fits = {}
        for key, kind in fitter.kinds.items():
            if key in best.effects:
                continue
            starts = []
            for k, origin in ((0, best.values), (-1, best.values), (-1, STARTS[0])):
                shapes = {f"effects.{key}.{name}": values[k] for name, values in kind.shapes}
                starts.append({**origin, **shapes, f"effects.{key}.strength": kind.typical})
            fits[key] = fitter.fit(parts.train, (*best.effects, key), starts, STEPS)[0]
        scores = {key: error(fitter, parts.select, fitted) for key, fitted in fits.items()}
        scores = dict(sorted(scores.items(), key=lambda item: item[1]))
        if not scores:
            break
        key = next(iter(scores))
        accepted = scores[key] < min((1 - MIN_CUT) * score, score - MIN_FALL)
        text = ", ".join(f"{k} {v:.3f}" for k, v in scores.items())
        what = f"effect {number}: error on the selection part"
        text = f"{score:.3f} K before; {text}; {f'{key} accepted' if accepted else 'none accepted'}"
        rows.append(Row(what, "-", text, None, scores))
        say(f"{what}: {text}")
        if not accepted:
            break
        best, score = fits[key], scores[key]
    return rows, base, best


def forecast_rows(parts: Parts, modelled: np.ndarray, early: np.ndarray) -> list[Row]:
    """Return the errors on the second half at each horizon, and of the prediction without a reading of it.

    Args:
        parts: The parts of the log.
        modelled: Temperature by the fit to the first half, degC.
        early: Temperature by a fit to the first two thirds of that half; the last third chooses the correction.
    """
    values, time, held = parts.whole.channels["temperature"], parts.whole.time, parts.held
    chosen = slice(int(np.sum(time < parts.third)), int(np.argmax(held)))
    ahead = [round(h / PERIOD) for h in HORIZONS]
    rows = []
    for horizon, steps in zip(HORIZONS, ahead, strict=True):
        naive = {n: s[held] for n, s in naive_forecasts(values, values, steps).items() if n != "last cycle"}
        naive["straight line"] = straight_lines(time, values, steps)[held]
        correction = choose_correction([(values, early, chosen)], steps, PERIOD)
        rows.append(Row(f"correction {horizon} s ahead", "-", str(correction), None, dataclasses.asdict(correction)))
        forecast = correction.forecast(values, modelled, steps, PERIOD)[held]
        rows.append(compare(f"held out: {horizon} s ahead", values[held], forecast, naive, "K"))
    first = int(np.argmax(held))
    last = naive_forecasts(values, values, 1)
    naive = {n: np.full(np.sum(held), last[n][first]) for n in ("mean so far", "persistence")}
    recent = (time < time[first]) & (time >= time[first] - LINE)
    naive["straight line"] = np.polyval(np.polyfit(time[recent], values[recent], 1), time[held])
    what = f"held out: the whole half ({time[held][-1] - time[first]:.0f} s), no reading used"
    return [*rows, compare(what, values[held], modelled[held], naive, "K")]


def straight_lines(time: np.ndarray, values: np.ndarray, steps: int) -> np.ndarray:
    """Return the forecast of each row by a straight line through the last readings up to some rows before."""
    count, result = round(LINE / PERIOD), np.full(len(values), np.nan)
    for k in range(count - 1 + steps, len(values)):
        recent = slice(k - steps - count + 1, k - steps + 1)
        result[k] = np.polyval(np.polyfit(time[recent] - time[k], values[recent], 1), 0.0)
    return result


def report_rows(fitter: EffectFitter, parts: Parts, base: EffectFit, best: EffectFit) -> list[Row]:
    """Return the errors of both halves before and after, the forecasts, and the values of the last fit.

    Args:
        fitter: The fits.
        parts: The parts of the log.
        base: The fit of the training part without effects.
        best: That with effects.
    """
    before, after = (fitter.fit(parts.fitted, f.effects, [f.values], STEPS)[0] for f in (base, best))
    readings = np.where(parts.held, parts.whole.channels["temperature"], np.nan)
    held = dataclasses.replace(parts.whole, channels={**parts.whole.channels, "temperature": readings})
    rows, effects = [], ", ".join(best.effects) or "no effect"
    for what, part in (("fitted half", parts.fitted), ("held-out half", held)):
        errors = {"before": error(fitter, part, before), "after": error(fitter, part, after)}
        text = f"{errors['before']:.3f} K before, {errors['after']:.3f} K after ({effects})"
        is_lower = errors["after"] < errors["before"]
        rows.append(Row(f"{what}: simulation without readings", "lower after", text, is_lower, errors))
    final, target = error(fitter, held, after), f"<= {FLOOR:.3f} K"
    rows.append(Row("held-out half: steps of the sensor", target, f"{final:.3f} K", final <= FLOOR))
    early = fitter.fit(parts.early, best.effects, [best.values], STEPS)[0]
    modelled = [fitter.predict(parts.whole, fitted)["temperature"] for fitted in (after, early)]
    rows += forecast_rows(parts, *modelled)
    everything = fitter.fit(parts.whole, best.effects, [after.values, best.values], STEPS)[0]
    values = [fitted.values["heat.h0"] for fitted in (after, everything)]
    final = error(fitter, held, everything)
    text = f"{final:.3f} K; heat.h0 {values[1]:.3g} instead of {values[0]:.3g} W/m^2/K"
    rows.append(Row("second half, if the whole heating is fitted", target, text, final <= FLOOR, {"rmse_K": final}))
    for unknown in fitter.first.unknowns:
        if not unknown.name.startswith("effects.") or unknown.name.split(".")[1] in after.effects:
            rows.append(Row(unknown.name, "-", f"{after.values[unknown.name]:.4g} {unknown.unit}", None))
    return rows


def main() -> None:
    """Print the table."""
    args = arguments(
        __doc__,
        quick="one effect only",
        more={
            "--write-rig": {
                "type": Path,
                "metavar": "FILE",
                "help": "write the rig file for smajax check and fit, and end",
            },
            "log": {
                "nargs": "?",
                "type": Path,
                "default": DATA / "dongsus-pwm-temperature" / "0331 test1.csv",
                "metavar": "LOG",
                "help": "the log",
            },
        },
    )
    if args.write_rig:
        args.write_rig.write_text(RIG.lstrip(), encoding="utf-8")
        return
    parts = read_parts(args.log)
    for note in parts.notes:
        say(note)
    kinds = {**catalogue(), HeatSoak.key: HeatSoak}
    candidates = ("thermocouple-embedding",) if args.quick else CANDIDATES
    rig = parse_rig(RIG, "dongsus.toml")
    fitter = EffectFitter(rig, {k: kinds[k] for k in candidates}, PRIOR_DEVIATION, [parts.fitted], STEP)
    rounds, base, best = search(fitter, parts, 1 if args.quick else MOST_EFFECTS)
    dropped = "; ".join(n for n in parts.notes if "dropped" in n) or "none left out"
    rows = [Row("rows", "-", dropped, None), *rounds, *report_rows(fitter, parts, base, best)]
    finish(rows, args)


if __name__ == "__main__":
    main()
