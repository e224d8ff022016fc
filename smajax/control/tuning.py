"""What is tuned, as a function of a point: a loop around one plant or many, its gains by their logarithms in the unit box."""

import dataclasses
import math
from collections.abc import Mapping
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import scipy.stats

from smajax.control import metrics, objective
from smajax.control.driven import AbstractDriven
from smajax.control.gains import gain, with_gains
from smajax.control.objective import Parts, Task, Wanted
from smajax.control.rollout import Loop, Rollout, Scenario, rollout
from smajax.errors import InputError

NOISES = 8  # draws of the sensor's noise that gains are tuned for, lest they suit one only
SPREAD = 0.1  # of a gain: how far each may be off, lest they suit the moments of one reference only


class Tuning(eqx.Module):
    """What is tuned: a loop around something driven, over a scenario.

    ``members`` name parameters that differ, each of shape ``(m,)``; ``draws``, shape ``(m, n)``, are the sensor's noise of each. A member
    judges gains that are off by its row of ``offsets``, shape ``(m, p)``, of the box: a wire that hunts meets the reference's jumps in
    better and worse moments, and what is good for one row of moments only is no good gain.
    """

    driven: AbstractDriven
    loop: Loop
    scenario: Scenario
    task: Task
    members: dict[str, jax.Array]
    draws: jax.Array
    offsets: jax.Array
    lower: jax.Array
    upper: jax.Array
    names: tuple[str, ...] = eqx.field(static=True)

    @classmethod
    def of(
        cls,
        driven: AbstractDriven,
        loop: Loop,
        scenario: Scenario,
        bounds: Mapping[str, tuple[float, float]],
        members: Mapping[str, Any] | None = None,
        draws: Any | None = None,
        spread: float = 0.0,
    ) -> "Tuning":
        """``bounds`` name the gains to be tuned and the positive ends between which they lie.

        A single row of ``draws``, or the scenario's noise without, is met by all members. With a ``spread``, the gains that several members
        judge lie up to such a share above and below those asked for. Raises ``InputError`` for a gain that the controller has not, or whose
        start value does not lie between its bounds.
        """
        for name, (low, high) in bounds.items():
            value = float(gain(loop, name))
            if not 0.0 < low <= value <= high:
                raise InputError(
                    f"{name} starts at {value:.6g} and is to be tuned between {low:.6g} and {high:.6g}: the bounds have to be positive "
                    "and hold the start value"
                )
        period = loop.controller.inner.period
        reference, before = np.asarray(scenario.reference), float(scenario.before)
        found = metrics.jumps(reference, before, period)
        span = float(np.max(np.append(reference, before)) - np.min(np.append(reference, before))) or abs(before) or 1.0
        task = Task(*map(jnp.asarray, (reference, found.since, found.size, span)), channel=loop.channel, period=period, wires=driven.wires)
        lower, upper = (jnp.asarray([b[k] for b in bounds.values()], jnp.float64) for k in (0, 1))
        differ = {k: jnp.asarray(v) for k, v in (members or {}).items()}
        noise = scenario.draws[None] if draws is None else jnp.asarray(draws)
        noise = jnp.broadcast_to(noise, (next((len(v) for v in differ.values()), len(noise)), len(reference)))
        wide = np.log(np.where(upper > lower, upper / lower, math.inf))
        even = scipy.stats.qmc.Halton(len(bounds), rng=0).random(len(noise)) if len(noise) > 1 else np.full((1, len(bounds)), 0.5)
        offsets = jnp.asarray(math.log1p(spread) / wide * (2.0 * even - 1.0))
        return cls(driven, loop, scenario, task, differ, noise, offsets, lower, upper, names=tuple(bounds))

    @property
    def count(self) -> int:
        """Number of members: rollouts at each look at a point."""
        return self.draws.shape[0]

    def alone(self, member: int = 0) -> "Tuning":
        """The same with one member only, which judges gains that are not off."""
        one = self._of(slice(member, member + 1))
        return dataclasses.replace(one, offsets=0.0 * one.offsets)

    def first(self, count: int) -> "Tuning":
        """The same with the first members only."""
        return self._of(slice(count))

    def _of(self, own: slice) -> "Tuning":
        members = {name: values[own] for name, values in self.members.items()}
        return dataclasses.replace(self, members=members, draws=self.draws[own], offsets=self.offsets[own])

    @property
    def jumps(self) -> metrics.Jumps:
        """The reference's jumps."""
        return metrics.jumps(np.asarray(self.scenario.reference), float(self.scenario.before), self.task.period)

    @property
    def start(self) -> np.ndarray:
        """The start gains in the unit box, shape ``(p,)``."""
        values = np.array([float(gain(self.loop, name)) for name in self.names])
        low, high = np.asarray(self.lower), np.asarray(self.upper)
        return np.log(values / low) / np.where(high > low, np.log(high / low), 1.0)

    def gains(self, point: Any) -> dict[str, jax.Array]:
        """The gains at a point of the unit box, or at several as columns, in internal units."""
        values = jnp.asarray(point)
        return {name: self.lower[i] * (self.upper[i] / self.lower[i]) ** values[i] for i, name in enumerate(self.names)}

    def steered(self, gains: Mapping[str, Any]) -> Loop:
        """The loop with other gains, in internal units."""
        return with_gains(self.loop, gains)

    def roll(self, gains: Mapping[str, Any]) -> Rollout:
        """The rollouts of all members with other gains, in internal units; leaves with a leading axis of ``m``."""
        return self._roll({name: jnp.broadcast_to(value, self.count) for name, value in gains.items()})

    def _roll(self, gains: dict[str, jax.Array]) -> Rollout:
        """The rollouts of all members, each with gains of its own, arrays of shape ``(m,)``."""

        def one(values: dict[str, jax.Array], draws: jax.Array, gains: dict[str, jax.Array]) -> Rollout:
            driven = self.driven.changed(values) if values else self.driven
            return rollout(driven, self.steered(gains), dataclasses.replace(self.scenario, draws=draws))

        if not self.members and self.count == 1:  # no batch is faster than a batch of one
            alone = one({}, self.draws[0], {name: value[0] for name, value in gains.items()})
            return jax.tree.map(lambda leaf: leaf[None], alone)
        return jax.vmap(one)(self.members, self.draws, gains)

    def parts(self, point: jax.Array, wanted: Wanted) -> Parts:
        """Terms, shape ``(m, 4, n)``, and violations, shape ``(m, 5, n)``."""
        done = self._roll(self.gains((point[None] + self.offsets).T))
        return jax.vmap(lambda done: objective.parts(done, self.task, wanted))(done._replace(ends=None))


def noises(loop: Loop, scenario: Scenario, count: int = NOISES, seed: int = 0) -> jax.Array:
    """The scenario's noise and ``count - 1`` other draws of it, shape ``(count, n)``; only the one if no sensor has noise."""
    metered = () if loop.meters is None or (loop.guard is None and loop.observer is None) else loop.meters.each.values()
    count = count if any(float(one.noise) > 0.0 for one in (loop.sensing, *metered)) else 1
    more = np.random.default_rng([seed, 11]).standard_normal((count - 1, scenario.draws.shape[0]))
    return jnp.concatenate([scenario.draws[None], jnp.asarray(more)])


@eqx.filter_jit
def look(tuning: Tuning, points: jax.Array, wanted: Wanted) -> tuple[jax.Array, jax.Array]:
    """Sums of squares of the terms, mean over the members, shape ``(k, 4)``, and the largest violation of each limit, ``(k, 5)``."""

    def single(point: jax.Array) -> tuple[jax.Array, jax.Array]:
        found = tuning.parts(point, wanted)
        return jnp.mean(jnp.sum(found.terms**2, axis=2), axis=0), jnp.max(found.violated, axis=(0, 2))

    return jax.vmap(single)(points)


def roll(tuning: Tuning, gains: Mapping[str, Any]) -> Rollout:
    """``Tuning.roll``, compiled once for all gains."""
    return _roll(tuning, {name: jnp.asarray(value, jnp.float64) for name, value in gains.items()})


@eqx.filter_jit
def _roll(tuning: Tuning, gains: dict[str, jax.Array]) -> Rollout:
    return tuning.roll(gains)
