"""A wire heated by a constant duty, its thermocouple read in steps of 0.25 K: fit the first half, predict the second.

    python experiments/measured/dongsus.py [LOG] [--quick] [--json FILE] [--write-rig FILE]

LOG is a raw log: time in s, of which one row in six repeats the stamp of the row before, temperature in degC in steps
of 0.25 K, and duty in percent. It is read by ``RIG``; rows with a repeated stamp are left out and counted, and the
others are taken every 0.2 s.

The first half of the heating selects the effects. Each of its blocks of 3 s is left out of a fit in turn and predicted;
a reading stays on a step of 0.25 K for as long, so that errors of neighbouring rows are not independent, but those of
blocks nearly are, and the noise of a fit is a whole step. An effect is accepted if it lowers the error of the blocks by
more than 5 %, by more than a tenth of the scatter of the steps, and with a 95 % interval above zero.

The second half is held out. From each of its rows on, the rest is forecast by a fit of all rows before, as the naive
forecasts use all rows before: the last reading, the mean so far, and a straight line through the last 10 s. There is a
single cycle, so that none can be repeated. A forecast by one fit, of the first half, depends on where the half ends, so
that its error is given next to those from later rows on. Last, the model is fitted to the whole heating, which shows
whether its equations or the data are what is missing.

The wire stays below its transformation. Nothing but its heat balance can be fitted, up to one common factor of heat,
convection and capacity.
"""

from __future__ import annotations

import dataclasses
import shlex
import sys
from pathlib import Path

sys.path.insert(0, str(Path(__file__).resolve().parents[2]))  # the checkout: smajax, tests/reference, experiments

from experiments.common.arm_effects import HeatSoak
from experiments.common.base import DATA, Row, arguments, finish, refuse, say
from experiments.common.converter import step_row
from experiments.common.effect_fit import NOMINAL_ALLOY, EffectFit, EffectFitter
from experiments.common.forecasts import compare, naive_forecasts, rms

import numpy as np
from scipy.stats import bootstrap

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

USUAL = DATA / "dongsus-pwm-temperature" / "0331 test1.csv"
PERIOD = 0.2  # s between rows that are fitted
QUANTUM = 0.25  # K, the steps of the thermocouple's converter
FLOOR = QUANTUM / np.sqrt(12)  # K, scatter of a value that is rounded to such steps
HORIZONS = (1, 5, 10)  # s
LINE = 10.0  # s of readings through which the straight line goes
BLOCK = 3.0  # s; a reading stays on a step for up to 2.8 s of the first half
NAIVE = ("mean so far", "persistence")  # naive forecasts that need no cycle
ORIGINS = (0, 4, 8, 12, 16)  # s after the first half, from which forecasts of the rest have a row of their own
DRAWS = 1000  # samples of the bootstrap: 25 of them lie below its 2.5 % quantile
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
MIN_CUT = 0.05  # relative cut of the error of the blocks left out that an effect must reach
MIN_FALL = 0.1 * FLOOR  # K by which it must fall
MOST_EFFECTS = 3
STEPS = 80


@dataclasses.dataclass(frozen=True)
class Parts:
    """A log and the roles of its rows.

    Attributes:
        whole: All rows.
        blocks: Number of the block that each row of the first half of the heating belongs to; -1 for other rows.
        held: Whether a row is one of the second half of the heating, or later.
        notes: Sentences on rows that were left out.
    """

    whole: Recording
    blocks: np.ndarray
    held: np.ndarray
    notes: tuple[str, ...]

    def readings(self, rows: np.ndarray) -> Recording:
        """Return the log with NaN as temperature of all rows but some.

        Args:
            rows: Whether a row keeps its reading.
        """
        temperature = np.where(rows, self.whole.channels["temperature"], np.nan)
        return dataclasses.replace(self.whole, channels={**self.whole.channels, "temperature": temperature})

    @property
    def fitted(self) -> Recording:
        """Rest, and the first half of the heating."""
        return self.readings(np.arange(len(self.whole)) < self.first)

    @property
    def first(self) -> int:
        """First row of the second half."""
        return int(np.argmax(self.held))


def read_parts(path: Path) -> Parts:
    """Read a log by the rig and cut it into its parts."""
    if not path.is_file():
        refuse(f"{path} is not a file: name a log with time, temperature and duty")
    try:
        recording = parse_rig(RIG, "dongsus.toml").read(path)
    except InputError as error:
        refuse(str(error))
    whole = recording.resample(PERIOD, hold=tuple(recording.channels))
    time = whole.time
    heated = time[whole.channels["duty"] > 0]
    if len(heated) < 5 * LINE / PERIOD / 2:
        refuse(f"{path}: it is heated for {len(heated) * PERIOD:.0f} s: {2.5 * LINE:.0f} s are needed")
    half = (heated[0] + heated[-1]) / 2
    blocks = np.floor((time - heated[0]) / ((half - heated[0]) / round((half - heated[0]) / BLOCK))).astype(int)
    blocks[(time < heated[0]) | (time >= half)] = -1
    return Parts(whole, blocks, time >= half, recording.notes)


def block_errors(fitter: EffectFitter, parts: Parts, fitted: EffectFit) -> np.ndarray:
    """Return the mean squared error of each block in K^2, by a fit without that block.

    Args:
        fitter: The fits.
        parts: The parts of the log.
        fitted: Fit of the first half, whose effects are used and at whose values each fit begins.
    """
    values, errors = parts.whole.channels["temperature"], []
    for number in range(parts.blocks.max() + 1):
        block = parts.blocks == number
        rest = parts.readings(~block & (np.arange(len(block)) < parts.first))
        without = fitter.fit(rest, fitted.effects, [fitted.values], STEPS)[0]
        errors.append(rms((values - fitter.predict(parts.whole, without)["temperature"])[block]) ** 2)
    return np.array(errors)


def fall(before: np.ndarray, after: np.ndarray, axis: int = -1) -> np.ndarray:
    """Return the fall of the RMSE in K from mean squared errors in K^2 along an axis."""
    return np.sqrt(np.mean(before, axis=axis)) - np.sqrt(np.mean(after, axis=axis))


def fall_interval(before: np.ndarray, after: np.ndarray) -> tuple[float, float]:
    """Return the 95 % interval of the fall of the RMSE in K, from blocks that are drawn together for both fits.

    Args:
        before: Mean squared errors of the blocks in K^2.
        after: The same with an effect.
    """
    random = np.random.default_rng(0)
    drawn = bootstrap((before, after), fall, paired=True, n_resamples=DRAWS, method="percentile", rng=random)
    return float(drawn.confidence_interval.low), float(drawn.confidence_interval.high)


def search(fitter: EffectFitter, parts: Parts, rounds: int) -> tuple[list[Row], EffectFit, EffectFit]:
    """Add effects one by one, as long as one lowers the error of the blocks left out enough.

    Returns:
        A row for each round, the fit of the first half without effects, and that with those accepted.
    """
    base = fitter.fit(parts.fitted, (), STARTS, STEPS)[0]
    best, errors, rows = base, block_errors(fitter, parts, base), []
    for number in range(1, rounds + 1):
        fits = {}
        for key, kind in fitter.kinds.items():
            if key in best.effects:
                continue
            starts = []
            for k, origin in ((0, best.values), (-1, best.values), (-1, STARTS[0])):
                shapes = {f"effects.{key}.{name}": values[k] for name, values in kind.shapes}
                starts.append({**origin, **shapes, f"effects.{key}.strength": kind.typical})
            fits[key] = fitter.fit(parts.fitted, (*best.effects, key), starts, STEPS)[0]
        if not fits:
            break
        left_out = {key: block_errors(fitter, parts, fitted) for key, fitted in fits.items()}
        scores = dict(sorted({k: float(np.sqrt(np.mean(e))) for k, e in left_out.items()}.items(), key=lambda i: i[1]))
        key, score = next(iter(scores)), float(np.sqrt(np.mean(errors)))
        low, high = fall_interval(errors, left_out[key])
        accepted = low > 0 and scores[key] < min((1 - MIN_CUT) * score, score - MIN_FALL)
        text = f"{score:.3f} K before; {', '.join(f'{k} {v:.3f}' for k, v in scores.items())}; {key} lowers it by "
        text += f"{low:.3f} .. {high:.3f} K, {'accepted' if accepted else 'not accepted'}"
        what = f"effect {number}: error of blocks left out"
        rows.append(Row(what, "-", text, None, {"before": score, **scores, "fall": [low, high]}))
        say(f"{what}: {text}")
        if not accepted:
            break
        best, errors = fits[key], left_out[key]
    return rows, base, best


@dataclasses.dataclass(frozen=True)
class Forecasts:
    """Forecasts of all rows from each row of the second half on, by a fit of the rows before it.

    Attributes:
        series: Modelled temperature in degC, shape ``(origins, rows)``.
        fits: The fits.
    """

    series: np.ndarray
    fits: tuple[EffectFit, ...]

    def ahead(self, parts: Parts, steps: int) -> np.ndarray:
        """Return the forecast of each row from ``steps`` rows before; of the rows that have one.

        Args:
            parts: The parts of the log.
            steps: Horizon, in rows.
        """
        rows = np.arange(parts.first + steps - 1, len(parts.whole))
        return self.series[rows - steps + 1 - parts.first, rows]

    def rest(self, parts: Parts, k: int) -> np.ndarray:
        """Return the forecast of the rest from the k-th row of the second half on.

        Args:
            parts: The parts of the log.
            k: Number of the row.
        """
        return self.series[k, parts.first + k :]


def forecast_all(fitter: EffectFitter, parts: Parts, fitted: EffectFit) -> Forecasts:
    """Forecast from each row of the second half on.

    Args:
        fitter: The fits.
        parts: The parts of the log.
        fitted: Fit of the first half, whose effects are used.
    """
    fits, series, rows = [fitted], [], np.arange(len(parts.whole))
    for origin in np.flatnonzero(parts.held):
        fits += fitter.fit(parts.readings(rows < origin), fitted.effects, [fits[-1].values, STARTS[0]], STEPS)[:1]
        series.append(fitter.predict(parts.whole, fits[-1])["temperature"])
    return Forecasts(np.array(series), tuple(fits[1:]))


def origin_rows(parts: Parts, before: Forecasts, after: Forecasts) -> list[Row]:
    """Return the errors of forecasts of the rest from several rows on, and from all rows together."""
    values, time, rows = parts.whole.channels["temperature"], parts.whole.time, []
    for seconds in ORIGINS:
        k = round(seconds / PERIOD)
        if k >= len(before.fits):
            break
        rest = values[parts.first + k :]
        errors = {n: rms(rest - f.rest(parts, k)) for n, f in (("before", before), ("after", after))}
        losses = [f.fits[k].values["heat.h0"] for f in (before, after)]
        text = f"{errors['before']:.3f} K before, {errors['after']:.3f} K after; "
        text += f"heat.h0 {losses[0]:.3g} before, {losses[1]:.3g} W/m^2/K after"
        what = f"held out: the rest from {time[parts.first + k]:.0f} s on"
        rows.append(Row(what, "lower after", text, errors["after"] < errors["before"], errors))
    return rows


def forecast_rows(parts: Parts, before: Forecasts, after: Forecasts) -> list[Row]:
    """Return the errors on the second half at each horizon, and of the rest from each of its rows on."""
    values, time = parts.whole.channels["temperature"], parts.whole.time
    rows = origin_rows(parts, before, after)
    last, origins = naive_forecasts(values, values, 1), range(parts.first, parts.first + len(after.fits))
    naive = {n: np.concatenate([np.full(len(values) - k, last[n][k]) for k in origins]) for n in NAIVE}
    naive["straight line"] = np.concatenate([straight_line(time, values, k, time[k:]) for k in origins])
    measured = np.concatenate([values[k:] for k in origins])
    series = [np.concatenate([f.rest(parts, k - parts.first) for k in origins]) for f in (before, after)]
    errors = {"before": rms(measured - series[0]), "after": rms(measured - series[1])}
    text = f"{errors['before']:.3f} K before, {errors['after']:.3f} K after"
    what = "held out: the rest, from each row on"
    rows.append(Row(what, "lower after", text, errors["after"] < errors["before"], errors))
    rows.append(compare(f"{what}, naive forecasts", measured, series[1], naive, "K"))
    for horizon in HORIZONS:
        steps = round(horizon / PERIOD)
        counted = slice(parts.first + steps - 1, None)
        naive = {n: s[counted] for n, s in naive_forecasts(values, values, steps).items() if n in NAIVE}
        ends = range(parts.first, len(values) - steps + 1)
        lines = [straight_line(time, values, k, time[k + steps - 1 : k + steps]) for k in ends]
        naive["straight line"] = np.concatenate(lines)
        what = f"held out: {horizon} s ahead"
        errors = {n: rms(values[counted] - f.ahead(parts, steps)) for n, f in (("before", before), ("after", after))}
        text = f"{errors['before']:.3f} K before, {errors['after']:.3f} K after"
        rows.append(Row(what, "lower after", text, errors["after"] < errors["before"], errors))
        rows.append(compare(f"{what}, naive forecasts", values[counted], after.ahead(parts, steps), naive, "K"))
    return rows


def straight_line(time: np.ndarray, values: np.ndarray, origin: int, at: np.ndarray) -> np.ndarray:
    """Return the forecast at some times by a straight line through the last readings before a row."""
    recent = slice(origin - round(LINE / PERIOD), origin)
    return np.polyval(np.polyfit(time[recent] - time[origin], values[recent], 1), at - time[origin])


def report_rows(fitter: EffectFitter, parts: Parts, base: EffectFit, best: EffectFit) -> list[Row]:
    """Return the errors of both halves before and after, the forecasts, and the values of the last fit.

    Args:
        fitter: The fits.
        parts: The parts of the log.
        base: Fit of the first half without effects.
        best: That with effects.
    """
    values = parts.whole.channels["temperature"]

    def error(fitted: EffectFit, rows: np.ndarray) -> float:
        return rms((values - fitter.predict(parts.whole, fitted)["temperature"])[rows])

    known, effects = ~parts.held, ", ".join(best.effects) or "no effect"
    errors = {"before": error(base, known), "after": error(best, known)}
    text = f"{errors['before']:.3f} K before, {errors['after']:.3f} K after ({effects})"
    what = "fitted half: simulation without readings"
    rows = [Row(what, "lower after", text, errors["after"] < errors["before"], errors)]
    rows += forecast_rows(parts, *(forecast_all(fitter, parts, fitted) for fitted in (base, best)))
    everything = fitter.fit(parts.whole, best.effects, [best.values, *STARTS], STEPS)[0]
    losses = [fitted.values["heat.h0"] for fitted in (best, everything)]
    final = error(everything, parts.held)
    text = f"{final:.3f} K; heat.h0 {losses[1]:.3g} instead of {losses[0]:.3g} W/m^2/K"
    what, target = "second half, if the whole heating is fitted", f"<= {FLOOR:.3f} K"
    rows.append(Row(what, target, text, final <= FLOOR, {"rmse_K": final}))
    for unknown in fitter.first.unknowns:
        if not unknown.name.startswith("effects.") or unknown.name.split(".")[1] in best.effects:
            rows.append(Row(unknown.name, "-", f"{best.values[unknown.name]:.4g} {unknown.unit}", None))
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
                "default": USUAL,
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
    steps = step_row(parts.whole.time, parts.whole.channels["temperature"], parts.first, QUANTUM, "degC")
    rows = [Row("rows", "-", dropped, None), steps, *rounds, *report_rows(fitter, parts, base, best)]
    finish(rows, args, words="" if args.log == USUAL else f" {shlex.quote(args.log.name)}")


if __name__ == "__main__":
    main()
