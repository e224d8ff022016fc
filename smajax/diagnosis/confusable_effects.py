"""Refits in which an effect that is known to be confused with an accepted one takes its place."""

import math

import numpy as np

from smajax.diagnosis.candidate_evaluation import CandidateEvaluator
from smajax.diagnosis.candidates import CandidateFit, EffectSet, Refit, RefitSearch
from smajax.diagnosis.parallel import map_in_pairs
from smajax.parameters import declarations

# Steps of one stage of a search, and how many stages follow that with held shapes. Chosen by trial;
# tests/unit/diagnosis holds them.
_STAGE_STEPS = 8
_MAX_STAGES = 4
# Cost over that of the fit whose place is taken beyond which a search is behind, and the share of its own cost that a
# search that is behind has to keep below in each stage to catch up. Chosen by trial.
_BEHIND = 4.0
_CATCHING_UP = 0.5
# Relative fall of the cost at which these searches end: effects that are nearly equivalent differ by little.
_RTOL = 1e-7
# Start strength of the effect in the other's place, in units of the typical one. Chosen by trial.
_START_STRENGTH = 0.3


def refit_confusable_effects(evaluator: CandidateEvaluator, fit: CandidateFit) -> list[CandidateFit]:
    """Refit with each effect that may be confused with a fit's last one in its place.

    The searches start at the fit's own point, with its shape where the other effect has a shape of the same name, else
    with each of its usual ones. Shapes are held at first: freed too early, they drift away. A search goes on unless it
    is far behind and does not catch up: where the other parameters have a long way to go, an effect as good as the
    fit's takes a while.

    Args:
        evaluator: The evaluator.
        fit: The fit whose last effect is replaced.

    Returns:
        The fits that are not far behind.
    """
    problem = evaluator.problem
    effects, key, refit, stride = problem.effects, fit.key, fit.refit, evaluator.stride(fit.train_chi2)
    others, taken = refit.effect_set.without(key), (*fit.keys, *problem.modelled_effects)
    confusable = [
        k for k in effects if (k in effects[key].confused_with or key in effects[k].confused_with) and k not in taken
    ]
    starts = [
        others.with_effect(other, {f"effects.{other}.strength": _START_STRENGTH * effects[other].typical, **shape})
        for other in confusable
        for shape in replacement_shapes(evaluator, other, key, refit)
    ]

    def search_with_held_shapes(start: EffectSet) -> RefitSearch:
        search = problem.start_search(start, refit.base, rtol=_RTOL, hold_shapes=True, stride=stride)
        return search.advance(_STAGE_STEPS)

    def search_on(held: RefitSearch) -> RefitSearch:
        end, before = problem.refit_from(held), held.cost
        search = problem.start_search(end.effect_set, end.base, rtol=_RTOL, stride=stride).advance(_STAGE_STEPS)
        for _ in range(_MAX_STAGES):
            if search.cost > max(_BEHIND * refit.chi2, _CATCHING_UP * before):
                break
            before = search.cost
            search.advance(_STAGE_STEPS)
        return evaluator.continue_if_needed(search)

    best: dict[str, RefitSearch] = {}
    for search in sorted(map_in_pairs(search_with_held_shapes, starts), key=lambda s: s.cost):
        best.setdefault(search.effect_set.keys[-1], search)
    close = [s for s in map_in_pairs(search_on, list(best.values())) if s.cost < _BEHIND * refit.chi2]
    fits = map_in_pairs(lambda s: evaluator.evaluate(problem.refit_from(s)), close)
    return [f for f in fits if math.isfinite(f.total_chi2) and not evaluator.is_negligible(f)]


def replacement_shapes(evaluator: CandidateEvaluator, other: str, key: str, refit: Refit) -> list[dict[str, float]]:
    """Return start shapes of an effect that takes another's place.

    Args:
        evaluator: The evaluator.
        other: Key of the effect.
        key: Key of the effect whose place it takes.
        refit: The refit with that one.

    Returns:
        The fitted shape, where it has the same name, else each of the usual ones, by parameter name.
    """
    shapes: dict[tuple, dict[str, float]] = {}
    for shape in evaluator.problem.shape_grid(other):
        values = {}
        for name, usual in shape:
            declared = declarations(evaluator.problem.effects[other])[name]
            fitted = refit.values.get(f"effects.{key}.{name}", usual)
            values[f"effects.{other}.{name}"] = float(np.clip(fitted, declared.lower, declared.upper))
        shapes.setdefault(tuple(values.values()), values)
    return list(shapes.values())
