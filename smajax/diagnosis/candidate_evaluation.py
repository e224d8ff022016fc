"""Evaluation of a fit: scores of the effects that it lacks, refits, and their prediction of the selection split."""

import dataclasses
import math
from typing import Any

import numpy as np

from smajax.diagnosis.candidates import CandidateFit, EffectSet, Refit, RefitSearch
from smajax.diagnosis.data_split import SELECT, TRAIN
from smajax.diagnosis.localisation import stage_shares
from smajax.diagnosis.plausibility import absent_effects
from smajax.diagnosis.problem import DiagnosisProblem
from smajax.diagnosis.screening import (
    Score,
    noise_model,
    null_max_distribution,
    orthonormal_basis,
    project_out,
    whiten,
)
from smajax.diagnosis.sensitivities import EffectShape, effect_sensitivities
from smajax.diagnosis.step_errors import step_length_error, stride_error
from smajax.fitting.levenberg_marquardt import SolverStatus
from smajax.numerics.ensemble import share_among_cores

# Distances of the samples that a search may use, the largest first.
_STRIDES = (16, 8, 4, 2)
# Reduced chi-squared above which a search may use fewer samples and longer steps; nearer to the noise every sample is
# needed. Chosen by trial; tests/unit/diagnosis holds it.
FAR_FROM_NOISE = 9.0
# Largest mean square error by longer steps as a share of the reduced chi-squared: a tenth of the residual. Chosen by
# trial.
_MAX_STEP_ERROR = 0.01
# Distance from a bound, relative to 1 plus the absolute value, up to which a parameter is on it: rounding.
_ON_BOUND = 1e-9
# Largest number of steps of a refit to convergence, and its relative tolerances; on some of the samples the optimum
# need not be exact. Chosen by trial.
_CONVERGENCE_STEPS = 60
_CONVERGENCE_RTOL = 1e-9
_CONVERGENCE_RTOL_STRIDED = 1e-6


@dataclasses.dataclass(frozen=True)
class Scores:
    """Scores of all effects at one fit; arrays have one row for each of the m scored samples.

    Attributes:
        best: Score of each effect, by key, at the shape with the largest gain.
        shapes: That shape of each effect, by key.
        sensitivities: Sensitivities by effect and shape, not projected, each of shape ``(m,)``.
        jacobian: Jacobian of the free parameters, shape ``(m, p)``.
        basis: Orthonormal basis of the Jacobian, shape ``(m, rank)``.
        residual: Projected residual over the noise, shape ``(m,)``.
        p_values: Probability by effect that noise gives any effect so large a gain.
    """

    best: dict[str, Score]
    shapes: dict[str, tuple[Any, ...]]
    sensitivities: dict[EffectShape, np.ndarray]
    jacobian: np.ndarray
    basis: np.ndarray
    residual: np.ndarray
    p_values: dict[str, float]

    @property
    def p_value(self) -> float:
        """p-value of the largest gain; 1 without effects."""
        return min(self.p_values.values(), default=1.0)


class CandidateEvaluator:
    """Scores, refits and evaluates candidates on a diagnosis problem.

    Args:
        problem: The diagnosis problem.
        seed: Seed of the null distribution of the scores.
    """

    def __init__(self, problem: DiagnosisProblem, seed: int):
        self.problem: DiagnosisProblem = problem
        self.seed: int = seed
        self._stride_errors: dict[int, float] = {}

    def on(self, problem: DiagnosisProblem) -> "CandidateEvaluator":
        """Return an evaluator of the same recordings on a problem of the same programs, with the same strides."""
        evaluator = CandidateEvaluator(problem, self.seed)
        evaluator._stride_errors = self._stride_errors
        return evaluator

    def base_refit(self, point: np.ndarray, status: SolverStatus) -> Refit:
        """Make a refit without effects, and measure which step lengths and strides are accurate enough there.

        Args:
            point: The base vector, shape ``(p,)``.
            status: Status of the search that ended there.
        """
        self.problem.wait_for_compilation()

        def evaluate() -> Refit:
            empty = EffectSet()
            return Refit(empty, point, *self.problem.evaluate(empty, point, TRAIN), status)

        refit = evaluate()
        before = self.problem.problems[TRAIN]
        # Several steps for each sample are more accurate than most recordings need.
        self.problem.lengthen_steps(lambda longer: step_length_error(self.problem, refit, longer) < _MAX_STEP_ERROR)
        refit = refit if self.problem.problems[TRAIN] is before else evaluate()
        self._stride_errors = {stride: stride_error(self.problem, refit, stride) for stride in _STRIDES}
        return refit

    def stride(self, reduced_chi2: float) -> int:
        """Return the largest distance of samples with which a search is accurate enough at a reduced chi-squared."""
        errors = self._stride_errors.items()
        accurate = (k for k, e in errors if e < _MAX_STEP_ERROR * reduced_chi2 and reduced_chi2 > FAR_FROM_NOISE)
        return next(accurate, 1)

    def free_columns(self, refit: Refit, *, jointly: bool = False) -> np.ndarray:
        """Return a mask of the Jacobian's columns: true for parameters that are neither held nor pressed on a bound.

        Args:
            refit: The refit; its effect parameters count as free.
            jointly: Whether it is one to training and selection split together.
        """
        lower, upper = self.problem.joint_bounds if jointly else self.problem.bounds
        gradient = refit.jacobian[:, : self.problem.size].T @ refit.residual
        margin = _ON_BOUND * (1 + np.abs(refit.base))
        pressed = (
            ((refit.base <= lower + margin) & (gradient > 0))
            | ((refit.base >= upper - margin) & (gradient < 0))
            | (lower == upper)
        )
        return np.append(~pressed, np.ones(refit.jacobian.shape[1] - self.problem.size, bool))

    def scores(self, refit: Refit) -> Scores:
        """Score every effect that a refit lacks, at each of its shapes (``screening.score_test``)."""
        problem = self.problem
        columns = refit.jacobian[:, self.free_columns(refit)].T
        jacobian = np.column_stack([problem.counted_samples(derivative) for derivative in columns])
        basis = orthonormal_basis(jacobian)
        residual = project_out(basis, problem.counted_samples(refit.residual))
        derivatives = effect_sensitivities(problem, refit.effect_set, refit.base)
        sensitivities = {item: problem.counted_samples(derivative) for item, derivative in derivatives.items()}
        best: dict[str, Score] = {}
        shapes: dict[str, tuple[Any, ...]] = {}
        for (key, shape), sensitivity in sensitivities.items():
            score = problem.score_effect(key, basis, residual, sensitivity)
            if key not in best or score.gain > best[key].gain:
                best[key], shapes[key] = score, shape
        p_values = self._p_values(refit, jacobian, sensitivities)
        return Scores(best, shapes, sensitivities, jacobian, basis, residual, p_values)

    def _p_values(
        self, refit: Refit, jacobian: np.ndarray, sensitivities: dict[EffectShape, np.ndarray]
    ) -> dict[str, float]:
        """p-values by effect, after whitening by the residual's own autocorrelation."""
        problem = self.problem
        series = list(problem.series(refit.residual).values())
        models = [noise_model(s) for s in series]
        cuts = np.cumsum([len(s) for s in series])[:-1]

        def white(v: np.ndarray) -> np.ndarray:
            return np.concatenate([whiten(p, m[0]) / m[1] for p, m in zip(np.split(v, cuts), models, strict=True)])

        basis = orthonormal_basis(np.column_stack([white(c) for c in jacobian.T]))
        residual = project_out(basis, white(problem.counted_samples(refit.residual)))
        scores = {item: problem.score_effect(item[0], basis, residual, white(c)) for item, c in sensitivities.items()}
        detectable = {item: s for item, s in scores.items() if math.isfinite(s.minimum_detectable_strength)}
        plausible = {item: problem.plausible_range(item[0]) for item in detectable}
        by_noise = null_max_distribution({item: s.sensitivity for item, s in detectable.items()}, plausible, self.seed)
        gains = dict.fromkeys((key for key, _ in sensitivities), 0.0)
        for (key, _), score in detectable.items():
            gains[key] = max(gains[key], score.gain)
        return {key: float(np.mean(by_noise >= gain)) for key, gain in gains.items()}

    def stage_shares(self, refit: Refit, scores: Scores) -> dict[str, float]:
        """Return the share of a refit's residual that each stage can explain.

        Args:
            refit: The refit.
            scores: Its scores.
        """
        return stage_shares(self.problem, refit, scores.basis, scores.residual, scores.sensitivities)

    def fit(
        self, effect_set: EffectSet, base: np.ndarray, stride: int, *, max_steps: int = 25, rtol: float = 1e-5
    ) -> Refit:
        """Fit a set of effects to the training split, from a base vector and the set's own values.

        All parameters of the effects are free. The search ends on all samples, unless the residual is so large that
        fewer are enough.

        Args:
            effect_set: The effects, with start values of their parameters.
            base: Start of the base vector, shape ``(p,)``.
            stride: Distance of the samples with which the search starts.
            max_steps: Largest number of steps with them.
            rtol: Relative fall of the cost at which the search ends.
        """
        free = tuple(self.problem.free_effect_parameters(effect_set))
        search = self.problem.start_search(effect_set, base, free=free, rtol=rtol, stride=stride)
        return self.problem.refit_from(self.continue_if_needed(search.advance(max_steps)))

    def continue_if_needed(self, search: RefitSearch) -> RefitSearch:
        """Continue a search on all samples, unless its residual is so large that its own samples are enough."""
        is_accurate = search.stride > 1 and self.stride(search.cost / self.problem.samples) >= search.stride
        return search if is_accurate else self.problem.continue_on_all_samples(search)

    def with_all_parameters_free(self, fit: CandidateFit) -> CandidateFit:
        """Refit until convergence if the search for a fit has held some of its effects' parameters; else return it."""
        return self.refit_to_convergence(fit) if self.problem.holds_parameters(fit.refit) else fit

    def refit_to_convergence(self, fit: CandidateFit) -> CandidateFit:
        """Refit until convergence, from the fit's point and, unless it is at the noise, from the nominal values."""
        effect_set, stride = fit.refit.effect_set, self.stride(fit.train_chi2)
        starts = [fit.refit.base, self.problem.nominal][: 1 if fit.at_noise else 2]
        rtol = _CONVERGENCE_RTOL if stride == 1 else _CONVERGENCE_RTOL_STRIDED
        refits = share_among_cores(
            lambda base: self.fit(effect_set, base, stride, max_steps=_CONVERGENCE_STEPS, rtol=rtol), starts
        )
        return self.evaluate(min(refits, key=lambda r: r.chi2))

    def evaluate(self, refit: Refit) -> CandidateFit:
        """Compute the errors of a refit on training and selection split."""
        problem = self.problem
        predicted = problem.predict(refit.effect_set, refit.base, SELECT)
        channel = problem.channels[0]
        reported, _ = problem.report(refit, SELECT)
        rmse = float(np.sqrt(np.mean(problem.series(reported, SELECT)[channel] ** 2))) * problem.noise[channel]
        train = problem.reduced_chi2(refit.residual, TRAIN) if math.isfinite(refit.chi2) else math.inf
        return CandidateFit(refit, train, problem.reduced_chi2(predicted, SELECT), rmse)

    def is_negligible(self, fit: CandidateFit) -> bool:
        """Return whether the strength of a fit's last effect is almost 0, so that other parameters improve the fit."""
        return fit.key in absent_effects(self.problem, fit.refit)

    def log_distance_from_typical(self, fit: CandidateFit) -> float:
        """Return the squared logarithmic distance of a fit's last effect from its typical strength and shapes.

        It is the sum of the squares of log(strength / typical strength) and, for each shape but an onset time or a
        place, of the logarithm of its ratio to the nearest usual value.
        """
        effect, values = self.problem.effects[fit.key], fit.refit.values
        distance = math.log(max(abs(values[f"effects.{fit.key}.strength"]) / effect.typical, 1e-9)) ** 2
        for name, usual in effect.shapes:
            value = values.get(f"effects.{fit.key}.{name}", usual[0])
            if name not in ("instant", "place") and min(value, *usual) > 0.0:
                distance += math.log(value / min(max(value, min(usual)), max(usual))) ** 2
        return distance
