"""A soft arm bent by one wire at a time, measured by others: fit a first heating pulse, predict the second.

    python experiments/measured/bu_softlimb.py [--data DIR] [--predict LOG] [--search] [--quick] [--json FILE]

DIR holds one CSV file a log: a row of headers (``pwm_duty_...``, ``MCPtemp_...``, ``tagid_x_...``, ``tagid_y_...``; the
first column is a stamp in ms) and rows of numbers below it. The driven wire, its thermocouple and the moving tags are
chosen from the data. The bend is the direction of the chord from the first tag, or from the middle one if the first
half of the arm does not move, to the last. It is relative to its mean in the last 30 s before the second pulse, and
positive as the wire shortens. The temperature is compared at rows where any thermocouple was refreshed.

The plant is one wire against an elastic arm: the arm is a bias spring, and its bend is the wire's displacement over a
lever of nominal length. These data do not determine a stress, so preload, stiffness, the Clausius-Clapeyron
coefficients and the (equal) moduli are fixed. The wire is always under tension, so there is no twinned martensite. It
starts detwinned. Of supply, resistance and heat capacity, which scale the same heat, the supply is fitted.

All logs are fitted together. The wires are of one make and in one arm, so their alloy, their heat and the silicone
around them are alike: each wire's parameters scatter about shared ones by a fifth of what data sheets leave open
(``arm_priors.SPREAD``). One pulse leaves many directions undetermined, in which the other wires then help. Each log has
its own temperatures, lag of its thermocouple, lever and place where the arm begins. Their latent heat is one that an
alloy can have (``data/plausible-ranges.toml``).

Fits end in different places, so they start from several points. With the narrow prior of the latent heat alone they end
at higher costs, so a search has two stages: all start points are fitted with a wide prior, the best of these fits are
continued with the narrow one, and points around the best one follow. The lowest cost with the narrow prior counts.

What the arm has (``EFFECTS``) was read off residuals of both pulses. ``--search`` tests each effect on first pulses
alone: it is left out, the blocks of 2 s that train are fitted, and the error on every third block shows whether it is
missed. The scored pulse has no part in that, nor in any fit. In the fitted part the slow tail is thinned to about a row
a second; the scored part keeps all rows. A reading of the thermocouples stands in a separate row, at the time when it
was taken (``arm_log.reading_shift``).

``--predict`` fits the logs of DIR, both pulses, and predicts LOG without a fit to it: any wires in any course.
"""

from __future__ import annotations

import dataclasses
import sys
from collections.abc import Sequence
from pathlib import Path

sys.path.insert(0, str(Path(__file__).resolve().parents[2]))  # the checkout: smajax, tests/reference, experiments

from experiments.common.arm_fit import ArmFit, ArmFitter
from experiments.common.arm_log import Log, describe_pulses, read_logs, repeat_first_pulse
from experiments.common.arm_model import LEVER, rms
from experiments.common.arm_prediction import Course, predict_course
from experiments.common.base import Row, arguments, finish, say
from experiments.common.charts import Chart, Curve, draw

import numpy as np

TARGET_K, TARGET_DEG = 7.3, 0.80  # of a small model fitted by ordinary least squares
TARGET_WITH_EFFECTS_K, TARGET_WITH_EFFECTS_DEG = 1.6, 0.37  # of that model with effects
# What the arm has: grains that transform at scattered temperatures, with latent heat and creep; silicone around the
# wire that warms within seconds, and a body that warms within minutes; thermocouples that touch wire and silicone, and
# lag; and a pulse that begins where the arm was left.
EFFECTS = ("grains", "coating", "body-heat", "thermocouple-contact", "rest-offset")
STARTS, HOPS, STEPS = 12, 16, 80  # start points, restarts around the best one, solver steps of each
QUICK_STARTS, QUICK_HOPS, QUICK_STEPS = 2, 0, 30
BASE_STARTS = 8  # with fewer the base fit may stay where the wire never transforms, so that any effect improves it
MIN_CUT = 0.05  # relative cut of the selection part's error that an effect must reach


def search(fitter: ArmFitter, starts: int, hops: int, steps: int) -> list[Row]:
    """Leave out each effect in turn, and compare the errors on the selection part of the first pulses.

    Args:
        fitter: The fits of the logs.
        starts: Number of start points.
        hops: Number of restarts around the best fit.
        steps: Largest number of solver steps.
    """
    whole = fitter.fit("train", (), starts, hops, steps)[0]
    score = fitter.score("select", whole)
    rows = [error_row("selection part of pulse 1: all effects", fitter.errors("select", whole), None, score=score)]
    for key in fitter.effects:
        fits = fitter.fit("train", (key,), 1, hops, steps, before=whole)
        missing = fitter.score("select", fits[0])
        verdict = "needed" if score < (1 - MIN_CUT) * missing else f"not needed: it cuts less than {MIN_CUT:.0%}"
        text = f"error over noise {missing:.3f} without it, {score:.3f} with it: {verdict}"
        rows.append(Row(f"selection part of pulse 1: {key}", "-", text, None, {"without": missing, "with": score}))
    return rows


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


def report_rows(fitter: ArmFitter, logs: Sequence[Log], base: ArmFit, final: ArmFit, has_targets: bool) -> list[Row]:
    """Return the table without the rows on start points.

    Args:
        fitter: The fits of the logs.
        logs: The logs.
        base: Fit of the base model.
        final: Fit with all effects.
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
    rows.append(error_row("fitted: base model", fitter.errors("fitted", base), None))
    rows.append(error_row("fitted: with effects", fitter.errors("fitted", final), None))
    forecasts = [repeat_first_pulse(log) for log in logs]
    repeated = rms([g[0] for g in forecasts]), rms([g[1] for g in forecasts])
    rows.append(error_row("held out: repeating pulse 1 (naive)", repeated, None))
    targets = (TARGET_K, TARGET_DEG) if has_targets else None
    rows.append(error_row("held out: base model", fitter.errors("held", base), targets))
    targets = (TARGET_WITH_EFFECTS_K, TARGET_WITH_EFFECTS_DEG) if has_targets else None
    ours = fitter.errors("held", final)
    rows.append(error_row("held out: with effects", ours, targets))
    for i, (log, forecast) in enumerate(zip(logs, forecasts, strict=True)):
        errors, naive = ((rms([pair[0]]), rms([pair[1]])) for pair in (fitter.residuals(i, "held", final), forecast))
        target = f"below {naive[0]:.2f} K, {naive[1]:.2f} deg (naive)"
        rows.append(
            dataclasses.replace(
                error_row(f"held out: {log.name}", errors, None),
                target=target,
                met=errors[0] < naive[0] and errors[1] < naive[1],
            )
        )
    text = f"{ours[0]:.2f} K, {ours[1]:.2f} deg against {repeated[0]:.2f} K, {repeated[1]:.2f} deg"
    is_met = ours[0] < repeated[0] and ours[1] < repeated[1]
    what = f"held out: with {', '.join(fitter.effects)}, against the naive forecast"
    rows.append(Row(what, "below it", text, is_met))
    return rows + parameter_rows(fitter, final)


def parameter_rows(fitter: ArmFitter, final: ArmFit) -> list[Row]:
    """Return the parameters of a fit, a value for each log."""
    return [
        Row(name, "-", f"{', '.join(f'{v:.4g}' for v in values)} {unit}", None)
        for name, unit, values in zip(fitter.names, fitter.units, final.values.T, strict=True)
    ]


def agreement_row(fits: Sequence[ArmFit]) -> Row:
    """Count the fits that end at the lowest cost.

    Args:
        fits: Fits from several start points, the best first.
    """
    lowest = fits[0].cost
    matching, close = (sum(f.cost <= share * lowest for f in fits) for share in (1.001, 1.05))
    text = (
        f"{matching} of {len(fits)} end within 0.1 %, {close} within 5 % of the lowest cost, {lowest:.1f}; "
        f"{fits[0].message}"
    )
    return Row("is it the best that this model can do?", "one optimum", text, matching == len(fits), {"cost": lowest})


def pictures(fitter: ArmFitter, logs: Sequence[Log], final: ArmFit, folder: Path) -> None:
    """Draw the scored part of each log, measured and modelled.

    Args:
        fitter: The fits of the logs.
        logs: The logs.
        final: Their fit.
        folder: Where the pictures go.
    """
    for i, log in enumerate(logs):
        part = fitter.parts[i]["held"]
        measured = part.channels["temperature"], np.degrees(part.channels["displacement"] / LEVER)
        pairs = zip(("temperature [degC]", "bend [deg]"), measured, fitter.residuals(i, "held", final), strict=True)
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
        quick="the first log only, without --predict; few start points and steps",
        more={
            "--search": {"action": "store_true", "help": "print only what each effect cuts on the first pulses alone"},
            "--predict": {
                "type": Path,
                "metavar": "LOG",
                "help": "predict this log, of any course, by a fit to the logs of DIR, one for each wire",
            },
        },
    )
    course = Course(args.predict) if args.predict else None
    logs = read_logs(args.data)
    starts, hops, steps = (QUICK_STARTS, QUICK_HOPS, QUICK_STEPS) if args.quick else (STARTS, HOPS, STEPS)
    if course is not None:
        fitter = ArmFitter(logs, EFFECTS)
        say(f"fitting {len(logs)} logs, pulse 1 and then both pulses")
        first = fitter.fit("fitted", (), starts, hops, steps)[0]
        rows = predict_course(fitter, logs, fitter.fit("whole", (), 1, hops, steps, before=first)[0], course)
        finish(rows, args, words=f" --predict {args.predict.name}")
        return
    has_targets = args.data.name == "bu-softlimb" and not args.quick
    logs = logs[:1] if args.quick else logs
    fitter = ArmFitter(logs, EFFECTS)
    if args.search:
        finish(search(fitter, starts, hops // 4, steps), args, words=" --search")
        return
    say("fitting the base model")
    base = fitter.fit("fitted", EFFECTS, starts if args.quick else BASE_STARTS, 0, steps)[0]
    say("fitting with effects")
    fits = fitter.fit("fitted", (), starts, hops, steps)
    rows = [*report_rows(fitter, logs, base, fits[0], has_targets), agreement_row(fits)]
    if args.out:
        pictures(fitter, logs, fits[0], args.out)
    finish(rows, args)


if __name__ == "__main__":
    main()
