"""Closed-loop rollouts: a plant and a sampled controller in one scan, differentiable in both.

At each sample the controller is told what the sensor sees, and gives a command that is held for a period; meanwhile the plant takes its own
steps. Derivatives of a plant's loop are taken once all states are known, as those of a simulation are: nothing is searched for again, and
what a sample's derivative needs is worked out anew where it is used, in forward as in reverse mode, which is faster than to remember it.
Where nothing is searched for, ``Scenario.block`` samples at a time are remembered at their beginning only and done again on the way back.
"""

import dataclasses
from collections.abc import Callable
from typing import Any, NamedTuple, cast

import equinox as eqx
import jax
import jax.numpy as jnp
from jax.flatten_util import ravel_pytree

from smajax.control.allocation import Allocation
from smajax.control.controller import AbstractController
from smajax.control.driven import AbstractDriven
from smajax.control.guard import TemperatureGuard
from smajax.control.last_known import LastKnown
from smajax.control.meters import Meters
from smajax.control.observers import AbstractFilter, AbstractThermometer, Inertial, each
from smajax.control.sensing import Sensing
from smajax.kinks import larger, smaller, within
from smajax.plant.step import push

_ELECTRICAL = ("current", "voltage", "power")


class Told(NamedTuple):
    """What a loop is told at a sample: the ``value`` of its channel, and the wires' temperatures, shape ``(wires,)``, if a guard or an
    observer wants them. ``states`` are those of sensor, observer and meters afterwards.
    """

    value: jax.Array
    warm: jax.Array | None
    states: Any


class Loop(eqx.Module):
    """All that stands between the reference and the wires; ``channel`` is the one that is steered.

    With ``meters``, the guard, or the ``observer`` from which it knows the wires' temperatures if there is one, hears what those tell. What
    the guard leaves of a wire's command is the controller's limit for the sample, lest its integral winds up while the guard holds it back.
    With ``believes`` the controller, too, goes by the observer, a filter of the whole plant: by what it believes of the channel, not by
    ``sensing``. With ``gaps`` a channel may be no number, as a rig's may and a simulated one may not, and counts as where it was; once it
    is lost the command is 0, or the least one, until the controller begins anew with the next number.
    """

    controller: AbstractController
    allocation: Allocation
    sensing: Sensing | Inertial
    guard: TemperatureGuard | None = None
    observer: AbstractThermometer | None = None
    meters: Meters | None = None
    channel: str = eqx.field(static=True, kw_only=True)
    believes: bool = eqx.field(static=True, kw_only=True, default=False)
    gaps: bool = eqx.field(static=True, kw_only=True, default=False)

    def __check_init__(self) -> None:
        if self.believes and not isinstance(self.observer, AbstractFilter):
            raise ValueError("a loop that believes needs a filter of the whole plant as its observer")
        if self.believes and self.gaps:
            raise ValueError("a filter takes a measurement that is no number for none: leave gaps out")

    def reset(self, reference: jax.Array, seen: dict[str, jax.Array]) -> Any:
        """The state at rest."""
        guards = () if self.guard is None else tuple(self.guard.reset(t) for t in each(seen, "temperature"))
        watched = () if self.observer is None else self.observer.begin(seen)
        metered = () if self.meters is None else self.meters.reset(seen)
        known = LastKnown.begin(seen[self.channel]) if self.gaps else None
        value = seen[self.channel] if known is None else known.value
        return self.controller.reset(reference, value), (self.sensing.reset(value), watched, metered), guards, known

    def step(self, state: Any, reference: jax.Array, seen: dict[str, jax.Array], draw: jax.Array) -> tuple[Any, jax.Array]:
        """The state after a sample and the wires' commands, shape ``(wires,)``."""
        inner, states, guards, before = state
        known = None if before is None else before.after(seen[self.channel], self.controller.inner.period)
        if known is not None:
            seen = seen | {self.channel: known.value}
        heard = self.hear(states, seen, draw)
        controller, guards, most = self.limited(guards, heard.warm)
        if before is not None:
            inner = jax.tree.map(lambda a, b: jnp.where(before.lost, a, b), controller.reset(reference, heard.value), inner)
        inner, command = controller.step(inner, reference, heard.value)
        if known is not None:
            command = jnp.where(known.lost, within(jnp.zeros(()), controller.inner.lower, controller.inner.upper), command)
        commands = self.allocation(command)
        if self.guard is not None:
            commands = smaller(commands, most)
        sensed, watched, metered = heard.states
        if self.observer is not None:
            watched = self.observer.under(watched, commands)
        return (inner, (sensed, watched, metered), guards, known), commands

    def hear(self, states: Any, seen: dict[str, jax.Array], draw: jax.Array) -> Told:
        """What is heard of the channels at a sample."""
        sensed, watched, metered = states
        sensed, value = self.sensing.step(sensed, seen[self.channel], draw)
        if self.guard is None and self.observer is None:
            return Told(value, None, (sensed, watched, metered))
        if self.meters is not None:
            metered, seen = self.meters.step(metered, seen, draw)
        warm = each(seen, "temperature")
        if self.observer is not None:
            watched, warm = self.observer.watch(watched, seen)
        if self.believes and isinstance(self.observer, AbstractFilter):
            value = self.observer.believed(watched, self.channel)
        return Told(value, warm, (sensed, watched, metered))

    def limited(self, guards: Any, warm: jax.Array | None) -> tuple[AbstractController, Any, jax.Array]:
        """The controller within what the guard leaves it at a sample, the guards' states then, and the most that each wire may get."""
        if self.guard is None or warm is None:
            return self.controller, guards, jnp.full(self.allocation.wires, jnp.inf)
        cut = [self.guard.step(s, t, c) for s, t, c in zip(guards, warm, self.allocation.most, strict=True)]
        states, most = tuple(s for s, _ in cut), jnp.stack([c for _, c in cut])
        own = self.controller.inner
        least, largest = self.allocation.ends(most)
        upper = smaller(own.upper, largest)
        return self.controller.limited(smaller(larger(own.lower, least), upper), upper), states, most


class Scenario(eqx.Module):
    """What a rollout meets: the ``reference``, shape ``(n,)``, ``draws`` of the sensor's noise alike, and parameters that change with time.

    ``before`` is the reference until the first sample. ``changes`` names parameters and gives their values, shape ``(n,)``.
    """

    reference: jax.Array
    before: jax.Array
    draws: jax.Array
    changes: dict[str, jax.Array]
    block: int = eqx.field(static=True, default=64)

    @property
    def rows(self) -> tuple:
        """What changes from sample to sample."""
        return self.reference, self.draws, self.changes

    def calm(self) -> "Scenario":
        """The same without noise: what is restless then is so by itself."""
        return dataclasses.replace(self, draws=jnp.zeros_like(self.draws))

    @classmethod
    def quiet(cls, reference: Any, before: float = 0.0, changes: dict[str, Any] | None = None) -> "Scenario":
        """Without noise."""
        reference = jnp.asarray(reference, jnp.float64)
        return cls(reference, jnp.asarray(before, jnp.float64), jnp.zeros_like(reference), changes or {})


class Rollout(NamedTuple):
    """``channels`` by name as they are (not as the sensor sees them) at the samples, shape ``(n,)``; ``command``, shape ``(n, wires)``, is
    held from each; ``unsolved`` counts steps of the plant that could not be solved. ``ends`` are plant and loop at the end.
    """

    channels: dict[str, jax.Array]
    command: jax.Array
    unsolved: jax.Array
    ends: Any


def rollout(driven: AbstractDriven, loop: Loop, scenario: Scenario) -> Rollout:
    """The closed loop over a scenario; to be compiled and batched by the caller.

    Differentiable in the plant's parameters, the gains and the changes, in forward and in reverse mode, once.
    """
    return _known(driven, loop, scenario) if driven.searches else march(driven, loop, scenario)[0]


def _sample(driven: AbstractDriven, loop: Loop, carry: Any, row: tuple, move: Callable) -> tuple[Any, Any]:
    """One sample: read, decide, and ``move`` on to the next; the carry there, and channels, command and what ``move`` adds."""
    state, inner, command = carry
    reference, draw, changed = row
    now = driven.changed(changed) if changed else driven
    seen = now.read(state, command)
    inner, command = loop.step(inner, reference, seen, draw)
    # Only what is electrical follows the command at once; the rest is not read, and differentiated, twice.
    under = now.read(state, command)
    channels = {name: under[name] if name.partition("_")[0] in _ELECTRICAL else value for name, value in seen.items()}
    state, added = move(now, state, command)
    return (state, inner, command), (channels, command, added)


def march(driven: AbstractDriven, loop: Loop, scenario: Scenario) -> tuple[Rollout, Any]:
    """The rollout, and of each sample the carry before it and the way of the plant."""

    def sample(carry: Any, row: tuple) -> tuple[Any, Any]:
        def move(now: AbstractDriven, state: Any, command: jax.Array) -> tuple[Any, Any]:
            state, way, unsolved = now.advance(state, command)
            return state, (way, unsolved)

        later, (channels, command, (way, unsolved)) = _sample(driven, loop, carry, row, move)
        kept = (ravel_pytree(carry)[0], way) if driven.searches else ()
        return later, (channels, command, unsolved, kept)

    end, (channels, command, unsolved, kept) = _scan(sample, _first(driven, loop, scenario), scenario.rows, scenario.block)
    return Rollout(channels, command, jnp.sum(unsolved), end), kept


def _first(driven: AbstractDriven, loop: Loop, scenario: Scenario) -> Any:
    start, idle = driven.start(), jnp.zeros(driven.wires)
    return start, loop.reset(scenario.before, driven.read(start, idle)), idle


@eqx.filter_custom_jvp
def _known(driven: AbstractDriven, loop: Loop, scenario: Scenario) -> Rollout:
    """``march``, whose derivative is taken with all states known."""
    return march(driven, loop, scenario)[0]


@_known.def_jvp
def _known_jvp(primals: tuple, tangents: tuple) -> tuple:
    """Pushes the tangent from sample to sample; linear in the tangents, so that reverse mode comes with it."""
    (driven, loop, scenario), (drivens, loops, scenarios) = primals, tangents
    done, (carries, ways) = march(driven, loop, scenario)
    unflatten = ravel_pytree(_first(driven, loop, scenario))[1]

    def recur(tangent: Any, row: tuple) -> tuple[Any, Any]:
        carry, way, rows, moved_rows = row

        def landed(driven: AbstractDriven, loop: Loop, carry: jax.Array, rows: tuple) -> tuple[jax.Array, Any]:
            later, (channels, command, _) = _sample(driven, loop, unflatten(carry), rows, lambda now, s, c: (now.land(s, c, way), ()))
            return ravel_pytree(later)[0], (channels, command)

        return push(landed, (driven, loop, carry, rows), (drivens, loops, tangent, moved_rows))

    first = push(lambda *all_: ravel_pytree(_first(*all_))[0], primals, tangents)
    moved_rows = jax.tree.map(lambda r, t: jnp.zeros_like(r) if t is None else t, scenario.rows, scenarios.rows, is_leaf=_none)
    end, (channels, command) = jax.lax.scan(jax.checkpoint(recur, prevent_cse=False), first, (carries, ways, scenario.rows, moved_rows))
    # Counts and flags, which some controllers keep, have no tangent.
    ends = jax.tree.map(lambda value, tangent: tangent if eqx.is_inexact_array(value) else None, done.ends, unflatten(end))
    return done, Rollout(channels, command, cast(Any, None), ends)


def _none(leaf: Any) -> bool:
    return leaf is None


def _scan(function: Any, first: Any, rows: Any, block: int) -> tuple[Any, Any]:
    """``jax.lax.scan``, whose tape in reverse mode holds the carry at the beginning of each block only."""
    count = jax.tree.leaves(rows)[0].shape[0]
    blocks = count // block
    head = jax.tree.map(lambda leaf: leaf[: blocks * block].reshape(blocks, block, *leaf.shape[1:]), rows)
    carry, found = jax.lax.scan(jax.checkpoint(lambda c, r: jax.lax.scan(function, c, r), prevent_cse=False), first, head)
    carry, rest = jax.lax.scan(function, carry, jax.tree.map(lambda leaf: leaf[blocks * block :], rows))
    return carry, jax.tree.map(lambda a, b: jnp.concatenate([a.reshape(blocks * block, *a.shape[2:]), b]), found, rest)
