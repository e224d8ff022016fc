"""The best designs of a sweep, made better along the metrics' gradients, within the space and the constraints.

A design's place in the space is scaled to 0..1 an axis; metrics and their derivatives come from one simulation with its tangents, which
counts as 1 + axes simulations; the search is SciPy's sequential quadratic programming (SLSQP).

A search goes on steps that resolve its start. What it finds may be faster: then it goes on from there, on finer ones, until they resolve
what it has found. So whatever is called better is so on steps that resolve it.
"""

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import replace
from typing import NamedTuple

import jax.numpy as jnp
import numpy as np
from scipy.optimize import minimize

from smajax.jax_options import on_processor
from smajax.recording import Floats
from smajax.sweep.space import Axis
from smajax.sweep.study import AbstractStudy, differentiate_batch

_INSIDE = 1e-6
_STEPS = 60
# What stands for an infinite cost or room in the search, in sizes of the start's.
_FAR = 1e6


class Refined(NamedTuple):
    """A refined design: its values, its metrics, those it started from, and the simulations that it took. ``better`` if it is."""

    design: Floats
    metrics: dict[str, float]
    before: dict[str, float]
    simulations: int
    better: bool


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
    moving = [k for k, axis in enumerate(axes) if not axis.values]
    study, name, sign = asked.study, asked.name, asked.sign
    known: dict[bytes, tuple[dict[str, float], dict[str, Floats]]] = {}

    def design_of(share: Floats) -> Floats:
        design = np.array(start, dtype=np.float64)
        for k, s in zip(moving, np.clip(share, 0.0, 1.0), strict=True):
            design[k] = axes[k].at(np.asarray([s]))[0]
        return design

    def at(share: Floats) -> tuple[dict[str, float], dict[str, Floats]]:
        key = np.asarray(share).tobytes()
        if key not in known:
            design = design_of(share)
            with on_processor():
                found, slopes, _ = differentiate_batch(study, jnp.asarray(design)[None], steps)
            per_share = np.array([_slope(axes[k], design[k]) for k in moving])
            values = {n: float(found[n][0]) for n in study.units}
            known[key] = values, {n: np.asarray(slopes[n][0])[moving] * per_share for n in study.units}
        return known[key]

    def share_of(design: Floats) -> Floats:
        return np.array([float(np.clip(axes[k].share(design[k]), 0.0, 1.0)) for k in moving])

    origin, first = share_of(start), share_of(begin)
    before = dict(at(origin)[0])
    if not np.isfinite(before[name]):
        return Refined(design_of(origin), before, before, 1 + len(axes), False)
    limits = asked.within(before if given is None else given)
    scales = {n: max(abs(v), 1e-300) if np.isfinite(v) else 1.0 for n, v in before.items()}
    bounds = [(n, end, way) for n, ends in limits.items() for end, way in zip(ends, (1.0, -1.0), strict=True) if np.isfinite(end)]

    def cost(share: Floats) -> tuple[float, Floats]:
        values, slopes = at(share)
        if not np.isfinite(values[name]) or not np.all(np.isfinite(slopes[name])):
            return (-_FAR if sign * values[name] == -np.inf else _FAR), np.zeros(len(moving))
        return sign * values[name] / scales[name], sign * slopes[name] / scales[name]

    def room(share: Floats) -> Floats:
        values = at(share)[0]
        left = np.array([way * (values[n] - end) / _scale(end, scales[n]) - _INSIDE for n, end, way in bounds])
        return np.nan_to_num(left, nan=-_FAR, posinf=_FAR, neginf=-_FAR)

    def room_slope(share: Floats) -> Floats:
        slopes = at(share)[1]
        rows = np.array([way * slopes[n] / _scale(end, scales[n]) for n, end, way in bounds])
        return np.where(np.isfinite(rows), rows, 0.0)

    kept = [{"type": "ineq", "fun": room, "jac": room_slope}] if bounds else []
    if moving:
        box, options = [(0.0, 1.0)] * len(moving), {"maxiter": _STEPS, "ftol": 1e-8}
        minimize(cost, first, jac=True, method="SLSQP", bounds=box, constraints=kept, options=options)
    good = {key: sign * values[name] for key, (values, _) in known.items() if not np.isnan(values[name]) and _keeps(limits, values)}
    best = min(good, key=lambda key: good[key]) if good else origin.tobytes()
    better = bool(good) and sign * known[best][0][name] < sign * before[name]
    return Refined(design_of(np.frombuffer(best)), known[best][0], before, len(known) * (1 + len(axes)), better)


def starts(shares: Floats, order: Iterable[int], count: int, apart: float = 0.15) -> list[int]:
    """Up to ``count`` rows of designs' shares ``(m, axes)``, taken in ``order``, no two of them nearer than ``apart`` on every axis."""
    chosen: list[int] = []
    for row in order:
        if all(np.max(np.abs(shares[row] - shares[other])) >= apart for other in chosen):
            chosen.append(int(row))
        if len(chosen) == count:
            break
    return chosen


def _slope(axis: Axis, value: float) -> float:
    """d value / d share."""
    return value * float(np.log(axis.upper / axis.lower)) if axis.log else axis.upper - axis.lower


def _scale(end: float, size: float) -> float:
    return max(abs(end), 1e-3 * size)
