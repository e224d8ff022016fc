"""Detectability: what an input can show of each effect before a fit, namely testable, absorbed or blind.

- testable: its minimum detectable strength, 3.5 standard errors, is below the largest plausible strength.
- absorbed: a change of the free parameters has the same influence on the residual.
- blind: this input, or this rig, does not show it at any plausible strength.
"""

import dataclasses
import enum
import math
from typing import Any, NamedTuple

import numpy as np
from jaxtyping import Float

from smajax.diagnosis.candidates import EffectSet
from smajax.diagnosis.data_split import TRAIN
from smajax.diagnosis.problem import DiagnosisProblem
from smajax.diagnosis.screening import Score, orthonormal_basis, project_out
from smajax.diagnosis.sensitivities import effect_sensitivities
from smajax.plant.effects.base import AbstractEffect

# Share of an effect's squared sensitivity that its listed absorbers explain together: the list stays short, and the
# remainder would not show in a plot. Chosen by trial; only the text of the report depends on it.
_ABSORBED_SHARE = 0.99


class BlindCode(enum.StrEnum):
    """Why an effect is blind."""

    input = "input"  # this input does not show it at any plausible strength
    modelled = "modelled"  # the rig file has it
    needs = "needs"  # the rig lacks what the effect needs
    no_mean_effect = "no-mean-effect"  # it only adds scatter


@dataclasses.dataclass(frozen=True)
class Detectability:
    """What the training input can show of one effect.

    Attributes:
        key: Key of the effect.
        stage: Its stage: "drive", "heat", "material", "mechanism" or "sensor".
        unit: Unit of its strength.
        status: "testable", "absorbed" or "blind".
        minimum_detectable_strength: Strength, SI, that is 3.5 times its standard error; ``None`` if there is none.
        absorbed_by: Free parameters that have the same influence, where it is absorbed.
        blind_code: Why it is blind; ``None`` otherwise.
        missing: Capabilities that the effect needs and the rig lacks ("needs").
        explanation: The effect's own words why it has no mean effect ("no-mean-effect").
        excluding: Capabilities of the rig with which it cannot have the effect ("needs").
    """

    key: str
    stage: str
    unit: str
    status: str
    minimum_detectable_strength: float | None
    absorbed_by: tuple[str, ...] = ()
    blind_code: BlindCode | None = None
    missing: tuple[str, ...] = ()
    explanation: str = ""
    excluding: tuple[str, ...] = ()


class NominalScore(NamedTuple):
    """Score of an effect at the rig's own values, at the shape with the largest gain.

    Attributes:
        gain: Fall of chi-squared to first order, beyond that of the free parameters.
        strength: Expected strength in units of the typical strength.
        shape: Names and values of the shape parameters.
    """

    gain: float
    strength: float
    shape: tuple[Any, ...]


def assess_detectability(problem: DiagnosisProblem) -> tuple[dict[str, Detectability], dict[str, NominalScore]]:
    """Assess every effect at the rig's own values, with the problem's noise.

    Args:
        problem: The diagnosis problem.

    Returns:
        Detectability and nominal score of each effect by key; the latter only of effects that the rig can have.
    """
    nominal = problem.nominal
    residual, jacobian = problem.evaluate(EffectSet(), nominal, TRAIN)
    jacobian = np.column_stack([problem.counted_samples(derivative) for derivative in jacobian.T])
    basis = orthonormal_basis(jacobian)
    projected = project_out(basis, problem.counted_samples(residual))
    nominal_scores: dict[str, NominalScore] = {}
    sensitivities = effect_sensitivities(problem, EffectSet(), nominal)
    best: dict[str, tuple[Score, np.ndarray]] = {}
    for (key, shape), series in sensitivities.items():
        sensitivity = problem.counted_samples(series)
        score = problem.score_effect(key, basis, projected, sensitivity)
        if key not in nominal_scores or score.gain > nominal_scores[key].gain:
            nominal_scores[key] = NominalScore(score.gain, score.strength, shape)
        if key not in best or score.minimum_detectable_strength < best[key][0].minimum_detectable_strength:
            best[key] = (score, sensitivity)
    names = [u.label for u in problem.problems[TRAIN].unknowns]
    detectability = {
        key: detectability_from_score(kind, *best[key], jacobian, names) if key in best else undetectable(problem, kind)
        for key, kind in problem.effect_kinds.items()
    }
    return detectability, nominal_scores


def detectability_from_score(
    kind: type[AbstractEffect],
    score: Score,
    sensitivity: Float[np.ndarray, " m"],
    jacobian: Float[np.ndarray, "m p"],
    names: list[str],
) -> Detectability:
    """Classify an effect as testable, absorbed or blind by its score.

    Args:
        kind: The effect.
        score: Its score.
        sensitivity: Its sensitivity, shape ``(m,)``, not projected.
        jacobian: Jacobian of the free parameters, shape ``(m, p)``.
        names: Names of the free parameters; without names no absorbers are searched for.
    """

    def with_status(status: str, absorbed_by: tuple[str, ...] = (), code: BlindCode | None = None) -> Detectability:
        return Detectability(kind.key, kind.stage, kind.unit(), status, detectable, absorbed_by, code)

    largest_plausible = max(map(abs, kind.plausible_range())) / kind.typical
    detectable = score.minimum_detectable_strength
    detectable = detectable * kind.typical if math.isfinite(detectable) else None
    if score.absorbed_fraction >= kind.absorbed_from:
        return with_status("absorbed", absorbed_by=find_absorbers(sensitivity, jacobian, names))
    if not score.minimum_detectable_strength < largest_plausible:
        return with_status("blind", code=BlindCode.input)
    return with_status("testable")


def undetectable(problem: DiagnosisProblem, kind: type[AbstractEffect]) -> Detectability:
    """Return the detectability of an effect that the rig file already models, or that the rig cannot have or show.

    Args:
        problem: The diagnosis problem.
        kind: The effect.
    """
    missing = tuple(sorted(set(kind.needs) - problem.capabilities))
    excluding = tuple(sorted(set(kind.excluded_by) & problem.capabilities))
    code = BlindCode.no_mean_effect if kind.no_mean_effect else BlindCode.needs
    code = BlindCode.modelled if kind.key in problem.modelled_effects else code
    head = (kind.key, kind.stage, kind.unit(), "blind", None, (), code, missing, kind.no_mean_effect)
    return Detectability(*head, excluding)


def find_absorbers(
    sensitivity: Float[np.ndarray, " m"], jacobian: Float[np.ndarray, "m p"], names: list[str]
) -> tuple[str, ...]:
    """Find a few parameters that together absorb 99 % of an effect's squared sensitivity, by greedy selection.

    Each step adds the parameter whose projected column has the largest correlation with the remaining sensitivity.

    Args:
        sensitivity: Sensitivity of the effect, shape ``(m,)``.
        jacobian: Jacobian of the free parameters, shape ``(m, p)``.
        names: Names of the free parameters; without names nothing is searched for.

    Returns:
        The names of the parameters, in the order of ``names``.
    """
    total, chosen = float(sensitivity @ sensitivity), []
    norms = np.linalg.norm(jacobian, axis=0)
    while len(chosen) < len(names):
        basis = orthonormal_basis(jacobian[:, chosen])
        remaining = project_out(basis, sensitivity)
        if remaining @ remaining <= (1.0 - _ABSORBED_SHARE) * total:
            break
        candidates = [i for i in range(len(names)) if i not in chosen and norms[i] > 0]
        if not candidates:
            break
        projected = [project_out(basis, jacobian[:, i]) for i in candidates]
        correlation = [abs(p @ remaining) / max(np.linalg.norm(p), 1e-300) for p in projected]
        chosen.append(candidates[int(np.argmax(correlation))])
    return tuple(names[i] for i in sorted(chosen))
