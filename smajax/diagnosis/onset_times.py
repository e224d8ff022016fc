"""Onset times: the instants at which effects such as a change of the airflow begin.

As a function of an onset time the cost has many local minima, one for each motion of the wire that could be mistaken
for the change, and it is nearly flat while the wire is cold. A search by derivatives therefore fails, and onset times
are scanned:

1. ``scan_onset_times``: a coarse grid over the whole recording, with a search from the best points.
2. ``refine_onsets``: a fine grid around the fitted onset, as far as the cost is flat.
3. ``onset_prediction_error``: how much a prediction changes over all onset times that the recordings allow.

An onset time has no influence at strength 0, so the score test takes the largest gain over a grid of onset times, and
its p-value is that of the largest gain (``screening``). Source: davies1977.
"""

import math
from collections.abc import Sequence

import numpy as np

from smajax.diagnosis import candidates
from smajax.diagnosis.candidate_evaluation import CandidateEvaluator
from smajax.diagnosis.candidates import CandidateFit, EffectSet, Refit, RefitSearch
from smajax.diagnosis.data_split import TRAIN
from smajax.diagnosis.problem import DiagnosisProblem
from smajax.numerics.ensemble import share_among_cores

# Number of onset times of the scan over a whole recording, and of the best of them from which a search starts. Chosen
# by trial; tests/unit/diagnosis holds them.
_SCANNED = 32
_SEARCHED = 5
# Number of steps of each of these searches, the first of which only evaluates the start, and of the further steps of
# the best search. Chosen by trial; tests/unit/diagnosis holds the onset times.
_SEARCH_STEPS = 9
_FINAL_STEPS = 30
# The resolution of onset times near a fitted one is the recording's length over the first number; the second is the
# largest number of them. Chosen by trial.
_RESOLUTION = 1200
_MAX_INSTANTS = 60
# Cost over that of the fitted onset time below which it counts as flat. Chosen by trial.
_FLAT = 1.1
# Fall of chi-squared that justifies another search: two standard deviations, squared.
_MIN_FALL = 4.0
# Reduced chi-squared above which the misfit is more than a small error of an onset time. Chosen by trial.
_FAR_FROM_FIT = 100.0
# Rise of chi-squared over its minimum that noise may cause: three standard deviations of one parameter, squared.
_ALLOWED_RISE = 9.0


def scan_onset_times(evaluator: CandidateEvaluator, search: RefitSearch) -> list[RefitSearch]:
    """Scan each onset time of a search over the whole recording, and search again from the best points of the scan.

    Args:
        evaluator: The evaluator.
        search: The search, at its end.

    Returns:
        The best search for each onset time; empty if the search is at the noise already, or fails.
    """
    problem = evaluator.problem
    refit = problem.refit_from(search)
    if problem.reduced_chi2(refit.residual, TRAIN) < candidates.AT_NOISE or not math.isfinite(refit.chi2):
        return []
    searches, stride = [], evaluator.stride(problem.reduced_chi2(refit.residual, TRAIN))

    def search_from(name: str, onset: float) -> RefitSearch:
        effect_set = refit.effect_set.with_values({name: onset})
        return problem.start_search(effect_set, refit.base, stride=stride).advance(_SEARCH_STEPS)

    def cost_at(name: str, onset: float) -> float:
        effect_set = refit.effect_set.with_values({name: onset})
        residual = problem.predict_on(problem.strided_problem(stride), effect_set, refit.base)
        return float(residual @ residual) if np.all(np.isfinite(residual)) else math.inf

    for name in _onset_names(problem, refit):
        onsets = [problem.duration * (k + 0.5) / _SCANNED for k in range(_SCANNED)]
        costs = share_among_cores(lambda onset, name=name: cost_at(name, onset), onsets)
        best_points = sorted(zip(costs, onsets, strict=True))[:_SEARCHED]
        from_best = share_among_cores(lambda point, name=name: search_from(name, point[1]), best_points)
        best = min(from_best, key=lambda s: s.cost)
        searches.append(evaluator.continue_if_needed(best.advance(_FINAL_STEPS)))
    return searches


def refine_onsets(evaluator: CandidateEvaluator, fit: CandidateFit) -> CandidateFit:
    """Refit with better onset times near the fitted ones.

    Args:
        evaluator: The evaluator.
        fit: A fit to the training split.

    Returns:
        The new fit if it explains the training split better, else ``fit``.
    """
    better = with_better_onsets(evaluator.problem, fit.refit, (TRAIN,))
    if better is None:
        return fit
    refined = evaluator.evaluate(evaluator.fit(better, fit.refit.base, 1, rtol=1e-7))
    improved = refined.train_chi2 < fit.train_chi2 and (refined.at_noise or not fit.at_noise)
    return refined if improved else fit


def with_better_onsets(problem: DiagnosisProblem, refit: Refit, splits: Sequence[int]) -> EffectSet | None:
    """Move each onset time to the smallest cost near it.

    Args:
        problem: The diagnosis problem.
        refit: The fitted model.
        splits: The splits whose squared residuals are the cost.

    Returns:
        The effects with the new onset times; ``None`` if no cost near the fitted ones is smaller by more than 4.
    """
    better = None
    if not problem.reduced_chi2(refit.residual, TRAIN) < _FAR_FROM_FIT:
        return None
    for name in _onset_names(problem, refit):
        onsets, costs = _costs_near(problem, refit, better or refit.effect_set, name, splits)
        if np.min(costs) < costs[0] - _MIN_FALL:
            better = (better or refit.effect_set).with_values({name: float(onsets[np.argmin(costs)])})
    return better


def onset_prediction_error(
    problem: DiagnosisProblem, refit: Refit, split: int, fitted: Sequence[int] = (TRAIN,)
) -> float:
    """Compute the mean square change of a prediction over all onset times that the fitted splits allow.

    An onset time is allowed if its cost on the fitted splits is within 9 of the smallest one.

    Args:
        problem: The diagnosis problem.
        refit: The fitted model.
        split: The split that is predicted.
        fitted: The splits to which the onset times were fitted.

    Returns:
        The mean square over the noise, averaged over the allowed times and added over the onsets; 0 without an onset.
    """
    total = 0.0
    predicted = problem.predict(refit.effect_set, refit.base, split)
    for name in _onset_names(problem, refit):
        onsets, costs = _costs_near(problem, refit, refit.effect_set, name, fitted)
        allowed = onsets[costs < np.min(costs) + _ALLOWED_RISE]
        predictions = share_among_cores(
            lambda onset, name=name: problem.predict(refit.effect_set.with_values({name: onset}), refit.base, split),
            list(allowed),
        )
        squares = [np.mean(problem.counted_samples(p - predicted, split) ** 2) for p in predictions]
        total += float(np.mean(squares))
    return total


def _onset_names(problem: DiagnosisProblem, refit: Refit) -> list[str]:
    """Names of the onset times among a refit's effect parameters."""
    return [n for n in problem.free_effect_parameters(refit.effect_set) if n.endswith(".instant")]


def _costs_near(
    problem: DiagnosisProblem, refit: Refit, effect_set: EffectSet, name: str, splits: Sequence[int]
) -> tuple[np.ndarray, np.ndarray]:
    """A fitted onset time and others near it, and the sum of squared residuals of each on some splits.

    While the wire is cold the cost is nearly flat, with a shallow minimum at the onset. The grid therefore extends on
    each side until the cost has risen by a tenth.
    """
    fitted, ends = refit.values[name], []

    def cost(onset: float) -> float:
        with_onset = effect_set.with_values({name: onset})
        residuals = ((problem.predict(with_onset, refit.base, k), k) for k in splits)
        total = sum(float(np.sum(problem.counted_samples(residual, k) ** 2)) for residual, k in residuals)
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
    onsets = np.linspace(ends[0], ends[1], count)
    return np.append(fitted, onsets), np.array([fitted_cost, *share_among_cores(cost, list(onsets))])
