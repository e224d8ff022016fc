"""Does a diagnosis name what is hidden in two wires on a pulley?

Truth from tests/reference/hidden_pair.py, of which smajax shares nothing.

    python experiments/diagnosis/two_wires.py [--quick] [--seeds N] [--json FILE] [--out DIR]

As diagnosis_bench.py, for the rig whose fit is the harder one: the angle remembers every turn of both wires, so that
a large effect bends the first fit beyond coming to rest. Every case draws the rig's free parameters near their
nominal values, the strength log-uniformly from 0.3 to 1.5 of a usual one, and three inputs of 80 s; the angle has
noise of 0.06 degrees and is rounded to 0.025 degrees.

With --out, each case is written to DIR/cases.jsonl as it ends, and a case that is there is not run again. ``--quick``
runs one hidden effect and one case without.
"""

from __future__ import annotations

import math
import sys
import time
from collections import Counter
from collections.abc import Iterator
from pathlib import Path

sys.path.insert(0, str(Path(__file__).resolve().parents[2]))  # the checkout: smajax, tests/reference, experiments

from experiments.common.base import ROOT, Row, arguments, finish, say
from experiments.diagnosis.hidden_effects import SINGLES, Facts, answers, draw, named, nearby

import numpy as np

from smajax.diagnosis.outcome import diagnose
from smajax.diagnosis.problem import DiagnosisProblem
from smajax.files.rig_file import Rig, read_rig
from smajax.recordings.recording import Recording
from tests.reference.hidden import Hidden
from tests.reference.hidden_pair import angle
from tests.reference.make_data import rotary
from tests.reference.rig_file import RigFile

DEGREE = math.pi / 180.0
SPREAD, ROUNDED = 0.06 * DEGREE, 0.025 * DEGREE
NOISE = math.sqrt(SPREAD**2 + ROUNDED**2 / 12.0)
USUAL = SINGLES | {  # play in rad, drift of the encoder in rad/s
    "backlash": ("play", 7.5e-3, None, {}),
    "encoder-drift": ("encoder_drift", 7.5e-4, None, {}),
    "wire-crosstalk": ("crosstalk", 0.06, None, {}),
}
PAIRS = (
    ("latent-heat", "sensor-lag"),
    ("coulomb-friction", "latent-heat"),
    ("creep", "airflow-change"),
    ("wire-crosstalk", "latent-heat"),
)
UNLISTED = {"kinetics by half off": {"pace": 0.5}, "bent sensor": {"cubic": 0.1}}


def read_angle(truth: RigFile, hidden: Hidden, part: str, rng: np.random.Generator) -> Recording:
    """A recording of a pair of wires under an input that is drawn."""
    columns = rotary(rng)
    return seen_angle(
        truth,
        hidden,
        part,
        columns["time [s]"],
        np.column_stack([columns["current_1 [A]"], columns["current_2 [A]"]]),
        rng,
    )


def seen_angle(
    truth: RigFile, hidden: Hidden, part: str, seconds: np.ndarray, currents: np.ndarray, rng: np.random.Generator
) -> Recording:
    """What is recorded of a pair of wires under two currents (n, 2)."""
    turned = angle(truth, hidden, seconds, currents, 30) + SPREAD * rng.standard_normal(len(seconds))
    channels = {"current_1": currents[:, 0], "current_2": currents[:, 1], "angle": ROUNDED * np.round(turned / ROUNDED)}
    return Recording.from_arrays(part, seconds, channels, {"angle": "deg"})


def record(hidden: dict[str, float], rng: np.random.Generator) -> list[Recording]:
    """Three recordings of one pair of wires under three inputs."""
    truth = nearby(rng, "rotary")
    return [read_angle(truth, Hidden(**hidden), part, rng) for part in ("train", "select", "holdout")]


def run(rig: Rig, group: str, name: str, keys: tuple[str, ...], hidden: dict[str, float], seed: int) -> Facts:
    """Diagnoses a case."""
    recordings = record(hidden, np.random.default_rng([seed, *name.encode()]))
    began = time.perf_counter()
    found = diagnose(DiagnosisProblem(rig.plant, recordings, rig.fit, interpolation=rig.interpolation), seed=seed)
    seconds = time.perf_counter() - began
    before, after = (found.rmse["angle"][f"holdout_{when}"] / NOISE for when in ("before", "after"))
    say(
        f"{name} ({seed}): {found.verdict} {', '.join(found.effects)}; {before:.2f} -> {after:.2f} of the noise, "
        f"{seconds:.0f} s"
    )
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
        "before_over_noise": before,
        "holdout_over_noise": after,
        "seconds": seconds,
    }


def cases(seeds: range, quick: bool) -> Iterator[tuple[str, str, tuple[str, ...], dict[str, float], int]]:
    """Group, name, hidden keys, their fields and seed of every case."""
    for seed in seeds:
        rng = np.random.default_rng([seed, 2])
        for key in list(USUAL)[: 1 if quick else None]:
            yield "one effect", key, (key,), draw(rng, (key,), USUAL), seed
        yield "nothing", "nothing", (), {}, seed
        if quick:
            return
        for keys in PAIRS:
            yield "two effects", " + ".join(keys), keys, draw(rng, keys, USUAL), seed
        for name, fields in UNLISTED.items():
            yield "in no catalogue", name, (), fields, seed


def main() -> None:
    """Runs all cases and prints the table."""
    args = arguments(
        __doc__, quick="one hidden effect and one case without", more={"--seeds": {"type": int, "default": 2}}
    )
    rig = read_rig(ROOT / "data" / "recordings" / "rotary" / "rig.toml")
    facts = answers(cases(range(1 if args.quick else args.seeds), args.quick), rig, run, args.out)
    words = "" if args.quick or args.seeds == 2 else f" --seeds {args.seeds}"
    finish(rows(facts), args, cases=facts, words=words)


def count(what: str, hits: list[bool], target: float) -> Row:
    """The line of how many of some cases are hit, and whether these are enough."""
    met = float(np.mean(hits)) >= target if hits else None
    return Row(
        what, f">= {100 * target:.0f} %", f"{sum(hits)} of {len(hits)}", met, {"hits": sum(hits), "cases": len(hits)}
    )


def rows(facts: list[Facts]) -> list[Row]:
    """The table."""
    singles, nulls, pairs, outside = (
        [c for c in facts if c["group"] == g] for g in ("one effect", "nothing", "two effects", "in no catalogue")
    )
    seconds = [c["seconds"] for c in singles]
    table = [
        count("one effect: first, or in the class declared", [named(c, c["keys"][0]) for c in singles], 0.90),
        count("one effect: exactly and first", [list(c["effects"][:1]) == list(c["keys"]) for c in singles], 0.80),
        count("one effect: no other named", [len(c["effects"]) <= 1 for c in singles], 0.90),
        count(
            "one effect: held-out error within 1.2 of the noise",
            [c["holdout_over_noise"] <= 1.2 for c in singles],
            0.90,
        ),
        count("nothing hidden: no effect named", [not c["effects"] for c in nulls], 0.98),
        count("two effects: both named", [all(named(c, k) for k in c["keys"]) for c in pairs], 0.80),
        count(
            "in no catalogue: partial or unresolved", [c["verdict"] in ("partial", "unresolved") for c in outside], 0.95
        ),
        Row(
            "seconds a case, median and longest (one effect)",
            "<= 60 s",
            f"{np.median(seconds):.0f}, {max(seconds):.0f}",
            max(seconds) <= 60.0,
        ),
    ]
    for key in USUAL:
        seen = [c for c in singles if c["keys"][0] == key]
        if seen:
            said = Counter(c["effects"][0] if c["effects"] else "none" for c in seen)
            errors = ", ".join(f"{c['before_over_noise']:.3g} -> {c['holdout_over_noise']:.3g}" for c in seen)
            told = f"{', '.join(f'{k} {n}' for k, n in said.most_common())}; held-out error over noise {errors}"
            table.append(Row(f"hidden {key}, named first", "-", told, None, dict(said)))
    return table


if __name__ == "__main__":
    main()
