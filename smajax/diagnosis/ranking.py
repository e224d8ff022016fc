"""Ranking: a summary of every effect by its score at the base fit."""

import math

from smajax.diagnosis.candidate_evaluation import CandidateEvaluator, Scores
from smajax.diagnosis.candidates import Refit
from smajax.diagnosis.data_split import TRAIN
from smajax.diagnosis.detectability import detectability_from_score, undetectable
from smajax.diagnosis.screening import half_width_95
from smajax.diagnosis.selection_state import CandidateSummary


def rank_effects(evaluator: CandidateEvaluator, scores: Scores, base: Refit) -> dict[str, CandidateSummary]:
    """Summarise every effect by its score at the base fit, with a 95 % interval that is widened by the misfit.

    Args:
        evaluator: The evaluator.
        scores: The scores.
        base: The base fit.
    """
    problem, ranking = evaluator.problem, {}
    free = zip(problem.problems[TRAIN].unknowns, evaluator.free_columns(base), strict=True)
    names = [unknown.label for unknown, is_free in free if is_free]
    inflation = math.sqrt(max(problem.reduced_chi2(base.residual, TRAIN), 1.0))
    for key, kind in problem.effect_kinds.items():
        if key not in scores.best:
            ranking[key] = CandidateSummary(undetectable(problem, kind))
            continue
        score, sensitivity = scores.best[key], scores.sensitivities[key, scores.shapes[key]]
        detectability = detectability_from_score(kind, score, sensitivity, scores.jacobian, names)
        detectable = detectability.minimum_detectable_strength
        if detectability.status != "testable" or detectable is None:
            ranking[key] = CandidateSummary(detectability)
            continue
        estimate, half_width = score.strength * kind.typical, half_width_95(detectable) * inflation
        ranking[key] = CandidateSummary(
            detectability, estimate, estimate - half_width, estimate + half_width, score.gain, scores.p_values[key]
        )
    return ranking
