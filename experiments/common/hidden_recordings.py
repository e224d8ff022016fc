"""Recordings of one wire with hidden effects, by the reference simulator (tests/reference/hidden.py).

It shares no code with smajax.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from typing import Any

import numpy as np

from smajax.recordings.recording import Recording
from tests.reference.hidden import Hidden, displacement
from tests.reference.make_data import clock, shipped, turns
from tests.reference.rig_file import RigFile

# By key of an effect: field of the reference simulator, typical size, strength in the catalogue for a size of 1 (None
# where the two forms have no strength in common), and fields that are set with it.
EFFECTS: dict[str, tuple[str, float, float | None, dict[str, float]]] = {
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
NOISE = 2e-5  # m, standard deviation of the measured displacement


def draw_strengths(
    rng: np.random.Generator, keys: tuple[str, ...], table: dict[str, Any] | None = None
) -> dict[str, float]:
    """Return the reference's fields for effects of drawn strengths.

    Args:
        rng: Random generator.
        keys: Keys of the effects.
        table: The effects' fields and typical sizes; ``EFFECTS`` by default.
    """
    fields: dict[str, float] = {}
    for key in keys:
        name, usual, _, more = (table or EFFECTS)[key]
        fields |= {name: usual * math.exp(rng.uniform(math.log(0.3), math.log(1.5)))} | more
    return fields


def draw_shipped_rig(rng: np.random.Generator, kind: str) -> RigFile:
    """Return a shipped rig of the reference simulator, its free parameters drawn near their nominal values."""
    return perturb_rig(rng, shipped(kind))


def perturb_rig(rng: np.random.Generator, rig: RigFile) -> RigFile:
    """Return a rig whose free parameters are drawn near their nominal values."""
    return rig.changed(
        h0=rng.uniform(0.92, 1.08),
        h2=rng.uniform(0.8, 1.2),
        capacity=rng.uniform(0.95, 1.05),
        max_transformation_strain=rng.uniform(0.97, 1.03),
        austenite_shift=rng.uniform(-2.5, 2.5),
        martensite_shift=rng.uniform(-2.5, 2.5),
    )


def draw_inputs(rng: np.random.Generator) -> Iterator[tuple[str, np.ndarray, np.ndarray]]:
    """Yield name, times and current of the three recordings of a case."""
    seconds = clock(80.0)
    rig = shipped("dead-weight")
    bands = np.array([[46.0, 62.0], [84.0, 100.0]])
    for part in ("train", "select", "holdout"):
        yield part, seconds, turns(rng, seconds, rig, (0.0, 0.14), (0.28, 0.35), bands).round(4)


def record(hidden: dict[str, float], rng: np.random.Generator, *, same_input: bool = False) -> list[Recording]:
    """Make three recordings of one wire under three inputs.

    Args:
        hidden: The hidden fields.
        rng: Random generator.
        same_input: Give the second recording the input of the first.
    """
    truth = draw_shipped_rig(rng, "dead-weight")
    recordings = []
    for part, seconds, drawn in draw_inputs(rng):
        current = recordings[0].channels["current"] if part == "select" and same_input else drawn
        measured = displacement(truth, Hidden(**hidden), seconds, current) + NOISE * rng.standard_normal(len(seconds))
        recordings.append(
            Recording.from_arrays(part, seconds, {"current": current, "displacement": measured}, {"displacement": "mm"})
        )
    return recordings
