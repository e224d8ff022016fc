"""Fits of networks: more weights than a recording can tell, held by a ridge, trained in open and then in closed loop.

The cost, the mean square over the output's variance, has ``ridge``^2 times the sum of squares of how far the weights went from the first
guess. Ridges are tried from the strongest on. Under the strongest, which leaves a network little more than a linear law, each start is
trained in open loop, over longer and longer stretches, and in closed loop; under each further one in closed loop alone, from where the ones
before ended and from a little beside. Most starts become one on the way, and where neurons that were alike part, those beside go the other
ways. Networks begun anywhere under a weak ridge often run away in closed loop; these seldom do.

What fits one order of inputs best may still run away on another. So each end is tried on the training recordings' inputs in other orders,
and those are taken that leave the outputs' range far behind on the fewest.
"""

import dataclasses
import math
import os
from concurrent.futures import ThreadPoolExecutor
from typing import NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import optimistix as optx

from smajax.fit import least_squares
from smajax.fit.operator_problem import Measured, OperatorProblem
from smajax.fit.searchable import Searchable, costs, residual
from smajax.kinks import within

_RIDGES = (0.3, 0.1, 0.03, 0.01, 3e-3, 1e-3)  # from what leaves a network little more than a linear law to what hardly holds its weights
_DRAWN, _BESIDE = 0.05, 0.005  # of the room between the bounds: how far from the first guess, and from an end, a search begins
_FOLDS = 4
_ALIKE = 1.1  # ridges whose errors are within this factor serve alike
_STRETCHES = (1, 5, 25, 125)  # rows that a network runs on its own before it does to the end
_ON_THE_WAY, _AT_THE_END = 1e-3, 1e-6  # the relative fall of the cost at which a search ends
_SHORTER = 4  # times fewer steps on the way
_ONE, _RIVAL = 1.001, 1.25  # ends within the first factor of each other's costs are one; those beyond the second of the least are dropped
_ENDS = 3
_FURTHEST = 0.5  # of the outputs' range: an end that goes further beyond it on known inputs in another order runs away
_PIECES, _ORDERS = 12, 8


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


class Network(NamedTuple):
    """Where a fit ended, shape ``(p,)``, or ``None`` where nothing gives numbers; the simulations it took; the ridge that it ended with;
    and on which share of the known inputs in other orders it runs away.
    """

    vector: np.ndarray | None
    simulations: int
    ridge: float
    away: float


def fit_network(problem: OperatorProblem, weights: jax.Array, starts: int, seed: int, max_steps: int) -> Network:
    """Fits under weaker and weaker ridges to all rows, and beside it to all but one stretch of them, each stretch in turn.

    ``weights``, shape ``(p,)``, is 1 for what a ridge holds. A ridge is as good as its fits predict the stretches that they do not see, by
    the worst of their ends: one that leaves networks which run away may still be lucky once. The strongest is taken that serves as well as
    the best, since another recording is never quite like this one; two in turn that are no better than those before are the last. Of a
    ridge's ends, and of the ridges, those come first that run away least often.
    """
    (lower, upper), rng = problem.box, np.random.default_rng(seed)
    room = upper > lower

    def beside(place: np.ndarray, far: float, count: int) -> np.ndarray:
        return np.clip(place + far * room * rng.standard_normal((count, len(lower))), lower, upper)

    parts, rows = parted(problem), problem.data.time.shape[1]
    fitted = [problem, *(seen for seen, _ in parts)]
    begun, on_the_way = beside(problem.nominal, _DRAWN, starts), (max_steps // _SHORTER, _ON_THE_WAY)
    first = _trained(_ridged(problem, weights, _RIDGES[0]), begun, (*_STRETCHES, rows), *on_the_way)
    ends, simulations, errors, best = [first] * len(fitted), first.simulations, [], []
    for ridge in _RIDGES:
        points = [np.vstack([one.vectors, beside(one.vectors[0], _BESIDE, _ENDS - len(one.vectors))]) for one in ends]
        held = [_ridged(part, weights, ridge) for part in fitted]
        with ThreadPoolExecutor(os.cpu_count()) as pool:  # a search of one start is one thread
            ends = list(pool.map(lambda part, begun: _trained(part, begun, (rows,), *on_the_way), held, points))
        simulations += sum(one.simulations for one in ends)
        unseen = [np.max(_mean(hidden, one.vectors)) for (_, hidden), one in zip(parts, ends[1:], strict=True)]
        away = runs_away(problem, ends[0].vectors)
        errors.append((float(np.min(away)), float(np.sqrt(np.mean(np.square(unseen))))))
        best.append(ends[0].vectors[[np.argmin(away)]])
        if len(errors) > 2 and min(errors[-2:]) >= min(errors[:-2]) and min(errors)[0] == 0.0:
            break
    seldom, least = min(errors)
    chosen = next(k for k, error in enumerate(errors) if error <= (seldom, _ALIKE * least))
    last = _trained(_ridged(problem, weights, _RIDGES[chosen]), best[chosen], (rows,), max_steps, _AT_THE_END)
    ended = np.vstack([last.vectors, best[chosen]])
    away = runs_away(problem, ended)
    vector = ended[np.argmin(away)] if last.costs[0] < math.inf else None
    return Network(vector, (simulations + last.simulations) * problem.data.measured.shape[0], _RIDGES[chosen], float(np.min(away)))


def runs_away(problem: OperatorProblem, vectors: np.ndarray) -> np.ndarray:
    """On which share of the known inputs with their pieces in other orders, both ways, each point runs away; shape ``(s,)``."""
    data, rng = problem.data, np.random.default_rng(0)
    pieces, seen = np.array_split(np.arange(data.input.shape[1]), _PIECES), np.asarray(data.measured)[np.asarray(data.weight) > 0]
    room = _FURTHEST * np.ptp(seen)
    stays = []
    for way in _ORDERS * (1, -1):
        rows = np.concatenate([pieces[k] for k in rng.permutation(_PIECES)])[::way]
        other = dataclasses.replace(problem, data=dataclasses.replace(data, input=data.input[:, rows]))
        reached = np.asarray(_outputs(other, jnp.asarray(vectors)))
        stays.append(np.all((seen.min() - room <= reached) & (reached <= seen.max() + room), axis=(1, 2)))  # what is no number does not
    return 1.0 - np.mean(stays, axis=0)


@eqx.filter_jit
def _outputs(problem: OperatorProblem, vectors: jax.Array) -> jax.Array:
    """Outputs at points, shape ``(s, r, n)``."""
    return jax.lax.map(problem.predict, vectors)


def _mean(problem: OperatorProblem, vectors: np.ndarray) -> np.ndarray:
    """Root of the mean square of the residual at each point, shape ``(s,)``; infinite where it is no number."""
    found = np.sqrt(np.asarray(costs(problem, jnp.asarray(vectors))) / max(int(jnp.sum(problem.data.weight > 0)), 1))
    return np.where(np.isfinite(found), found, math.inf)


def parted(problem: OperatorProblem) -> list[tuple[OperatorProblem, OperatorProblem]]:
    """For each stretch of the measured rows the problem that sees all the others only, and the one that sees this one only."""
    seen = np.cumsum(np.asarray(problem.data.weight) > 0, axis=1)
    stretch = np.minimum(_FOLDS * (seen - 1) // np.maximum(seen[:, -1:], 1), _FOLDS - 1)

    def of(rows: np.ndarray) -> OperatorProblem:
        weight = jnp.where(jnp.asarray(rows), problem.data.weight, 0.0)
        return dataclasses.replace(problem, data=dataclasses.replace(problem.data, weight=weight))

    return [(of(stretch != k), of(stretch == k)) for k in range(_FOLDS)]


def _ridged(problem: OperatorProblem, weights: jax.Array, ridge: float) -> Ridged:
    return Ridged(problem.data, problem, ridge * jnp.sqrt(jnp.sum(problem.data.weight > 0)) * weights * problem.width)


class _Trained(NamedTuple):
    """The few best ends that differ, best first, ``(s, p)``, their costs, infinite where that is no number; simulations per recording."""

    vectors: np.ndarray
    costs: np.ndarray
    simulations: int


def _trained(ridged: Ridged, points: np.ndarray, stretches: tuple[int, ...], max_steps: int, rtol: float) -> _Trained:
    """From each point over each stretch by Levenberg-Marquardt, which is closed loop over the last; then by BFGS in reverse mode.

    One after another: a batch takes as long per start, and goes on until the last has ended.
    """
    problem, (lower, upper) = ridged.problem, ridged.box
    ends, found, simulations = [], [], 0
    for point in points:
        for every in stretches:
            stage = dataclasses.replace(ridged, problem=dataclasses.replace(problem, ahead=True, every=jnp.asarray(every)))
            search = least_squares.Search(residual, stage, point[None], lower, upper, size=stage.size, rtol=rtol)
            solved = search.advance(max_steps).result()
            simulations += solved.simulations
            point = solved.points[0]
        vector, taken = _closed(jnp.asarray(point), ridged, (jnp.asarray(lower), jnp.asarray(upper)))
        pair = np.stack([point, np.asarray(vector)])
        cost = np.asarray(costs(ridged, jnp.asarray(pair)))
        cost = np.where(np.isfinite(cost), cost, math.inf)
        best = int(np.argmin(cost))
        ends.append(pair[best])
        found.append(cost[best])
        simulations += 3 * int(taken)  # a gradient in reverse mode counts three
    order = np.argsort(found, stable=True)
    kept = [order[0]]
    for k in order[1:]:
        if _ONE * found[kept[-1]] < found[k] < _RIVAL * found[kept[0]]:
            kept.append(k)
    kept = kept[:_ENDS]
    return _Trained(np.stack(ends)[kept], np.array(found)[kept], simulations)


@eqx.filter_jit
def _closed(point: jax.Array, ridged: Ridged, box: tuple[jax.Array, jax.Array]) -> tuple[jax.Array, jax.Array]:
    """Where BFGS ends, shape ``(p,)``, and its steps. It knows no box: what is outside stands for the nearest inside."""

    def cost(vector: jax.Array, ridged: Ridged) -> jax.Array:
        return jnp.mean(ridged.residual(within(vector, *box)) ** 2)

    solution = optx.minimise(cost, optx.BFGS(rtol=1e-6, atol=1e-9), point, args=ridged, max_steps=300, throw=False)
    return within(solution.value, *box), solution.stats["num_steps"]
