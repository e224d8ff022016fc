"""Scores of a model's prediction: root mean square error, fit percentage, and Bayesian information criterion (BIC)."""

import math
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from jaxtyping import Float

from smajax.comparison.model_result import ModelResult
from smajax.recordings.recording import Recording

# Least RMSE in the logarithm of the BIC, so that the BIC of an exact model is finite; its square is a normal number.
_MIN_ERROR = 1e-150


class Scores(NamedTuple):
    """Scores of one model.

    Attributes:
        rmse: Root mean square errors on the training and on the holdout recording, SI.
        fit_percent: Fit percentages on both (``fit_percent``).
        bic: Bayesian information criterion on the training recording.
    """

    rmse: tuple[float, float]
    fit_percent: tuple[float, float]
    bic: float


def score_model(result: ModelResult, recordings: Sequence[Recording], channel: str) -> Scores:
    """Compute the scores of a fitted model on the training and the holdout recording by one channel.

    With n measured samples and p parameters, BIC = n log(RMSE^2) + p log(n).

    Args:
        result: The result of the model, with predictions.
        recordings: The training recording, and the holdout.
        channel: The compared channel; rows where it is NaN are left out.

    Source: schwarz1978.
    """
    pairs = [(r.channels[channel], p) for r, p in zip(recordings, result.predictions, strict=True)]
    errors = [np.sqrt(np.mean((m - p)[np.isfinite(m)] ** 2)) for m, p in pairs]
    percent = [fit_percent(m, p) for m, p in pairs]
    samples = int(np.sum(np.isfinite(pairs[0][0])))
    bic = samples * math.log(max(float(errors[0]), _MIN_ERROR) ** 2) + result.parameters * math.log(samples)
    return Scores((errors[0], errors[1]), (percent[0], percent[1]), bic)


def fit_percent(measured: Float[np.ndarray, " n"], model: Float[np.ndarray, " n"]) -> float:
    """Compute the fit percentage (NRMSE) of a prediction, as ``compare`` of MATLAB does.

    With the measurements y and predictions m it is 100 (1 - |y - m| / |y - mean(y)|): 100 for an exact prediction, 0
    for one as good as the mean of the measurements.

    Args:
        measured: Measurements, shape ``(n,)``; NaN where there is none.
        model: Predictions, shape ``(n,)``, in the same unit.

    Returns:
        The percentage; NaN if the measurements are constant.
    """
    finite = np.isfinite(measured)
    scale = float(np.linalg.norm(measured[finite] - np.mean(measured[finite])))
    return 100.0 * (1.0 - float(np.linalg.norm(measured[finite] - model[finite])) / scale) if scale > 0.0 else math.nan
