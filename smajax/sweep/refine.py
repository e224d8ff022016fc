"""The best designs of a sweep, made better along the metrics' gradients, within the space and the constraints.

A design's place in the space is scaled to 0..1 an axis (``look``); the search is SciPy's sequential quadratic programming (SLSQP). From a
design that breaks constraints it first moves to where they hold (``reach``).

A search goes on steps that resolve its start. What it finds may be faster: then it goes on from there, on finer ones, until they resolve
what it has found. So whatever is called better is so on steps that resolve it.
"""

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import replace
from typing import NamedTuple

import numpy as np
from scipy.optimize import minimize

from smajax.recording import Floats
from smajax.sweep.look import Look
from smajax.sweep.reach import reach
from smajax.sweep.room import FAR, as_constraints
from smajax.sweep.space import Axis
from smajax.sweep.study import AbstractStudy

_STEPS = 60


class Refined(NamedTuple):
    """A refined design: its values, its metrics, those it started from, and the simulations that it took.

    ``better`` if it is, as one that keeps the constraints is better than one that does not; ``rescued`` if its start did not.
    """

    design: Floats
    metrics: dict[str, float]
    before: dict[str, float]
    simulations: int
    better: bool
    rescued: bool = False


class _Asked(NamedTuple):
    """What is asked for, see ``refine``, wherever a search begins."""

    study: AbstractStudy
    name: str
    sign: float
    others: Mapping[str, str]
    limits: Mapping[str, tuple[float, float]]

    def within(self, before: Mapping[str, float]) -> dict[str, tuple[float, float]]:
        """The limits, and those that the ``others`` have at the start."""
        limits = dict(self.limits)
        for other, way in self.others.items():
            low, high = limits.get(other, (-np.inf, np.inf))
            limits[other] = (max(low, before[other]), high) if way == "max" else (low, min(high, before[other]))
        return limits

    def ahead(self, found: Mapping[str, float], before: Mapping[str, float], base: Mapping[str, float]) -> bool:
        """Whether what was found is better than another design's figures, keeps the limits, and is in nothing worse than the start."""
        return self.sign * found[self.name] < self.sign * base[self.name] and _keeps(self.within(before), found)


def _keeps(limits: Mapping[str, tuple[float, float]], values: Mapping[str, float]) -> bool:
    return all(low <= values[n] <= high for n, (low, high) in limits.items())


def refine(
    study: AbstractStudy,
    axes: Sequence[Axis],
    start: Floats,
    objectives: Mapping[str, str],
    limits: Mapping[str, tuple[float, float]],
) -> Refined:
    """Makes the first of ``objectives`` (metric: ``max`` or ``min``) better from a design, shape ``(axes,)``, that keeps all ``limits``.

    No other objective gets worse than it is there. Axes of listed values are held. The best design that was met and keeps the limits is
    returned, so it is never worse than the start. An infinite metric is as good or bad as can be and has no slope: from a design whose
    objective is infinite nothing is searched. Whole axes are searched as if they were not, then rounded and held while the others are
    searched again; and held where they were.
    """
    (name, way), *others = objectives.items()
    asked = _Asked(study, name, -1.0 if way == "max" else 1.0, dict(others), limits)
    counts = [k for k, axis in enumerate(axes) if axis.whole and not axis.values]
    if not counts:
        return _resolved(asked, axes, start)
    loose = _resolved(asked, [replace(axis, whole=False) for axis in axes], start)

    def held(place: Floats) -> tuple[list[Axis], Floats]:
        place = np.array(place, dtype=np.float64)
        place[counts] = np.rint(place[counts])
        return [replace(axis, values=(float(place[k]),)) if k in counts else axis for k, axis in enumerate(axes)], place

    stays = _resolved(asked, *held(start))
    moved = _resolved(asked, *held(loose.design), stays.before)
    ahead = asked.ahead(moved.metrics, stays.before, stays.metrics)
    spent = loose.simulations + stays.simulations + moved.simulations
    best = moved if ahead else stays
    return best._replace(before=stays.before, simulations=spent, better=ahead or stays.better)


def rescue(
    study: AbstractStudy,
    axes: Sequence[Axis],
    start: Floats,
    objectives: Mapping[str, str],
    limits: Mapping[str, tuple[float, float]],
) -> Refined:
    """As ``refine``, from a design that breaks ``limits``: it moves to where they hold, and goes on from there.

    Where it finds no such place, the design is the one that comes nearest, and is not ``better``.
    """
    there = reach(study, axes, start, limits)
    if there.beyond > 0.0:
        return Refined(there.design, there.metrics, there.before, there.simulations, False, True)
    one = refine(study, axes, there.design, objectives, limits)
    return one._replace(before=there.before, simulations=there.simulations + one.simulations, better=True, rescued=True)


def _resolved(asked: _Asked, axes: Sequence[Axis], start: Floats, before: Mapping[str, float] | None = None) -> Refined:
    """Searches on finer steps, each from where the last one ended, until they resolve that place.

    ``before`` are the figures that the other objectives must not fall behind, by default those of the start.
    """
    steps = asked.study.program(start)
    found, spent = _search(asked, axes, start, start, steps, before), 0
    while (needed := asked.study.program(found.design)) > steps:
        steps, spent = needed, spent + found.simulations
        found = _search(asked, axes, start, found.design, steps, before)
    if before is None and not found.better:
        found = found._replace(design=np.array(start, dtype=np.float64), metrics=found.before)
    return found._replace(simulations=spent + found.simulations)


def _search(
    asked: _Asked, axes: Sequence[Axis], start: Floats, begin: Floats, steps: int, given: Mapping[str, float] | None
) -> Refined:  # fmt: skip
    """One search on ``steps`` that begins at a design; ``start`` is what it has to be better than."""
    name, sign = asked.name, asked.sign
    look = Look(asked.study, axes, start, steps)
    origin, first = look.share(start), look.share(begin)
    before = dict(look.at(origin)[0])
    if not np.isfinite(before[name]):
        return Refined(look.design(origin), before, before, look.simulations, False)
    limits = asked.within(before if given is None else given)
    scales = {n: max(abs(v), 1e-300) if np.isfinite(v) else 1.0 for n, v in before.items()}

    def cost(share: Floats) -> tuple[float, Floats]:
        values, slopes = look.at(share)
        if not np.isfinite(values[name]) or not np.all(np.isfinite(slopes[name])):
            return (-FAR if sign * values[name] == -np.inf else FAR), np.zeros(len(look.moving))
        return sign * values[name] / scales[name], sign * slopes[name] / scales[name]

    if look.moving:
        box, options = [(0.0, 1.0)] * len(look.moving), {"maxiter": _STEPS, "ftol": 1e-8}
        kept = as_constraints(look, limits, scales)
        minimize(cost, first, jac=True, method="SLSQP", bounds=box, constraints=kept, options=options)
    good = {key: sign * values[name] for key, (values, _) in look.known.items() if not np.isnan(values[name]) and _keeps(limits, values)}
    best = min(good, key=lambda key: good[key]) if good else origin.tobytes()
    better = bool(good) and sign * look.known[best][0][name] < sign * before[name]
    return Refined(look.design(np.frombuffer(best)), look.known[best][0], before, look.simulations, better)


def starts(shares: Floats, order: Iterable[int], count: int, apart: float = 0.15) -> list[int]:
    """Up to ``count`` rows of designs' shares ``(m, axes)``, taken in ``order``, no two of them nearer than ``apart`` on every axis."""
    chosen: list[int] = []
    for row in order:
        if all(np.max(np.abs(shares[row] - shares[other])) >= apart for other in chosen):
            chosen.append(int(row))
        if len(chosen) == count:
            break
    return chosen
