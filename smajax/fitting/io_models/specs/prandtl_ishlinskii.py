"""The spec of the generalised Prandtl-Ishlinskii operator for fits."""

import itertools
from collections.abc import Sequence
from typing import Any, Literal

import jax.numpy as jnp
import numpy as np

from smajax.errors import InputError
from smajax.fitting.io_models.problem import ModelSpec, Series
from smajax.fitting.io_models.specs.ranges import Ranges, as_arrays, direction_of, ranges_of
from smajax.laws.prandtl_ishlinskii import Envelope, PrandtlIshlinskii

# Number of plays of the operator by default. Chosen by trial.
_PLAYS = 10
# Further first guesses; chosen by trial on the recordings of tests/unit/laws/test_input_output_models.py.
# Slopes of the envelopes times the input's range.
_SLOPES = (2.0, 4.0, 8.0, 16.0)
# Centres of the envelopes as shares of the input's range.
_CENTRES = (0.2, 0.35, 0.5, 0.65, 0.8)
# Distances between two envelopes as shares of the input's range.
_DISTANCES = (0.0, 0.1, 0.25)
# Factors on the largest threshold.
_REACH_FACTORS = (0.2, 1.0)


def prandtl_ishlinskii_spec(
    series: Sequence[Series],
    count: int = _PLAYS,
    envelopes: int = 2,
    *,
    thresholds: Sequence[float] | np.ndarray | Literal["even", "free"] = "even",
    densities: Sequence[float] | np.ndarray | Literal["free"] = "free",
) -> ModelSpec:
    """Return the spec of the operator with ``count`` plays and one tanh envelope, or one for each direction.

    Where thresholds and densities are both fitted, the height of the loading envelope is fixed: if envelopes and
    thresholds are multiplied by a factor, and direct part and densities divided by it, the operator is the same. The
    envelopes rise or fall as the output does with the input. A search for more than ten even plays also starts at the
    fit with half as many.

    Args:
        series: Training recordings.
        count: Number of plays.
        envelopes: Number of envelopes, 1 or 2.
        thresholds: In the output's unit: evenly spaced ones of which the largest is fitted (``even``), each fitted
            (``free``), or fixed increasing values (count,).
        densities: Fitted (``free``), or fixed values (count,).

    Returns:
        The spec, with bounds relative to the ranges of input and output.

    Raises:
        InputError: Thresholds do not increase from above 0, a density is negative, or there are not ``count`` of them.

    Source: copaci2020, equations 7 to 9.
    """
    fixed_gaps, fixed_densities = _fixed_values(count, thresholds, densities)
    ranges, direction = ranges_of(series), direction_of(series)
    lower, upper, start = _sides(ranges, direction, count, envelopes)
    if fixed_gaps is not None or thresholds == "free":
        gaps = _gap_sides(fixed_gaps, count, ranges.swing)
        lower, upper, start = (
            {k: v for k, v in side.items() if k != "reach"} | {"gaps": gap}
            for side, gap in zip((lower, upper, start), gaps, strict=True)
        )
    if fixed_densities is not None:
        lower, upper, start = (side | {"densities": fixed_densities} for side in (lower, upper, start))
    if fixed_gaps is None and fixed_densities is None:
        height = start["loading"]["height"]
        lower, upper = (side | {"loading": side["loading"] | {"height": height}} for side in (lower, upper))
    # With two envelopes the plays can compensate for envelopes of a wrong slope and centre, and a search ends there.
    # With one envelope they cannot, unless all thresholds are free.
    several = envelopes == 2 or (fixed_gaps is None and thresholds == "free")
    nested = ()
    if "reach" in start and fixed_densities is None and count > _PLAYS and count % 2 == 0:
        nested = ((prandtl_ishlinskii_spec(series, count // 2, envelopes), _twice_as_many),)
    return ModelSpec(
        f"prandtl-ishlinskii-{count}" if count != _PLAYS else "prandtl-ishlinskii",
        _make,
        *map(as_arrays, (lower, upper, start)),
        nonsmooth=True,
        extra_starts=tuple(_extra_starts(start, ranges, envelopes)) if several else (),
        nested=nested,
    )


def _fixed_values(count: int, thresholds: Any, densities: Any) -> tuple[np.ndarray | None, np.ndarray | None]:
    """Distances between fixed thresholds, and fixed densities, (count,) each; ``None`` where they are fitted."""
    gaps = np.diff(np.asarray(thresholds, float), prepend=0.0) if not isinstance(thresholds, str) else None
    fixed = np.asarray(densities, float) if not isinstance(densities, str) else None
    if gaps is not None and (gaps.shape != (count,) or not np.all(gaps > 0.0)):
        raise InputError(
            f"thresholds have to be {count} increasing numbers above 0: give one for each play, or 'even' or 'free'"
        )
    if fixed is not None and (fixed.shape != (count,) or not np.all(fixed >= 0.0)):
        raise InputError(f"densities have to be {count} numbers of at least 0: give one for each play, or 'free'")
    return gaps, fixed


def _sides(
    ranges: Ranges, direction: float, count: int, envelopes: int
) -> tuple[dict[str, Any], dict[str, Any], dict[str, Any]]:
    """Lower and upper bounds and the first guess, with even thresholds."""
    low, span, bottom, swing = ranges
    envelope = {
        "height": direction * 0.5 * swing,
        "slope": 3.0 / span,
        "centre": low + 0.5 * span,
        "middle": bottom + 0.5 * swing,
    }
    ends = {
        "height": (0.1 * swing, swing) if direction > 0.0 else (-swing, -0.1 * swing),
        "slope": (0.2 / span, 40.0 / span),
        "centre": (low - 0.5 * span, low + 1.5 * span),
        "middle": (bottom - swing, bottom + 2 * swing),
    }
    lower = {
        "direct": 1e-3,
        "densities": np.zeros(count),
        "reach": 0.01 * swing,
        "loading": {k: v[0] for k, v in ends.items()},
    }
    upper = {
        "direct": 4.0,
        "densities": np.full(count, 2.0),
        "reach": swing,
        "loading": {k: v[1] for k, v in ends.items()},
    }
    start = {"direct": 0.6, "densities": np.full(count, 0.4 / count), "reach": 0.5 * swing, "loading": envelope}
    if envelopes == 2:
        lower, upper, start = (side | {"unloading": side["loading"]} for side in (lower, upper, start))
    return lower, upper, start


def _gap_sides(fixed: np.ndarray | None, count: int, swing: float) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Lower and upper bounds and the first guess of the distances between thresholds."""
    if fixed is not None:
        return fixed, fixed, fixed
    return np.full(count, 1e-4 * swing), np.full(count, swing), np.full(count, 0.5 * swing / count)


def _extra_starts(start: dict[str, Any], ranges: Ranges, envelopes: int) -> list[Any]:
    """Further first guesses: envelopes with other slopes and centres, and plays with another largest threshold."""
    low, span, _, _ = ranges
    envelope = start["loading"]
    distances = _DISTANCES if envelopes == 2 else (0.0,)
    factors = _REACH_FACTORS if "reach" in start else (1.0,)
    starts = []
    for slope, centre, distance, factor in itertools.product(_SLOPES, _CENTRES, distances, factors):
        guess = start | ({"reach": factor * start["reach"]} if "reach" in start else {})
        for name, side in (("loading", 0.5), ("unloading", -0.5))[:envelopes]:
            position = low + (centre + side * distance) * span
            guess |= {name: envelope | {"slope": slope / span, "centre": position}}
        starts.append(as_arrays(guess))
    return starts


def _make(parameters: dict[str, Any]) -> PrandtlIshlinskii:
    densities = parameters["densities"]
    count = densities.shape[0]
    thresholds = (
        jnp.cumsum(parameters["gaps"])
        if "gaps" in parameters
        else parameters["reach"] * jnp.arange(1, count + 1) / count
    )
    unloading = parameters.get("unloading")
    return PrandtlIshlinskii(
        parameters["direct"],
        thresholds,
        densities,
        _envelope(parameters["loading"]),
        _envelope(unloading) if unloading else None,
    )


def _envelope(parameters: dict[str, Any]) -> Envelope:
    """An envelope from its ``centre``, an input, whose bounds do not depend on the zero of the input."""
    return Envelope(
        parameters["height"], parameters["slope"], -parameters["slope"] * parameters["centre"], parameters["middle"]
    )


def _twice_as_many(parameters: dict[str, Any]) -> dict[str, Any]:
    """The parameters of twice as many plays with the same output: the additional plays have density 0."""
    densities = parameters["densities"]
    return parameters | {"densities": jnp.stack([jnp.zeros_like(densities), densities], axis=1).ravel()}
