"""From the residual of a fit to the effect that is missing: detect, rank, refit, accept on other data, again.

One round: the effects' scores say whether anything is missing and what is worth refitting; each of the best is added to the plant and all
is fitted again; the one that explains the training recording and predicts the selection recording best is accepted, if it lowers the error
there by more than ``CUT``. What explains both as well is its equivalence. Where more than noise is left, the best few of them get another
effect each, so that a first choice can still be changed for a better pair. In the end each accepted effect has to be missed if it is taken
away again. ``smajax.diagnose.verdict`` looks at a third recording, once, at the end.
"""

import dataclasses
import math
from collections.abc import Callable, Sequence
from typing import NamedTuple

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
EXPLAINED = 0.5
ROUNDS = 3
_NEAR, _AFAR = 5, 4  # effects refitted first: by their scores at the fit, and at the rig's nominal values
_BEAM, _SECOND = 3, 4  # fits that get another effect, and how many are tried on each
_HEATS = ((99, 5), (6, 4), (4, 8), (2, 30))  # how many go on, and for how many steps, the first of which only looks at the start
_APART = 5
_HOPELESS = 30.0
_STATIONARY = 2e-2
_RIVALS = 3


@dataclasses.dataclass(frozen=True)
class Trial:
    """A refit, and how it does: goodness of fit on the training and on the selection recording.

    ``rmse_select`` is that of the first observed channel on the selection recording, SI.
    """

    refit: Refit
    train: float
    select: float
    rmse_select: float

    @property
    def keys(self) -> tuple[str, ...]:
        """Its effects, in the order in which they were added."""
        return self.refit.hypothesis.keys

    @property
    def key(self) -> str:
        """The effect that was added last; empty without effects."""
        return self.keys[-1] if self.keys else ""

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
    rivals: dict[str, list[Trial]] = dataclasses.field(default_factory=dict)
    equivalent: dict[str, tuple[str, ...]] = dataclasses.field(default_factory=dict)
    rejected: list[tuple[str, str]] = dataclasses.field(default_factory=list)
    ranking: dict[str, Ranked] = dataclasses.field(default_factory=dict)
    stages: dict[str, float] = dataclasses.field(default_factory=dict)

    @property
    def accepted(self) -> tuple[str, ...]:
        """The effects of the last fit, in order."""
        return self.last.keys

    @property
    def explained(self) -> float:
        """Share of the first fit's excess over the noise, on both recordings, that the last one explains."""
        left = max(self.last.train - 1.0, 0.0) + max(self.last.select - 1.0, 0.0)
        return 1.0 - left / max(self.first.total - 2.0, 1e-9)


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

    def expected(self, refit: Refit) -> float:
        """Mean square over the noise that the parameters' uncertainty makes of a perfect fit on the selection recording: at least 1."""
        bench, free = self.bench, self.held(refit)
        known = np.column_stack([bench.flat(c) for c in refit.jacobian[:, free].T])
        _, jacobian = bench.evaluate(refit.hypothesis, refit.base, 1, bench.moved(refit.hypothesis))
        asked = np.column_stack([bench.flat(c, 1) for c in jacobian[:, free].T])
        return 1.0 + float(np.mean(np.sum((asked @ np.linalg.pinv(known.T @ known)) * asked, axis=1)))

    def race(self, extensions: Sequence["Extension"], also: np.ndarray | None = None) -> list[Trial]:
        """Fits with one effect more for each extension: a few steps for all, then the best of them to their end.

        They start at their parent's point with a small strength, so that all parameters go together from there, and at the point ``also``
        with the expected one: what a large effect has done to the other parameters may lie in the way.
        """
        starts = []
        for parent, key, strength, shape in extensions:
            typical, name = self.bench.effects[key].typical, f"effects.{key}.strength"
            own = {f"effects.{key}.{n}": v for n, v in shape}
            low, high = self.bench.plausible(key)
            size = float(np.clip(strength, max(low, -2.0), min(high, 2.0))) or 0.1
            small, large = math.copysign(min(abs(size), 0.1), size), math.copysign(max(abs(size), 0.3), size)
            starts.append((parent.hypothesis.extended(key, {name: small * typical, **own}), parent.base, False))
            if also is not None:
                starts.append((parent.hypothesis.extended(key, {name: large * typical, **own}), also, True))
        # Heats: the better half goes on, apart for the two kinds of start, since those from afar begin with larger errors.
        fields = [[self.bench.search(h, base) for h, base, afar in starts if afar == far] for far in (False, True)]
        everyone = [s for f in fields for s in f]
        for count, steps in _HEATS:
            least = min((s.search.cost for s in everyone), default=math.inf)
            fields = [sorted((s for s in f if not s.search.cost > _HOPELESS * least), key=lambda s: s.search.cost)[:count] for f in fields]
            if steps > _APART:
                whole = sorted((s for f in fields for s in f), key=lambda s: s.search.cost)
                fields = [[s for s in whole if s.search.cost < 4.0 * whole[0].search.cost][:count]]
            self.bench.many(lambda s: s.advance(steps), [s for f in fields for s in f])  # noqa: B023
        best: dict[frozenset, Refit] = {}
        for found in sorted((self.bench.reached(s) for s in everyone), key=lambda r: r.chi2):
            best.setdefault(frozenset(found.hypothesis.keys), found)
        trials = self.bench.many(self.judged, [r for r in best.values() if math.isfinite(r.chi2)])
        return [t for t in trials if math.isfinite(t.total) and not self.nothing(t)]

    def nothing(self, trial: Trial) -> bool:
        """Whether a trial's last effect is as good as absent: what it improves is owed to a better point of the other parameters."""
        key = trial.key
        return abs(trial.refit.values[f"effects.{key}.strength"]) < 1e-3 * self.bench.effects[key].typical

    def settled(self, trial: Trial) -> Trial:
        """A trial fitted to its end: from its own point, and from the rig's nominal values with the effects that it has."""
        hypothesis = trial.refit.hypothesis
        starts = [trial.refit.base, self.bench.problems[0].nominal]
        ended = self.bench.many(lambda base: self.bench.fit(hypothesis, base, max_steps=60, rtol=1e-9), starts)
        return self.judged(min(ended, key=lambda r: r.chi2))

    def judged(self, refit: Refit) -> Trial:
        """A refit with its fitness on both recordings."""
        predicted, _ = self.bench.evaluate(refit.hypothesis, refit.base, 1)
        channel = self.bench.channels[0]
        rmse = float(np.sqrt(np.mean(self.bench.series(predicted, 1)[channel] ** 2))) * self.bench.noise[channel]
        train = self.bench.fitness(refit.residual, 0) if math.isfinite(refit.chi2) else math.inf
        return Trial(refit, train, self.bench.fitness(predicted, 1), rmse)


class Extension(NamedTuple):
    """One effect more for a fit: its key, the strength expected in units of the typical one, and its shape."""

    parent: Refit
    key: str
    strength: float
    shape: tuple


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
    first = tracer.judged(tracer.base(point, stop))
    story = Story(seen, noise, first, first, critical(len(bench.flat(first.refit.residual))), gains)
    beam = [first]
    for turn in range(ROUNDS):
        beam = _round(tracer, story, beam, turn, say)
        if not beam:
            break
    _backward(tracer, story)
    return tracer, story


def _first_fit(bench: Bench, seed: int) -> tuple[np.ndarray, Stop, dict[str, tuple[float, str]]]:
    """The rig as it is written down, fitted from its own values and from beside them: point, end, and noise by channel."""
    plain = bench.plain
    lower, upper = plain.search_box()
    nominal = np.clip(plain.nominal, lower, upper)
    aside = 0.1 * np.random.default_rng(seed).uniform(-1, 1, len(nominal)) * (upper - lower)
    solved = [
        least_squares.Search(plain_residual, plain, start[None], *plain.box, rtol=1e-8).advance().result()
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


def _round(tracer: Tracer, story: Story, beam: list[Trial], turn: int, say: Callable[[str], None]) -> list[Trial]:
    """One round: adds an effect to each trial of the beam; gives the next beam, empty if no effect was accepted."""
    bench, current = tracer.bench, story.last
    samples = len(bench.flat(current.refit.residual))
    beam = [t for t in beam if len(bench.moved(t.refit.hypothesis)) < SLOTS]
    if not beam or (turn and current.train < max(story.limit, 1.02)) or (turn > 1 and story.explained < EXPLAINED):
        return []
    say(f"round {turn + 1}: scoring {len(bench.effects) - turn} effects")
    if turn == 0:
        scores = tracer.scores(current.refit)
        story.stages = tracer.shares(current.refit, scores)
        story.ranking = _ranking(tracer, scores, current.refit)
        if scores.chance > DETECTED and current.train < story.limit:
            return []
        trials = _singles(tracer, story, scores, say)
        for t in trials:
            story.ranking[t.key] = dataclasses.replace(story.ranking[t.key], refit_rmse_select=t.rmse_select)
    else:
        trials = _more(tracer, story, beam, turn, say)
    best = min(trials, key=lambda t: t.total, default=None)
    if best is None:
        return []
    best = tracer.settled(best)
    fall = (current.train - best.train) * samples
    cut = 1.0 - math.sqrt(best.select / current.select)
    if fall < 25.0 * max(1.0, best.train) or cut < CUT:
        told = "fits the training recording no better" if fall <= 0.0 else f"cuts the error on the selection recording by {100 * cut:.1f} %"
        story.rejected.append((best.key, f"{told}; a cause has to cut it by {100 * CUT:.0f} %"))
        return []
    say(f"with {' and '.join(best.keys)}: error over noise {math.sqrt(story.first.select):.3g} -> {math.sqrt(best.select):.3g}, selected")
    story.last = best
    others = sorted((t for t in trials if set(t.keys) != set(best.keys)), key=lambda t: t.total)
    for key in best.keys:
        swapped = [t for t in others if set(best.keys) - {key} <= set(t.keys) and key not in t.keys]
        if key == best.key or swapped:
            story.rivals[key] = swapped[:_RIVALS]
            story.equivalent[key] = tuple((set(t.keys) - set(best.keys)).pop() for t in swapped if _as_good(t, best, samples))
    return [best, *others[: _BEAM - 1]]


def _singles(tracer: Tracer, story: Story, scores: Scores, say: Callable[[str], None]) -> list[Trial]:
    """Refits of the effects that promise most, and of all others if none of these explains the residual."""
    refit, bench = story.last.refit, tracer.bench
    hopeful = [k for k, s in sorted(scores.found.items(), key=lambda item: -item[1].gain) if s.gain > 0.0]
    afar = [k for k in sorted(story.promise, key=lambda k: -story.promise[k]) if story.promise[k] > 0.0 and k in hopeful]
    groups = score.classes({k: scores.found[k].column for k in hopeful})
    chosen = list(dict.fromkeys([*hopeful[:_NEAR], *afar[:_AFAR]]))
    for key in chosen[:2]:  # all that look like the best ones
        chosen += [k for k in next((g for g in groups if key in g), ()) if k not in chosen]

    def refits(keys: list[str], parent: Refit, also: np.ndarray | None) -> list[Trial]:
        say(f"round 1: refitting {len(keys)} effects")
        extensions = [Extension(parent, k, scores.found[k].strength, scores.shapes[k]) for k in keys]
        return tracer.race(extensions, also)

    nominal = bench.problems[0].nominal
    trials = refits(chosen, refit, nominal)
    rest = [k for k in hopeful if k not in chosen]
    if rest and min((t.train for t in trials), default=math.inf) > max(story.limit, 1.15):
        # Where the fit stands they promise little: from the nominal values only.
        trials += refits(rest, dataclasses.replace(refit, base=nominal), None)
    return trials


def _more(tracer: Tracer, story: Story, beam: list[Trial], turn: int, say: Callable[[str], None]) -> list[Trial]:
    """Refits of the beam's fits with one effect more."""
    extensions: list[Extension] = []
    seen: set[frozenset] = set()
    for trial in beam:
        scores = tracer.scores(trial.refit)
        for key, one in sorted(scores.found.items(), key=lambda item: -item[1].gain)[:_SECOND]:
            keys = frozenset((*trial.keys, key))
            if one.gain > 0.0 and keys not in seen:
                seen.add(keys)
                extensions.append(Extension(trial.refit, key, one.strength, scores.shapes[key]))
    say(f"round {turn + 1}: refitting {len(extensions)} sets of effects")
    return tracer.race(extensions)


def _as_good(trial: Trial, best: Trial, samples: int) -> bool:
    close = (trial.train - best.train) * samples < 10.0 * max(1.0, best.train)
    return close and trial.select < best.select + max(0.01, 10.0 * max(1.0, best.select) / samples)


def _backward(tracer: Tracer, story: Story) -> None:
    """Drops each accepted effect that is not missed by now."""
    samples = len(tracer.bench.flat(story.first.refit.residual))
    for key in story.accepted:
        if len(story.accepted) < 2:
            return
        refit = story.last.refit
        judged = tracer.judged(tracer.bench.fit(refit.hypothesis.without(key), refit.base))
        if not math.isfinite(judged.total):
            continue
        loss = 1.0 - math.sqrt(story.last.select / judged.select)
        if (judged.train - story.last.train) * samples < 25.0 * max(1.0, story.last.train) or loss < CUT:
            story.rejected.append((key, "is no longer missed beside the other effects"))
            story.last = judged


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
