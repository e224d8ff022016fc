"""In which stage a residual lives, and how a term of free form there would look.

Heat and material are each given a piecewise linear function of time, added as heat or as a shift of the transformation temperatures; the
place where the motion is measured, one that is added to the channel. Whatever of the residual such a function explains beyond the free
parameters, adjusted for its freedom, is the share that can live there. Drive, mechanism and sensor have no such function of their own
(a current is heat, and what happens between mechanism and sensor adds to the channel): their effects say which of them it is.
"""

import dataclasses
import math
from collections.abc import Mapping

import jax
import numpy as np

from smajax.diagnose import freeform, score
from smajax.diagnose.bench import Bench, in_pairs
from smajax.diagnose.hypothesis import Form, Refit
from smajax.diagnose.program import SLOTS

STAGES = ("drive", "heat", "material", "mechanism", "sensor")
_NODES = 5
_TIE = 0.1
_NONE = 0.02  # a share of which nothing can be told


@dataclasses.dataclass(frozen=True)
class Shape:
    """A term of free form, fitted: its stage and unit, what it stands against, where its nodes are and their values.

    ``train`` and ``select`` are the mean squares over the noise that the fit with it leaves, ``before`` that of ``train`` without it.
    """

    stage: str
    kind: str
    unit: str
    against: str
    at: np.ndarray
    term: np.ndarray
    before: float
    train: float
    select: float


def shares(bench: Bench, refit: Refit, q: np.ndarray, left: np.ndarray, columns: Mapping) -> dict[str, float]:
    """Share of a residual, projected on ``q``, that can live in each stage; ``columns`` are the effects' own."""
    known = {s: _share(q, left, [c for (key, _), c in columns.items() if bench.effects[key].stage == s]) for s in STAGES}
    span = (0.0, bench.duration)
    heat, material = (_share(q, left, _hats(bench, refit, kind, "time", span, freeform.KNOTS)) for kind in (0, 1))
    carried = _share(q, left, _carried(bench))
    late = max(known["mechanism"], known["sensor"], 1e-300)
    return {
        "drive": min(known["drive"], max(heat, known["heat"])),
        "heat": max(heat, known["heat"]),
        "material": max(material, known["material"]),
        "mechanism": max(known["mechanism"], carried * known["mechanism"] / late),
        "sensor": max(known["sensor"], carried * known["sensor"] / late),
    }


def likeliest(shares: Mapping[str, float]) -> str | None:
    """The stage to look at: the first of those whose share comes near the largest, since what is upstream shows further down.

    ``None`` if the residual can live in no stage: then it is as good as noise.
    """
    largest = max(shares.values())
    return next(s for s in STAGES if shares[s] >= max(largest - _TIE, 0.5 * largest)) if largest > _NONE else None


def shape(bench: Bench, refit: Refit, q: np.ndarray, left: np.ndarray, stage: str, stride: int = 1) -> Shape | None:
    """The term of free form in a stage that explains most, fitted beside all other parameters; ``None`` if no slot is left for it.

    With a ``stride``, fitted to the samples of ``bench.strided``.
    """
    nodes = min(_NODES, SLOTS - len(bench.moved(refit.hypothesis)))
    kinds = [1, 2] if stage in ("material", "mechanism", "sensor") else [0]
    if nodes < 3:
        return None
    against = [a for a in freeform.AGAINST if a != "time"]
    options = [(kind, a, _span(bench, refit, a)) for kind in kinds for a in against]
    options = [o for o in options if o[2][1] > o[2][0]]
    found = [_share(q, left, _hats(bench, refit, *o, nodes)) for o in options]
    if not found:
        return None
    kind, state, (low, high) = options[int(np.argmax(found))]
    form = Form(kind, state, low, high, _matrix(nodes) * _unit(bench, kind))
    fitted = bench.fit(refit.hypothesis, refit.base, max_steps=25, form=form, stride=stride)
    if not np.isfinite(fitted.chi2):
        return None
    moved = bench.moved(fitted.hypothesis)
    predicted = bench.predict_at(bench.problems[1], fitted.hypothesis, fitted.base, moved, form, fitted.nodes)
    made = freeform.KINDS[kind]
    at = np.linspace(low, high, nodes)
    return Shape(
        stage if made is freeform.FreeStrain else made.stage, made.key, made.adds, state, at, fitted.nodes * _unit(bench, kind),
        bench.fitness(refit.residual, 0), bench.fitness(fitted.residual, 0), bench.fitness(predicted, 1),
    )  # fmt: skip


def _span(bench: Bench, refit: Refit, against: str) -> tuple[float, float]:
    """Lowest and highest value of a state (a word of ``freeform.AGAINST``) over the training part, without effects."""
    low, high = math.inf, -math.inf
    for k, recording in enumerate(bench.parts[0].recordings):
        states = bench.states(refit, jax.tree.map(lambda leaf, k=k: leaf[k], bench.problems[0].data.inputs))
        martensite = np.asarray(states.fractions.martensite)[: len(recording)]
        travelled = np.cumsum(np.abs(np.diff(martensite, axis=0)), axis=0)
        temperature = np.asarray(states.temperature)[: len(recording)]
        values = {"temperature": temperature, "martensite": martensite, "travel": travelled}[against]
        low, high = min(low, float(values.min())), max(high, float(values.max()))
    return low, high


def _unit(bench: Bench, kind: int) -> float:
    """A change of order one: what ten kelvins do to the heat balance, a kelvin, a hundredth of a per cent."""
    plant = bench.problems[0].plant
    return (10.0 * float(plant.heat.conductance(plant.environment.ambient, plant.wire)), 1.0, 1e-4)[kind]


def _matrix(nodes: int) -> np.ndarray:
    return freeform.hats(np.linspace(0.0, 1.0, freeform.KNOTS), nodes)


def _hats(bench: Bench, refit: Refit, kind: int, against: str, span: tuple[float, float], nodes: int) -> list[np.ndarray]:
    """The residual's derivative by each node of a free term."""
    matrix = _matrix(nodes) * _unit(bench, kind)
    forms = [Form(kind, against, *span, matrix[:, k : k + SLOTS]) for k in range(0, nodes, SLOTS)]
    found = in_pairs(lambda form: bench.evaluate(refit.hypothesis, refit.base, 0, (), form)[1][:, bench.size :], forms)
    return [bench.flat(c) for block in found for c in block.T]


def _carried(bench: Bench) -> list[np.ndarray]:
    """Hats along the rows added to each channel."""
    lengths = [len(v) for v in bench.series(np.zeros(bench.problems[0].data.measured.size)).values()]
    whole, columns = np.zeros(sum(lengths)), []
    for first, length in zip(np.cumsum([0, *lengths]), lengths, strict=False):
        for hat in freeform.hats(np.linspace(0.0, 1.0, length), freeform.KNOTS).T:
            columns.append(whole.copy())
            columns[-1][first : first + length] = hat
    return columns


def _share(q: np.ndarray, left: np.ndarray, columns: list[np.ndarray]) -> float:
    """Share of a projected residual that columns explain beyond ``q``, adjusted for their number (adjusted R squared)."""
    whole, n = float(left @ left), len(left)
    own = [p for c in columns if np.linalg.norm(p := score.project(q, c)) > 1e-3 * max(np.linalg.norm(c), 1e-300)]
    if not own or whole <= 0.0:
        return 0.0
    basis = score.basis(np.column_stack(own))
    explained, p = float(np.sum((basis.T @ left) ** 2)) / whole, basis.shape[1]
    return float(np.clip(1.0 - (1.0 - explained) * (n - 1) / max(n - p - 1, 1), 0.0, 1.0))
