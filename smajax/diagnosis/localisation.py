"""Localisation: the stage of the plant that a residual can come from.

A piecewise linear function of time is added in turn as heat, as a shift of the transformation temperatures, and to each
channel. The share of the residual that it explains beyond the free parameters, an adjusted R squared, is the share of
that stage. Drive, mechanism and sensor have no such function of their own: an error of the current acts as heat, and
mechanism and sensor both act on the channel. The sensitivities of their effects decide between them.
"""

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from jaxtyping import Float

from smajax.diagnosis.candidates import NonparametricTerm, Refit
from smajax.diagnosis.compiled_model import SLOTS
from smajax.diagnosis.data_split import TRAIN
from smajax.diagnosis.nonparametric import KINDS, KNOTS, FreeHeat, FreeShift, FreeStrain, hat_functions
from smajax.diagnosis.problem import DiagnosisProblem
from smajax.diagnosis.screening import orthonormal_basis, project_out
from smajax.numerics.ensemble import share_among_cores

STAGES = ("drive", "heat", "material", "mechanism", "sensor")
# A stage ties with the one of the largest share if its share is within the first number of the largest, or at least the
# second times the largest. Of tied stages the most upstream is named, since a cause there acts on all that follow. 0.1
# is chosen by trial.
_TIE = 0.1
_TIE_FRACTION = 0.5
# Largest share up to which no stage is named. Chosen by trial; tests/unit/diagnosis holds it.
_NO_STAGE = 0.02
# Least share of a column's norm that remains after projection; below it the remainder is rounding.
_MIN_REMAINING = 1e-3
# Units of the nodes, which make their values of order one: 10 K times the heat balance's conductance, 1 K, and a strain
# of 0.01 %.
_HEAT_UNIT_KELVIN = 10.0
_SHIFT_UNIT = 1.0
_STRAIN_UNIT = 1e-4


def stage_shares(
    problem: DiagnosisProblem,
    refit: Refit,
    basis: Float[np.ndarray, "m rank"],
    residual: Float[np.ndarray, " m"],
    sensitivities: Mapping[Any, Any],
) -> dict[str, float]:
    """Compute the share of a residual that each stage can explain.

    Args:
        problem: The diagnosis problem.
        refit: The refit that leaves the residual.
        basis: Orthonormal basis of the free parameters' Jacobian, shape ``(m, rank)``.
        residual: The projected residual, shape ``(m,)``.
        sensitivities: Sensitivities of the effects by key and shape, each of shape ``(m,)``.

    Returns:
        The share, from 0 to 1, of each of ``STAGES``.
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
    """Return the most upstream stage whose share ties with the largest; ``None`` if all shares are nearly 0.

    Args:
        shares: The share of each of ``STAGES``.
    """
    largest = max(shares.values())
    if largest <= _NO_STAGE:
        return None
    return next(stage for stage in STAGES if shares[stage] >= max(largest - _TIE, _TIE_FRACTION * largest))


def explained_share(
    basis: Float[np.ndarray, "m rank"], residual: Float[np.ndarray, " m"], columns: Sequence[Float[np.ndarray, " m"]]
) -> float:
    """Compute the share of a projected residual that columns explain beyond a basis (adjusted R squared).

    With R^2 the share of the squares in the span of the p projected columns, of n samples, it is
    1 - (1 - R^2) (n - 1) / (n - p - 1), clipped to 0 and 1.

    Args:
        basis: Orthonormal basis of the free parameters' Jacobian, shape ``(m, rank)``.
        residual: The projected residual, shape ``(m,)``.
        columns: The columns, each of shape ``(m,)``, not projected.
    """
    total, n = float(residual @ residual), len(residual)
    projected = [
        p
        for c in columns
        if np.linalg.norm(p := project_out(basis, c)) > _MIN_REMAINING * max(np.linalg.norm(c), 1e-300)
    ]
    if not projected or total <= 0.0:
        return 0.0
    column_basis = orthonormal_basis(np.column_stack(projected))
    r_squared, p = float(np.sum((column_basis.T @ residual) ** 2)) / total, column_basis.shape[1]
    return float(np.clip(1.0 - (1.0 - r_squared) * (n - 1) / max(n - p - 1, 1), 0.0, 1.0))


def node_unit(problem: DiagnosisProblem, kind: int) -> float:
    """Return the unit of the nodes of a nonparametric term: W/m^3 for heat, K for a shift, 1 for a strain.

    Args:
        problem: The diagnosis problem.
        kind: Row of ``nonparametric.KINDS``.
    """
    plant = problem.problems[TRAIN].plant
    conductance = float(plant.heat.conductance(plant.environment.ambient, plant.wire))
    units = {FreeHeat: _HEAT_UNIT_KELVIN * conductance, FreeShift: _SHIFT_UNIT, FreeStrain: _STRAIN_UNIT}
    return units[KINDS[kind]]


def node_matrix(nodes: int) -> Float[np.ndarray, "knots nodes"]:
    """Return the matrix that interpolates the knots from equally spaced nodes, shape ``(KNOTS, nodes)``."""
    return hat_functions(np.linspace(0.0, 1.0, KNOTS), nodes)


def node_sensitivities(
    problem: DiagnosisProblem, refit: Refit, kind: int, variable: str, span: tuple[float, float], nodes: int
) -> list[Float[np.ndarray, " m"]]:
    """Differentiate the training residual with respect to each node of a nonparametric term.

    Args:
        problem: The diagnosis problem.
        refit: The refit to which the term is added.
        kind: Row of ``nonparametric.KINDS``.
        variable: Word of ``nonparametric.VARIABLES``.
        span: Lowest and highest value of the variable.
        nodes: Number of nodes; ``SLOTS`` of them share a simulation.

    Returns:
        The derivative with respect to each node in units of ``node_unit``, each of shape ``(m,)``.
    """
    matrix = node_matrix(nodes) * node_unit(problem, kind)
    terms = [NonparametricTerm(kind, variable, *span, matrix[:, k : k + SLOTS]) for k in range(0, nodes, SLOTS)]
    blocks = share_among_cores(
        lambda term: problem.evaluate(refit.effect_set, refit.base, TRAIN, (), term)[1][:, problem.size :], terms
    )
    return [problem.counted_samples(derivative) for block in blocks for derivative in block.T]


def _channel_columns(problem: DiagnosisProblem) -> list[np.ndarray]:
    """Hat functions of time of each channel, as columns of all scored samples."""
    lengths = [len(v) for v in problem.series(np.zeros(problem.problems[TRAIN].data.measured.size)).values()]
    zeros, columns = np.zeros(sum(lengths)), []
    for first, length in zip(np.cumsum([0, *lengths]), lengths, strict=False):
        for hat in hat_functions(np.linspace(0.0, 1.0, length), KNOTS).T:
            columns.append(zeros.copy())
            columns[-1][first : first + length] = hat
    return columns
