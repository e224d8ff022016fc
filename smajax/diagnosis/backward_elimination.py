"""Backward elimination: drop accepted effects that are no longer needed, and swap confusable ones."""

import dataclasses
import math

from smajax.diagnosis.acceptance import MIN_CHI2_FALL, MIN_SELECT_CUT, Rejection, RejectionCode
from smajax.diagnosis.candidate_evaluation import FAR_FROM_NOISE, CandidateEvaluator
from smajax.diagnosis.confusable_effects import refit_confusable_effects
from smajax.diagnosis.selection_state import SelectionState


def drop_unneeded_effects(evaluator: CandidateEvaluator, state: SelectionState) -> None:
    """Drop each accepted effect without which the recordings are explained as well.

    An effect stays if the fit without it is significantly worse on the training split and predicts the selection split
    worse by at least 5 %, as in ``acceptance``.

    Args:
        evaluator: The evaluator.
        state: The state of the selection, which is changed.
    """
    samples = evaluator.problem.samples
    for key in state.accepted:
        if len(state.accepted) < 2:
            return
        refit, current = state.current.refit, state.current
        remaining = refit.effect_set.without(key)
        earlier = [fit for fit in state.accepted_fits if set(fit.keys) == set(remaining.keys)]
        if earlier:
            without = earlier[0]
        else:
            without = evaluator.evaluate(evaluator.fit(remaining, refit.base, evaluator.stride(current.train_chi2)))
        if not math.isfinite(without.total_chi2):
            continue
        cut = 1.0 - math.sqrt(current.select_chi2 / without.select_chi2)
        fall = (without.train_chi2 - current.train_chi2) * samples
        if fall < MIN_CHI2_FALL * max(1.0, current.train_chi2) or cut < MIN_SELECT_CUT:
            state.rejected.append(Rejection(key, RejectionCode.unneeded))
            state.current = without


def swap_confusable_effects(evaluator: CandidateEvaluator, state: SelectionState) -> None:
    """Replace an effect by a confusable one if several effects nearly explain the residual and the fit improves.

    The first effect was selected alone, and may have been the wrong one of two similar effects.

    Args:
        evaluator: The evaluator.
        state: The state of the selection, which is changed.
    """
    samples = evaluator.problem.samples
    for key in state.accepted:
        current = state.current
        at_noise = current.train_chi2 < state.acceptable_chi2
        if len(current.keys) < 2 or at_noise or current.total_chi2 > 2.0 * FAR_FROM_NOISE:
            return
        last = dataclasses.replace(current, refit=current.refit.with_effect_last(key))
        best = min(refit_confusable_effects(evaluator, last), key=lambda fit: fit.total_chi2, default=None)
        fall = MIN_CHI2_FALL * max(1.0, current.train_chi2) / samples
        if best is not None and best.total_chi2 < current.total_chi2 - fall:
            state.rejected.append(Rejection(key, RejectionCode.swapped, others=(best.key,)))
            state.current = evaluator.refit_to_convergence(best)
            state.equivalent.pop(key, None)
