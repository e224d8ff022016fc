"""Rough rigs with hidden effects, by the reference simulator (tests/reference/rough.py): rig files and recordings.

It shares no code with smajax. Each rig is drawn: its wire and load, the values of its free parameters near those of its
rig file, and the background that makes it rough.
"""

from __future__ import annotations

import math
import re
import tempfile
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

from experiments.common.base import ROOT
from experiments.common.hidden_recordings import perturb_rig

import numpy as np

from smajax.recordings.recording import Recording
from tests.reference.hidden import Hidden
from tests.reference.make_data import taking_turns
from tests.reference.rig_file import RigFile, read_rig
from tests.reference.rough import (
    ANGLE_ENCODER,
    ENCODER,
    Background,
    draw_background,
    jittering_clock,
    read_sensor,
    simulate,
)
from tests.reference.wire import convection

# Folder of the shipped rig file of each kind.
KINDS = {"dead weight": "dead-weight", "spring": "bias-spring", "two wires": "rotary"}
PARTS = ("train", "select", "holdout")
SECONDS = 100.0
GRAVITY = 9.81
_SIZES = {0.15: (220.0, 290.0), 0.2: (250.0, 350.0), 0.25: (270.0, 400.0)}  # mm: sold diameters, lengths of rigs

# By key of an effect: field of the reference simulator, size, and fields that are set with it. A size is such that
# without the effect, the one-cell model would leave less than half of its excess (rough_rigs.py prints the share).
_OF_ALL: dict[str, tuple[str, float, dict[str, float]]] = {
    "latent-heat": ("latent_heat", 1.5e8, {}),
    "airflow-change": ("draught", 0.35, {"draught_instant": 41.0}),
    "ambient-drift": ("drift", 0.06, {}),  # 6 K in a recording
    "coulomb-friction": ("friction", 4e7, {}),
    "sensor-lag": ("lag", 0.6, {}),
    "current-limit": ("saturation", 0.15, {}),
}
_OF_ONE_WIRE = _OF_ALL | {
    "load-change": ("arm", 0.5, {}),
    "backlash": ("play", 6e-4, {}),
    "encoder-drift": ("encoder_drift", 2.5e-5, {}),
}
_OF_TWO_WIRES = _OF_ALL | {
    "backlash": ("play", math.radians(3.0), {}),
    "encoder-drift": ("encoder_drift", math.radians(0.08), {}),
    "wire-crosstalk": ("crosstalk", 0.1, {}),
}
# Under a dead weight every partial loop turns round at the plateau of the latent heat; with more of it, the wires would
# barely transform under the inputs of ``draw_current``, as under a lower limit of the current.
_UNDER_A_WEIGHT = _OF_ONE_WIRE | {
    "latent-heat": ("latent_heat", 8e7, {}),
    "current-limit": ("saturation", 0.1, {}),
    "backlash": ("play", 2e-3, {}),
}
# Against a spring, strain and transformation temperatures absorb most of a latent heat or a friction of the sizes
# above, and all of a lever that changes.
_ON_A_SPRING = {key: value for key, value in _OF_ONE_WIRE.items() if key != "load-change"} | {
    "latent-heat": ("latent_heat", 2e8, {}),
    "coulomb-friction": ("friction", 8e7, {}),
}
EFFECTS = {"dead weight": _UNDER_A_WEIGHT, "spring": _ON_A_SPRING, "two wires": _OF_TWO_WIRES}
PAIRS = (
    ("latent-heat", "sensor-lag"),
    ("ambient-drift", "backlash"),
    ("coulomb-friction", "latent-heat"),
    ("airflow-change", "encoder-drift"),
    ("sensor-lag", "ambient-drift"),
)


@dataclass(frozen=True)
class RoughRig:
    """A drawn rig.

    Attributes:
        text: Its rig file.
        nominal: The rig file as the reference simulator reads it.
        truth: The rig with its true values.
        background: What makes it rough.
        seed: Seed of its inputs and its noise.
    """

    text: str
    nominal: RigFile
    truth: RigFile
    background: Background
    seed: Sequence[int]

    @property
    def channel(self) -> str:
        """The observed channel."""
        return self.nominal.observe[0]

    @property
    def noise(self) -> float:
        """Standard deviation of the noise of the observed channel, SI."""
        return (ANGLE_ENCODER if self.channel == "angle" else ENCODER).noise


def draw_strengths(rng: np.random.Generator, kind: str, keys: Sequence[str]) -> dict[str, float]:
    """Return the reference's fields for effects, each of its size within 15 %."""
    fields: dict[str, float] = {}
    for key in keys:
        name, size, more = EFFECTS[kind][key]
        fields |= {name: size * rng.uniform(0.85, 1.15)} | more
    return fields


def draw_rig(kind: str, seed: Sequence[int], lines: Mapping[str, Sequence[str]] | None = None) -> RoughRig:
    """Draw a rig of a kind.

    Args:
        kind: A key of ``KINDS``.
        seed: Seed of the rig, its inputs and its noise.
        lines: Lines to add to the rig file by section (``rig_text``).
    """
    rng = np.random.default_rng([*seed, 0])
    text = rig_text(rng, kind, lines or {})
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "rig.toml"
        path.write_text(rig_text(np.random.default_rng([*seed, 0]), kind, {}), "utf-8")
        nominal = read_rig(path)
    wires = 2 if kind == "two wires" else 1
    return RoughRig(text, nominal, perturb_rig(rng, nominal), draw_background(rng, wires), seed)


def rig_text(rng: np.random.Generator, kind: str, lines: Mapping[str, Sequence[str]]) -> str:
    """Return the text of a rig file: that of a shipped rig with a drawn wire and load, under a current.

    All rig files of the bench come from here, so that settings of the model are added here.

    Args:
        rng: Random generator.
        kind: A key of ``KINDS``.
        lines: Lines to add by section, such as ``{"wire": ["cells = 9"]}``.
    """
    diameter = float(rng.choice(list(_SIZES)))
    length = rng.uniform(*_SIZES[diameter])
    section = 0.25 * math.pi * diameter**2  # mm^2
    stress, rise = rng.uniform(100.0, 150.0), rng.uniform(130.0, 180.0)  # MPa
    values = {
        "diameter": f"{diameter} mm",
        "h0": f"{100.6 * (0.15 / diameter) ** 0.6:.1f} W/m^2/K",
        "control": "current",
    }
    if kind == "dead weight":
        values |= {"length": f"{length:.0f} mm", "mass": f"{stress * section / GRAVITY:.4f} kg"}
    elif kind == "spring":
        length *= 0.75  # so that the one-cell fit leaves about as many times the noise as under a dead weight
        stiffness = rise * section / (0.04 * length)
        values |= {"length": f"{length:.0f} mm", "preload": f"{stress * section:.4f} N"}
        values |= {"stiffness": f"{stiffness:.5f} N/mm", "interpolation": "linear"}
    else:
        values |= {"length": f"{1.75 * length:.0f} mm", "radius": f"{rng.uniform(15.0, 25.0):.1f} mm"}
    text = (ROOT / "data" / "recordings" / KINDS[kind] / "rig.toml").read_text("utf-8")
    for key, value in values.items():
        text, times = re.subn(rf'^{key} = ".*?"', f'{key} = "{value}"', text, flags=re.MULTILINE)
        assert times == 1, key
    for section_name, added in lines.items():
        head = re.compile(rf"^\[{re.escape(section_name)}\].*$", re.MULTILINE)
        if not head.search(text):
            text += f"\n[{section_name}]\n"
        text = head.sub(lambda match, added=added: "\n".join([match[0], *added]), text)
    return text


def holding_current(rig: RigFile, temperature: float) -> float:
    """Return the current in A that holds a wire of half martensite at a temperature in degC."""
    material, wire = rig.material, rig.wire
    rho = 0.5 * (material.resistivity_austenite + material.resistivity_martensite)
    flux = convection(rig.heat, temperature) * (temperature - wire.ambient)
    return 0.25 * math.pi * math.sqrt(4.0 * flux * wire.diameter**3 / rho)


def draw_current(rng: np.random.Generator, rig: RigFile, seconds: np.ndarray) -> np.ndarray:
    """Return currents in A of a rig.

    One wire, shape ``(n,)``: levels in turn below and within or above the transformations, by steps or ramps, and an
    oscillation of falling amplitude before or after them. Two wires, shape ``(n, 2)``: the wires take turns.
    """
    material, of = rig.material, rig.mechanism
    slow = rig.heat.capacity_austenite * rig.wire.diameter / (4.0 * rig.heat.h0)
    if rig.kind == "antagonistic-rotary":
        full = holding_current(rig, material.austenite_finish + 25.0)
        return taking_turns(rng, seconds, (1.5 * slow, 6.0 * slow), (0.75 * full, 1.2 * full)).round(4)
    section = 0.25 * math.pi * rig.wire.diameter**2
    load = GRAVITY * of["mass"] if rig.kind == "dead-weight" else of["preload"]
    highest = load / section + of.get("stiffness", 0.0) * 0.04 * rig.wire.length / section
    full = holding_current(rig, material.austenite_finish + highest / material.clausius_clapeyron_austenite + 10.0)
    levels = full * draw_levels(rng, seconds, (1.5 * slow, 4.5 * slow))
    phase = (seconds - seconds[0]) / (rng.uniform(5.0, 9.0) * slow)
    wave = full * (
        rng.uniform(0.7, 0.8) + rng.uniform(0.25, 0.35) * np.exp(-phase / 12.0) * np.sin(2.0 * np.pi * phase)
    )
    share = rng.uniform(0.35, 0.45)
    waves = seconds < share * seconds[-1] if rng.random() < 0.5 else seconds > (1.0 - share) * seconds[-1]
    return np.where(waves, wave, levels).round(4)


def draw_levels(rng: np.random.Generator, seconds: np.ndarray, spans: tuple[float, float]) -> np.ndarray:
    """Return levels, shape ``(n,)``, in turn low and high.

    Each lasts for a time within ``spans`` (s), and is reached by a step or a ramp.
    """
    signal, now, before, is_high = np.zeros(len(seconds)), 0.0, 0.0, True
    while now <= seconds[-1]:
        span = rng.uniform(*spans)
        level = rng.uniform(0.75, 1.1) if is_high else rng.uniform(0.1, 0.6)
        rise = span * rng.uniform(0.3, 0.9) if rng.random() < 0.4 else 1e-9
        inside = (seconds >= now) & (seconds < now + span)
        signal[inside] = np.interp(seconds[inside] - now, [0.0, rise], [before, level])
        now, before, is_high = now + span, level, not is_high
    return signal


def record(rig: RoughRig, hidden: Mapping[str, float]) -> list[Recording]:
    """Make three recordings of a rig under three inputs, the same for all hidden effects.

    Args:
        rig: The rig.
        hidden: The hidden fields.
    """
    recordings = []
    for k, part in enumerate(PARTS):
        rng = np.random.default_rng([*rig.seed, 1 + k])
        seconds = jittering_clock(rng, SECONDS)
        current = draw_current(rng, rig.nominal, seconds)
        run = simulate(rig.truth, rig.background, Hidden(**hidden), seconds, current)
        if rig.channel == "angle":
            angle = read_sensor(rng, ANGLE_ENCODER, seconds, run.reading)
            channels = {"current_1": current[:, 0], "current_2": current[:, 1], "angle": angle}
            recordings.append(Recording.from_arrays(part, seconds, channels, {"angle": "deg"}))
        else:
            displacement = read_sensor(rng, ENCODER, seconds, run.reading)
            channels = {"current": current, "displacement": displacement}
            recordings.append(Recording.from_arrays(part, seconds, channels, {"displacement": "mm"}))
    return recordings
