"""Plausibility of fits: parameters outside of what an alloy can have, and effects whose strength is 0.

Plausible ranges are priors of the selection only: a fit that moves a parameter outside of its range, or farther outside
than the fit without the effect does, is no explanation. Estimates and intervals are those of the data.
"""

import math
from collections.abc import Mapping, Sequence

from smajax.diagnosis.acceptance import Rejection, RejectionCode
from smajax.diagnosis.candidates import CandidateFit, Refit
from smajax.diagnosis.data_split import TRAIN
from smajax.diagnosis.problem import DiagnosisProblem
from smajax.diagnosis.selection_state import SelectionState
from smajax.files.plausible_ranges import ImplausibleValue, implausible_values

# Distance beyond the end of a range, as a share of its width, that an effect may add: ranges have no sharp ends. Chosen
# by trial.
_ALLOWED_EXCESS = 0.1
# Strength, as a share of the typical one, up to which an effect counts as absent: a search rarely ends at 0 exactly.
# Chosen by trial.
ZERO_STRENGTH = 1e-3


def implausible_estimates(problem: DiagnosisProblem, refit: Refit) -> tuple[ImplausibleValue, ...]:
    """List the parameters of a refit, of the rig and of its effects, that lie outside of what an alloy can have.

    Args:
        problem: The diagnosis problem.
        refit: The refit.
    """
    names = [u.name for u in problem.problems[TRAIN].unknowns]
    own = problem.free_effect_parameters(refit.effect_set)
    return tuple(implausible_values(problem.fitted_plant(refit), dict.fromkeys((*names, *own))))


def newly_implausible(problem: DiagnosisProblem, refit: Refit, current: Refit) -> tuple[str, ...]:
    """Return the parameters that a refit moves outside of their plausible range, and ``current`` does not.

    Args:
        problem: The diagnosis problem.
        refit: The refit with one more effect.
        current: The refit without it.

    Returns:
        Their names; those that ``current`` has outside as far are left out.
    """
    before = _excesses(implausible_estimates(problem, current))
    after = _excesses(implausible_estimates(problem, refit))
    return tuple(name for name, excess in after.items() if excess > before.get(name, 0.0) + _ALLOWED_EXCESS)


def _excesses(values: tuple[ImplausibleValue, ...]) -> Mapping[str, float]:
    return {v.name: v.plausible.excess(v.value) for v in values}


def absent_effects(problem: DiagnosisProblem, refit: Refit) -> tuple[str, ...]:
    """Return the effects of a refit whose strength is 0, within a thousandth of the typical one.

    Args:
        problem: The diagnosis problem.
        refit: The refit.
    """
    strengths = {key: abs(refit.values[f"effects.{key}.strength"]) for key in refit.effect_set.keys}
    return tuple(key for key, strength in strengths.items() if strength < ZERO_STRENGTH * problem.effects[key].typical)


def plausible_fits(
    problem: DiagnosisProblem, state: SelectionState, fits: Sequence[CandidateFit]
) -> list[CandidateFit]:
    """Leave out fits that need a parameter outside of what an alloy can have.

    Their effects only compensate for the lack of another one, for which the search goes on.

    Args:
        problem: The diagnosis problem.
        state: The state of the selection; the best of these fits is noted there as rejected, if it is the best of all.
        fits: Fits with one more effect than the current one.
    """
    outside = {id(fit): newly_implausible(problem, fit.refit, state.current.refit) for fit in fits}
    plausible = [fit for fit in fits if not outside[id(fit)]]
    least = min((fit.total_chi2 for fit in plausible), default=math.inf)
    better = [fit for fit in fits if outside[id(fit)] and fit.total_chi2 < least]
    if better:
        best = min(better, key=lambda fit: fit.total_chi2)
        state.rejected.append(Rejection(best.key, RejectionCode.implausible, others=outside[id(best)]))
    return plausible


def refusal(problem: DiagnosisProblem, current: CandidateFit, best: CandidateFit) -> Rejection | None:
    """Return why an effect cannot be one, although the fit with it improves: its strength is 0, or it is implausible.

    Args:
        problem: The diagnosis problem.
        current: The fit without the effect.
        best: The fit with it.
    """
    if absent := absent_effects(problem, best.refit):
        return Rejection(absent[-1], RejectionCode.zero)
    if outside := newly_implausible(problem, best.refit, current.refit):
        return Rejection(best.key, RejectionCode.implausible, others=outside)
    return None
