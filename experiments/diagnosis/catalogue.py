"""Does a diagnosis name the effects that hidden_effects leaves out, and what do auxiliary channels add?

    python experiments/diagnosis/catalogue.py [--quick] [--seeds N] [--json FILE] [--out DIR]

Truth from tests/reference/hidden.py, which shares no code with smajax: an R-phase with martensite and one before it,
a supply that comes to its voltage, capacities, resistivities, slack, grease, temperatures that move with the cycles,
a load that changes along the way, a set that the first heating takes away. Then, with a temperature or a voltage that
was recorded and is not observed: a thermocouple that lags or picks up the current, and nothing at all. Rig, inputs,
draws and noise are those of hidden_effects. At last those effects that two wires on a pulley can have, too, on the
rig of diagnosis_two_wires.

With --out, each case is written to DIR/cases.jsonl as it ends, and a case that is there is not run again. ``--quick``
runs one case.
"""

from __future__ import annotations

import math
import sys
import time
from collections.abc import Iterator
from pathlib import Path

sys.path.insert(0, str(Path(__file__).resolve().parents[2]))  # the checkout: smajax, tests/reference, experiments

from experiments.common.base import ROOT, Row, arguments, finish, say
from experiments.diagnosis.hidden_effects import NOISE, Facts, answers, inputs, named, nearby
from experiments.diagnosis.two_wires import NOISE as NOISE_OF_ANGLE
from experiments.diagnosis.two_wires import read_angle

import numpy as np

from smajax.diagnosis.auxiliary_channels import with_auxiliary_channels
from smajax.diagnosis.outcome import diagnose
from smajax.diagnosis.problem import DiagnosisProblem
from smajax.files.rig_file import Rig, read_rig
from smajax.recordings.recording import Recording
from tests.reference.hidden import Hidden, channels
from tests.reference.rig_file import RigFile

# Name: the effect's key, the reference's field, a usual size, fields that go with it, and the channels recorded
# in addition to the displacement.
FURTHER: dict[str, tuple[str, str, float, dict[str, float], tuple[str, ...]]] = {
    "R-phase with martensite": ("r-phase", "r_strain", 5e-3, {"r_above": 6.0, "r_spread": 3.0, "r_kept": 1.0}, ()),
    "R-phase before martensite": ("r-phase", "r_strain", 6e-3, {"r_above": 18.0, "r_spread": 2.0, "r_hump": 0.1}, ()),
    "supply at its voltage": ("current-limit", "share", 0.12, {}, ()),
    "heat capacities": ("heat-capacity", "capacity_change", -0.12, {}, ()),
    "resistivity with temperature": ("resistivity-temperature", "resistivity_slope", 8e-4, {}, ()),
    "resistivity with strain": ("resistivity-strain", "resistivity_strain", 1.0, {}, ()),
    "slack": ("slack", "slack", 2e-4, {"slack_span": 8e-4}, ()),
    "grease": ("viscous-friction", "viscous", 2e8, {}, ()),
    "temperatures that move": ("transformation-shift", "shift", 0.4, {}, ()),
    "load along the way": ("load-change", "arm", 0.25, {}, ()),
    "set before the first heating": ("initial-set", "set_strain", 2e-3, {}, ()),
    "thermocouple that lags": ("thermocouple-lag", "probe_lag", 0.4, {}, ("temperature",)),
    "thermocouple in the current": ("thermocouple-pickup", "probe_pickup", 6.0, {}, ("temperature",)),
    "latent heat, temperature recorded": ("latent-heat", "latent_heat", 8e7, {}, ("temperature",)),
    "sensor lag, voltage recorded": ("sensor-lag", "lag", 0.15, {}, ("voltage",)),
    "nothing, temperature recorded": ("", "", 0.0, {}, ("temperature",)),
    "nothing, voltage recorded": ("", "", 0.0, {}, ("voltage",)),
}
TWO_WIRES = (
    "R-phase with martensite",
    "R-phase before martensite",
    "supply at its voltage",
    "heat capacities",
    "resistivity with temperature",
    "resistivity with strain",
    "temperatures that move",
)
NOISES = {"displacement": NOISE, "temperature": 0.4, "voltage": 5e-3, "angle": NOISE_OF_ANGLE}
UNITS = {"displacement": "mm", "temperature": "degC", "voltage": "V"}


def known(truth: RigFile, hidden: dict[str, float], current: float) -> Hidden:
    """What is hidden.

    A ``share`` is how much less than a current asks for, in austenite, the supply's voltage gives.
    """
    fields = {k: v for k, v in hidden.items() if k != "share"}
    if "share" in hidden:
        ohms = truth.material.resistivity_austenite * truth.wire.length / (0.25 * math.pi * truth.wire.diameter**2)
        fields["ceiling"] = (1.0 - hidden["share"]) * current * ohms
    return Hidden(**fields)


def one_wire(hidden: dict[str, float], auxiliary: tuple[str, ...], rng: np.random.Generator) -> list[Recording]:
    """Three recordings of one wire under three inputs."""
    truth, recordings = nearby(rng, "dead-weight"), []
    for part, seconds, current in inputs(rng):
        exact = channels(truth, known(truth, hidden, 0.35), seconds, current)
        seen = {c: exact[c] + NOISES[c] * rng.standard_normal(len(seconds)) for c in ("displacement", *auxiliary)}
        recordings.append(
            Recording.from_arrays(part, seconds, {"current": current, **seen}, {c: UNITS[c] for c in seen})
        )
    return recordings


def two_wires(hidden: dict[str, float], rng: np.random.Generator) -> list[Recording]:
    """Three recordings of two wires on a pulley."""
    truth = nearby(rng, "rotary")
    return [read_angle(truth, known(truth, hidden, 0.47), part, rng) for part in ("train", "select", "holdout")]


def run(
    rigs: dict[str, Rig], group: str, name: str, keys: tuple[str, ...], hidden: dict[str, float], seed: int
) -> Facts:
    """Diagnoses a case."""
    began, rng, auxiliary = time.perf_counter(), np.random.default_rng([seed, *name.encode()]), FURTHER[name][4]
    rig = rigs[group]
    recordings = two_wires(hidden, rng) if group == "two wires" else one_wire(hidden, auxiliary, rng)
    plant, settings = with_auxiliary_channels(rig.plant, rig.fit, auxiliary)
    found = diagnose(DiagnosisProblem(plant, recordings, settings, interpolation=rig.interpolation), seed=seed)
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
        "before_over_noise": before,
        "holdout_over_noise": after,
        "seconds": seconds,
    }


def cases(seeds: range, quick: bool) -> Iterator[tuple[str, str, tuple[str, ...], dict[str, float], int]]:
    """Group, name, hidden keys, their fields and seed of every case."""
    for seed in seeds:
        rng = np.random.default_rng([seed, 3])
        for name, (key, field, usual, more, _) in list(FURTHER.items())[: 1 if quick else None]:
            size = usual * math.exp(rng.uniform(math.log(0.5), math.log(1.5)))
            yield "one wire", name, (key,) if key else (), ({field: size} | more if field else {}), seed
        for name in () if quick else TWO_WIRES:
            key, field, usual, more, _ = FURTHER[name]
            yield (
                "two wires",
                name,
                (key,),
                {field: usual * math.exp(rng.uniform(math.log(0.5), math.log(1.5)))} | more,
                seed,
            )


def rows(facts: list[Facts]) -> list[Row]:
    """The table."""
    hidden = [c for c in facts if c["keys"]]
    hits = [named(c, c["keys"][0]) for c in hidden]
    close = [c["holdout_over_noise"] <= 1.2 for c in hidden]
    table = [
        Row("the right effect, or its class", ">= 90 %", f"{sum(hits)} of {len(hits)}", float(np.mean(hits)) >= 0.9),
        Row(
            "held-out error within 1.2 of the noise",
            ">= 90 %",
            f"{sum(close)} of {len(close)}",
            float(np.mean(close)) >= 0.9,
        ),
    ]
    if nulls := [c for c in facts if not c["keys"]]:
        alarms = [bool(c["effects"]) for c in nulls]
        table.append(
            Row("nothing hidden: an effect named", "<= 2 %", f"{sum(alarms)} of {len(alarms)}", not any(alarms))
        )
    for group, name in dict.fromkeys((c["group"], c["case"]) for c in facts):
        told = []
        for c in (c for c in facts if (c["group"], c["case"]) == (group, name)):
            of = [f"{e} (or {', '.join(same)})" if (same := c["equivalent"].get(e)) else e for e in c["effects"]]
            told.append(f"{', '.join(of) or 'none'}, {c['before_over_noise']:.1f} -> {c['holdout_over_noise']:.2f}")
        table.append(
            Row(f"{group}, {name}: named, error over noise", FURTHER[name][0] or "none", "; ".join(told), None)
        )
    seconds = [c["seconds"] for c in facts]
    told = f"{np.median(seconds):.0f}, {max(seconds):.0f}"
    return [*table, Row("seconds a case, median and longest", "<= 60 s", told, max(seconds) <= 60.0)]


def main() -> None:
    """Runs all cases and prints the table."""
    args = arguments(__doc__, quick="one case", more={"--seeds": {"type": int, "default": 1}})
    kinds = {"one wire": "dead-weight", "two wires": "rotary"}
    rigs = {group: read_rig(ROOT / "data" / "recordings" / kind / "rig.toml") for group, kind in kinds.items()}
    facts = answers(cases(range(1 if args.quick else args.seeds), args.quick), rigs, run, args.out)
    words = "" if args.quick or args.seeds == 1 else f" --seeds {args.seeds}"
    finish(rows(facts), args, cases=facts, words=words)


if __name__ == "__main__":
    main()
