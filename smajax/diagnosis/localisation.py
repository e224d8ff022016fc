"""Localisation: in which stage of the plant a residual can live.

Heat and material are each given a piecewise linear function of time, added as heat or as a shift of the transformation
temperatures, and each channel one that is added to it. Whatever of the residual such a function explains beyond the
free parameters, adjusted for its number of nodes, is the share that can live there. Drive, mechanism and sensor have no
such function of their own (a current is heat, and what happens between mechanism and sensor adds to the channel): the
sensitivities of their effects decide between them.
"""

from collections.abc import Mapping, Sequence

import numpy as np

from smajax.diagnosis.candidates import NonparametricTerm, Refit
from smajax.diagnosis.compiled_model import SLOTS
from smajax.diagnosis.data_split import TRAIN
from smajax.diagnosis.nonparametric import KINDS, KNOTS, FreeHeat, FreeShift, FreeStrain, hat_functions
from smajax.diagnosis.parallel import map_in_pairs
from smajax.diagnosis.problem import DiagnosisProblem
from smajax.diagnosis.screening import orthonormal_basis, project_out

STAGES = ("drive", "heat", "material", "mechanism", "sensor")
# Shares within this of the largest, or of half of it, are as good: of these the most upstream stage is named, since one
# cause there shows in all that follows. 0.1 is from the prototype study of the diagnosis.
_TIE = 0.1
_TIE_FRACTION = 0.5
# Largest share below which the residual lives in no stage. Chosen by trial; tests/unit/diagnosis holds it.
_NO_STAGE = 0.02
# Share of a column's norm that has to remain after projection: less is rounding.
_MIN_REMAINING = 1e-3
# Values of nodes of order one: ten kelvin times the heat balance's conductance, a kelvin, a hundredth of a per cent of
# strain.
_HEAT_UNIT_KELVIN = 10.0
_SHIFT_UNIT = 1.0
_STRAIN_UNIT = 1e-4


def stage_shares(
    problem: DiagnosisProblem, refit: Refit, basis: np.ndarray, residual: np.ndarray, sensitivities: Mapping
) -> dict[str, float]:
    """Compute the share of a residual that can live in each stage.

    Args:
        problem: The diagnosis problem.
        refit: The refit that leaves the residual.
        basis: Orthonormal basis of the free parameters' Jacobian, shape ``(m, rank)``.
        residual: The projected residual, shape ``(m,)``.
        sensitivities: Sensitivities of the effects by key and shape, each of shape ``(m,)``.
    """
    by_effects = {
        stage: explained_share(
            basis, residual, [c for (key, _), c in sensitivities.items() if problem.effects[key].stage == stage]
        )
        for stage in STAGES
    }
    whole = (0.0, problem.duration)
    heat, material = (
        explained_share(basis, residual, node_sensitivities(problem, refit, KINDS.index(kind), "time", whole, KNOTS))
        for kind in (FreeHeat, FreeShift)
    )
    channel = explained_share(basis, residual, _channel_columns(problem))
    largest = max(by_effects["mechanism"], by_effects["sensor"], 1e-300)
    return {
        "drive": min(by_effects["drive"], max(heat, by_effects["heat"])),
        "heat": max(heat, by_effects["heat"]),
        "material": max(material, by_effects["material"]),
        "mechanism": max(by_effects["mechanism"], channel * by_effects["mechanism"] / largest),
        "sensor": max(by_effects["sensor"], channel * by_effects["sensor"] / largest),
    }


def most_likely_stage(shares: Mapping[str, float]) -> str | None:
    """Return the most upstream stage whose share comes near the largest; ``None`` if all shares are next to 0."""
    largest = max(shares.values())
    if largest <= _NO_STAGE:
        return None
    return next(stage for stage in STAGES if shares[stage] >= max(largest - _TIE, _TIE_FRACTION * largest))


def explained_share(basis: np.ndarray, residual: np.ndarray, columns: Sequence[np.ndarray]) -> float:
    """Return the share of a projected residual that columns explain beyond the basis (adjusted R squared)."""
    total, n = float(residual @ residual), len(residual)
    projected = [
        p
        for c in columns
        if np.linalg.norm(p := project_out(basis, c)) > _MIN_REMAINING * max(np.linalg.norm(c), 1e-300)
    ]
    if not projected or total <= 0.0:
        return 0.0
    own = orthonormal_basis(np.column_stack(projected))
    explained, p = float(np.sum((own.T @ residual) ** 2)) / total, own.shape[1]
    return float(np.clip(1.0 - (1.0 - explained) * (n - 1) / max(n - p - 1, 1), 0.0, 1.0))


def node_unit(problem: DiagnosisProblem, kind: int) -> float:
    """Return the value of a node that counts as one, in the unit of a row of ``nonparametric.KINDS``."""
    plant = problem.problems[TRAIN].plant
    conductance = float(plant.heat.conductance(plant.environment.ambient, plant.wire))
    units = {FreeHeat: _HEAT_UNIT_KELVIN * conductance, FreeShift: _SHIFT_UNIT, FreeStrain: _STRAIN_UNIT}
    return units[KINDS[kind]]


def node_matrix(nodes: int) -> np.ndarray:
    """Return the matrix that makes knots of equally spaced nodes, shape ``(KNOTS, nodes)``."""
    return hat_functions(np.linspace(0.0, 1.0, KNOTS), nodes)


def node_sensitivities(
    problem: DiagnosisProblem, refit: Refit, kind: int, variable: str, span: tuple[float, float], nodes: int
) -> list[np.ndarray]:
    """Differentiate the training residual with respect to each node of a nonparametric term.

    Args:
        problem: The diagnosis problem.
        refit: The refit to which the term is added.
        kind: Row of ``nonparametric.KINDS``.
        variable: Word of ``nonparametric.VARIABLES``.
        span: Range of the variable.
        nodes: Number of nodes; as many as there are slots share a simulation.
    """
    matrix = node_matrix(nodes) * node_unit(problem, kind)
    terms = [NonparametricTerm(kind, variable, *span, matrix[:, k : k + SLOTS]) for k in range(0, nodes, SLOTS)]
    blocks = map_in_pairs(
        lambda term: problem.evaluate(refit.effect_set, refit.base, TRAIN, (), term)[1][:, problem.size :], terms
    )
    return [problem.counted_samples(derivative) for block in blocks for derivative in block.T]


def _channel_columns(problem: DiagnosisProblem) -> list[np.ndarray]:
    """Hat functions of time added to each channel."""
    lengths = [len(v) for v in problem.series(np.zeros(problem.problems[TRAIN].data.measured.size)).values()]
    zeros, columns = np.zeros(sum(lengths)), []
    for first, length in zip(np.cumsum([0, *lengths]), lengths, strict=False):
        for hat in hat_functions(np.linspace(0.0, 1.0, length), KNOTS).T:
            columns.append(zeros.copy())
            columns[-1][first : first + length] = hat
    return columns
