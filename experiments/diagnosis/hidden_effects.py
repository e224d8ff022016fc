"""Does a diagnosis name what is hidden? Truth from tests/reference/hidden.py, which shares no code with smajax.

    python experiments/diagnosis/hidden_effects.py [--quick] [--seeds N] [--json FILE] [--out DIR]

Every case draws the rig's free parameters near their nominal values, the strength log-uniformly from 0.3 to 1.5 of a
usual one, and three inputs of 80 s. Counted are: the right effect alone or as first (exact, or in the class that the
verdict declares), alarms where nothing is hidden, effects named too many, what is said of effects that no catalogue
lists, whether the interval of the strength holds the true one, the held-out error over the noise, and whether a rig
file with other start values comes to the same verdict.

Ablations: what the score at the first fit would name, without clipping to what is plausible, without taking out what
the free parameters absorb, and if of each class of alike effects only the best-scored one were refitted; alarms if
the residual were taken for white; and second effects where the kinetics is off if the selection recording had the
training recording's input.

With --out, each case is written to DIR/cases.jsonl as it ends, and a case that is there is not run again. ``--quick``
runs one hidden effect and one case without.
"""

from __future__ import annotations

import math
import sys
import time
from collections import Counter
from collections.abc import Callable, Iterable, Iterator
from pathlib import Path
from typing import Any

sys.path.insert(0, str(Path(__file__).resolve().parents[2]))  # the checkout: smajax, tests/reference, experiments

from experiments.common.base import ROOT, Row, add_case, arguments, finish, read_cases, say

import numpy as np

from smajax import parameters
from smajax.diagnosis.candidate_evaluation import CandidateEvaluator
from smajax.diagnosis.candidates import EffectSet
from smajax.diagnosis.equivalence import equivalence_classes
from smajax.diagnosis.outcome import diagnose
from smajax.diagnosis.problem import DiagnosisProblem
from smajax.diagnosis.result import Diagnosis
from smajax.diagnosis.screening import Score, p_value, score_test
from smajax.files.rig_file import Rig, read_rig
from smajax.plant.plant import Plant
from smajax.recordings.recording import Recording
from tests.reference.hidden import Hidden, displacement
from tests.reference.make_data import clock, shipped, turns
from tests.reference.rig_file import RigFile

# Key: the reference's field, a usual size, what the strength in the catalogue is for a size of one, and fields that
# go with it.
SINGLES: dict[str, tuple[str, float, float | None, dict[str, float]]] = {
    "latent-heat": ("latent_heat", 8e7, 1.0, {}),
    "ambient-drift": ("drift", 0.05, 1.0, {}),
    "airflow-change": ("draught", 0.3, 1.0, {"draught_instant": 31.0}),
    "coating": ("coating", 0.5, None, {"coating_time": 4.0}),
    "end-conduction": ("ends", 0.15, None, {"ends_time": 25.0}),
    "convection-temperature": ("convection_slope", 0.3, 1.0, {}),
    "current-limit": ("saturation", 0.08, None, {}),
    "coulomb-friction": ("friction", 1.2e7, 1.0, {}),
    "backlash": ("play", 1.5e-4, 1.0, {}),
    "sensor-lag": ("lag", 0.15, 1.0, {}),
    "time-skew": ("skew", 0.08, 1.0, {}),
    "ratcheting": ("ratchet", 1e-4, None, {}),
    "functional-fatigue": ("fatigue", 0.01, None, {}),
    "minor-loop-shape": ("exponent", 0.3, 1.0, {}),
    "creep": ("creep", 0.003, None, {"creep_time": 12.0}),
    "encoder-drift": ("encoder_drift", 1.5e-5, 1.0, {}),
}
SAME = {"ratcheting": {"functional-fatigue"}, "functional-fatigue": {"ratcheting"}}
PAIRS = (
    ("latent-heat", "sensor-lag"),
    ("ambient-drift", "backlash"),
    ("coulomb-friction", "latent-heat"),
    ("creep", "airflow-change"),
)
UNLISTED = {
    "kinetics by half off": {"pace": 0.5},
    "load step": {"load_step": 0.12, "load_instant": 28.0},
    "bent sensor": {"cubic": 0.05},
}
BENT = ("latent-heat", "ambient-drift", "backlash")
STARTS = ("latent-heat", "coating", "backlash", "sensor-lag", "functional-fatigue")
NOISE = 2e-5

Facts = dict[str, Any]  # of one case, as they are written


def draw(rng: np.random.Generator, keys: tuple[str, ...], known: dict[str, Any] | None = None) -> dict[str, float]:
    """The reference's fields for effects of drawn strengths; ``known`` stands for ``SINGLES``."""
    fields: dict[str, float] = {}
    for key in keys:
        name, usual, _, more = (known or SINGLES)[key]
        fields |= {name: usual * math.exp(rng.uniform(math.log(0.3), math.log(1.5)))} | more
    return fields


def nearby(rng: np.random.Generator, kind: str) -> RigFile:
    """A shipped rig as the reference has it, its free parameters drawn near their nominal values."""
    return near(rng, shipped(kind))


def near(rng: np.random.Generator, rig: RigFile) -> RigFile:
    """A rig whose free parameters are drawn near their nominal values."""
    return rig.changed(
        h0=rng.uniform(0.92, 1.08),
        h2=rng.uniform(0.8, 1.2),
        capacity=rng.uniform(0.95, 1.05),
        max_transformation_strain=rng.uniform(0.97, 1.03),
        austenite_shift=rng.uniform(-2.5, 2.5),
        martensite_shift=rng.uniform(-2.5, 2.5),
    )


def inputs(rng: np.random.Generator) -> Iterator[tuple[str, np.ndarray, np.ndarray]]:
    """Name, times and current of the three recordings of a case."""
    seconds, rig, bands = clock(80.0), shipped("dead-weight"), np.array([[46.0, 62.0], [84.0, 100.0]])
    for part in ("train", "select", "holdout"):
        yield part, seconds, turns(rng, seconds, rig, (0.0, 0.14), (0.28, 0.35), bands).round(4)


def record(
    rig: Rig, hidden: dict[str, float], rng: np.random.Generator, *, same_input: bool = False
) -> list[Recording]:
    """Three recordings of one wire under three inputs; with ``same_input`` the second one has the first one's."""
    truth = nearby(rng, "dead-weight")
    recordings = []
    for part, seconds, drawn in inputs(rng):
        current = recordings[0].channels["current"] if part == "select" and same_input else drawn
        lifted = displacement(truth, Hidden(**hidden), seconds, current) + NOISE * rng.standard_normal(len(seconds))
        recordings.append(
            Recording.from_arrays(part, seconds, {"current": current, "displacement": lifted}, {"displacement": "mm"})
        )
    return recordings


def run(rig: Rig, group: str, name: str, keys: tuple[str, ...], hidden: dict[str, float], seed: int) -> Facts:
    """Diagnoses a case."""
    began = time.perf_counter()
    rng = np.random.default_rng([seed, *name.encode()])
    recordings = record(rig, hidden, rng, same_input=group == "same input")
    plant = elsewhere(rig, rng) if group == "another start" else rig.plant
    bench = DiagnosisProblem(plant, recordings, rig.fit, interpolation=rig.interpolation)
    found = diagnose(bench, seed=seed)
    seconds = time.perf_counter() - began
    ratio = found.rmse["displacement"]["holdout_after"] / NOISE
    say(f"{name} ({seed}): {found.verdict} {', '.join(found.effects)}; {ratio:.2f} of the noise, {seconds:.0f} s")
    return {
        "group": group,
        "case": name,
        "seed": seed,
        "keys": keys,
        "hidden": hidden,
        "verdict": found.verdict,
        "effects": found.effects,
        "equivalent": found.equivalent,
        "unresolved_stage": found.unresolved_stage,
        "holdout_over_noise": ratio,
        "seconds": seconds,
        "interval_holds": held(found, keys[0], hidden) if group == "one effect" else None,
        **ablated(bench, found, seed),
    }


def elsewhere(rig: Rig, rng: np.random.Generator) -> Plant:
    """The rig's plant with other values of its free parameters: within a twentieth, temperatures within 3 K."""
    values = {}
    for name in rig.fit.free:
        value, unit = float(parameters.get(rig.plant, name)), parameters.declaration(rig.plant, name).unit
        values[name] = value + rng.uniform(-3.0, 3.0) if unit in ("degC", "K") else value * rng.uniform(0.95, 1.05)
    return parameters.replace(rig.plant, values)


def held(found: Diagnosis, key: str, hidden: dict[str, float]) -> bool | None:
    """Whether the interval holds the true strength; ``None`` where the two forms have no strength in common."""
    name, _, factor, _ = SINGLES[key]
    interval = found.intervals.get(f"effects.{key}.strength")
    return None if factor is None or interval is None else bool(interval[0] <= factor * hidden[name] <= interval[1])


def ablated(bench: DiagnosisProblem, found: Diagnosis, seed: int) -> Facts:
    """What a lesser diagnosis would say at the first fit.

    The effect named first, and the alarm if the residual were white.
    """
    tracer = CandidateEvaluator(bench, seed)
    base = bench.fit(EffectSet(), found.before.base)
    scores = tracer.scores(base)

    def first(one: Callable[[str, np.ndarray], Score]) -> str:
        gains = [(one(key, column).gain, key) for (key, _), column in scores.sensitivities.items()]
        return max(gains)[1]

    raw, nothing = bench.counted_samples(base.residual), np.zeros((len(scores.residual), 0))
    alike = equivalence_classes({k: s.sensitivity for k, s in scores.best.items() if s.gain > 0.0})
    refitted = {r.detectability.key: r.refit_rmse_select for r in found.ranking if r.refit_rmse_select is not None}
    heads = [max(group, key=lambda k: scores.best[k].gain) for group in alike]
    seen = {k: s for k, s in scores.best.items() if math.isfinite(s.minimum_detectable_strength)}
    largest = max((s.gain for s in seen.values()), default=0.0)
    white = p_value(
        {k: s.sensitivity for k, s in seen.items()}, {k: bench.plausible_range(k) for k in seen}, largest, seed
    )
    return {
        "by_score": first(lambda k, c: bench.score_effect(k, scores.basis, scores.residual, c)),
        "by_score_unclipped": first(
            lambda k, c: score_test(
                scores.basis, scores.residual, c, (-math.inf, math.inf), bench.effects[k].absorbed_from
            )
        ),
        "by_score_unprojected": first(lambda k, c: bench.score_effect(k, nothing, raw, c)),
        "by_heads_of_classes": min((h for h in heads if h in refitted), key=lambda h: refitted[h], default=""),
        "chance": scores.p_value,
        "chance_if_white": white,
    }


def cases(seeds: range, quick: bool) -> Iterator[tuple[str, str, tuple[str, ...], dict[str, float], int]]:
    """Group, name, hidden keys, their fields and seed of every case."""
    for seed in seeds:
        rng = np.random.default_rng([seed, 1])
        for key in list(SINGLES)[: 1 if quick else None]:
            yield "one effect", key, (key,), draw(rng, (key,)), seed
        for k in range(1 if quick else 2):
            yield "nothing", f"nothing {k}", (), {}, seed
        if quick:
            return
        for keys in PAIRS:
            yield "two effects", " + ".join(keys), keys, draw(rng, keys), seed
        for name, fields in UNLISTED.items():
            yield "in no catalogue", name, (), fields, seed
        for key in BENT:
            fields = draw(rng, (key,)) | {"pace": 0.07}
            yield "kinetics off", f"{key}, kinetics off", (key,), fields, seed
            yield "same input", f"{key}, kinetics off", (key,), fields, seed
        again = np.random.default_rng([seed, 1])
        drawn = {key: draw(again, (key,)) for key in SINGLES}
        for key in STARTS:
            yield "another start", key, (key,), drawn[key], seed


def answers(asked: Iterable[tuple], rig: Any, run: Callable[..., Facts], folder: Path | None) -> list[Facts]:
    """What ``run`` makes of a rig and each case, or what the folder has of it already."""
    done = {(c["group"], c["case"], c["seed"]): c for c in read_cases(folder)}
    facts = []
    for group, name, keys, hidden, seed in asked:
        if (group, name, seed) not in done:
            done[group, name, seed] = run(rig, group, name, keys, hidden, seed)
            add_case(folder, done[group, name, seed])
        facts.append(done[group, name, seed])
    return facts


def main() -> None:
    """Runs all cases and prints the table."""
    args = arguments(
        __doc__, quick="one hidden effect and one case without", more={"--seeds": {"type": int, "default": 10}}
    )
    rig = read_rig(ROOT / "data" / "recordings" / "dead-weight" / "rig.toml")
    facts = answers(cases(range(1 if args.quick else args.seeds), args.quick), rig, run, args.out)
    words = "" if args.quick or args.seeds == 10 else f" --seeds {args.seeds}"
    finish(rows(facts), args, cases=facts, words=words)


def named(case: Facts, key: str) -> bool:
    """Whether a diagnosis names an effect, or a class that holds it."""
    return any(key == e or key in case["equivalent"].get(e, ()) or e in SAME.get(key, ()) for e in case["effects"])


def first(case: Facts) -> bool:
    """Whether the effect named first is the hidden one."""
    return bool(case["effects"]) and case["effects"][0] == case["keys"][0]


def said(case: Facts) -> set[frozenset[str]]:
    """The effects named, each with its class."""
    return {frozenset({e, *case["equivalent"].get(e, ())}) for e in case["effects"]}


def share(what: str, hits: list[bool], target: float | None, at_most: bool = False) -> Row:
    """How often a statement holds, against its target."""
    rate = float(np.mean(hits)) if hits else math.nan
    met = None if target is None or not hits else rate <= target if at_most else rate >= target
    sign = "<=" if at_most else ">="
    goal = "-" if target is None else f"{sign} {100 * target:.0f} %"
    return Row(what, goal, f"{sum(hits)} of {len(hits)}", met, {"share": rate})


def case_rows(singles: list[Facts], outside: list[Facts]) -> list[Row]:
    """What was named for each hidden effect, and for those that no catalogue lists."""
    table = []
    for key in SINGLES:
        counts = Counter(c["effects"][0] if c["effects"] else "none" for c in singles if c["keys"][0] == key)
        if counts:
            told = ", ".join(f"{k} {n}" for k, n in counts.most_common())
            held = [c["interval_holds"] for c in singles if c["keys"][0] == key and c["interval_holds"] is not None]
            told += f"; its interval holds the truth {sum(held)} of {len(held)} times" if held else ""
            table.append(Row(f"hidden {key}, named first", "-", told, None, dict(counts)))
    for name in dict.fromkeys(c["case"] for c in outside):
        told = Counter(
            f"{c['verdict']}, {c['unresolved_stage'] or '-'} ({', '.join(c['effects']) or 'no effect'})"
            for c in outside
            if c["case"] == name
        )
        table.append(Row(f"in no catalogue: {name}", "-", "; ".join(f"{k}: {n}" for k, n in told.most_common()), None))
    return table


def ablation_rows(singles: list[Facts], nulls: list[Facts], same: list[Facts]) -> list[Row]:
    """What a diagnosis would name without some of its parts."""
    return [
        *(
            share(f"ablation: {what}, the right effect first", [c[field] == c["keys"][0] for c in singles], None)
            for what, field in (
                ("no refit, the largest score", "by_score"),
                ("no refit, strengths not clipped", "by_score_unclipped"),
                ("no refit, nothing projected out", "by_score_unprojected"),
                ("one refit a class", "by_heads_of_classes"),
            )
        ),
        share(
            "ablation: residual taken for white, an alarm at 1 %", [c["chance_if_white"] < 0.01 for c in nulls], None
        ),
        share("the same, autocorrelation taken out as shipped", [c["chance"] < 0.01 for c in nulls], None),
        share(
            "ablation: selection by the same input, other effects named, too",
            [len(c["effects"]) > 1 for c in same],
            None,
        ),
    ]


def rows(facts: list[Facts]) -> list[Row]:
    """The table."""

    of: dict[str, list[Facts]] = {}
    for case in facts:
        of.setdefault(case["group"], []).append(case)
    singles, nulls, pairs, outside, bent, same, again = (
        of.get(g, [])
        for g in (
            "one effect",
            "nothing",
            "two effects",
            "in no catalogue",
            "kinetics off",
            "same input",
            "another start",
        )
    )
    usual = {(c["case"], c["seed"]): c for c in singles}
    table = [
        share("one effect: first, or in the class declared", [named(c, c["keys"][0]) for c in singles], 0.90),
        share("one effect: exactly and first", [first(c) for c in singles], 0.80),
        share("one effect: other effects named, too", [len(c["effects"]) > 1 for c in singles], 0.10, True),
        share(
            "one effect: held-out error within 1.2 of the noise",
            [c["holdout_over_noise"] <= 1.2 for c in singles],
            0.90,
        ),
        share(
            "one effect: its interval holds the truth",
            [c["interval_holds"] for c in singles if c["interval_holds"] is not None],
            0.90,
        ),
        share("nothing hidden: an effect named", [bool(c["effects"]) for c in nulls], 0.02, True),
        share("two effects: both named", [all(named(c, k) for k in c["keys"]) for c in pairs], 0.80),
        share(
            "in no catalogue: partial or unresolved", [c["verdict"] in ("partial", "unresolved") for c in outside], 0.95
        ),
        share("kinetics off by 7 %: the right effect first", [first(c) for c in bent], 0.80),
        share("kinetics off by 7 %: other effects named, too", [len(c["effects"]) > 1 for c in bent], 0.10, True),
        share(
            "another start point: the same effects", [said(c) == said(usual[c["case"], c["seed"]]) for c in again], 0.95
        ),
        *ablation_rows(singles, nulls, same),
    ]
    seconds = [c["seconds"] for c in singles]
    told = f"{np.median(seconds):.0f}, {max(seconds):.0f}"
    table.append(Row("seconds a case, median and longest (one effect)", "<= 60 s", told, max(seconds) <= 60.0))
    table += case_rows(singles, outside)
    return table


if __name__ == "__main__":
    main()
