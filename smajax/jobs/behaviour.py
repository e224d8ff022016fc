"""What gains do on the rig that they are tuned for: its rollout in numbers, whether it comes to rest, and what it does on draws."""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, NamedTuple

import jax.numpy as jnp
import numpy as np

from smajax.control import metrics
from smajax.control.margins import Margins, margins, of_draws, restless, worst
from smajax.control.reach import Reach
from smajax.control.rollout import Loop, Rollout
from smajax.control.tuning import Tuning, roll
from smajax.controller_file import ControllerFile
from smajax.report.document import number
from smajax.units import numbered

_BATCH = 64
_IDLE = 0.9  # of the error of a rig that is left alone: gains that leave more have given the reference up


@dataclass(frozen=True, eq=False)
class Behaviour:
    """One set of gains on the plant as the rig has it: its rollout, metrics in SI, margins, and why it counts as unstable, if it does."""

    loop: Loop
    channels: Mapping[str, np.ndarray]
    command: np.ndarray
    numbers: dict[str, float]
    margins: Margins
    unstable: str


class Checked(NamedTuple):
    """What gains do on draws: a document, and which draws are unstable or beyond a limit."""

    document: dict[str, Any]
    failing: tuple[int, ...]


def behave(given: ControllerFile, gains: Mapping[str, float]) -> Behaviour:
    """How the rig's own plant does with other gains than the file's."""
    as_seen, calm = (Tuning.of(given.driven, given.loop, s, {}) for s in (given.scenario, given.scenario.calm()))
    done, still = roll(as_seen, gains), roll(calm, gains)
    channels = {name: np.asarray(values)[0] for name, values in done.channels.items()}
    command, loop = np.asarray(done.command)[0], as_seen.steered(gains)
    why = _unstable(given, still, 0)
    return Behaviour(loop, channels, command, _numbers(given, channels, command), margins(given.driven, loop, calm.scenario), why)


def _unstable(given: ControllerFile, still: Rollout, member: int) -> str:
    """Why a member of a rollout without noise counts as unstable; nothing if it does not."""
    pid = given.loop.controller.inner
    command, value = np.asarray(still.command[member]), np.asarray(still.channels[given.loop.channel][member])
    return restless(command, np.asarray(given.scenario.reference), value, float(pid.upper) - float(pid.lower))


def _numbers(given: ControllerFile, channels: Mapping[str, np.ndarray], command: np.ndarray) -> dict[str, float]:
    period, channel = given.driven.period, given.loop.channel
    reference = np.asarray(given.scenario.reference)
    told = metrics.tracking(channels[channel], reference, period)
    answers = metrics.answers(
        channels[channel], reference, metrics.jumps(reference, float(given.scenario.before), period), period, given.band
    )
    if answers:
        told |= {
            "rise": max(a.rise for a in answers),
            "settling": max(a.settling for a in answers),
            "overshoot": max(a.overshoot for a in answers),
        }
    told["energy"] = float(np.sum([np.sum(channels[n]) for n in each_of(given, "power")]) * period)
    told["mean_command"] = float(np.mean(np.sum(command, axis=1)))
    for name in ("temperature", "stress", "current"):
        told[f"peak_{name}"] = float(np.max([np.max(channels[n]) for n in each_of(given, name)]))
    return told


def each_of(given: ControllerFile, name: str) -> tuple[str, ...]:
    """The channels of a kind that the rig's wires have."""
    return numbered(name, given.driven.wires)


def at_rest(given: ControllerFile, name: str) -> float:
    """A channel of a rig that is left alone; of two wires the larger one."""
    seen = given.driven.read(given.driven.start(), jnp.zeros(given.driven.wires))
    return max(float(seen[n]) for n in ((name,) if name in seen else each_of(given, name)))


def check(given: ControllerFile, gains: Mapping[str, float], drawn: Mapping[str, np.ndarray]) -> Checked:
    """Metrics of every draw: median and 5 to 95 %, and how many are stable (without noise) and within the limits.

    A draw that comes to rest is judged by its margins, too, as the rig's own plant is: by the median along its rollout.
    """
    count = len(next(iter(drawn.values())))
    size = min(_BATCH, count)
    told: list[dict[str, float]] = []
    calm = given.scenario.calm()
    linear = of_draws(given.driven, Tuning.of(given.driven, given.loop, calm, {}).steered(gains), calm, drawn)
    unstable = broken = swinging = 0
    failing: list[int] = []
    for first in range(0, count, size):
        rows = np.minimum(np.arange(first, first + size), count - 1)  # the last batch is filled up: one program serves all
        some = {n: v[rows] for n, v in drawn.items()}
        done, still = (roll(Tuning.of(given.driven, given.loop, s, {}, some), gains) for s in (given.scenario, calm))
        channels = {n: np.asarray(v) for n, v in done.channels.items()}
        for k in range(min(size, count - first)):
            numbers = _numbers(given, {n: v[k] for n, v in channels.items()}, np.asarray(done.command[k]))
            told.append(numbers)
            restless, beyond = bool(_unstable(given, still, k)), bool(broken_limits(given.limits, numbers))
            swings = not restless and linear[first + k].unstable
            unstable, broken, swinging = unstable + restless, broken + beyond, swinging + swings
            failing += [first + k] * (restless or beyond or swings)
    table = {n: np.array([t[n] for t in told]) for n in told[0]}
    spread = {n: [number(float(q)) for q in _quantiles(v)] for n, v in table.items()}
    largest = {n: number(float(np.max(v))) for n, v in table.items()}
    counts = {"draws": count, "unstable": unstable, "unstable_linearised": swinging, "beyond_a_limit": broken}
    margin = {n: number(v) for n, v in worst(linear)._asdict().items()}
    return Checked(counts | {"spread": spread, "worst": largest, "worst_margins": margin}, tuple(failing))


def _quantiles(values: np.ndarray) -> np.ndarray:
    """5, 50 and 95 % of what is a number; an infinite one, such as a settling time that never ends, is."""
    known = np.sort(values[~np.isnan(values)])
    return np.quantile(known, [0.05, 0.5, 0.95], method="inverted_cdf") if len(known) else np.full(3, np.nan)


def broken_limits(limits: Mapping[str, float], numbers: Mapping[str, float]) -> list[str]:
    """The limits that a rollout's numbers do not keep."""
    names = {k: k if k in ("overshoot", "settling") else f"peak_{k}" for k in limits}
    scales = {"temperature": 10.0, "overshoot": metrics.BAND, "settling": max(limits.get("settling", 1.0), 1e-9)}
    return [
        k for k, limit in limits.items()
        if names[k] in numbers and not numbers[names[k]] <= limit + 2e-3 * scales.get(k, 0.1 * abs(limit))
    ]  # fmt: skip


def given_up(given: ControllerFile, last: Behaviour, far: Reach) -> bool:
    """Whether gains do hardly more than a rig that is left alone, though it can."""
    idle, least = idle_error(given), _least_error(given, far)
    return idle > 0.0 and last.numbers["rmse"] > least + _IDLE * (idle - least)


def idle_error(given: ControllerFile) -> float:
    """The tracking error (RMS) of a rig that stays at rest; 0 for a reference that is near it all the time."""
    rest = at_rest(given, given.loop.channel)
    wanted = np.append(np.asarray(given.scenario.reference), rest)
    error = float(np.sqrt(np.mean((wanted - rest) ** 2)))
    return error if error > 0.1 * float(np.ptp(wanted)) else 0.0


def _least_error(given: ControllerFile, far: Reach) -> float:
    """The tracking error (RMS) of a rig that is always as near to the reference as it reaches."""
    wanted = np.asarray(given.scenario.reference)
    return float(np.sqrt(np.mean((wanted - np.clip(wanted, far.least, far.largest)) ** 2)))
