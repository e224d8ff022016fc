"""Forward selection: from the residual of a fit to the effects that are missing.

One round:

1. Score every effect at the current fit (``screening``). Stop if no score is significant and the residual is noise.
2. Add each of the best candidates to the plant and refit all parameters (``successive_halving``).
3. Take the fit with the smallest sum of the reduced chi-squared of the training and the selection split.
4. Accept its effect if both splits improve by more than chance (``acceptance``).
5. List the effects that explain both splits as well as the accepted one (``equivalence``).

Where the residual still exceeds the noise, the best few fits get another effect each (a beam search), so that a better
pair can replace the first choice. Finally each accepted effect is dropped if the fit without it is as good
(``backward_elimination``). ``outcome`` predicts a third recording, once, at the end.

Source: efroymson1960 (stepwise regression), with refits of all parameters, and the prediction of a second recording in
addition to a test of the fit.
"""

import dataclasses
import math
from collections.abc import Callable, Mapping
from concurrent.futures import Future, ThreadPoolExecutor
from types import MappingProxyType

import numpy as np

from smajax.diagnosis.acceptance import MIN_CHI2_FALL, rejection
from smajax.diagnosis.backward_elimination import drop_unneeded_effects, swap_confusable_effects
from smajax.diagnosis.base_fit import BaseFit, fit_base
from smajax.diagnosis.candidate_evaluation import CandidateEvaluator, Scores
from smajax.diagnosis.candidates import Candidate, CandidateFit, EffectSet
from smajax.diagnosis.confusable_effects import refit_confusable_effects
from smajax.diagnosis.data_split import TRAIN
from smajax.diagnosis.detectability import Detectability, NominalScore, assess_detectability
from smajax.diagnosis.equivalence import is_equivalent
from smajax.diagnosis.joint_refit import refit_jointly
from smajax.diagnosis.onset_times import refine_onsets
from smajax.diagnosis.plausibility import plausible_fits, refusal
from smajax.diagnosis.problem import DiagnosisProblem
from smajax.diagnosis.ranking import rank_effects
from smajax.diagnosis.rising_convection import repeat_if_overheating
from smajax.diagnosis.selection_state import SIGNIFICANCE, SelectionState, chi2_threshold
from smajax.diagnosis.successive_halving import successive_halving
from smajax.errors import Cancelled
from smajax.numerics.ensemble import share_among_cores
from smajax.progress import CallbackStop, stoppable

# Least share of the base fit's excess over the noise that a cause explains: an effect that is near to a cause outside
# of the catalogue rarely explains more. Chosen by trial; experiments/diagnosis/hidden_effects.py prints the rates.
MIN_CAUSE_FRACTION = 0.5
# A third effect is searched for if two explain at least the first share of the excess, and the largest score is at
# least the second share of the remaining excess: less points to a cause outside of the catalogue. Chosen by trial.
MIN_EXPLAINED_FRACTION = 0.75
MIN_SCORE_GAIN = 1.0 / 3.0
# Largest number of accepted effects, a limit on the time: rigs of experiments/diagnosis hide two at most.
MAX_EFFECTS = 3
# Number of effects, those with the largest scores at the rig's nominal values, that are refitted from there as well.
# Chosen by trial.
_FROM_NOMINAL = 4
# Number of fits that get another effect, and of candidates for each of them. Chosen by trial.
_BEAM_WIDTH = 3
_CANDIDATES_PER_FIT = 4
# Number of unconverged fits that are refitted to convergence, and of fits that are refitted jointly. Chosen by trial.
_MAX_CONVERGED = 2
_MAX_JOINT = 2
# Sum of the two reduced chi-squared, over the least one, up to which a fit whose search held parameters is refitted
# with all of them free. Chosen by trial.
_NEAR_BEST = 2.0
# Number of alternatives that are stored for each accepted effect: what the next experiment can distinguish.
_MAX_ALTERNATIVES = 3
# Difference of chi-squared below which two fits count as equally good: the one with the more typical effect is
# preferred. Chosen by trial.
_SAME_CHI2 = 2.0
# Least threshold of the reduced chi-squared where rounding is coarser than the noise: the rounding error is constant
# while nothing moves, and does not average out. Chosen by trial.
_MIN_LIMIT_IF_ROUNDED = 1.5
# Reduced chi-squared of the training split below which no further effect is searched for. Chosen by trial.
_MIN_CHI2_TO_GO_ON = 1.02

# Message of ``Cancelled``.
_CANCELLED = "the diagnosis was stopped before the first effect was accepted"

Report = Callable[[str], object]


def select_effects(
    problem: DiagnosisProblem,
    *,
    seed: int = 0,
    starts: int = 2,
    min_explained_fraction: float = MIN_EXPLAINED_FRACTION,
    min_score_gain: float = MIN_SCORE_GAIN,
    known_noise: Mapping[str, float] = MappingProxyType({}),
    report_progress: Report = lambda text: None,
) -> tuple[CandidateEvaluator, SelectionState]:
    """Select the effects that the training split lacks, by their prediction of the selection split.

    Args:
        problem: The diagnosis problem.
        seed: Seed of the start points and of the null distribution.
        starts: Least number of starts of the base fit.
        min_explained_fraction: Share of the excess over the noise that two effects must explain before a third is
            searched for.
        min_score_gain: Share of the remaining excess that the score of the third must reach.
        known_noise: Known standard deviations of the noise by channel, SI; those of other channels are estimated.
        report_progress: Called with a line of text at each stage; it may raise ``StopIteration`` or
            ``KeyboardInterrupt`` to end the selection with the effects so far.

    Returns:
        The evaluator of the problem, and the state at the end of the selection.

    Raises:
        Cancelled: If the callback ended the selection before an effect was accepted.
        NumericsError: If the simulation fails at the rig's own values.
    """
    report = stoppable(report_progress)
    try:
        evaluator, state = _start_selection(problem, seed, starts, known_noise, report)
    except (CallbackStop, KeyboardInterrupt) as stop:
        raise Cancelled(_CANCELLED) from stop
    try:
        _run_rounds(evaluator, state, (min_explained_fraction, min_score_gain), report)
        drop_unneeded_effects(evaluator, state)
        swap_confusable_effects(evaluator, state)
        state.current = refine_onsets(evaluator, state.current)
    except (CallbackStop, KeyboardInterrupt) as stop:
        if not state.accepted:
            raise Cancelled(_CANCELLED) from stop
        state.interrupted = True
    return evaluator, state


def _run_rounds(
    evaluator: CandidateEvaluator, state: SelectionState, third_effect: tuple[float, float], report_progress: Report
) -> None:
    """Run rounds until no effect is accepted; ``third_effect`` is (``min_explained_fraction``, ``min_score_gain``)."""
    beam, (min_explained_fraction, min_score_gain) = [state.base_fit], third_effect
    for round_index in range(MAX_EFFECTS):
        is_third = round_index > 1
        if is_third and state.explained < min_explained_fraction:
            return
        min_gain = min_score_gain if is_third else 0.0
        beam = _run_round(evaluator, state, beam, round_index, min_gain, report_progress)
        if not beam:
            return


def _start_selection(
    problem: DiagnosisProblem, seed: int, starts: int, known_noise: Mapping[str, float], report_progress: Report
) -> tuple[CandidateEvaluator, SelectionState]:
    """Fit the rig without further effects and set the noise. Return evaluator and state before the first round."""
    base, detectability, nominal_scores = _prepare(problem, seed, starts, report_progress)
    base = repeat_if_overheating(problem, base, seed, starts)
    if base.rising_convection:
        report_progress("fitted again with convection that does not fall: the wire melted under another input")
    noise = base.noise | {c: (value, "rig file") for c, value in known_noise.items() if c in base.noise}
    if not base.converged:
        report_progress("the base fit did not converge; its residual is not reliable")
    problem.set_noise({c: value for c, (value, _) in noise.items()})
    evaluator = CandidateEvaluator(problem, seed)
    base_fit = evaluator.evaluate(evaluator.base_refit(base.point, base.status))
    limit = chi2_threshold(problem.samples)
    limit = max(limit, _MIN_LIMIT_IF_ROUNDED) if any(source == "rounding" for _, source in noise.values()) else limit
    state = SelectionState(detectability, noise, base_fit, base_fit, limit, nominal_scores, base.converged)
    state.offsets, state.rising_convection = base.offsets, base.rising_convection
    return evaluator, state


def _prepare(
    problem: DiagnosisProblem, seed: int, starts: int, report_progress: Report
) -> tuple[BaseFit, dict[str, Detectability], dict[str, NominalScore]]:
    """Run the base fit while the large programs compile, then assess what the input can show of each effect."""
    report_progress("preflight: what these inputs can show")
    with ThreadPoolExecutor(1) as pool:
        base_fit: Future[BaseFit] = pool.submit(fit_base, problem, seed, starts)
        problem.wait_for_compilation()
        if not np.all(np.isfinite(problem.predict(EffectSet(), problem.nominal, TRAIN))):
            base_fit.result()
        detectability, nominal_scores = assess_detectability(problem)
        statuses = [d.status for d in detectability.values()]
        counts = [statuses.count(status) for status in ("testable", "absorbed", "blind")]
        report_progress("preflight: {} effects are testable, {} are absorbed, {} are blind".format(*counts))
        report_progress("fitting the rig without further effects")
        return base_fit.result(), detectability, nominal_scores


def _run_round(
    evaluator: CandidateEvaluator,
    state: SelectionState,
    beam: list[CandidateFit],
    round_index: int,
    min_score_gain: float,
    report_progress: Report,
) -> list[CandidateFit]:
    """Run one round: add an effect to each fit of the beam. Return the next beam, empty if no effect was accepted."""
    problem, current = evaluator.problem, state.current
    if round_index and current.train_chi2 < max(state.chi2_limit, _MIN_CHI2_TO_GO_ON):
        return []
    scored_count = len(problem.effects) - len(problem.modelled_effects) - round_index
    report_progress(f"round {round_index + 1}: scoring {scored_count} effects")
    if round_index == 0:
        fits = _fit_first_effects(evaluator, state, report_progress)
    else:
        fits = _fit_further_effects(evaluator, beam, round_index, min_score_gain, report_progress)
    fits = plausible_fits(evaluator.problem, state, _converge_worse_fits(evaluator, fits, current))
    if not fits:
        return []
    best, fits = _refine_best(evaluator, fits, state)
    if round_index == 0:
        for fit in fits:
            summary = state.ranking[fit.key]
            state.ranking[fit.key] = dataclasses.replace(summary, refit_rmse_select=fit.rmse_select)
    if reason := rejection(current, best, problem.samples) or refusal(problem, current, best):
        state.rejected.append(reason)
        return []
    before, after = math.sqrt(state.base_fit.select_chi2), math.sqrt(best.select_chi2)
    report_progress(f"with {' and '.join(best.keys)}: error over noise {before:.3g} -> {after:.3g}, selected")
    return accept(state, best, fits, problem.samples)


def _fit_first_effects(
    evaluator: CandidateEvaluator, state: SelectionState, report_progress: Report
) -> list[CandidateFit]:
    """Score all effects at the base fit and refit with one effect each; empty if nothing is missing."""
    base = state.current.refit
    scores = evaluator.scores(base)
    state.stage_shares = evaluator.stage_shares(base, scores)
    state.ranking = rank_effects(evaluator, scores, base)
    if scores.p_value > SIGNIFICANCE and state.current.train_chi2 < state.chi2_limit:
        return []
    return _fit_single_effects(evaluator, state, scores, report_progress)


def _fit_single_effects(
    evaluator: CandidateEvaluator, state: SelectionState, scores: Scores, report_progress: Report
) -> list[CandidateFit]:
    """Refit with every detectable effect: at a biased fit even the score of the cause may be 0."""
    problem, refit = evaluator.problem, state.current.refit
    keys = [key for key, s in scores.best.items() if math.isfinite(s.minimum_detectable_strength)]
    nominal = state.nominal_scores
    from_nominal = sorted((k for k in keys if nominal[k].gain > 0.0), key=lambda k: -nominal[k].gain)[:_FROM_NOMINAL]
    report_progress(f"round 1: refitting {len(keys)} effects")
    fits = successive_halving(
        evaluator,
        [Candidate(refit, k, scores.best[k].strength, scores.shapes[k], scores.best[k].gain) for k in keys],
        [Candidate(refit, k, nominal[k].strength, nominal[k].shape) for k in from_nominal],
    )
    best = min(fits, key=lambda fit: fit.total_chi2, default=None)
    if best is not None and (best.at_noise or _explains_enough(state, best)):
        return fits
    # The score of a large effect may be 0 at the fit and at the rig's own values: start each at its typical strength.
    report_progress("round 1: refitting them from the rig's own values")
    typical = [
        Candidate(refit, key, sign, shape)
        for key in keys
        for shape in problem.shape_grid(key)
        for sign in (-1.0, 1.0)
        if problem.plausible_range(key)[0] < sign < problem.plausible_range(key)[1]
    ]
    return [*fits, *successive_halving(evaluator, (), typical)]


def _explains_enough(state: SelectionState, fit: CandidateFit) -> bool:
    """Whether a fit explains so much of a reliable base residual that no other start is needed."""
    explained = min(state.explained_by(fit), state.explained_in_training_by(fit))
    return state.base_fit_converged and explained > MIN_CAUSE_FRACTION


def _fit_further_effects(
    evaluator: CandidateEvaluator,
    beam: list[CandidateFit],
    round_index: int,
    min_score_gain: float,
    report_progress: Report,
) -> list[CandidateFit]:
    """Refit each fit of the beam with one more effect.

    Empty if no score at the first fit reaches the share ``min_score_gain`` of its excess.
    """
    candidates: list[Candidate] = []
    queued: set[frozenset[str]] = set()
    for fit in beam:
        scores = evaluator.scores(fit.refit)
        excess = (fit.train_chi2 - 1.0) * evaluator.problem.samples
        largest = max((score.gain for score in scores.best.values()), default=0.0)
        if fit is beam[0] and largest < min_score_gain * excess:
            return []
        for key, score in sorted(scores.best.items(), key=lambda item: -item[1].gain)[:_CANDIDATES_PER_FIT]:
            keys = frozenset((*fit.keys, key))
            if score.gain > 0.0 and keys not in queued:
                queued.add(keys)
                candidates.append(Candidate(fit.refit, key, score.strength, scores.shapes[key], score.gain))
    report_progress(f"round {round_index + 1}: refitting {len(candidates)} sets of effects")
    return successive_halving(evaluator, candidates)


def _converge_worse_fits(
    evaluator: CandidateEvaluator, fits: list[CandidateFit], current: CandidateFit
) -> list[CandidateFit]:
    """The fits that improve the training split over ``current``, and the best of the others after convergence.

    ``current`` is nested in each fit, so a fit that is worse on the training split only stopped early or had its
    parameters held.
    """
    better = [fit for fit in fits if fit.train_chi2 < current.train_chi2]
    least = min((fit.total_chi2 for fit in better), default=math.inf)
    worse = [fit for fit in fits if fit.train_chi2 >= current.train_chi2 and fit.total_chi2 < least]
    worse = sorted(worse, key=lambda fit: fit.total_chi2)[:_MAX_CONVERGED]
    return [*better, *share_among_cores(evaluator.refit_to_convergence, worse)]


def _refine_best(
    evaluator: CandidateEvaluator, fits: list[CandidateFit], state: SelectionState
) -> tuple[CandidateFit, list[CandidateFit]]:
    """The best fit, converged and compared with confusable effects, and all fits, one for each set of effects."""
    samples = evaluator.problem.samples
    best = evaluator.refit_to_convergence(min(fits, key=lambda fit: fit.total_chi2))
    by_effects: dict[frozenset[str], CandidateFit] = {}
    confusable = plausible_fits(evaluator.problem, state, refit_confusable_effects(evaluator, best))
    all_fits = [best, *fits, *confusable]
    for fit in sorted(all_fits, key=lambda fit: fit.total_chi2):
        by_effects.setdefault(frozenset(fit.keys), fit)
    fits = list(by_effects.values())
    # A search with the same effects as ``best`` would converge to the same point again.
    fall = MIN_CHI2_FALL * max(1.0, best.train_chi2) / samples
    if set(fits[0].keys) != set(best.keys) and fits[0].total_chi2 < best.total_chi2 - fall:
        best = evaluator.refit_to_convergence(fits[0])
    fits = _refit_open_fits_jointly(evaluator, _free_held_parameters(evaluator, best, fits), state.acceptable_chi2)
    best = min([best, *fits], key=lambda fit: fit.total_chi2)
    other_keys = set(best.keys) - {best.key}
    equally_good = [
        fit
        for fit in fits
        if fit.key not in other_keys
        and set(fit.keys) - {fit.key} == other_keys
        and (fit.total_chi2 - best.total_chi2) * samples < _SAME_CHI2
    ]
    best = min([best, *equally_good], key=evaluator.log_distance_from_typical)
    return evaluator.with_all_parameters_free(best), fits


def _free_held_parameters(
    evaluator: CandidateEvaluator, best: CandidateFit, fits: list[CandidateFit]
) -> list[CandidateFit]:
    """The fits, with those near the best whose search held parameters refitted with all of them.

    Nothing is refitted if the best fit is at the noise: the parameters that were held cannot make another one better.
    """
    near = [] if best.at_noise else [fit for fit in fits if fit.total_chi2 < _NEAR_BEST * best.total_chi2]
    incomplete = [fit for fit in near if evaluator.problem.holds_parameters(fit.refit)][:_MAX_CONVERGED]
    replacements = {id(fit): evaluator.with_all_parameters_free(fit) for fit in incomplete}
    return [replacements.get(id(fit), fit) for fit in fits]


def _refit_open_fits_jointly(
    evaluator: CandidateEvaluator, fits: list[CandidateFit], acceptable_chi2: float
) -> list[CandidateFit]:
    """The fits, with those at the noise of the training split replaced by joint refits that are at the noise of both.

    The training split hardly determines an onset at which nothing moves. Without the joint refit, the cause would be
    rejected for its prediction of the selection split.
    """
    if any(fit.at_noise for fit in fits):
        return fits
    explaining = (fit for fit in fits if fit.train_chi2 < acceptable_chi2)
    open_fits = sorted(explaining, key=lambda fit: fit.train_chi2)[:_MAX_JOINT]

    def refit(fit: CandidateFit) -> CandidateFit:
        return evaluator.evaluate(refit_jointly(evaluator.problem, fit.refit))

    pairs = zip(open_fits, share_among_cores(refit, open_fits), strict=True)
    joint = {id(fit): refitted for fit, refitted in pairs if refitted.at_noise}
    return [joint.get(id(fit), fit) for fit in fits]


def accept(state: SelectionState, best: CandidateFit, fits: list[CandidateFit], samples: int) -> list[CandidateFit]:
    """Store a fit as accepted, with alternatives and equivalents of its effects.

    Args:
        state: The state of the selection, which is changed.
        best: The fit.
        fits: All fits of its round.
        samples: Number of scored samples of the training split.

    Returns:
        The best fits of the round, which get another effect each in the next one.
    """
    state.current = best
    state.accepted_fits.append(best)
    other_fits = sorted((fit for fit in fits if set(fit.keys) != set(best.keys)), key=lambda fit: fit.total_chi2)
    for key in best.keys:
        swapped = [fit for fit in other_fits if set(best.keys) - {key} <= set(fit.keys) and key not in fit.keys]
        if key == best.key or swapped:
            state.alternatives[key] = swapped[:_MAX_ALTERNATIVES]
            equivalent = (fit for fit in swapped if is_equivalent(fit, best, samples))
            state.equivalent[key] = tuple((set(fit.keys) - set(best.keys)).pop() for fit in equivalent)
    return [best, *other_fits[: _BEAM_WIDTH - 1]]
