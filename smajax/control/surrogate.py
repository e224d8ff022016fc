"""Where to look next at a cost that is rough: a Gaussian process through what is known of it, and its expected improvement.

The logarithm of the cost is taken as a draw of a process whose covariance is Matern's of order 5/2,

    k(x, x') = s (1 + d + d^2 / 3) exp(-d),     d^2 = 5 sum_i ((x_i - x'_i) / l_i)^2,

plus white noise of variance e, which stands for what is rough. Lengths l, s and e are those of the largest likelihood. Several points are
proposed at a time: after each, the process believes that it found there what it expected (the kriging believer).

Sources: Rasmussen and Williams, Gaussian Processes for Machine Learning (2006), eqs. 2.25, 2.26, 4.17, 5.8 and 5.9; Jones, Schonlau and
Welch, J. Global Optimization 13 (1998) 455, eq. 15; Ginsbourger, Le Riche and Carraro, Kriging is well-suited to parallelize optimization
(2010).
"""

from typing import NamedTuple

import numpy as np
import scipy.linalg
import scipy.optimize
import scipy.stats

_TALL = 3.0  # logarithms above the least at which costs are cut: how bad the bad ones are does not matter
_LENGTH, _LENGTHS = 0.3, (0.03, 3.0)  # the one to begin with, of the box
_SLIGHT = 1e-3  # noise to begin with
_DRAWN = 600  # points each to choose from: anywhere, about the best, and close about it


class Process(NamedTuple):
    """A process through ``points``, shape ``(n, p)``, with ``values``, shape ``(n,)``; ``lengths``, shape ``(p,)``, and two variances."""

    points: np.ndarray
    values: np.ndarray
    lengths: np.ndarray
    variance: float
    noise: float
    factor: tuple
    weights: np.ndarray

    @classmethod
    def of(cls, points: np.ndarray, values: np.ndarray, lengths: np.ndarray, variance: float, noise: float) -> "Process":
        """The process with given lengths and variances."""
        factor = scipy.linalg.cho_factor(_seen(_apart(_squares(points, points), lengths), variance, noise), lower=True)
        return cls(points, values, lengths, variance, noise, factor, scipy.linalg.cho_solve(factor, values))

    def tell(self, points: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Mean and standard deviation at points, shape ``(m, p)``."""
        across = _covariance(_apart(_squares(points, self.points), self.lengths), self.variance)
        left = self.variance - np.sum(across * scipy.linalg.cho_solve(self.factor, across.T).T, axis=1)
        return across @ self.weights, np.sqrt(np.maximum(left, 1e-12))

    def believe(self, point: np.ndarray) -> "Process":
        """The process that has seen at a point what it expects there."""
        mean, _ = self.tell(point[None])
        return Process.of(np.vstack([self.points, point]), np.append(self.values, mean), self.lengths, self.variance, self.noise)


def fitted(points: np.ndarray, costs: np.ndarray, before: Process | None = None) -> Process:
    """The likeliest process through costs above 0, shape ``(n,)``; ``before`` says where to begin."""
    values = np.log(np.maximum(costs, 1e-300))
    values = np.minimum(values, np.min(values) + _TALL)
    values = values - np.mean(values)
    spread, wide = float(np.var(values)) + 1e-9, points.shape[1]
    squares = _squares(points, points)
    first = np.append(np.full(wide, np.log(_LENGTH)), np.log([spread, _SLIGHT * spread]))
    if before is not None:
        first = np.append(np.log(before.lengths), np.log([before.variance, before.noise]))
    ends = [tuple(np.log(_LENGTHS))] * wide + [tuple(np.log([0.01 * spread, 100.0 * spread])), tuple(np.log([1e-6 * spread, spread]))]
    first = np.clip(first, *np.transpose(ends))
    best = scipy.optimize.minimize(
        unlikelihood, first, (squares, values), jac=True, method="L-BFGS-B", bounds=ends, options={"maxiter": 30}
    ).x
    return Process.of(points, values, np.exp(best[:wide]), float(np.exp(best[wide])), float(np.exp(best[wide + 1])))


def unlikelihood(at: np.ndarray, squares: np.ndarray, values: np.ndarray) -> tuple[float, np.ndarray]:
    """Minus the logarithm of the likelihood, but for a constant, and its gradient in ``at``: logarithms of lengths, variance and noise.

    ``squares``, shape ``(n, n, p)``, are those of the points' differences. A guess of the lengths is in it, which keeps those of which few
    points tell nothing from running to their bounds.
    """
    wide = squares.shape[2]
    lengths, variance, noise = np.exp(at[:wide]), float(np.exp(at[wide])), float(np.exp(at[wide + 1]))
    apart = _apart(squares, lengths)
    covariance = _seen(apart, variance, noise)
    factor = scipy.linalg.cho_factor(covariance, lower=True)
    inverse = scipy.linalg.cho_solve(factor, np.eye(len(values)))
    weights = inverse @ values
    away = at[:wide] - np.log(_LENGTH)
    found = 0.5 * values @ weights + np.sum(np.log(np.diag(factor[0]))) + 0.5 * away @ away
    pull = 0.5 * (inverse - np.outer(weights, weights))
    inner = pull * variance * (5.0 / 3.0) * (1.0 + apart) * np.exp(-apart)
    by_lengths = np.einsum("ij,ijk->k", inner, squares) / lengths**2 + away
    by_noise = noise * np.trace(pull)
    return float(found), np.append(by_lengths, [np.sum(pull * covariance) - by_noise, by_noise])


def propose(process: Process, count: int, rng: np.random.Generator) -> np.ndarray:
    """So many points of the unit box, shape ``(count, p)``, at which an improvement is expected; the last where the mean is least."""
    chosen = []
    mean, _ = process.tell(process.points)
    best, reach = process.points[np.argmin(mean)], np.clip(0.5 * process.lengths, 0.01, 0.3)
    for k in range(count):
        steps = rng.standard_normal((2, _DRAWN, len(best))) * reach
        drawn = np.vstack([rng.uniform(size=(_DRAWN, len(best))), *np.clip(best + steps * [[[1.0]], [[0.3]]], 0.0, 1.0)])
        mean, deviation = process.tell(drawn)
        if k < count - 1:
            gain = (np.min(process.tell(process.points)[0]) - mean) / deviation
            expected = deviation * (gain * scipy.stats.norm.cdf(gain) + scipy.stats.norm.pdf(gain))
            chosen.append(drawn[np.argmax(expected)])
        else:
            chosen.append(drawn[np.argmin(mean)])
        process = process.believe(chosen[-1])
    return np.array(chosen)


def _squares(one: np.ndarray, other: np.ndarray) -> np.ndarray:
    return (one[:, None] - other[None]) ** 2


def _apart(squares: np.ndarray, lengths: np.ndarray) -> np.ndarray:
    return np.sqrt(5.0 * squares @ lengths**-2.0)


def _seen(apart: np.ndarray, variance: float, noise: float) -> np.ndarray:
    """The covariance of what was seen, with noise and the little that keeps equal points apart."""
    return _covariance(apart, variance) + (noise + 1e-8 * variance) * np.eye(len(apart))


def _covariance(apart: np.ndarray, variance: float) -> np.ndarray:
    return variance * (1.0 + apart + apart**2 / 3.0) * np.exp(-apart)
