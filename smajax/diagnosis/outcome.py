"""The whole diagnosis: select effects, predict the holdout once, and classify the outcome."""

import dataclasses
import math
from collections.abc import Callable, Mapping
from types import MappingProxyType
from typing import NamedTuple

import jax.numpy as jnp

from smajax.diagnosis.acceptance import Rejection, RejectionCode
from smajax.diagnosis.bootstrap import bootstrap_cut
from smajax.diagnosis.candidate_evaluation import CandidateEvaluator
from smajax.diagnosis.candidates import EffectSet, Refit
from smajax.diagnosis.data_split import HOLDOUT, SELECT, TRAIN
from smajax.diagnosis.error_budget import BudgetEntry, error_budget, first_half
from smajax.diagnosis.forward_selection import select_effects
from smajax.diagnosis.joint_refit import refit_jointly
from smajax.diagnosis.localisation import most_likely_stage
from smajax.diagnosis.next_experiment import NextExperiment, propose_experiment
from smajax.diagnosis.nonparametric_fit import NonparametricFit, fit_nonparametric_term
from smajax.diagnosis.onset_times import onset_prediction_error
from smajax.diagnosis.other_laws import LawComparison, OtherLaws
from smajax.diagnosis.plausibility import absent_effects
from smajax.diagnosis.prediction_uncertainty import expected_reduced_chi2
from smajax.diagnosis.problem import DiagnosisProblem
from smajax.diagnosis.result import Conclusion, Diagnosis, summarise
from smajax.diagnosis.selection_state import SelectionState
from smajax.diagnosis.structure import ASK_FROM, UNIFORM, Structure, leaves_more_than_noise
from smajax.diagnosis.structured_selection import select_with_structure
from smajax.diagnosis.support import judge_effects
from smajax.diagnosis.verdict import classify_outcome
from smajax.errors import NumericsError
from smajax.progress import CallbackStop, stoppable
from smajax.simulation.status import SimulationStatus

# Largest number of alternatives from which the next experiment distinguishes each accepted effect, and of effects that
# it distinguishes where none is accepted. Chosen by trial.
_MAX_RIVALS = 2
# Verdicts that leave more than noise.
_UNEXPLAINED = ("unresolved", "partial")


def diagnose(
    problem: DiagnosisProblem,
    *,
    seed: int = 0,
    laws: bool = False,
    known_noise: Mapping[str, float] = MappingProxyType({}),
    report_progress: Callable[[str], object] = lambda text: None,
) -> Diagnosis:
    """Find the effects that a rig lacks, classify the outcome, and propose the next experiment.

    1. Select effects on the training and the selection split (``forward_selection``).
    2. Where they leave more than noise, or if ``laws``, fit other material laws (``other_laws``), and decide whether
       the wire needs cells and grains, next to which effects are selected again (``structured_selection``).
    3. Keep as facts those that explain most of the excess; the others are candidates (``support``). Where more than
       noise remains on a wire of one cell and grain, reject them if they do not improve the holdout. Only then has the
       holdout a part in the choice of the effects (``Diagnosis.holdout_decided``).
    4. Refit both splits together, predict the holdout once, and classify (``verdict``).
    5. If another law explains most of the excess, and more than effects and structure do, these become candidates.
    6. Locate an unexplained residual (``localisation``), and, on a wire of one cell, find its form and propose an input
       that distinguishes equivalent effects.

    Args:
        problem: The diagnosis problem, with three splits for training, selection and holdout.
        seed: Seed of all random samples.
        laws: Whether to compare other material laws although effects explain the residual.
        known_noise: Known standard deviations of the noise by channel, SI; those of other channels are estimated.
        report_progress: Called with a line of text at each stage. It may raise ``StopIteration`` or
            ``KeyboardInterrupt``: the diagnosis then ends with the effects that are accepted so far, without a search
            for the stage of the residual or the next experiment, as after Ctrl-C.

    Raises:
        Cancelled: If the diagnosis was stopped before the first effect was accepted.
        KeyboardInterrupt: If Ctrl-C ended the last refits, without which there is no prediction of the holdout.
        NumericsError: If the simulation fails at the rig's own values, or if the base fit neither converged nor is at
            the noise, and no effect is accepted; its ``state`` then holds the parameters of the base fit.
    """
    rig, without = select_effects(problem, seed=seed, known_noise=known_noise, report_progress=report_progress)
    others, law = OtherLaws(rig, without.base_fit), None
    if not problem.own_count and (laws or leaves_more_than_noise(without)):
        law = _compared_laws(others, rig, without, report_progress)
    explained = law is not None and law.cause == "law" and law.best_error**2 < ASK_FROM
    evaluator, state, structure = select_with_structure(rig, without, stoppable(report_progress), may_ask=not explained)
    if not structure.effects and not explained:
        _check_convergence(problem, state)
    may_continue = _continuation(state, report_progress)
    may_continue("predicting the holdout")
    before = _joint_refit(problem, without.base_fit.refit)
    after, verdict = _fit_and_classify(evaluator, state, structure, before)
    holdout_decided = verdict == "partial" and not structure.effects
    if holdout_decided and not improves_holdout(evaluator, before, after):
        _reject_all(state, RejectionCode.holdout)
        after, verdict = before, "unresolved"
    found = _Found(evaluator, state, structure, after, verdict, holdout_decided)
    if law is not None:
        law = others.compare(evaluator, state.current)
    return _concluded(rig, without, found, law, before, may_continue)


def _concluded(
    rig: CandidateEvaluator,
    without: SelectionState,
    found: "_Found",
    law: LawComparison | None,
    before: Refit,
    may_continue: Callable[[str], bool],
) -> Diagnosis:
    """The result: what was found, or nothing where another law explains more; and what explains the rest."""
    explanation = _Explanation()
    if law is not None and law.cause == "law":
        found, explanation.stage = _without_effects(rig, without, found, law, before), "material"
    try:
        _explain(explanation, rig, found, before, may_continue)
    except KeyboardInterrupt:  # the effects are a result without these
        found.state.interrupted = True
    conclusion = _conclusion(found, explanation, law)
    # Of the rig as it is, without a structure of the wire.
    found.state.offsets = without.offsets
    found.state.rising_convection = without.rising_convection
    return summarise(found.evaluator, found.state, before, found.after, conclusion, without=rig)


def _compared_laws(
    others: OtherLaws, rig: CandidateEvaluator, state: SelectionState, report_progress: Callable[[str], object]
) -> LawComparison | None:
    """The comparison of the laws; ``None`` if the diagnosis was or is stopped."""
    if not _continuation(state, report_progress)("fitting other material laws"):
        return None
    try:
        return others.compare(rig, state.current)
    except KeyboardInterrupt:  # the effects are a result without it
        state.interrupted = True
        return None


class _Found(NamedTuple):
    """What was found: the evaluator and the state of the structure, the last fit, and the verdict."""

    evaluator: CandidateEvaluator
    state: SelectionState
    structure: Structure
    after: Refit
    verdict: str
    holdout_decided: bool


@dataclasses.dataclass
class _Explanation:
    """Error budget, stage and form of an unexplained residual, and the next experiment."""

    budget: tuple[BudgetEntry, ...] = ()
    stage: str | None = None
    term: NonparametricFit | None = None
    experiment: NextExperiment | None = None


def _explain(
    explanation: _Explanation,
    rig: CandidateEvaluator,
    found: _Found,
    before: Refit,
    may_continue: Callable[[str], bool],
) -> None:
    """Compute the parts of an explanation one after the other, until the diagnosis is stopped."""
    evaluator, state, structure, law_is_wrong = *found[:3], explanation.stage is not None
    if may_continue("computing the error budget"):
        explanation.budget = error_budget(rig, evaluator, state, structure, before, found.after)
    if law_is_wrong or found.verdict == "nothing-missing":
        return
    if found.verdict in _UNEXPLAINED and may_continue("searching for the stage that the residual comes from"):
        explanation.stage, explanation.term = _locate_residual(evaluator, state, structure)
    if found.verdict != "named" and not structure.effects and may_continue("designing the next experiment"):
        rivals = _rivals(state)
        explanation.experiment = propose_experiment(evaluator.problem, state.current.refit, rivals, evaluator.seed)


def _conclusion(found: _Found, explanation: _Explanation, law: LawComparison | None) -> Conclusion:
    return Conclusion(
        found.verdict,
        explanation.stage,
        explanation.term,
        explanation.experiment,
        found.holdout_decided,
        found.structure,
        explanation.budget,
        law,
    )


def _fit_and_classify(
    evaluator: CandidateEvaluator, state: SelectionState, structure: Structure, before: Refit
) -> tuple[Refit, str]:
    """The last refit and the verdict; effects are dropped that are absent or no facts after the joint refit."""
    problem = evaluator.problem
    after = _last_refit(problem, state, structure, before)
    while absent := absent_effects(problem, after):
        _drop_absent(evaluator, state, absent[-1])
        after = _last_refit(problem, state, structure, before)
    verdict, facts = _verdict(evaluator, state, after, structure), state.accepted
    if verdict == "partial":
        judge_effects(evaluator, state, final=True)
    if state.accepted == facts:
        return after, verdict
    after = _last_refit(problem, state, structure, before)
    return after, _verdict(evaluator, state, after, structure)


def _continuation(state: SelectionState, report_progress: Callable[[str], object]) -> Callable[[str], bool]:
    """A function that reports progress and returns whether the diagnosis goes on."""
    report = stoppable(report_progress)

    def may_continue(text: str) -> bool:
        if not state.interrupted:
            try:
                report(text)
            except CallbackStop:
                state.interrupted = True
        return not state.interrupted

    return may_continue


def first_predicting_refit(problem: DiagnosisProblem, *refits: Refit) -> Refit:
    """Return the first refit whose predictions of selection and holdout split are finite; if none is, the last one.

    The simulation of a bad fit may diverge under another input.

    Args:
        problem: The diagnosis problem.
        *refits: The refits, the preferred one first.
    """
    for refit in refits:
        predictions = ((k, problem.predict(refit.effect_set, refit.base, k)) for k in (SELECT, HOLDOUT))
        if all(math.isfinite(problem.reduced_chi2(residual, k)) for k, residual in predictions):
            return refit
    return refits[-1]


def improves_holdout(evaluator: CandidateEvaluator, before: Refit, after: Refit) -> bool:
    """Return whether the RMSE of the holdout falls significantly in any channel, or only the effects predict it at all.

    The first half of its samples decides, so that the second one can be used for intervals (``error_budget``).

    Args:
        evaluator: The evaluator, whose seed the bootstrap uses.
        before: The fit without effects.
        after: The fit with the accepted effects.
    """
    problem = evaluator.problem
    residuals, statuses = zip(*(problem.report(refit, HOLDOUT) for refit in (before, after)), strict=True)
    if statuses[1] is not SimulationStatus.done:
        return False
    series = [problem.series(residual, HOLDOUT) for residual in residuals]
    without, with_effects = ({c: first_half(v) for c, v in by_channel.items()} for by_channel in series)
    return any(not bootstrap_cut(without[c], with_effects[c], evaluator.seed)[0] <= 0.0 for c in problem.channels)


def _check_convergence(problem: DiagnosisProblem, state: SelectionState) -> None:
    """Raise ``NumericsError`` if the base fit is not reliable and no effect is accepted."""
    if state.base_fit_converged or state.accepted or state.base_fit.train_chi2 < state.acceptable_chi2:
        return
    values, _ = problem.problems[TRAIN].values(jnp.asarray(state.base_fit.refit.base))
    raise NumericsError(
        "the base fit did not converge, so its residual is not reliable: widen fit.bounds",
        {name: float(v) for name, v in values.items()},
    )


def _joint_refit(problem: DiagnosisProblem, base: Refit) -> Refit:
    """The fit without effects by which the holdout is predicted."""
    nominal = Refit(EffectSet(), problem.nominal, *problem.evaluate(EffectSet(), problem.nominal, TRAIN), base.status)
    return first_predicting_refit(problem, refit_jointly(problem, base), base, nominal)


def _last_refit(problem: DiagnosisProblem, state: SelectionState, structure: Structure, before: Refit) -> Refit:
    """The fit with the structure and the accepted effects by which the holdout is predicted."""
    current = state.current.refit
    if not state.accepted and not structure.effects:
        return before
    return first_predicting_refit(problem, refit_jointly(problem, current), current)


def _verdict(evaluator: CandidateEvaluator, state: SelectionState, after: Refit, structure: Structure) -> str:
    """The verdict; the uncertainty of onset times is evaluated only where it would otherwise be "partial"."""
    problem, current = evaluator.problem, state.current
    splits = range(len(problem.splits))
    joint = tuple(problem.reduced_chi2(problem.predict(after.effect_set, after.base, k), k) for k in splits)
    fitted = (TRAIN,) if problem.own_count else (TRAIN, SELECT)
    # Where nothing is accepted and no effect is significant, the whole residual counts as noise.
    autocorrelated = not state.accepted and state.base_residual_may_be_noise
    expected_chi2 = (
        expected_reduced_chi2(evaluator, current.refit, SELECT, autocorrelated=autocorrelated),
        expected_reduced_chi2(evaluator, after, HOLDOUT, fitted, autocorrelated=autocorrelated),
    )
    verdict = classify_outcome(state, joint, expected_chi2, structure)
    if verdict == "partial" and min(current.train_chi2, max(joint[:HOLDOUT])) < state.acceptable_chi2:
        # An onset time may be more uncertain than its derivative says.
        onset_errors = (
            onset_prediction_error(problem, current.refit, SELECT),
            onset_prediction_error(problem, after, HOLDOUT, fitted),
        )
        return classify_outcome(
            state, joint, (expected_chi2[0] + onset_errors[0], expected_chi2[1] + onset_errors[1]), structure
        )
    return verdict


def _reject_all(state: SelectionState, code: RejectionCode, share: float | None = None) -> None:
    state.rejected += [Rejection(key, code, share) for key in state.accepted]
    state.equivalent, state.current = {}, state.base_fit


def _without_effects(
    rig: CandidateEvaluator, without: SelectionState, found: _Found, law: LawComparison, before: Refit
) -> _Found:
    """What was found where another law explains more: no effects and no structure; the effects are candidates."""
    rejected = [Rejection(key, RejectionCode.law, others=(law.better or "",)) for key in found.state.accepted]
    state = dataclasses.replace(
        without,
        current=without.base_fit,
        equivalent={},
        rejected=[*found.state.rejected, *rejected],
        interrupted=found.state.interrupted,
        supports=tuple(support._replace(is_fact=False) for support in found.state.supports),
    )
    return _Found(rig, state, UNIFORM, before, "unresolved", False)


def _drop_absent(evaluator: CandidateEvaluator, state: SelectionState, key: str) -> None:
    """Reject an accepted effect whose strength is 0 in the fit to training and selection split."""
    state.rejected.append(Rejection(key, RejectionCode.zero))
    state.equivalent.pop(key, None)
    remaining = state.current.refit.effect_set.without(key)
    stride = evaluator.stride(state.current.train_chi2)
    refit = evaluator.fit(remaining, state.current.refit.base, stride) if remaining.keys else None
    state.current = state.base_fit if refit is None else evaluator.evaluate(refit)


def _locate_residual(
    evaluator: CandidateEvaluator, state: SelectionState, structure: Structure
) -> tuple[str | None, NonparametricFit | None]:
    """The stage that the unexplained residual comes from, and its form.

    If the accepted effects explain the training split, only another input shows the residual: then it is the stage of
    the last accepted effect, a surrogate of the cause.
    """
    refit = state.current.refit
    if state.accepted and state.current.train_chi2 < state.acceptable_chi2:
        return evaluator.problem.effects[state.current.key].stage, None
    scores = evaluator.scores(refit)
    shares = evaluator.stage_shares(refit, scores) if state.accepted or structure.effects else state.stage_shares
    stage = most_likely_stage(shares)
    if stage is None:
        return None, None
    if structure.effects:  # each derivative takes too long for a term of several nodes
        return stage, None
    stride = evaluator.stride(state.current.train_chi2)
    return stage, fit_nonparametric_term(evaluator.problem, refit, scores.basis, scores.residual, stage, stride)


def _rivals(state: SelectionState) -> dict[str, dict[str, float]]:
    """Effects to distinguish, with their values: accepted ones and their alternatives, or the two largest gains."""
    rivals: dict[str, dict[str, float]] = {}
    for key in state.accepted:
        equivalent = state.equivalent.get(key, ())
        if equivalent or state.current.train_chi2 > state.chi2_limit:
            fits = [f for f in state.alternatives.get(key, ()) if f.key in equivalent or not equivalent][:_MAX_RIVALS]
            rivals |= {fit.key: fit.refit.values_of(fit.key) for fit in fits}
            rivals[key] = state.current.refit.values_of(key)
    if not rivals:
        scored = sorted((r for r in state.ranking.values() if r.gain), key=lambda r: -(r.gain or 0.0))[:_MAX_RIVALS]
        keys = [(r.detectability.key, r.strength) for r in scored]
        rivals = {key: {f"effects.{key}.strength": strength or 0.0} for key, strength in keys}
    return rivals
