"""The spec of the Bouc-Wen model for fits."""

from collections.abc import Sequence
from typing import Any

from smajax.fitting.io_models.problem import ModelSpec, Series
from smajax.fitting.io_models.specs.ranges import as_arrays, direction_of, output_at_zero, ranges_of
from smajax.laws.bouc_wen import BoucWen


def bouc_wen_spec(series: Sequence[Series], *, rest: bool = False) -> ModelSpec:
    """Return the spec of the Bouc-Wen model with its five parameters.

    Args:
        series: Training recordings.
        rest: Add a constant to the output, for sensors that do not read 0 at the first input.

    Returns:
        The spec, with bounds relative to the ranges of input and output.

    Source: ikhouane2007.
    """
    ranges = ranges_of(series)
    _, span, _, swing = ranges
    direction = direction_of(series)
    lower = {"kx": -10 * swing / span, "kw": -10 * swing, "rho": 0.1 / span, "sigma": 0.5, "n": 1.0}
    upper = {"kx": 10 * swing / span, "kw": 10 * swing, "rho": 100.0 / span, "sigma": 5.0, "n": 6.0}
    start = {
        "kx": direction * 0.5 * swing / span,
        "kw": direction * 0.5 * swing,
        "rho": 2.0 / span,
        "sigma": 1.0,
        "n": 1.5,
    }
    if rest:
        ends = output_at_zero(ranges, direction)
        lower, upper, start = (side | {"rest": end} for side, end in zip((lower, upper, start), ends, strict=True))
    return ModelSpec("bouc-wen", _make, as_arrays(lower), as_arrays(upper), as_arrays(start))


def _make(parameters: dict[str, Any]) -> BoucWen:
    return BoucWen(**parameters)
