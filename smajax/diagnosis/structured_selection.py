"""Selection of effects on a wire of cells and grains, after the selection without them.

Where the effects that were selected on a wire of one cell and one grain leave more than noise, the wire may lack cells
and grains. They are fitted together with those of these effects that are facts. Where that improves the fit, the facts
stay. Where there are none, or one of them is an approximation of cells or grains, every effect is scored next to the
structure; those of the largest scores and the best ones of the first round are fitted, and then pairs of effects.
"""

import functools
from collections.abc import Callable

import numpy as np

from smajax.diagnosis.acceptance import rejection
from smajax.diagnosis.backward_elimination import drop_unneeded_effects
from smajax.diagnosis.candidate_evaluation import CandidateEvaluator
from smajax.diagnosis.candidates import Candidate, CandidateFit, EffectSet
from smajax.diagnosis.forward_selection import accept
from smajax.diagnosis.plausibility import plausible_fits, refusal
from smajax.diagnosis.problem import DiagnosisProblem
from smajax.diagnosis.selection_state import SelectionState
from smajax.diagnosis.structure import (
    UNIFORM,
    Structure,
    are_settled,
    candidate_keys,
    fit_from,
    fit_with_structure,
    may_have_structure,
    refit,
    structured_problem,
)
from smajax.diagnosis.structure_choice import compare_variants, halves_excess, is_clear_improvement
from smajax.diagnosis.successive_halving import SHORT_SCHEDULE, successive_halving
from smajax.diagnosis.support import judge_effects
from smajax.progress import CallbackStop

# Number of effects, those of the largest scores at the fit with the structure alone, that are added to it. Chosen by
# trial.
_BEST_NEXT_TO_STRUCTURE = 4
# Number of fits with one effect that get a second one next to the structure, and of effects that each of them gets.
# Chosen by trial.
_PARENTS = 3
_SECOND_EFFECTS = 2

Selected = tuple[CandidateEvaluator, SelectionState, Structure]


def select_with_structure(
    evaluator: CandidateEvaluator,
    state: SelectionState,
    report_progress: Callable[[str], object],
    *,
    may_ask: bool = True,
) -> Selected:
    """Decide whether the wire needs cells and grains, and select effects next to them.

    Args:
        evaluator: The evaluator of the rig without structure.
        state: The state at the end of its forward selection.
        report_progress: Called with a line of text at each stage; it may raise ``StopIteration`` or
            ``KeyboardInterrupt``: the result is then that without structure.
        may_ask: Whether the structure is an open question; otherwise the effects are judged without one.

    Returns:
        The evaluator and the state of the structure that was found, and the structure; ``evaluator`` and ``state``
        themselves where the wire needs neither. The evidence for the effects is in the state.
    """
    asks = may_ask and may_have_structure(evaluator.problem, state)
    judge_effects(evaluator, state)
    if not asks:
        return evaluator, state, UNIFORM
    try:
        return _select(evaluator, state, report_progress)
    except (CallbackStop, KeyboardInterrupt):
        state.interrupted = True
        return evaluator, state, UNIFORM


def _select(evaluator: CandidateEvaluator, state: SelectionState, report_progress: Callable[[str], object]) -> Selected:
    report_progress("fitting cells along the wire and grains in them")
    problem = structured_problem(evaluator.problem, state)
    structured = CandidateEvaluator(problem, evaluator.seed)
    first = problem.fit(EffectSet(), problem.nominal, max_steps=1)
    structured.base_refit(first.base, first.status)
    facts = _allowed_effects(problem, state.current.refit.effect_set)
    # On one cell and one grain, effects may absorb what the structure explains: it is fitted without them, too.
    base = fit_with_structure(structured, EffectSet(), state.current)
    fits = [base, *([fit_with_structure(structured, facts, state.current)] if facts.keys else [])]
    if not are_settled(state):
        near, far = _candidates(structured, fits[-1], state)
        report_progress(f"fitting {len(near)} effects next to cells and grains")
        fits += successive_halving(structured, near, far, SHORT_SCHEDULE)
    evaluator.problem.count_simulations(problem.simulations)
    # Without facts, cells and grains may absorb an effect that was not found: then the selection split alone decides.
    jointly = bool(facts.keys)
    improves = functools.partial(is_clear_improvement, evaluator, state, structured)
    if not any((jointly and halves_excess(state, f)) or improves(f) for f in fits):
        return evaluator, state, UNIFORM
    inner = SelectionState(
        state.detectability, state.noise, base, base, state.chi2_limit, state.nominal_scores, state.base_fit_converged
    )
    inner.stage_shares, inner.ranking = state.stage_shares, state.ranking
    beam = _add_effects(structured, inner, [f for f in fits if f.keys])
    if len(inner.accepted) == 1 and not facts.keys:
        report_progress("fitting a second effect next to cells and grains")
        pairs = _second_candidates(structured, beam)
        _add_effects(structured, inner, successive_halving(structured, pairs, schedule=SHORT_SCHEDULE))
    judge_effects(structured, inner)
    if not improves(inner.current, jointly=jointly):
        return evaluator, state, UNIFORM
    report_progress("comparing cells alone, grains alone, both, and neither")
    structure, chosen, fit = compare_variants(evaluator, state, structured, inner.current, jointly=jointly)
    if structure.variant == "neither":
        return evaluator, state, structure
    inner.accepted_fits = []  # fits of another variant
    inner.base_fit = refit(chosen, base, EffectSet()) if fit.keys else fit
    inner.current = fit
    return chosen, inner, structure


def _allowed_effects(problem: DiagnosisProblem, effect_set: EffectSet) -> EffectSet:
    """Effects without those that are approximations of cells and grains, which the problem does not have."""
    for key in effect_set.keys:
        effect_set = effect_set if key in problem.effects else effect_set.without(key)
    return effect_set


def _add_effects(evaluator: CandidateEvaluator, state: SelectionState, fits: list[CandidateFit]) -> list[CandidateFit]:
    """Add the effects of the best fit next to the structure. Return the best fits, none if no effect was added."""
    problem, current = evaluator.problem, state.current
    if current.at_noise:
        return []
    fits = plausible_fits(problem, state, [fit for fit in fits if fit.train_chi2 < current.train_chi2])
    best = min(fits, key=lambda fit: fit.total_chi2, default=None)
    if best is None:
        return []
    # The search may have stayed near a fit that lacks the effect: the rig's own values are a second start.
    starts = (np.clip(best.refit.base, *problem.bounds), problem.nominal)
    best = fit_from(evaluator, best.refit.effect_set, starts, best.train_chi2)
    if reason := rejection(current, best, problem.samples) or refusal(problem, current, best):
        state.rejected.append(reason)
        return []
    beam = accept(state, best, fits, problem.samples)
    drop_unneeded_effects(evaluator, state)
    return beam


def _second_candidates(evaluator: CandidateEvaluator, beam: list[CandidateFit]) -> list[Candidate]:
    """The effects of the largest scores at the best fits with one effect, each pair of effects once."""
    candidates: dict[frozenset[str], Candidate] = {}
    for fit in beam[:_PARENTS]:
        scores = evaluator.scores(fit.refit)
        largest = sorted((s.gain, key) for key, s in scores.best.items() if s.gain > 0.0)[-_SECOND_EFFECTS:]
        for gain, key in reversed(largest):
            candidate = Candidate(fit.refit, key, scores.best[key].strength, scores.shapes[key], gain)
            candidates.setdefault(frozenset((*fit.keys, key)), candidate)
    return list(candidates.values())


def _candidates(
    evaluator: CandidateEvaluator, fit: CandidateFit, state: SelectionState
) -> tuple[list[Candidate], list[Candidate]]:
    """Effects of the largest scores and the best of the first round, from the point of a fit and the rig's values."""
    scores, nominal = evaluator.scores(fit.refit), state.nominal_scores
    largest = sorted((key for key in scores.best if scores.best[key].gain > 0.0), key=lambda k: -scores.best[k].gain)
    keys = [k for k in dict.fromkeys((*largest[:_BEST_NEXT_TO_STRUCTURE], *candidate_keys(state))) if k in scores.best]
    near = [Candidate(fit.refit, k, (s := scores.best[k]).strength, scores.shapes[k], s.gain) for k in keys]
    far = [Candidate(fit.refit, k, nominal[k].strength, nominal[k].shape) for k in keys]
    return near, far
