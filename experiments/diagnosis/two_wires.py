"""Whether a diagnosis names the effect that is hidden in recordings of two wires on a pulley.

    python experiments/diagnosis/two_wires.py [--quick] [--seeds N] [--json FILE] [--out DIR]

The truth is tests/reference/hidden_pair.py, which shares no code with smajax. This rig is harder to fit than that of
hidden_effects.py: the angle depends on the whole history of both wires, so that the first fit may not converge if an
effect is large. Every case draws the rig's free parameters near their nominal values, the strength log-uniformly from
0.3 to 1.5 times a typical one, and three inputs of 80 s. The angle has noise of 0.06 degrees and is rounded to 0.025
degrees.

With ``--out``, each case is appended to DIR/cases.jsonl when it ends, and cases that are there are not run again.
``--quick`` runs one hidden effect and one case without.
"""

from __future__ import annotations

import math
import sys
import time
from collections import Counter
from collections.abc import Iterator
from pathlib import Path

sys.path.insert(0, str(Path(__file__).resolve().parents[2]))  # the checkout: smajax, tests/reference, experiments

from experiments.common.base import ROOT, Row, arguments
from experiments.common.diagnosis_cases import (
    Case,
    Facts,
    error_text,
    report_cases,
    scored_facts,
    time_rows,
    verdict_rows,
)
from experiments.common.hidden_recordings import EFFECTS, draw_shipped_rig, draw_strengths

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
NOISE_DEVIATION = 0.06 * DEGREE
RESOLUTION = 0.025 * DEGREE
NOISE = math.sqrt(NOISE_DEVIATION**2 + RESOLUTION**2 / 12.0)
PAIR_EFFECTS = EFFECTS | {  # sizes in rad and rad/s
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


def record_angle(truth: RigFile, hidden: Hidden, part: str, rng: np.random.Generator) -> Recording:
    """Make a recording of a pair of wires under a drawn input.

    Args:
        truth: The rig of the reference simulator.
        hidden: What is hidden.
        part: Name of the recording.
        rng: Random generator.
    """
    columns = rotary(rng)
    return measure_angle(
        truth,
        hidden,
        part,
        columns["time [s]"],
        np.column_stack([columns["current_1 [A]"], columns["current_2 [A]"]]),
        rng,
    )


def measure_angle(
    truth: RigFile, hidden: Hidden, part: str, seconds: np.ndarray, currents: np.ndarray, rng: np.random.Generator
) -> Recording:
    """Make a recording of a pair of wires under two currents.

    Args:
        truth: The rig of the reference simulator.
        hidden: What is hidden.
        part: Name of the recording.
        seconds: Times, s, shape ``(n,)``.
        currents: Currents, A, shape ``(n, 2)``.
        rng: Random generator.
    """
    exact = angle(truth, hidden, seconds, currents, 30) + NOISE_DEVIATION * rng.standard_normal(len(seconds))
    channels = {
        "current_1": currents[:, 0],
        "current_2": currents[:, 1],
        "angle": RESOLUTION * np.round(exact / RESOLUTION),
    }
    return Recording.from_arrays(part, seconds, channels, {"angle": "deg"})


def record(hidden: dict[str, float], rng: np.random.Generator) -> list[Recording]:
    """Make three recordings of one pair of wires under three inputs."""
    truth = draw_shipped_rig(rng, "rotary")
    return [record_angle(truth, Hidden(**hidden), part, rng) for part in ("train", "select", "holdout")]


def run(rig: Rig, case: Case) -> Facts:
    """Record and diagnose a case."""
    _, name, _, hidden, seed = case
    recordings = record(hidden, np.random.default_rng([seed, *name.encode()]))
    start = time.perf_counter()
    problem = DiagnosisProblem(rig.plant, recordings, rig.fit, interpolation=rig.interpolation)
    diagnosis = diagnose(problem, seed=seed)
    seconds = time.perf_counter() - start
    facts = scored_facts(name, case, diagnosis, {"angle": NOISE}, seconds)
    return facts | {"unresolved_stage": diagnosis.unresolved_stage}


def cases(seeds: range, quick: bool) -> Iterator[Case]:
    """Yield all cases of a range of seeds."""
    for seed in seeds:
        rng = np.random.default_rng([seed, 2])
        for key in list(PAIR_EFFECTS)[: 1 if quick else None]:
            yield "one effect", key, (key,), draw_strengths(rng, (key,), PAIR_EFFECTS), seed
        yield "nothing", "nothing", (), {}, seed
        if quick:
            return
        for keys in PAIRS:
            yield "two effects", " + ".join(keys), keys, draw_strengths(rng, keys, PAIR_EFFECTS), seed
        for name, fields in UNLISTED.items():
            yield "in no catalogue", name, (), fields, seed


def main() -> None:
    """Run all cases and print the table."""
    args = arguments(
        __doc__, quick="one hidden effect and one case without", more={"--seeds": {"type": int, "default": 2}}
    )
    rig = read_rig(ROOT / "data" / "recordings" / "rotary" / "rig.toml")
    report_cases(args, 2, rig, cases, run, rows)


def rows(facts: list[Facts]) -> list[Row]:
    """Return the rows of the table."""
    singles, nulls, pairs, outside = (
        [c for c in facts if c["group"] == g] for g in ("one effect", "nothing", "two effects", "in no catalogue")
    )
    table = [*verdict_rows("", singles, nulls, pairs, outside), *time_rows("", singles)]
    for key in PAIR_EFFECTS:
        same_key = [c for c in singles if c["keys"][0] == key]
        if same_key:
            counts = Counter(c["effects"][0] if c["effects"] else "none" for c in same_key)
            errors = ", ".join(error_text(c, ".3g") for c in same_key)
            text = f"{', '.join(f'{k} {n}' for k, n in counts.most_common())}; held-out error over noise {errors}"
            table.append(Row(f"hidden {key}, named first", "-", text, None, dict(counts)))
    return table


if __name__ == "__main__":
    main()
