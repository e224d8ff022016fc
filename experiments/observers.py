"""What is known of a wire that no thermometer touches: by its plant, an extended Kalman filter on it, an ensemble of plants.

    python experiments/observers.py [--quick] [--json FILE]

Truth is the exact simulator's (tests/reference), in air that cools 15 to 20 % more or less than the filters' rig file says and is 2 to 5 K
warmer or colder; a minute of partial loops, pauses and saturation each. Both filters are told that convection and ambient are uncertain by
25 W/m^2/K and 4 K, and both are judged from the sixth second on: the temperature's error (RMS), and how often it is within 1.96 standard
deviations. The time is that of one filter and one sample, alone and in a batch.
"""

from __future__ import annotations

import dataclasses
import time
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from _common import ROOT, Row, arguments, finish

from smajax.control.driven import DrivenPlant
from smajax.control.ensemble import EnsembleFilter
from smajax.control.extended import ExtendedFilter
from smajax.control.meters import Meters
from smajax.control.sensing import Sensing
from smajax.rig import read_rig
from tests.reference.rig_file import read_rig as read_reference
from tests.reference.rig_file import simulate

RIG = ROOT / "data" / "recordings" / "dead-weight" / "rig.toml"
PERIOD, ROWS, SETTLED, LAG = 0.05, 1200, 120, 0.6
NOISE = {"voltage": 2e-3, "temperature": 0.5, "displacement": 2e-5}
AIR = {"heat.h0": 25.0, "environment.ambient": 4.0}
BENCHES = ((1.2, 24.0), (0.8, 16.0), (1.2, 18.0), (0.85, 25.0))  # convection as a factor, ambient in degC
HEARD = (("voltage",), ("voltage", "displacement"), ("temperature",), ("voltage", "temperature"))
BATCH = 32


def bench(convection: float, ambient: float, seed: int) -> tuple[jax.Array, dict[str, jax.Array], np.ndarray]:
    """Current, what meters tell, and the wire's temperature."""
    truth = read_reference(RIG).changed(h0=convection, h2=convection, austenite_shift=0.5)
    truth = dataclasses.replace(truth, wire=truth.wire._replace(ambient=ambient))
    rng = np.random.default_rng(seed)
    levels = rng.uniform(0.15, 0.36, 41) * np.sqrt(convection)
    levels[::4] = 0.03
    current = np.repeat(levels, ROWS // 40)[: ROWS + 1]
    run = simulate(truth, {"time": np.arange(ROWS + 1) * PERIOD, "current": current})
    warm = run.temperature[:, 0]
    probe = np.full(ROWS + 1, warm[0])
    for k in range(ROWS):
        probe[k + 1] = probe[k] + (1.0 - np.exp(-PERIOD / LAG)) * (warm[k + 1] - probe[k])
    exact = {"voltage": run.resistance[1:, 0] * current[:-1], "temperature": probe[1:], "displacement": run.position[1:]}
    measured = {n: jnp.asarray(v + NOISE[n] * rng.standard_normal(ROWS)) for n, v in exact.items()}
    return jnp.asarray(current[:-1]), measured, warm[1:]


def filters(heard: tuple[str, ...]) -> dict[str, Any]:
    """Both filters on the rig file's plant."""
    driven, zero = DrivenPlant.of(read_rig(RIG).plant, PERIOD), jnp.zeros(())
    meters = Meters({n: Sensing(jnp.asarray(NOISE[n]), zero) for n in heard}, PERIOD, jnp.asarray(LAG))
    noise, unknown = {n: jnp.asarray(NOISE[n]) for n in heard}, {n: jnp.asarray(v) for n, v in AIR.items()}
    return {"extended": ExtendedFilter.of(driven, meters, AIR), "ensemble of 32": EnsembleFilter(driven, noise, unknown, jnp.asarray(LAG))}


@jax.jit
def followed(one: Any, current: jax.Array, measured: dict[str, jax.Array]) -> tuple[jax.Array, jax.Array]:
    """Temperatures and their standard deviations, for a batch of benches: leading axis."""

    def step(state: Any, row: tuple) -> tuple[Any, tuple[jax.Array, jax.Array]]:
        state = one.step(one.under(state, row[0][None]), row[1])
        found = one.estimate(state)
        return state, (found.mean["temperature"], found.spread["temperature"])

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
        rows += [judged(f"{' and '.join(kinds.get(n, n) for n in heard)}: {name}", one, measured) for name, one in filters(heard).items()]
    for count in (1, BATCH):
        spent = {name: seconds(one, current, measured, count, 3 if args.quick else 10) for name, one in filters(("voltage",)).items()}
        ratio = spent["extended"] / spent["ensemble of 32"]
        text = "; ".join(f"{name} {1e6 * s:.1f} us" for name, s in spent.items()) + f": {ratio:.2f}x"
        rows.append(Row(f"a sample, {'alone' if count == 1 else f'in a batch of {count}'}", "-", text, None, spent))
    finish("observers", rows, args)


if __name__ == "__main__":
    main()
