"""A refit of the training and the selection recording together, by which the holdout is predicted."""

import dataclasses
import functools
import math

import numpy as np
import scipy.optimize

from smajax.diagnose import instants
from smajax.diagnose.bench import Bench, in_pairs
from smajax.diagnose.hypothesis import Hypothesis, Refit

_MOST = 12  # evaluations
_FAR = 100.0  # mean square over the noise, beyond which nobody asks for the last digits
_SETTLED, _SETTLED_FAR = 1e-6, 1e-3  # relative fall of the cost below which it ends
_SEEN = 1e-9  # of the largest: a parameter that moves the residual by less is not fitted


def joined(bench: Bench, refit: Refit) -> Refit:
    """A refit's parameters, fitted to the training and the selection part together from where they are.

    What one recording leaves open, the other may know; the holdout is predicted with these. A refit with parameters that each recording
    has of its own stays what it is.
    """
    if bench.own:
        return refit
    # Instants first: where one recording leaves one open, a search of all parameters would make the others do for it.
    found = refit
    for turn in range(2):
        better = instants.better(bench, found, (0, 1))
        if turn == 0 or better is not None:
            found = _fitted(bench, found if better is None else dataclasses.replace(found, hypothesis=better))
    return found


def _fitted(bench: Bench, refit: Refit) -> Refit:
    """See ``joined``: by one search."""
    moved = bench.moved(refit.hypothesis)
    lower, upper = bench.ends(moved)
    scales = np.array([bench.scale(name) for name in moved])

    def at(point: np.ndarray) -> Hypothesis:
        return refit.hypothesis.at(dict(zip(moved, (point[bench.size :] * scales).tolist(), strict=True)))

    @functools.lru_cache(maxsize=2)  # SciPy asks for the residual and for its derivative one after the other
    def both(packed: bytes) -> tuple[np.ndarray, np.ndarray, tuple[np.ndarray, np.ndarray]]:
        point = np.frombuffer(packed)
        parts = in_pairs(lambda k: bench.evaluate(at(point), point[: bench.size], k, moved), (0, 1))
        residual = np.concatenate([bench.flat(r, k) for k, (r, _) in enumerate(parts)])
        jacobian = np.concatenate([np.column_stack([bench.flat(c, k) for c in j.T]) for k, (_, j) in enumerate(parts)])
        if not math.isfinite(float(np.sum(jacobian**2))):  # SciPy refuses a step to where the residual is no number, but not to there
            residual = np.full(len(residual), np.nan)
        return residual, jacobian, parts[0]

    start = np.append(refit.base, [refit.values[name] / scale for name, scale in zip(moved, scales, strict=True)]).clip(lower, upper)
    left, slopes, _ = both(start.tobytes())
    if not np.all(np.isfinite(left)):
        return refit
    size = np.linalg.norm(slopes, axis=0)
    free = (lower < upper) & (size > _SEEN * np.max(size))

    def whole(x: np.ndarray) -> bytes:
        point = start.copy()
        point[free] = x
        return point.tobytes()

    with np.errstate(over="ignore"):  # its own step length, where one singular value is next to nothing
        found = scipy.optimize.least_squares(
            lambda x: both(whole(x))[0],
            start[free],
            lambda x: both(whole(x))[1][:, free],  # pyright: ignore[reportArgumentType]
            (lower[free], upper[free]),
            x_scale="jac",
            ftol=_SETTLED if bench.fitness(refit.residual, 0) < _FAR else _SETTLED_FAR,
            max_nfev=_MOST,
        )
    point = np.frombuffer(whole(found.x))
    return Refit(at(point), point[: bench.size], *both(whole(found.x))[2], refit.stop)
