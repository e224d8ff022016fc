"""The plant with every effect that its rig could have, all at strength 0, as one compiled program.

Fits, scores, refits and predictions all run on that program: a vector holds the rig's free parameters, then ``SLOTS`` slots; which
effect's strength or shape a slot moves is data (a matrix), so that no hypothesis needs a compilation of its own.
"""

import dataclasses
import math
import threading
from collections.abc import Callable, Sequence
from concurrent.futures import ThreadPoolExecutor
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np

from smajax import parameters, simulate
from smajax.diagnose import freeform, score
from smajax.diagnose.effects import catalogue
from smajax.errors import InputError
from smajax.fit import least_squares
from smajax.fit.least_squares import Stop
from smajax.fit.problem import Problem, Settings, build
from smajax.parameters import declarations
from smajax.plant.effect import AbstractEffect
from smajax.plant.plant import Plant
from smajax.recording import Recording

SLOTS = 6
_MULTIPLE = 512


class Model(eqx.Module):
    """What the compiled program takes beside the vector: a recording's problem, the effects' parameters, and what the slots move.

    ``fixed``, shape ``(n,)``, and ``moved``, shape ``(n, SLOTS)``, hold the named parameters and then the knots of the free terms, which
    are functions of ``free``: what they stand against, its low and its high, each of shape ``(len(freeform.AGAINST),)``.
    """

    problem: Problem
    fixed: jax.Array
    moved: jax.Array
    free: tuple[jax.Array, jax.Array, jax.Array]
    names: tuple[str, ...] = eqx.field(static=True)

    def residual(self, vector: jax.Array) -> jax.Array:
        """Model minus measurement over the noise, shape ``(c * n,)``."""
        base = len(self.problem.unknowns)
        values = self.fixed + self.moved @ vector[base:]
        plant = parameters.replace(self.problem.plant, {name: values[i] for i, name in enumerate(self.names)})
        plant = freeform.put(plant, values[len(self.names) :].reshape(len(freeform.KINDS), freeform.KNOTS), *self.free)
        return dataclasses.replace(self.problem, plant=plant).residual(vector[:base])


def _residual(vector: jax.Array, model: Model) -> jax.Array:
    return model.residual(vector)


def plain_residual(vector: jax.Array, problem: Problem) -> jax.Array:
    """The residual of a rig without effects."""
    return problem.residual(vector)


@dataclasses.dataclass(frozen=True)
class Hypothesis:
    """Effects that are there: their keys, and starting values of their strengths and shapes by parameter name."""

    keys: tuple[str, ...] = ()
    values: tuple[tuple[str, float], ...] = ()

    def extended(self, key: str, values: dict[str, float]) -> "Hypothesis":
        """With one more effect."""
        return Hypothesis((*self.keys, key), (*self.values, *values.items()))

    def without(self, key: str) -> "Hypothesis":
        """With one effect less."""
        prefix = f"effects.{key}."
        return Hypothesis(tuple(k for k in self.keys if k != key), tuple((n, v) for n, v in self.values if not n.startswith(prefix)))


@dataclasses.dataclass(frozen=True)
class Refit:
    """A hypothesis fitted: base vector ``(p,)``, effect parameters by name, residual and Jacobian (base, then moved parameters).

    ``nodes`` are those of a free term, where there is one.
    """

    hypothesis: Hypothesis
    base: np.ndarray
    residual: np.ndarray
    jacobian: np.ndarray
    stop: Stop
    nodes: np.ndarray = dataclasses.field(default_factory=lambda: np.zeros(0))

    @property
    def values(self) -> dict[str, float]:
        """Strengths and shapes by parameter name."""
        return dict(self.hypothesis.values)

    @property
    def chi2(self) -> float:
        """Sum of the squared residuals over the noise; infinite if the simulation fails at the start point."""
        return math.inf if self.stop is Stop.failed else float(self.residual @ self.residual)


@dataclasses.dataclass(frozen=True)
class Form:
    """A free term: its kind (row of ``freeform.KINDS``), what it stands against from ``low`` to ``high``, and its nodes.

    ``matrix``, shape ``(freeform.KNOTS, nodes)``, makes the knots of what the slots hold.
    """

    kind: int
    against: str
    low: float
    high: float
    matrix: np.ndarray


@dataclasses.dataclass
class Running:
    """A search that can go on: its hypothesis, the nodes of its free term, and how many of its simulations are counted already."""

    search: least_squares.Search
    hypothesis: Hypothesis
    nodes: int
    counted: int = 0

    def advance(self, steps: int) -> "Running":
        """At most so many steps more."""
        self.search.advance(steps)
        return self


class Bench:
    """A rig's augmented plant with its recordings laid out alike: all that is simulated runs on one compiled program."""

    def __init__(
        self,
        plant: Plant,
        recordings: Sequence[Recording],
        settings: Settings,
        *,
        interpolation: str,
        step: float | None = None,
    ):
        if settings.per_recording or settings.initial:
            raise InputError("a diagnosis takes one set of parameters for all recordings: leave out fit.per_recording and fit.initial")
        self.traits = plant.traits(tuple(settings.observe))
        train = recordings[0]
        self.duration = float(train.time[-1] - train.time[0])
        self.effects = {key: _made(kind, train) for key, kind in catalogue().items() if not kind.obstacle(self.traits)}
        augmented = dataclasses.replace(plant, effects=(*self.effects.values(), *freeform.absent()))
        self.names = tuple(f"effects.{key}.{name}" for key, kind in self.effects.items() for name in declarations(kind))
        self.nominal = np.array([float(parameters.get(augmented, name)) for name in self.names])
        self.plain = build(plant, recordings[:1], settings, interpolation=interpolation, step=step)
        self._layout: dict[str, Any] = {"interpolation": interpolation, "step": step}
        # Built together, so that all have the length of the longest and run on one program.
        whole = build(augmented, recordings, settings, **self._layout, multiple=_MULTIPLE)
        parts = [jax.tree.map(lambda leaf, k=k: leaf[k : k + 1], whole.data) for k in range(len(recordings))]
        self.problems = [dataclasses.replace(whole, data=data) for data in parts]
        self.recordings, self.channels = list(recordings), tuple(settings.observe)
        seen = np.max(np.asarray(whole.data.weight), axis=(0, 2))
        self.noise = {c: 1.0 / float(w) for c, w in zip(self.channels, seen, strict=True)}
        self.simulations = 0
        self._ready = threading.Thread(target=self.evaluate, args=(Hypothesis(), self.problems[0].nominal, 0), daemon=True)
        self._ready.start()  # the large program compiles while the small one fits

    @property
    def size(self) -> int:
        """Number of the rig's free parameters."""
        return len(self.problems[0].unknowns)

    def set_noise(self, noise: dict[str, float]) -> None:
        """Weights all recordings by these standard deviations (SI)."""
        self.noise = dict(noise)
        weight = np.array([1.0 / noise[c] for c in self.channels])[None, :, None]
        for k, problem in enumerate(self.problems):
            seen = np.asarray(problem.data.weight) > 0
            data = eqx.tree_at(lambda d: d.weight, problem.data, jnp.asarray(np.where(seen, weight, 0.0)))
            self.problems[k] = dataclasses.replace(problem, data=data)

    def series(self, residual: np.ndarray, k: int = 0) -> dict[str, np.ndarray]:
        """A residual over the noise as one series per channel."""
        count = len(self.recordings[k])
        return {c: residual.reshape(len(self.channels), -1)[i, :count] for i, c in enumerate(self.channels)}

    def flat(self, residual: np.ndarray, k: int = 0) -> np.ndarray:
        """The samples of a residual, without its filling."""
        return np.concatenate(list(self.series(residual, k).values()))

    def fitness(self, residual: np.ndarray, k: int) -> float:
        """Mean square of a residual over the noise: 1 where only noise is left."""
        return float(np.mean(self.flat(residual, k) ** 2))

    def plausible(self, key: str) -> tuple[float, float]:
        """An effect's plausible range over its typical strength."""
        low, high = self.effects[key].plausible()
        return low / self.effects[key].typical, high / self.effects[key].typical

    def scored(self, key: str, q: np.ndarray, left: np.ndarray, column: np.ndarray) -> score.Score:
        """The score of one effect's column against a projected residual."""
        return score.score(q, left, column, self.plausible(key), self.effects[key].absorbed_from)

    def many(self, function: Callable[[Any], Any], tasks: Sequence) -> list:
        """Results of a function over tasks, two at a time: a simulation keeps one core busy."""
        with ThreadPoolExecutor(2) as pool:
            return list(pool.map(function, tasks))

    def span(self, refit: Refit, against: str) -> tuple[float, float]:
        """Lowest and highest value of a state (a word of ``freeform.AGAINST``) over the training recording, without effects."""
        shared, _ = self.plain.values(jnp.asarray(refit.base))
        plant = parameters.replace(self.plain.plant, shared)
        states, _ = _states(plant, jax.tree.map(lambda leaf: leaf[0], self.plain.data.inputs))
        martensite = np.asarray(states.fractions.martensite)
        travelled = np.sum(np.abs(np.diff(martensite, axis=0)), axis=0)
        ends = {
            "temperature": (float(jnp.min(states.temperature)), float(jnp.max(states.temperature))),
            "martensite": (float(martensite.min()), float(martensite.max())),
            "travel": (0.0, float(travelled.max())),
        }
        return ends[against]

    def scale(self, name: str) -> float:
        """A typical change of an effect's parameter."""
        _, key, field = name.split(".")
        if field == "strength":
            return self.effects[key].typical
        declared = declarations(self.effects[key])[field]
        return 0.3 * abs(self.nominal[self.names.index(name)]) or 0.15 * (declared.upper - declared.lower)

    def compiled(self) -> None:
        """Waits until the large program is compiled."""
        self._ready.join()

    def model(self, hypothesis: Hypothesis, moved: Sequence[str], problem: Problem, form: "Form | None" = None) -> Model:
        """The program's data for a hypothesis on a problem; the parameters ``moved`` are the slots', in units of ``scale``.

        The slots after these are the nodes of a free term, if there is one.
        """
        knots = len(freeform.KINDS) * freeform.KNOTS
        fixed, matrix = np.append(self.nominal, np.zeros(knots)), np.zeros((len(self.names) + knots, SLOTS))
        for name, value in hypothesis.values:
            fixed[self.names.index(name)] = value
        for j, name in enumerate(moved):
            i = self.names.index(name)
            matrix[i, j] = self.scale(name)
            fixed[i] = 0.0
        free = (np.zeros(len(freeform.AGAINST)), np.zeros(len(freeform.AGAINST)), np.ones(len(freeform.AGAINST)))
        if form is not None:
            own = slice(len(self.names) + form.kind * freeform.KNOTS, len(self.names) + (form.kind + 1) * freeform.KNOTS)
            matrix[own, len(moved) : len(moved) + form.matrix.shape[1]] = form.matrix
            state = freeform.AGAINST.index(form.against)
            free[0][state], free[1][state], free[2][state] = 1.0, form.low, form.high
        against, low, high = map(jnp.asarray, free)
        return Model(problem, jnp.asarray(fixed), jnp.asarray(matrix), (against, low, high), self.names)

    def moved(self, hypothesis: Hypothesis) -> list[str]:
        """The parameters that a fit of a hypothesis frees: strengths first, then shapes as far as there are slots."""
        strengths = [f"effects.{key}.strength" for key in hypothesis.keys]
        shapes = [f"effects.{key}.{shape}" for key in hypothesis.keys for shape, _ in self.effects[key].shapes]
        return [*strengths, *shapes][:SLOTS]

    def fit(self, hypothesis: Hypothesis, base: np.ndarray, *, max_steps: int = 25, rtol: float = 1e-5, form: Form | None = None) -> Refit:
        """Fits a hypothesis to the training recording, from ``base`` and the hypothesis' own values; with a free term if there is one."""
        return self.reached(self.search(hypothesis, base, rtol=rtol, form=form).advance(max_steps))

    def search(self, hypothesis: Hypothesis, base: np.ndarray, *, rtol: float = 1e-6, form: Form | None = None) -> "Running":
        """The search of ``fit`` before its first step."""
        moved, values = self.moved(hypothesis), dict(hypothesis.values)
        lower, upper = (np.concatenate([b, np.zeros(SLOTS)]) for b in self.problems[0].box)
        start = np.concatenate([base, np.zeros(SLOTS)])
        for j, name in enumerate(moved):
            declared = declarations(self.effects[name.split(".")[1]])[name.split(".")[2]]
            lower[self.size + j], upper[self.size + j] = declared.lower / self.scale(name), declared.upper / self.scale(name)
            start[self.size + j] = values.get(name, float(self.nominal[self.names.index(name)])) / self.scale(name)
        nodes = form.matrix.shape[1] if form else 0
        lower[self.size + len(moved) :][:nodes], upper[self.size + len(moved) :][:nodes] = -math.inf, math.inf
        model = self.model(hypothesis, moved, self.problems[0], form)
        return Running(least_squares.Search(_residual, model, start[None], lower, upper, rtol=rtol), hypothesis, nodes)

    def reached(self, running: "Running") -> Refit:
        """Where a search stands."""
        solved, moved, values = running.search.result(), self.moved(running.hypothesis), dict(running.hypothesis.values)
        self.simulations += solved.simulations - running.counted
        running.counted = solved.simulations
        point, columns = solved.points[0], self.size + len(moved)
        found = {**values, **{name: float(point[self.size + j] * self.scale(name)) for j, name in enumerate(moved)}}
        return Refit(
            Hypothesis(running.hypothesis.keys, tuple(found.items())), point[: self.size], solved.residuals[0],
            solved.jacobians[0][:, :columns], solved.stops[0], point[columns : columns + running.nodes],
        )  # fmt: skip

    def evaluate(
        self,
        hypothesis: Hypothesis,
        base: np.ndarray,
        k: int,
        moved: Sequence[str] = (),
        form: Form | None = None,
        nodes: np.ndarray | None = None,
    ) -> tuple[np.ndarray, np.ndarray]:
        """Residual on recording ``k`` and its derivatives by the free parameters, by ``moved`` and by a free term's nodes."""
        return self.evaluate_at(self.problems[k], hypothesis, base, moved, form, nodes)

    def evaluate_at(
        self,
        problem: Problem,
        hypothesis: Hypothesis,
        base: np.ndarray,
        moved: Sequence[str] = (),
        form: Form | None = None,
        nodes: np.ndarray | None = None,
    ) -> tuple[np.ndarray, np.ndarray]:
        """As ``evaluate``, under the inputs of a problem that is laid out like the bench's own."""
        values = dict(hypothesis.values)
        start = np.concatenate([base, np.zeros(SLOTS)])
        for j, name in enumerate(moved):
            start[self.size + j] = values.get(name, float(self.nominal[self.names.index(name)])) / self.scale(name)
        columns = self.size + len(moved) + (form.matrix.shape[1] if form else 0)
        if nodes is not None:
            start[self.size + len(moved) : columns] = nodes
        model = self.model(hypothesis, moved, problem, form)
        free = np.full(len(start), math.inf)
        solved = least_squares.Search(_residual, model, start[None], -free, free).advance(1).result()
        self.simulations += solved.simulations
        failed = solved.stops[0] is Stop.failed
        return np.where(failed, math.nan, solved.residuals[0]), solved.jacobians[0][:, :columns]

    def under(self, recording: Recording) -> Problem | None:
        """A problem under other inputs, laid out like the bench's own; ``None`` if it would need a longer grid."""
        mine = self.problems[0]
        inputs = simulate.lay_out(mine.plant, recording, **self._layout)
        grid, samples = mine.data.inputs.time.shape[1], mine.data.inputs.rows.shape[1]
        if len(inputs.time) > grid or len(inputs.rows) > samples:
            return None
        inputs = jax.tree.map(lambda leaf: jnp.asarray(leaf)[None], inputs.padded(grid, samples))
        seen = np.arange(samples) < len(recording)
        weight = np.max(np.asarray(mine.data.weight), axis=-1, keepdims=True) * seen
        data = dataclasses.replace(mine.data, inputs=inputs, weight=jnp.asarray(weight))
        return dataclasses.replace(mine, data=data)

    def columns(self, hypothesis: Hypothesis, base: np.ndarray) -> dict[tuple[str, tuple[tuple[str, float], ...]], np.ndarray]:
        """The residual's derivative by the strength of every effect that is not there yet, at each value of its shape's grid.

        Keyed by effect and shape; in units of the typical strength; on the training recording.
        """
        wanted = [(key, shape) for key in self.effects if key not in hypothesis.keys for shape in self.grid(key)]
        batches: list[list[tuple[str, tuple[tuple[str, float], ...]]]] = []
        for item in wanted:
            home = next((b for b in batches if len(b) < SLOTS and all(other[0] != item[0] for other in b)), None)
            if home is None:
                batches.append(home := [])
            home.append(item)

        def one(batch: list) -> list[np.ndarray]:
            at = hypothesis
            for key, shape in batch:
                at = Hypothesis(at.keys, (*at.values, *((f"effects.{key}.{n}", v) for n, v in shape)))
            _, jacobian = self.evaluate(at, base, 0, [f"effects.{key}.strength" for key, _ in batch])
            return [jacobian[:, self.size + j] for j in range(len(batch))]

        found = self.many(one, batches)
        return {item: column for batch, columns in zip(batches, found, strict=True) for item, column in zip(batch, columns, strict=True)}

    def grid(self, key: str) -> list[tuple[tuple[str, float], ...]]:
        """The shapes at which an effect is tried."""
        shapes = self.effects[key].shapes
        if not shapes:
            return [()]
        (name, values), *_ = shapes
        return [((name, v * self.duration if name == "instant" else v),) for v in values]


_states = eqx.filter_jit(simulate.run)


def _made(kind: type[AbstractEffect], recording: Recording) -> AbstractEffect:
    values = {"strength": jnp.asarray(0.0)}
    if "reference" in declarations(kind):
        largest = max((float(np.max(np.abs(v))) for c, v in recording.channels.items() if c.startswith("current")), default=1.0)
        values["reference"] = jnp.asarray(largest or 1.0)
    return kind(**values)  # pyright: ignore[reportCallIssue]
