"""Stability of a loop: margins of its linearisation along a rollout, and whether the rollout itself comes to rest.

The loop is cut at the controller's output. At a sample of a rollout, plant and controller are linearised about their states, and their
frequency responses multiplied: L = -K P. A shape-memory wire is another plant while it warms than while it cools, so that margins are taken
at many samples. Where it does not transform, its expansion moves it a little the wrong way; a loop has no margin there, and needs none,
since it leaves again: such samples do not count, nor do frequencies far below the crossover, at which the states have moved on before a
period is over. A filter that the controller goes by counts as if it told the channel as it is; what it does to the loop shows in rollouts.
"""

import itertools
import math
from collections.abc import Iterator, Mapping, Sequence
from typing import Any, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jax.flatten_util import ravel_pytree

from smajax.control.driven import AbstractDriven
from smajax.control.rollout import Loop, Scenario, march

_FREQUENCIES = 400
_OF_A_DRAW = 60  # samples
_RESTLESS = 0.02
_HOLD = 10  # samples
_SWING = 0.05  # of what the reference spans: less is as good as rest
_SWINGS, _PER_TURN = 4, 4  # swings that are none of settling: so many, and so many more for each turn of the reference
_SUSTAINED = 0.7  # of its first swings: what is left of it at the end of what goes on
_FAR = 1e6  # where a response shows its first sample only
_BELOW = 5.0  # below the crossover


class Margins(NamedTuple):
    """Gain margin (a factor), phase margin in degrees, and the largest sensitivity; infinite where nothing bounds them.

    Of a plant that is not linear, medians over the samples of a rollout: single ones are far better and far worse for an instant.
    """

    gain: float
    phase: float
    sensitivity: float

    @property
    def unstable(self) -> bool:
        """Whether the linearised loop is unstable, though limits of its command may hold it."""
        return self.gain < 1.0 or self.phase < 0.0


@eqx.filter_jit
def _carries(driven: AbstractDriven, loop: Loop, scenario: Scenario) -> tuple[jax.Array, jax.Array]:
    done, (carries, _) = march(driven, loop, scenario)
    return carries, done.command


@eqx.filter_jit
def _loop_gain(driven: AbstractDriven, loop: Loop, carry: Any, reference: jax.Array, draw: jax.Array, z: jax.Array) -> jax.Array:
    """L(z) at a sample, linearised; complex, of the shape of ``z``."""
    state, inner, before = carry
    seen = driven.read(state, before)
    held, states, guards, _ = inner
    value, warm, _ = loop.hear(states, seen, draw)
    controller, _, _ = loop.limited(guards, warm)
    flat, unflatten = ravel_pytree(held)

    def decide(flat: jax.Array, value: jax.Array) -> tuple[jax.Array, jax.Array]:
        later, command = controller.step(unflatten(flat), reference, value)
        return ravel_pytree(later)[0].astype(flat.dtype), command

    (rates, out), (drive, direct) = (jax.jacfwd(decide, argnums=i)(flat, value) for i in (0, 1))
    command = controller.step(held, reference, value)[1]
    each, direction = loop.allocation(command), jax.jacfwd(loop.allocation)(command)
    plant = driven.response(state, each, direction, loop.channel, z)

    def controls(z: jax.Array) -> jax.Array:
        return out @ jnp.linalg.solve(z * jnp.eye(len(flat)) - rates, drive.astype(z.dtype)) + direct

    return -jax.vmap(controls)(z) * plant * z ** (0 if loop.believes else -loop.sensing.delay)


def margins(driven: AbstractDriven, loop: Loop, scenario: Scenario, *, samples: int = 300) -> Margins:
    """The margins at so many samples of the rollout, spread over those at which the command moves; their medians."""
    period = loop.controller.inner.period
    count = scenario.reference.shape[0]
    frequencies = np.geomspace(0.2 * math.pi / (count * period), math.pi / period, _FREQUENCIES)
    z = jnp.append(jnp.exp(1j * frequencies * period), _FAR)
    start, idle = driven.start(), jnp.zeros(driven.wires)
    first = (start, loop.reset(scenario.before, driven.read(start, idle)), idle)
    if not driven.searches:  # linear: one state is as good as another
        gains = np.asarray(_loop_gain(driven, loop, first, scenario.before, jnp.zeros(()), z))[None]
    else:
        carries, command = _carries(driven, loop, scenario)
        moving = np.flatnonzero(np.any(np.abs(np.diff(np.asarray(command), axis=0)) > 0.0, axis=1)) + 1
        if not len(moving):
            return Margins(math.inf, math.inf, 0.0)
        at = moving[np.linspace(0, len(moving) - 1, samples).astype(int)]
        gains = np.asarray(_along(driven, loop, carries[at], scenario.reference[at], scenario.draws[at], z, first))
        gains = gains[(np.real(gains[:, -1]) > 0.0) & np.all(np.isfinite(gains), axis=1)]  # by the first answer to a command
    return _margins(gains[:, :-1], frequencies)


def of_draws(driven: AbstractDriven, loop: Loop, scenario: Scenario, drawn: Mapping[str, np.ndarray]) -> list[Margins]:
    """The margins of a loop around each of so many plants, which differ in named parameters: arrays of shape ``(count,)``, internal units.

    One program serves all; each at fewer samples of its own rollout, the median over the samples being what counts.
    """
    count = len(next(iter(drawn.values())))
    plants = (driven.changed({name: jnp.asarray(values[k], jnp.float64) for name, values in drawn.items()}) for k in range(count))
    return [margins(plant, loop, scenario, samples=_OF_A_DRAW) for plant in plants]


def worst(of: Sequence[Margins]) -> Margins:
    """The least gain and phase margins and the largest sensitivity of some, each by itself."""
    gain, phase, sensitivity = zip(*of, strict=True)
    return Margins(min(gain), min(phase), max(sensitivity))


@eqx.filter_jit
def _along(driven: AbstractDriven, loop: Loop, carries: Any, references: Any, draws: Any, z: jax.Array, like: Any) -> jax.Array:
    unflatten = ravel_pytree(like)[1]
    return jax.lax.map(lambda row: _loop_gain(driven, loop, unflatten(row[0]), row[1], row[2], z), (carries, references, draws))


def _margins(gains: np.ndarray, frequencies: np.ndarray) -> Margins:
    """Medians over the rows of ``gains``."""
    found = []
    for gain in gains:
        size, angle = np.abs(gain), np.mod(np.angle(gain), -2.0 * math.pi)  # from -360 to 0 degrees
        crossings = np.flatnonzero((size[:-1] > 1.0) & (size[1:] <= 1.0))
        first = frequencies[crossings[-1]] if len(crossings) else frequencies[0]
        near = frequencies >= first / _BELOW
        least, phase = math.inf, math.inf
        for k in crossings[-1:]:
            phase = math.degrees(angle[k + 1] + math.pi)
        for k in np.flatnonzero((angle[:-1] > -math.pi) & (angle[1:] <= -math.pi) & (angle[:-1] - angle[1:] < math.pi) & near[1:]):
            part = (angle[k] + math.pi) / (angle[k] - angle[k + 1])
            least = min(least, math.exp(-math.log(size[k]) - part * (math.log(size[k + 1]) - math.log(size[k]))))
        found.append((least, phase, float(np.max(1.0 / np.abs(1.0 + gain[near])))))
    return Margins(*(float(np.median(column)) for column in zip(*found, strict=True))) if found else Margins(math.inf, math.inf, 0.0)


def restless(command: np.ndarray, reference: np.ndarray, value: np.ndarray, reach: float) -> str:
    """Why a rollout without noise counts as unstable, or nothing: it is no number, runs away, or does not come to rest.

    Arrays of shape ``(n, wires)``, ``(n,)`` and ``(n,)``; ``reach`` is the range of the command (infinite: the largest that it takes). In
    the later half of each hold of the reference the command should be at rest; where the reference always moves, it should not jump to
    and fro. And however slowly: the value should not go on swinging about the reference.
    """
    if not (np.all(np.isfinite(value)) and np.all(np.isfinite(command))):
        return "the loop's numbers overflow"
    span = float(np.ptp(np.append(reference, value[0]))) or 1.0
    later = slice(3 * len(value) // 4, None)
    if np.max(np.abs(value[later] - reference[later])) > 3.0 * span:
        return "the loop runs away from its reference"
    size = reach if math.isfinite(reach) else float(np.max(np.abs(command)))
    change = np.diff(command, axis=0, prepend=command[:1])
    rests = _later_halves(reference)
    holds = bool(np.any(rests))
    if not holds:
        turns = change * np.roll(change, 1, axis=0) < 0.0
        change, rests = np.where(turns, change, 0.0), np.ones(len(value), bool)
    moves = float(np.sqrt(np.mean(change[rests] ** 2))) / max(size, 1e-300)
    if moves > _RESTLESS:
        return f"the command goes on moving by {100 * moves:.0f} % of its range from sample to sample"
    swing = max((_goes_on(reference[part], value[part], _SWING * span) for part in _settled(reference, holds)), default=0.0)
    return f"the loop goes on swinging about its reference by {100 * swing / span:.0f} % of what the reference spans" if swing > 0.0 else ""


def _settled(reference: np.ndarray, holds: bool) -> Iterator[slice]:
    """All but the first quarter of each hold, or, of a reference that always moves, of the whole."""
    for first, end in _holds(reference) if holds else [(0, len(reference))]:
        yield slice(first + (end - first) // 4, end)


def _goes_on(reference: np.ndarray, value: np.ndarray, least: float) -> float:
    """How far a value swings about its reference to and fro, if it does so at least twice, more often than the reference turns, and does
    not come to rest; else 0. Swings of less than ``least`` do not count."""
    found = swings(value - reference, least)
    own = len(swings(reference, least))
    if len(found) < _SWINGS + _PER_TURN * own:
        return 0.0
    first, last = float(np.mean(found[:2])), float(np.mean(found[-2:]))
    return last if last > _SUSTAINED * first else 0.0


def swings(values: np.ndarray, least: float) -> list[float]:
    """How far a series goes from each turning point to the next one; what turns back by less than ``least`` goes on."""
    sizes: list[float] = []
    low = high = start = float(values[0])
    way = 0
    for v in values.tolist():
        low, high = min(low, v), max(high, v)
        if way >= 0 and high - v > least:
            sizes += [high - start] if way else []
            way, start, low = -1, high, v
        elif way <= 0 and v - low > least:
            sizes += [start - low] if way else []
            way, start, high = 1, low, v
    return sizes


def _later_halves(reference: np.ndarray) -> np.ndarray:
    """Which samples lie in the later half of a hold."""
    rests = np.zeros(len(reference), bool)
    for first, end in _holds(reference):
        rests[(first + end + 1) // 2 : end] = True
    return rests


def _holds(reference: np.ndarray) -> Iterator[tuple[int, int]]:
    """First sample of each hold, and the one after its last."""
    edges = np.r_[0, np.flatnonzero(np.diff(reference)) + 1, len(reference)]
    yield from ((int(a), int(b)) for a, b in itertools.pairwise(edges) if b - a >= _HOLD)
