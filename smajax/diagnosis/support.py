"""Facts and candidates: which accepted effects a rig is said to have.

An effect that absorbs a part of a background, which no effect of the catalogue matches, may be accepted for its better
prediction. It is called a fact only if the accepted effects explain at least half of the excess mean square of the
selection split, by more than chance, and each of them explains a large share of what the others leave. Otherwise it is
a candidate: the rig may have it, and its strength describes what it absorbs.
"""

import math

from smajax.diagnosis.acceptance import Rejection, RejectionCode
from smajax.diagnosis.bootstrap import bootstrap_cut
from smajax.diagnosis.candidate_evaluation import CandidateEvaluator
from smajax.diagnosis.candidates import CandidateFit
from smajax.diagnosis.data_split import SELECT
from smajax.diagnosis.selection_state import SelectionState, Support

# Least share of the excess mean square of the selection split that the facts explain together: more than all else.
MIN_FACT_SHARE = 0.5
# Least shares that each of several facts explains: of the excess without it, more than all else; and of the excess of
# the model without effects, since next to a dominant effect others may absorb most of a small background. Chosen by
# trial on single rough rigs; the rates of experiments/diagnosis/rough_rigs.py are not counted yet.
MIN_MEMBER_SHARE = 0.5
MIN_MEMBER_SHARE_OF_ALL = 0.05


def judge_effects(evaluator: CandidateEvaluator, state: SelectionState, *, final: bool = False) -> None:
    """Separate the accepted effects into facts, which stay accepted, and candidates, which do not.

    Effects that explain the training split down to its noise stay for the joint refit, since that split may not
    determine them well enough for a prediction.

    Args:
        evaluator: The evaluator of the last fit.
        state: The state at the end of the selection, which is changed: ``supports`` gets the evidence, facts first.
        final: Whether the joint refit has left more than noise, so that such effects are judged as well.
    """
    candidates = [support for support in state.supports if not support.is_fact]
    while state.accepted and not state.current.at_noise:
        if not final and state.current.train_chi2 < state.acceptable_chi2:
            break
        weakest = min((_support(evaluator, state, key) for key in state.accepted), key=lambda s: s.share)
        if _are_facts(evaluator, state, weakest):
            break
        candidates.insert(0, weakest)
        state.rejected.append(Rejection(weakest.key, RejectionCode.little_explained, weakest.share))
        state.current = _without(evaluator, state, weakest.key)
        state.equivalent.pop(weakest.key, None)
    facts = [_support(evaluator, state, key)._replace(is_fact=True) for key in state.accepted]
    state.supports = (*facts, *candidates)


def _are_facts(evaluator: CandidateEvaluator, state: SelectionState, weakest: Support) -> bool:
    """Whether the accepted effects explain enough together, and the weakest of several next to the others."""
    whole = compare(evaluator, "", state.base_fit, state.current)
    if min(whole.share, state.explained) < MIN_FACT_SHARE or whole.cut[0] <= 0.0:
        return False
    if len(state.accepted) == 1:
        return True
    excess, without, remaining = _excesses(state.base_fit, _without(evaluator, state, weakest.key), state.current)
    shares = weakest.share >= MIN_MEMBER_SHARE and without - remaining >= MIN_MEMBER_SHARE_OF_ALL * excess
    return shares and not weakest.cut[0] <= 0.0


def _support(evaluator: CandidateEvaluator, state: SelectionState, key: str) -> Support:
    """The evidence for one of the accepted effects, next to the others."""
    return compare(evaluator, key, _without(evaluator, state, key), state.current)


def compare(evaluator: CandidateEvaluator, key: str, without: CandidateFit, fit: CandidateFit) -> Support:
    """Compare the predictions of the selection split by two fits.

    Args:
        evaluator: The evaluator of both.
        key: Key of the effect that only the second one has.
        without: The first fit.
        fit: The second fit.

    Returns:
        The evidence for the effect, as that of a candidate. If a prediction fails, the share is that of the training
        split, and the ends of the interval are NaN.
    """
    problem = evaluator.problem
    before, after = (
        problem.counted_samples(problem.predict(f.refit.effect_set, f.refit.base, SELECT), SELECT)
        for f in (without, fit)
    )
    excess, remaining = _excesses(without, fit)
    return Support(key, 1.0 - remaining / excess, bootstrap_cut(before, after, evaluator.seed), False)


def _without(evaluator: CandidateEvaluator, state: SelectionState, key: str) -> CandidateFit:
    """The fit without one of the accepted effects."""
    refit = state.current.refit
    remaining = refit.effect_set.without(key)
    if not remaining.keys:
        return state.base_fit
    earlier = [fit for fit in state.accepted_fits if set(fit.keys) == set(remaining.keys)]
    if earlier:
        return earlier[0]
    fit = evaluator.evaluate(evaluator.fit(remaining, refit.base, evaluator.stride(state.current.train_chi2)))
    state.accepted_fits.append(fit)
    return fit


def _excesses(*fits: CandidateFit) -> list[float]:
    """Excess mean squares over the noise on the selection split; on the training split if a prediction of it fails."""
    chi2 = [fit.select_chi2 for fit in fits]
    if not all(map(math.isfinite, chi2)):
        chi2 = [fit.train_chi2 for fit in fits]
    return [max(value - 1.0, 1e-9) for value in chi2]
