"""Ranges, directions and times of series, from which the bounds of the models follow."""

from collections.abc import Sequence
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

from smajax.fitting.io_models.problem import Series

# An input below this share of its range is off: above rounding, below any driven input.
_OFF_SHARE = 1e-9
# Bounds of the output at input 0, as a multiple of the output's range; chosen by trial.
_REACH = 5.0


class Ranges(NamedTuple):
    """Ranges of input and output.

    Attributes:
        low: Lowest input.
        span: Range of the input; 1 for a constant input.
        bottom: Lowest output.
        swing: Range of the output; 1 for a constant output.
    """

    low: float
    span: float
    bottom: float
    swing: float


def ranges_of(series: Sequence[Series]) -> Ranges:
    """Return the ranges of input and output over all series."""
    inputs, outputs = np.concatenate([s.input for s in series]), np.concatenate([s.output for s in series])
    return Ranges(
        float(inputs.min()),
        float(np.ptp(inputs)) or 1.0,
        float(np.nanmin(outputs)),
        float(np.nanmax(outputs) - np.nanmin(outputs)) or 1.0,
    )


def direction_of(series: Sequence[Series]) -> float:
    """Return 1 where the output rises with the input, -1 where it falls, by their covariance."""
    values, outputs = np.concatenate([s.input for s in series]), np.concatenate([s.output for s in series])
    measured = np.isfinite(outputs)
    return -1.0 if float(np.cov(values[measured], outputs[measured])[0, 1]) < 0.0 else 1.0


def step_of(series: Sequence[Series]) -> float:
    """Return the median step of the first series, s."""
    return float(np.median(np.diff(series[0].time)))


def duration_of(series: Sequence[Series]) -> float:
    """Return the duration of the longest series, s."""
    return max(float(s.time[-1] - s.time[0]) for s in series)


def begins_on(series: Sequence[Series], span: float) -> bool:
    """Return whether a series begins with its input on.

    Args:
        series: The series.
        span: Range of the input.
    """
    return any(abs(s.input[0]) > _OFF_SHARE * span for s in series)


def output_at_zero(ranges: Ranges, direction: float) -> tuple[float, float, float]:
    """Estimate the output at input 0, which may be outside the input's range.

    Args:
        ranges: Ranges of input and output.
        direction: 1 where the output rises with the input, -1 where it falls.

    Returns:
        Lower bound, upper bound and first guess, in the output's unit.
    """
    low, span, bottom, swing = ranges
    guess, reach = (
        (bottom if direction > 0.0 else bottom + swing) - direction * swing * low / span,
        _REACH * swing * (1.0 + abs(low) / span),
    )
    return bottom - reach, bottom + reach, guess


def as_arrays(tree: Any) -> Any:
    """Convert the numbers of a pytree to arrays of float64."""
    return jax.tree.map(lambda v: jnp.asarray(v, jnp.float64), tree)
