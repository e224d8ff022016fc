"""The feedforward of a rig: an operator fitted to one slow loop of command against channel, and its inverse.

The command goes up and down so slowly that heat has time at every instant; the second such loop is what the operator is fitted to. It
spans the commands between which the loop is open, below the limit on temperature. What the operator cannot follow of it is the misfit:
the loop of a dead weight is steep, and its misfit is no small one.
"""

import math
from typing import NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np

from smajax.control.controller import AbstractController
from smajax.control.driven import DrivenPlant
from smajax.control.feedforward import FeedforwardPID
from smajax.control.pid import PID
from smajax.control.ppid import PPID
from smajax.control.rollout import Loop
from smajax.errors import InputError
from smajax.fit.families import prandtl_ishlinskii
from smajax.fit.operator_problem import Series
from smajax.fit.operators import fit_operator
from smajax.hysteresis.prandtl_ishlinskii import InversePrandtlIshlinskii, PrandtlIshlinskii
from smajax.simulate import time_constant
from smajax.units import CHANNELS, numbered

_SAMPLES = 400  # of a loop, one each time constant of the wire
_OPEN = 0.02  # share of the stroke by which the two ways of a loop are apart at least where it counts as open


class Feedforward(NamedTuple):
    """What a feedforward is made of: so many play operators, and the loop: measured, or simulated between ``ends`` of the command."""

    operators: int
    ends: tuple[float, float] | None = None
    measured: Series | None = None


class Identified(NamedTuple):
    """An inverse operator, and how well the operator itself follows its loop: RMSE and the loop's stroke, in the channel's unit.

    ``ends`` are the least and largest command, ``seconds`` is the loop's duration.
    """

    inverse: InversePrandtlIshlinskii
    misfit: float
    stroke: float
    ends: tuple[float, float]
    seconds: float


def identify(driven: DrivenPlant, loop: Loop, wanted: Feedforward, hottest: float = math.inf) -> Identified:
    """Fits the operator; wires stay below ``hottest`` degC in a simulated loop. Raises ``InputError`` if the channel does not follow."""
    series = wanted.measured or _simulated(driven, loop, wanted.ends, hottest)
    stroke = float(np.ptp(series.output))
    rises = np.corrcoef(series.input, series.output)[0, 1] if stroke > 0.0 else 0.0
    if not rises > 0.1:
        raise InputError(f"feedforward: the {loop.channel} does not rise with the command in a slow loop: leave [feedforward] out")
    found = fit_operator(prandtl_ishlinskii([series], wanted.operators, envelopes=1), [series], starts=4)
    assert isinstance(found.law, PrandtlIshlinskii)
    inverse = found.law.inverse()
    assert isinstance(inverse, InversePrandtlIshlinskii)  # of one envelope
    ends = (float(series.input.min()), float(series.input.max()))
    return Identified(inverse, found.rmse, stroke, ends, float(np.ptp(series.time)))


def with_inverse(controller: AbstractController, inverse: InversePrandtlIshlinskii) -> AbstractController:
    """The controller with a feedforward. Raises ``InputError`` for one that has no place for it."""
    if isinstance(controller, PPID):
        return PPID(controller.pid, controller.kp_rest, controller.band, controller.leave, inverse)
    if isinstance(controller, PID):
        return FeedforwardPID(controller, inverse)
    raise InputError(f"feedforward: a {type(controller).__name__} takes none: make the controller's kind pid or ppid")


def _simulated(driven: DrivenPlant, loop: Loop, ends: tuple[float, float] | None, hottest: float) -> Series:
    slow = DrivenPlant.of(driven.plant, float(time_constant(driven.plant)))
    pid = loop.controller.inner
    if ends is None:
        command, value, warm = _looped(slow, loop, (float(pid.lower), float(pid.upper)))
        ends = _hysteretic(command, value, warm, hottest)
    command, value, warm = _looped(slow, loop, ends)
    if not np.all(np.isfinite(value)) or warm.max() > hottest + 1.0:
        raise InputError(
            f"feedforward: in a slow loop up to {ends[1]:.4g} {CHANNELS[driven.plant.drive.control].unit} the wire reaches "
            f"{warm.max():.4g} degC: give a smaller range"
        )
    return Series("slow loop", slow.period * np.arange(len(command)), command, value)


def _looped(slow: DrivenPlant, loop: Loop, ends: tuple[float, float]) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Command, channel and the hottest wire along the second of two loops, shape ``(_SAMPLES + 1,)`` each."""
    share = 1.0 - np.abs(2.0 * ((np.arange(2 * _SAMPLES + 1) / _SAMPLES) % 1.0) - 1.0)
    command = ends[0] + (ends[1] - ends[0]) * share
    value, warm = _march(slow, loop, jnp.asarray(command))
    return command[_SAMPLES:], np.asarray(value)[_SAMPLES:], np.asarray(warm)[_SAMPLES:]


@eqx.filter_jit
def _march(slow: DrivenPlant, loop: Loop, command: jax.Array) -> tuple[jax.Array, jax.Array]:
    def single(state: tuple, command: jax.Array) -> tuple[tuple, tuple]:
        each = loop.allocation(command)
        state, _, _ = slow.advance(state, each)
        seen = slow.read(state, each)
        return state, (seen[loop.channel], jnp.max(jnp.stack([seen[n] for n in numbered("temperature", slow.wires)])))

    return jax.lax.scan(single, slow.start(), command)[1]


def _hysteretic(command: np.ndarray, value: np.ndarray, warm: np.ndarray, hottest: float) -> tuple[float, float]:
    """The least and largest command at which a loop is open, its two ways being apart, of those at which the wires are cool enough."""
    ways = [np.stack([v[: _SAMPLES // 2 + 1], v[: _SAMPLES // 2 - 1 : -1]]) for v in (value, warm)]
    cool = np.all((ways[1] <= hottest) & np.isfinite(ways[0]), axis=0)
    if np.sum(cool) < 3:
        raise InputError("feedforward: a slow loop of the command overheats the wire from its start: raise the limit on temperature")
    apart = np.abs(ways[0][0] - ways[0][1])
    opened = cool & (apart > _OPEN * np.ptp(ways[0][:, cool]))
    among = command[: _SAMPLES // 2 + 1][opened if np.sum(opened) > 2 else cool]
    return float(among[0]), float(among[-1])
