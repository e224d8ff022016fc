"""The structure of the wire: whether a rig needs cold ends (cells), a spread of its grains, both, or neither.

Each of the two alone may explain too little to be accepted. Cells and grains are therefore one candidate, fitted from
several positive starts, since at a spread of 0 the derivative is 0. All variants run on one compiled program: the
spreads of grains are held at 0 and their widths at 1 where there is one grain, and the conductivity along the wire is
held near 0 where there are no cells.
"""

import copy
import dataclasses
import math
from collections.abc import Collection, Mapping, Sequence
from typing import NamedTuple

import jax.numpy as jnp
import numpy as np

from smajax import parameters
from smajax.diagnosis.candidate_evaluation import CandidateEvaluator
from smajax.diagnosis.candidates import CandidateFit, EffectSet
from smajax.diagnosis.data_split import TRAIN
from smajax.diagnosis.memory import diagnosis_memory
from smajax.diagnosis.problem import DiagnosisProblem
from smajax.diagnosis.problem_layout import JointPrior
from smajax.diagnosis.selection_state import SelectionState
from smajax.fitting.memory import free_memory
from smajax.numerics.ensemble import share_among_cores
from smajax.parameters import declarations
from smajax.plant.cells import Cells
from smajax.plant.effects.end_conduction import EndConduction
from smajax.plant.effects.gradual_transformation import GradualTransformation
from smajax.plant.effects.temperature_distribution import TemperatureDistribution
from smajax.plant.grains import SHAPES as GRAIN_SHAPES
from smajax.plant.grains import Grains
from smajax.plant.heat import PrescribedTemperature
from smajax.plant.plant import Plant

# Cells along the wire and grains in each, a compromise between accuracy and cost. Chosen by trial;
# experiments/speed/cells_and_grains.py prints both.
CELLS = 9
GRAINS = 6
# The variants of the structure, the simplest first, and the effects that stand for each in a list of effects.
VARIANTS: Mapping[str, tuple[str, ...]] = {
    "neither": (),
    "cells": (EndConduction.key,),
    "grains": (GradualTransformation.key,),
    "both": (EndConduction.key, GradualTransformation.key),
}
# Effects of the catalogue that are approximations of cells or grains.
APPROXIMATIONS = (EndConduction.key, TemperatureDistribution.key, GradualTransformation.key)
SPREADS = ("grains.austenite_spread", "grains.martensite_spread")
# A full cycle shows the width of the whole wire's transformation alone, which a rig file may have from a data sheet.
WIDTHS = ("grains.austenite_width", "grains.martensite_width")
# Correlation of the shifts of a grain in both directions: they may be independent, which is where searches start.
ANGLE = "grains.correlation_angle"
_START_ANGLE = 0.5 * math.pi
# Shapes of the distribution of the grains' shifts. One recording seldom determines them: only fits to training and
# selection split together free them (``joint_refit``).
SHAPES = tuple(f"grains.{name}" for name in GRAIN_SHAPES)
# Convection differs along every wire by a few per cent, which shifts the temperatures of cells by as much of their rise
# above the ambient. Starts of the searches, both signs, and bounds within which they stay. Chosen by trial.
UNEVEN = "cells.uneven_convection"
_START_UNEVEN = (0.01, -0.01)
_LARGEST_UNEVEN = 0.1
# Standard deviations of the prior of the structure's parameters in fits to both splits. Chosen by trial.
_DEVIATIONS = (
    dict.fromkeys(SPREADS, 0.2) | dict.fromkeys(WIDTHS, 0.5) | dict.fromkeys(SHAPES, 1.0) | {ANGLE: 0.6, UNEVEN: 0.05}
)
# Parameters of the variants without cells: even cooling, and hardly any conduction along the wire and into its clamps.
_INSULATING = ("conductivity", "clamp_conductance", "clamp_capacity")
_WITHOUT_CELLS = {f"cells.{name}": declarations(Cells)[name].lower for name in _INSULATING} | {UNEVEN: 0.0}
# Reduced chi-squared of training or selection split from which on the structure is fitted: 1.5 times the noise.
# Chosen by trial.
ASK_FROM = 2.25
# Start values of both spreads. Chosen by trial.
_START_SPREADS = (0.7, 0.35)
# Number of effects of the first round, those with the least errors on the selection split, and those with the largest
# scores, that are fitted next to the structure. Chosen by trial.
_BEST_REFITS = 4
_BEST_SCORES = 2
# Number of steps of each search from a start, and of the best one after that, with the relative fall of the cost at
# which it ends. Chosen by trial.
_START_STEPS = 10
_STEPS = 25
_RTOL = 1e-5


class Structure(NamedTuple):
    """The structure of the wire that a diagnosis found.

    Attributes:
        variant: A key of ``VARIANTS``.
        cells: Number of cells, 1 without.
        grains: Number of grains, 1 without. With cells alone their spreads are 0; they lie at different places.
        errors: RMSE of the selection split over the noise by variant, each fitted to the training split with the same
            effects; empty if the structure was not fitted.
        jointly: Whether the errors are those of fits to training and selection split together, which decided.
    """

    variant: str = "neither"
    cells: int = 1
    grains: int = 1
    errors: Mapping[str, float] = {}
    jointly: bool = False

    @property
    def effects(self) -> tuple[str, ...]:
        """Keys of the effects that stand for the structure."""
        return VARIANTS[self.variant]


# A wire of one temperature and one grain.
UNIFORM = Structure()


def leaves_more_than_noise(state: SelectionState) -> bool:
    """Return whether the accepted effects leave so much that the structure and the law of the rig are in question.

    Args:
        state: The state at the end of a forward selection.
    """
    return max(state.current.train_chi2, state.current.select_chi2) >= ASK_FROM


def may_have_structure(problem: DiagnosisProblem, state: SelectionState) -> bool:
    """Return whether a diagnosis has to decide on the structure of the wire.

    It has not where the rig file has cells or grains, the fit is near the noise, the diagnosis was stopped, each
    recording has own parameters, or the memory is not enough.

    Args:
        problem: The diagnosis problem of a rig without structure.
        state: The state at the end of its forward selection.
    """
    plant = problem.base_problem.plant
    if plant.cells is not None or plant.grains is not None or problem.own_count or state.interrupted:
        return False
    if not leaves_more_than_noise(state):
        return False
    recordings = [r for split in problem.splits for r in split.recordings]
    _, memory = diagnosis_memory(with_structure(plant), recordings, **problem.grid_options)
    return memory < free_memory()


def with_structure(plant: Plant, cells: int = CELLS, grains: int = GRAINS) -> Plant:
    """Return a plant with cells, unless its temperature is prescribed, and grains.

    Args:
        plant: A plant without either.
        cells: Number of cells.
        grains: Number of grains in each.
    """
    along = None if isinstance(plant.heat, PrescribedTemperature) else Cells(count=cells)
    spreads = (jnp.asarray(_START_SPREADS[0]),) * 2
    return dataclasses.replace(plant, cells=along, grains=Grains(*spreads, count=grains))


def structured_problem(problem: DiagnosisProblem, state: SelectionState) -> DiagnosisProblem:
    """Build the problem of the same rig with cells, and with grains whose spreads and widths are free.

    Args:
        problem: The problem without structure.
        state: The state at the end of its forward selection. Its facts are the candidates next to the structure; where
            these are not settled (``are_settled``), all effects are.
    """
    plant = parameters.replace(with_structure(problem.base_problem.plant), {ANGLE: _START_ANGLE})
    own = (*SPREADS, *WIDTHS, ANGLE, *((UNEVEN,) if plant.cells is not None else ()), *SHAPES)
    free = (*problem.settings.free, *own)
    settings = dataclasses.replace(problem.settings, free=free)  # pyright: ignore[reportArgumentType, reportCallIssue]
    keys = candidate_keys(state) if are_settled(state) else _without_approximations(problem.effects)
    structured = DiagnosisProblem(plant, problem.splits, settings, **problem.grid_options, candidates=keys)
    structured.set_noise(problem.noise)
    unknowns = structured.problems[TRAIN].unknowns
    lower, upper = (side.copy() for side in structured.bounds)
    for i, unknown in enumerate(unknowns):
        if unknown.name == UNEVEN:
            lower[i], upper[i] = (side / unknown.scale for side in (-_LARGEST_UNEVEN, _LARGEST_UNEVEN))
        elif unknown.name in SHAPES:
            lower[i] = upper[i] = structured.nominal[i]
    structured.bounds = (lower, upper)
    structured.joint_prior = JointPrior(
        np.array([unknown.name in SHAPES for unknown in unknowns]),
        np.array([_DEVIATIONS.get(unknown.name, math.inf) / unknown.scale for unknown in unknowns]),
    )
    return structured


def are_settled(state: SelectionState) -> bool:
    """Return whether the facts alone are fitted next to the structure: there are some, and none approximates it.

    An effect that stands for cold ends or grains on a wire of one cell and one grain may have absorbed another effect.

    Args:
        state: The state at the end of the forward selection without structure.
    """
    return bool(state.accepted) and not any(key in APPROXIMATIONS for key in state.accepted)


def candidate_keys(state: SelectionState) -> tuple[str, ...]:
    """Return the effects that are tried next to the structure: the facts, or if these are not settled others as well.

    Args:
        state: The state at the end of the forward selection without structure.
    """
    tried = _without_approximations(state.accepted)
    if are_settled(state):
        return tuple(tried)
    tried += [key for fit in state.accepted_fits for key in fit.keys]
    refits = {k: s.refit_rmse_select for k, s in state.ranking.items() if s.refit_rmse_select is not None}
    scores = {k: s.gain for k, s in state.ranking.items() if s.gain}
    tried += _without_approximations(sorted(refits, key=lambda k: refits[k]))[:_BEST_REFITS]
    tried += _without_approximations(sorted(scores, key=lambda k: -scores[k]))[:_BEST_SCORES]
    return tuple(dict.fromkeys(_without_approximations(tried)))


def _without_approximations(keys: Collection[str]) -> list[str]:
    return [key for key in keys if key not in APPROXIMATIONS]


def holding(problem: DiagnosisProblem, values: Mapping[str, float]) -> DiagnosisProblem:
    """Return a problem with parameters of the plant held; it runs on the same compiled programs.

    Args:
        problem: The problem.
        values: Values by name, SI.
    """
    unknowns = problem.problems[TRAIN].unknowns
    names = [unknown.name for unknown in unknowns]
    held = copy.copy(problem)
    held.set_plant_values({name: value for name, value in values.items() if name not in names})
    held.nominal, (lower, upper) = problem.nominal.copy(), (side.copy() for side in problem.bounds)
    for name in set(names) & values.keys():
        i = names.index(name)
        held.nominal[i] = lower[i] = upper[i] = values[name] / unknowns[i].scale
    held.bounds = (lower, upper)
    if (prior := problem.joint_prior) is not None:
        held.joint_prior = prior._replace(free=prior.free & ~np.isin(names, list(values)))
    return held


def held_values(variant: str, has_cells: bool) -> dict[str, float]:
    """Return the parameters that are held in a variant, SI by name.

    Args:
        variant: A key of ``VARIANTS``.
        has_cells: Whether the problem has cells.
    """
    one_grain = dict.fromkeys((*SPREADS, *SHAPES), 0.0) | dict.fromkeys(WIDTHS, 1.0) | {ANGLE: 0.0}
    values = one_grain if variant in ("neither", "cells") else {}
    return values | (_WITHOUT_CELLS if has_cells and variant in ("neither", "grains") else {})


def fit_with_structure(evaluator: CandidateEvaluator, effect_set: EffectSet, without: CandidateFit) -> CandidateFit:
    """Fit a set of effects together with the structure, from several positive starts.

    Args:
        evaluator: The evaluator of the problem with structure.
        effect_set: The effects, with start values of their parameters.
        without: The fit without structure; the values of the structure follow its parameters in the base vector.

    Returns:
        The best fit to the training split.
    """
    problem, base = evaluator.problem, without.refit.base
    near = [
        np.append(base, _structure_values(problem, spread, uneven))
        for spread, uneven in zip(_START_SPREADS, _START_UNEVEN, strict=True)
    ]
    return fit_from(evaluator, effect_set, (problem.nominal, *near), without.train_chi2)


def fit_from(
    evaluator: CandidateEvaluator, effect_set: EffectSet, starts: Sequence[np.ndarray], reduced_chi2: float
) -> CandidateFit:
    """Fit a set of effects with a few steps from each of several starts, and with more from the best point.

    Args:
        evaluator: The evaluator.
        effect_set: The effects, with start values of their parameters.
        starts: Base vectors, each of shape ``(p,)``.
        reduced_chi2: Reduced chi-squared of the training split that is expected.

    Returns:
        The best fit to the training split.
    """
    problem, stride = evaluator.problem, evaluator.stride(reduced_chi2)
    free = tuple(problem.free_effect_parameters(effect_set))
    searches = [problem.start_search(effect_set, start, free=free, rtol=_RTOL, stride=stride) for start in starts]
    best = min(share_among_cores(lambda s: s.advance(_START_STEPS), searches), key=lambda s: s.cost)
    return evaluator.evaluate(problem.refit_from(evaluator.continue_if_needed(best.advance(_STEPS))))


def refit(evaluator: CandidateEvaluator, fit: CandidateFit, effect_set: EffectSet) -> CandidateFit:
    """Fit other effects next to the structure, from the point of a fit.

    Args:
        evaluator: The evaluator.
        fit: The fit.
        effect_set: The effects, with start values of their parameters.
    """
    start = np.clip(fit.refit.base, *evaluator.problem.bounds)
    stride = evaluator.stride(fit.train_chi2)
    return evaluator.evaluate(evaluator.fit(effect_set, start, stride, max_steps=_STEPS, rtol=_RTOL))


def _structure_values(problem: DiagnosisProblem, spread: float, uneven: float) -> np.ndarray:
    """Entries of the parameters of grains, and of the uneven convection, in the base vector."""
    values = dict.fromkeys(SPREADS, spread) | dict.fromkeys(WIDTHS, 1.0) | dict.fromkeys(SHAPES, 0.0)
    values |= {ANGLE: _START_ANGLE, UNEVEN: uneven}
    return np.array([values[u.name] / u.scale for u in problem.problems[TRAIN].unknowns if u.name in values])


def structured_plant(plant: Plant, structure: Structure) -> Plant:
    """Return a fitted plant with the parts of its structure only, and with the temperatures of its whole wire.

    Args:
        plant: The fitted plant, with cells and grains.
        structure: The structure that was found; if it was not fitted, the plant stays as it is.
    """
    if not structure.errors:
        return plant
    if plant.grains is not None:
        grains, material = plant.grains.with_whole_width(plant.material)
        # Critical stresses near 0 may become negative, which no rig file has: then the factors stay.
        if all(d.lower <= float(getattr(material, key)) <= d.upper for key, d in declarations(material).items()):
            plant = dataclasses.replace(plant, grains=grains, material=material)
    cells = plant.cells if structure.cells > 1 else None
    grains = plant.grains if structure.grains > 1 else None
    return dataclasses.replace(plant, cells=cells, grains=grains)
