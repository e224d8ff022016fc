"""Scores of a model's prediction: root mean square error, fit percentage, and Bayesian information criterion (BIC)."""

import math
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from smajax.comparison.model_result import ModelResult
from smajax.recordings.recording import Recording

# Least error in the logarithm of the BIC: an exact model has a finite one.
_MIN_ERROR = 1e-300


class Scores(NamedTuple):
    """Scores of one model.

    Attributes:
        rmse: Root mean square errors on the training and on the holdout recording, SI units.
        fit_percent: Fit percentages on both.
        bic: Bayesian information criterion on the training recording.
    """

    rmse: tuple[float, float]
    fit_percent: tuple[float, float]
    bic: float


def score_model(result: ModelResult, recordings: Sequence[Recording], channel: str) -> Scores:
    """Score a fitted model on the training and the holdout recording by one channel.

    With n measured samples and p parameters the criterion is n log(RMSE^2) + p log(n).

    Source: schwarz1978.
    """
    pairs = [(r.channels[channel], p) for r, p in zip(recordings, result.predictions, strict=True)]
    errors = [np.sqrt(np.mean((m - p)[np.isfinite(m)] ** 2)) for m, p in pairs]
    percent = [fit_percent(m, p) for m, p in pairs]
    samples = int(np.sum(np.isfinite(pairs[0][0])))
    bic = samples * math.log(max(float(errors[0]), _MIN_ERROR) ** 2) + result.parameters * math.log(samples)
    return Scores((errors[0], errors[1]), (percent[0], percent[1]), bic)


def fit_percent(measured: np.ndarray, model: np.ndarray) -> float:
    """Return 100 (1 - |y - model| / |y - mean(y)|), as MATLAB's ``compare`` does (NRMSE).

    100 is perfect, 0 is as good as the mean of the measurements.

    Args:
        measured: Measurements (n,); NaN where there is none.
        model: Predictions (n,).
    """
    finite = np.isfinite(measured)
    scale = float(np.linalg.norm(measured[finite] - np.mean(measured[finite])))
    return 100.0 * (1.0 - float(np.linalg.norm(measured[finite] - model[finite])) / scale) if scale > 0.0 else math.nan
