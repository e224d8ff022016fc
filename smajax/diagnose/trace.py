"""From the residual of a fit to the effect that is missing: detect, rank, refit, accept on other data, again.

One round: the effects' scores say whether anything is missing and what is worth refitting; each of the best is added to the plant and all
is fitted again; the one that explains the training recording and predicts the selection recording best is accepted, if it lowers the error
there by more than ``CUT``. What explains both as well is its equivalence. After the last round each accepted effect is tried against its
rivals, and has to be missed if it is taken away again. ``smajax.diagnose.verdict`` looks at a third recording, once, at the end.
"""

import dataclasses
import math
from collections.abc import Callable, Sequence

import jax.numpy as jnp
import numpy as np

from smajax.diagnose import localise, residual, score
from smajax.diagnose.candidates import SLOTS, Bench, Hypothesis, Refit, plain_residual
from smajax.diagnose.effects import catalogue
from smajax.diagnose.preflight import Sight, hidden, preflight, sight
from smajax.errors import NumericsError
from smajax.fit import least_squares
from smajax.fit.least_squares import Stop
from smajax.fit.problem import Problem

DETECTED = 0.01
CUT = 0.05
ROUNDS = 3
_REFITTED = 8
_HEATS = ((99, 2), (5, 3), (4, 6), (2, 30))  # how many go on, and for how many steps
_APART = 3
_STATIONARY = 2e-2
_RIVALS = 3


@dataclasses.dataclass(frozen=True)
class Trial:
    """A refit with one effect more, and how it does: goodness of fit on the training and on the selection recording.

    ``rmse_select`` is that of the first observed channel on the selection recording, SI.
    """

    key: str
    refit: Refit
    train: float
    select: float
    rmse_select: float

    @property
    def total(self) -> float:
        """What trials are compared by."""
        return self.train + self.select


@dataclasses.dataclass(frozen=True)
class Ranked:
    """What is known of one effect after the first round; strengths in SI."""

    sight: Sight
    strength: float | None = None
    lower95: float | None = None
    upper95: float | None = None
    gain: float | None = None
    p_value: float | None = None
    refit_rmse_select: float | None = None


@dataclasses.dataclass
class Story:
    """What happened: from the first fit to the last, what was accepted, what else would do, what was refused and why.

    ``promise`` is what each effect would explain at the rig's nominal values, to first order: a large effect has bent the fit's
    parameters so far that scores there mislead.
    """

    preflight: dict[str, Sight]
    noise: dict[str, tuple[float, str]]
    first: Trial
    last: Trial
    limit: float
    promise: dict[str, float]
    accepted: list[str] = dataclasses.field(default_factory=list)
    rivals: dict[str, list[Trial]] = dataclasses.field(default_factory=dict)
    equivalent: dict[str, tuple[str, ...]] = dataclasses.field(default_factory=dict)
    rejected: list[tuple[str, str]] = dataclasses.field(default_factory=list)
    ranking: dict[str, Ranked] = dataclasses.field(default_factory=dict)
    stages: dict[str, float] = dataclasses.field(default_factory=dict)


class Tracer:
    """A bench, and what is done on it again and again."""

    def __init__(self, bench: Bench, seed: int):
        self.bench, self.seed = bench, seed

    def base(self, point: np.ndarray, stop: Stop) -> Refit:
        """The plant without effects at a fitted point."""
        self.bench.compiled()
        left, jacobian = self.bench.evaluate(Hypothesis(), point, 0)
        return Refit(Hypothesis(), point, left, jacobian, stop)

    def held(self, refit: Refit) -> np.ndarray:
        """Jacobian columns that are free to move: those of parameters on a bound that the data press against it are not."""
        lower, upper = self.bench.problems[0].box
        gradient = refit.jacobian[:, : self.bench.size].T @ refit.residual
        margin = 1e-9 * (1 + np.abs(refit.base))
        pressed = ((refit.base <= lower + margin) & (gradient > 0)) | ((refit.base >= upper - margin) & (gradient < 0))
        return np.append(~pressed, np.ones(refit.jacobian.shape[1] - self.bench.size, bool))

    def projection(self, refit: Refit) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Jacobian of the free columns, its orthonormal basis, and the residual beyond it."""
        jacobian = np.column_stack([self.bench.flat(c) for c in refit.jacobian[:, self.held(refit)].T])
        q = score.basis(jacobian)
        return jacobian, q, score.project(q, self.bench.flat(refit.residual))

    def scores(self, refit: Refit) -> "Scores":
        """Scores every effect that is not there yet, at each of its shapes."""
        bench = self.bench
        jacobian, q, left = self.projection(refit)
        columns = {item: bench.flat(column) for item, column in bench.columns(refit.hypothesis, refit.base).items()}
        found: dict[str, score.Score] = {}
        shapes: dict[str, tuple] = {}
        for (key, shape), column in columns.items():
            one = bench.scored(key, q, left, column)
            if key not in found or one.gain > found[key].gain:
                found[key], shapes[key] = one, shape
        return Scores(found, shapes, columns, jacobian, q, left, self.chance(refit, jacobian, columns))

    def chance(self, refit: Refit, jacobian: np.ndarray, columns: dict) -> float:
        """The p-value of the largest gain, the residual's own autocorrelation taken out first."""
        series = list(self.bench.series(refit.residual).values())
        models = [score.noise_model(s) for s in series]
        cuts = np.cumsum([len(s) for s in series])[:-1]

        def white(v: np.ndarray) -> np.ndarray:
            return np.concatenate([score.whiten(p, m[0]) / m[1] for p, m in zip(np.split(v, cuts), models, strict=True)])

        q = score.basis(np.column_stack([white(c) for c in jacobian.T]))
        left = score.project(q, white(self.bench.flat(refit.residual)))
        kept = {key: self.bench.scored(key[0], q, left, white(c)) for key, c in columns.items()}
        kept = {f"{key}{shape}": (s, self.bench.plausible(key)) for (key, shape), s in kept.items() if math.isfinite(s.smallest)}
        largest = max((s.gain for s, _ in kept.values()), default=0.0)
        return score.p_value({k: s.column for k, (s, _) in kept.items()}, {k: p for k, (_, p) in kept.items()}, largest, self.seed)

    def shares(self, refit: Refit, scores: "Scores | None" = None) -> dict[str, float]:
        """Share of a fit's residual that can live in each stage."""
        scores = scores or self.scores(refit)
        return localise.shares(self.bench, refit, scores.q, scores.left, scores.columns)

    def race(self, refit: Refit, keys: Sequence[str], scores: "Scores", also: np.ndarray | None) -> list[Trial]:
        """Fits with one effect more for each key: a few steps for all, then the best of them to their end.

        They start at the fit's own point with the expected strength, and at the point ``also`` with 0.4 of the typical one: what a large
        effect has done to the other parameters may lie in the way.
        """
        starts = []
        for key in keys:
            typical, name = self.bench.effects[key].typical, f"effects.{key}.strength"
            shape = {f"effects.{key}.{n}": v for n, v in scores.shapes[key]}
            low, high = self.bench.plausible(key)
            size = float(np.clip(scores.found[key].strength, max(low, -3.0), min(high, 3.0))) or 0.1
            starts.append((key, refit.hypothesis.extended(key, {name: size * typical, **shape}), refit.base))
            if also is not None:
                other = refit.hypothesis.extended(key, {name: math.copysign(0.4, size) * typical, **shape})
                starts.append((key, other, also))
        # Heats: the better half goes on, apart for the two kinds of start, since those from afar begin with larger errors.
        fields = [[self.bench.search(h, base) for _, h, base in starts if (base is also) == far] for far in (False, True)]
        everyone = [s for f in fields for s in f]
        for count, steps in _HEATS:
            fields = [sorted(f, key=lambda s: s.search.cost)[:count] for f in fields]
            if steps > _APART:
                whole = sorted((s for f in fields for s in f), key=lambda s: s.search.cost)
                fields = [[s for s in whole if s.search.cost < 4.0 * whole[0].search.cost][:count]]
            self.bench.many(lambda s: s.advance(steps), [s for f in fields for s in f])  # noqa: B023
        best: dict[str, Refit] = {}
        for found in sorted((self.bench.reached(s) for s in everyone), key=lambda r: r.chi2):
            best.setdefault(found.hypothesis.keys[-1], found)
        return self.bench.many(lambda item: self.judged(*item), [item for item in best.items() if math.isfinite(item[1].chi2)])

    def judged(self, key: str, refit: Refit) -> Trial:
        """A refit with its fitness on both recordings."""
        predicted, _ = self.bench.evaluate(refit.hypothesis, refit.base, 1)
        channel = self.bench.channels[0]
        rmse = float(np.sqrt(np.mean(self.bench.series(predicted, 1)[channel] ** 2))) * self.bench.noise[channel]
        return Trial(key, refit, self.bench.fitness(refit.residual, 0), self.bench.fitness(predicted, 1), rmse)


@dataclasses.dataclass(frozen=True)
class Scores:
    """Scores at one fit: the best of each effect, at which shape, all columns, the free parameters' Jacobian, its basis, the residual
    beyond it, and the probability of so large a gain by noise."""

    found: dict[str, score.Score]
    shapes: dict[str, tuple]
    columns: dict
    jacobian: np.ndarray
    q: np.ndarray
    left: np.ndarray
    chance: float


def critical(samples: int) -> float:
    """Fitness above which more than noise is left."""
    return 1.0 + 4.0 * math.sqrt(2.0 / (0.8 * samples))


def trace(bench: Bench, *, seed: int = 0, say: Callable[[str], None] = lambda text: None) -> tuple[Tracer, Story]:
    """Traces the residual of the bench's training recording, helped by the selection recording.

    Raises NumericsError if the first fit does not come to rest; its ``state`` holds the point where it ended.
    """
    say("fitting the rig as it is written down")
    point, stop, noise = _first_fit(bench, seed)
    bench.compiled()
    seen, gains = preflight(bench)
    counts = [sum(s.status == status for s in seen.values()) for status in ("testable", "absorbed", "blind")]
    say("preflight: {} effects are testable, {} are absorbed, {} are blind".format(*counts))
    bench.set_noise({c: value for c, (value, _) in noise.items()})
    tracer = Tracer(bench, seed)
    first = tracer.judged("", tracer.base(point, stop))
    samples = len(bench.flat(first.refit.residual))
    story = Story(seen, noise, first, first, critical(samples), gains)
    for turn in range(ROUNDS):
        if not _round(tracer, story, turn, say):
            break
    if len(story.accepted) > 1:
        say("looking for a better set of effects")
        _swap(tracer, story)
        _backward(tracer, story, samples)
    return tracer, story


def _first_fit(bench: Bench, seed: int) -> tuple[np.ndarray, Stop, dict[str, tuple[float, str]]]:
    """The rig as it is written down, fitted from its own values and from beside them: point, end, and noise by channel."""
    plain = bench.plain
    lower, upper = plain.search_box()
    nominal = np.clip(plain.nominal, lower, upper)
    aside = 0.1 * np.random.default_rng(seed).uniform(-1, 1, len(nominal)) * (upper - lower)
    solved = [
        least_squares.solve(plain_residual, plain, start[None], *plain.box, max_steps=100, rtol=1e-8)
        for start in (nominal, np.clip(nominal + aside, lower, upper))
    ]
    bench.simulations += sum(s.simulations for s in solved)
    best = min(solved, key=lambda s: s.costs[0] if math.isfinite(s.costs[0]) else math.inf)
    if best.stops[0] is Stop.failed:
        raise NumericsError("the simulation fails at the rig's own values: check them by smajax simulate")
    jacobian, left = best.jacobians[0], best.residuals[0]
    inside = (best.points[0] > plain.box[0]) & (best.points[0] < plain.box[1])
    if np.linalg.norm(score.basis(jacobian[:, inside]).T @ left) > _STATIONARY * np.linalg.norm(left):
        told = "the fit of the rig as it is written down did not come to rest, so its residual says nothing: widen fit.bounds"
        raise NumericsError(told, {name: float(v) for name, v in plain.values(jnp.asarray(best.points[0]))[0].items()})
    return best.points[0], best.stops[0], _noise(bench, plain, left)


def _noise(bench: Bench, plain: Problem, left: np.ndarray) -> dict[str, tuple[float, str]]:
    weight, recording = np.asarray(plain.data.weight)[0], bench.recordings[0]
    inputs = {name: recording.channels[name] for name in plain.plant.signals}
    found = {}
    for channel, part, w in zip(plain.channels, left.reshape(len(plain.channels), -1), weight, strict=True):
        value, source = residual.noise(part[: len(recording)] / float(np.max(w)), inputs)
        found[channel] = (value, source)
    return found


def _round(tracer: Tracer, story: Story, turn: int, say: Callable[[str], None]) -> bool:
    """One round; says whether an effect was accepted."""
    bench, current = tracer.bench, story.last
    samples = len(bench.flat(current.refit.residual))
    if turn and current.train < max(story.limit, 1.02):
        return False
    if len(bench.moved(current.refit.hypothesis)) >= SLOTS:
        return False
    say(f"round {turn + 1}: scoring {len(bench.effects) - len(story.accepted)} effects")
    scores = tracer.scores(current.refit)
    if turn == 0:
        story.stages = tracer.shares(current.refit, scores)
        story.ranking = _ranking(tracer, scores, current.refit)
    if scores.chance > DETECTED and current.train < story.limit:
        return False
    trials = _refits(tracer, story, scores, turn, say)
    if turn == 0:
        for t in trials:
            story.ranking[t.key] = dataclasses.replace(story.ranking[t.key], refit_rmse_select=t.rmse_select)
    best = min((t for t in trials if not _nothing(bench, t)), key=lambda t: t.total, default=None)
    if best is None:
        return False
    fall = (current.train - best.train) * samples
    cut = 1.0 - math.sqrt(best.select / current.select)
    if fall < 25.0 * max(1.0, best.train) or cut < CUT:
        why = f"cuts the error on the selection recording by {100 * cut:.1f} %, under the {100 * CUT:.0f} % that a cause must reach"
        story.rejected.append((best.key, why))
        return False
    near = sorted((t for t in trials if t.key != best.key and _as_good(t, best, samples)), key=lambda t: t.total)
    story.accepted.append(best.key)
    story.equivalent[best.key] = tuple(t.key for t in near)
    story.rivals[best.key] = sorted((t for t in trials if t.key != best.key), key=lambda t: t.total)[:_RIVALS]
    story.last = _settled(tracer, best)
    reached = math.sqrt(story.last.select)
    say(f"accepted {best.key}: error over noise {math.sqrt(current.select):.3g} -> {reached:.3g} on the selection recording")
    return True


def _refits(tracer: Tracer, story: Story, scores: Scores, turn: int, say: Callable[[str], None]) -> list[Trial]:
    """Refits of the effects that promise most, and of all others if none of these explains the residual."""
    refit = story.last.refit
    hopeful = [k for k, s in sorted(scores.found.items(), key=lambda item: -item[1].gain) if s.gain > 0.0]
    groups = score.classes({k: scores.found[k].column for k in hopeful})
    chosen = hopeful[:_REFITTED]
    if turn == 0:
        afar = [k for k in sorted(story.promise, key=lambda k: -story.promise[k]) if story.promise[k] > 0.0]
        chosen = list(dict.fromkeys([*hopeful[: _REFITTED // 2], *afar[: _REFITTED // 2]]))
    for key in chosen[:2]:  # all that look like the best ones
        chosen += [k for k in next((g for g in groups if key in g), ()) if k not in chosen]
    also = tracer.bench.problems[0].nominal if turn == 0 else None
    say(f"round {turn + 1}: refitting {len(chosen)} effects")
    trials = tracer.race(refit, chosen, scores, also)
    rest = [k for k in hopeful if k not in chosen]
    if rest and min((t.train for t in trials), default=math.inf) > max(story.limit, 1.15):
        say(f"round {turn + 1}: refitting {len(rest)} more")
        trials += tracer.race(refit, rest, scores, also)
    return [t for t in trials if math.isfinite(t.total)]


def _settled(tracer: Tracer, trial: Trial) -> Trial:
    """A trial fitted to its end: from its own point, and from the rig's nominal values with the effects that it has."""
    bench, hypothesis = tracer.bench, trial.refit.hypothesis
    starts = [trial.refit.base, bench.problems[0].nominal]
    ended = bench.many(lambda base: bench.fit(hypothesis, base, max_steps=60, rtol=1e-9), starts)
    return tracer.judged(trial.key, min(ended, key=lambda r: r.chi2))


def _nothing(bench: Bench, trial: Trial) -> bool:
    """Whether a trial's effect is as good as absent: what it improves is owed to a better point of the other parameters."""
    return abs(trial.refit.values[f"effects.{trial.key}.strength"]) < 1e-3 * bench.effects[trial.key].typical


def _as_good(trial: Trial, best: Trial, samples: int) -> bool:
    close = (trial.train - best.train) * samples < 10.0 * max(1.0, best.train)
    return close and trial.select < best.select + max(0.01, 10.0 * max(1.0, best.select) / samples)


def _swap(tracer: Tracer, story: Story) -> None:
    """Tries each accepted effect but the last against its rivals, beside the effects that were accepted after it."""
    bench = tracer.bench
    for key in list(story.accepted)[:-1]:
        tasks = [t for t in story.rivals[key] if t.key not in story.accepted]
        without = story.last.refit.hypothesis.without(key)

        def instead(rival: Trial, without: Hypothesis = without) -> Trial:
            own = {n: v for n, v in rival.refit.values.items() if n.split(".")[1] == rival.key}
            return tracer.judged(rival.key, bench.fit(without.extended(rival.key, own), rival.refit.base, max_steps=30, rtol=1e-6))

        tried = [t for t in bench.many(instead, tasks) if math.isfinite(t.total)]
        best = min(tried, key=lambda t: t.total, default=None)
        if best and best.train < story.last.train and best.select < (1.0 - CUT) ** 2 * story.last.select:
            story.rejected.append((key, f"{best.key} in its place explains more, beside the other effects"))
            story.accepted[story.accepted.index(key)] = best.key
            story.equivalent[best.key] = ()
            story.last = _settled(tracer, best)


def _backward(tracer: Tracer, story: Story, samples: int) -> None:
    """Drops each accepted effect that is not missed by now."""
    for key in list(story.accepted):
        if len(story.accepted) < 2:
            return
        refit = story.last.refit
        judged = tracer.judged("", tracer.bench.fit(refit.hypothesis.without(key), refit.base))
        loss = 1.0 - math.sqrt(story.last.select / judged.select)
        if (judged.train - story.last.train) * samples < 25.0 * max(1.0, story.last.train) or loss < CUT:
            story.rejected.append((key, "is no longer missed beside the other effects"))
            story.last, story.accepted = judged, [k for k in story.accepted if k != key]


def _ranking(tracer: Tracer, scores: Scores, base: Refit) -> dict[str, Ranked]:
    bench, ranking = tracer.bench, {}
    names = [u.label for u, free in zip(bench.problems[0].unknowns, tracer.held(base), strict=True) if free]
    inflated = math.sqrt(max(bench.fitness(base.residual, 0), 1.0))
    for key, kind in catalogue().items():
        if key not in scores.found:
            ranking[key] = Ranked(hidden(kind, kind.obstacle(bench.traits)))
            continue
        one = scores.found[key]
        seen = sight(kind, one, scores.columns[key, scores.shapes[key]], scores.jacobian, names)
        if seen.status != "testable" or seen.smallest is None:
            ranking[key] = Ranked(seen)
            continue
        estimate, spread = one.strength * kind.typical, 1.96 / score.DETECTABLE * seen.smallest * inflated
        ranking[key] = Ranked(seen, estimate, estimate - spread, estimate + spread, one.gain, scores.chance)
    return ranking
