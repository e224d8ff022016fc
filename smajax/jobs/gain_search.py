"""Gains looked for until they keep the limits, follow the reference and come to rest, as far as they can.

What helps is more starts where few were asked for, more weight of the effort, and the draws that fail.
"""

import math
from collections.abc import Mapping
from dataclasses import replace
from typing import NamedTuple

import numpy as np

from smajax.console import Progress
from smajax.control.reach import Reach
from smajax.control.tune import Tuned, least_broken, tune
from smajax.control.tuning import Tuning
from smajax.controller_file import ControllerFile
from smajax.jobs.behaviour import Behaviour, Checked, behave, check, given_up

_AGAIN = 3  # times that gains are tuned on for draws that fail
_WIDER = 4  # starts, where fewer do not keep all limits or give the reference up
_FURTHER = 1.5  # times what the worst draw passes a limit by: so much further inside it is sought
_LEAST, _HALF = 0.005, 0.5  # of a limit: by so much further at least, and at most
_CALMER, _MORE, _SOME = 3, 10.0, 0.01  # times that effort is given more weight, how much more, and the least that it had


class Searched(NamedTuple):
    """What was found, how the rig does with it, and the weights with which it was."""

    found: Tuned
    last: Behaviour
    weights: Mapping[str, float]


def searched(given: ControllerFile, tuning: Tuning, far: Reach, seed: int, progress: Progress) -> Searched:
    """The gains found from as many starts as wanted, or from more, since what does better may lie far away."""
    found = _search(given, tuning, given.starts, seed, progress)
    last = behave(given, found.gains)
    lost = "keep all limits yet" if not found.feasible else "follow the reference yet" if given_up(given, last, far) else ""
    if lost and given.starts < _WIDER:
        progress.phase(f"no gains {lost}: looking from more starts")
        again = _search(given, tuning, _WIDER, seed, progress)
        found = min(found, again, key=lambda one: _rank(given, one))._replace(rollouts=found.rollouts + again.rollouts)
        last = behave(given, found.gains)
    so_far = Searched(found, last, given.weights)
    return _calmer(given, tuning, so_far, far, seed, progress) if last.unstable or last.margins.unstable else so_far


def _search(given: ControllerFile, tuning: Tuning, starts: int, seed: int, progress: Progress) -> Tuned:
    return tune(
        tuning, given.weights, given.limits, settle=given.settle, starts=starts, seed=seed, band=given.band,
        progress=lambda count, cost: progress.step(f"{count} rollouts, cost {cost:.4g}"),
    )  # fmt: skip


def _rank(given: ControllerFile, one: Tuned) -> tuple:
    """What searches are compared by: limits broken first, then by what is wanted."""
    if not one.feasible:
        return least_broken(one)
    return False, 0.0, one.settling if given.settle else sum(weight * one.terms[name] for name, weight in given.weights.items())


def _calmer(given: ControllerFile, tuning: Tuning, before: Searched, far: Reach, seed: int, progress: Progress) -> Searched:
    """Gains that come to rest with margins, by ever more weight of the effort.

    What there was, if none do that follow and break limits no further.
    """
    spent, weights = before.found.rollouts, given.weights
    for _ in range(0 if given.settle else _CALMER):  # the shortest settling is not steered by weights
        weights = {**weights, "effort": _MORE * max(weights.get("effort", 0.0), _SOME)}
        progress.phase(f"the gains found do not come to rest, or nearly not: giving effort the weight {weights['effort']:g}")
        again = _search(replace(given, weights=weights), tuning, max(_WIDER, given.starts), seed, progress)
        spent += again.rollouts
        now = behave(given, again.gains)
        calm = not now.unstable and not now.margins.unstable
        if calm and not given_up(given, now, far) and least_broken(again)[:2] <= least_broken(before.found)[:2]:
            return Searched(again._replace(rollouts=spent), now, weights)
    return before._replace(found=before.found._replace(rollouts=spent))


def harder(
    given: ControllerFile, tuning: Tuning, found: Tuned, checks: Mapping[str, Checked], drawn: Mapping[str, np.ndarray], seed: int,
    progress: Progress,
) -> tuple[Tuned, Checked]:  # fmt: skip
    """Gains tuned on, a few times, for the draws among those checked that fail, beside some of those that they were tuned for.

    A limit that some of the draws pass then still is sought further inside by as much, and by half as much more. What follows the
    reference worse than the start gains do is no help.
    """
    count, limits, checked = tuning.count, dict(given.limits), checks["tuned"]
    hard: list[int] = []
    for turn in range(_AGAIN):
        if not checked.failing:
            break
        progress.phase(f"tuning on for {len(checked.failing)} draws that are unstable or beyond a limit")
        worst = checked.document["worst"]
        hard = list(dict.fromkeys([*checked.failing[: max(1, count // 2)], *hard]))
        rows = list(dict.fromkeys([*hard, *range(count)]))[:count]
        few = {n: v[np.resize(rows, count)] for n, v in drawn.items()}
        on = Tuning.of(given.driven, tuning.steered(found.gains), given.scenario, given.bounds, few, tuning.draws)
        if turn:
            passed = {k: (worst.get(k) or worst.get(f"peak_{k}") or 0.0) - v for k, v in given.limits.items()}
            limits = {k: v - (passed[k] > 0.0) * max(_FURTHER * passed[k], _LEAST * abs(v)) for k, v in limits.items()}
            limits = {k: max(v, given.limits[k] - _HALF * abs(given.limits[k])) for k, v in limits.items()}  # an overshoot below 0 is none
        again = tune(on, given.weights, limits, settle=given.settle, starts=_WIDER, seed=seed, band=given.band)
        found = found._replace(rollouts=found.rollouts + again.rollouts)
        now = check(given, again.gains, drawn)
        follows = given.settle or _middle(now) <= _middle(checks["start"])
        if follows and len(now.failing) < len(checked.failing):
            found, checked = again._replace(rollouts=found.rollouts), now
    return found, checked


def _middle(checked: Checked) -> float:
    """The median tracking error (RMS) over the draws."""
    return checked.document["spread"]["rmse"][1] or math.inf
