"""Other material laws as explanations of a residual: is the law wrong, or is an effect missing?

Every other law of the package replaces that of the rig, with the parameters that both share and those that it adds, and
is fitted to the same training split, without further effects. Its prediction of the selection split is compared with
those of the rig's law, without effects and with the effects and the structure that were found.
"""

import dataclasses
import functools
import math
from typing import Literal, NamedTuple

import jax.numpy as jnp
import numpy as np
from jaxtyping import Float

from smajax import parameters
from smajax.diagnosis.bootstrap import bootstrap_cut
from smajax.diagnosis.candidate_evaluation import CandidateEvaluator
from smajax.diagnosis.candidates import CandidateFit
from smajax.diagnosis.data_split import SELECT, TRAIN
from smajax.diagnosis.problem import DiagnosisProblem
from smajax.diagnosis.problem_layout import GriddedSplits
from smajax.diagnosis.support import MIN_FACT_SHARE
from smajax.errors import InputError
from smajax.fitting import abstract_problem
from smajax.fitting.levenberg_marquardt import SolverStatus
from smajax.fitting.material_laws import law_name, with_law
from smajax.fitting.multi_start import MultiStartSolver
from smajax.numerics.ensemble import share_among_cores
from smajax.plant.materials.registry import MATERIALS
from smajax.plant.plant import Plant

# Least relative fall of the error on the selection split by which one law is better than another: twice the 5 %
# that an effect needs (``acceptance.MIN_SELECT_CUT``), since a law adds parameters.
MIN_LAW_CUT = 0.1
# Error of a law on the selection split over that on the training split up to which the training split determines its
# parameters: beyond it, laws are not compared. Chosen by trial on single rough rigs.
_MAX_GROWTH = 3.0
# Relative fall of the cost at which the search of another law ends, and its largest number of steps: a right law ends
# at the noise after fewer. Chosen by trial; experiments/diagnosis/other_laws.py prints how many laws are recognised.
_RTOL = 1e-6
_STEPS = 50

Cause = Literal["none", "law", "effect", "either", "part"]


class LawFit(NamedTuple):
    """A fit of another law to the training split.

    Attributes:
        name: The law, as in ``MATERIALS``.
        error: Error on the selection split over the noise; infinite if the fit or the prediction fails.
        train_error: Error on the training split over the noise; infinite if the fit fails.
        residual: Residual of the selection split over the noise, channel after channel, shape ``(scored,)``.
        plant: The fitted plant.
    """

    name: str
    error: float
    train_error: float
    residual: Float[np.ndarray, " scored"]
    plant: Plant

    @property
    def is_determined(self) -> bool:
        """Whether the training split determines the law's parameters, so that its predictions can be compared."""
        return self.error <= _MAX_GROWTH * max(self.train_error, 1.0)


@dataclasses.dataclass(frozen=True)
class LawComparison:
    """Comparison of the rig's law with others on the selection split.

    Attributes:
        own: The law of the rig; empty if it is not registered.
        errors: Error over the noise, of the rig's law without effects ("" if it is not registered) and of each other
            law; infinite where the fit or the prediction fails.
        error_with_effects: Error over the noise of the rig's law with the effects and the structure that were found.
        better: The best law, if it predicts clearly better than that of the rig does without effects.
        cut: 95 % interval of the fall of the error by that law, over the noise; NaN if the rig's law predicts nothing.
        cause: "none": no law is better; "law": the better one explains most of the excess, and more than effects do;
            "effect": effects next to the rig's law explain more; "either": the split does not distinguish these, or
            the training split does not determine the better law's parameters;
            "part": the better law explains a small part of the excess only.
        plant: The plant with the better law, fitted; ``None`` if there is none.
        skipped: Reason by law that cannot be fitted.
    """

    own: str
    errors: dict[str, float]
    error_with_effects: float
    better: str | None
    cut: tuple[float, float]
    cause: Cause
    plant: Plant | None
    skipped: dict[str, str]

    @property
    def best_error(self) -> float:
        """Error of the better law over the noise; infinite without one."""
        return math.inf if self.better is None else self.errors[self.better]


class OtherLaws:
    """The other material laws of the package, fitted when they are first asked for.

    Args:
        rig: The evaluator of the rig without structure.
        base: Its fit without effects.
    """

    def __init__(self, rig: CandidateEvaluator, base: CandidateFit):
        self._rig, self._base = rig, base
        self._own = law_name(rig.problem.base_problem.plant) or ""
        self._skipped: dict[str, str] = {}

    def compare(self, evaluator: CandidateEvaluator, found: CandidateFit) -> LawComparison:
        """Decide whether the law is wrong or an effect is missing.

        Args:
            evaluator: The evaluator of the structure that was found.
            found: Its fit with the effects that were found.
        """
        before, after, seed = _prediction(self._rig, self._base), _prediction(evaluator, found), self._rig.seed
        errors = {self._own: _error(before)} | {f.name: f.error for f in self._fits}
        other = min(self._fits, key=lambda f: f.error, default=None)
        if other is None or not is_better(before, other.residual, seed):
            nothing = (None, (math.nan, math.nan), "none", None)
            return LawComparison(self._own, errors, _error(after), *nothing, self._skipped)
        cause, cut = _cause(before, after, other.residual, seed), bootstrap_cut(before, other.residual, seed)
        cause = "either" if cause == "law" and not other.is_determined else cause
        return LawComparison(self._own, errors, _error(after), other.name, cut, cause, other.plant, self._skipped)

    @functools.cached_property
    def _fits(self) -> list[LawFit]:
        """The fits of all laws that the rig's parameters can start."""

        def fit(name: str) -> LawFit | None:
            try:
                return _fit_law(self._rig.problem, self._base, name)
            except InputError as error:
                self._skipped[name] = str(error)
                return None

        fits = share_among_cores(fit, [name for name in MATERIALS if name != self._own])
        return [f for f in fits if f is not None]


def is_better(before: Float[np.ndarray, " n"], after: Float[np.ndarray, " n"], seed: int) -> bool:
    """Return whether a residual is smaller than another by at least 10 % and by more than chance.

    Args:
        before: The other residual over the noise, shape ``(n,)``; not finite if its simulation failed.
        after: The residual over the noise, shape ``(n,)``.
        seed: Seed of the bootstrap.
    """
    if not np.all(np.isfinite(after)):
        return False
    if not np.all(np.isfinite(before)):
        return True
    return _error(after) <= (1.0 - MIN_LAW_CUT) * _error(before) and bootstrap_cut(before, after, seed)[0] > 0.0


def _cause(before: np.ndarray, after: np.ndarray, other: np.ndarray, seed: int) -> Cause:
    """What explains a residual for which another law is better than that of the rig without effects."""
    if is_better(other, after, seed):
        return "effect"
    if not is_better(after, other, seed):
        return "either"
    excess, remaining = (max(_error(residual) ** 2 - 1.0, 0.0) for residual in (before, other))
    return "law" if remaining <= (1.0 - MIN_FACT_SHARE) * excess else "part"


def _error(residual: np.ndarray) -> float:
    """Root mean square of a residual; infinite where it is not finite."""
    value = float(np.sqrt(np.mean(residual**2)))
    return value if math.isfinite(value) else math.inf


def _prediction(evaluator: CandidateEvaluator, fit: CandidateFit) -> Float[np.ndarray, " scored"]:
    """Residual of the selection split over the noise."""
    problem = evaluator.problem
    return problem.counted_samples(problem.predict(fit.refit.effect_set, fit.refit.base, SELECT), SELECT)


def _fit_law(problem: DiagnosisProblem, base: CandidateFit, name: str) -> LawFit:
    """Fit a law from the rig's own values and from those of the base fit."""
    plant, settings = with_law(problem.base_problem.plant, problem.settings, name)
    splits = GriddedSplits(plant, problem.splits, settings, problem.grid_options)
    splits.set_noise(problem.noise)
    train, select = (splits.problems[k] for k in (TRAIN, SELECT))
    fitted = {n: float(v) for n, v in problem.problems[TRAIN].values(jnp.asarray(base.refit.base))[0].items()}
    near = [fitted.get(u.name, u.nominal) / u.scale for u in train.unknowns]
    lower, upper = train.bounds
    starts = np.clip(np.stack([train.nominal, np.array(near)]), lower, upper)
    solver = MultiStartSolver(abstract_problem.residual, train, starts, lower, upper, size=train.size, rtol=_RTOL)
    result = solver.advance(_STEPS).result()
    problem.count_simulations(result.simulations + 1)
    point = jnp.asarray(result.points[0])
    plant = parameters.replace(plant, {n: float(v) for n, v in train.values(point)[0].items()})
    if result.statuses[0] is SolverStatus.failed:
        return LawFit(name, math.inf, math.inf, np.full(1, math.nan), plant)
    fitted_residual, residual = (
        splits.counted_samples(np.asarray(abstract_problem.compiled_residual(point, split)), k)
        for k, split in ((TRAIN, train), (SELECT, select))
    )
    return LawFit(name, _error(residual), _error(fitted_residual), residual, plant)
