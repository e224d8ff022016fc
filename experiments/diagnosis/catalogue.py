"""Whether a diagnosis names the effects that hidden_effects.py leaves out, and what auxiliary channels add.

    python experiments/diagnosis/catalogue.py [--quick] [--seeds N] [--json FILE] [--out DIR]

The truth is tests/reference/hidden.py, which shares no code with smajax. The hidden effects are an R-phase (with the
martensite, or before it), a supply at its voltage limit, heat capacities, resistivities, slack, viscous friction,
transformation temperatures that shift with the cycles, a load that changes with the displacement, and a set that the
first heating recovers. Other cases have a temperature or a voltage recorded in addition: a thermocouple that lags or
picks up the current, and nothing hidden. Rig, inputs, draws and noise are those of hidden_effects.py. The effects that
two wires on a pulley can have are tried on the rig of two_wires.py as well.

With ``--out``, each case is appended to DIR/cases.jsonl when it ends, and cases that are there are not run again.
``--quick`` runs one case.
"""

from __future__ import annotations

import math
import sys
import time
from collections.abc import Iterator
from pathlib import Path

sys.path.insert(0, str(Path(__file__).resolve().parents[2]))  # the checkout: smajax, tests/reference, experiments

from experiments.common.base import ROOT, Row, arguments
from experiments.common.diagnosis_cases import (
    Case,
    Facts,
    error_text,
    names_effect,
    report_cases,
    scored_facts,
    time_rows,
)
from experiments.common.hidden_recordings import NOISE, draw_inputs, draw_shipped_rig
from experiments.diagnosis.two_wires import NOISE as NOISE_OF_ANGLE
from experiments.diagnosis.two_wires import record_angle

import numpy as np

from smajax.diagnosis.auxiliary_channels import with_auxiliary_channels
from smajax.diagnosis.outcome import diagnose
from smajax.diagnosis.problem import DiagnosisProblem
from smajax.files.rig_file import Rig, read_rig
from smajax.recordings.recording import Recording
from tests.reference.hidden import Hidden, channels
from tests.reference.rig_file import RigFile

# By name of a case: key of the effect, field of the reference simulator, typical size, fields that are set with it, and
# channels recorded in addition to the displacement.
CASES: dict[str, tuple[str, str, float, dict[str, float], tuple[str, ...]]] = {
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
# Names from which the noise is drawn, where a case has been renamed: its figures stay those of the earlier tables.
STREAMS = {"R-phase with martensite": "R-phase beside martensite"}
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


def hidden_state(truth: RigFile, hidden: dict[str, float], current: float) -> Hidden:
    """Return the fields of the reference simulator.

    Args:
        truth: The rig of the reference simulator.
        hidden: The hidden fields; ``share`` is the part of ``current`` that the supply's voltage cannot drive through
            the
            austenite.
        current: Largest current of the inputs, A.
    """
    fields = {k: v for k, v in hidden.items() if k != "share"}
    if "share" in hidden:
        ohms = truth.material.resistivity_austenite * truth.wire.length / (0.25 * math.pi * truth.wire.diameter**2)
        fields["ceiling"] = (1.0 - hidden["share"]) * current * ohms
    return Hidden(**fields)


def record_one_wire(hidden: dict[str, float], auxiliary: tuple[str, ...], rng: np.random.Generator) -> list[Recording]:
    """Make three recordings of one wire under three inputs.

    Args:
        hidden: The hidden fields.
        auxiliary: Channels recorded in addition to the displacement.
        rng: Random generator.
    """
    truth, recordings = draw_shipped_rig(rng, "dead-weight"), []
    for part, seconds, current in draw_inputs(rng):
        exact = channels(truth, hidden_state(truth, hidden, 0.35), seconds, current)
        measured = {c: exact[c] + NOISES[c] * rng.standard_normal(len(seconds)) for c in ("displacement", *auxiliary)}
        recordings.append(
            Recording.from_arrays(part, seconds, {"current": current, **measured}, {c: UNITS[c] for c in measured})
        )
    return recordings


def record_two_wires(hidden: dict[str, float], rng: np.random.Generator) -> list[Recording]:
    """Make three recordings of two wires on a pulley."""
    truth = draw_shipped_rig(rng, "rotary")
    return [
        record_angle(truth, hidden_state(truth, hidden, 0.47), part, rng) for part in ("train", "select", "holdout")
    ]


def run(rigs: dict[str, Rig], case: Case) -> Facts:
    """Record and diagnose a case."""
    group, name, _, hidden, seed = case
    start = time.perf_counter()
    rng = np.random.default_rng([seed, *STREAMS.get(name, name).encode()])
    auxiliary = CASES[name][4]
    rig = rigs[group]
    recordings = record_two_wires(hidden, rng) if group == "two wires" else record_one_wire(hidden, auxiliary, rng)
    plant, settings = with_auxiliary_channels(rig.plant, rig.fit, auxiliary)
    diagnosis = diagnose(DiagnosisProblem(plant, recordings, settings, interpolation=rig.interpolation), seed=seed)
    return scored_facts(f"{group}, {name}", case, diagnosis, NOISES, time.perf_counter() - start)


def cases(seeds: range, quick: bool) -> Iterator[Case]:
    """Yield all cases of a range of seeds."""
    for seed in seeds:
        rng = np.random.default_rng([seed, 3])
        for name, (key, field, typical, fields, _) in list(CASES.items())[: 1 if quick else None]:
            size = typical * math.exp(rng.uniform(math.log(0.5), math.log(1.5)))
            yield "one wire", name, (key,) if key else (), ({field: size} | fields if field else {}), seed
        for name in () if quick else TWO_WIRES:
            key, field, typical, fields, _ = CASES[name]
            yield (
                "two wires",
                name,
                (key,),
                {field: typical * math.exp(rng.uniform(math.log(0.5), math.log(1.5)))} | fields,
                seed,
            )


def rows(facts: list[Facts]) -> list[Row]:
    """Return the rows of the table."""
    hidden = [c for c in facts if c["keys"]]
    hits = [names_effect(c, c["keys"][0]) for c in hidden]
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
        text = []
        for c in (c for c in facts if (c["group"], c["case"]) == (group, name)):
            effects = [f"{e} (or {', '.join(same)})" if (same := c["equivalent"].get(e)) else e for e in c["effects"]]
            text.append(f"{', '.join(effects) or 'none'}, {error_text(c)}")
        table.append(Row(f"{group}, {name}: named, error over noise", CASES[name][0] or "none", "; ".join(text), None))
    return [*table, *time_rows("", facts)]


def main() -> None:
    """Run all cases and print the table."""
    args = arguments(__doc__, quick="one case", more={"--seeds": {"type": int, "default": 1}})
    kinds = {"one wire": "dead-weight", "two wires": "rotary"}
    rigs = {group: read_rig(ROOT / "data" / "recordings" / kind / "rig.toml") for group, kind in kinds.items()}
    report_cases(args, 1, rigs, cases, run, rows)


if __name__ == "__main__":
    main()
