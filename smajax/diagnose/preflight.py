"""What an input can show of each effect, before anything is fitted: testable, absorbed by free parameters, or blind."""

import dataclasses
import math
from typing import NamedTuple

import numpy as np

from smajax.diagnose import score
from smajax.diagnose.bench import Bench
from smajax.diagnose.columns import effect_columns
from smajax.diagnose.effects import catalogue
from smajax.diagnose.hypothesis import Hypothesis
from smajax.plant.effect import AbstractEffect

_ALL_OF_IT = 0.99


@dataclasses.dataclass(frozen=True)
class Sight:
    """What the training input can show of one effect.

    ``status`` is "testable", "absorbed" (the parameters ``absorbed_by`` do the same) or "blind" (``why`` says so); ``smallest`` is the
    smallest strength, SI, that stands out of the noise 3.5 times.
    """

    key: str
    stage: str
    unit: str
    status: str
    smallest: float | None
    absorbed_by: tuple[str, ...]
    why: str


class Promise(NamedTuple):
    """What an effect would explain of the residual at the rig's own values, to first order, beyond the free parameters.

    With the strength, in units of the typical one, and the shape with which it would explain most.
    """

    gain: float
    strength: float
    shape: tuple


def preflight(bench: Bench) -> tuple[dict[str, Sight], dict[str, Promise]]:
    """The sight of every effect of the catalogue at the rig's own values; noise as the bench has it. And what each promises there."""
    nominal = bench.nominal
    residual, jacobian = bench.evaluate(Hypothesis(), nominal, 0)
    jacobian = np.column_stack([bench.flat(c) for c in jacobian.T])
    q = score.basis(jacobian)
    left = score.project(q, bench.flat(residual))
    promise: dict[str, Promise] = {}
    columns = {item: bench.flat(column) for item, column in effect_columns(bench, Hypothesis(), nominal).items()}
    best: dict[str, tuple[score.Score, np.ndarray]] = {}
    for (key, shape), column in columns.items():
        one = bench.scored(key, q, left, column)
        if key not in promise or one.gain > promise[key].gain:
            promise[key] = Promise(one.gain, one.strength, shape)
        if key not in best or one.smallest < best[key][0].smallest:
            best[key] = (one, column)
    names = [u.label for u in bench.problems[0].unknowns]
    seen = {key: sight(kind, *best[key], jacobian, names) if key in best else unseen(bench, kind) for key, kind in catalogue().items()}
    return seen, promise


def sight(kind: type[AbstractEffect], one: score.Score, column: np.ndarray, jacobian: np.ndarray, names: list[str]) -> Sight:
    """The sight of an effect from its score."""
    reach = max(map(abs, kind.plausible())) / kind.typical
    smallest = one.smallest * kind.typical if math.isfinite(one.smallest) else None
    if one.absorbed >= kind.absorbed_from:
        return Sight(kind.key, kind.stage, kind.unit(), "absorbed", smallest, absorbers(column, jacobian, names), "")
    if not one.smallest < reach:
        return Sight(kind.key, kind.stage, kind.unit(), "blind", smallest, (), "this input does not show it at any plausible strength")
    return Sight(kind.key, kind.stage, kind.unit(), "testable", smallest, (), "")


def unseen(bench: Bench, kind: type[AbstractEffect]) -> Sight:
    """The sight of an effect that a rig has by its file, cannot have, or cannot show."""
    obstacle = kind.obstacle(bench.traits)
    why = obstacle if kind.no_mean_effect else f"this rig cannot show it: {obstacle}"
    return Sight(kind.key, kind.stage, kind.unit(), "blind", None, (), "the rig file has it" if kind.key in bench.known else why)


def absorbers(column: np.ndarray, jacobian: np.ndarray, names: list[str]) -> tuple[str, ...]:
    """The fewest parameters, found one after the other, that together do all but 1 % of what an effect does."""
    whole, chosen = float(column @ column), []
    size = np.linalg.norm(jacobian, axis=0)
    while len(chosen) < len(names):
        q = score.basis(jacobian[:, chosen])
        left = score.project(q, column)
        if left @ left <= (1.0 - _ALL_OF_IT) * whole:
            break
        rest = [i for i in range(len(names)) if i not in chosen and size[i] > 0]
        if not rest:
            break
        apart = [score.project(q, jacobian[:, i]) for i in rest]
        chosen.append(rest[int(np.argmax([abs(a @ left) / max(np.linalg.norm(a), 1e-300) for a in apart]))])
    return tuple(names[i] for i in sorted(chosen))
