"""From a design that breaks constraints to one that keeps them, by their gradients.

Each end of a constraint may lack some room, in sizes of that end; sought is where the least is lacking in all, and of such places the
nearest. So there always is an answer: where nothing lacks the constraints hold, and elsewhere some of them stand in each other's way.
"""

from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import NamedTuple

import numpy as np
from scipy.optimize import minimize

from smajax.recording import Floats
from smajax.sweep.front import beyond
from smajax.sweep.look import Look
from smajax.sweep.room import as_constraints
from smajax.sweep.space import Axis
from smajax.sweep.study import AbstractStudy

_STEPS = 60
# What a move across the whole space costs beside a constraint that is passed by its own size.
_NEAR = 1e-3


class Reached(NamedTuple):
    """Where a search ended: the design, its metrics, those at the start, how far beyond the constraints it is, and the simulations."""

    design: Floats
    metrics: dict[str, float]
    before: dict[str, float]
    beyond: float
    simulations: int


def reach(study: AbstractStudy, axes: Sequence[Axis], start: Floats, limits: Mapping[str, tuple[float, float]]) -> Reached:
    """Moves a design, shape ``(axes,)``, that breaks ``limits`` to where all of them hold; ``beyond`` is then 0.

    Where it finds no such place, it is the one it met that is least beyond. Whole axes are moved as if they were not, then rounded and
    held while the others are moved again.
    """
    counts = [k for k, axis in enumerate(axes) if axis.whole and not axis.values]
    found = _resolved(study, [replace(axis, whole=False) for axis in axes], np.array(start, dtype=np.float64), limits)
    if not counts:
        return found
    place = found.design.copy()
    place[counts] = np.rint(place[counts])
    held = [replace(axis, values=(float(place[k]),)) if k in counts else axis for k, axis in enumerate(axes)]
    whole = _resolved(study, held, place, limits)
    return whole._replace(before=found.before, simulations=found.simulations + whole.simulations)


def _resolved(study: AbstractStudy, axes: Sequence[Axis], start: Floats, limits: Mapping[str, tuple[float, float]]) -> Reached:
    """Searches on finer steps, each from where the last one ended, until they resolve that place."""
    steps = study.program(start)
    found, spent = _search(study, axes, start, steps, limits), 0
    while (needed := study.program(found.design)) > steps:
        steps, spent, before = needed, spent + found.simulations, found.before
        found = _search(study, axes, found.design, steps, limits)._replace(before=before)
    return found._replace(simulations=spent + found.simulations)


def _search(study: AbstractStudy, axes: Sequence[Axis], start: Floats, steps: int, limits: Mapping[str, tuple[float, float]]) -> Reached:
    look = Look(study, axes, start, steps)
    origin = look.share(start)
    before = dict(look.at(origin)[0])
    sizes = {n: abs(v) if np.isfinite(v) and v else 1.0 for n, v in before.items()}
    count = len(look.moving)
    (kept,) = as_constraints(look, limits, sizes)

    def cost(point: Floats) -> tuple[float, Floats]:
        moved, lacking = point[:count] - origin, point[count:]
        return float(np.sum(lacking) + 0.5 * _NEAR * np.sum(moved**2)), np.concatenate([_NEAR * moved, np.ones(len(lacking))])

    def room(point: Floats) -> Floats:
        return kept["fun"](point[:count]) + point[count:]

    def slope(point: Floats) -> Floats:
        rows = kept["jac"](point[:count])
        return np.hstack([rows, np.eye(len(rows))])

    if count:
        lacking = np.maximum(-kept["fun"](origin), 0.0)
        minimize(
            cost,
            np.concatenate([origin, lacking]),
            jac=True,
            method="SLSQP",
            bounds=[(0.0, 1.0)] * count + [(0.0, None)] * len(lacking),
            constraints=[{"type": "ineq", "fun": room, "jac": slope}],
            options={"maxiter": _STEPS, "ftol": 1e-9},
        )
    # Of several that keep the constraints the last one met is the nearest that they allow.
    far = {key: float(beyond(values, limits)) for key, (values, _) in look.known.items()}
    best = min(reversed(far), key=lambda key: far[key])
    return Reached(look.design(np.frombuffer(best)), look.known[best][0], before, far[best], look.simulations)
