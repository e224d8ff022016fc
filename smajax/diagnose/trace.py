"""From the residual of a fit to the effect that is missing: detect, rank, refit, accept on other data, again, and a verdict.

One round: the effects' scores say whether anything is missing and what is worth refitting; each of the best is added to the plant and all
is fitted again; the one that explains the training recording and predicts the selection recording best is accepted, if it lowers the error
there by more than ``CUT``. What explains both as well is its equivalence. After the last round each accepted effect has to be missed if it
is taken away again. A third recording is looked at once, at the end.
"""

import dataclasses
import math
from collections.abc import Callable, Sequence

import numpy as np

from smajax.diagnose import score
from smajax.diagnose.candidates import SLOTS, Bench, Hypothesis, Refit, plain_residual, together
from smajax.diagnose.effects import catalogue
from smajax.errors import NumericsError
from smajax.fit import least_squares, uncertainty
from smajax.fit.fit import difference_noise
from smajax.fit.least_squares import Stop
from smajax.fit.problem import Problem

STAGES = ("drive", "heat", "material", "mechanism", "sensor")
DETECTED = 0.01
CUT = 0.05
ROUNDS = 3
_REFITTED = 8
_SPRINT = 6
_HEATS = ((4, 10), (2, 30))  # how many go on, and for how many steps
_STATIONARY = 2e-2


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

    key: str
    stage: str
    status: str
    strength: float | None
    lower95: float | None
    upper95: float | None
    unit: str
    gain: float | None
    p_value: float | None
    refit_rmse_select: float | None
    smallest: float | None
    absorbed_by: tuple[str, ...]


@dataclasses.dataclass(frozen=True)
class Diagnosis:
    """The whole of it. RMSEs in SI by channel.

    ``predictions`` hold model minus measurement, SI, by before / after, recording and channel.
    """

    verdict: str
    effects: tuple[str, ...]
    equivalent: dict[str, tuple[str, ...]]
    unresolved_stage: str | None
    ranking: tuple[Ranked, ...]
    stages: dict[str, float]
    noise: dict[str, float]
    before: Refit
    after: Refit
    fitness: tuple[float, float, float]
    rmse: dict[str, dict[str, float]]
    cut95: dict[str, tuple[float, float]]
    rejected: tuple[tuple[str, str], ...]
    intervals: dict[str, tuple[float, float]]
    predictions: dict[str, list[dict[str, np.ndarray]]]


class _Tracer:
    """One bench, and what is done on it."""

    def __init__(self, bench: Bench, floor: dict[str, float], seed: int):
        self.bench, self.floor, self.seed = bench, floor, seed
        bench.set_noise(floor)

    def base(self, point: np.ndarray, stop: Stop) -> Refit:
        """The plant without effects at a fitted point."""
        self.bench.compiled()
        residual, jacobian = self.bench.evaluate(Hypothesis(), point, 0)
        return Refit(Hypothesis(), point, residual, jacobian, stop)

    def fitness(self, residual: np.ndarray, k: int) -> float:
        """Mean square of a residual over the noise: 1 where only noise is left."""
        return float(np.mean(np.concatenate(list(self.bench.series(residual, k).values())) ** 2))

    def flat(self, residual: np.ndarray) -> np.ndarray:
        """The samples of the training recording, without its filling."""
        return np.concatenate(list(self.bench.series(residual).values()))

    def held(self, refit: Refit) -> np.ndarray:
        """Jacobian columns that are free to move: those of parameters on a bound that the data press against it are not."""
        lower, upper = self.bench.problems[0].box
        gradient = refit.jacobian[:, : self.bench.size].T @ refit.residual
        margin = 1e-9 * (1 + np.abs(refit.base))
        pressed = ((refit.base <= lower + margin) & (gradient > 0)) | ((refit.base >= upper - margin) & (gradient < 0))
        return np.append(~pressed, np.ones(refit.jacobian.shape[1] - self.bench.size, bool))

    def scores(self, refit: Refit) -> tuple[dict[str, score.Score], dict[str, dict[str, float]], float, dict[str, float]]:
        """The best score of each effect over its shapes, that shape, the probability of so large a gain by noise, and stages' shares."""
        bench = self.bench
        free = self.held(refit)
        jacobian = np.column_stack([self.flat(c) for c in refit.jacobian[:, free].T])
        residual, q = self.flat(refit.residual), score.basis(jacobian)
        left = score.project(q, residual)
        found, shapes, columns = {}, {}, {}
        for (key, shape), column in bench.columns(refit.hypothesis, refit.base).items():
            columns[key, shape] = self.flat(column)
            one = score.score(q, left, columns[key, shape], self.plausible(key))
            if key not in found or one.gain > found[key].gain:
                found[key], shapes[key] = one, {f"effects.{key}.{n}": v for n, v in shape}
        return found, shapes, self.chance(refit, jacobian, columns), self.stages(q, left, columns)

    def stages(self, q: np.ndarray, left: np.ndarray, columns: dict) -> dict[str, float]:
        """Share of a projected residual that each stage's effects together could explain; adjusted for their number."""
        whole, n = float(left @ left), len(left)
        shares: dict[str, float] = dict.fromkeys(STAGES, 0.0)
        for stage in shares:
            own = [c for (key, _), c in columns.items() if self.bench.effects[key].stage == stage]
            own = [p for c in own if np.linalg.norm(p := score.project(q, c)) > 1e-3 * max(np.linalg.norm(c), 1e-300)]
            if own and whole > 0:
                basis = score.basis(np.column_stack(own))
                explained, p = float(np.sum((basis.T @ left) ** 2)) / whole, basis.shape[1]
                shares[stage] = float(np.clip(1.0 - (1.0 - explained) * (n - 1) / max(n - p - 1, 1), 0.0, 1.0))
        return shares

    def chance(self, refit: Refit, jacobian: np.ndarray, columns: dict) -> float:
        """The p-value of the largest gain, the residual's own autocorrelation taken out first."""
        series = list(self.bench.series(refit.residual).values())
        models = [score.noise_model(s) for s in series]
        cuts = np.cumsum([len(s) for s in series])[:-1]

        def white(v: np.ndarray) -> np.ndarray:
            return np.concatenate([score.whiten(p, m[0]) / m[1] for p, m in zip(np.split(v, cuts), models, strict=True)])

        q = score.basis(np.column_stack([white(c) for c in jacobian.T]))
        left = score.project(q, white(self.flat(refit.residual)))
        kept = {key: score.score(q, left, white(c), self.plausible(key[0])) for key, c in columns.items()}
        kept = {f"{key}{shape}": (s, self.plausible(key)) for (key, shape), s in kept.items() if math.isfinite(s.smallest)}
        largest = max((s.gain for s, _ in kept.values()), default=0.0)
        return score.p_value({k: s.column for k, (s, _) in kept.items()}, {k: p for k, (_, p) in kept.items()}, largest, self.seed)

    def plausible(self, key: str) -> tuple[float, float]:
        """An effect's plausible range over its typical strength."""
        effect = self.bench.effects[key]
        low, high = effect.plausible()
        return low / effect.typical, high / effect.typical

    def race(
        self, refit: Refit, keys: Sequence[str], strengths: dict[str, float], shapes: dict[str, dict[str, float]], also: np.ndarray | None
    ) -> list[Trial]:
        """Fits with one effect more for each key: a few steps for all, then the best of them to their end.

        They start at the fit's own point with the expected strength, and at the point ``also`` with 0.4 of the typical one: what a large
        effect has done to the other parameters may lie in the way.
        """
        starts = []
        for key in keys:
            typical, name = self.bench.effects[key].typical, f"effects.{key}.strength"
            low, high = self.plausible(key)
            size = float(np.clip(strengths[key], max(low, -3.0), min(high, 3.0))) or 0.1
            starts.append((key, refit.hypothesis.extended(key, {name: size * typical, **shapes[key]}), refit.base))
            if also is not None:
                other = refit.hypothesis.extended(key, {name: math.copysign(0.4, size) * typical, **shapes[key]})
                starts.append((key, other, also))
        sprints = together(lambda start: (start[0], self.bench.fit(start[1], start[2], max_steps=_SPRINT)), starts)
        best: dict[str, Refit] = {}
        for key, found in sorted((s for s in sprints if math.isfinite(s[1].chi2)), key=lambda s: s[1].chi2):
            best.setdefault(key, found)
        order = sorted(best.items(), key=lambda item: item[1].chi2)
        for count, steps in _HEATS:
            ahead = [(k, f) for k, f in order[:count] if f.chi2 < 4.0 * order[0][1].chi2]
            ended = together(lambda s: (s[0], self.bench.fit(s[1].hypothesis, s[1].base, max_steps=steps, rtol=1e-6)), ahead)  # noqa: B023
            order = sorted([*ended, *order[len(ahead) :]], key=lambda item: item[1].chi2 if math.isfinite(item[1].chi2) else math.inf)
        return together(lambda s: self.judged(*s), order)

    def judged(self, key: str, refit: Refit) -> Trial:
        """A refit with its fitness on both recordings."""
        predicted, _ = self.bench.evaluate(refit.hypothesis, refit.base, 1)
        channel = self.bench.channels[0]
        rmse = float(np.sqrt(np.mean(self.bench.series(predicted, 1)[channel] ** 2))) * self.floor[channel]
        return Trial(key, refit, self.fitness(refit.residual, 0), self.fitness(predicted, 1), rmse)


def critical(samples: int) -> float:
    """Fitness above which more than noise is left."""
    return 1.0 + 4.0 * math.sqrt(2.0 / (0.8 * samples))


def _first_fit(plain: Problem, seed: int) -> tuple[np.ndarray, Stop, dict[str, float], int]:
    """The rig as it is written down, fitted from its own values and from beside them: point, end, noise by channel, simulations."""
    lower, upper = plain.search_box()
    nominal = np.clip(plain.nominal, lower, upper)
    aside = 0.1 * np.random.default_rng(seed).uniform(-1, 1, len(nominal)) * (upper - lower)
    solved = [
        least_squares.solve(plain_residual, plain, start[None], *plain.box, max_steps=100, rtol=1e-8)
        for start in (nominal, np.clip(nominal + aside, lower, upper))
    ]
    best = min(solved, key=lambda s: s.costs[0] if math.isfinite(s.costs[0]) else math.inf)
    if best.stops[0] is Stop.failed:
        raise NumericsError("the simulation fails at the rig's own values: check them by smajax simulate")
    jacobian, residual = best.jacobians[0], best.residuals[0]
    inside = (best.points[0] > plain.box[0]) & (best.points[0] < plain.box[1])
    if np.linalg.norm(score.basis(jacobian[:, inside]).T @ residual) > _STATIONARY * np.linalg.norm(residual):
        raise NumericsError("the fit of the rig as it is written down did not come to rest, so its residual says nothing: widen fit.bounds")
    weight = np.asarray(plain.data.weight)[0]
    parts = residual.reshape(len(plain.channels), -1)
    floor = {c: difference_noise(parts[i]) / float(np.max(weight[i])) for i, c in enumerate(plain.channels)}
    return best.points[0], best.stops[0], floor, sum(s.simulations for s in solved)


def trace(bench: Bench, *, seed: int = 0, say: Callable[[str], None] = lambda text: None) -> Diagnosis:
    """Diagnoses the bench's three recordings, for training, selection and holdout.

    Raises NumericsError if the first fit does not come to rest.
    """
    say("fitting the rig as it is written down")
    point, stop, floor, simulations = _first_fit(bench.plain, seed)
    bench.simulations += simulations
    tracer = _Tracer(bench, floor, seed)
    first = current = tracer.judged("", tracer.base(point, stop))
    samples = len(tracer.flat(current.refit.residual))
    limit = critical(samples)
    accepted: list[str] = []
    rejected: list[tuple[str, str]] = []
    equivalent: dict[str, tuple[str, ...]] = {}
    ranking: dict[str, Ranked] = {}
    stages: dict[str, float] = {}
    for turn in range(ROUNDS):
        if turn and current.train < max(limit, 1.02):
            break
        if len(bench.moved(current.refit.hypothesis)) >= SLOTS:
            break
        say(f"round {turn + 1}: scoring {len(bench.effects) - len(accepted)} effects")
        scores, shapes, chance, shares = tracer.scores(current.refit)
        if turn == 0:
            stages = shares
            ranking = {key: _impossible(bench, key) for key in catalogue()} | _ranking(tracer, scores, chance, current.refit)
        if chance > DETECTED and current.train < limit:
            break
        trials = _refits(tracer, current.refit, scores, shapes, turn, limit, say)
        if turn == 0:
            for t in trials:
                ranking[t.key] = dataclasses.replace(ranking[t.key], refit_rmse_select=t.rmse_select)
        if not trials:
            break
        best = min(trials, key=lambda t: t.total)
        fall = (current.train - best.train) * samples
        cut = 1.0 - math.sqrt(best.select / current.select)
        if fall < 25.0 * max(1.0, best.train) or cut < CUT:
            why = f"cuts the error on the selection recording by {100 * cut:.1f} %, under the {100 * CUT:.0f} % that a cause must reach"
            rejected.append((best.key, why))
            break
        near = [t for t in trials if t.key != best.key and _as_good(t, best, samples)]
        accepted.append(best.key)
        equivalent[best.key] = tuple(t.key for t in sorted(near, key=lambda t: t.total))
        was = current.select
        current = tracer.judged(best.key, bench.fit(best.refit.hypothesis, best.refit.base, max_steps=60, rtol=1e-9))
        say(f"accepted {best.key}: error over noise {math.sqrt(was):.3g} -> {math.sqrt(current.select):.3g} on the selection recording")
    current, accepted, dropped = _backward(tracer, current, accepted, samples)
    say("predicting the holdout")
    return _conclude(tracer, first, current, accepted, equivalent, ranking, stages, [*rejected, *dropped], limit)


def _refits(tracer: _Tracer, refit: Refit, scores: dict, shapes: dict, turn: int, limit: float, say: Callable[[str], None]) -> list[Trial]:
    """Refits of the effects that promise most, and of all others if none of these explains the residual."""
    hopeful = [k for k, s in sorted(scores.items(), key=lambda item: -item[1].gain) if s.gain > 0.0]
    groups = score.classes({k: scores[k].column for k in hopeful})
    chosen = hopeful[:_REFITTED]
    for key in hopeful[:2]:  # all that look like the best ones
        chosen += [k for k in next((g for g in groups if key in g), ()) if k not in chosen]
    strengths = {k: s.strength for k, s in scores.items()}
    also = tracer.bench.problems[0].nominal if turn == 0 else None
    say(f"round {turn + 1}: refitting {len(chosen)} effects")
    trials = tracer.race(refit, chosen, strengths, shapes, also)
    rest = [k for k in hopeful if k not in chosen]
    if rest and min((t.train for t in trials), default=math.inf) > max(limit, 1.15):
        say(f"round {turn + 1}: refitting {len(rest)} more")
        trials += tracer.race(refit, rest, strengths, shapes, also)
    return [t for t in trials if math.isfinite(t.total)]


def _as_good(trial: Trial, best: Trial, samples: int) -> bool:
    close = (trial.train - best.train) * samples < 10.0 * max(1.0, best.train)
    return close and trial.select < best.select + max(0.01, 10.0 * max(1.0, best.select) / samples)


def _backward(tracer: _Tracer, current: Trial, accepted: list[str], samples: int) -> tuple[Trial, list[str], list[tuple[str, str]]]:
    """Drops each accepted effect that is not missed by now."""
    dropped = []
    for key in list(accepted)[:-1]:
        without = tracer.bench.fit(current.refit.hypothesis.without(key), current.refit.base)
        judged = tracer.judged("", without)
        loss = 1.0 - math.sqrt(current.select / judged.select)
        if (judged.train - current.train) * samples < 25.0 * max(1.0, current.train) or loss < CUT:
            dropped.append((key, "is no longer missed beside the other effects"))
            current, accepted = judged, [k for k in accepted if k != key]
    return current, accepted, dropped


def _impossible(bench: Bench, key: str) -> Ranked:
    """An effect that is not on any bench of this rig, and why."""
    kind = catalogue()[key]
    why = kind.no_mean_effect or f"this rig cannot show it: it needs {', '.join(sorted(set(kind.needs) - bench.traits))}"
    return Ranked(key, kind.stage, "blind", None, None, None, kind.unit(), None, None, None, None, (why,))


def _ranking(tracer: _Tracer, scores: dict[str, score.Score], chance: float, base: Refit) -> dict[str, Ranked]:
    bench, ranking = tracer.bench, {}
    names = tuple(u.label for u in bench.problems[0].unknowns)
    inflated = math.sqrt(max(float(base.residual @ base.residual) / len(tracer.flat(base.residual)), 1.0))
    for key, one in scores.items():
        kind = catalogue()[key]
        low, high = kind.plausible()
        reach = max(abs(low), abs(high)) / kind.typical
        status = "absorbed" if one.absorbed > score.ABSORBED else "blind" if not one.smallest < reach else "testable"
        smallest = one.smallest * kind.typical if math.isfinite(one.smallest) else None
        if status != "testable":
            by = names if status == "absorbed" else ()
            ranking[key] = Ranked(key, kind.stage, status, None, None, None, kind.unit(), None, None, None, smallest, by)
            continue
        estimate, spread = one.strength * kind.typical, 1.96 / score.DETECTABLE * one.smallest * kind.typical * inflated
        ends = (estimate - spread, estimate + spread)
        ranking[key] = Ranked(key, kind.stage, status, estimate, *ends, kind.unit(), one.gain, chance, None, smallest, ())
    return ranking


def _conclude(
    tracer: _Tracer,
    first: Trial,
    last: Trial,
    accepted: Sequence[str],
    equivalent: dict,
    ranking: dict,
    stages: dict[str, float],
    rejected: list,
    limit: float,
) -> Diagnosis:
    bench, noise = tracer.bench, tracer.floor
    residuals = {
        "before": [first.refit.residual, *(bench.evaluate(Hypothesis(), first.refit.base, k)[0] for k in (1, 2))],
        "after": [last.refit.residual, *(bench.evaluate(last.refit.hypothesis, last.refit.base, k)[0] for k in (1, 2))],
    }
    series = {when: [bench.series(r, k) for k, r in enumerate(found)] for when, found in residuals.items()}
    rmse, cut95 = {}, {}
    for c in bench.channels:
        rmse[c] = {
            f"{part}_{when}": float(np.sqrt(np.mean(series[when][k][c] ** 2))) * noise[c]
            for k, part in enumerate(("train", "select", "holdout")) for when in ("before", "after")
        }  # fmt: skip
        cut95[c] = _bootstrap(series["before"][2][c] * noise[c], series["after"][2][c] * noise[c], tracer.seed)
    worst = math.sqrt(last.select)
    if not accepted:
        missing = first.train > max(limit, 1.1) or first.select > 1.2
        verdict = "unresolved" if missing else "nothing-missing"
    elif worst < 1.2 and last.train < max(limit, 1.25):
        verdict = "named-up-to-class" if any(equivalent.get(k) for k in accepted) else "named"
    else:
        verdict = "partial"
    unresolved = None
    if verdict in ("unresolved", "partial"):
        left = tracer.scores(last.refit)[3] if accepted else stages
        unresolved = max(left, key=lambda s: left[s])
    return Diagnosis(
        verdict, tuple(accepted), {k: equivalent.get(k, ()) for k in accepted if equivalent.get(k)}, unresolved, tuple(ranking.values()),
        stages, noise, first.refit, last.refit, (first.train, last.train, limit), rmse, cut95, tuple(rejected),
        _intervals(tracer, last.refit), {when: [{c: v * noise[c] for c, v in s.items()} for s in found] for when, found in series.items()},
    )  # fmt: skip


def _intervals(tracer: _Tracer, refit: Refit) -> dict[str, tuple[float, float]]:
    """95 % intervals of the effects' parameters, by the residual's own autocorrelation."""
    bench, moved = tracer.bench, tracer.bench.moved(refit.hypothesis)
    if not moved:
        return {}
    free = tracer.held(refit)
    columns = [bench.series(c) for c in refit.jacobian[:, free].T]
    series = bench.series(refit.residual)
    jacobians = [np.column_stack([c[name] for c in columns]) for name in series]
    covariance = uncertainty.covariance(jacobians, list(series.values()), int(np.sum(free)))
    spread = np.sqrt(np.diag(covariance))[-len(moved) :] * 1.96
    return {
        name: (refit.values[name] - s * bench.scale(name), refit.values[name] + s * bench.scale(name))
        for name, s in zip(moved, spread, strict=True) if math.isfinite(s)
    }  # fmt: skip


def _bootstrap(before: np.ndarray, after: np.ndarray, seed: int, draws: int = 1000) -> tuple[float, float]:
    """95 % interval of the fall of the RMSE, by blocks of a fiftieth of the recording."""
    length = max(1, len(before) // 50)
    count = len(before) // length
    squares = [np.mean((v[: count * length] ** 2).reshape(count, length), axis=1) for v in (before, after)]
    pick = np.random.default_rng(seed).integers(0, count, (draws, count))
    cut = np.sqrt(np.mean(squares[0][pick], axis=1)) - np.sqrt(np.mean(squares[1][pick], axis=1))
    low, high = np.quantile(cut, [0.025, 0.975])
    return float(low), float(high)
