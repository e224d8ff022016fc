"""The result of a diagnosis in numbers: errors before and after, intervals, and excluded effects."""

import dataclasses
import math
from collections.abc import Mapping
from typing import NamedTuple

import numpy as np

from smajax.diagnosis.acceptance import Rejection, RejectionCode
from smajax.diagnosis.bootstrap import bootstrap_cut
from smajax.diagnosis.candidate_evaluation import CandidateEvaluator
from smajax.diagnosis.candidates import Refit
from smajax.diagnosis.data_split import HOLDOUT, SELECT, SPLIT_NAMES, TRAIN
from smajax.diagnosis.detectability import Detectability, detectability_from_score
from smajax.diagnosis.error_budget import BudgetEntry, second_half
from smajax.diagnosis.next_experiment import NextExperiment
from smajax.diagnosis.nonparametric_fit import NonparametricFit
from smajax.diagnosis.other_laws import LawComparison
from smajax.diagnosis.plausibility import implausible_estimates
from smajax.diagnosis.problem import DiagnosisProblem
from smajax.diagnosis.residual_checks import ResidualStatistics, residual_statistics
from smajax.diagnosis.screening import NORMAL_95, half_width_95
from smajax.diagnosis.selection_state import CandidateSummary, SelectionState, Support
from smajax.diagnosis.step_errors import estimate_step_error
from smajax.diagnosis.structure import UNIFORM, Structure, structured_plant
from smajax.files.plausible_ranges import ImplausibleValue, plausible_range
from smajax.fitting.intervals import covariance_under_autocorrelation
from smajax.fitting.residual_offsets import ResidualOffset
from smajax.parameters import declarations
from smajax.plant.plant import Plant
from smajax.simulation.status import SimulationStatus


@dataclasses.dataclass(frozen=True)
class Conclusion:
    """The conclusion of a diagnosis.

    Attributes:
        verdict: "named", "named-up-to-class", "partial", "unresolved" or "nothing-missing".
        unresolved_stage: The stage that an unexplained residual comes from.
        nonparametric_fit: The form of an unexplained residual.
        next_experiment: The input to run next.
        holdout_decided: Whether the first half of the holdout decided that the effects stay or are rejected.
        structure: The structure of the wire.
        error_budget: Errors by what was added to the model.
        law: Comparison with other material laws; ``None`` where it was not asked for.
    """

    verdict: str
    unresolved_stage: str | None = None
    nonparametric_fit: NonparametricFit | None = None
    next_experiment: NextExperiment | None = None
    holdout_decided: bool = False
    structure: Structure = UNIFORM
    error_budget: tuple[BudgetEntry, ...] = ()
    law: LawComparison | None = None


@dataclasses.dataclass(frozen=True)
class EffectEstimate:
    """A fitted parameter of an accepted effect.

    Attributes:
        name: Its name, such as "effects.coating.time_constant".
        value: The estimate, SI.
        unit: Its unit.
        meaning: What it is.
        interval: 95 % interval, SI; ``None`` if the recordings do not determine it.
        plausible: Plausible range, SI: that of ``data/plausible-ranges.toml``, else the declared one.
    """

    name: str
    value: float
    unit: str
    meaning: str
    interval: tuple[float, float] | None
    plausible: tuple[float, float]


class FailedPrediction(NamedTuple):
    """A prediction that failed, or has states that no wire has.

    Attributes:
        when: "before" or "after" effects were added.
        split: Name of the split, one of ``SPLIT_NAMES``.
        status: Status code of the simulation.
    """

    when: str
    split: str
    status: SimulationStatus


@dataclasses.dataclass(frozen=True)
class Diagnosis:
    """The result of a diagnosis.

    Attributes:
        verdict: "named", "named-up-to-class", "partial", "unresolved" or "nothing-missing".
        effects: Keys of the effects that stand for the structure of the wire, and of the accepted effects.
        equivalent: For each accepted effect, those that explain the recordings as well.
        unresolved_stage: The stage that an unexplained residual comes from.
        detectability: What the training input can show of each effect.
        ranking: Summary of each effect after the first round.
        excluded: Effects that would have been detected from their minimum detectable strength on.
        stage_shares: Share of the base fit's residual that each stage can explain.
        noise: Standard deviation of each channel, SI, and its source.
        before: The base fit, fitted to training and selection split together.
        after: The fit with the accepted effects, fitted likewise.
        base_fit_converged: Whether the base fit of the training split converged.
        reduced_chi2: Reduced chi-squared of ``before`` and ``after`` on the training split, and its limit.
        rmse: RMSE, SI, by channel and "train_before", ..., "holdout_after".
        cut95: 95 % interval of the fall of the holdout's RMSE, SI, by channel; of its second half, which has no part in
            any choice, where ``holdout_decided`` is true.
        holdout_decided: Whether the first half of the holdout had a part in the choice of the effects: where they leave
            more than noise, they are rejected unless they improve it.
        rejected: Effects that were not accepted, and why.
        intervals: 95 % intervals of the effects' parameters, SI.
        estimates: All fitted parameters of the accepted effects.
        predictions: Measurement minus model at the scored samples, SI, by "before" and "after", split and channel.
        residual_statistics: Statistics of the training residual by "before" and "after", and channel.
        nonparametric_fit: The form of an unexplained residual.
        next_experiment: The input to run next.
        interrupted: Whether the progress callback ended the diagnosis early.
        failures: Predictions of ``before`` and ``after`` that failed; their errors are NaN.
        implausible: Parameters of ``after`` outside of what an alloy can have.
        structure: The structure of the wire that was found.
        supports: Evidence for each effect that was accepted at first: facts, then candidates.
        plant: The plant of ``after``; ``None`` where it was not built.
        error_budget: Errors by what was added to the model; empty if the diagnosis was stopped before.
        law: Comparison with other material laws; ``None`` where it was not asked for.
        offsets: Offsets of sensors that explain the base fit's residual above the noise, without any effect.
        rising_convection: Coefficients of h(T) that were bounded at 0 (module ``rising_convection``).
    """

    verdict: str
    effects: tuple[str, ...]
    equivalent: dict[str, tuple[str, ...]]
    unresolved_stage: str | None
    detectability: tuple[Detectability, ...]
    ranking: tuple[CandidateSummary, ...]
    excluded: tuple[Detectability, ...]
    stage_shares: dict[str, float]
    noise: dict[str, tuple[float, str]]
    before: Refit
    after: Refit
    base_fit_converged: bool
    reduced_chi2: tuple[float, float, float]
    rmse: dict[str, dict[str, float]]
    cut95: dict[str, tuple[float, float]]
    holdout_decided: bool
    rejected: tuple[Rejection, ...]
    intervals: dict[str, tuple[float, float]]
    estimates: tuple[EffectEstimate, ...]
    predictions: dict[str, list[dict[str, np.ndarray]]]
    residual_statistics: dict[str, dict[str, ResidualStatistics]]
    nonparametric_fit: NonparametricFit | None
    next_experiment: NextExperiment | None
    interrupted: bool
    failures: tuple[FailedPrediction, ...] = ()
    implausible: tuple[ImplausibleValue, ...] = ()
    structure: Structure = UNIFORM
    supports: tuple[Support, ...] = ()
    plant: Plant | None = None
    error_budget: tuple[BudgetEntry, ...] = ()
    law: LawComparison | None = None
    offsets: tuple[ResidualOffset, ...] = ()
    rising_convection: tuple[str, ...] = ()


def summarise(
    evaluator: CandidateEvaluator,
    state: SelectionState,
    before: Refit,
    after: Refit,
    conclusion: Conclusion,
    *,
    without: CandidateEvaluator | None = None,
) -> Diagnosis:
    """Collect the result of a diagnosis.

    Args:
        evaluator: The evaluator, whose seed the bootstrap uses.
        state: The state at the end of the selection.
        before: The base fit by which the holdout is predicted.
        after: The fit with the accepted effects by which the holdout is predicted.
        conclusion: Verdict, stage and form of the residual, and the next experiment.
        without: The evaluator of ``before``, where the structure of the wire is another one.
    """
    problem, noise, structure = evaluator.problem, evaluator.problem.noise, conclusion.structure
    series, failures = _residual_series((without or evaluator, evaluator), before, after)
    predictions = _in_units(series, noise)
    intervals = effect_intervals(evaluator, after)
    before_chi2, after_chi2 = (_reduced_chi2(series[when][TRAIN]) for when in ("before", "after"))
    return Diagnosis(
        verdict=conclusion.verdict,
        effects=(*structure.effects, *state.accepted),
        equivalent={key: state.equivalent[key] for key in state.accepted if state.equivalent.get(key)},
        unresolved_stage=conclusion.unresolved_stage,
        detectability=tuple(state.detectability.values()),
        ranking=tuple(state.ranking.values()),
        excluded=() if conclusion.verdict in ("partial", "unresolved") else _excluded_effects(evaluator, state),
        stage_shares=state.stage_shares,
        noise=state.noise,
        before=before,
        after=after,
        base_fit_converged=state.base_fit_converged,
        offsets=state.offsets,
        rising_convection=state.rising_convection,
        reduced_chi2=(before_chi2, after_chi2, state.chi2_limit),
        rmse=_errors(series, noise),
        cut95=_cuts(evaluator, predictions, conclusion.holdout_decided),
        holdout_decided=conclusion.holdout_decided,
        rejected=_rejections(state),
        intervals=intervals,
        estimates=_effect_estimates(problem, after, intervals),
        predictions=predictions,
        residual_statistics=_statistics(problem, predictions),
        nonparametric_fit=conclusion.nonparametric_fit,
        next_experiment=conclusion.next_experiment,
        interrupted=state.interrupted,
        failures=failures,
        implausible=implausible_estimates(problem, after),
        structure=structure,
        supports=state.supports,
        error_budget=conclusion.error_budget,
        law=conclusion.law,
        plant=structured_plant(problem.fitted_plant(after), structure),
    )


def _in_units(
    series: Mapping[str, list[dict[str, np.ndarray]]], noise: Mapping[str, float]
) -> dict[str, list[dict[str, np.ndarray]]]:
    """Series over the noise of their channels in the units of these."""
    return {
        when: [{c: v * noise[c] for c, v in by_channel.items()} for by_channel in splits]
        for when, splits in series.items()
    }


def _cuts(
    evaluator: CandidateEvaluator, predictions: Mapping[str, list[dict[str, np.ndarray]]], holdout_decided: bool
) -> dict[str, tuple[float, float]]:
    """95 % interval of the fall of the holdout's RMSE by channel, SI; of its second half if the first one decided."""
    before, after = (
        {c: second_half(v) if holdout_decided else v for c, v in predictions[when][HOLDOUT].items()}
        for when in ("before", "after")
    )
    return {c: bootstrap_cut(before[c], after[c], evaluator.seed) for c in before}


def _statistics(
    problem: DiagnosisProblem, predictions: Mapping[str, list[dict[str, np.ndarray]]]
) -> dict[str, dict[str, ResidualStatistics]]:
    """Statistics of the training residual by "before" and "after", and channel."""
    return {
        when: {c: residual_statistics(v, problem.inputs()) for c, v in splits[TRAIN].items()}
        for when, splits in predictions.items()
    }


def _rejections(state: SelectionState) -> tuple[Rejection, ...]:
    """What was rejected, once each; without an implausible form of an effect that is accepted in another one."""
    return tuple(
        dict.fromkeys(
            r for r in state.rejected if r.code is not RejectionCode.implausible or r.key not in state.accepted
        )
    )


def _residual_series(
    evaluators: tuple[CandidateEvaluator, CandidateEvaluator], before: Refit, after: Refit
) -> tuple[dict[str, list[dict[str, np.ndarray]]], tuple[FailedPrediction, ...]]:
    """Residuals over the noise by "before" and "after", split and channel, NaN where it fails; and the failures."""
    series, failures = {}, []
    for when, evaluator, refit in zip(("before", "after"), evaluators, (before, after), strict=True):
        problem = evaluator.problem
        reports = [problem.report(refit, k) for k in (TRAIN, SELECT, HOLDOUT)]
        series[when] = [problem.series(residual, k) for k, (residual, _) in enumerate(reports)]
        failures += [
            FailedPrediction(when, SPLIT_NAMES[k], status)
            for k, (_, status) in enumerate(reports)
            if status is not SimulationStatus.done
        ]
    return series, tuple(failures)


def _reduced_chi2(series: Mapping[str, np.ndarray]) -> float:
    """Mean square of all channels over the noise."""
    return float(np.mean(np.concatenate(list(series.values())) ** 2))


def _errors(series: dict[str, list[dict[str, np.ndarray]]], noise: dict[str, float]) -> dict[str, dict[str, float]]:
    """RMSE, SI, by channel and split, before and after."""
    return {
        c: {
            f"{name}_{when}": float(np.sqrt(np.mean(series[when][k][c] ** 2))) * noise[c]
            for k, name in enumerate(SPLIT_NAMES)
            for when in ("before", "after")
        }
        for c in series["before"][TRAIN]
    }


def _excluded_effects(evaluator: CandidateEvaluator, state: SelectionState) -> tuple[Detectability, ...]:
    """Detectable effects whose strength at the last fit, which leaves noise only, does not differ from 0."""
    scores = evaluator.scores(state.current.refit)
    not_excluded = {key for keys in state.equivalent.values() for key in keys} | {r.key for r in state.rejected}
    excluded = []
    for key, score in scores.best.items():
        sensitivity = scores.sensitivities[key, scores.shapes[key]]
        kind = evaluator.problem.effect_kinds[key]
        detectability = detectability_from_score(kind, score, sensitivity, scores.jacobian, [])
        half_width = half_width_95(score.minimum_detectable_strength)
        if detectability.status == "testable" and key not in not_excluded and abs(score.strength) < half_width:
            excluded.append(detectability)
    return tuple(excluded)


def effect_intervals(evaluator: CandidateEvaluator, refit: Refit) -> dict[str, tuple[float, float]]:
    """Compute 95 % intervals of the effects' parameters.

    The half width is 1.96 standard errors, which include the autocorrelation of the residual, plus the error of the
    estimate by the finite length of the steps.

    Args:
        evaluator: The evaluator.
        refit: The fit to training and selection split.

    Returns:
        Lower and upper end, SI, by parameter name; parameters without a finite standard error are left out.
    """
    problem, free_parameters = evaluator.problem, evaluator.problem.free_effect_parameters(refit.effect_set)
    if not free_parameters:
        return {}
    free = evaluator.free_columns(refit, jointly=not problem.own_count)
    jacobians, residuals, by_split = [], [], []
    for k in (TRAIN,) if problem.own_count else (TRAIN, SELECT):
        residual, jacobian = problem.evaluate(refit.effect_set, refit.base, k, free_parameters)
        columns = [problem.series(c, k) for c in jacobian[:, free].T]
        for name, series in problem.series(residual, k).items():
            jacobians.append(np.column_stack([c[name] for c in columns]))
            residuals.append(series)
        by_split.append(np.concatenate(jacobians[-len(problem.channels) :]))
    covariance = covariance_under_autocorrelation(jacobians, residuals, int(np.sum(free)))
    half_width = NORMAL_95 * np.sqrt(np.diag(covariance))
    # The error of the steps' finite length is assumed to bias the parameters on the other recordings as on the first.
    inverse = np.linalg.pinv(sum(j.T @ j for j in by_split), hermitian=True)
    half_width += np.abs(inverse @ (by_split[0].T @ estimate_step_error(problem, refit))) * len(by_split)
    scale = problem.effect_parameters.scale
    return {
        name: (refit.values[name] - s * scale(name), refit.values[name] + s * scale(name))
        for name, s in zip(free_parameters, half_width[-len(free_parameters) :].tolist(), strict=True)
        if math.isfinite(s)
    }


def _effect_estimates(
    problem: DiagnosisProblem, refit: Refit, intervals: Mapping[str, tuple[float, float]]
) -> tuple[EffectEstimate, ...]:
    """All free parameters of the effects, effect by effect."""
    names = problem.free_effect_parameters(refit.effect_set)
    estimates = []
    for key in refit.effect_set.keys:
        declared = declarations(problem.effects[key])
        for name in (name for name in names if name.split(".")[1] == key):
            declaration = declared[name.split(".")[2]]
            allowed = plausible_range(name, declaration.unit)
            ends = (declaration.lower, declaration.upper) if allowed is None else (allowed.lower, allowed.upper)
            head = (name, refit.values[name], declaration.unit, declaration.meaning)
            estimates.append(EffectEstimate(*head, intervals.get(name), ends))
    return tuple(estimates)
