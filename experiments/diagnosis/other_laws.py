"""Whether a diagnosis tells a wrong material law from a missing effect.

    python experiments/diagnosis/other_laws.py [--quick] [--seeds N] [--json FILE] [--out DIR]

The rig file has Brinson's law. In half of the cases the wire follows another one and nothing else is hidden: that of
Tanaka (tests/reference/one_fraction.py) or of Lagoudas with smooth hardening (tests/reference/lagoudas.py). In the
other half it follows Brinson's law, and an effect is hidden (tests/reference/hidden.py). None of these simulators
shares code with smajax. Every case draws the rig's free parameters near their nominal values and three inputs of 80 s;
strengths are typical ones. Each diagnosis compares the laws (``laws=True``).

The rows count the cases with a wrong law that is recognised, or that the recordings do not distinguish from an effect,
and those without an effect as a fact; and the cases with a missing effect in which the law is not called wrong.

With ``--out``, each case is appended to DIR/cases.jsonl when it ends, and cases that are there are not run again.
``--quick`` runs one case with each law and one with an effect.
"""

from __future__ import annotations

import sys
import time
from collections.abc import Iterator
from pathlib import Path

sys.path.insert(0, str(Path(__file__).resolve().parents[2]))  # the checkout: smajax, tests/reference, experiments

from experiments.common.base import ROOT, Row, arguments
from experiments.common.diagnosis_cases import Case, Facts, count_row, names_effect, report_cases, scored_facts
from experiments.common.hidden_recordings import EFFECTS, NOISE, draw_inputs, draw_shipped_rig, record

import numpy as np

from smajax import parameters
from smajax.diagnosis.outcome import diagnose
from smajax.diagnosis.problem import DiagnosisProblem
from smajax.files.rig_file import Rig, read_rig
from smajax.plant.plant import Plant
from smajax.recordings.recording import Recording
from tests.reference import lagoudas, one_fraction
from tests.reference.rig_file import RigFile

LAWS = ("tanaka", "lagoudas")
HIDDEN = ("latent-heat", "sensor-lag", "airflow-change", "backlash", "ambient-drift")
# m/s^2, standard gravity, of the load.
GRAVITY = 9.80665


def displacement(truth: RigFile, law: str, time: np.ndarray, current: np.ndarray) -> np.ndarray:
    """Simulate a wire with another law under its dead weight, in m."""
    rig = one_fraction.Rig(True, truth.material, truth.heat, truth.wire, 0.0, truth.mechanism["mass"] * GRAVITY)
    run = one_fraction.simulate(rig, time, current)
    return run[:, 0] if law == "tanaka" else _by_lagoudas(truth, run[:, 1], run[:, 2])


def _by_lagoudas(truth: RigFile, temperature: np.ndarray, stress: np.ndarray) -> np.ndarray:
    """Contraction of a wire with Lagoudas' law along a path of temperature, in m.

    Both phases have one resistivity and one heat capacity, so the temperature does not depend on the law.
    """
    m = truth.material
    law = lagoudas.Law(
        m.martensite_start,
        m.martensite_finish,
        m.austenite_start,
        m.austenite_finish,
        m.clausius_clapeyron_austenite,
        m.clausius_clapeyron_martensite,
        m.modulus_austenite,
        m.modulus_martensite,
        m.max_transformation_strain,
        1.0,
        0.0,
        0.0,
        float(stress[0]),
        0.25,
        0.25,
        0.25,
        0.25,
    )
    state = lagoudas.State(1.0, m.max_transformation_strain)
    strains = []
    for warm, load in zip(temperature, stress, strict=True):
        state = lagoudas.advance(law, state, float(warm), (float(load), float(load)))
        expansion = m.thermal_expansion_austenite * (warm - truth.wire.ambient)
        strains.append(lagoudas.strain(law, state, float(load)) + expansion)
    return truth.wire.length * (strains[0] - np.array(strains))


def with_other_law(law: str, rng: np.random.Generator) -> list[Recording]:
    """Make three recordings of a wire with another law under three inputs."""
    truth = draw_shipped_rig(rng, "dead-weight")
    material = truth.material._replace(resistivity_martensite=truth.material.resistivity_austenite)
    truth = RigFile(**{**truth.__dict__, "material": material})
    recordings = []
    for part, seconds, current in draw_inputs(rng):
        measured = displacement(truth, law, seconds, current) + NOISE * rng.standard_normal(len(seconds))
        recordings.append(
            Recording.from_arrays(part, seconds, {"current": current, "displacement": measured}, {"displacement": "mm"})
        )
    return recordings


def run(rig: Rig, case: Case) -> Facts:
    """Record and diagnose a case."""
    start = time.perf_counter()
    group, name, _, hidden, seed = case
    rng = np.random.default_rng([seed, *name.encode()])
    recordings = with_other_law(name, rng) if group == "wrong law" else record(hidden, rng)
    plant, interpolation = rig.plant, rig.interpolation
    if group == "wrong law":
        plant, interpolation = with_one_resistivity(plant), "hold"  # as one_fraction.py takes the current
    problem = DiagnosisProblem(plant, recordings, rig.fit, interpolation=interpolation)
    diagnosis = diagnose(problem, seed=seed, laws=True)
    law = diagnosis.law
    cause, better = (law.cause, law.better) if law is not None else ("none", None)
    say_errors = ", ".join(f"{key} {error:.3g}" for key, error in ({} if law is None else law.errors).items())
    label = f"{name}, {say_errors}, cause {cause}{f' ({better})' * bool(better)}"
    seconds = time.perf_counter() - start
    return scored_facts(label, case, diagnosis, {"displacement": NOISE}, seconds) | {
        "cause": cause,
        "better": better,
        "errors": {} if law is None else law.errors,
    }


def with_one_resistivity(plant: Plant) -> Plant:
    """Return the plant with the resistivity of austenite in both phases, as ``with_other_law`` makes the wire."""
    resistivity = float(parameters.get(plant, "material.resistivity_austenite"))
    return parameters.replace(plant, {"material.resistivity_martensite": resistivity})


def cases(seeds: range, quick: bool) -> Iterator[Case]:
    """Yield all cases of a range of seeds: two for each seed with a wrong law, and two with a missing effect."""
    for seed in seeds:
        for law in LAWS:
            yield "wrong law", law, (), {}, seed
        for k in range(1 if quick else 2):
            key = HIDDEN[(2 * seed + k) % len(HIDDEN)]
            name, typical, _, more = EFFECTS[key]
            yield "missing effect", key, (key,), {name: typical} | more, seed


def rows(facts: list[Facts]) -> list[Row]:
    """Return the rows of the table."""
    wrong, missing = ([f for f in facts if f["group"] == group] for group in ("wrong law", "missing effect"))
    return [
        count_row("wrong law: recognised", [f["cause"] == "law" for f in wrong], 0.8),
        count_row(
            "wrong law: recognised, or not distinguished from an effect",
            [f["cause"] in ("law", "either") for f in wrong],
            1.0,
        ),
        count_row("wrong law: no effect named", [not f["effects"] for f in wrong], 0.9),
        count_row("missing effect: law not called wrong", [f["cause"] != "law" for f in missing], 1.0),
        count_row("missing effect: named", [names_effect(f, f["keys"][0]) for f in missing], 0.9),
    ]


def main() -> None:
    """Run all cases and print the table."""
    args = arguments(
        __doc__, quick="one case with each law, one with an effect", more={"--seeds": {"type": int, "default": 5}}
    )
    rig = read_rig(ROOT / "data" / "recordings" / "dead-weight" / "rig.toml")
    report_cases(args, 5, rig, cases, run, rows)


if __name__ == "__main__":
    main()
