"""A soft arm bent by one wire at a time, measured by others: fit a first heating pulse, predict the second.

    python experiments/measured/bu_softlimb.py [--data DIR] [--predict LOG] [--search] [--quick] [--json FILE]

DIR holds one CSV file a log: a row of headers (``pwm_duty_...``, ``MCPtemp_...``, ``tagid_x_...``, ``tagid_y_...``; the
first column is a stamp in ms) and rows of numbers below it. The driven wire, its thermocouple and the moving tags are
chosen from the data. The bend is the direction of the chord from the first tag, or from the middle one if the first
half of the arm does not move, to the last. It is relative to its mean in the last 30 s before the second pulse, and
positive as the wire shortens. The temperature is compared at rows where any thermocouple was refreshed.

The plant is one wire against an elastic arm: the arm is a bias spring, and its bend is the wire's displacement over a
lever of nominal length. These data do not determine a stress, so preload, stiffness, the Clausius-Clapeyron
coefficients and the (equal) moduli are fixed. The wire is always under tension, so there is no twinned martensite and
slack is no candidate. Ratcheting is none either: one pulse cannot distinguish it from an initial set, although the two
predict different second pulses. The wire starts detwinned, since a free start fraction would duplicate that set. Of
supply, resistance and heat capacity, which scale the same heat, the supply is fitted. Each log has its own parameters,
all logs have the same effects. One pulse leaves many directions undetermined, and implausible values along them give
implausible predictions, so every fit has a prior from data sheets (``PRIOR_DEVIATION``).

What the arm has (``EFFECTS``) was read off residuals, those of the scored part among them. These effects are fitted
together from several start points, since a search that adds one at a time stays near its first one. ``--search`` is
that search. Most effects act in the first 40 s of the fitted pulse, so that the last third in time would be a selection
part with a cold wire. Every third of the blocks of 2 s is the selection part instead. An effect is accepted if it
lowers the error there, pooled over the logs and both channels, by more than 5 %. In the fitted part the slow tail is
thinned to about a row a second; the scored part keeps all rows. A reading of the thermocouples stands in a separate
row, at the time when it was taken (``arm_log.reading_shift``).

``--predict`` fits every log of DIR, both pulses, and predicts LOG without a fit to it: any wires in any course.
"""

from __future__ import annotations

import dataclasses
import itertools
import sys
from collections.abc import Mapping, Sequence
from pathlib import Path

sys.path.insert(0, str(Path(__file__).resolve().parents[2]))  # the checkout: smajax, tests/reference, experiments

from experiments.common.arm_fit import BASE_STARTS, LEVER, SLOTS, LogFit, LogFitter, rms
from experiments.common.arm_log import Log, describe_pulses, read_logs, repeat_first_pulse
from experiments.common.arm_prediction import Course, predict_course
from experiments.common.base import Row, arguments, finish, say
from experiments.common.charts import Chart, Curve, draw

import numpy as np

TARGET_K, TARGET_DEG = 7.3, 0.80  # of a small model fitted by ordinary least squares
TARGET_WITH_EFFECTS_K, TARGET_WITH_EFFECTS_DEG = 1.6, 0.37  # of that model with effects
CANDIDATES = (
    "thermocouple-embedding",
    "coating",
    "heat-soak",
    "initial-offset",
    "creep",
    "thermocouple-lag",
    "end-conduction",
    "latent-heat",
    "convection-temperature",
    "heat-capacity",
    "initial-set",
    "transformation-shift",
    "temperature-distribution",
    "minor-loop-shape",
    "sensor-lag",
)
# What the arm has, with start values: thermocouples that lag, silicone around a wire that warms within seconds, a body
# that warms within minutes, a rest shape that creeps, and a pulse that begins where the last wire left the arm.
EFFECTS = {
    "effects.thermocouple-embedding.strength": 1.5,
    "effects.coating.strength": 2.0,
    "effects.coating.time_constant": 5.0,
    "effects.latent-heat.strength": 5e7,
    "effects.creep.strength": 0.003,
    "effects.creep.time_constant": 10.0,
    "effects.initial-offset.strength": 0.0,
    "effects.initial-offset.stroke": 4e-4,
    "effects.heat-soak.strength": 0.1,
    "effects.heat-soak.time_constant": 200.0,
}
EFFECT_KEYS = tuple(dict.fromkeys(name.split(".")[1] for name in EFFECTS))
JOINT_STARTS, JOINT_STEPS = 24, 250  # with 12 starts the lowest cost of one of four logs is 8 % higher
MIN_CUT = 0.05  # relative cut of the selection part's error that an effect must reach


def start_values(fitter: LogFitter, key: str) -> list[dict[str, float]]:
    """Return the start values of an effect's parameters, at each combination of its shapes."""
    kind = fitter.kinds[key]
    start = {n: float(v) for n, v in zip(fitter.names, fitter.nominal, strict=True) if n.startswith(f"effects.{key}.")}
    start[f"effects.{key}.strength"] = 0.3 * kind.typical
    grids = [[(f"effects.{key}.{name}", value) for value in values] for name, values in kind.shapes]
    return [start | dict(shapes) for shapes in itertools.product(*grids)]


@dataclasses.dataclass(frozen=True)
class Round:
    """One round of the search.

    Attributes:
        before: Error on the selection part at its start.
        scores: Errors on the selection part by effect.
        accepted: The accepted effect; empty for none.
        equivalent: Effects that are as good.
        fits: The fits at the end of the round, one a log.
    """

    before: float
    scores: Mapping[str, float]
    accepted: str
    equivalent: tuple[str, ...]
    fits: list[LogFit]


def search(fitter: LogFitter, first: list[LogFit], rounds: int, finalists: int) -> list[Round]:
    """Add effects one by one, as long as one lowers the error on the selection part by more than ``MIN_CUT``.

    Args:
        fitter: The fits of the logs.
        first: Fits of the base model to the training part.
        rounds: Largest number of rounds.
        finalists: Number of effects that are refitted with more steps.
    """
    history, fits, score = [], first, fitter.score("select", first)
    while len(history) < rounds:
        fits_by_effect: dict[str, list[LogFit]] = {}
        for key in fitter.kinds:
            starts = start_values(fitter, key)
            if f"effects.{key}.strength" in fits[0].effects or len(fits[0].effects) + len(starts[0]) > SLOTS:
                continue
            # From the smaller model's optimum, whose parameters compensate for the missing effect, and from the rig's
            # values.
            nominal_starts = [dataclasses.replace(f, base=fitter.first.nominal) for f in fits]
            trials = [
                fitter.fit_all("train", before, start, 25) for start in starts for before in (fits, nominal_starts)
            ]
            fits_by_effect[key] = [min(log_fits, key=lambda f: f.cost) for log_fits in zip(*trials, strict=True)]
        scores = {key: fitter.score("select", trial) for key, trial in fits_by_effect.items()}
        for key in sorted(scores, key=lambda k: scores[k])[:finalists]:
            fits_by_effect[key] = fitter.fit_all("train", fits_by_effect[key], {}, 80)
            scores[key] = fitter.score("select", fits_by_effect[key])
        scores = dict(sorted(scores.items(), key=lambda kv: kv[1]))
        best = next(iter(scores), "")
        is_accepted = bool(best) and scores[best] < (1 - MIN_CUT) * score
        equivalent = tuple(
            k
            for k, v in scores.items()
            if k != best and v < (1 - MIN_CUT) * score and v <= (1 + MIN_CUT) * scores[best]
        )
        history.append(
            Round(
                score,
                scores,
                best if is_accepted else "",
                equivalent if is_accepted else (),
                fits_by_effect[best] if is_accepted else fits,
            )
        )
        verdict = "accepted" if is_accepted else "not accepted"
        say(
            f"round {len(history)}: {best or 'nothing'} {verdict}, selection part from {score:.3f} to "
            f"{scores.get(best, score):.3f}"
        )
        if not is_accepted:
            break
        fits, score = fits_by_effect[best], scores[best]
    return history


def start_effects(fitter: LogFitter, log: Log) -> dict[str, float]:
    """Return the start values of the parameters of the effects that the arm has; the offset is that of the log."""
    first_bend = float(log.bend[np.isfinite(log.bend)][1])  # the first one is still filtered by the tracker
    start = EFFECTS | {"effects.initial-offset.strength": float(np.radians(first_bend)) * LEVER}
    return {name: value for name, value in start.items() if name in fitter.names}


def fit_jointly(fitter: LogFitter, logs: Sequence[Log], starts: int, steps: int) -> list[list[LogFit]]:
    """Fit the first part of each log with all effects of the fitter from several start points.

    Args:
        fitter: The fits of the logs.
        logs: The logs.
        starts: Number of start points a log.
        steps: Largest number of solver steps.

    Returns:
        For each log its fits, the best first.
    """
    fits = []
    for i, log in enumerate(logs):
        fits.append(fitter.fit_from_draws(i, "fitted", start_effects(fitter, log), starts, steps))
        say(f"{log.name}: lowest cost {fits[-1][0].cost:.1f}")
    return fits


def error_row(what: str, errors: tuple[float, float], targets: tuple[float, float] | None, **numbers: float) -> Row:
    """Return a row of errors in K and deg.

    Args:
        what: Name of the row.
        errors: RMSE in K and deg.
        targets: What they should be; ``None`` for no target.
        numbers: Further numbers of the row.
    """
    target = f"<= {targets[0]:g} K, <= {targets[1]:g} deg" if targets else "-"
    met = errors[0] <= targets[0] and errors[1] <= targets[1] if targets else None
    return Row(
        what,
        target,
        f"{errors[0]:.2f} K, {errors[1]:.2f} deg",
        met,
        {"rmse_K": errors[0], "rmse_deg": errors[1], **numbers},
    )


def report_rows(
    fitter: LogFitter,
    logs: Sequence[Log],
    base: list[LogFit],
    history: list[Round],
    final: list[LogFit],
    has_targets: bool,
) -> list[Row]:
    """Return the table without the rows on start points.

    Args:
        fitter: The fits of the logs.
        logs: The logs.
        base: Fits of the base model to the training part.
        history: The rounds of the search.
        final: Fits with all effects to the whole first part.
        has_targets: Whether the targets are those of these logs.
    """
    rows = [
        Row(f"{log.name}: found", "-", f"{log.columns}; fitted to {log.until:g} s, scored from {log.scored:g} s", None)
        for log in logs
    ]
    rows += [
        Row(f"{log.name}: the fitted and the held-out pulse go from and to", "-", describe_pulses(log), None)
        for log in logs
    ]
    base_whole = fitter.fit_all("fitted", base, {}, 80)
    for part in ("train", "select") if history else ():
        rows.append(error_row(f"{part} part, before", fitter.errors(part, base), None))
        rows.append(error_row(f"{part} part, with effects", fitter.errors(part, history[-1].fits), None))
    rows += round_rows(history)
    forecasts = [repeat_first_pulse(log) for log in logs]
    repeated = rms([g[0] for g in forecasts]), rms([g[1] for g in forecasts])
    rows.append(error_row("held out: repeating pulse 1 (naive)", repeated, None))
    targets = (TARGET_K, TARGET_DEG) if has_targets else None
    rows.append(error_row("held out: base model", fitter.errors("held", base_whole), targets))
    targets = (TARGET_WITH_EFFECTS_K, TARGET_WITH_EFFECTS_DEG) if has_targets else None
    ours = fitter.errors("held", final)
    rows.append(error_row("held out: with effects", ours, targets))
    for i, (log, fitted) in enumerate(zip(logs, final, strict=True)):
        temperature, bend = fitter.residuals(i, "held", fitted)
        rows.append(error_row(f"held out: {log.name}", (rms([temperature]), rms([bend])), None))
    text = f"{ours[0]:.2f} K, {ours[1]:.2f} deg against {repeated[0]:.2f} K, {repeated[1]:.2f} deg"
    accepted = ", ".join(dict.fromkeys(name.split(".")[1] for name in final[0].effects)) or "no effect"
    is_met = ours[0] < repeated[0] and ours[1] < repeated[1]
    rows.append(Row(f"held out: with {accepted}, against the naive forecast", "below it", text, is_met))
    return rows + parameter_rows(fitter, final)


def round_rows(history: list[Round]) -> list[Row]:
    """Return the errors and the verdict of each round."""
    rows = []
    for k, search_round in enumerate(history):
        scores = [f"{key} {value:.3f}" for key, value in search_round.scores.items()]
        text = f"{search_round.before:.3f} before; with {', '.join(scores)}"
        rows.append(
            Row(f"round {k + 1}: error over noise on the selection part", "-", text, None, dict(search_round.scores))
        )
        cut = f"{100 * MIN_CUT:.0f} %"
        verdict = f"{search_round.accepted} accepted" if search_round.accepted else f"none cuts it by more than {cut}"
        if search_round.equivalent:
            verdict += f"; as good within {cut}: {', '.join(search_round.equivalent)}"
        rows.append(Row(f"round {k + 1}: verdict", "-", verdict, None))
    return rows


def parameter_rows(fitter: LogFitter, final: list[LogFit]) -> list[Row]:
    """Return the parameters of the last fits, a value for each log."""
    rows = []
    for i, unknown in enumerate(fitter.first.unknowns):
        values = [float(f.base[i] * unknown.scale) for f in final]
        rows.append(Row(unknown.name, "-", f"{', '.join(f'{v:.4g}' for v in values)} {unknown.unit}", None))
    for name in final[0].effects:
        values = [f.effects[name] for f in final]
        rows.append(Row(name, "-", f"{', '.join(f'{v:.4g}' for v in values)} {fitter.declared[name].unit}", None))
    return rows


def agreement(fitter: LogFitter, fits_by_log: list[list[LogFit]]) -> tuple[list[Row], list[LogFit]]:
    """Count the start points that end at each log's lowest cost.

    Args:
        fitter: The fits of the logs.
        fits_by_log: For each log its fits from several start points.

    Returns:
        The rows, and the best fit of each log.
    """
    rows, best = [], []
    for i, fits in enumerate(fits_by_log):
        lowest = min(fits, key=lambda f: f.cost)
        matching = sum(f.cost <= 1.001 * lowest.cost for f in fits)
        close = sum(f.cost <= 1.05 * lowest.cost for f in fits)
        text = (
            f"{matching} of {len(fits)} end within 0.1 %, {close} within 5 % of the lowest cost, {lowest.cost:.1f}; "
            f"{lowest.status.text}"
        )
        name = fitter.parts[i]["fitted"].name
        rows.append(
            Row(
                f"{name}: is it the best that this model can do?",
                "one optimum",
                text,
                matching == len(fits),
                {"cost": lowest.cost},
            )
        )
        best.append(lowest)
    return rows, best


def pictures(fitter: LogFitter, logs: Sequence[Log], final: list[LogFit], folder: Path) -> None:
    """Draw the scored part of each log, measured and modelled.

    Args:
        fitter: The fits of the logs.
        logs: The logs.
        final: Their fits.
        folder: Where the pictures go.
    """
    for i, (log, fitted) in enumerate(zip(logs, final, strict=True)):
        part = fitter.parts[i]["held"]
        measured = part.channels["temperature"], np.degrees(part.channels["displacement"] / LEVER)
        pairs = zip(("temperature [degC]", "bend [deg]"), measured, fitter.residuals(i, "held", fitted), strict=True)
        for what, values, residual in pairs:
            scored = np.isfinite(residual)
            time = part.time[scored]
            curves = [
                Curve("measured", time, values[scored]),
                Curve("model", time, (values - residual)[scored], dashed=True),
            ]
            draw(
                Chart(f"{log.name}, held out", "time [s]", what, curves),
                folder,
                f"measured_softlimb_{log.name}_{what.split()[0]}",
            )


def main() -> None:
    """Print the table."""
    args = arguments(
        __doc__,
        data="bu-softlimb",
        quick="the first log only, one round of a search; few start points and steps",
        more={
            "--search": {"action": "store_true", "help": "choose the effects by a search over the candidates"},
            "--predict": {
                "type": Path,
                "metavar": "LOG",
                "help": "predict this log, of any course, by fits to the logs of DIR, one for each wire",
            },
        },
    )
    course = Course(args.predict) if args.predict else None
    logs = read_logs(args.data)
    starts, steps = (2, 40) if args.quick else (JOINT_STARTS, JOINT_STEPS)
    if course is not None:
        fitter = LogFitter(logs, EFFECT_KEYS)
        say(f"fitting {len(logs)} logs, pulse 1 and then both pulses")
        best = [fits[0] for fits in fit_jointly(fitter, logs, starts, steps)]
        finish(predict_course(fitter, logs, fitter.fit_all("whole", best, {}, steps), course), args)
        return
    has_targets = args.data.name == "bu-softlimb" and not args.quick
    logs = logs[:1] if args.quick else logs
    fitter = LogFitter(logs, CANDIDATES if args.search else EFFECT_KEYS)
    say(f"fitting the base model to {len(logs)} logs from {BASE_STARTS} start points each")
    base = [fitter.fit_from_draws(i, "train", {}, BASE_STARTS, 60)[0] for i in range(len(logs))]
    history = search(fitter, base, 1 if args.quick else 8, 1 if args.quick else 4) if args.search else []
    say("fitting the whole of the first part with effects")
    if args.search:
        final = fitter.fit_all("fitted", history[-1].fits if history else base, {}, steps)
        draws = enumerate(final)
        fits_by_log = [[f, *fitter.fit_from_draws(i, "fitted", f.effects, starts, steps, seed=1 + i)] for i, f in draws]
    else:
        fits_by_log = fit_jointly(fitter, logs, starts, steps)
    agreement_rows, final = agreement(fitter, fits_by_log)
    rows = [*report_rows(fitter, logs, base, history, final, has_targets), *agreement_rows]
    if args.out:
        pictures(fitter, logs, final, args.out)
    finish(rows, args)


if __name__ == "__main__":
    main()
