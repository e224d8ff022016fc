"""Ranking of the models of a comparison by their error on the holdout."""

import math
from collections.abc import Sequence
from typing import NamedTuple

from smajax.comparison.model_result import ModelResult
from smajax.comparison.scores import Scores, score_model
from smajax.recordings.recording import Recording


class RankedModel(NamedTuple):
    """A model with its scores.

    Attributes:
        result: Result of the model.
        scores: Its scores; ``None`` where it could not be fitted.
    """

    result: ModelResult
    scores: Scores | None


def rank_models(results: Sequence[ModelResult], recordings: Sequence[Recording], channel: str) -> list[RankedModel]:
    """Rank models by their root mean square error on the holdout, the best first.

    Args:
        results: The results of all models.
        recordings: The training recording and the holdout.
        channel: The compared channel.

    Returns:
        The models with their scores; models without a finite error, or that could not be fitted, come last in the given
        order.
    """
    ranked = [RankedModel(r, None if r.reason else score_model(r, recordings, channel)) for r in results]

    def error(model: RankedModel) -> float:
        rmse = math.nan if model.scores is None else float(model.scores.rmse[1])
        return rmse if math.isfinite(rmse) else math.inf

    return sorted(ranked, key=error)
