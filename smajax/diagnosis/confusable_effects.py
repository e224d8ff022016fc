"""Confusable effects: refits in which an effect is replaced by one that it is often confused with."""

import math
from typing import Any

import numpy as np

from smajax.diagnosis.candidate_evaluation import CandidateEvaluator
from smajax.diagnosis.candidates import CandidateFit, EffectSet, Refit, RefitSearch
from smajax.numerics.ensemble import share_among_cores
from smajax.parameters import declarations

# Number of steps of one stage of a search, and of stages that follow the one with held shapes. Chosen by trial;
# tests/unit/diagnosis holds them.
_STAGE_STEPS = 8
_MAX_STAGES = 4
# A search is behind if its cost exceeds the first number times that of the fit whose effect is replaced; it continues
# if each stage reduces its cost to at most the second number times that before. Chosen by trial.
_BEHIND = 4.0
_CATCHING_UP = 0.5
# Relative fall of the cost at which these searches end: small, since nearly equivalent effects differ by little.
# Chosen by trial.
_RTOL = 1e-7
# Start strength of the replacing effect in units of the typical strength. Chosen by trial.
_START_STRENGTH = 0.3


def refit_confusable_effects(evaluator: CandidateEvaluator, fit: CandidateFit) -> list[CandidateFit]:
    """Replace the last effect of a fit by each effect that may be confused with it, and refit.

    The searches start at the point of the fit, with its shape where the other effect has a shape of the same name, and
    else with each usual shape. Shapes are held at first, because they drift away if they are freed too early. A search
    continues while its cost is near that of the fit or falls fast: an equally good effect may need many steps if the
    other parameters have to change much.

    Args:
        evaluator: The evaluator.
        fit: The fit whose last effect is replaced.

    Returns:
        The fits whose cost is at most 4 times that of ``fit``.
    """
    problem = evaluator.problem
    effects, key, refit, stride = problem.effects, fit.key, fit.refit, evaluator.stride(fit.train_chi2)
    remaining, in_model = refit.effect_set.without(key), (*fit.keys, *problem.modelled_effects)
    confusable = [
        k for k in effects if (k in effects[key].confused_with or key in effects[k].confused_with) and k not in in_model
    ]
    share = {k: 1.0 if effects[k].all_or_nothing else _START_STRENGTH for k in confusable}
    starts = [
        remaining.with_effect(other, {f"effects.{other}.strength": share[other] * effects[other].typical, **shape})
        for other in confusable
        for shape in replacement_shapes(evaluator, other, key, refit)
    ]

    def search_with_held_shapes(start: EffectSet) -> RefitSearch:
        search = problem.start_search(start, refit.base, rtol=_RTOL, hold_shapes=True, stride=stride)
        return search.advance(_STAGE_STEPS)

    def search_with_free_shapes(held: RefitSearch) -> RefitSearch:
        end, before = problem.refit_from(held), held.cost
        search = problem.start_search(end.effect_set, end.base, rtol=_RTOL, stride=stride).advance(_STAGE_STEPS)
        for _ in range(_MAX_STAGES):
            if search.cost > max(_BEHIND * refit.chi2, _CATCHING_UP * before):
                break
            before = search.cost
            search.advance(_STAGE_STEPS)
        return evaluator.continue_if_needed(search)

    best: dict[str, RefitSearch] = {}
    for search in sorted(share_among_cores(search_with_held_shapes, starts), key=lambda s: s.cost):
        best.setdefault(search.effect_set.keys[-1], search)
    close = [
        s for s in share_among_cores(search_with_free_shapes, list(best.values())) if s.cost < _BEHIND * refit.chi2
    ]
    fits = share_among_cores(lambda s: evaluator.evaluate(problem.refit_from(s)), close)
    return [f for f in fits if math.isfinite(f.total_chi2) and not evaluator.is_negligible(f)]


def replacement_shapes(evaluator: CandidateEvaluator, other: str, key: str, refit: Refit) -> list[dict[str, float]]:
    """Return start shapes of an effect that replaces another one.

    Args:
        evaluator: The evaluator.
        other: Key of the replacing effect.
        key: Key of the replaced effect.
        refit: The refit with the replaced effect.

    Returns:
        Shapes, SI, by parameter name: the fitted values where the names are the same, else each of the usual ones.
    """
    shapes: dict[tuple[Any, ...], dict[str, float]] = {}
    for shape in evaluator.problem.shape_grid(other):
        values = {}
        for name, usual in shape:
            declared = declarations(evaluator.problem.effects[other])[name]
            fitted = refit.values.get(f"effects.{key}.{name}", usual)
            values[f"effects.{other}.{name}"] = float(np.clip(fitted, declared.lower, declared.upper))
        shapes.setdefault(tuple(values.values()), values)
    return list(shapes.values())
