"""The plant with every effect that its rig could have, and the recordings that serve a diagnosis, laid out alike.

Fits, scores, refits and predictions all run on one compiled program (``smajax.diagnose.program``). All parts (training, selection, holdout)
have as many recordings, of which those that fill up count nothing, on grids of one length.
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
from smajax.diagnose.hypothesis import Form, Hypothesis, Refit, Running
from smajax.diagnose.part import Part
from smajax.diagnose.program import SLOTS, Model, begin_search, compiling, simulated
from smajax.diagnose.steps import longer, pieces
from smajax.errors import InputError
from smajax.fit.least_squares import Solved, Stop
from smajax.fit.problem import Problem, Settings, build
from smajax.parameters import declarations
from smajax.plant.effect import AbstractEffect
from smajax.plant.plant import Plant
from smajax.recording import Recording

_MULTIPLE = 512
_POLISH = 8  # steps on all samples after a search on some of them


def in_pairs(function: Callable[[Any], Any], tasks: Sequence) -> list:
    """Results of a function over tasks, two at a time: a simulation keeps one core busy."""
    with ThreadPoolExecutor(2) as pool:
        return list(pool.map(function, tasks))


class Bench:
    """A rig's augmented plant with its recordings laid out alike: all that is simulated runs on one compiled program.

    ``parts`` are the training, selection and holdout recordings, in this order. ``plain`` is the rig as it is written down on the training
    part. Effects that are written down (``known``) stay, fitted where they are free; hypotheses are about the others.
    """

    def __init__(
        self,
        plant: Plant,
        parts: Sequence[Part | Recording],
        settings: Settings,
        *,
        interpolation: str,
        step: float | None = None,
    ):
        if settings.initial:
            raise InputError("a diagnosis takes no free start values: leave out fit.initial")
        self.parts = [Part((p,)) if isinstance(p, Recording) else p for p in parts]
        for recording in (r for part in self.parts for r in part.recordings):
            gaps = [c for c in settings.observe if not np.all(np.isfinite(recording.channels.get(c, 0.0)))]
            if gaps:
                raise InputError(f"{recording.name}: a diagnosis needs {gaps[0]} at every row: leave out the rows without a value")
        train = self.parts[0].recordings
        self.traits = plant.traits(tuple(settings.observe)) - (set() if all(r.has_clock for r in train) else {"clock"})
        self.duration = max(float(r.time[-1] - r.time[0]) for r in train)
        free = {name.split(".")[1] for name in settings.free if name.startswith("effects.")}
        own = {e.key: e for e in plant.effects if e.key in free or float(e.strength) != 0.0}  # at strength 0 it is not there
        self.known = tuple(own)
        self.effects = own | {k: _made(kind, train) for k, kind in catalogue().items() if k not in own and not kind.obstacle(self.traits)}
        augmented = dataclasses.replace(plant, effects=(*self.effects.values(), *freeform.absent()))
        self.names = tuple(f"effects.{key}.{name}" for key, kind in self.effects.items() for name in declarations(kind))
        self.values = np.array([float(parameters.get(augmented, name)) for name in self.names])
        self.channels = tuple(settings.observe)
        self._layout: dict[str, Any] = {"interpolation": interpolation, "step": step}
        self._pieces = 1  # steps of the layout that one of the problems' stands for
        self._rows = [part.rows() for part in self.parts]
        # Built together, so that all have the length of the longest and run on one program.
        everything = [r for part in self.parts for r in part.recordings]
        whole = build(augmented, everything, settings, **self._layout, multiple=_MULTIPLE)
        whole = dataclasses.replace(whole, data=dataclasses.replace(whole.data, until=jnp.max(whole.data.inputs.rows)))
        self.noise = dict(zip(self.channels, 1.0 / np.max(np.asarray(whole.data.weight), axis=(0, 2)), strict=True))
        self.shared, self.own = len(whole.shared), len(whole.own)
        self._split(whole)
        self.nominal, self.box = self._ends[0][0], self._ends[0][1:]
        self.plain = self._weighted(build(plant, train, settings, **self._layout), self._rows[0])
        self.set_noise(self.noise)
        self.simulations, self._counting = 0, threading.Lock()
        start = self._start(Hypothesis(), self.nominal, ())
        self._compiling = compiling(self.model(Hypothesis(), (), self.problems[0]), start)  # goes on while the small program fits

    def _split(self, whole: Problem) -> None:
        """Makes a problem of each part, and its vector's nominal values and ends: shared entries, then those of its own recordings.

        Parts with fewer recordings than the largest are filled up with their last one, whose own parameters are held then.
        """
        size, first = max(len(part.recordings) for part in self.parts), 0
        self.problems: list[Problem] = []
        self._ends: list[tuple[np.ndarray, np.ndarray, np.ndarray]] = []
        unknowns: tuple = ()
        for part in self.parts:
            count = len(part.recordings)
            recordings = first + np.minimum(np.arange(size), count - 1)
            own = self.shared + (recordings[:, None] * self.own + np.arange(self.own)).ravel()
            places = np.concatenate([np.arange(self.shared), own]).astype(int)
            unknowns = unknowns or tuple(whole.unknowns[i] for i in places)  # the same for all, so that they run on one program
            data = jax.tree.map(lambda leaf: leaf[recordings] if leaf.ndim else leaf, whole.data)  # noqa: B023
            self.problems.append(dataclasses.replace(whole, data=data, scales=whole.scales[places], unknowns=unknowns))
            nominal, (lower, upper) = whole.nominal[places], (side[places] for side in whole.box)
            held = np.arange(len(places)) >= self.shared + self.own * count
            self._ends.append((nominal, np.where(held, nominal, lower), np.where(held, nominal, upper)))
            first += count

    def _weighted(self, problem: Problem, rows: Sequence[np.ndarray]) -> Problem:
        """The problem with only these rows of each recording weighted, by the bench's noise; recordings that fill up count nothing."""
        weight = np.zeros(problem.data.weight.shape)
        each = np.array([1.0 / self.noise[c] for c in self.channels])
        for k, seen in enumerate(rows):
            weight[k][:, seen] = each[:, None]
        return dataclasses.replace(problem, data=eqx.tree_at(lambda d: d.weight, problem.data, jnp.asarray(weight)))

    def count(self, simulations: int) -> None:
        """Notes that so many simulations were run."""
        with self._counting:  # searches run two at a time
            self.simulations += simulations

    @property
    def samples(self) -> int:
        """How many samples of the training part count."""
        return int(np.sum(np.asarray(self.problems[0].data.weight) > 0.0))

    @property
    def size(self) -> int:
        """Length of the base vector: the rig's free parameters, then each training recording's own."""
        return len(self.nominal)

    def set_noise(self, noise: dict[str, float]) -> None:
        """Weights all recordings by these standard deviations (SI)."""
        self.noise = dict(noise)
        self.problems = [self._weighted(p, rows) for p, rows in zip(self.problems, self._rows, strict=True)]
        self._sparse: dict[int, Problem] = {}

    def padded(self, point: np.ndarray) -> np.ndarray:
        """The base vector of a point of ``plain``."""
        return np.append(point, self.nominal[len(point) :])

    def series(self, residual: np.ndarray, k: int = 0) -> dict[str, np.ndarray]:
        """A residual of part ``k`` over the noise as one series per channel, its recordings one behind the other."""
        by = residual.reshape(len(self.problems[k].data.measured), len(self.channels), -1)
        return {c: np.concatenate([by[r, i, rows] for r, rows in enumerate(self._rows[k])]) for i, c in enumerate(self.channels)}

    def inputs(self, k: int = 0) -> dict[str, np.ndarray]:
        """The driving channels of part ``k`` on the rows of ``series``."""
        pairs = list(zip(self.parts[k].recordings, self._rows[k], strict=True))
        return {name: np.concatenate([r.channels[name][rows] for r, rows in pairs]) for name in self.plain.plant.signals}

    def flat(self, residual: np.ndarray, k: int = 0) -> np.ndarray:
        """The samples of a residual that count."""
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

    def fitted(self, refit: Refit) -> Plant:
        """The plant with a refit's parameters and effects, without parameters that each recording has of its own."""
        shared, _ = self.problems[0].values(jnp.asarray(refit.base))
        plant = dataclasses.replace(self.plain.plant, effects=tuple(self.effects[key] for key in (*self.known, *refit.hypothesis.keys)))
        own = {name: value for name, value in refit.values.items() if name.split(".")[1] in refit.hypothesis.keys}
        return parameters.replace(plant, {**shared, **own})

    def states(self, refit: Refit, inputs: simulate.Inputs) -> Any:
        """States of the plant without effects, at a refit's parameters, under inputs laid out like the bench's own."""
        return _states(dataclasses.replace(self.fitted(refit), effects=()), inputs)[0]

    def scale(self, name: str) -> float:
        """A typical change of an effect's parameter."""
        _, key, field = name.split(".")
        if field == "strength":
            return self.effects[key].typical
        declared = declarations(self.effects[key])[field]
        return 0.3 * abs(self.values[self.names.index(name)]) or 0.15 * (declared.upper - declared.lower)

    def strided(self, stride: int) -> Problem:
        """The training part at every ``stride``-th sample, on steps as many times as long; laid out like the bench's own.

        A part without a clock, or whose steps would be too long for it, stays what it is.
        """
        if stride > 1 and stride not in self._sparse:
            self._sparse[stride] = self._longer(0, stride, self._pieces) or self.problems[0]
        return self._sparse[stride] if stride > 1 else self.problems[0]

    def _longer(self, k: int, stride: int, pieces: int) -> Problem | None:
        known = "clock" in self.traits
        return longer(self.problems[k], self.parts[k].recordings, stride, pieces=pieces, **self._layout) if known else None

    def lengthen(self, affordable: Callable[[Problem], bool]) -> None:
        """Goes on with one step from sample to sample, where there usually are more, if that is ``affordable`` on the training part."""
        count = pieces(self.problems[0], self.parts[0].recordings)
        if count > 1 and (first := self._longer(0, 1, count)) and affordable(first):
            others = [self._longer(k, 1, count) or p for k, p in enumerate(self.problems[1:], 1)]
            self._pieces, self.problems, self._sparse = count, [first, *others], {}

    def cost(self, hypothesis: Hypothesis, base: np.ndarray, stride: int) -> float:
        """Sum of the squared residuals over the noise on the training part, as far as ``strided`` sees it; infinite where it fails."""
        left = self.predict_at(self.strided(stride), hypothesis, base)
        return float(left @ left) if np.all(np.isfinite(left)) else math.inf

    def compiled(self) -> None:
        """Waits until the large programs are compiled."""
        for thread in self._compiling:
            thread.join()

    def model(self, hypothesis: Hypothesis, moved: Sequence[str], problem: Problem, form: Form | None = None) -> Model:
        """The program's data for a hypothesis on a problem; the parameters ``moved`` are the slots', in units of ``scale``.

        The slots after these are the nodes of a free term, if there is one.
        """
        knots = len(freeform.KINDS) * freeform.KNOTS
        fixed, matrix = np.append(self.values, np.zeros(knots)), np.zeros((len(self.names) + knots, SLOTS))
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

    def ends(self, moved: Sequence[str]) -> tuple[np.ndarray, np.ndarray]:
        """Lower and upper bounds of the base vector followed by the parameters ``moved``; instants are within the recordings."""
        declared = [declarations(self.effects[name.split(".")[1]])[name.split(".")[2]] for name in moved]
        highest = [min(d.upper, self.duration) if name.endswith(".instant") else d.upper for d, name in zip(declared, moved, strict=True)]
        lower = [d.lower / self.scale(name) for d, name in zip(declared, moved, strict=True)]
        upper = [high / self.scale(name) for high, name in zip(highest, moved, strict=True)]
        return np.append(self.box[0], lower), np.append(self.box[1], upper)

    def fit(
        self,
        hypothesis: Hypothesis,
        base: np.ndarray,
        *,
        max_steps: int = 25,
        rtol: float = 1e-5,
        form: Form | None = None,
        stride: int = 1,
    ) -> Refit:
        """Fits a hypothesis to the training part, from ``base`` and the hypothesis' own values; with a free term if there is one.

        With a ``stride``, to the samples of ``strided`` only.
        """
        return self.reached(self.search(hypothesis, base, rtol=rtol, form=form, stride=stride).advance(max_steps))

    def search(
        self,
        hypothesis: Hypothesis,
        base: np.ndarray,
        *,
        rtol: float = 1e-6,
        form: Form | None = None,
        near: bool = False,
        held: bool = False,
        stride: int = 1,
    ) -> Running:
        """The search of ``fit`` before its first step; with ``near``, the free parameters are held near the rig's own values.

        With ``held``, the effects' shapes stay what they are. It sees the samples of ``strided``.
        """
        moved, nodes = self.moved(hypothesis), form.matrix.shape[1] if form else 0
        lower, upper = (np.append(side, np.zeros(SLOTS - len(moved))) for side in self.ends(moved))
        if near:
            lower[: self.size], upper[: self.size] = map(self.padded, self.plain.search_box())
        lower[self.size + len(moved) :][:nodes], upper[self.size + len(moved) :][:nodes] = -math.inf, math.inf
        problem = self.strided(stride)
        stride = 1 if problem is self.problems[0] else stride
        model = self.model(hypothesis, moved, problem, form)
        start = self._start(hypothesis, base, moved)
        if held:
            shapes = slice(self.size + len(hypothesis.keys), self.size + len(moved))
            lower[shapes] = upper[shapes] = start[shapes]
        return Running(begin_search(model, start, lower, upper, rtol), hypothesis, form, stride, near, rtol, self.count)

    def whole(self, running: Running, steps: int = _POLISH) -> Running:
        """A search that sees some of the samples, gone on from where it stands with all of them, by at most so many steps."""
        if running.stride == 1:
            return running
        found, base, _ = self._ended(running)
        return self.search(found, base, near=running.near, rtol=running.rtol).advance(steps)

    def reached(self, running: Running) -> Refit:
        """Where a search ends: residual and Jacobian there are those of all samples."""
        found, base, solved = self._ended(running)
        moved = self.moved(found)
        columns = self.size + len(moved)
        nodes = solved.points[0][columns:][: running.form.matrix.shape[1] if running.form else 0]
        if running.stride == 1:
            left, jacobian = solved.residuals[0], solved.jacobians[0]
        else:
            left, jacobian = self.evaluate(found, base, 0, moved, running.form, nodes)
        stop = solved.stops[0] if np.all(np.isfinite(left)) else Stop.failed
        return Refit(found, base, left, jacobian[:, :columns], stop, nodes)

    def _ended(self, running: Running) -> tuple[Hypothesis, np.ndarray, Solved]:
        """The hypothesis with the values where a search stands, the base vector there, and all that the search says."""
        solved, moved = running.search.result(), self.moved(running.hypothesis)
        point = solved.points[0]
        found = running.hypothesis.at({name: float(point[self.size + j] * self.scale(name)) for j, name in enumerate(moved)})
        return found, point[: self.size], solved

    def evaluate(
        self,
        hypothesis: Hypothesis,
        base: np.ndarray,
        k: int,
        moved: Sequence[str] = (),
        form: Form | None = None,
        nodes: np.ndarray | None = None,
    ) -> tuple[np.ndarray, np.ndarray]:
        """Residual on part ``k`` and its derivatives by the free parameters, by ``moved`` and by a free term's nodes."""
        if k and self.own:
            base = self._anchored(hypothesis, base, k)
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
        columns = self.size + len(moved) + (form.matrix.shape[1] if form else 0)
        start, free = self._start(hypothesis, base, moved, nodes), np.full(self.size + SLOTS, math.inf)
        model = self.model(hypothesis, moved, problem, form)
        solved = begin_search(model, start, -free, free).advance(1).result()
        self.count(solved.simulations)
        failed = solved.stops[0] is Stop.failed
        return np.where(failed, math.nan, solved.residuals[0]), solved.jacobians[0][:, :columns]

    def predict(self, hypothesis: Hypothesis, base: np.ndarray, k: int) -> np.ndarray:
        """Residual on part ``k``, as by ``evaluate``, which takes twice as long."""
        if k and self.own:
            base = self._anchored(hypothesis, base, k)
        return self.predict_at(self.problems[k], hypothesis, base)

    def predict_at(
        self,
        problem: Problem,
        hypothesis: Hypothesis,
        base: np.ndarray,
        moved: Sequence[str] = (),
        form: Form | None = None,
        nodes: np.ndarray | None = None,
    ) -> np.ndarray:
        """As ``predict``, under the inputs of a problem that is laid out like the bench's own; with a free term if there is one."""
        start = jnp.asarray(self._start(hypothesis, base, moved, nodes))
        left = np.asarray(simulated(start, self.model(hypothesis, moved, problem, form)).residual)
        self.count(1)
        return left if math.isfinite(float(left @ left)) else np.full(len(left), math.nan)

    def _start(self, hypothesis: Hypothesis, base: np.ndarray, moved: Sequence[str], nodes: np.ndarray | None = None) -> np.ndarray:
        values = dict(hypothesis.values)
        slots = [values.get(name, float(self.values[self.names.index(name)])) / self.scale(name) for name in moved]
        slots += [] if nodes is None else list(nodes)
        return np.concatenate([base, slots, np.zeros(SLOTS - len(slots))])

    def _anchored(self, hypothesis: Hypothesis, base: np.ndarray, k: int) -> np.ndarray:
        """The base vector on part ``k``: shared parameters of ``base``, each recording's own fitted to its anchor."""
        nominal, *ends = self._ends[k]
        start, lower, upper = (np.concatenate([base[: self.shared], own[self.shared :], np.zeros(SLOTS)]) for own in (nominal, *ends))
        problem = self._weighted(self.problems[k], self.parts[k].anchor_rows())
        model = self.model(hypothesis, (), problem)
        solved = begin_search(model, start, lower, upper).advance(15).result()
        self.count(solved.simulations)
        return solved.points[0][: self.size]

    def under(self, recording: Recording) -> Problem | None:
        """A problem under other inputs, laid out like the bench's own; ``None`` if it would need a longer grid."""
        mine = self.problems[0]
        inputs = simulate.lay_out(mine.plant, recording, **self._layout)
        inputs = inputs.merged(1, held=self._layout["interpolation"] == "hold", pieces=self._pieces) if self._pieces > 1 else inputs
        count, grid = mine.data.inputs.time.shape
        samples = mine.data.inputs.rows.shape[1]
        if len(inputs.time) > grid or len(inputs.rows) > samples:
            return None
        inputs = jax.tree.map(lambda leaf: jnp.asarray(np.repeat(np.asarray(leaf)[None], count, axis=0)), inputs.padded(grid, samples))
        data = dataclasses.replace(mine.data, inputs=inputs, until=jnp.max(inputs.rows))
        return self._weighted(dataclasses.replace(mine, data=data), [np.arange(len(recording))])

    def grid(self, key: str) -> list[tuple[tuple[str, float], ...]]:
        """The shapes at which an effect is tried."""
        shapes = self.effects[key].shapes
        if not shapes:
            return [()]
        (name, values), *_ = shapes
        return [((name, v * self.duration if name == "instant" else v),) for v in values]


_states = eqx.filter_jit(simulate.run)


def _made(kind: type[AbstractEffect], recordings: Sequence[Recording]) -> AbstractEffect:
    values = {"strength": jnp.asarray(0.0)}
    if "reference" in declarations(kind):
        currents = [np.max(np.abs(v)) for r in recordings for c, v in r.channels.items() if c.startswith("current")]
        values["reference"] = jnp.asarray(float(max(currents, default=0.0)) or 1.0)
    return kind(**values)  # pyright: ignore[reportCallIssue]
