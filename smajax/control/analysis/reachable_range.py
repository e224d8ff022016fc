"""The range of the channel that a rig can reach within its limits with any controller."""

import math
from collections.abc import Callable, Mapping
from typing import Any, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np

from smajax.channels import numbered
from smajax.control.loop.closed_loop import ClosedLoop
from smajax.control.loop.rollout import Scenario
from smajax.control.sampled_plant import AbstractSampledSystem
from smajax.numerics.loop_kernels import jit_with_kernels

# Number of commands that are tried at each sample: 0, and a geometric series up to the largest command whose smallest
# power is this share of the largest. Chosen by trial; tests/unit/control/test_tuning.py holds it.
_COMMANDS = 64
_MIN_POWER = 1e-8
# Shortest simulated time in s, so that a wire can heat up even if the reference is short; chosen by trial.
_MIN_DURATION = 5.0
# A clipped reference is used if its span is more than this share of what it could be; chosen by trial.
_MIN_SPAN_SHARE = 0.5


class ReachableRange(NamedTuple):
    """Smallest and largest value of the channel that the rig reaches, internal unit."""

    lower: float
    upper: float


def reachable_range(
    system: AbstractSampledSystem, loop: ClosedLoop, scenario: Scenario, limits: Mapping[str, float]
) -> ReachableRange:
    """Compute the range that the channel reaches within the duration of the reference.

    At each sample a wire gets the largest of many commands with which it keeps the limits until the next sample. Two
    wires are heated in two separate simulations, each from rest.

    Args:
        system: The sampled plant.
        loop: The closed loop; the limit of its temperature limiter is a limit, too.
        scenario: Scenario with the reference, for its duration.
        limits: Limits on ``temperature``, ``stress`` and ``current``, internal units; others are ignored.
    """
    period = loop.period
    count = max(scenario.reference.shape[0], math.ceil(_MIN_DURATION / period))
    bounds = {k: limits.get(k, math.inf) for k in ("temperature", "stress", "current")}
    if loop.temperature_limiter is not None:
        bounds["temperature"] = min(bounds["temperature"], float(loop.temperature_limiter.limit))
    greedy = _greedy_rollout(system, loop.channel, bounds, count)
    parts = [np.array([_value_at_rest(system, loop.channel)])]
    for wire, max_command in enumerate(loop.max_commands):
        value, keeps = map(np.asarray, greedy(jnp.zeros(system.wires).at[wire].set(max_command)))
        parts.append(value[keeps])
    values = np.concatenate(parts)
    return ReachableRange(float(np.min(values)), float(np.max(values)))


def _greedy_rollout(
    system: AbstractSampledSystem, channel: str, bounds: Mapping[str, float], count: int
) -> Callable[[jax.Array], tuple[jax.Array, jax.Array]]:
    """A compiled rollout under the largest commands that keep the bounds.

    It maps the largest commands, shape ``(wires,)``, to the channel, and to whether the bounds are kept, shape
    ``(count,)`` each.
    """

    @jit_with_kernels
    def greedy(max_commands: jax.Array) -> tuple[jax.Array, jax.Array]:
        shares = jnp.append(jnp.zeros(1), jnp.sqrt(jnp.geomspace(_MIN_POWER, 1.0, _COMMANDS - 1)))
        commands = shares[:, None] * max_commands[None]

        def try_command(state: Any, command: jax.Array) -> tuple[Any, jax.Array, jax.Array]:
            later, _, unsolved = system.step(state, command)
            channels = system.observe(later, command)
            keeps = [
                jnp.all(jnp.stack([channels[n] for n in numbered(k, system.wires)]) <= bound)
                for k, bound in bounds.items()
            ]
            value = channels[channel]
            return later, value, jnp.all(jnp.stack(keeps)) & (unsolved == 0) & jnp.isfinite(value)

        def sample(state: Any, _: Any) -> tuple[Any, tuple[jax.Array, jax.Array]]:
            later, value, keeps = jax.vmap(lambda command: try_command(state, command))(commands)
            best = jnp.max(jnp.where(keeps, jnp.arange(_COMMANDS), 0))
            return jax.tree.map(lambda leaf: leaf[best], later), (value[best], keeps[best])

        return jax.lax.scan(sample, system.start(), None, length=count)[1]

    return greedy


def clip_reference(scenario: Scenario, reachable: ReachableRange) -> Scenario:
    """Return the scenario with its reference clipped to the reachable range.

    The scenario is returned unchanged if the clipped reference spans at most half of the original span, or of the
    larger distance that the rig can move from the initial reference, whichever is smaller.

    Args:
        scenario: The scenario.
        reachable: Range of the channel that the rig reaches.
    """
    clipped = jnp.clip(scenario.reference, reachable.lower, reachable.upper)
    initial = float(scenario.initial_reference)
    span, clipped_span = (float(jnp.ptp(jnp.append(values, initial))) for values in (scenario.reference, clipped))
    min_span = _MIN_SPAN_SHARE * min(span, max(reachable.upper - initial, initial - reachable.lower))
    return eqx.tree_at(lambda s: s.reference, scenario, clipped) if clipped_span > min_span else scenario


def falls_when_heated(system: AbstractSampledSystem, loop: ClosedLoop) -> bool:
    """Return whether the channel's largest change from rest is negative while the first wire gets its largest command.

    Args:
        system: The sampled plant.
        loop: The closed loop, for the channel and the largest command.
    """
    commands = loop.max_commands * (jnp.arange(system.wires) == 0)
    count = math.ceil(2.0 * _MIN_DURATION / loop.period)

    def sample(state: Any, _: Any) -> tuple[Any, jax.Array]:
        state, _, _ = system.step(state, commands)
        return state, system.observe(state, commands)[loop.channel]

    run = jit_with_kernels(lambda state: jax.lax.scan(sample, state, None, length=count)[1])
    motion = np.asarray(run(system.start())) - _value_at_rest(system, loop.channel)
    motion = motion[np.isfinite(motion)]
    return len(motion) > 0 and float(motion[np.argmax(np.abs(motion))]) < 0.0


def _value_at_rest(system: AbstractSampledSystem, channel: str) -> float:
    return float(system.observe(system.start(), jnp.zeros(system.wires))[channel])
