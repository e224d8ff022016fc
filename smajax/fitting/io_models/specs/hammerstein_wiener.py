"""The spec of the Hammerstein-Wiener model for fits."""

import math
from collections.abc import Sequence
from typing import Any

import jax.numpy as jnp
import numpy as np

from smajax.fitting.io_models.problem import ModelSpec, Series
from smajax.fitting.io_models.specs.ranges import as_arrays, begins_on, duration_of, ranges_of, step_of
from smajax.laws.hammerstein_wiener import HammersteinWiener


def hammerstein_wiener_spec(series: Sequence[Series], knots: int = 10) -> ModelSpec:
    """Return the spec with two poles and, where it lowers the error enough, a delay of at most half the recording.

    The delay is searched from several first guesses. ``settled`` is free where a recording begins with the input on.

    Args:
        series: Training recordings.
        knots: Number of knots of each curve.

    Returns:
        The spec, with the model without delay as the nested one.
    """
    duration = duration_of(series)
    lower, upper, start = _sides(series, knots)
    extra_starts = [
        start | {"delay": delay, "reflections": _double_pole(step_of(series), slow)}
        for delay in np.linspace(0.0, 0.45, 19) * duration
        for slow in (duration / 50, duration / 12)
    ]
    sides = [as_arrays(side) for side in (lower, upper, start)]
    without_delay = ({k: v for k, v in side.items() if k != "delay"} for side in sides)
    prompt = ModelSpec("hammerstein-wiener", _make, *without_delay, needs_even_rows=True)
    return ModelSpec(
        "hammerstein-wiener",
        _make,
        *sides,
        needs_even_rows=True,
        extra_starts=tuple(map(as_arrays, extra_starts)),
        nested=((prompt, _without_delay),),
        prefers_simpler=True,
    )


def _sides(series: Sequence[Series], knots: int) -> tuple[dict[str, Any], dict[str, Any], dict[str, Any]]:
    """Lower and upper bounds and the first guess."""
    low, span, bottom, swing = ranges_of(series)
    step, duration = step_of(series), duration_of(series)
    positions, even = np.linspace(low, low + span, knots), np.linspace(0.0, 1.0, knots)
    edges = np.r_[0.0, np.full(knots - 2, -0.5), 1.0], np.r_[0.0, np.full(knots - 2, 1.5), 1.0]
    lower = {
        "knots": positions,
        "inlet": edges[0],
        "reflections": np.array((-1 + 1e-6, -0.999)),
        "split": -3.0,
        "outlet": np.full(knots, bottom - swing),
        "delay": 0.0,
        "settled": 0.0 if begins_on(series, span) else 1.0,
    }
    upper = {
        "knots": positions,
        "inlet": edges[1],
        "reflections": np.array((1.0, 1 - 1e-6)),
        "split": 4.0,
        "outlet": np.full(knots, bottom + 2 * swing),
        "delay": duration / 2,
        "settled": 1.0,
    }
    start = {
        "knots": positions,
        "inlet": even,
        "reflections": _double_pole(step, duration / 50),
        "split": 0.5,
        "outlet": bottom + swing * even,
        "delay": 0.0,
        "settled": 1.0,
    }
    return lower, upper, start


def _make(parameters: dict[str, Any]) -> HammersteinWiener:
    return HammersteinWiener(**parameters)


def _without_delay(parameters: dict[str, Any]) -> dict[str, Any]:
    return parameters | {"delay": jnp.zeros(())}


def _double_pole(step: float, slow: float) -> np.ndarray:
    """Reflection coefficients (2,) of a double pole with the time constant ``slow``."""
    pole = math.exp(-step / slow)
    return np.array((-2 * pole / (1 + pole**2), pole**2))
