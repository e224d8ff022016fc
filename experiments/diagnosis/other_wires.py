"""Does a diagnosis name what is hidden in other wires than the shipped ones?

Truth from tests/reference, of which smajax shares nothing.

    python experiments/diagnosis/other_wires.py [--quick] [--seeds N] [--json FILE] [--out DIR]

As diagnosis_bench.py and diagnosis_two_wires.py, but every case draws a rig of its own: diameter from 0.1 to 0.31 mm,
length, load or prestrain and pulley, the room's temperature, and an alloy, whose transformation temperatures,
Clausius-Clapeyron coefficients, moduli, transformation strain and resistivities are nominal values of the rig file;
convection goes with the diameter. The free parameters are drawn near these, strengths log-uniformly from 0.2 to 2 of
a usual one, and the currents go with the wire. Recordings are as long as 100 of the wire's thermal time constants,
between 60 and 120 s.

With --out, each case is written to DIR/cases.jsonl as it ends, and a case that is there is not run again. ``--quick``
runs one case.
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

from experiments.common.base import ROOT, Row, arguments, finish, say
from experiments.diagnosis.hidden_effects import NOISE, SINGLES, Facts, answers, named, near
from experiments.diagnosis.hidden_effects import PAIRS as PAIRS_OF_ONE
from experiments.diagnosis.hidden_effects import UNLISTED as UNLISTED_OF_ONE
from experiments.diagnosis.two_wires import NOISE as NOISE_OF_ANGLE
from experiments.diagnosis.two_wires import PAIRS as PAIRS_OF_TWO
from experiments.diagnosis.two_wires import UNLISTED as UNLISTED_OF_TWO
from experiments.diagnosis.two_wires import USUAL as OF_TWO
from experiments.diagnosis.two_wires import count, seen_angle

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
DIAMETERS = (0.1, 0.125, 0.15, 0.2, 0.25, 0.31)  # mm, as they are sold
Case = tuple[str, str, tuple[str, ...], dict[str, float], int]


def other_rig(rng: np.random.Generator, kind: str) -> str:
    """The text of a rig file of a shipped kind for a wire that is drawn."""
    diameter, moved, wider = rng.choice(DIAMETERS), rng.uniform(-6.0, 12.0), rng.uniform(-3.0, 5.0)
    values = {
        "martensite_start": f"{50.0 + moved - wider:.1f} degC",
        "martensite_finish": f"{36.0 + moved - wider - rng.uniform(-3.0, 4.0):.1f} degC",
        "austenite_start": f"{64.0 + moved + wider:.1f} degC",
        "austenite_finish": f"{80.0 + moved + wider + rng.uniform(-3.0, 4.0):.1f} degC",
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


def amperes(rig: RigFile, temperature: float) -> float:
    """The current that holds a wire of half martensite at a temperature in degC."""
    material, heat, wire = rig.material, rig.heat, rig.wire
    rho = 0.5 * (material.resistivity_austenite + material.resistivity_martensite)
    flux = (heat.h0 + heat.h1 * temperature + heat.h2 * temperature**2) * (temperature - wire.ambient)
    return 0.25 * math.pi * math.sqrt(4.0 * flux * wire.diameter**3 / rho)


def record(rig: RigFile, hidden: Hidden, rng: np.random.Generator) -> list[Recording]:
    """Three recordings under three inputs of a wire whose free parameters are near the rig file's."""
    truth, material, wire, recordings = near(rng, rig), rig.material, rig.wire, []
    late = rig.heat.capacity_austenite * wire.diameter / (4.0 * rig.heat.h0)
    seconds = clock(round(min(max(100.0 * late, 60.0), 120.0)))
    for part in ("train", "select", "holdout"):
        if rig.kind == "dead-weight":
            stress = 9.81 * rig.mechanism["mass"] / (0.25 * math.pi * wire.diameter**2)
            cold, hot = stress / material.clausius_clapeyron_martensite, stress / material.clausius_clapeyron_austenite
            finish, full = material.austenite_finish + hot, amperes(rig, material.austenite_finish + hot + 22.0)
            low = (material.martensite_finish + cold - 7.0, material.martensite_start + cold - 6.0)
            bands = np.array([low, (material.austenite_start + hot + 4.0, finish + 3.0)])
            current = turns(
                rng, seconds, rig, (0.0, 0.42 * full), (0.93 * full, 1.1 * full), bands, finish + 28.0
            ).round(4)
            lifted = displacement(truth, hidden, seconds, current) + NOISE * rng.standard_normal(len(seconds))
            channels, units = {"current": current, "displacement": lifted}, {"displacement": "mm"}
            recordings.append(Recording.from_arrays(part, seconds, channels, units))
        else:
            full, slow = amperes(rig, material.austenite_finish + 25.0), late / 0.98
            both = taking_turns(rng, seconds, (1.5 * slow, 6.0 * slow), (0.75 * full, 1.2 * full)).round(4)
            recordings.append(seen_angle(truth, hidden, part, seconds, both, rng))
    return recordings


def run(rigs: None, group: str, name: str, keys: tuple[str, ...], hidden: dict[str, float], seed: int) -> Facts:
    """Diagnoses a case."""
    rng = np.random.default_rng([seed, *f"{group}, {name}".encode()])
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "rig.toml"
        path.write_text(other_rig(rng, KINDS[group]), "utf-8")
        rig: Rig = read_rig(path)
        recordings = record(reference_rig(path), Hidden(**hidden), rng)
    began = time.perf_counter()
    found = diagnose(DiagnosisProblem(rig.plant, recordings, rig.fit, interpolation=rig.interpolation), seed=seed)
    seconds = time.perf_counter() - began
    before, after = (
        max(found.rmse[c][f"holdout_{when}"] / NOISES[c] for c in found.rmse) for when in ("before", "after")
    )
    say(
        f"{group}, {name} ({seed}): {found.verdict} {', '.join(found.effects)}; {before:.2f} -> {after:.2f} of "
        f"the noise, {seconds:.0f} s"
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


def cases(seeds: range, quick: bool) -> Iterator[Case]:
    """Group, name, hidden keys, their fields and seed of every case."""
    kinds = {"one wire": (SINGLES, PAIRS_OF_ONE, UNLISTED_OF_ONE), "two wires": (OF_TWO, PAIRS_OF_TWO, UNLISTED_OF_TWO)}
    for seed in seeds:
        for group, (usual, pairs, unlisted) in kinds.items():
            rng = np.random.default_rng([seed, 4, *group.encode()])
            for keys in [(key,) for key in usual] + [()] + list(pairs):
                fields: dict[str, float] = {}
                for key in keys:
                    field, size, _, more = usual[key]
                    fields |= {field: size * math.exp(rng.uniform(math.log(0.2), math.log(2.0)))} | more
                yield group, " + ".join(keys) or "nothing", keys, fields, seed
                if quick:
                    return
            for name, fields in unlisted.items():
                yield group, name, (), fields, seed


def rows(facts: list[Facts]) -> list[Row]:
    """The table."""
    table = []
    for group in KINDS:
        of = [c for c in facts if c["group"] == group]
        singles, pairs = ([c for c in of if len(c["keys"]) == n] for n in (1, 2))
        nulls = [c for c in of if c["case"] == "nothing"]
        outside = [c for c in of if not c["keys"] and c["case"] != "nothing"]
        if not of:
            continue
        table += [
            count(
                f"{group}, one effect: first, or in the class declared", [named(c, c["keys"][0]) for c in singles], 0.90
            ),
            count(
                f"{group}, one effect: exactly and first",
                [list(c["effects"][:1]) == list(c["keys"]) for c in singles],
                0.80,
            ),
            count(f"{group}, one effect: no other named", [len(c["effects"]) <= 1 for c in singles], 0.90),
            count(
                f"{group}, one effect: held-out error within 1.2 of the noise",
                [c["holdout_over_noise"] <= 1.2 for c in singles],
                0.90,
            ),
            count(f"{group}, nothing hidden: no effect named", [not c["effects"] for c in nulls], 0.98),
            count(f"{group}, two effects: both named", [all(named(c, k) for k in c["keys"]) for c in pairs], 0.80),
            count(
                f"{group}, in no catalogue: partial or unresolved",
                [c["verdict"] in ("partial", "unresolved") for c in outside],
                0.95,
            ),
        ]
        seconds = [c["seconds"] for c in of]
        told = f"{np.median(seconds):.0f}, {max(seconds):.0f}"
        table.append(Row(f"{group}: seconds a case, median and longest", "<= 60 s", told, max(seconds) <= 60.0))
        for name in dict.fromkeys(c["case"] for c in of):
            told = "; ".join(
                f"{c['verdict']}: {', '.join(c['effects']) or 'none'}, {c['before_over_noise']:.1f} -> "
                f"{c['holdout_over_noise']:.2f}"
                for c in of
                if c["case"] == name
            )
            table.append(Row(f"{group}, {name}: verdict, error over noise", "-", told, None))
    return table


def main() -> None:
    """Runs all cases and prints the table."""
    args = arguments(__doc__, quick="one case", more={"--seeds": {"type": int, "default": 1}})
    facts = answers(cases(range(1 if args.quick else args.seeds), args.quick), None, run, args.out)
    words = "" if args.quick or args.seeds == 1 else f" --seeds {args.seeds}"
    finish(rows(facts), args, cases=facts, words=words)


if __name__ == "__main__":
    main()
