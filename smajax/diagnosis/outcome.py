"""The whole diagnosis: select effects, predict the holdout once, and classify the outcome."""

import math
from collections.abc import Callable, Mapping
from types import MappingProxyType

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
from smajax.diagnosis.next_experiment import propose_experiment
from smajax.diagnosis.nonparametric_fit import NonparametricFit, fit_nonparametric_term
from smajax.diagnosis.onset_times import onset_prediction_error
from smajax.diagnosis.plausibility import absent_effects
from smajax.diagnosis.prediction_uncertainty import expected_reduced_chi2
from smajax.diagnosis.problem import DiagnosisProblem
from smajax.diagnosis.result import Conclusion, Diagnosis, summarise
from smajax.diagnosis.selection_state import SelectionState
from smajax.diagnosis.structure import UNIFORM, Structure
from smajax.diagnosis.structured_selection import select_with_structure
from smajax.diagnosis.support import judge_effects
from smajax.errors import NumericsError
from smajax.progress import CallbackStop, stoppable
from smajax.simulation.status import SimulationStatus

# Reduced chi-squared over its expectation up to which a prediction of the selection split is as good as noise. For the
# holdout, whose inputs may have a larger range, its square. Chosen by trial.
_MAX_MISS = 1.2
# Reduced chi-squared of the training split above which an effect is missing, where ``chi2_threshold`` is smaller.
# Chosen by trial.
_MIN_MISSING = 1.1
# Largest number of alternatives from which the next experiment distinguishes each accepted effect, and of effects that
# it distinguishes where none is accepted. Chosen by trial.
_MAX_RIVALS = 2


def diagnose(
    problem: DiagnosisProblem,
    *,
    seed: int = 0,
    known_noise: Mapping[str, float] = MappingProxyType({}),
    report_progress: Callable[[str], object] = lambda text: None,
) -> Diagnosis:
    """Find the effects that a rig lacks, classify the outcome, and propose the next experiment.

    1. Select effects on the training and the selection split (``forward_selection``).
    2. Where they leave more than noise, decide whether the wire needs cells and grains, and select effects next to them
       (``structured_selection``).
    3. Keep as facts those that explain most of the excess; the others are candidates (``support``). Where more than
       noise remains on a wire of one cell and grain, reject them if they do not improve the holdout. Only then has the
       holdout a part in the choice of the effects (``Diagnosis.holdout_decided``).
    4. Refit both splits together, predict the holdout once, and classify (``classify_outcome``).
    5. Locate an unexplained residual (``localisation``), and, on a wire of one cell, find its form and propose an input
       that distinguishes equivalent effects.

    Args:
        problem: The diagnosis problem, with three splits for training, selection and holdout.
        seed: Seed of all random samples.
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
    evaluator, state, structure = select_with_structure(rig, without, stoppable(report_progress))
    if not structure.effects:
        _check_convergence(problem, state)
    may_continue = _continuation(state, report_progress)
    may_continue("predicting the holdout")
    before = _joint_refit(problem, without.base_fit.refit)
    after, verdict = _fit_and_classify(evaluator, state, structure, before)
    holdout_decided = verdict == "partial" and not structure.effects
    if holdout_decided and not improves_holdout(evaluator, before, after):
        _reject_all(state, RejectionCode.holdout)
        after, verdict = before, "unresolved"
    stage = term = experiment = None
    budget: tuple[BudgetEntry, ...] = ()
    try:
        if may_continue("computing the error budget"):
            budget = error_budget(rig, evaluator, state, structure, before, after)
        unexplained = verdict in ("unresolved", "partial")
        if unexplained and may_continue("searching for the stage that the residual comes from"):
            stage, term = _locate_residual(evaluator, state, structure)
        asks = verdict not in ("named", "nothing-missing") and not structure.effects
        if asks and may_continue("designing the next experiment"):
            experiment = propose_experiment(problem, state.current.refit, _rivals(state), seed)
    except KeyboardInterrupt:  # the effects are a result without these
        state.interrupted = True
    conclusion = Conclusion(verdict, stage, term, experiment, holdout_decided, structure, budget)
    return summarise(evaluator, state, before, after, conclusion, without=rig)


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


def classify_outcome(
    state: SelectionState,
    joint: tuple[float, ...],
    expected_chi2: tuple[float, float],
    structure: Structure = UNIFORM,
) -> str:
    """Return the verdict.

    - "nothing-missing": no effect is accepted, and all three splits are at the noise.
    - "unresolved": no effect is accepted, and a split is not at the noise.
    - "named": the accepted effects predict selection split and holdout as well as expected, or one fit to the first two
      splits is at the noise on all three. The latter is enough where the training split determines little, such as an
      onset at which nothing moves.
    - "named-up-to-class": the same, with effects that explain the recordings as well.
    - "partial": the accepted effects explain a part only.

    Args:
        state: The state at the end of the selection.
        joint: Reduced chi-squared of the fit to training and selection split on all three splits.
        expected_chi2: Reduced chi-squared by the noise and the uncertainty of the parameters: on the selection split,
            of the fit to the training split, and on the holdout, of the fit to both.
        structure: The structure of the wire, which counts as an accepted effect.
    """
    current, acceptable = state.current, state.acceptable_chi2
    select, holdout = current.select_chi2 / expected_chi2[0], joint[HOLDOUT] / expected_chi2[1]
    if not state.accepted and not structure.effects:
        limit = max(state.chi2_limit, _MIN_MISSING)
        missing = current.train_chi2 > limit or select > _MAX_MISS or holdout > _MAX_MISS**2
        return "unresolved" if missing else "nothing-missing"
    predicted = current.train_chi2 < acceptable and max(select, holdout) < _MAX_MISS**2
    if predicted or max(*joint[:HOLDOUT], holdout) < acceptable:
        return "named-up-to-class" if any(state.equivalent.get(key) for key in state.accepted) else "named"
    return "partial"


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
