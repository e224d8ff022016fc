"""What an input can show of each effect, before anything is fitted: testable, absorbed by free parameters, or blind."""

import dataclasses
import math
from typing import NamedTuple

import numpy as np

from smajax.diagnosis.candidates import EffectSet
from smajax.diagnosis.data_split import TRAIN
from smajax.diagnosis.problem import DiagnosisProblem
from smajax.diagnosis.screening import Score, orthonormal_basis, project_out
from smajax.diagnosis.sensitivities import effect_sensitivities
from smajax.plant.effects import catalogue
from smajax.plant.effects.base import AbstractEffect

# Share of an effect's squared sensitivity that the parameters named as its absorbers have to explain together: a list
# that is short and explains all that one would see in a plot. Chosen by trial; only the words of the report depend on
# it.
_ABSORBED_SHARE = 0.99


@dataclasses.dataclass(frozen=True)
class Detectability:
    """What the training input can show of one effect.

    ``status`` is "testable", "absorbed" (the parameters ``absorbed_by`` have the same influence) or "blind" (``why``
    says so); ``minimum_detectable_strength`` is the detectable strength, SI, that exceeds the noise 3.5 times.
    """

    key: str
    stage: str
    unit: str
    status: str
    minimum_detectable_strength: float | None
    absorbed_by: tuple[str, ...]
    why: str


class NominalScore(NamedTuple):
    """What an effect would explain of the residual at the rig's own values, to first order, beyond the free parameters.

    ``gain`` is the fall of chi-squared; ``strength``, in units of the typical one, and ``shape`` are those of the
    largest gain.
    """

    gain: float
    strength: float
    shape: tuple


def assess_detectability(problem: DiagnosisProblem) -> tuple[dict[str, Detectability], dict[str, NominalScore]]:
    """Assess every effect of the catalogue at the rig's own values, with the problem's noise.

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
        for key, kind in catalogue().items()
    }
    return detectability, nominal_scores


def detectability_from_score(
    kind: type[AbstractEffect], score: Score, sensitivity: np.ndarray, jacobian: np.ndarray, names: list[str]
) -> Detectability:
    """Classify an effect as testable, absorbed or blind by its score.

    Args:
        kind: The effect.
        score: Its score.
        sensitivity: Its sensitivity, shape ``(m,)``, not projected.
        jacobian: Jacobian of the free parameters, shape ``(m, p)``.
        names: Their names, of which the absorbers are listed.
    """

    def with_status(status: str, absorbed_by: tuple[str, ...] = (), why: str = "") -> Detectability:
        return Detectability(kind.key, kind.stage, kind.unit(), status, detectable, absorbed_by, why)

    largest_plausible = max(map(abs, kind.plausible_range())) / kind.typical
    detectable = score.minimum_detectable_strength
    detectable = detectable * kind.typical if math.isfinite(detectable) else None
    if score.absorbed_fraction >= kind.absorbed_from:
        return with_status("absorbed", absorbed_by=find_absorbers(sensitivity, jacobian, names))
    if not score.minimum_detectable_strength < largest_plausible:
        return with_status("blind", why="this input does not show it at any plausible strength")
    return with_status("testable")


def undetectable(problem: DiagnosisProblem, kind: type[AbstractEffect]) -> Detectability:
    """Return the detectability of an effect that the rig file models, or that the rig cannot have or show."""
    reason = kind.unavailable_reason(problem.capabilities)
    why = reason if kind.no_mean_effect else f"this rig cannot show it: {reason}"
    why = "the rig file has it" if kind.key in problem.modelled_effects else why
    return Detectability(kind.key, kind.stage, kind.unit(), "blind", None, (), why)


def find_absorbers(sensitivity: np.ndarray, jacobian: np.ndarray, names: list[str]) -> tuple[str, ...]:
    """Find few parameters, greedily, that together have all but 1 % of an effect's influence.

    Args:
        sensitivity: The effect's sensitivity, shape ``(m,)``.
        jacobian: Jacobian of the parameters, shape ``(m, p)``.
        names: Their names; without names nothing is searched for.
    """
    total, chosen = float(sensitivity @ sensitivity), []
    size = np.linalg.norm(jacobian, axis=0)
    while len(chosen) < len(names):
        basis = orthonormal_basis(jacobian[:, chosen])
        remaining = project_out(basis, sensitivity)
        if remaining @ remaining <= (1.0 - _ABSORBED_SHARE) * total:
            break
        others = [i for i in range(len(names)) if i not in chosen and size[i] > 0]
        if not others:
            break
        projected = [project_out(basis, jacobian[:, i]) for i in others]
        correlation = [abs(p @ remaining) / max(np.linalg.norm(p), 1e-300) for p in projected]
        chosen.append(others[int(np.argmax(correlation))])
    return tuple(names[i] for i in sorted(chosen))
