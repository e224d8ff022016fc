"""The choice between the variants of the structure, and between a wire with a structure and one without.

The selection split decides, on fits of the training split. Next to facts, where the training split may not determine
the structure, fits to both splits together decide as well: cells and grains then have to leave less than half of the
excess mean square on each of them.
"""

import math
from collections.abc import Mapping

import numpy as np

from smajax.diagnosis.acceptance import MIN_SELECT_CUT
from smajax.diagnosis.bootstrap import bootstrap_cut
from smajax.diagnosis.candidate_evaluation import CandidateEvaluator
from smajax.diagnosis.candidates import CandidateFit
from smajax.diagnosis.data_split import SELECT, TRAIN
from smajax.diagnosis.joint_refit import refit_jointly
from smajax.diagnosis.selection_state import SelectionState
from smajax.diagnosis.structure import (
    ASK_FROM,
    CELLS,
    GRAINS,
    UNEVEN,
    VARIANTS,
    Structure,
    fit_from,
    held_values,
    holding,
    refit,
)
from smajax.numerics.ensemble import share_among_cores

# Largest share of the excess mean square on each split that a structure leaves, if fits to both splits decide: that of
# facts (``support``).
_LARGEST_JOINT_SHARE = 0.5

Evaluated = tuple[CandidateEvaluator, CandidateFit]


def halves_excess(state: SelectionState, fit: CandidateFit) -> bool:
    """Return whether a fit leaves less than half of the training split's excess that the one without structure leaves.

    A training split that is near the noise without structure shows nothing about it, and does not exclude it.

    Args:
        state: The state at the end of the selection without structure.
        fit: The fit with structure.
    """
    if state.current.train_chi2 < ASK_FROM:
        return True
    return fit.train_chi2 - 1.0 < _LARGEST_JOINT_SHARE * (state.current.train_chi2 - 1.0)


def is_clear_improvement(
    rig: CandidateEvaluator,
    state: SelectionState,
    structured: CandidateEvaluator,
    fit: CandidateFit,
    *,
    jointly: bool = False,
) -> bool:
    """Return whether a fit with structure takes the place of the one without.

    It fits the training split better and predicts clearly better; or it has fewer effects, predicts clearly better than
    the rig without effects, and not clearly worse than with them: every wire has ends and grains, so that effects which
    explain no more than these are not needed. If ``jointly``, fits to both splits decide as well (``joint_errors``).

    Args:
        rig: The evaluator of the problem without structure.
        state: The state at the end of its forward selection.
        structured: The evaluator of the problem with structure.
        fit: Its fit.
        jointly: Whether fits to both splits decide as well.
    """
    current = state.current
    if fit.train_chi2 < current.train_chi2 and clearly_better(rig, current, structured, fit):
        return True
    if jointly and joint_errors((rig, current), (structured, fit)):
        return True
    if len(fit.keys) >= len(current.keys) or clearly_better(structured, fit, rig, current):
        return False
    return clearly_better(rig, state.base_fit, structured, fit)


def joint_errors(without: Evaluated, other: Evaluated) -> tuple[float, float] | None:
    """Fit both splits together, without and with the structure.

    Args:
        without: Evaluator and fit without structure.
        other: Evaluator and fit with it.

    Returns:
        The errors of the selection split over the noise, without and with the structure, if it leaves less than half of
        the excess mean square on each split; else ``None``.
    """
    excess = []
    for evaluator, fit in (without, other):
        problem, joint = evaluator.problem, refit_jointly(evaluator.problem, fit.refit, shapes=False)
        residuals = {k: problem.predict(joint.effect_set, joint.base, k) for k in (TRAIN, SELECT)}
        excess.append([problem.reduced_chi2(residual, k) - 1.0 for k, residual in residuals.items()])
    # Not finite where a simulation fails.
    if not all(b < _LARGEST_JOINT_SHARE * a for a, b in zip(*excess, strict=True)):
        return None
    return math.sqrt(excess[0][1] + 1.0), math.sqrt(excess[1][1] + 1.0)


def compare_variants(
    rig: CandidateEvaluator,
    state: SelectionState,
    evaluator: CandidateEvaluator,
    current: CandidateFit,
    *,
    jointly: bool = False,
) -> tuple[Structure, CandidateEvaluator, CandidateFit]:
    """Fit every variant with the same effects and choose the simplest one that predicts as well as the best.

    Args:
        rig: The evaluator of the problem without structure.
        state: The state at the end of its forward selection.
        evaluator: The evaluator of the problem with structure.
        current: Its fit.
        jointly: Whether fits to both splits decide as well (``joint_errors``).

    Returns:
        The structure, and the evaluator and the fit of its variant.
    """
    problem = evaluator.problem
    has_cells = problem.base_problem.plant.cells is not None
    variants = [v for v in VARIANTS if has_cells or v in ("neither", "grains")]
    fits = {variants[0]: (rig, _fit_without(rig, state, current)), variants[-1]: (evaluator, current)}
    between = variants[1:-1]
    held = share_among_cores(lambda v: _fit_held(evaluator, current, held_values(v, has_cells)), between)
    fits |= zip(between, held, strict=True)
    errors = {v: math.sqrt(fits[v][1].select_chi2) for v in variants}
    best = min(errors, key=lambda v: errors[v])
    chosen = next(v for v in variants if v == best or not clearly_better(*fits[v], *fits[best]))
    if jointly and chosen == "neither" and (joint := joint_errors(fits["neither"], fits[variants[-1]])):
        chosen = variants[-1]
        cells = CELLS if chosen == "both" else 1
        return Structure(chosen, cells, GRAINS, dict(zip(("neither", chosen), joint, strict=True)), True), *fits[chosen]
    if chosen not in ("cells", "both"):
        return Structure(chosen, 1, 1 if chosen == "neither" else GRAINS, errors), *fits[chosen]
    # Uneven convection stays only where it predicts clearly better: elsewhere it absorbs other differences.
    even = _fit_held(*fits[chosen], {UNEVEN: 0.0})
    found = fits[chosen] if clearly_better(*even, *fits[chosen]) else even
    errors[chosen] = math.sqrt(found[1].select_chi2)
    return Structure(chosen, CELLS, GRAINS, errors), *found


def _fit_held(
    evaluator: CandidateEvaluator, fit: CandidateFit, values: Mapping[str, float]
) -> tuple[CandidateEvaluator, CandidateFit]:
    """The fit of the same effects with parameters held, and its evaluator."""
    held = evaluator.on(holding(evaluator.problem, values))
    return held, refit(held, fit, fit.refit.effect_set)


def _fit_without(rig: CandidateEvaluator, state: SelectionState, fit: CandidateFit) -> CandidateFit:
    """The fit of the same effects without structure."""
    for earlier in (state.base_fit, state.current):
        if set(earlier.keys) == set(fit.keys):
            return earlier
    # The fit with the structure is a start, too: it must not win because the search without it has not ended.
    problem = rig.problem
    bases = (state.current.refit.base, problem.nominal, fit.refit.base[: problem.size])
    starts = [np.clip(base, *problem.bounds) for base in bases]
    return fit_from(rig, fit.refit.effect_set, starts, fit.train_chi2)


def clearly_better(
    evaluator: CandidateEvaluator, fit: CandidateFit, other_evaluator: CandidateEvaluator, other: CandidateFit
) -> bool:
    """Return whether another fit predicts the selection split better, and both by at least 5 % and beyond chance.

    The errors of a rough rig lie in few short spans, so that the selection split alone says little about chance.

    Args:
        evaluator: The evaluator of the first fit.
        fit: The first fit.
        other_evaluator: The evaluator of the other fit.
        other: The other fit.
    """
    if not math.isfinite(other.select_chi2):
        return False
    if not math.isfinite(fit.select_chi2):
        return True
    if other.select_chi2 >= fit.select_chi2:
        return False
    residuals = [
        np.concatenate(
            [
                e.problem.counted_samples(e.problem.predict(f.refit.effect_set, f.refit.base, k), k)
                for k in (TRAIN, SELECT)
            ]
        )
        for e, f in ((evaluator, fit), (other_evaluator, other))
    ]
    cut = 1.0 - math.sqrt(other.total_chi2 / fit.total_chi2)
    return cut >= MIN_SELECT_CUT and bootstrap_cut(residuals[0], residuals[1], evaluator.seed)[0] > 0.0
