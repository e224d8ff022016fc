"""Onset times: the instants of effects that set in at some moment, such as a draught.

A residual depends on an instant with many a minimum, one for each motion of the wire that the change may be taken for,
and hardly at all while the wire is cold; so instants are also scanned, and a prediction may miss by all that the
recordings leave open.
"""

import math
from collections.abc import Sequence

import numpy as np

from smajax.diagnosis import candidates
from smajax.diagnosis.candidate_evaluation import CandidateEvaluator
from smajax.diagnosis.candidates import CandidateFit, EffectSet, Refit, RefitSearch
from smajax.diagnosis.data_split import TRAIN
from smajax.diagnosis.parallel import map_in_pairs
from smajax.diagnosis.problem import DiagnosisProblem

# Instants of the scan over a whole recording, and from how many of the best a search starts. Chosen by trial;
# tests/unit/diagnosis holds them.
_SCANNED = 32
_SEARCHED = 5
# Steps of each of these searches, the first of which only evaluates the start, and of the best of them to its end.
_SEARCH_STEPS = 9
_FINAL_STEPS = 30
# Resolution of instants near a fitted one, as a share of the recording's length, and how many are evaluated at most.
# Chosen by trial.
_RESOLUTION = 1200
_MAX_INSTANTS = 60
# Cost over that of the fitted instant up to which it counts as flat. Chosen by trial.
_FLAT = 1.1
# Fall of chi-squared that is worth another search: the square of two standard deviations.
_MIN_FALL = 4.0
# Reduced chi-squared from which the misfit is more than an instant that is a little off. Chosen by trial.
_FAR_FROM_FIT = 100.0
# Rise of chi-squared over its minimum that noise may cause: the square of three standard deviations of one parameter.
_ALLOWED_RISE = 9.0


def scan_onset_times(evaluator: CandidateEvaluator, search: RefitSearch) -> list[RefitSearch]:
    """Continue a search from each of its instants, squares over the whole recording to where that costs least.

    Returns:
        One search for each instant; none if the search is at the noise, or fails.
    """
    problem = evaluator.problem
    refit = problem.refit_from(search)
    if problem.reduced_chi2(refit.residual, TRAIN) < candidates.AT_NOISE or not math.isfinite(refit.chi2):
        return []
    searches, stride = [], evaluator.stride(problem.reduced_chi2(refit.residual, TRAIN))

    def advance_from(name: str, instant: float) -> RefitSearch:
        effect_set = refit.effect_set.with_values({name: instant})
        return problem.start_search(effect_set, refit.base, stride=stride).advance(_SEARCH_STEPS)

    def cost_at(name: str, instant: float) -> float:
        return problem.cost(refit.effect_set.with_values({name: instant}), refit.base, stride)

    for name in _instants(problem, refit):
        times = [problem.duration * (k + 0.5) / _SCANNED for k in range(_SCANNED)]
        costs = map_in_pairs(lambda t, name=name: cost_at(name, t), times)
        best = sorted(zip(costs, times, strict=True))[:_SEARCHED]
        advanced = map_in_pairs(lambda pair, name=name: advance_from(name, pair[1]), best)
        nearest = min(advanced, key=lambda s: s.cost)
        searches.append(evaluator.continue_if_needed(nearest.advance(_FINAL_STEPS)))
    return searches


def refine_onsets(evaluator: CandidateEvaluator, fit: CandidateFit) -> CandidateFit:
    """Refit with the instants that leave least of the training split, near where the search has left them."""
    better = with_better_onsets(evaluator.problem, fit.refit, (TRAIN,))
    if better is None:
        return fit
    refined = evaluator.evaluate(evaluator.fit(better, fit.refit.base, 1, rtol=1e-7))
    improved = refined.train_chi2 < fit.train_chi2 and (refined.at_noise or not fit.at_noise)
    return refined if improved else fit


def with_better_onsets(problem: DiagnosisProblem, refit: Refit, splits: Sequence[int]) -> EffectSet | None:
    """Move instants to where the residual on these splits is smaller.

    Returns:
        The set of effects with other instants; ``None`` if its own are as good as any near them.
    """
    better = None
    for name in _instants(problem, refit) if problem.reduced_chi2(refit.residual, TRAIN) < _FAR_FROM_FIT else ():
        times, costs = _costs_near(problem, refit, better or refit.effect_set, name, splits)
        if np.min(costs) < costs[0] - _MIN_FALL:
            better = (better or refit.effect_set).with_values({name: float(times[np.argmin(costs)])})
    return better


def onset_prediction_error(
    problem: DiagnosisProblem, refit: Refit, split: int, fitted: Sequence[int] = (TRAIN,)
) -> float:
    """Return the mean square by which a prediction moves as instants take all values that the fitted splits allow.

    Args:
        problem: The diagnosis problem.
        refit: The fitted model.
        split: The split that is predicted.
        fitted: The splits to which the instants were fitted.
    """
    total = 0.0
    predicted = problem.predict(refit.effect_set, refit.base, split)
    for name in _instants(problem, refit):
        times, costs = _costs_near(problem, refit, refit.effect_set, name, fitted)
        allowed = times[costs < np.min(costs) + _ALLOWED_RISE]
        others = map_in_pairs(
            lambda t, name=name: problem.predict(refit.effect_set.with_values({name: t}), refit.base, split),
            list(allowed),
        )
        squares = [np.mean(problem.counted_samples(other - predicted, split) ** 2) for other in others]
        total += float(np.mean(squares))
    return total


def _instants(problem: DiagnosisProblem, refit: Refit) -> list[str]:
    return [n for n in problem.free_effect_parameters(refit.effect_set) if n.endswith(".instant")]


def _costs_near(
    problem: DiagnosisProblem, refit: Refit, effect_set: EffectSet, name: str, splits: Sequence[int]
) -> tuple[np.ndarray, np.ndarray]:
    """An instant's own value and others near it, and the sum of squares that each leaves of these splits.

    While the wire is cold it hardly matters when a draught sets in: the cost is all but flat there, its slope is
    useless to a search, and the instant is where it dips a little. The instants reach on each side to where the cost
    rises.
    """
    fitted, ends = refit.values[name], []

    def cost(instant: float) -> float:
        at = effect_set.with_values({name: instant})
        total = sum(float(np.sum(problem.counted_samples(problem.predict(at, refit.base, k), k) ** 2)) for k in splits)
        return total if math.isfinite(total) else math.inf

    fitted_cost, resolution = cost(fitted), problem.duration / _RESOLUTION
    for direction in (-1.0, 1.0):
        distance = resolution
        while (
            0.0 < fitted + direction * distance < problem.duration
            and cost(fitted + direction * distance) < _FLAT * fitted_cost
        ):
            distance *= 2.0
        ends.append(float(np.clip(fitted + direction * distance, 0.0, problem.duration)))
    count = min(int((ends[1] - ends[0]) / resolution) + 2, _MAX_INSTANTS)
    times = np.linspace(ends[0], ends[1], count)
    return np.append(fitted, times), np.array([fitted_cost, *map_in_pairs(cost, list(times))])
