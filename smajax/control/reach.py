"""How far a rig goes within its limits, whatever controls it."""

import math
from collections.abc import Mapping
from typing import Any, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np

from smajax.control.driven import AbstractDriven
from smajax.control.rollout import Loop, Scenario
from smajax.units import numbered

# Commands that are tried at each sample, by equal factors down to this share of the largest one's power.
_COMMANDS, _LEAST_POWER = 64, 1e-8
_LOOK = 5.0  # s at least that are looked at


class Reach(NamedTuple):
    """The least and largest value of the channel."""

    least: float
    largest: float


def reach(driven: AbstractDriven, loop: Loop, scenario: Scenario, limits: Mapping[str, float]) -> Reach:
    """What the channel reaches by the reference's end, within ``limits`` on temperature, stress and current and below a guard's.

    At each sample a wire gets the largest of many commands with which it keeps them until the next one. Of two wires, both are heated in
    turn.
    """
    period = loop.controller.inner.period
    count = max(scenario.reference.shape[0], math.ceil(_LOOK / period))
    ends = {k: limits.get(k, math.inf) for k in ("temperature", "stress", "current")}
    if loop.guard is not None:
        ends["temperature"] = min(ends["temperature"], float(loop.guard.limit))

    @eqx.filter_jit
    def greedy(most: jax.Array) -> tuple[jax.Array, jax.Array]:
        shares = jnp.append(jnp.zeros(1), jnp.sqrt(jnp.geomspace(_LEAST_POWER, 1.0, _COMMANDS - 1)))[:, None] * most[None]

        def tried(state: Any, command: jax.Array) -> tuple[Any, jax.Array, jax.Array]:
            later, _, unsolved = driven.advance(state, command)
            seen = driven.read(later, command)
            kept = [jnp.all(jnp.stack([seen[n] for n in numbered(k, driven.wires)]) <= end) for k, end in ends.items()]
            value = seen[loop.channel]
            return later, value, jnp.all(jnp.stack(kept)) & (unsolved == 0) & jnp.isfinite(value)

        def one(state: Any, _: Any) -> tuple[Any, tuple[jax.Array, jax.Array]]:
            later, value, kept = jax.vmap(lambda command: tried(state, command))(shares)
            best = jnp.max(jnp.where(kept, jnp.arange(_COMMANDS), 0))
            return jax.tree.map(lambda leaf: leaf[best], later), (value[best], kept[best])

        return jax.lax.scan(one, driven.start(), None, length=count)[1]

    found = [np.array([_rest(driven, loop.channel)])]
    for wire, most in enumerate(loop.allocation.most):
        value, kept = map(np.asarray, greedy(jnp.zeros(driven.wires).at[wire].set(most)))
        found.append(value[kept])
    values = np.concatenate(found)
    return Reach(float(np.min(values)), float(np.max(values)))


def cut(scenario: Scenario, far: Reach) -> Scenario:
    """The scenario with its reference within the reach, if that leaves half of it, or of the longer way that the rig can go."""
    within = jnp.clip(scenario.reference, far.least, far.largest)
    before = float(scenario.before)
    whole, left = (float(jnp.ptp(jnp.append(values, before))) for values in (scenario.reference, within))
    enough = 0.5 * min(whole, max(far.largest - before, before - far.least))
    return eqx.tree_at(lambda s: s.reference, scenario, within) if left > enough else scenario


def falls(driven: AbstractDriven, loop: Loop) -> bool:
    """Whether the channel goes down, on the whole, while its first wire gets all that there is."""
    most = loop.allocation.most * (jnp.arange(driven.wires) == 0)
    count = math.ceil(2.0 * _LOOK / loop.controller.inner.period)

    def one(state: Any, _: Any) -> tuple[Any, jax.Array]:
        state, _, _ = driven.advance(state, most)
        return state, driven.read(state, most)[loop.channel]

    value = np.asarray(eqx.filter_jit(lambda state: jax.lax.scan(one, state, None, length=count)[1])(driven.start()))
    moved = value - _rest(driven, loop.channel)
    moved = moved[np.isfinite(moved)]
    return len(moved) > 0 and float(moved[np.argmax(np.abs(moved))]) < 0.0


def _rest(driven: AbstractDriven, channel: str) -> float:
    return float(driven.read(driven.start(), jnp.zeros(driven.wires))[channel])
