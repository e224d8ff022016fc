"""Whether a diagnosis names the hidden effect in wires other than the shipped ones.

    python experiments/diagnosis/other_wires.py [--quick] [--seeds N] [--json FILE] [--out DIR]

The truth is made by tests/reference, which shares no code with smajax. The cases are those of hidden_effects.py and
two_wires.py, but each draws its own rig: a diameter from 0.1 to 0.31 mm, length, load or prestrain and pulley, the
ambient temperature, and an alloy, whose transformation temperatures, Clausius-Clapeyron coefficients, moduli,
transformation strain and resistivities are nominal values of the rig file. Convection depends on the diameter. The free
parameters are drawn near these values, strengths log-uniformly from 0.2 to 2 times a typical one, and the currents are
scaled to the wire. A recording lasts 100 thermal time constants of the wire, but at least 60 and at most 120 s.

With ``--out``, each case is appended to DIR/cases.jsonl when it ends, and cases that are there are not run again.
``--quick`` runs one case.
"""

from __future__ import annotations

import math
import re
import sys
import tempfile
import time
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
from experiments.common.hidden_recordings import EFFECTS, NOISE, perturb_rig
from experiments.diagnosis.hidden_effects import PAIRS as PAIRS_OF_ONE
from experiments.diagnosis.hidden_effects import UNLISTED as UNLISTED_OF_ONE
from experiments.diagnosis.two_wires import NOISE as NOISE_OF_ANGLE
from experiments.diagnosis.two_wires import PAIR_EFFECTS, measure_angle
from experiments.diagnosis.two_wires import PAIRS as PAIRS_OF_TWO
from experiments.diagnosis.two_wires import UNLISTED as UNLISTED_OF_TWO

import numpy as np

from smajax.diagnosis.outcome import diagnose
from smajax.diagnosis.problem import DiagnosisProblem
from smajax.files.rig_file import Rig, read_rig
from smajax.recordings.recording import Recording
from tests.reference.hidden import Hidden, displacement
from tests.reference.make_data import clock, taking_turns, turns
from tests.reference.rig_file import RigFile
from tests.reference.rig_file import read_rig as reference_rig

KINDS = {"one wire": "dead-weight", "two wires": "rotary"}
NOISES = {"displacement": NOISE, "angle": NOISE_OF_ANGLE}
DIAMETERS = (0.1, 0.125, 0.15, 0.2, 0.25, 0.31)  # mm, sold sizes


def draw_rig_text(rng: np.random.Generator, kind: str) -> str:
    """Return the text of a rig file of a shipped kind, for a drawn wire."""
    diameter = rng.choice(DIAMETERS)
    shift = rng.uniform(-6.0, 12.0)
    widening = rng.uniform(-3.0, 5.0)
    values = {
        "martensite_start": f"{50.0 + shift - widening:.1f} degC",
        "martensite_finish": f"{36.0 + shift - widening - rng.uniform(-3.0, 4.0):.1f} degC",
        "austenite_start": f"{64.0 + shift + widening:.1f} degC",
        "austenite_finish": f"{80.0 + shift + widening + rng.uniform(-3.0, 4.0):.1f} degC",
        "clausius_clapeyron_austenite": f"{rng.uniform(5.5, 8.5):.2f} MPa/K",
        "clausius_clapeyron_martensite": f"{rng.uniform(5.5, 8.5):.2f} MPa/K",
        "modulus_austenite": f"{rng.uniform(28.0, 60.0):.1f} GPa",
        "modulus_martensite": f"{rng.uniform(16.0, 27.0):.1f} GPa",
        "resistivity_austenite": f"{rng.uniform(90.0, 105.0):.0f} uohm cm",
        "resistivity_martensite": f"{rng.uniform(74.0, 86.0):.0f} uohm cm",
        "max_transformation_strain": f"{rng.uniform(3.6, 5.2):.2f} %",
        "h0": f"{100.0 * (0.15 / diameter) ** 0.6 * rng.uniform(0.8, 1.25):.1f} W/m^2/K",
        "diameter": f"{diameter} mm",
        "ambient": f"{rng.uniform(16.0, 28.0):.1f} degC",
    }
    if kind == "dead-weight":
        mass = rng.uniform(110e6, 200e6) * 0.25 * math.pi * (1e-3 * diameter) ** 2 / 9.81
        values |= {"length": f"{rng.uniform(120.0, 450.0):.0f} mm", "mass": f"{mass:.4f} kg"}
    else:
        values |= {
            "length": f"{rng.uniform(300.0, 700.0):.0f} mm",
            "prestrain": f"{rng.uniform(1.5, 2.5):.2f} %",
            "radius": f"{rng.uniform(12.0, 25.0):.1f} mm",
        }
    text = (ROOT / "data" / "recordings" / kind / "rig.toml").read_text("utf-8")
    for key, value in values.items():
        text, times = re.subn(rf'^{key} = ".*?"', f'{key} = "{value}"', text, flags=re.MULTILINE)
        assert times == 1, key
    return text


def holding_current(rig: RigFile, temperature: float) -> float:
    """Return the current in A that holds a wire of half martensite at a temperature in degC."""
    material, heat, wire = rig.material, rig.heat, rig.wire
    rho = 0.5 * (material.resistivity_austenite + material.resistivity_martensite)
    flux = (heat.h0 + heat.h1 * temperature + heat.h2 * temperature**2) * (temperature - wire.ambient)
    return 0.25 * math.pi * math.sqrt(4.0 * flux * wire.diameter**3 / rho)


def record(rig: RigFile, hidden: Hidden, rng: np.random.Generator) -> list[Recording]:
    """Make three recordings under three inputs of a wire whose free parameters are near the rig file's.

    Args:
        rig: The rig of the reference simulator.
        hidden: What is hidden.
        rng: Random generator.
    """
    truth, material, wire, recordings = perturb_rig(rng, rig), rig.material, rig.wire, []
    time_constant = rig.heat.capacity_austenite * wire.diameter / (4.0 * rig.heat.h0)
    seconds = clock(round(min(max(100.0 * time_constant, 60.0), 120.0)))
    for part in ("train", "select", "holdout"):
        if rig.kind == "dead-weight":
            stress = 9.81 * rig.mechanism["mass"] / (0.25 * math.pi * wire.diameter**2)
            cold = stress / material.clausius_clapeyron_martensite
            hot = stress / material.clausius_clapeyron_austenite
            finish = material.austenite_finish + hot
            full = holding_current(rig, material.austenite_finish + hot + 22.0)
            low = (material.martensite_finish + cold - 7.0, material.martensite_start + cold - 6.0)
            bands = np.array([low, (material.austenite_start + hot + 4.0, finish + 3.0)])
            current = turns(
                rng, seconds, rig, (0.0, 0.42 * full), (0.93 * full, 1.1 * full), bands, finish + 28.0
            ).round(4)
            measured = displacement(truth, hidden, seconds, current) + NOISE * rng.standard_normal(len(seconds))
            channels, units = {"current": current, "displacement": measured}, {"displacement": "mm"}
            recordings.append(Recording.from_arrays(part, seconds, channels, units))
        else:
            full = holding_current(rig, material.austenite_finish + 25.0)
            slow = time_constant / 0.98
            currents = taking_turns(rng, seconds, (1.5 * slow, 6.0 * slow), (0.75 * full, 1.2 * full)).round(4)
            recordings.append(measure_angle(truth, hidden, part, seconds, currents, rng))
    return recordings


def run(rigs: None, case: Case) -> Facts:
    """Draw the rig of a case, record and diagnose it."""
    group, name, _, hidden, seed = case
    rng = np.random.default_rng([seed, *f"{group}, {name}".encode()])
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "rig.toml"
        path.write_text(draw_rig_text(rng, KINDS[group]), "utf-8")
        rig: Rig = read_rig(path)
        recordings = record(reference_rig(path), Hidden(**hidden), rng)
    start = time.perf_counter()
    problem = DiagnosisProblem(rig.plant, recordings, rig.fit, interpolation=rig.interpolation)
    diagnosis = diagnose(problem, seed=seed)
    seconds = time.perf_counter() - start
    facts = scored_facts(f"{group}, {name}", case, diagnosis, NOISES, seconds)
    return facts | {"unresolved_stage": diagnosis.unresolved_stage}


def cases(seeds: range, quick: bool) -> Iterator[Case]:
    """Yield all cases of a range of seeds."""
    kinds = {
        "one wire": (EFFECTS, PAIRS_OF_ONE, UNLISTED_OF_ONE),
        "two wires": (PAIR_EFFECTS, PAIRS_OF_TWO, UNLISTED_OF_TWO),
    }
    for seed in seeds:
        for group, (effects, pairs, unlisted) in kinds.items():
            rng = np.random.default_rng([seed, 4, *group.encode()])
            for keys in [(key,) for key in effects] + [()] + list(pairs):
                fields: dict[str, float] = {}
                for key in keys:
                    field, size, _, extra = effects[key]
                    fields |= {field: size * math.exp(rng.uniform(math.log(0.2), math.log(2.0)))} | extra
                yield group, " + ".join(keys) or "nothing", keys, fields, seed
                if quick:
                    return
            for name, fields in unlisted.items():
                yield group, name, (), fields, seed


def rows(facts: list[Facts]) -> list[Row]:
    """Return the rows of the table."""
    table = []
    for group in KINDS:
        group_facts = [c for c in facts if c["group"] == group]
        singles, pairs = ([c for c in group_facts if len(c["keys"]) == n] for n in (1, 2))
        nulls = [c for c in group_facts if c["case"] == "nothing"]
        outside = [c for c in group_facts if not c["keys"] and c["case"] != "nothing"]
        if not group_facts:
            continue
        table += verdict_rows(f"{group}, ", singles, nulls, pairs, outside)
        table += time_rows(f"{group}: ", group_facts)
        for name in dict.fromkeys(c["case"] for c in group_facts):
            text = "; ".join(
                f"{c['verdict']}: {', '.join(c['effects']) or 'none'}, {error_text(c)}"
                for c in group_facts
                if c["case"] == name
            )
            table.append(Row(f"{group}, {name}: verdict, error over noise", "-", text, None))
    return table


def main() -> None:
    """Run all cases and print the table."""
    args = arguments(__doc__, quick="one case", more={"--seeds": {"type": int, "default": 1}})
    report_cases(args, 1, None, cases, run, rows)


if __name__ == "__main__":
    main()
