"""What is done at a fit again and again: scores of what could be missing, refits with one effect more, and how they predict."""

import dataclasses
import math
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from smajax.diagnose import instants, localise, score
from smajax.diagnose.bench import Bench, in_pairs
from smajax.diagnose.columns import effect_columns
from smajax.diagnose.hypothesis import Hypothesis, Refit, Running
from smajax.diagnose.joint import joined
from smajax.diagnose.step_errors import coarseness, difference
from smajax.fit import uncertainty
from smajax.fit.least_squares import Stop
from smajax.parameters import declarations

_HEATS = ((99, 5), (8, 4), (5, 8), (3, 30))  # how many go on, and for how many steps, the first of which only looks at the start
_APART = 5
_PROMISING = 3  # of those that promise most
_HOPELESS = 30.0
_BEHIND = 4.0  # times the least cost: no search from there wins any more
_JUDGED = 10  # sets of effects, at most, whose prediction is looked at
_LOOK, _LOOKS = 8, 4  # steps of a look, and how many follow the first
_CATCHING_UP = 0.5  # of its cost, at most, is left to a search that catches up after a look
_INSTANTS, _PLACES = 32, 5  # looked at, and searched from
AT_NOISE = 1.25  # mean square over the noise that a fit with the right effects may leave, where the criterion asks for less
_STRIDES = (16, 8, 4, 2)
_FAR, _COARSE = 9.0, 0.01  # mean square over the noise from which longer steps will do, and the share of it that they may change


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

    @property
    def at_noise(self) -> bool:
        """Whether it leaves no more than a fit with the right effects may."""
        return self.total < 2.0 * AT_NOISE


class Extension(NamedTuple):
    """One effect more for a fit: its key, the strength expected in units of the typical one, its shape, and the gain that its score
    promises (0: not known)."""

    parent: Refit
    key: str
    strength: float
    shape: tuple
    gain: float = 0.0


@dataclasses.dataclass(frozen=True)
class Scores:
    """Scores at one fit: the best of each effect, at which shape, all columns, the free parameters' Jacobian, its basis, the residual
    beyond it, and for each effect the probability that noise gives any effect so large a gain."""

    found: dict[str, score.Score]
    shapes: dict[str, tuple]
    columns: dict
    jacobian: np.ndarray
    q: np.ndarray
    left: np.ndarray
    chances: dict[str, float]

    @property
    def chance(self) -> float:
        """The probability of the largest gain."""
        return min(self.chances.values(), default=1.0)


class Tracer:
    """A bench, and what is done on it again and again."""

    def __init__(self, bench: Bench, seed: int):
        self.bench, self.seed = bench, seed
        self._coarse: dict[int, float] = {}

    def base(self, point: np.ndarray, stop: Stop) -> Refit:
        """The plant without effects at a fitted point."""
        self.bench.compiled()

        def fit() -> Refit:
            return Refit(Hypothesis(), point, *self.bench.evaluate(Hypothesis(), point, 0), stop)

        found = fit()
        before = self.bench.problems[0]
        # Several steps a sample resolve what a thin wire does better than most recordings tell.
        self.bench.lengthen(lambda longer: difference(self.bench, found, longer) < _COARSE)
        found = found if self.bench.problems[0] is before else fit()
        self._coarse = {stride: coarseness(self.bench, found, stride) for stride in _STRIDES}
        return found

    def stride(self, fitness: float) -> int:
        """Of how many samples a search needs one, on steps as many times as long, while so much is left over the noise (a mean square)."""
        return next((k for k, error in self._coarse.items() if error < _COARSE * fitness and fitness > _FAR), 1)

    def free(self, refit: Refit) -> np.ndarray:
        """Jacobian columns that are free to move: those of parameters that are held, or on a bound that the data press against, are not."""
        lower, upper = self.bench.box
        gradient = refit.jacobian[:, : self.bench.size].T @ refit.residual
        margin = 1e-9 * (1 + np.abs(refit.base))
        pressed = ((refit.base <= lower + margin) & (gradient > 0)) | ((refit.base >= upper - margin) & (gradient < 0)) | (lower == upper)
        return np.append(~pressed, np.ones(refit.jacobian.shape[1] - self.bench.size, bool))

    def scores(self, refit: Refit) -> Scores:
        """Scores every effect that is not there yet, at each of its shapes."""
        bench = self.bench
        jacobian = np.column_stack([bench.flat(c) for c in refit.jacobian[:, self.free(refit)].T])
        q = score.basis(jacobian)
        left = score.project(q, bench.flat(refit.residual))
        columns = {item: bench.flat(column) for item, column in effect_columns(bench, refit.hypothesis, refit.base).items()}
        found: dict[str, score.Score] = {}
        shapes: dict[str, tuple] = {}
        for (key, shape), column in columns.items():
            one = bench.scored(key, q, left, column)
            if key not in found or one.gain > found[key].gain:
                found[key], shapes[key] = one, shape
        return Scores(found, shapes, columns, jacobian, q, left, self.chances(refit, jacobian, columns))

    def chances(self, refit: Refit, jacobian: np.ndarray, columns: dict) -> dict[str, float]:
        """Each effect's p-value among all of them, the residual's own autocorrelation taken out first."""
        series = list(self.bench.series(refit.residual).values())
        models = [score.noise_model(s) for s in series]
        cuts = np.cumsum([len(s) for s in series])[:-1]

        def white(v: np.ndarray) -> np.ndarray:
            return np.concatenate([score.whiten(p, m[0]) / m[1] for p, m in zip(np.split(v, cuts), models, strict=True)])

        q = score.basis(np.column_stack([white(c) for c in jacobian.T]))
        left = score.project(q, white(self.bench.flat(refit.residual)))
        kept = {key: self.bench.scored(key[0], q, left, white(c)) for key, c in columns.items()}
        kept = {item: s for item, s in kept.items() if math.isfinite(s.smallest)}
        plausible = {item: self.bench.plausible(item[0]) for item in kept}
        by_noise = score.largest_by_noise({item: s.column for item, s in kept.items()}, plausible, self.seed)
        gains = dict.fromkeys((key for key, _ in columns), 0.0)
        for (key, _), s in kept.items():
            gains[key] = max(gains[key], s.gain)
        return {key: float(np.mean(by_noise >= gain)) for key, gain in gains.items()}

    def shares(self, refit: Refit, scores: Scores) -> dict[str, float]:
        """Share of a fit's residual that can live in each stage."""
        return localise.shares(self.bench, refit, scores.q, scores.left, scores.columns)

    def expected(self, refit: Refit, k: int, fitted: Sequence[int] = (0,), *, slow: bool = False) -> float:
        """Mean square over the noise that the parameters' uncertainty makes of a perfect fit on part ``k``: at least 1.

        ``fitted`` are the parts that the parameters were fitted to. What they do not tell may be as far off as is typical. ``slow`` takes
        the autocorrelation of what is left for that of the noise.
        """
        bench, free = self.bench, self.free(refit)
        foreign = (np.arange(len(free)) >= bench.shared) & (np.arange(len(free)) < bench.size)  # another recording's own parameters

        def columns(part: int) -> tuple[list[np.ndarray], list[np.ndarray]]:
            """Jacobian and residual of each series of a part."""
            left, jacobian = bench.evaluate(refit.hypothesis, refit.base, part, bench.moved(refit.hypothesis))
            jacobian = np.where(foreign, 0.0, jacobian) if part else jacobian
            each = [bench.series(c, part) for c in jacobian[:, free].T]
            series = bench.series(left, part)
            return [np.column_stack([c[name] for c in each]) for name in series], list(series.values())

        parts = [columns(part) for part in fitted]
        asked = np.concatenate(columns(k)[0])
        known = np.concatenate([j for jacobians, _ in parts for j in jacobians])
        covariance = np.linalg.inv(known.T @ known + np.eye(known.shape[1]))
        if slow:
            jacobians, series = ([one for part in parts for one in part[i]] for i in (0, 1))
            told = uncertainty.covariance(jacobians, series, known.shape[1])
            covariance = told if np.all(np.isfinite(told)) else covariance
        return 1.0 + float(np.mean(np.sum((asked @ covariance) * asked, axis=1)))

    def race(self, beside: Sequence[Extension], afar: Sequence[Extension] = ()) -> list[Trial]:
        """Fits with one effect more for each extension: a few steps for all, then the best of them to their end.

        Those ``beside`` start at their parent's point with a small strength, so that all parameters go together from there; those ``afar``
        at the rig's nominal values, and stay near them: what a large effect has done to the other parameters may lie in the way. Sets of
        effects that most others have left behind by then are no trials.
        """

        stride = self.stride(min((self.bench.fitness(e.parent.residual, 0) for e in (*beside, *afar)), default=0.0))

        def started(one: Extension, size: float) -> Hypothesis:
            own = {f"effects.{one.key}.{n}": v for n, v in one.shape}
            strength = math.copysign(size, one.strength or 1.0) * self.bench.effects[one.key].typical
            return one.parent.hypothesis.extended(one.key, {f"effects.{one.key}.strength": strength, **own})

        def search(one: Extension, size: float, base: np.ndarray, near: bool, *, held: bool = False) -> Running:
            return self.bench.search(started(one, size), base, near=near, held=held, stride=stride)

        close = [search(e, min(abs(e.strength) or 0.1, 0.1), e.parent.base, False) for e in beside]
        distant = [search(e, min(max(abs(e.strength), 0.3), 2.0), self.bench.nominal, True) for e in afar]
        # What promises most starts a second time, its shape held: freed too early, a shape may wander off, or go around a long bend.
        promising = sorted((e for e in beside if e.gain > 0.0 and e.shape), key=lambda e: -e.gain)[:_PROMISING]
        close += [search(e, min(abs(e.strength) or 0.1, 0.1), e.parent.base, False, held=True) for e in promising]
        # Near the noise what promises most may be trusted, and goes on though others fall sooner: its valley may be a long one.
        most = self._trusted(beside)
        trusted = [s for e, s in zip(beside, close, strict=False) if e is most]
        # Heats: the better half goes on, apart for the two kinds of start, since those from afar begin with larger errors.
        fields = [close, distant]
        everyone = [s for f in fields for s in f]
        for count, steps in _HEATS:
            least = min((s.cost for s in everyone), default=math.inf)
            fields = [sorted((s for s in f if not s.cost > _HOPELESS * least), key=lambda s: s.cost)[:count] for f in fields]
            if steps > _APART:
                whole = sorted((s for f in fields for s in f), key=lambda s: s.cost)
                fields = [[s for s in whole if s.cost < _BEHIND * whole[0].cost][:count]]
                fields[0] += [s for s in trusted if math.isfinite(s.cost) and all(s is not other for other in fields[0])]
                if whole and self.stride(whole[0].cost / self.bench.samples) < stride:
                    fields = [[self.bench.whole(s, 0) for s in fields[0]]]
                    everyone += fields[0]
            in_pairs(lambda s: s.advance(steps), [s for f in fields for s in f])  # noqa: B023
        everyone += in_pairs(self.whole, [s for s in fields[0] if s.stride > 1])
        everyone += [s for found in in_pairs(self.elsewhere, fields[0]) for s in found]
        best: dict[frozenset, Running] = {}
        for one in sorted(everyone, key=lambda s: s.cost):
            best.setdefault(frozenset(one.hypothesis.keys), one)
        ends = in_pairs(self.bench.reached, list(best.values())[:_JUDGED])
        trials = in_pairs(self.judged, [r for r in ends if math.isfinite(r.chi2)])
        return [t for t in trials if math.isfinite(t.total) and not self.nothing(t)]

    def _trusted(self, extensions: Sequence[Extension]) -> Extension | None:
        """The extension that promises most, if its parent is so near to the noise that a score, which is of first order, holds there."""
        most = max(extensions, key=lambda e: e.gain, default=None)
        near = most is not None and most.gain > 0.0 and self.bench.fitness(most.parent.residual, 0) < _FAR
        return most if near else None

    def elsewhere(self, running: Running) -> list[Running]:
        """Searches that set in at a search's end, unless it is at the noise, with each instant that it moves wherever that costs least.

        What depends on an instant has many a minimum: with each motion of the wire that the change may be taken for.
        """
        refit, bench = self.bench.reached(running), self.bench
        if bench.fitness(refit.residual, 0) < AT_NOISE or not math.isfinite(refit.chi2):
            return []
        found, stride = [], self.stride(bench.fitness(refit.residual, 0))

        def search(values: dict[str, float]) -> Running:
            return bench.search(refit.hypothesis.at(values), refit.base, stride=stride)

        for name in (n for n in bench.moved(refit.hypothesis) if n.endswith(".instant")):
            times = [bench.duration * (k + 0.5) / _INSTANTS for k in range(_INSTANTS)]
            costs = in_pairs(lambda t: bench.cost(refit.hypothesis.at({name: t}), refit.base, stride), times)  # noqa: B023
            best = sorted(zip(costs, times, strict=True))[:_PLACES]
            several = in_pairs(lambda one: search({name: one[1]}).advance(1 + _LOOK), best)  # noqa: B023
            found.append(self.whole(min(several, key=lambda s: s.cost).advance(_HEATS[-1][1])))
        return found

    def kin(self, trial: Trial) -> list[Trial]:
        """Fits in which an effect that is known to be confused with a trial's last one stands in its place.

        They start at the trial's own point, with its shape where theirs is called the same, else with the best of their usual ones, which
        are held at first: freed too early, a shape wanders off. They go to their end unless they lag far behind and do not catch up: where
        the other parameters have a long way to go, an effect as good as the trial's takes a while.
        """
        effects, key, refit, stride = self.bench.effects, trial.key, trial.refit, self.stride(trial.train)
        rest, taken = refit.hypothesis.without(key), (*trial.keys, *self.bench.known)
        known = [k for k in effects if (k in effects[key].confused_with or key in effects[k].confused_with) and k not in taken]
        starts = [
            rest.extended(other, {f"effects.{other}.strength": 0.3 * effects[other].typical, **shape})
            for other in known
            for shape in self._shapes(other, key, refit)
        ]

        def ended(look: Running) -> Running:
            held, before = self.bench.reached(look), look.cost
            running = self.bench.search(held.hypothesis, held.base, rtol=1e-7, stride=stride).advance(_LOOK)
            for _ in range(_LOOKS):
                if running.cost > max(_BEHIND * refit.chi2, _CATCHING_UP * before):
                    break
                before = running.cost
                running.advance(_LOOK)
            return self.whole(running)

        looks = in_pairs(lambda start: self.bench.search(start, refit.base, rtol=1e-7, held=True, stride=stride).advance(_LOOK), starts)
        best: dict[str, Running] = {}
        for one in sorted(looks, key=lambda s: s.cost):
            best.setdefault(one.hypothesis.keys[-1], one)
        near = [s for s in in_pairs(ended, list(best.values())) if s.cost < _BEHIND * refit.chi2]
        found = in_pairs(lambda s: self.judged(self.bench.reached(s)), near)
        return [t for t in found if math.isfinite(t.total) and not self.nothing(t)]

    def _shapes(self, other: str, key: str, refit: Refit) -> list[dict[str, float]]:
        """Shapes for another effect in the place of ``key``: its own, where called the same, else each of the other's usual ones."""
        found: dict[tuple, dict[str, float]] = {}
        for shape in self.bench.grid(other):
            values = {}
            for name, usual in shape:
                known = declarations(self.bench.effects[other])[name]
                values[f"effects.{other}.{name}"] = float(
                    np.clip(refit.values.get(f"effects.{key}.{name}", usual), known.lower, known.upper)
                )
            found.setdefault(tuple(values.values()), values)
        return list(found.values())

    def nothing(self, trial: Trial) -> bool:
        """Whether a trial's last effect is as good as absent: what it improves is owed to a better point of the other parameters."""
        key = trial.key
        return abs(trial.refit.values[f"effects.{key}.strength"]) < 1e-3 * self.bench.effects[key].typical

    def unusual(self, trial: Trial) -> float:
        """How far the sizes of a trial's last effect are from usual ones: the square of their logarithms' distance."""
        effect, values = self.bench.effects[trial.key], trial.refit.values
        away = math.log(max(abs(values[f"effects.{trial.key}.strength"]) / effect.typical, 1e-9)) ** 2
        for name, usual in effect.shapes:
            value = values.get(f"effects.{trial.key}.{name}", usual[0])
            if name != "instant" and min(value, *usual) > 0.0:
                away += math.log(value / min(max(value, min(usual)), max(usual))) ** 2
        return away

    def settled(self, trial: Trial) -> Trial:
        """A trial fitted to its end: from its own point and, unless it is at the noise, from the rig's nominal values with its effects."""
        hypothesis, stride = trial.refit.hypothesis, self.stride(trial.train)
        starts = [trial.refit.base, self.bench.nominal][: 1 if trial.at_noise else 2]
        rtol = 1e-9 if stride == 1 else 1e-6
        ended = in_pairs(lambda base: self.fit(hypothesis, base, stride, max_steps=60, rtol=rtol), starts)
        return self.judged(min(ended, key=lambda r: r.chi2))

    def fit(self, hypothesis: Hypothesis, base: np.ndarray, stride: int, *, max_steps: int = 25, rtol: float = 1e-5) -> Refit:
        """A hypothesis fitted to the training part, from ``base`` and its own values."""
        return self.bench.reached(self.whole(self.bench.search(hypothesis, base, rtol=rtol, stride=stride).advance(max_steps)))

    def whole(self, running: Running) -> Running:
        """A search gone on with all samples, unless so much is left where it stands that it needs no more than it has."""
        enough = running.stride > 1 and self.stride(running.cost / self.bench.samples) >= running.stride
        return running if enough else self.bench.whole(running)

    def timely(self, trial: Trial) -> Trial:
        """A trial with its instants where they leave least of the training recording, near where its search has left them."""
        better = instants.better(self.bench, trial.refit, (0,))
        if better is None:
            return trial
        found = self.judged(self.fit(better, trial.refit.base, 1, rtol=1e-7))
        return found if found.train < trial.train and (found.at_noise or not trial.at_noise) else trial

    def together(self, trial: Trial) -> Trial:
        """A trial fitted to the training and the selection recording together."""
        return self.judged(joined(self.bench, trial.refit))

    def judged(self, refit: Refit) -> Trial:
        """A refit with its fitness on both recordings."""
        predicted = self.bench.predict(refit.hypothesis, refit.base, 1)
        channel = self.bench.channels[0]
        rmse = float(np.sqrt(np.mean(self.bench.series(predicted, 1)[channel] ** 2))) * self.bench.noise[channel]
        train = self.bench.fitness(refit.residual, 0) if math.isfinite(refit.chi2) else math.inf
        return Trial(refit, train, self.bench.fitness(predicted, 1), rmse)
