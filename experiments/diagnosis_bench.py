"""Does a diagnosis name what is hidden? Truth from tests/reference/hidden.py, which shares no code with smajax.

    python experiments/diagnosis_bench.py [--quick] [--seeds N] [--json FILE] [--out DIR]

Every case draws the rig's free parameters near their nominal values, the strength log-uniformly from 0.3 to 1.5 of a usual one, and three
inputs of 80 s. Counted are: the right effect alone or as first (exact, or in the class that the verdict declares), alarms where nothing is
hidden, effects named too many, what is said of effects that no catalogue lists, whether the interval of the strength holds the true one,
and the held-out error over the noise. ``--quick`` runs one hidden effect and one case without.
"""

from __future__ import annotations

import math
import time
from collections import Counter
from dataclasses import dataclass, field

import numpy as np
from _common import ROOT, Row, arguments, finish, say

from smajax.diagnose.bench import Bench
from smajax.diagnose.verdict import Diagnosis, diagnose
from smajax.recording import Recording
from smajax.rig import Rig, read_rig
from tests.reference.hidden import Hidden, displacement
from tests.reference.make_data import clock, turns
from tests.reference.rig_file import read_rig as reference_rig

# Key: the reference's field, a usual size, what the strength in the catalogue is for a size of one, and fields that go with it.
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
    "creep": ("creep", 0.003, None, {"creep_time": 12.0}),
    "encoder-drift": ("encoder_drift", 1.5e-5, 1.0, {}),
}
SAME = {"ratcheting": {"functional-fatigue"}, "functional-fatigue": {"ratcheting"}}
PAIRS = (("latent-heat", "sensor-lag"), ("ambient-drift", "backlash"), ("coulomb-friction", "latent-heat"), ("creep", "airflow-change"))
UNLISTED = {"kinetics exponent": {"exponent": 1.35}, "load step": {"load_step": 0.12, "load_instant": 28.0}, "bent sensor": {"cubic": 0.05}}
NOISE = 2e-5


@dataclass
class Case:
    """What is hidden, and what was found."""

    name: str
    hidden: dict[str, float]
    keys: tuple[str, ...]
    found: Diagnosis | None = None
    seconds: float = 0.0
    ratio: float = math.nan
    facts: dict = field(default_factory=dict)


def draw(rng: np.random.Generator, keys: tuple[str, ...]) -> dict[str, float]:
    """The reference's fields for effects of drawn strengths."""
    fields: dict[str, float] = {}
    for key in keys:
        name, usual, _, more = SINGLES[key]
        fields |= {name: usual * math.exp(rng.uniform(math.log(0.3), math.log(1.5)))} | more
    return fields


def record(rig: Rig, hidden: dict[str, float], rng: np.random.Generator) -> list[Recording]:
    """Three recordings of one wire under three inputs."""
    truth = reference_rig(ROOT / "data" / "recordings" / "dead-weight" / "rig.toml").changed(
        h0=rng.uniform(0.92, 1.08), h2=rng.uniform(0.8, 1.2), capacity=rng.uniform(0.95, 1.05), max_strain=rng.uniform(0.97, 1.03),
        austenite_shift=rng.uniform(-2.5, 2.5), martensite_shift=rng.uniform(-2.5, 2.5),
    )  # fmt: skip
    recordings, seconds, bands = [], clock(80.0), np.array([[46.0, 62.0], [84.0, 100.0]])
    for part in ("train", "select", "holdout"):
        current = turns(rng, seconds, "dead-weight", (0.0, 0.14), (0.28, 0.35), bands).round(4)
        lifted = displacement(truth, Hidden(**hidden), seconds, current) + NOISE * rng.standard_normal(len(seconds))
        recordings.append(Recording.from_arrays(part, seconds, {"current": current, "displacement": lifted}, {"displacement": "mm"}))
    return recordings


def run(case: Case, rig: Rig, seed: int) -> Case:
    """Diagnoses a case."""
    began = time.perf_counter()
    rng = np.random.default_rng([seed, *case.name.encode()])
    bench = Bench(rig.plant, record(rig, case.hidden, rng), rig.fit, interpolation=rig.interpolation)
    case.found = diagnose(bench, seed=seed)
    case.seconds = time.perf_counter() - began
    case.ratio = case.found.rmse["displacement"]["holdout_after"] / NOISE
    case.facts = {
        "case": case.name, "seed": seed, "verdict": case.found.verdict, "effects": case.found.effects,
        "equivalent": case.found.equivalent, "unresolved_stage": case.found.unresolved_stage, "holdout_over_noise": case.ratio,
        "first_by_score": max(case.found.ranking, key=lambda r: r.gain or 0.0).sight.key, "seconds": case.seconds,
    }  # fmt: skip
    say(f"{case.name} ({seed}): {case.found.verdict} {', '.join(case.found.effects)}; {case.ratio:.2f} of the noise, {case.seconds:.0f} s")
    return case


def named(case: Case, key: str) -> bool:
    """Whether a diagnosis names an effect, or a class that holds it."""
    found = case.found
    assert found is not None
    return any(key == e or key in found.equivalent.get(e, ()) or e in SAME.get(key, ()) for e in found.effects)


def covered(case: Case) -> bool | None:
    """Whether the interval holds the true strength; ``None`` where the two forms have no strength in common."""
    found = case.found
    assert found is not None
    name, _, factor, _ = SINGLES[case.keys[0]]
    interval = found.intervals.get(f"effects.{case.keys[0]}.strength")
    return None if factor is None or interval is None else interval[0] <= factor * case.hidden[name] <= interval[1]


def main() -> None:
    """Runs all cases and prints the table."""
    args = arguments(__doc__, quick="one hidden effect and one case without", more={"--seeds": {"type": int, "default": 10}})
    seeds = range(1 if args.quick else args.seeds)
    rig = read_rig(ROOT / "data" / "recordings" / "dead-weight" / "rig.toml")
    singles, nulls, pairs, outside, bent = [], [], [], [], []
    for seed in seeds:
        rng = np.random.default_rng([seed, 1])
        singles += [run(Case(key, draw(rng, (key,)), (key,)), rig, seed) for key in list(SINGLES)[: 1 if args.quick else None]]
        nulls += [run(Case(f"nothing {k}", {}, ()), rig, seed) for k in range(1 if args.quick else 2)]
        if args.quick:
            break
        pairs += [run(Case(" + ".join(keys), draw(rng, keys), keys), rig, seed) for keys in PAIRS]
        outside += [run(Case(name, fields, ()), rig, seed) for name, fields in UNLISTED.items()]
        keys = ("latent-heat", "ambient-drift", "backlash")
        bent += [run(Case(f"{k}, kinetics off", draw(rng, (k,)) | {"exponent": 1.07}, (k,)), rig, seed) for k in keys]
    finish(
        "diagnosis_bench",
        rows(singles, nulls, pairs, outside, bent),
        args,
        cases=[c.facts for c in singles + nulls + pairs + outside + bent],
    )


def rows(singles: list[Case], nulls: list[Case], pairs: list[Case], outside: list[Case], bent: list[Case]) -> list[Row]:
    """The table."""

    def share(what: str, hits: list[bool], target: float | None, at_most: bool = False) -> Row:
        rate = float(np.mean(hits)) if hits else math.nan
        met = None if target is None or not hits else rate <= target if at_most else rate >= target
        sign = "<=" if at_most else ">="
        goal = "-" if target is None else f"{sign} {100 * target:.0f} %"
        return Row(what, goal, f"{sum(hits)} of {len(hits)}", met, {"share": rate})

    def first(case: Case) -> bool:
        return bool(case.found and case.found.effects) and case.found.effects[0] == case.keys[0]  # pyright: ignore

    table = [
        share("one effect: first, or in the class declared", [named(c, c.keys[0]) for c in singles], 0.90),
        share("one effect: exactly and first", [first(c) for c in singles], 0.80),
        share("one effect: first by its score alone, without refits", [c.facts["first_by_score"] == c.keys[0] for c in singles], None),
        share("one effect: others named beside it", [len(c.found.effects) > 1 for c in singles if c.found], 0.10, True),
        share("one effect: held-out error within 1.2 of the noise", [c.ratio <= 1.2 for c in singles], 0.90),
        share("one effect: its interval holds the truth", [v for v in map(covered, singles) if v is not None], 0.90),
        share("nothing hidden: an effect named", [bool(c.found.effects) for c in nulls if c.found], 0.02, True),
        share("two effects: both named", [all(named(c, k) for k in c.keys) for c in pairs], 0.80),
        share("in no catalogue: partial or unresolved", [c.found.verdict in ("partial", "unresolved") for c in outside if c.found], 0.95),
        share("kinetics off by 7 %: the right effect first", [first(c) for c in bent], 0.80),
        share("kinetics off by 7 %: others named beside it", [len(c.found.effects) > 1 for c in bent if c.found], 0.10, True),
    ]
    seconds = [c.seconds for c in singles]
    table.append(
        Row(
            "seconds a case, median and longest (one effect)",
            "<= 60 s",
            f"{np.median(seconds):.0f}, {max(seconds):.0f}",
            max(seconds) <= 60.0,
        )
    )
    confusion = {
        key: Counter(c.found.effects[0] if c.found and c.found.effects else "none" for c in singles if c.keys[0] == key) for key in SINGLES
    }
    for key, counts in confusion.items():
        table.append(Row(f"hidden {key}, named first", "-", ", ".join(f"{k} {n}" for k, n in counts.most_common()), None, dict(counts)))
    for case in outside:
        if case.found:
            told = f"{case.found.verdict}, {case.found.unresolved_stage or '-'} ({', '.join(case.found.effects) or 'no effect'})"
            table.append(Row(f"in no catalogue: {case.name}", "-", told, None))
    return table


if __name__ == "__main__":
    main()
