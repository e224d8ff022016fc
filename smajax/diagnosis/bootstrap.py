"""Interval of the difference of two errors on one recording, by a block bootstrap of the paired residuals."""

import math

import numpy as np
from jaxtyping import Float

# Number of blocks into which the bootstrap divides a residual, each longer than its correlation. Chosen by trial.
_BLOCKS = 50
# Number of random samples of the bootstrap: 25 of them then lie below its 2.5 % quantile.
_DRAWS = 1000


def bootstrap_cut(
    before: Float[np.ndarray, " n"], after: Float[np.ndarray, " n"], seed: int, draws: int = _DRAWS
) -> tuple[float, float]:
    """Compute a 95 % interval of the fall of the RMSE by a block bootstrap with 50 blocks.

    Args:
        before: Residual without effects, shape ``(n,)``.
        after: Residual with them, shape ``(n,)``.
        seed: Seed of the random samples.
        draws: Number of random samples.

    Returns:
        Lower and upper end, in the unit of the residuals; NaN if a residual is not finite.

    Source: carlstein1986.
    """
    length = max(1, len(before) // _BLOCKS)
    count = len(before) // length
    squares = [np.mean((v[: count * length] ** 2).reshape(count, length), axis=1) for v in (before, after)]
    if not np.all(np.isfinite(squares)):
        return math.nan, math.nan

    def cut(before: np.ndarray, after: np.ndarray, axis: int) -> np.ndarray:
        return np.sqrt(np.mean(before, axis=axis)) - np.sqrt(np.mean(after, axis=axis))

    import scipy.stats  # slow to import, and seldom needed

    # The blocks are paired, and drawn together for both fits.
    interval = scipy.stats.bootstrap(
        squares,
        cut,
        paired=True,
        n_resamples=draws,
        confidence_level=0.95,
        method="percentile",
        rng=np.random.default_rng(seed),
    ).confidence_interval
    return float(interval.low), float(interval.high)
