"""What is known of a wire that no thermometer touches.

By its plant, an extended Kalman filter on it, an ensemble of plants.

    python experiments/control/observers.py [--quick] [--json FILE]

Truth is the exact simulator's (tests/reference), in air that cools 15 to 20 % more or less than the filters' rig file
says and is 2 to 5 K warmer or colder; a minute of partial loops, pauses and saturation each. Both filters are told
that convection and ambient are uncertain by 25 W/m^2/K and 4 K, and both are judged from the sixth second on: the
temperature's error (RMS), and how often it is within 1.96 standard deviations. The time is that of one filter and one
sample, alone and in a batch.

Then the same wires are steered over three steps by a PID: by an encoder as fine as before, by one that is 0.1 mm
noisy and 0.1 s late, by the extended filter that hears the latter and the voltage, and by the filter without any
sensor of position. The gains for the first are those of the filter, too; for the second they are tuned anew.
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
PERIOD, ROWS, SETTLED, LAG = 0.05, 1200, 120, 0.6
NOISE = {"voltage": 2e-3, "temperature": 0.5, "displacement": 2e-5}
AIR = {"heat.h0": 25.0, "environment.ambient": 4.0}
BENCHES = ((1.2, 24.0), (0.8, 16.0), (1.2, 18.0), (0.85, 25.0))  # convection as a factor, ambient in degC
HEARD = (("voltage",), ("voltage", "displacement"), ("temperature",), ("voltage", "temperature"))
BATCH = 32
NOISY, LATE = 1e-4, 2  # m, samples
START, LARGEST = {"kp": 30.0, "ki": 10.0, "kd": 0.5, "filter_time": 0.05}, 0.5
STEPS = np.repeat([4e-3, 6e-3, 2e-3], 400)  # m


def truth_of(convection: float, ambient: float) -> RigFile:
    """A wire that differs from the rig file's, in other air."""
    truth = read_reference(RIG).changed(h0=convection, h2=convection, austenite_shift=0.5)
    return dataclasses.replace(truth, wire=truth.wire._replace(ambient=ambient))


def bench(convection: float, ambient: float, seed: int) -> tuple[jax.Array, dict[str, jax.Array], np.ndarray]:
    """Current, what meters tell, and the wire's temperature."""
    truth = truth_of(convection, ambient)
    rng = np.random.default_rng(seed)
    levels = rng.uniform(0.15, 0.36, 41) * np.sqrt(convection)
    levels[::4] = 0.03
    current = np.repeat(levels, ROWS // 40)[: ROWS + 1]
    run = simulate(truth, {"time": np.arange(ROWS + 1) * PERIOD, "current": current})
    warm = run.temperature[:, 0]
    probe = np.full(ROWS + 1, warm[0])
    for k in range(ROWS):
        probe[k + 1] = probe[k] + (1.0 - np.exp(-PERIOD / LAG)) * (warm[k + 1] - probe[k])
    exact = {
        "voltage": run.resistance[1:, 0] * current[:-1],
        "temperature": probe[1:],
        "displacement": run.position[1:],
    }
    measured = {n: jnp.asarray(v + NOISE[n] * rng.standard_normal(ROWS)) for n, v in exact.items()}
    return jnp.asarray(current[:-1]), measured, warm[1:]


def filters(heard: tuple[str, ...]) -> dict[str, Any]:
    """Both filters on the rig file's plant."""
    driven, zero = SampledPlant.of(read_rig(RIG).plant, PERIOD), jnp.zeros(())
    meters = Instruments({n: SensorModel(jnp.asarray(NOISE[n]), zero) for n in heard}, PERIOD, jnp.asarray(LAG))
    noise, unknown = {n: jnp.asarray(NOISE[n]) for n in heard}, {n: jnp.asarray(v) for n, v in AIR.items()}
    return {
        "extended": ExtendedKalmanFilter.of(driven, meters, AIR),
        "ensemble of 32": EnsembleKalmanFilter(driven, noise, unknown, jnp.asarray(LAG)),
    }


@jax.jit
def followed(one: Any, current: jax.Array, measured: dict[str, jax.Array]) -> tuple[jax.Array, jax.Array]:
    """Temperatures and their standard deviations, for a batch of benches: leading axis."""

    def step(state: Any, row: tuple) -> tuple[Any, tuple[jax.Array, jax.Array]]:
        state = one.step(one.under(state, row[0][None]), row[1])
        found = one.estimate(state)
        return state, (found.mean["temperature"], found.standard_deviation["temperature"])

    return jax.vmap(lambda c, m: jax.lax.scan(step, one.reset(), (c, m))[1])(current, measured)


def seconds(one: Any, current: jax.Array, measured: dict[str, jax.Array], count: int, times: int) -> float:
    """The least time of so many runs of a batch, for one filter and one sample."""
    current, measured = jax.tree.map(lambda v: jnp.broadcast_to(v[:1], (count, *v.shape[1:])), (current, measured))
    jax.block_until_ready(followed(one, current, measured))
    least = np.inf
    for _ in range(times):
        began = time.perf_counter()
        jax.block_until_ready(followed(one, current, measured))
        least = min(least, time.perf_counter() - began)
    return least / count / ROWS


def tuned(sensing: SensorModel) -> dict[str, float]:
    """Gains for the rig file's plant and a sensor of its position."""
    pid = PID(*(jnp.asarray(v) for v in (*START.values(), 0.0, LARGEST)), period=PERIOD)
    loop = ClosedLoop(pid, Allocation(jnp.asarray(LARGEST), jnp.asarray(0.0), 1), sensing, channel="displacement")
    draws = np.random.default_rng(1).standard_normal(len(STEPS))
    scenario = dataclasses.replace(Scenario.noiseless(STEPS), draws=jnp.asarray(draws))
    bounds = {name: (value / 100.0, value * 100.0) for name, value in START.items()}
    driven = SampledPlant.of(read_rig(RIG).plant, PERIOD)
    tuning = TuningProblem.of(driven, loop, scenario, bounds, draws=noise_draws(loop, scenario), spread=GAIN_SPREAD)
    return tune(tuning, {"tracking": 1.0, "effort": 0.01}, {}, starts=4).gains


class Sensor:
    """What the controller hears.

    A late and noisy encoder, or an extended filter of that (``encoder``) and the voltage.
    """

    def __init__(self, seed: int, late: int, noise: float, filtered: bool = False, encoder: bool = True) -> None:
        self.rng, self.noise, self.waiting = np.random.default_rng(seed), noise, [0.0] * late
        self.filtered, self.encoder = filtered, encoder
        zero = jnp.zeros(())
        each = {"voltage": SensorModel(jnp.asarray(NOISE["voltage"]), zero)}
        if encoder:
            each["displacement"] = SensorModel(jnp.asarray(noise), zero, late)
        self.one = ExtendedKalmanFilter.of(
            SampledPlant.of(read_rig(RIG).plant, PERIOD), Instruments(each, PERIOD, zero), AIR
        )
        self.belief = self.one.reset()

    def __call__(self, position: float, ohms: float, command: float) -> float:
        """The displacement as the controller hears it."""
        self.waiting.append(position + self.noise * self.rng.standard_normal())
        told = self.waiting.pop(0)
        if not self.filtered:
            return told
        heard = {"voltage": ohms * command + NOISE["voltage"] * self.rng.standard_normal()}
        if self.encoder:
            heard["displacement"] = told
        self.belief, value = hear(self.one, self.belief, jnp.asarray([command]), jax.tree.map(jnp.asarray, heard))
        return float(value)


@jax.jit
def hear(
    one: ExtendedKalmanFilter, belief: Any, command: jax.Array, heard: dict[str, jax.Array]
) -> tuple[Any, jax.Array]:
    """The belief a sample later, and its displacement."""
    belief = one.step(one.apply_command(belief, command), heard)
    return belief, one.estimated_channel(belief, "displacement")


def steered(gains: dict[str, float], sensor: Any) -> list[float]:
    """RMS errors (m) of each wire, steered over the steps on the exact simulator by what ``sensor(seed)`` tells."""
    errors = []
    for seed, where in enumerate(BENCHES):
        pid = Pid(*(gains[n] for n in START), 0.0, LARGEST, PERIOD)
        value = lift(truth_of(*where), pid, STEPS, np.zeros(len(STEPS)), sense=sensor(seed))[0]
        errors.append(float(np.sqrt(np.mean((value - STEPS) ** 2))))
    return errors


def steering() -> list[Row]:
    """One row for each way to hear the position."""
    zero = jnp.zeros(())
    clean, poor = (
        tuned(SensorModel(jnp.asarray(NOISE["displacement"]), zero)),
        tuned(SensorModel(jnp.asarray(NOISY), zero, LATE)),
    )
    ways = {
        "an encoder of 20 um": (clean, lambda seed: Sensor(seed, 0, NOISE["displacement"])),
        "an encoder of 0.1 mm, 0.1 s late": (poor, lambda seed: Sensor(seed, LATE, NOISY)),
        "the same, gains of the first": (clean, lambda seed: Sensor(seed, LATE, NOISY)),
        "a filter of that and voltage": (clean, lambda seed: Sensor(seed, LATE, NOISY, filtered=True)),
        "a filter of voltage alone": (clean, lambda seed: Sensor(seed, LATE, NOISY, filtered=True, encoder=False)),
    }
    rows = []
    for name, (gains, sensor) in ways.items():
        errors = steered(gains, sensor)
        rows.append(
            Row(
                f"steered by {name}", "-", f"{', '.join(f'{1e3 * e:.3f}' for e in errors)} mm", None, {"rmse_m": errors}
            )
        )
    return rows


def main() -> None:
    """Prints the table."""
    args = arguments(__doc__, quick="voltage alone, and fewer timings")
    told = [bench(*where, seed) for seed, where in enumerate(BENCHES, 3)]
    current, measured, warm = (
        jnp.stack([t[0] for t in told]),
        jax.tree.map(lambda *v: jnp.stack(v), *(t[1] for t in told)),
        [t[2] for t in told],
    )
    nothing = jax.tree.map(lambda v: jnp.full_like(v, jnp.nan), measured)

    def judged(what: str, one: Any, heard: dict[str, jax.Array]) -> Row:
        mean, spread = (np.asarray(v)[:, SETTLED:] for v in followed(one, current, heard))
        error = mean - np.stack(warm)[:, SETTLED:]
        each, share = np.sqrt(np.mean(error**2, axis=1)), np.mean(np.abs(error) < 1.96 * spread)
        text = f"{', '.join(f'{e:.2f}' for e in each)} K; within 95 % intervals {100 * share:.0f} %"
        return Row(what, "-", text, None, {"rms": each.tolist(), "inside": float(share)})

    rows = [judged("the plant alone", filters(("voltage",))["extended"], nothing)]
    for heard in HEARD[:1] if args.quick else HEARD:
        kinds = {"temperature": "thermocouple", "displacement": "position"}
        rows += [
            judged(f"{' and '.join(kinds.get(n, n) for n in heard)}: {name}", one, measured)
            for name, one in filters(heard).items()
        ]
    for count in (1, BATCH):
        spent = {
            name: seconds(one, current, measured, count, 3 if args.quick else 10)
            for name, one in filters(("voltage",)).items()
        }
        ratio = spent["extended"] / spent["ensemble of 32"]
        text = "; ".join(f"{name} {1e6 * s:.1f} us" for name, s in spent.items()) + f": {ratio:.2f}x"
        rows.append(Row(f"a sample, {'alone' if count == 1 else f'in a batch of {count}'}", "-", text, None, spent))
    finish(rows + steering(), args)


if __name__ == "__main__":
    main()
