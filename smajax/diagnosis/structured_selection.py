"""Selection of effects on a wire of cells and grains, after the selection without them.

Where the effects that were selected on a wire of one cell and one grain leave more than noise, the wire may lack cells
and grains. They are fitted with and without these effects. Where either fit improves, effects are selected again next
to the structure, among the best of the first round.
"""

from collections.abc import Callable, Sequence

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
    clearly_better,
    compare_variants,
    fit_with_structure,
    may_have_structure,
    refit,
    structured_problem,
)
from smajax.diagnosis.successive_halving import successive_halving
from smajax.diagnosis.support import explains_enough, judge_effects
from smajax.progress import CallbackStop

# Largest number of effects next to a structure: rigs of experiments/diagnosis/rough_rigs.py hide two at most.
_MAX_EFFECTS = 2

Selected = tuple[CandidateEvaluator, SelectionState, Structure]


def select_with_structure(
    evaluator: CandidateEvaluator, state: SelectionState, report_progress: Callable[[str], object]
) -> Selected:
    """Decide whether the wire needs cells and grains, and select effects next to them.

    Args:
        evaluator: The evaluator of the rig without structure.
        state: The state at the end of its forward selection.
        report_progress: Called with a line of text at each stage; it may raise ``StopIteration`` or
            ``KeyboardInterrupt``: the result is then that without structure.

    Returns:
        The evaluator and the state of the structure that was found, and the structure; ``evaluator`` and ``state``
        themselves where the wire needs neither. The evidence for the effects is in the state.
    """
    asks, selected = may_have_structure(evaluator.problem, state), state.current
    judge_effects(evaluator, state)
    if not asks:
        return evaluator, state, UNIFORM
    try:
        return _select(evaluator, state, selected, report_progress)
    except (CallbackStop, KeyboardInterrupt):
        state.interrupted = True
        return evaluator, state, UNIFORM


def _select(
    evaluator: CandidateEvaluator,
    state: SelectionState,
    selected: CandidateFit,
    report_progress: Callable[[str], object],
) -> Selected:
    """Decide; ``selected`` is the fit with facts and candidates, ``state`` has facts only."""
    report_progress("fitting cells along the wire and grains in them")
    problem = structured_problem(evaluator.problem, state)
    structured = CandidateEvaluator(problem, evaluator.seed)
    first = problem.fit(EffectSet(), problem.nominal, max_steps=1)
    structured.base_refit(first.base, first.status)
    base = fit_with_structure(structured, EffectSet(), state.base_fit)
    fits = _fits_with_effects(problem, [*state.accepted_fits[:1], selected])
    transferred = [fit_with_structure(structured, effect_set, fit) for fit, effect_set in fits]
    pairs = [(state.base_fit, base), *zip((fit for fit, _ in fits), transferred, strict=True)]
    improved = any(_improves(evaluator, without, structured, fit) for without, fit in pairs)
    evaluator.problem.count_simulations(problem.simulations)
    if not improved:
        return evaluator, state, UNIFORM
    inner = SelectionState(
        state.detectability, state.noise, base, base, state.chi2_limit, state.nominal_scores, state.base_fit_converged
    )
    inner.stage_shares, inner.ranking = state.stage_shares, state.ranking
    _run_rounds(structured, inner, transferred, report_progress)
    judge_effects(structured, inner)
    if not clearly_better(evaluator, state.current, structured, inner.current):
        return evaluator, state, UNIFORM
    report_progress("comparing cells alone, grains alone, both, and neither")
    structure, chosen, fit = compare_variants(structured, inner.current)
    if structure.variant == "neither":
        return evaluator, state, structure
    inner.accepted_fits = []  # fits of another variant
    inner.base_fit = refit(chosen, base, EffectSet()) if fit.keys else fit
    inner.current = fit
    return chosen, inner, structure


def _fits_with_effects(problem: DiagnosisProblem, fits: Sequence[CandidateFit]) -> list[tuple[CandidateFit, EffectSet]]:
    """Fits without structure, once for each set of effects, and their effects without the approximations of one."""
    by_keys: dict[frozenset[str], tuple[CandidateFit, EffectSet]] = {}
    for fit in fits:
        effect_set = fit.refit.effect_set
        for key in effect_set.keys:
            effect_set = effect_set if key in problem.effects else effect_set.without(key)
        by_keys.setdefault(frozenset(effect_set.keys), (fit, effect_set))
    return [pair for keys, pair in by_keys.items() if keys]


def _improves(
    evaluator: CandidateEvaluator, without: CandidateFit, structured: CandidateEvaluator, fit: CandidateFit
) -> bool:
    """Whether the structure fits the training split better, and predicts the selection split better."""
    return fit.train_chi2 < without.train_chi2 and clearly_better(evaluator, without, structured, fit)


def _run_rounds(
    evaluator: CandidateEvaluator,
    state: SelectionState,
    transferred: Sequence[CandidateFit],
    report_progress: Callable[[str], object],
) -> None:
    """Add effects while they explain most of the excess; those that were selected without structure compete as well."""
    problem = evaluator.problem
    for index in range(_MAX_EFFECTS):
        current = state.current
        if current.at_noise:
            return
        report_progress(f"round {index + 1} with cells and grains: fitting {len(problem.effects)} effects")
        scores = evaluator.scores(current.refit)
        candidates = [
            Candidate(current.refit, key, score.strength, scores.shapes[key], score.gain)
            for key, score in scores.best.items()
            if score.gain > 0.0
        ]
        fits = successive_halving(evaluator, candidates)
        fits += [fit for fit in transferred if set(current.keys) < set(fit.keys)]
        fits = plausible_fits(problem, state, [f for f in fits if f.train_chi2 < current.train_chi2])
        if not fits:
            return
        best = min(fits, key=lambda fit: fit.total_chi2)
        best = refit(evaluator, best, best.refit.effect_set)
        if reason := rejection(current, best, problem.samples) or refusal(problem, current, best):
            state.rejected.append(reason)
            return
        accept(state, best, fits, problem.samples)
        if not explains_enough(evaluator, state, current):
            return
    drop_unneeded_effects(evaluator, state)
