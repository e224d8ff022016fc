"""A wire that positions a weight: its rigs, recordings, tuning problems and exact simulations."""

from __future__ import annotations

from dataclasses import dataclass, replace

from experiments.common.base import ROOT

import jax.numpy as jnp
import numpy as np

from smajax.control.controllers.pid import PID
from smajax.control.loop.allocation import Allocation
from smajax.control.loop.closed_loop import ClosedLoop
from smajax.control.loop.rollout import Scenario
from smajax.control.sampled_plant import SampledPlant
from smajax.control.sensors.sensor_model import SensorModel
from smajax.control.tuning.problem import GAIN_SPREAD, TuningProblem, noise_draws
from smajax.files.rig_file import Rig, parse_rig
from smajax.recordings.recording import Recording
from tests.reference.closed_loop import Pid, lift
from tests.reference.rig_file import RigFile
from tests.reference.rig_file import read_csv as read_reference_csv
from tests.reference.rig_file import read_rig as read_reference
from tests.reference.rig_file import simulate as simulate_reference

FOLDER = ROOT / "data" / "recordings" / "dead-weight"
NAMES = ("kp", "ki", "kd", "filter_time")
NOISE = 5e-6  # m
# Factors and shifts of the truth that the rig file does not have; data/recordings/SOURCE.md has the shipped ones.
TRUTH = {"h0": 1.06, "max_transformation_strain": 0.98, "austenite_shift": 1.5, "martensite_shift": -1.0}


@dataclass(frozen=True)
class Wire:
    """A rig, by its differences from the shipped one.

    Attributes:
        diameter: Diameter, m.
        mass: Load, kg.
        current: Factor of the recording's currents.
        time: Factor of the recording's times.
        period: Sampling period of the controller, s.
        start: Start gains: kp, ki, kd and filter time.
    """

    diameter: float
    mass: float
    current: float
    time: float
    period: float
    start: tuple[float, float, float, float]


WIRES = {
    "0.15 mm": Wire(0.15e-3, 0.2, 1.0, 1.0, 0.02, (30.0, 10.0, 0.5, 0.05)),
    "0.51 mm": Wire(0.51e-3, 2.5, 6.0, 3.4, 0.05, (180.0, 30.0, 6.0, 0.05)),
}


def make_rig(wire: Wire) -> tuple[Rig, RigFile]:
    """Return the rig with nominal values, and the truth."""
    text = (FOLDER / "rig.toml").read_text(encoding="utf-8")
    text = text.replace('diameter = "0.15 mm"', f'diameter = "{1e3 * wire.diameter:g} mm"').replace(
        'mass = "0.2 kg"', f'mass = "{wire.mass:g} kg"'
    )
    truth = read_reference(FOLDER / "rig.toml")
    truth = replace(truth, wire=truth.wire._replace(diameter=wire.diameter), mechanism={"mass": wire.mass}).changed(
        **TRUTH
    )
    return parse_rig(text, "wire.toml"), truth


def make_recording(wire: Wire, truth: RigFile) -> Recording:
    """Return a recording of the truth with noise."""
    channels = read_reference_csv(FOLDER / "train.csv")
    first_half = slice(0, len(channels["time"]) // 2)
    inputs = {
        "time": channels["time"][first_half] * wire.time,
        "current": channels["current"][first_half] * wire.current,
    }
    run = simulate_reference(truth, inputs)
    noise = NOISE * np.random.default_rng(0).standard_normal(len(run.position))
    measured = {"current": inputs["current"], "displacement": run.position + noise}
    return Recording.from_arrays("train", inputs["time"], measured, {"current": "A", "displacement": "mm"})


def make_scenario(wire: Wire, seed: int = 1) -> Scenario:
    """Return the staircase of the reference: up, further up, and down, 20 s each times the wire's time factor."""
    hold = round(20.0 * wire.time / wire.period)
    reference = np.repeat([4e-3, 6e-3, 2e-3], hold)
    draws = np.random.default_rng(seed).standard_normal(len(reference))
    return Scenario(jnp.asarray(reference), jnp.asarray(0.0), jnp.asarray(draws), {})


def make_problem(wire: Wire, rig: Rig, values: dict | None = None, noisy: bool = True) -> TuningProblem:
    """Return the tuning problem of a rig's plant.

    Args:
        wire: The wire.
        rig: The rig.
        values: Parameters in which the members differ; ``None`` for one plant.
        noisy: Whether one plant has several draws of the sensor's noise.
    """
    largest = 0.5 * wire.current
    pid = PID(*(jnp.asarray(v) for v in (*wire.start, 0.0, largest)), period=wire.period)
    loop = ClosedLoop(
        pid,
        Allocation(jnp.asarray(largest), jnp.asarray(0.0), 1),
        SensorModel(jnp.asarray(NOISE), jnp.asarray(0.0)),
        channel="displacement",
    )
    bounds = {n: (g / 100.0, g * 100.0) for n, g in zip(NAMES, wire.start, strict=True)}
    scenario = make_scenario(wire)
    has_draws = noisy and not values
    sampled = SampledPlant.of(rig.plant, wire.period)
    draws = noise_draws(loop, scenario) if has_draws else None
    return TuningProblem.of(sampled, loop, scenario, bounds, values, draws, GAIN_SPREAD if has_draws else 0.0)


def simulate_exact(wire: Wire, truth: RigFile, gains: dict[str, float]) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return displacement, temperature and command on the exact simulator.

    Args:
        wire: The wire.
        truth: The rig of the exact simulator.
        gains: The gains by name.
    """
    scenario = make_scenario(wire)
    pid = Pid(*(gains[n] for n in NAMES), 0.0, 0.5 * wire.current, wire.period)
    return lift(truth, pid, np.asarray(scenario.reference), NOISE * np.asarray(scenario.draws))


def rmse(wire: Wire, value: np.ndarray) -> float:
    """Return the tracking error, m."""
    return float(np.sqrt(np.mean((value - np.asarray(make_scenario(wire).reference)) ** 2)))
