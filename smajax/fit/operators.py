"""Fits of input-output laws: hysteresis operators and black boxes, from one input channel to one output channel.

What is fitted is in ``operator_problem``; here are the searches, forward for laws of few numbers and in reverse mode for networks, and what
they leave: the law, its numbers and their intervals.
"""

import dataclasses
import math
import time
from collections.abc import Iterator, Sequence
from typing import Any, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import optimistix as optx
from jax.flatten_util import ravel_pytree

from smajax import simulate
from smajax.errors import NumericsError
from smajax.fit import least_squares, uncertainty
from smajax.fit.operator_problem import Family, Measured, OperatorProblem, Series, build_operator, check_rows, check_steps
from smajax.fit.searchable import Searchable, costs, residual
from smajax.hysteresis.operator import AbstractOperator
from smajax.kinks import within

_WIDE = 30.0
_RIDGES = (0.3, 0.1, 0.03, 0.01, 3e-3, 1e-3)  # from what leaves a network little more than a linear law to what hardly holds its weights
_DRAWN = 0.05  # of the room between the bounds: how far from the first guess a network begins
_HIDDEN = 0.632
_EARLIER = 0.75  # the share of the rows that are fitted while a ridge is chosen
_ROUNDS = 5  # of starts, each but the first beside the best end so far
_SIDES = 3
_BESIDE = 0.01  # of the room between the bounds
_LOWER = 1e-3  # a round that lowers the cost by less than this share is the last
_AT = 1e-6  # a parameter this share of its room away from a bound is at it


class Ridged(Searchable):
    """A problem whose numbers are held near the first guess: its residual, and ``pull``, shape ``(p,)``, times how far each went."""

    data: Measured
    problem: OperatorProblem
    pull: jax.Array

    @property
    def size(self) -> int:
        """Length of the residual."""
        return self.problem.size + self.pull.shape[0]

    @property
    def nominal(self) -> np.ndarray:
        """The first guess."""
        return self.problem.nominal

    @property
    def box(self) -> tuple[np.ndarray, np.ndarray]:
        """The problem's."""
        return self.problem.box

    def residual(self, vector: jax.Array) -> jax.Array:
        """The problem's residual, then how far each number is from the first guess, shape ``(r * n + p,)``."""
        return jnp.append(self.problem.residual(vector), self.pull * (vector - self.problem.first))


@dataclasses.dataclass(frozen=True)
class OperatorFit:
    """A fitted law; ``rmse`` of the training series in the output's unit, pooled, and what it took (s of wall, compiling included).

    ``step`` is the time between the rows that it was fitted to, s; ``ridge`` what held a network's weights, 0 of other laws. ``half`` are
    the half-widths of the 95 % intervals, alike: infinite where the recording does not tell, NaN of what is held or at a bound, ``None`` of
    networks, whose weights have none.
    """

    family: Family
    law: AbstractOperator
    parameters: Any
    rmse: float
    samples: int
    simulations: int
    wall: float
    step: float
    ridge: float = 0.0
    half: Any = None

    def _leaves(self) -> Iterator[tuple[str, np.ndarray, np.ndarray, np.ndarray, np.ndarray]]:
        """Name, value, both ends and half of the interval of each leaf of the parameters."""
        trees = (self.parameters, self.family.lower, self.family.upper, self.parameters if self.half is None else self.half)
        for (path, value), *others in zip(*(jax.tree_util.tree_leaves_with_path(tree) for tree in trees), strict=True):
            low, high, half = (np.asarray(other) for _, other in others)
            half = half if self.half is not None else np.full(low.shape, np.nan)
            yield ".".join(str(key.key) for key in path), np.asarray(value), low, high, half

    @property
    def values(self) -> dict[str, dict[str, Any]]:
        """The law's numbers by name, lists of arrays, with the ends of their 95 % intervals; ``None`` where there are none."""

        def shown(values: Any) -> Any:
            return np.asarray(np.where(np.isfinite(values), values, None)).tolist()

        return {
            name: {"value": shown(value), "lower95": shown(value - half), "upper95": shown(value + half), "free": bool(np.any(low < high))}
            for name, value, low, high, half in self._leaves()
        }

    @property
    def undetermined(self) -> tuple[str, ...]:
        """The free parameters whose interval is wider than all that their bounds allow; of an array, how many of its entries."""
        told = []
        for name, value, low, high, half in self._leaves():
            open_ = 2.0 * half > high - low
            if np.any(open_):
                told.append(f"{name} ({np.sum(open_)} of {value.size})" if value.ndim else name)
        return tuple(told)

    @property
    def at_bound(self) -> tuple[str, ...]:
        """The free parameters that ended at a bound, each with that bound; of an array, how many of its entries."""
        told = []
        for name, value, low, high, _ in self._leaves():
            held = _at_bound(value, low, high)
            if np.any(held):
                end = low if np.all(value - low < high - value) else high
                told.append(f"{name} ({f'{np.sum(held)} of {held.size}' if held.ndim else f'{float(end):.4g}'})")
        return tuple(told)

    def respond(self, series: Series) -> np.ndarray:
        """The law's output on a series, shape ``(n,)``. ``InputError`` if a law that goes row by row meets rows of another step."""
        check_steps(self.family, series, self.step)
        return np.asarray(_respond(self.law, jnp.asarray(series.time), jnp.asarray(series.input)))


_respond = eqx.filter_jit(simulate.respond)


def _at_bound(value: np.ndarray, low: np.ndarray, high: np.ndarray) -> np.ndarray:
    """Which free parameters are at a bound."""
    return np.asarray((np.minimum(value - low, high - value) <= _AT * (high - low)) & (low < high))


def fit_operator(family: Family, series: Sequence[Series], *, starts: int = 8, seed: int = 0, max_steps: int = 150) -> OperatorFit:
    """Fits a family to series by least squares from several starts.

    Raises ``NumericsError`` if nothing fits, and ``InputError`` where no more rows are measured than the family has parameters.

    A network has more weights than a recording can tell: its cost, the mean square over the output's variance, has ``ridge``^2 times the
    sum of squares of how far its weights went from the first guess. The ridge is the one of a few, tried from the strongest on, that
    serves best when fitted to the first three quarters of each series, by its error on the rest above all; with that one it is then fitted
    to all rows.
    """
    began = time.perf_counter()
    problem, ridge, slopes = build_operator(family, series), 0.0, None
    samples = int(np.sum(np.asarray(problem.data.weight) > 0))
    check_rows(" and ".join(s.name for s in series), samples, family.size, family.name)
    if family.weights is None:
        simpler = [(fit_operator(one, series, starts=starts, seed=seed, max_steps=max_steps), write) for one, write in family.holds]
        known = [problem.point(write(one.parameters)) for one, write in simpler]
        vector, simulations, slopes = _by_forward(problem, family, known, starts, seed, max_steps)
        simulations += sum(one.simulations for one, _ in simpler)
    else:
        vector, simulations, ridge = _by_reverse(problem, ravel_pytree(family.weights)[0], starts, seed, max_steps)
    if vector is None:
        raise NumericsError(f"{family.name}: no point between its bounds gives numbers: check the recordings' units")
    left = np.asarray(_weighted(jnp.asarray(vector), problem)) / float(jnp.max(problem.data.weight))
    flat = problem.lower + jnp.asarray(vector) * problem.width
    maker: Any = problem.make
    return OperatorFit(
        family, problem.make(flat), maker.unravel(flat), float(np.sqrt(np.sum(left**2) / samples)), samples, simulations,
        time.perf_counter() - began, float(np.median(np.diff(series[0].time))), ridge,
        None if slopes is None else maker.unravel(jnp.asarray(_half_widths(problem, vector, slopes))),
    )  # fmt: skip


_weighted = eqx.filter_jit(residual)


def _half_widths(problem: OperatorProblem, vector: np.ndarray, slopes: tuple[np.ndarray, np.ndarray]) -> np.ndarray:
    """Half-widths of the parameters' 95 % intervals, shape ``(p,)``, from residual and Jacobian at the fit's end: see ``OperatorFit``."""
    low, high = problem.box
    free = np.flatnonzero((low < high) & ~_at_bound(vector, low, high))
    seen = np.asarray(problem.data.weight) > 0
    left, columns = (v.reshape(*seen.shape, *v.shape[1:]) for v in slopes)
    each = [(columns[k][rows][:, free], left[k][rows]) for k, rows in enumerate(seen)]
    spread = uncertainty.covariance([c for c, _ in each], [r for _, r in each], len(free))
    half = np.full(len(vector), np.nan)
    half[free] = uncertainty.critical(int(np.sum(seen)), len(free)) * np.sqrt(np.diag(spread))
    return half * np.asarray(problem.width)


def _by_forward(
    problem: OperatorProblem, family: Family, known: Sequence[np.ndarray], starts: int, seed: int, max_steps: int
) -> tuple[np.ndarray | None, int, tuple[np.ndarray, np.ndarray] | None]:
    """Levenberg-Marquardt from the best of many points drawn between the bounds, from the first guess, and from ``known`` points.

    The best end, the simulations that it took, and residual and Jacobian there.
    """
    lower, upper = problem.box
    drawn = np.vstack([_draw(problem, 8 * starts, seed), *(np.clip(problem.point(other), lower, upper)[None] for other in family.others)])
    found = np.asarray(costs(problem, jnp.asarray(drawn)))
    points = np.vstack(
        [
            problem.nominal,
            *(np.clip(point, lower, upper)[None] for point in known),
            drawn[np.argsort(np.where(np.isfinite(found), found, np.inf))[: starts - 1]],
        ]
    )
    rng, simulations, best, least, slopes = np.random.default_rng(seed), len(drawn), None, math.inf, None
    for _ in range(_ROUNDS):
        before = least
        for point in points:
            solved = least_squares.Search(residual, problem, point[None], lower, upper, size=problem.size).advance(max_steps).result()
            simulations += solved.simulations
            if solved.costs[0] < least:
                least, best, slopes = float(solved.costs[0]), solved.points[0], (solved.residuals[0], solved.jacobians[0])
        if best is None or not family.kinked or not least < (1.0 - _LOWER) * before:
            break
        points = best + _BESIDE * rng.standard_normal((_SIDES, len(best)))
    return best, simulations * problem.data.measured.shape[0], slopes


def _draw(problem: OperatorProblem, count: int, seed: int) -> np.ndarray:
    """Points in the box, shape ``(count, p)``: each number is the first guess's or drawn, half and half.

    Numbers that may be of any size, such as time constants, are drawn by their logarithm.
    """
    low, width = np.asarray(problem.lower), np.asarray(problem.width)
    rng = np.random.default_rng(seed)
    share = rng.uniform(*problem.box, (count, len(low)))
    wide = (low > 0.0) & (low + width > _WIDE * low)
    safe = np.where(wide, low, 1.0)
    drawn = np.where(wide, safe * (((safe + width) / safe) ** share - 1.0) / np.where(width > 0.0, width, 1.0), share)
    return np.where(rng.random(drawn.shape) < 0.5, problem.nominal, drawn)


def _by_reverse(
    problem: OperatorProblem, weights: jax.Array, starts: int, seed: int, max_steps: int
) -> tuple[np.ndarray | None, int, float]:
    """Fits under each ridge to the first rows, then under the one that predicts the last ones best to all of them, from several starts.

    Ridges get weaker until two in turn are no better than those before. One is as good as the worst of the fits under it: one that leaves
    networks which run away may still be lucky once. What counts is the error of the last rows and, since a fit to all rows will have seen
    these, that of the others too, in the shares in which Efron (1983, the .632 estimator) weighs what a fit did not see and what it did.
    """
    (lower, upper), rng = problem.box, np.random.default_rng(seed)
    points = np.clip(problem.nominal + (upper > lower) * _DRAWN * rng.standard_normal((starts, len(lower))), lower, upper)
    earlier, later = parted(problem)
    errors, simulations = [], 0
    for ridge in _RIDGES:
        if len(errors) > 2 and min(errors[-2:]) >= min(errors[:-2]):
            break
        found = _trained(_ridged(earlier, weights, ridge), points, max_steps)
        simulations += found.simulations
        hidden, seen = (_mean(part, found.vectors) for part in (later, earlier))
        errors.append(float(np.max(_HIDDEN * hidden + (1.0 - _HIDDEN) * seen)))
    ridge = _RIDGES[int(np.argmin(errors))] if min(errors) < math.inf else _RIDGES[0]
    found = _trained(_ridged(problem, weights, ridge), points, max_steps)
    simulations += found.simulations
    best = int(np.argmin(found.costs))
    return found.vectors[best] if found.costs[best] < math.inf else None, simulations * problem.data.measured.shape[0], ridge


def _mean(problem: OperatorProblem, vectors: np.ndarray) -> np.ndarray:
    """Root of the mean square of the residual at each point, shape ``(s,)``; infinite where it is no number."""
    found = np.sqrt(np.asarray(costs(problem, jnp.asarray(vectors))) / max(int(jnp.sum(problem.data.weight > 0)), 1))
    return np.where(np.isfinite(found), found, math.inf)


def parted(problem: OperatorProblem) -> tuple[OperatorProblem, OperatorProblem]:
    """The problem that sees the first rows of each recording only, and the one that sees the others only."""
    seen = np.cumsum(np.asarray(problem.data.weight) > 0, axis=1)
    early = jnp.asarray(seen <= _EARLIER * seen[:, -1:])

    def of(rows: jax.Array) -> OperatorProblem:
        return dataclasses.replace(problem, data=dataclasses.replace(problem.data, weight=jnp.where(rows, problem.data.weight, 0.0)))

    return of(early), of(~early)


def _ridged(problem: OperatorProblem, weights: jax.Array, ridge: float) -> Ridged:
    return Ridged(problem.data, problem, ridge * jnp.sqrt(jnp.sum(problem.data.weight > 0)) * weights * problem.width)


class _Trained(NamedTuple):
    """Where searches ended, ``(s, p)``, their costs, ``(s,)``, infinite where that is no number, and the simulations of each recording."""

    vectors: np.ndarray
    costs: np.ndarray
    simulations: int


def _trained(ridged: Ridged, points: np.ndarray, max_steps: int) -> _Trained:
    """From each point open loop by Levenberg-Marquardt, then longer and longer stretches, then closed loop by BFGS in reverse mode."""
    problem, (lower, upper) = ridged.problem, ridged.box
    rows, simulations = problem.data.time.shape[1], 0
    for every in (1, 5, 25, 125, rows):
        stage = dataclasses.replace(ridged, problem=dataclasses.replace(problem, ahead=True, every=jnp.asarray(every)))
        steps = max_steps if every == rows else max_steps // 4
        solved = least_squares.Search(residual, stage, points, lower, upper, size=stage.size).advance(steps).result()
        simulations += solved.simulations
        points = solved.points
    vectors, after, taken = _closed(jnp.asarray(points), ridged, (jnp.asarray(lower), jnp.asarray(upper)))
    ends = np.stack([points, np.asarray(vectors)])
    found = np.stack([np.asarray(costs(ridged, jnp.asarray(points))), np.asarray(after)])
    found = np.where(np.isfinite(found), found, math.inf)
    lowest, each = np.argmin(found, axis=0), np.arange(len(points))
    # A gradient in reverse mode counts three.
    return _Trained(ends[lowest, each], found[lowest, each], simulations + 3 * int(np.sum(taken)))


@eqx.filter_jit
def _closed(points: jax.Array, ridged: Ridged, box: tuple[jax.Array, jax.Array]) -> tuple[jax.Array, jax.Array, jax.Array]:
    """Where BFGS ends from each point, the costs there, and its steps. It knows no box: what is outside stands for the nearest inside."""

    def cost(vector: jax.Array, ridged: Ridged) -> jax.Array:
        return jnp.mean(ridged.residual(within(vector, *box)) ** 2)

    def closed(point: jax.Array) -> tuple[jax.Array, jax.Array, jax.Array]:
        solution = optx.minimise(cost, optx.BFGS(rtol=1e-6, atol=1e-9), point, args=ridged, max_steps=300, throw=False)
        return within(solution.value, *box), cost(solution.value, ridged) * ridged.size, solution.stats["num_steps"]

    return jax.vmap(closed)(points)
