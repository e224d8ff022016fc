"""Plants that differ in what a fit does not know, or in what changes from day to day: draws of named parameters."""

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
import scipy.stats

from smajax.errors import InputError

_TRIES = 50


def posterior(document: Mapping[str, Any], names: Sequence[str], count: int, rng: np.random.Generator) -> dict[str, np.ndarray]:
    """Draws of the fitted parameters of a ``fit.json``, each of shape ``(count,)``, in internal units.

    Normal, with the fit's intervals and correlations, drawn again where they leave their bounds. Parameters at a bound or without an
    interval keep their estimate; those of single recordings, and those that are not among ``names``, are left out. Raises ``InputError`` if
    none is left that could be drawn.
    """
    entries = {n: e for n, e in document["parameters"].items() if "@" not in n and n in names}
    free = [n for n, e in entries.items() if e["lower95"] is not None and not e["at_bound"] and e["upper95"] > e["lower95"]]
    if not free:
        raise InputError("the fit gives no parameter an interval, so there is nothing to draw: fit with more data, or vary by ranges")
    known, matrix = document["correlations"]["parameters"], np.array(document["correlations"]["matrix"], float)
    at = [known.index(n) for n in free]
    correlation = np.nan_to_num(matrix[np.ix_(at, at)])
    np.fill_diagonal(correlation, 1.0)
    deviation = np.array([(entries[n]["upper95"] - entries[n]["lower95"]) / (2.0 * 1.959964) for n in free])
    middle = np.array([entries[n]["estimate"] for n in free])
    values, vectors = np.linalg.eigh(correlation)
    root = vectors * np.sqrt(np.maximum(values, 0.0))
    ends = [[entries[n]["bounds"][k] for n in free] for k in (0, 1)]
    lower, upper = (np.array([np.nan if e is None else e for e in side], float) for side in ends)
    lower, upper = np.where(np.isnan(lower), -np.inf, lower), np.where(np.isnan(upper), np.inf, upper)
    drawn = np.tile(middle, (count, 1))
    todo = np.arange(count)
    for _ in range(_TRIES):
        drawn[todo] = middle + deviation * (rng.standard_normal((len(todo), len(free))) @ root.T)
        todo = np.flatnonzero(np.any((drawn < lower) | (drawn > upper), axis=1))
        if not len(todo):
            break
    drawn[todo] = middle
    held = {n: np.full(count, e["estimate"]) for n, e in entries.items() if n not in free}
    return {n: drawn[:, i] for i, n in enumerate(free)} | held


def spread(vary: Mapping[str, tuple[float, float]], count: int, rng: np.random.Generator) -> dict[str, np.ndarray]:
    """Draws between the ends of ranges, by a Latin hypercube: each of shape ``(count,)``."""
    if not vary:
        return {}
    share = scipy.stats.qmc.LatinHypercube(len(vary), rng=rng).random(count)
    return {n: low + (high - low) * share[:, i] for i, (n, (low, high)) in enumerate(vary.items())}
