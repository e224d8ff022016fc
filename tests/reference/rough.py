"""Rough rigs: a simulator of wires that no model of one cell and one grain matches; it shares no code with smajax.

- The wire has cells along its length, finer towards its ends (44 by default), with axial conduction to clamps that have a contact
  conductance, a heat capacity, and lose heat to the air. Convection varies along the wire by a few per cent.
- Each cell has the same grains (12 by default), which stand for the batch of the wire: their A_s and M_s are shifted by draws from two
  normal distributions, apart from each other. Branches are logistic, not cosine, in the relative form of ``rough_wire``.
- Resistivity follows the phase of each cell, convection a polynomial in T; stress is equal along the wire.
- Loads: a dead weight, a bias spring (force = preload + stiffness x contraction), or two wires on a pulley without inertia.
- Hidden effects are fields of ``hidden.Hidden``, those of ``KNOWN``.
- The sensor has a quantum, white noise and slow noise; the clock jitters, and its stamps are true.

Conventions are those of ``rigs``: row 0 is the start state, temperatures in degC, else SI.
"""

import math
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from tests.reference.hidden import Hidden, _behind
from tests.reference.hidden_pair import _loose
from tests.reference.rig_file import RigFile
from tests.reference.rough_steps import Load, run
from tests.reference.rough_wire import Constants, Wire

Floats = NDArray[np.float64]

KNOWN = {"latent_heat", "drift", "draught", "draught_instant", "saturation", "ceiling", "friction", "play", "lag"}
KNOWN |= {"encoder_drift", "crosstalk", "slack", "slack_span", "arm"}
KINDS = ("dead-weight", "bias-spring", "antagonistic-rotary")
GRAVITY = 9.81
AXIAL_CONDUCTIVITY = 18.0  # W/m/K, NiTi austenite


class Background(NamedTuple):
    """What makes a rig rough.

    Attributes:
        lengths: Lengths of the cells as shares of the wire, shape ``(cells,)``.
        cooling: Convection of each cell relative to the rig's, shape ``(wires, cells)``.
        austenite: Shift of A_s and A_f of each grain, K, shape ``(grains,)``.
        martensite: Shift of M_s and M_f of each grain, K, shape ``(grains,)``.
        branch: Width of a grain's branches as a share of the rig file's bands.
        conductivity: Heat conductivity of the wire, W/m/K.
        contact: Conductance between the end of a wire and its clamp, W/K; 0 for no clamps.
        clamp_capacity: Heat capacity of a clamp, J/K.
        clamp_loss: Conductance from a clamp to the air, W/K.
    """

    lengths: Floats
    cooling: Floats
    austenite: Floats
    martensite: Floats
    branch: float
    conductivity: float
    contact: float
    clamp_capacity: float
    clamp_loss: float


@dataclass(frozen=True)
class RoughRun:
    """Results at the samples, shape ``(n,)``, ``(n, wires)`` or ``(n, wires, cells)``.

    Attributes:
        reading: What an ideal sensor shows, with the hidden effects on the motion's way to it: displacement in m or angle in rad.
        position: The motion itself.
        temperature: Temperatures, degC.
        stress: Stresses, Pa.
        martensite: Martensite fractions.
        heated: Electric heat so far, J.
        lost: Heat lost to the air so far, J.
        clamped: Heat lost by the clamps so far, J.
        stored: Heat in wires and clamps, J, from a constant on.
    """

    reading: Floats
    position: Floats
    temperature: Floats
    stress: Floats
    martensite: Floats
    heated: Floats
    lost: Floats
    clamped: Floats
    stored: Floats


def cell_lengths(cells: int, finest: float = 0.08) -> Floats:
    """Lengths of cells, as shares of the wire, that grow from ``finest`` times the mean at both ends to the middle by a sine."""
    middle = (np.arange(cells) + 0.5) / cells
    lengths = finest + np.sin(math.pi * middle) ** 2
    return lengths / lengths.sum()


def draw_background(
    rng: np.random.Generator,
    wires: int = 1,
    *,
    cells: int = 44,
    grains: int = 12,
    bands: tuple[float, float] = (16.0, 14.0),
    spread: tuple[float, float] = (0.75, 1.0),
) -> Background:
    """Draw a background.

    Args:
        rng: Random generator.
        wires: Number of wires: of one batch, so with the same grains, but each with its own convection along its length.
        cells: Number of cells.
        grains: Number of grains in each cell.
        bands: Widths of the reverse and the forward transformation of the whole wire, A_f - A_s and M_s - M_f, K.
        spread: Limits of the standard deviations of the grains' shifts, over that with which logistic branches of all grains together
            have the standard deviation of one logistic branch over the whole band.
    """
    branch = rng.uniform(0.5, 0.8)
    deviations = np.array(bands) * math.sqrt(1.0 - branch**2) / (2.0 * math.sqrt(3.0))
    lengths = cell_lengths(cells)
    middle = np.cumsum(lengths) - 0.5 * lengths
    waves = np.arange(1, 4)[:, None]
    cooling = np.empty((wires, cells))
    for k in range(wires):
        phase, size = rng.uniform(0.0, 2.0 * math.pi, (3, 1)), rng.uniform(0.005, 0.015, (3, 1))
        wave = np.sum(size * np.sin(math.pi * waves * middle + phase), axis=0)
        cooling[k] = 1.0 + wave - np.sum(lengths * wave)
    return Background(
        lengths,
        cooling,
        *(rng.uniform(*spread) * deviation * rng.standard_normal(grains) for deviation in deviations),
        branch,
        AXIAL_CONDUCTIVITY,
        rng.uniform(0.01, 0.05),
        rng.uniform(0.1, 0.4),
        rng.uniform(0.005, 0.02),
    )


def smooth_background(wires: int = 1, cells: int = 1, grains: int = 1, branch: float = 1.0) -> Background:
    """Return a background without clamps, conduction and differences between cells and grains."""
    same = np.zeros(grains)
    return Background(cell_lengths(cells), np.ones((wires, cells)), same, same, branch, 0.0, 0.0, 1.0, 0.0)


def simulate(
    rig: RigFile, background: Background, hidden: Hidden, time: Floats, current: Floats, substeps: int | None = None
) -> RoughRun:
    """Run a rig.

    Args:
        rig: The rig.
        background: What makes it rough.
        hidden: Hidden effects. ``play`` and ``encoder_drift`` of a pulley are in rad and rad/s; that of a single wire starts at the end
            to which the load pulls it, that of a pulley in its middle. ``friction`` of a pulley is the difference of the wires'
            stresses that moves it.
        time: Times, s, shape ``(n,)``.
        current: Currents, A, shape ``(n,)``, or ``(n, 2)`` for two wires.
        substeps: Number of fine steps between two samples; by default 5, and 10 with latent heat.

    Raises:
        ValueError: If the rig or a hidden effect is not one of those that this simulator knows.
    """
    _check(rig, hidden)
    hidden = Hidden(*map(float, hidden))
    wires = 2 if rig.kind == "antagonistic-rotary" else 1
    time, current = (
        np.ascontiguousarray(time, float),
        np.ascontiguousarray(np.reshape(current, (len(time), wires)), float),
    )
    constants = _constants(rig, background)
    substeps = substeps or (10 if hidden.latent_heat else 5)
    load, fraction, stress = _load(rig)
    states = tuple(_start(rig, background, k, fraction, hidden) for k in (0, wires - 1))
    shape = (len(time), wires, len(background.lengths))
    results = (np.empty(shape), np.empty(shape[:2]), np.empty(shape), np.zeros((len(time), 4)))
    fine, place = run(
        constants, hidden, load, states, stress, time, current, rig.interpolation == "linear", substeps,
        float(np.max(current)), results,
    )  # fmt: skip
    if wires == 2:
        place = place * rig.wire.length / rig.mechanism["radius"]
        seen = _behind(fine, _loose(place, hidden.play), hidden._replace(play=0.0))
    else:
        seen = _behind(fine, place, hidden)
    temperature, stresses, xi, energy = results
    reading = np.interp(time, fine, seen) + hidden.encoder_drift * (time - time[0])
    return RoughRun(reading, np.interp(time, fine, place), temperature, stresses, xi, *energy.T)


def _check(rig: RigFile, hidden: Hidden) -> None:
    unknown = [
        name for name in Hidden._fields if name not in KNOWN and getattr(hidden, name) != Hidden()._asdict()[name]
    ]
    if rig.kind not in KINDS or rig.control != "current" or unknown:
        raise ValueError(
            f"no rough rig of kind '{rig.kind}' under a {rig.control} with {', '.join(unknown) or 'nothing'} hidden"
        )
    if rig.heat.exponent != 2.0 or rig.heat.capacity_austenite != rig.heat.capacity_martensite or rig.heat.latent_heat:
        raise ValueError(
            "a rough rig has h0 + h1 T + h2 T^2, one capacity for both phases, and latent heat only as a hidden effect"
        )


def _constants(rig: RigFile, background: Background) -> Constants:
    m, heat, wire = rig.material, rig.heat, rig.wire
    width = background.branch / (2.0 * math.pi)
    section = 0.25 * math.pi * wire.diameter**2
    lengths = background.lengths * wire.length
    reverse = width * (m.austenite_finish - m.austenite_start)
    twinning = width * (m.martensite_start - m.martensite_finish)
    detwinning = width * (m.detwinning_finish_stress - m.detwinning_start_stress)
    between = background.conductivity * section / (0.5 * (lengths[1:] + lengths[:-1]))
    half = background.conductivity * section / (0.5 * lengths[[0, -1]])
    ends = half * background.contact / (half + background.contact) if background.contact else np.zeros(2)
    return Constants(
        0.5 * (m.austenite_start + m.austenite_finish), reverse, m.clausius_clapeyron_austenite,
        0.5 * (m.detwinning_start_stress + m.detwinning_finish_stress), detwinning, m.clausius_clapeyron_martensite,
        m.martensite_start, 0.5 * (m.martensite_start + m.martensite_finish), twinning,
        m.modulus_austenite, m.modulus_martensite, m.max_transformation_strain,
        m.thermal_expansion_austenite, m.thermal_expansion_martensite, m.resistivity_austenite, m.resistivity_martensite,
        heat.capacity_austenite, heat.h0, heat.h1, heat.h2, wire.ambient, wire.diameter, section, wire.length,
        background.clamp_capacity, background.clamp_loss,
        np.exp(-background.austenite / reverse), background.martensite,
        np.exp(m.clausius_clapeyron_martensite * background.martensite / detwinning),
        np.exp(background.martensite / twinning), background.lengths, np.concatenate([ends[:1], between, ends[1:]]),
    )  # fmt: skip


def _load(rig: RigFile) -> tuple[Load, float, float]:
    """Return the load, the detwinned fraction at the start, and the stress there."""
    m, wire, of = rig.material, rig.wire, rig.mechanism
    section = 0.25 * math.pi * wire.diameter**2
    if rig.kind == "antagonistic-rotary":
        return Load(0.0, 0.0, 0.0, 0.0, wire.prestrain), min(wire.prestrain / m.max_transformation_strain, 1.0), 0.0
    if rig.kind == "bias-spring":
        stress, stiffness = of["preload"] / section, of["stiffness"] / section
    else:
        stress, stiffness = of["mass"] * GRAVITY / section, 0.0
    return Load(stress, stiffness, 0.0, stress / m.modulus_martensite + m.max_transformation_strain, 0.0), 1.0, stress


def _start(rig: RigFile, background: Background, k: int, fraction: float, hidden: Hidden) -> Wire:
    """Return wire ``k`` at ambient, all martensite, of which a fraction is detwinned."""
    cells, grains, t = len(background.lengths), len(background.austenite), rig.wire.ambient
    m = rig.material
    zeros = np.zeros(cells)
    content = zeros + rig.heat.capacity_austenite * t - hidden.latent_heat
    detwinned = np.full((cells, grains), fraction)
    return Wire(
        background.cooling[k].copy(), zeros + t, zeros + t, content, zeros + 1.0,
        zeros.copy(), zeros.copy(), zeros.copy(), zeros + m.resistivity_martensite, detwinned, 1.0 - detwinned,
        detwinned.copy(), 1.0 - detwinned, np.full(2, t), np.zeros(2), np.zeros(2), np.zeros(3),
    )  # fmt: skip


def jittering_clock(rng: np.random.Generator, seconds: float, rate: float = 50.0, jitter: float = 1e-3) -> Floats:
    """True times of the samples of a clock with a jitter of so many s, to 10 microseconds; they start at 0 and rise."""
    count = round(seconds * rate)
    time = np.arange(count + 1) / rate
    time[1:] += np.clip(jitter * rng.standard_normal(count), -0.4 / rate, 0.4 / rate)
    return time.round(5)


def slow_noise(rng: np.random.Generator, time: Floats, deviation: float, time_constant: float = 0.4) -> Floats:
    """Noise of first order of a standard deviation and a time constant in s, exact at uneven times."""
    noise, white = np.empty(len(time)), rng.standard_normal(len(time))
    noise[0] = white[0]
    for k, gap in enumerate(np.diff(time)):
        kept = math.exp(-gap / time_constant)
        noise[k + 1] = kept * noise[k] + math.sqrt(1.0 - kept * kept) * white[k + 1]
    return deviation * noise


class Sensor(NamedTuple):
    """Quantum and standard deviations of white and slow noise, SI."""

    quantum: float
    white: float
    slow: float

    @property
    def noise(self) -> float:
        """Standard deviation of all noise."""
        return math.sqrt(self.white**2 + self.slow**2 + self.quantum**2 / 12.0)


ENCODER = Sensor(1e-5, 9.5e-6, 6.5e-6)
ANGLE_ENCODER = Sensor(math.radians(0.025), math.radians(0.05), math.radians(0.03))


def read_sensor(rng: np.random.Generator, sensor: Sensor, time: Floats, exact: Floats) -> Floats:
    """Return what a sensor shows of an exact series."""
    noisy = exact + sensor.white * rng.standard_normal(len(time)) + slow_noise(rng, time, sensor.slow)
    return sensor.quantum * np.round(noisy / sensor.quantum)
