"""Prediction uncertainty: the error of a correct model's prediction by the uncertainty of its parameters."""

from collections.abc import Sequence

import numpy as np

from smajax.diagnosis.candidate_evaluation import CandidateEvaluator
from smajax.diagnosis.candidates import Refit
from smajax.diagnosis.data_split import TRAIN
from smajax.fitting.intervals import covariance_under_autocorrelation


def expected_reduced_chi2(
    evaluator: CandidateEvaluator,
    refit: Refit,
    split: int,
    fitted: Sequence[int] = (TRAIN,),
    *,
    autocorrelated: bool = False,
) -> float:
    """Compute the reduced chi-squared that a correct model with uncertain parameters has on a split: at least 1.

    With the covariance C of the parameters and the Jacobian J on the split it is 1 + mean(diag(J C J^T)). With the
    Jacobian J_f on the fitted splits, C = inv(J_f^T J_f + I): a parameter that these do not determine has its scale as
    standard deviation.

    Args:
        evaluator: The evaluator.
        refit: The fitted model.
        split: The split that is predicted.
        fitted: The splits to which the parameters were fitted.
        autocorrelated: Whether the autocorrelation of the residual is that of the noise; C includes it then.
    """
    problem, free = evaluator.problem, evaluator.free_columns(refit, jointly=len(fitted) > 1)
    # The own parameters of the training recordings do not act on other splits.
    own = (np.arange(len(free)) >= problem.shared_count) & (np.arange(len(free)) < problem.size)

    def linearise(k: int) -> tuple[list[np.ndarray], list[np.ndarray]]:
        """Jacobian and residual of each series of a split."""
        free_parameters = problem.free_effect_parameters(refit.effect_set)
        residual, jacobian = problem.evaluate(refit.effect_set, refit.base, k, free_parameters)
        jacobian = np.where(own, 0.0, jacobian) if k else jacobian
        columns = [problem.series(c, k) for c in jacobian[:, free].T]
        series = problem.series(residual, k)
        return [np.column_stack([c[name] for c in columns]) for name in series], list(series.values())

    linearised = [linearise(k) for k in fitted]
    predicted = np.concatenate(linearise(split)[0])
    jacobian = np.concatenate([j for jacobians, _ in linearised for j in jacobians])
    covariance = np.linalg.inv(jacobian.T @ jacobian + np.eye(jacobian.shape[1]))
    if autocorrelated:
        jacobians, series = ([each for pair in linearised for each in pair[i]] for i in (0, 1))
        estimate = covariance_under_autocorrelation(jacobians, series, jacobian.shape[1])
        covariance = estimate if np.all(np.isfinite(estimate)) else covariance
    return 1.0 + float(np.mean(np.sum((predicted @ covariance) * predicted, axis=1)))
