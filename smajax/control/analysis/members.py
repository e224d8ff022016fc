"""Rollouts of one loop around several plants (members) at once, each with its own gains and sensor noise."""

import dataclasses
from collections.abc import Mapping
from typing import Any

import jax
import jax.numpy as jnp
from jaxtyping import Array, Float

from smajax.control.loop.closed_loop import ClosedLoop
from smajax.control.loop.gains import with_gains
from smajax.control.loop.rollout import Rollout, Scenario, rollout_with_solutions, simulate_loop, states_at_rest
from smajax.control.sampled_plant import AbstractSampledSystem
from smajax.numerics.stored_programs import stored


def rollout_members(
    system: AbstractSampledSystem,
    loop: ClosedLoop,
    scenario: Scenario,
    members: dict[str, Float[Array, " members"]],
    noise: Float[Array, "members samples"],
    gains: dict[str, Float[Array, " members"]],
    first: Any = None,
) -> Rollout:
    """Simulate a loop around all members; the caller compiles it.

    Args:
        system: The sampled plant.
        loop: The closed loop.
        scenario: The scenario; its noise is replaced by that of each member.
        members: Parameters in which the members differ, by name, internal units, shape ``(m,)`` each.
        noise: Standard normal numbers of the sensor's noise, shape ``(m, n)``.
        gains: Gains by name, internal units, shape ``(m,)`` each.
        first: States of plant and loop before the first sample, with a leading axis of ``m``: those of
            ``members_at_rest``, or the final states of other rollouts. By default the members begin at rest; only then
            are the rollouts of an implicit plant differentiable.

    Returns:
        Rollouts whose leaves have a leading axis of ``m``.
    """

    def simulate(
        values: dict[str, jax.Array], draws: jax.Array, gains: dict[str, jax.Array], first: Any = None
    ) -> Rollout:
        changed, own = _changed(system, values), dataclasses.replace(scenario, draws=draws)
        if first is None:
            return simulate_loop(changed, with_gains(loop, gains), own)
        return rollout_with_solutions(changed, with_gains(loop, gains), own, first)[0]

    if first is not None:
        return jax.vmap(simulate)(members, noise, gains, first)
    # A single rollout is faster than a batch of one.
    if not members and noise.shape[0] == 1:
        single = simulate({}, noise[0], {name: value[0] for name, value in gains.items()})
        return jax.tree.map(lambda leaf: leaf[None], single)
    return jax.vmap(simulate)(members, noise, gains)


def members_at_rest(
    system: AbstractSampledSystem,
    loop: ClosedLoop,
    scenario: Scenario,
    members: dict[str, Float[Array, " members"]],
    gains: dict[str, Float[Array, " members"]],
    initial: Float[Array, " members"],
) -> Any:
    """Return the states of all members at rest, for ``rollout_members``; the caller compiles it.

    Args:
        system: The sampled plant.
        loop: The closed loop.
        scenario: The scenario.
        members: Parameters in which the members differ, by name, internal units, shape ``(m,)`` each.
        gains: Gains by name, internal units, shape ``(m,)`` each.
        initial: References before the first sample, shape ``(m,)``.
    """

    def start(values: dict[str, jax.Array], gains: dict[str, jax.Array], initial: jax.Array) -> Any:
        own = dataclasses.replace(scenario, initial_reference=initial)
        return states_at_rest(_changed(system, values), with_gains(loop, gains), own)

    return jax.vmap(start)(members, gains, initial)


def _changed(system: AbstractSampledSystem, values: dict[str, jax.Array]) -> AbstractSampledSystem:
    return system.with_parameters(values) if values else system


def simulate_members(
    system: AbstractSampledSystem,
    loop: ClosedLoop,
    scenario: Scenario,
    gains: Mapping[str, Any],
    members: Mapping[str, Any] | None = None,
) -> Rollout:
    """Simulate a loop with other gains around one plant or several, all with the scenario's noise.

    Args:
        system: The sampled plant.
        loop: The closed loop.
        scenario: The scenario.
        gains: Gains by name, internal units, scalars; others keep their values.
        members: Parameters in which the plants differ, by name, internal units, shape ``(m,)`` each; without them the
            plant itself is simulated.

    Returns:
        Rollouts whose leaves have a leading axis of ``m``, or of 1 without ``members``.
    """
    values = {name: jnp.asarray(v) for name, v in (members or {}).items()}
    count = next((len(v) for v in values.values()), 1)
    noise = jnp.broadcast_to(scenario.draws[None], (count, scenario.draws.shape[0]))
    return _simulate(
        system, loop, scenario, values, noise, {name: jnp.asarray(v, jnp.float64) for name, v in gains.items()}
    )


@stored
def _simulate(
    system: AbstractSampledSystem,
    loop: ClosedLoop,
    scenario: Scenario,
    members: dict[str, jax.Array],
    noise: jax.Array,
    gains: dict[str, jax.Array],
) -> Rollout:
    equal_gains = {name: jnp.broadcast_to(value, noise.shape[0]) for name, value in gains.items()}
    return rollout_members(system, loop, scenario, members, noise, equal_gains)
