"""Fits of input-output laws: hysteresis operators and black boxes, from one input channel to one output channel.

What is fitted is in ``operator_problem``; here is the search for laws of few numbers, that for networks is in ``networks``, and what either
leaves: the law, its numbers and their intervals.
"""

import dataclasses
import math
import time
from collections.abc import Iterator, Sequence
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jax.flatten_util import ravel_pytree

from smajax import simulate
from smajax.errors import NumericsError
from smajax.fit import least_squares, uncertainty
from smajax.fit.networks import fit_network
from smajax.fit.operator_problem import Family, OperatorProblem, Series, build_operator, check_rows, check_steps
from smajax.fit.searchable import costs, residual
from smajax.hysteresis.operator import AbstractOperator

_WIDE = 30.0
_ROUNDS = 5  # of starts, each but the first beside the best end so far
_SIDES = 3
_BESIDE = 0.01  # of the room between the bounds
_LOWER = 1e-3  # a round that lowers the cost by less than this share is the last
_AT = 1e-6  # a parameter this share of its room away from a bound is at it


@dataclasses.dataclass(frozen=True)
class OperatorFit:
    """A fitted law; ``rmse`` of the training series in the output's unit, pooled, and what it took (s of wall, compiling included).

    ``step`` is the time between the rows that it was fitted to, s; ``ridge`` what held a network's weights, and ``away`` on which share of
    its inputs in other orders it runs away, 0 of other laws. ``half`` are
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
    away: float = 0.0
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

    A network has more weights than a recording can tell; what holds them is in ``smajax.fit.networks``.
    """
    began = time.perf_counter()
    problem, ridge, away, slopes = build_operator(family, series), 0.0, 0.0, None
    samples = int(np.sum(np.asarray(problem.data.weight) > 0))
    check_rows(" and ".join(s.name for s in series), samples, family.size, family.name)
    simpler = []
    if family.weights is None:
        simpler = [(fit_operator(one, series, starts=starts, seed=seed, max_steps=max_steps), write) for one, write in family.holds]
        known = [problem.point(write(one.parameters)) for one, write in simpler]
        vector, simulations, slopes = _by_forward(problem, family, known, starts, seed, max_steps)
        simulations += sum(one.simulations for one, _ in simpler)
    else:
        vector, simulations, ridge, away = fit_network(problem, ravel_pytree(family.weights)[0], starts, seed, max_steps)
    if vector is None:
        raise NumericsError(f"{family.name}: no point between its bounds gives numbers: check the recordings' units")
    left = np.asarray(_weighted(jnp.asarray(vector), problem)) / float(jnp.max(problem.data.weight))
    flat = problem.lower + jnp.asarray(vector) * problem.width
    rmse = float(np.sqrt(np.sum(left**2) / samples))
    if family.frugal:
        fewer = simpler[-1][0]
        if 2.0 * samples * math.log(fewer.rmse / rmse) < (family.size - fewer.family.size) * math.log(samples):
            return dataclasses.replace(fewer, simulations=simulations, wall=time.perf_counter() - began)
    maker: Any = problem.make
    return OperatorFit(
        family, problem.make(flat), maker.unravel(flat), rmse, samples, simulations,
        time.perf_counter() - began, float(np.median(np.diff(series[0].time))), ridge, away,
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
