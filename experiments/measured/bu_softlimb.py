"""A soft arm bent by one wire at a time, measured by others.

Fit a first heating pulse and its cooling, predict the second pulse.

    python experiments/measured/bu_softlimb.py [--data DIR] [--quick] [--json FILE] [--out DIR]

DIR holds one CSV file a log: a row of headers (``pwm_duty_...``, ``MCPtemp_...``, ``tagid_x_...``, ``tagid_y_...``,
the first column a stamp in ms), numbers below. Which duty is driven, which thermocouple answers and which tags move
is found in the data. The bend is the direction of the chord from the first tag, or from the middle one where the
first half of the arm stays, to the last, relative to its mean in the last 30 s before the second pulse, positive as
the wire shortens. The temperature is compared where any thermocouple was refreshed.

The plant is one wire against an elastic arm: the arm is a bias spring, its bend the wire's displacement over a lever
of nominal length. These data decide no stress, so preload, stiffness, the Clausius-Clapeyron coefficients and the
moduli (as equal) are held. The wire is always under tension: the twinned branch is held out of the way, and slack is
no candidate. Nor is ratcheting, which one pulse cannot tell from a set that is there from before (initial-set),
although the two forecast different second pulses. The wire starts detwinned: a free start fraction would be that set
a second time. Of supply, resistance and heat capacity, which scale the same heat, the supply is fitted. Each log has
its own parameters, all have the same effects. One pulse leaves many a direction open, and what is absurd along it
forecasts absurdly: what is known of such wires beforehand stands as a prior in every fit (``SPREAD``).

One pulse is fitted, and all that tells of most effects happens in its first 40 s. A selection part that is the last
third in time would see a wire at rest. So it is every third of the blocks of 2 s. An effect is accepted if it lowers
the error there, pooled over the logs and both channels over their noise, by more than 5 %. Then all is fitted once
more to the whole of the first part. In the fitted part the slow tail is thinned to a row a second or so; the scored
part keeps all rows.
"""

from __future__ import annotations

import dataclasses
import itertools
import sys
from collections.abc import Mapping, Sequence
from pathlib import Path

sys.path.insert(0, str(Path(__file__).resolve().parents[2]))  # the checkout: smajax, tests/reference, experiments

from experiments.common.arm_fit import BASE_STARTS, LEVER, SLOTS, Bench, Fitted, rms
from experiments.common.arm_log import Log, begun, naive, read_logs
from experiments.common.base import Row, arguments, finish, say
from experiments.common.charts import Chart, Curve, draw

import numpy as np

BASE_K, BASE_DEG = 7.3, 0.80  # small model fitted by plain least squares
REACH_K, REACH_DEG = 1.6, 0.37  # the same with effects added
CANDIDATES = (
    "thermocouple-embedding",
    "coating",
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
CUT = 0.05


def with_effect(bench: Bench, key: str) -> list[dict[str, float]]:
    """Start values of an effect's parameters.

    A part of its typical strength, at each of the shapes that it is tried at.
    """
    kind = bench.kinds[key]
    start = {n: float(v) for n, v in zip(bench.names, bench.nominal, strict=True) if n.startswith(f"effects.{key}.")}
    start[f"effects.{key}.strength"] = 0.3 * kind.typical
    grids = [[(f"effects.{key}.{name}", value) for value in values] for name, values in kind.shapes]
    return [start | dict(chosen) for chosen in itertools.product(*grids)]


@dataclasses.dataclass(frozen=True)
class Round:
    """One round of the search.

    Its scores on the selection part by effect, which one was accepted (or none), and which did as well.
    """

    before: float
    scores: Mapping[str, float]
    accepted: str
    equivalent: tuple[str, ...]
    fits: list[Fitted]


def search(bench: Bench, first: list[Fitted], rounds: int, finalists: int) -> list[Round]:
    """Adds effects one by one, as long as one lowers the error on the selection part by more than ``CUT``."""
    history, fits, score = [], first, bench.score("select", first)
    while len(history) < rounds:
        tried: dict[str, list[Fitted]] = {}
        for key in bench.kinds:
            starts = with_effect(bench, key)
            if f"effects.{key}.strength" in fits[0].effects or len(fits[0].effects) + len(starts[0]) > SLOTS:
                continue
            # From where the smaller model stands, whose parameters made up for the effect, and from the rig's own
            # values.
            anew = [dataclasses.replace(f, base=bench.first.nominal) for f in fits]
            trials = [bench.each("train", before, start, 25) for start in starts for before in (fits, anew)]
            tried[key] = [min(own, key=lambda f: f.cost) for own in zip(*trials, strict=True)]
        scores = {key: bench.score("select", trial) for key, trial in tried.items()}
        for key in sorted(scores, key=lambda k: scores[k])[:finalists]:
            tried[key] = bench.each("train", tried[key], {}, 80)
            scores[key] = bench.score("select", tried[key])
        scores = dict(sorted(scores.items(), key=lambda kv: kv[1]))
        best = next(iter(scores), "")
        good = bool(best) and scores[best] < (1 - CUT) * score
        alike = tuple(
            k for k, v in scores.items() if k != best and v < (1 - CUT) * score and v <= (1 + CUT) * scores[best]
        )
        history.append(Round(score, scores, best if good else "", alike if good else (), tried[best] if good else fits))
        what = "accepted" if good else "not accepted"
        say(
            f"round {len(history)}: {best or 'nothing'} {what}, selection part from {score:.3f} to "
            f"{scores.get(best, score):.3f}"
        )
        if not good:
            break
        fits, score = tried[best], scores[best]
    return history


def compared(what: str, errors: tuple[float, float], targets: tuple[float, float] | None, **numbers: float) -> Row:
    """One row of errors in K and deg."""
    goal = f"<= {targets[0]:g} K, <= {targets[1]:g} deg" if targets else "-"
    met = errors[0] <= targets[0] and errors[1] <= targets[1] if targets else None
    return Row(
        what,
        goal,
        f"{errors[0]:.2f} K, {errors[1]:.2f} deg",
        met,
        {"rmse_K": errors[0], "rmse_deg": errors[1], **numbers},
    )


def report(
    bench: Bench, logs: Sequence[Log], base: list[Fitted], history: list[Round], final: list[Fitted], known: bool
) -> list[Row]:
    """The table but for the agreement of start points."""
    rows = [
        Row(f"{log.name}: found", "-", f"{log.found}; fitted to {log.until:g} s, scored from {log.scored:g} s", None)
        for log in logs
    ]
    rows += [
        Row(f"{log.name}: the fitted and the held-out pulse go from and to", "-", begun(log), None) for log in logs
    ]
    guess = [naive(log) for log in logs]
    repeated = rms([g[0] for g in guess]), rms([g[1] for g in guess])
    whole = bench.each("fitted", base, {}, 80)
    for part in ("train", "select"):
        last = history[-1].fits if history else base
        rows.append(compared(f"{part} part, before", bench.errors(part, base), None))
        rows.append(compared(f"{part} part, with effects", bench.errors(part, last), None))
    for k, one in enumerate(history):
        best = [f"{key} {value:.3f}" for key, value in one.scores.items()]
        text = f"{one.before:.3f} before; with {', '.join(best)}"
        rows.append(Row(f"round {k + 1}: error over noise on the selection part", "-", text, None, dict(one.scores)))
        verdict = f"{one.accepted} accepted" if one.accepted else f"none cuts it by more than {100 * CUT:.0f} %"
        verdict += f"; as good within {100 * CUT:.0f} %: {', '.join(one.equivalent)}" if one.equivalent else ""
        rows.append(Row(f"round {k + 1}: verdict", "-", verdict, None))
    rows.append(compared("held out: repeating pulse 1 (naive)", repeated, None))
    rows.append(compared("held out: base model", bench.errors("held", whole), (BASE_K, BASE_DEG) if known else None))
    rows.append(
        compared("held out: with effects", bench.errors("held", final), (REACH_K, REACH_DEG) if known else None)
    )
    for i, (log, fitted) in enumerate(zip(logs, final, strict=True)):
        rows.append(
            compared(f"held out: {log.name}", tuple(rms([r]) for r in bench.residuals(i, "held", fitted)), None)
        )  # pyright: ignore[reportArgumentType]
    ours = bench.errors("held", final)
    text = f"{ours[0]:.2f} K, {ours[1]:.2f} deg against {repeated[0]:.2f} K, {repeated[1]:.2f} deg"
    named = ", ".join(one.accepted for one in history if one.accepted) or "no effect"
    rows.append(
        Row(
            f"held out: with {named}, against the naive forecast",
            "below it",
            text,
            ours[0] < repeated[0] and ours[1] < repeated[1],
        )
    )
    for i, unknown in enumerate(bench.first.unknowns):
        values = [float(f.base[i] * unknown.scale) for f in final]
        rows.append(Row(unknown.name, "-", f"{', '.join(f'{v:.4g}' for v in values)} {unknown.unit}", None))
    for name in final[0].effects:
        values = [f.effects[name] for f in final]
        rows.append(Row(name, "-", f"{', '.join(f'{v:.4g}' for v in values)} {bench.declared[name].unit}", None))
    return rows


def agreement(bench: Bench, final: list[Fitted], times: int) -> tuple[list[Row], list[Fitted]]:
    """How many start points end at each log's lowest cost, and the best fit of each."""
    rows, best = [], []
    for i, fitted in enumerate(final):
        fits = [fitted, *bench.drawn(i, "fitted", fitted.effects, times, 150, seed=1 + i)]
        lowest = min(fits, key=lambda f: f.cost)
        same = sum(f.cost <= 1.001 * lowest.cost for f in fits)
        near = sum(f.cost <= 1.05 * lowest.cost for f in fits)
        text = (
            f"{same} of {len(fits)} end within 0.1 %, {near} within 5 % of the lowest cost, {lowest.cost:.1f}; "
            f"{lowest.stop.text}"
        )
        name = bench.parts[i]["fitted"].name
        rows.append(
            Row(
                f"{name}: is it the best that this model can do?",
                "one optimum",
                text,
                same == len(fits),
                {"cost": lowest.cost},
            )
        )
        best.append(lowest)
    return rows, best


def pictures(bench: Bench, logs: Sequence[Log], final: list[Fitted], folder: Path) -> None:
    """The scored part of each log, measured and modelled."""
    for i, (log, fitted) in enumerate(zip(logs, final, strict=True)):
        part = bench.parts[i]["held"]
        measured = part.channels["temperature"], np.degrees(part.channels["displacement"] / LEVER)
        pairs = zip(("temperature [degC]", "bend [deg]"), measured, bench.residuals(i, "held", fitted), strict=True)
        for what, values, left in pairs:
            seen = np.isfinite(left)
            time = part.time[seen]
            curves = [Curve("measured", time, values[seen]), Curve("model", time, (values - left)[seen], dashed=True)]
            draw(
                Chart(f"{log.name}, held out", "time [s]", what, curves),
                folder,
                f"measured_softlimb_{log.name}_{what.split()[0]}",
            )


def main() -> None:
    """Prints the table."""
    args = arguments(__doc__, data="bu-softlimb", quick="the first log only, three candidates, one round")
    logs = read_logs(args.data)
    known = args.data.name == "bu-softlimb" and not args.quick
    logs = logs[:1] if args.quick else logs
    bench = Bench(logs, CANDIDATES[:3] if args.quick else CANDIDATES)
    say(f"fitting the base model to {len(logs)} logs from {BASE_STARTS} start points each")
    base = [bench.drawn(i, "train", {}, BASE_STARTS, 60)[0] for i in range(len(logs))]
    history = search(bench, base, 1 if args.quick else 8, 1 if args.quick else 4)
    say("fitting all once more to the whole of the first part")
    final = bench.each("fitted", history[-1].fits if history else base, {}, 40 if args.quick else 200)
    agreed, final = agreement(bench, final, 2 if args.quick else 10)
    rows = [*report(bench, logs, base, history, final, known), *agreed]
    if args.out:
        pictures(bench, logs, final, args.out)
    finish(rows, args)


if __name__ == "__main__":
    main()
