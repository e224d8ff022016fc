"""Samples of uncertain parameters: from the intervals of a fit, and from ranges of parameters that vary in use."""

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
import scipy.stats
from jaxtyping import Bool, Float

from smajax.errors import InputError
from smajax.parameters.checks import ORDERED_PAIRS

# Number of attempts to draw samples within their bounds; samples that are still outside get the estimate. Chosen by
# trial.
_ATTEMPTS = 50
# Half width of a 95 % interval of the normal distribution in standard deviations.
_HALF_WIDTH_95 = 1.959964
# Smaller eigenvalues of the correlations, relative to the largest, are rounding: their half axes have no length.
_MIN_EIGENVALUE = 1e-9


def draw_from_fit(
    document: Mapping[str, Any], names: Sequence[str], count: int, rng: np.random.Generator
) -> dict[str, Float[np.ndarray, " draws"]]:
    """Draw samples of the fitted parameters from a normal distribution with the fit's intervals and correlations.

    Samples outside the parameters' bounds are drawn again, and those in which a transformation does not end above its
    start. Parameters at a bound or without an interval keep their
    estimate; parameters of single recordings are left out.

    Args:
        document: Content of fit.json.
        names: Names of the plant's parameters; others in the document are left out.
        count: Number of samples.
        rng: Random number generator.

    Returns:
        Samples by name, internal units, shape ``(count,)`` each.

    Raises:
        InputError: if no parameter has an interval.
    """
    entries, free = _fitted_entries(document, names)
    estimate = np.array([entries[n]["estimate"] for n in free])
    deviation = _half_widths(entries, free) / _HALF_WIDTH_95
    values, vectors = np.linalg.eigh(_correlation_of(document, free))
    root = vectors * np.sqrt(np.maximum(values, 0.0))
    lower = _bounds_of(entries, free, 0, -np.inf)
    upper = _bounds_of(entries, free, 1, np.inf)
    samples = np.tile(estimate, (count, 1))
    rows = np.arange(count)
    for _ in range(_ATTEMPTS):
        samples[rows] = estimate + deviation * (rng.standard_normal((len(rows), len(free))) @ root.T)
        outside = np.any((samples < lower) | (samples > upper), axis=1)
        rows = np.flatnonzero(outside | _is_out_of_order(samples, free, entries))
        if not len(rows):
            break
    samples[rows] = estimate
    fixed = {n: np.full(count, e["estimate"]) for n, e in entries.items() if n not in free}
    return {n: samples[:, i] for i, n in enumerate(free)} | fixed


def confidence_axes(
    document: Mapping[str, Any], names: Sequence[str]
) -> tuple[tuple[str, ...], Float[np.ndarray, "axes free"]]:
    """Return the half axes of the ellipsoid of a fit's intervals and correlations.

    A quantity that is linear in the parameters has the 95 % half width sqrt(sum d_k^2), with d_k its change along half
    axis k.

    Args:
        document: Content of fit.json.
        names: Names of the plant's parameters; others in the document are left out.

    Returns:
        Names of the parameters that have an interval, and the half axes, internal units, shape ``(axes, free)``.

    Raises:
        InputError: if no parameter has an interval.
    """
    entries, free = _fitted_entries(document, names)
    values, vectors = np.linalg.eigh(_correlation_of(document, free))
    axes = (vectors * np.sqrt(np.maximum(values, 0.0))).T * _half_widths(entries, free)
    return tuple(free), axes[values > _MIN_EIGENVALUE * values.max()]


def _fitted_entries(
    document: Mapping[str, Any], names: Sequence[str]
) -> tuple[dict[str, Mapping[str, Any]], list[str]]:
    """Entries of the plant's parameters in a document, and the names of those that have an interval."""
    entries = {n: e for n, e in document["parameters"].items() if "@" not in n and n in names}
    free = [
        n for n, e in entries.items() if e["lower95"] is not None and not e["at_bound"] and e["upper95"] > e["lower95"]
    ]
    if not free:
        raise InputError(
            "the fit gives no parameter an interval, so there is nothing to draw: fit with more data, or use ranges"
        )
    return entries, free


def _half_widths(entries: Mapping[str, Mapping[str, Any]], free: Sequence[str]) -> Float[np.ndarray, " free"]:
    """Half widths of the 95 % intervals."""
    return np.array([0.5 * (entries[n]["upper95"] - entries[n]["lower95"]) for n in free])


def _is_out_of_order(
    samples: np.ndarray, names: Sequence[str], entries: Mapping[str, Mapping[str, Any]]
) -> Bool[np.ndarray, " draws"]:
    """Whether a transformation does not end above its start in each sample; ``entries`` has the other values."""
    columns = {n: np.full(len(samples), entry["estimate"]) for n, entry in entries.items()}
    columns |= {n: samples[:, i] for i, n in enumerate(names)}
    pairs = [(columns[low], columns[high]) for low, high in ORDERED_PAIRS if low in columns and high in columns]
    return np.any([low >= high for low, high in pairs], axis=0) if pairs else np.zeros(len(samples), bool)


def _correlation_of(document: Mapping[str, Any], names: Sequence[str]) -> np.ndarray:
    """Correlations of some parameters, shape ``(p, p)``; 0 where the fit has none."""
    order, matrix = document["correlations"]["parameters"], np.array(document["correlations"]["matrix"], float)
    rows = [order.index(n) for n in names]
    correlation = np.nan_to_num(matrix[np.ix_(rows, rows)])
    np.fill_diagonal(correlation, 1.0)
    return correlation


def _bounds_of(entries: Mapping[str, Any], names: Sequence[str], side: int, default: float) -> np.ndarray:
    """Lower (side 0) or upper (side 1) bounds of parameters, shape ``(p,)``."""
    bounds = [entries[n]["bounds"][side] for n in names]
    return np.array([default if bound is None else bound for bound in bounds], float)


def draw_from_ranges(
    ranges: Mapping[str, tuple[float, float]], count: int, rng: np.random.Generator
) -> dict[str, Float[np.ndarray, " draws"]]:
    """Draw samples from a uniform distribution between the ends of ranges, by Latin hypercube sampling.

    Args:
        ranges: Smallest and largest value of each parameter by name, internal units.
        count: Number of samples.
        rng: Random number generator.

    Returns:
        Samples by name, internal units, shape ``(count,)`` each.
    """
    if not ranges:
        return {}
    share = scipy.stats.qmc.LatinHypercube(len(ranges), rng=rng).random(count)
    return {n: low + (high - low) * share[:, i] for i, (n, (low, high)) in enumerate(ranges.items())}
