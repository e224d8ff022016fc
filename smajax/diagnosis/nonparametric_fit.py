"""Fit of a nonparametric term: the form of the term that a stage lacks to explain a residual."""

import dataclasses
import math

import jax
import numpy as np

from smajax.diagnosis.candidates import NonparametricTerm, Refit
from smajax.diagnosis.compiled_model import SLOTS
from smajax.diagnosis.data_split import SELECT, TRAIN
from smajax.diagnosis.localisation import explained_share, node_matrix, node_sensitivities, node_unit
from smajax.diagnosis.nonparametric import KINDS, VARIABLES, FreeHeat, FreeShift, FreeStrain
from smajax.diagnosis.problem import DiagnosisProblem

# Largest number of nodes of a term, as far as there are free slots, chosen by trial; and the least one: two nodes show
# no form.
_NODES = 5
_MIN_NODES = 3


@dataclasses.dataclass(frozen=True)
class NonparametricFit:
    """A fitted nonparametric term.

    Attributes:
        stage: The stage to which it belongs.
        kind: "free-heat", "free-shift" or "free-strain".
        unit: Unit of its values.
        variable: The variable of which it is a function, a word of ``nonparametric.VARIABLES``.
        positions: Values of the variable at the nodes, shape ``(nodes,)``.
        values: Values of the term at the nodes, shape ``(nodes,)``.
        base_chi2: Reduced chi-squared of the training split without the term.
        train_chi2: Reduced chi-squared of the training split with it.
        select_chi2: Reduced chi-squared of the selection split with it.
    """

    stage: str
    kind: str
    unit: str
    variable: str
    positions: np.ndarray
    values: np.ndarray
    base_chi2: float
    train_chi2: float
    select_chi2: float


def fit_nonparametric_term(
    problem: DiagnosisProblem, refit: Refit, basis: np.ndarray, residual: np.ndarray, stage: str, stride: int = 1
) -> NonparametricFit | None:
    """Fit the term of a stage that explains most of a residual, as a function of a state, with all other parameters.

    The variable and the kind of the term are those with the largest explained share to first order.

    Args:
        problem: The diagnosis problem.
        refit: The refit to which the term is added.
        basis: Orthonormal basis of the free parameters' Jacobian, shape ``(m, rank)``.
        residual: The projected residual, shape ``(m,)``.
        stage: The stage that the residual comes from.
        stride: Distance of the samples that are used (``strided_problem``).

    Returns:
        The fit; ``None`` if there are too few free slots for its nodes, no state changes, or the simulation fails.
    """
    nodes = min(_NODES, SLOTS - len(problem.free_effect_parameters(refit.effect_set)))
    if nodes < _MIN_NODES:
        return None
    kinds = (FreeShift, FreeStrain) if stage in ("material", "mechanism", "sensor") else (FreeHeat,)
    variables = [v for v in VARIABLES if v != "time"]
    options = [(KINDS.index(kind), v, _range_of(problem, refit, v)) for kind in kinds for v in variables]
    options = [option for option in options if option[2][1] > option[2][0]]
    shares = [explained_share(basis, residual, node_sensitivities(problem, refit, *o, nodes)) for o in options]
    if not shares:
        return None
    kind, variable, (low, high) = options[int(np.argmax(shares))]
    unit = node_unit(problem, kind)
    term = NonparametricTerm(kind, variable, low, high, node_matrix(nodes) * unit)
    fitted = problem.fit(refit.effect_set, refit.base, max_steps=25, term=term, stride=stride)
    if not np.isfinite(fitted.chi2):
        return None
    free = problem.free_effect_parameters(fitted.effect_set)
    predicted = problem.predict_on(problem.problems[SELECT], fitted.effect_set, fitted.base, free, term, fitted.nodes)
    effect = KINDS[kind]
    return NonparametricFit(
        stage=stage if effect is FreeStrain else effect.stage,
        kind=effect.key,
        unit=effect.adds,
        variable=variable,
        positions=np.linspace(low, high, nodes),
        values=fitted.nodes * unit,
        base_chi2=problem.reduced_chi2(refit.residual, TRAIN),
        train_chi2=problem.reduced_chi2(fitted.residual, TRAIN),
        select_chi2=problem.reduced_chi2(predicted, SELECT),
    )


def _range_of(problem: DiagnosisProblem, refit: Refit, variable: str) -> tuple[float, float]:
    """Lowest and highest value of a state over the training split, simulated without effects."""
    low, high = math.inf, -math.inf
    for k, recording in enumerate(problem.splits[TRAIN].recordings):
        inputs = jax.tree.map(lambda leaf, k=k: leaf[k], problem.problems[TRAIN].data.inputs)
        states = problem.states(refit, inputs)
        martensite = np.asarray(states.fractions.martensite)[: len(recording)]
        transformed = np.cumsum(np.abs(np.diff(martensite, axis=0)), axis=0)
        temperature = np.asarray(states.temperature)[: len(recording)]
        values = {"temperature": temperature, "martensite": martensite, "travel": transformed}[variable]
        low, high = min(low, float(values.min())), max(high, float(values.max()))
    return low, high
