"""Cases of a control task: rollouts that differ in noise, plant, start of the loop and rounding of the gains."""

from collections.abc import Mapping
from typing import Any, NamedTuple

import numpy as np
import scipy.stats
from jaxtyping import Float

from smajax import parameters
from smajax.control.analysis.case_numbers import NOISE_CASES
from smajax.control.analysis.closed_loop_checks import ControlTask, value_at_rest
from smajax.control.loop.rollout import Scenario
from smajax.errors import InputError

# Range of the ambient temperature about that of the rig, K: that of a room over a day.
AMBIENT_RANGE = 3.0
# The temperature of the rig and both ends of the range, as shares of it; that many members of a search have no noise.
_ENDS = np.array([0.0, 1.0, -1.0])
QUIET_MEMBERS = len(_ENDS)
# Number of cases with another ambient temperature, the ends of the range included; of cases for each start of the loop;
# and of cases for each rounding of the gains. Chosen so that all cases together fill whole batches.
_AMBIENT_CASES = 29
_START_CASES = 8
_ROUNDED_CASES = 4
# Number of cases with parameters drawn from the intervals of a fit or from ranges, for the same reason, and number of
# these draws that are cases without noise as well, in which an unstable loop is seen.
DRAWN_CASES = 64
_QUIET_DRAWN_CASES = 32
# Significant digits of a gain in the table of gains that the command prints; 0 stands for no rounding, and
# ``SINGLE_PRECISION`` for the C header with SMAJAX_REAL as float.
_TABLE_DIGITS = 5
SINGLE_PRECISION = -1
# Number in the seed of the cases that separates their random numbers from those of the search.
_CASE_STREAM = 13
_AMBIENT = "environment.ambient"

# Groups of cases by key, in words.
GROUPS = {
    "noise": "noise",
    "quiet": "no noise",
    "ambient": f"ambient temperature within +-{AMBIENT_RANGE:g} K",
    "drawn": "drawn parameters",
    "start": "starts of the loop",
    "rounded": "rounded gains",
}


class Case(NamedTuple):
    """What one rollout differs in.

    Attributes:
        group: Group of the case, a key of ``GROUPS``.
        name: What it is called.
        noise: Standard normal numbers of the sensors' noise, shape ``(n,)``.
        initial: Reference before the first sample.
        parameters: Parameters of the plant by name, internal units.
        digits: Significant digits to which the gains are rounded; 0 for none, ``SINGLE_PRECISION`` for a float.
        rests: Whether the loop has held the first reference before the first sample, for as long as the rollout.
    """

    group: str
    name: str
    noise: Float[np.ndarray, " samples"]
    initial: float
    parameters: dict[str, float]
    digits: int = 0
    rests: bool = False


def ambient_temperature(task: ControlTask, draws: Mapping[str, Any] | None = None) -> float | None:
    """Return the ambient temperature of a task's plant, degC; ``None`` if cases do not vary it.

    Args:
        task: The control task.
        draws: Parameters that are drawn, by name; they may include the ambient temperature.
    """
    if _AMBIENT in task.scenario.changes or _AMBIENT in (draws or {}):
        return None
    try:
        return float(parameters.get(task.system.plant, _AMBIENT))
    except InputError:  # an own plant without surroundings
        return None


def ambient_members(task: ControlTask, count: int, draws: Mapping[str, Any]) -> dict[str, Float[np.ndarray, " count"]]:
    """Return ambient temperatures for the members of a search: that of the rig, both ends, and values in between.

    The last ``QUIET_MEMBERS`` members have the temperature of the rig and both ends again.

    Args:
        task: The control task.
        count: Number of members.
        draws: Parameters that are drawn already, by name.

    Returns:
        Values by the parameter's name, shape ``(count,)``; empty if the ambient temperature does not vary.
    """
    ambient = ambient_temperature(task, draws)
    if ambient is None or count < 2:
        return {}
    shares = np.concatenate([_ENDS, scipy.stats.qmc.Halton(1, rng=0).random(count)[:, 0] * 2.0 - 1.0])[:count]
    shares[-QUIET_MEMBERS:] = _ENDS[:count]
    return {_AMBIENT: ambient + AMBIENT_RANGE * shares}


def make_cases(
    task: ControlTask,
    draws: Mapping[str, np.ndarray],
    noisy: bool,
    seed: int,
    repeat: int = 0,
    noise: int = NOISE_CASES,
) -> list[Case]:
    """Return the cases of a check, with noise that no search has used.

    Args:
        task: The control task.
        draws: Drawn parameters of the plant by name, internal units, shape ``(count,)`` each; empty for none.
        noisy: Whether any sensor of the loop has noise.
        seed: Seed of the random numbers.
        repeat: Number of the check: each has its own random numbers.
        noise: Number of draws of the noise.
    """
    scenario, rng = task.scenario, np.random.default_rng([seed, _CASE_STREAM, repeat])
    initial, count = float(scenario.initial_reference), scenario.reference.shape[0]
    ambient, quiet = ambient_temperature(task, draws), np.zeros(count)
    plain: dict[str, float] = {} if ambient is None else {_AMBIENT: ambient}
    if draws:
        plain |= {name: float(parameters.get(task.system.plant, name)) for name in draws}

    def noise_draw() -> np.ndarray:
        return rng.standard_normal(count) if noisy else quiet

    cases = [Case("quiet", "no noise", quiet, initial, plain)]
    cases += [Case("noise", f"noise draw {k + 1}", noise_draw(), initial, plain) for k in range(noise if noisy else 0)]
    if ambient is not None:
        shares = 2.0 * scipy.stats.qmc.LatinHypercube(1, rng=rng).random(_AMBIENT_CASES)[:, 0] - 1.0
        for end in (-AMBIENT_RANGE, AMBIENT_RANGE):
            there = plain | {_AMBIENT: ambient + end}
            cases.append(Case("ambient", f"no noise, ambient {ambient + end:.4g} degC", quiet, initial, there))
        for share in (-1.0, 1.0, *shares.tolist()):
            value = ambient + AMBIENT_RANGE * share
            name = f"ambient {value:.4g} degC"
            cases.append(Case("ambient", name, noise_draw(), initial, plain | {_AMBIENT: value}))
    for k in range(len(next(iter(draws.values()))) if draws else 0):
        drawn = plain | {name: float(v[k]) for name, v in draws.items()}
        cases.append(Case("drawn", f"parameter draw {k + 1}", noise_draw(), initial, drawn))
        if noisy and k < _QUIET_DRAWN_CASES:
            cases.append(Case("drawn", f"no noise, parameter draw {k + 1}", quiet, initial, drawn))
    cases += _starts(scenario, value_at_rest(task, task.loop.channel), plain, noise_draw)
    for digits, name in ((_TABLE_DIGITS, f"gains of {_TABLE_DIGITS} digits"), (SINGLE_PRECISION, "gains as floats")):
        cases += [Case("rounded", name, noise_draw(), initial, plain, digits) for _ in range(_ROUNDED_CASES)]
    return cases


def _starts(scenario: Scenario, rest: float, plain: dict[str, float], noise_draw: Any) -> list[Case]:
    """Cases in which the controller begins at other references than that before the first sample, or the loop rests."""
    first = float(scenario.reference[0])
    starts = {
        "a start at rest": (rest, False),
        "a controller that starts at the first reference": (first, False),
        "a loop at rest at the first reference": (first, True),
    }
    return [
        Case("start", name, noise_draw(), at, plain, rests=rests)
        for name, (at, rests) in starts.items()
        for _ in range(_START_CASES)
    ]


def rounded(value: float, digits: int) -> float:
    """Return a gain as it is printed.

    Args:
        value: The gain.
        digits: Number of significant digits; 0 for no rounding, ``SINGLE_PRECISION`` for a single-precision number.
    """
    if digits == SINGLE_PRECISION:
        return float(np.float32(value))
    return float(f"{value:.{digits}g}") if digits else value
