"""How far a perfect model's prediction may miss because its parameters are uncertain."""

from collections.abc import Sequence

import numpy as np

from smajax.diagnosis.candidate_evaluation import CandidateEvaluator
from smajax.diagnosis.candidates import Refit
from smajax.diagnosis.data_split import TRAIN
from smajax.fitting.intervals import estimate_covariance


def expected_reduced_chi2(
    evaluator: CandidateEvaluator,
    refit: Refit,
    split: int,
    fitted: Sequence[int] = (TRAIN,),
    *,
    autocorrelated: bool = False,
) -> float:
    """Return the reduced chi-squared that a perfect model with uncertain parameters has on a split: at least 1.

    With the covariance C of the parameters it is 1 + mean(diag(J C J')), J the Jacobian on the split. A parameter that
    the fitted splits do not determine may be off by its scale: C = inv(J_f' J_f + I), J_f the Jacobian on the fitted
    splits.

    Args:
        evaluator: The evaluator.
        refit: The fitted model.
        split: The split that is predicted.
        fitted: The splits to which the parameters were fitted.
        autocorrelated: Take the autocorrelation of the residual for that of the noise.
    """
    problem, free = evaluator.problem, evaluator.free_columns(refit)
    # Another recording's own parameters do not move a prediction.
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
        estimate = estimate_covariance(jacobians, series, jacobian.shape[1])
        covariance = estimate if np.all(np.isfinite(estimate)) else covariance
    return 1.0 + float(np.mean(np.sum((predicted @ covariance) * predicted, axis=1)))
