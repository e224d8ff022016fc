"""Temperature of a wire without a thermometer: estimates of its plant, an extended and an ensemble Kalman filter.

    python experiments/control/observers.py [--quick] [--json FILE]

The truth is the exact simulator (tests/reference), in air that cools 15 to 20 % more or less than the filters' rig
file says and is 2 to 5 K warmer or colder, under a minute of partial loops, pauses and saturation. Both filters
(kalman1960, whitaker2002) have standard deviations of 25 W/m^2/K for the convection and 4 K for the ambient
temperature. They are scored from the sixth second on: the RMS error of the temperature, and how often it is within
1.96 standard deviations. The time is that of one filter and one sample, alone and in a batch.

Then a PID moves the same wires over three steps with different sensors: a fine encoder; one with 0.1 mm of noise and a
delay of 0.1 s; the extended filter of the latter and the voltage; and the filter of the voltage alone. The gains tuned
for the fine encoder are those of the filters as well; the coarse encoder has its own.
"""

from __future__ import annotations

import dataclasses
import sys
import time
from pathlib import Path
from typing import Any

sys.path.insert(0, str(Path(__file__).resolve().parents[2]))  # the checkout: smajax, tests/reference, experiments

from experiments.common.base import ROOT, Row, arguments, finish

import jax
import jax.numpy as jnp
import numpy as np

from smajax.control.controllers.pid import PID
from smajax.control.estimators.ensemble_kalman_filter import EnsembleKalmanFilter
from smajax.control.estimators.extended_kalman_filter import ExtendedKalmanFilter
from smajax.control.loop.allocation import Allocation
from smajax.control.loop.closed_loop import ClosedLoop
from smajax.control.loop.rollout import Scenario
from smajax.control.sampled_plant import SampledPlant
from smajax.control.sensors.instruments import Instruments
from smajax.control.sensors.sensor_model import SensorModel
from smajax.control.tuning.problem import GAIN_SPREAD, TuningProblem, noise_draws
from smajax.control.tuning.tune import tune
from smajax.files.rig_file import read_rig
from tests.reference.closed_loop import Pid, lift
from tests.reference.rig_file import RigFile, simulate
from tests.reference.rig_file import read_rig as read_reference

RIG = ROOT / "data" / "recordings" / "dead-weight" / "rig.toml"
PERIOD = 0.05  # s
SAMPLES, FIRST_SCORED = 1200, 120
LAG = 0.6  # s, of the thermocouple
NOISE = {"voltage": 2e-3, "temperature": 0.5, "displacement": 2e-5}
AIR = {"heat.h0": 25.0, "environment.ambient": 4.0}
AIRS = ((1.2, 24.0), (0.8, 16.0), (1.2, 18.0), (0.85, 25.0))  # convection as a factor, ambient in degC
CHANNEL_SETS = (("voltage",), ("voltage", "displacement"), ("temperature",), ("voltage", "temperature"))
BATCH = 32
ENCODER_NOISE, ENCODER_DELAY = 1e-4, 2  # m, samples
START, LARGEST = {"kp": 30.0, "ki": 10.0, "kd": 0.5, "filter_time": 0.05}, 0.5
STEPS = np.repeat([4e-3, 6e-3, 2e-3], 400)  # m


def make_truth(convection: float, ambient: float) -> RigFile:
    """Return a wire that differs from the rig file's, in other air."""
    truth = read_reference(RIG).changed(h0=convection, h2=convection, austenite_shift=0.5)
    return dataclasses.replace(truth, wire=truth.wire._replace(ambient=ambient))


def make_record(convection: float, ambient: float, seed: int) -> tuple[jax.Array, dict[str, jax.Array], np.ndarray]:
    """Simulate a minute of one wire.

    Args:
        convection: Factor of the convection.
        ambient: Ambient temperature, degC.
        seed: Seed of current and noise.

    Returns:
        Current (A), measured channels, and temperature of the wire (degC).
    """
    truth = make_truth(convection, ambient)
    rng = np.random.default_rng(seed)
    levels = rng.uniform(0.15, 0.36, 41) * np.sqrt(convection)
    levels[::4] = 0.03
    current = np.repeat(levels, SAMPLES // 40)[: SAMPLES + 1]
    run = simulate(truth, {"time": np.arange(SAMPLES + 1) * PERIOD, "current": current})
    temperature = run.temperature[:, 0]
    probe = np.full(SAMPLES + 1, temperature[0])
    for k in range(SAMPLES):
        probe[k + 1] = probe[k] + (1.0 - np.exp(-PERIOD / LAG)) * (temperature[k + 1] - probe[k])
    exact = {
        "voltage": run.resistance[1:, 0] * current[:-1],
        "temperature": probe[1:],
        "displacement": run.position[1:],
    }
    measured = {n: jnp.asarray(v + NOISE[n] * rng.standard_normal(SAMPLES)) for n, v in exact.items()}
    return jnp.asarray(current[:-1]), measured, temperature[1:]


def filters(channels: tuple[str, ...]) -> dict[str, Any]:
    """Return both filters of the rig file's plant."""
    sampled = SampledPlant.of(read_rig(RIG).plant, PERIOD)
    zero = jnp.zeros(())
    instruments = Instruments({n: SensorModel(jnp.asarray(NOISE[n]), zero) for n in channels}, PERIOD, jnp.asarray(LAG))
    noise = {n: jnp.asarray(NOISE[n]) for n in channels}
    uncertain = {n: jnp.asarray(v) for n, v in AIR.items()}
    return {
        "extended": ExtendedKalmanFilter.of(sampled, instruments, AIR),
        "ensemble of 32": EnsembleKalmanFilter(sampled, noise, uncertain, jnp.asarray(LAG)),
    }


@jax.jit
def run_filter(filter_: Any, current: jax.Array, measured: dict[str, jax.Array]) -> tuple[jax.Array, jax.Array]:
    """Return temperatures and their standard deviations of a batch of wires (leading axis).

    Args:
        filter_: The filter.
        current: Currents, A, shape ``(wires, samples)``.
        measured: Measured channels, of the same shape.
    """

    def step(state: Any, row: tuple) -> tuple[Any, tuple[jax.Array, jax.Array]]:
        state = filter_.step(filter_.apply_command(state, row[0][None]), row[1])
        estimate = filter_.estimate(state)
        return state, (estimate.mean["temperature"], estimate.standard_deviation["temperature"])

    return jax.vmap(lambda c, m: jax.lax.scan(step, filter_.reset(), (c, m))[1])(current, measured)


def seconds_per_sample(
    filter_: Any, current: jax.Array, measured: dict[str, jax.Array], count: int, times: int
) -> float:
    """Return the least wall time of one filter and one sample.

    Args:
        filter_: The filter.
        current: Currents, A, shape ``(wires, samples)``.
        measured: Measured channels, of the same shape.
        count: Size of the batch.
        times: Number of runs.
    """
    current, measured = jax.tree.map(lambda v: jnp.broadcast_to(v[:1], (count, *v.shape[1:])), (current, measured))
    jax.block_until_ready(run_filter(filter_, current, measured))
    least = np.inf
    for _ in range(times):
        start = time.perf_counter()
        jax.block_until_ready(run_filter(filter_, current, measured))
        least = min(least, time.perf_counter() - start)
    return least / count / SAMPLES


def tune_gains(sensor: SensorModel) -> dict[str, float]:
    """Tune the gains for the rig file's plant and a sensor of its position."""
    pid = PID(*(jnp.asarray(v) for v in (*START.values(), 0.0, LARGEST)), period=PERIOD)
    loop = ClosedLoop(pid, Allocation(jnp.asarray(LARGEST), jnp.asarray(0.0), 1), sensor, channel="displacement")
    draws = np.random.default_rng(1).standard_normal(len(STEPS))
    scenario = dataclasses.replace(Scenario.noiseless(STEPS), draws=jnp.asarray(draws))
    bounds = {name: (value / 100.0, value * 100.0) for name, value in START.items()}
    sampled = SampledPlant.of(read_rig(RIG).plant, PERIOD)
    problem = TuningProblem.of(sampled, loop, scenario, bounds, draws=noise_draws(loop, scenario), spread=GAIN_SPREAD)
    return tune(problem, {"tracking": 1.0, "effort": 0.01}, {}, starts=4).gains


class Sensor:
    """The position that the controller measures: a delayed and noisy encoder, or an extended filter.

    The filter uses the encoder (if ``encoder``) and the voltage.
    """

    def __init__(self, seed: int, late: int, noise: float, filtered: bool = False, encoder: bool = True) -> None:
        self.rng = np.random.default_rng(seed)
        self.noise = noise
        self.delayed = [0.0] * late
        self.filtered, self.encoder = filtered, encoder
        zero = jnp.zeros(())
        sensors = {"voltage": SensorModel(jnp.asarray(NOISE["voltage"]), zero)}
        if encoder:
            sensors["displacement"] = SensorModel(jnp.asarray(noise), zero, late)
        self.filter = ExtendedKalmanFilter.of(
            SampledPlant.of(read_rig(RIG).plant, PERIOD), Instruments(sensors, PERIOD, zero), AIR
        )
        self.state = self.filter.reset()

    def __call__(self, position: float, ohms: float, command: float) -> float:
        """Return the displacement that the controller measures, m.

        Args:
            position: True displacement, m.
            ohms: Resistance of the wire.
            command: Current, A.
        """
        self.delayed.append(position + self.noise * self.rng.standard_normal())
        encoder_value = self.delayed.pop(0)
        if not self.filtered:
            return encoder_value
        measured = {"voltage": ohms * command + NOISE["voltage"] * self.rng.standard_normal()}
        if self.encoder:
            measured["displacement"] = encoder_value
        self.state, value = update_filter(
            self.filter, self.state, jnp.asarray([command]), jax.tree.map(jnp.asarray, measured)
        )
        return float(value)


@jax.jit
def update_filter(
    filter_: ExtendedKalmanFilter, state: Any, command: jax.Array, measured: dict[str, jax.Array]
) -> tuple[Any, jax.Array]:
    """Return the filter's state a sample later, and its displacement.

    Args:
        filter_: The filter.
        state: Its state.
        command: Current, A, shape ``(1,)``.
        measured: Measured channels.
    """
    state = filter_.step(filter_.apply_command(state, command), measured)
    return state, filter_.estimated_channel(state, "displacement")


def steering_errors(gains: dict[str, float], sensor: Any) -> list[float]:
    """Return the RMS error of each wire on the exact simulator, m, with the sensors that ``sensor(seed)`` makes."""
    errors = []
    for seed, air in enumerate(AIRS):
        pid = Pid(*(gains[n] for n in START), 0.0, LARGEST, PERIOD)
        value = lift(make_truth(*air), pid, STEPS, np.zeros(len(STEPS)), sense=sensor(seed))[0]
        errors.append(float(np.sqrt(np.mean((value - STEPS) ** 2))))
    return errors


def steering_rows() -> list[Row]:
    """Return one row for each sensor of the position."""
    zero = jnp.zeros(())
    fine_gains = tune_gains(SensorModel(jnp.asarray(NOISE["displacement"]), zero))
    coarse_gains = tune_gains(SensorModel(jnp.asarray(ENCODER_NOISE), zero, ENCODER_DELAY))
    sensors = {
        "an encoder of 20 um": (fine_gains, lambda seed: Sensor(seed, 0, NOISE["displacement"])),
        "an encoder of 0.1 mm, 0.1 s late": (coarse_gains, lambda seed: Sensor(seed, ENCODER_DELAY, ENCODER_NOISE)),
        "the same, gains of the first": (fine_gains, lambda seed: Sensor(seed, ENCODER_DELAY, ENCODER_NOISE)),
        "a filter of that and voltage": (
            fine_gains,
            lambda seed: Sensor(seed, ENCODER_DELAY, ENCODER_NOISE, filtered=True),
        ),
        "a filter of voltage alone": (
            fine_gains,
            lambda seed: Sensor(seed, ENCODER_DELAY, ENCODER_NOISE, filtered=True, encoder=False),
        ),
    }
    rows = []
    for name, (gains, sensor) in sensors.items():
        errors = steering_errors(gains, sensor)
        rows.append(
            Row(
                f"steered by {name}", "-", f"{', '.join(f'{1e3 * e:.3f}' for e in errors)} mm", None, {"rmse_m": errors}
            )
        )
    return rows


def main() -> None:
    """Print the table."""
    args = arguments(__doc__, quick="voltage alone, and fewer timings")
    records = [make_record(*where, seed) for seed, where in enumerate(AIRS, 3)]
    current = jnp.stack([t[0] for t in records])
    measured = jax.tree.map(lambda *v: jnp.stack(v), *(t[1] for t in records))
    temperatures = [t[2] for t in records]
    nothing = jax.tree.map(lambda v: jnp.full_like(v, jnp.nan), measured)

    def score_row(what: str, filter_: Any, channels: dict[str, jax.Array]) -> Row:
        mean, spread = (np.asarray(v)[:, FIRST_SCORED:] for v in run_filter(filter_, current, channels))
        error = mean - np.stack(temperatures)[:, FIRST_SCORED:]
        rmse = np.sqrt(np.mean(error**2, axis=1))
        share = np.mean(np.abs(error) < 1.96 * spread)
        text = f"{', '.join(f'{e:.2f}' for e in rmse)} K; within 95 % intervals {100 * share:.0f} %"
        return Row(what, "-", text, None, {"rms": rmse.tolist(), "inside": float(share)})

    rows = [score_row("the plant alone", filters(("voltage",))["extended"], nothing)]
    for channels in CHANNEL_SETS[:1] if args.quick else CHANNEL_SETS:
        kinds = {"temperature": "thermocouple", "displacement": "position"}
        rows += [
            score_row(f"{' and '.join(kinds.get(n, n) for n in channels)}: {name}", filter_, measured)
            for name, filter_ in filters(channels).items()
        ]
    for count in (1, BATCH):
        times = {
            name: seconds_per_sample(filter_, current, measured, count, 3 if args.quick else 10)
            for name, filter_ in filters(("voltage",)).items()
        }
        ratio = times["extended"] / times["ensemble of 32"]
        text = "; ".join(f"{name} {1e6 * s:.1f} us" for name, s in times.items()) + f": {ratio:.2f}x"
        rows.append(Row(f"a sample, {'alone' if count == 1 else f'in a batch of {count}'}", "-", text, None, times))
    finish(rows + steering_rows(), args)


if __name__ == "__main__":
    main()
