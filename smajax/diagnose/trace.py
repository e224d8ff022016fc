"""From the residual of a fit to the effect that is missing: detect, rank, refit, accept on other data, again.

One round: the effects' scores say whether anything is missing and what is worth refitting; each of the best is added to the plant and all
is fitted again; the one that explains the training recording and predicts the selection recording best is accepted, if it lowers the error
there by more than ``CUT``; of a later one more is asked (``objection``). What explains both as well is its equivalence. Where more
than noise is left, the best few of them get another effect each, so that a first choice can still be changed for a better pair. In the end
each accepted effect has to be missed if it is taken away again. ``smajax.diagnose.verdict`` looks at a third recording, once, at the end.
"""

import dataclasses
import math
from collections.abc import Callable, Mapping
from concurrent.futures import ThreadPoolExecutor
from types import MappingProxyType

import numpy as np

from smajax.diagnose import residual, score
from smajax.diagnose.bench import Bench, in_pairs
from smajax.diagnose.effects import catalogue
from smajax.diagnose.hypothesis import Hypothesis, Refit
from smajax.diagnose.preflight import Promise, Sight, preflight, sight, unseen
from smajax.diagnose.program import SLOTS
from smajax.diagnose.tracer import AT_NOISE, Extension, Scores, Tracer, Trial
from smajax.errors import NumericsError
from smajax.fit import least_squares, searchable
from smajax.fit.least_squares import Solved, Stop
from smajax.fit.problem import Problem, rounding_noise

DETECTED = 0.01
CUT = 0.05
# Kinetics that are a little off leave a residual that many an effect fits in part. Beside other effects, one has to move the mean square
# over the noise by MATERIAL, and, where no more than LITTLE exceeds it on both recordings, to leave at most the share LEFT of that.
MATERIAL, LITTLE, LEFT = 1.0, 10.0, 0.15
EXPLAINED = 0.5
_NEARLY = 9.0  # mean square over the noise, below which effects nearly explain it
WORTH, PROMISED = 0.75, 1.0 / 3.0
ROUNDS = 3
_AFAR = 4  # effects refitted from the rig's nominal values, too: those that promise most there
_LATE = 2  # trials that did not come to their end and are taken there
_BEAM, _SECOND = 3, 4  # fits that get another effect, and how many are tried on each
_OPEN = 2  # trials that explain the training recording, and are fitted to the selection recording, too
_STATIONARY = 2e-2
_TRIES, _RESTLESS = 10, 4  # start points of the first fit, and after how many it no longer waits for one to end at rest
_ALIKE = 2.0  # difference of the sum of squares over the noise that says nothing
_FALL = 25.0  # least fall of the sum of squares over the noise that counts
_RIVALS = 3
_ROUNDED = 1.5  # rounding that is coarser than the noise errs all the same way where nothing moves


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

    ``promise`` is what each effect would explain at the rig's nominal values: a large effect has bent the fit's
    parameters so far that scores there mislead. So far, perhaps, that the first fit did not come to rest (``rests``). ``way`` are the
    fits that were accepted one after the other.
    """

    preflight: dict[str, Sight]
    noise: dict[str, tuple[float, str]]
    first: Trial
    last: Trial
    limit: float
    promise: dict[str, Promise]
    rests: bool = True
    way: list[Trial] = dataclasses.field(default_factory=list)
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
    def least(self) -> float:
        """Mean square over the noise that a fit with the right effects may leave."""
        return max(self.limit, AT_NOISE)

    @property
    def quiet(self) -> bool:
        """Whether noise may well give what the first fit left, if it is as slow as that is."""
        return min((r.p_value for r in self.ranking.values() if r.p_value is not None), default=1.0) > DETECTED

    @property
    def explained(self) -> float:
        """Share of the first fit's excess over the noise, on both recordings, that the last one explains."""
        return self.explained_by(self.last)

    def explained_by(self, trial: Trial) -> float:
        """The same of a trial; on the training recording alone where the first fit cannot predict the other."""
        parts = [(trial.train, self.first.train), (trial.select, self.first.select)]
        left, before = np.sum([np.maximum(np.array(p) - 1.0, 0.0) for p in parts if math.isfinite(p[1])], axis=0)
        return float(1.0 - left / max(before, 1e-9))

    def fitted_by(self, trial: Trial) -> float:
        """The same of the training recording alone: a surrogate may mend a prediction that a biased fit spoilt, and fit no better."""
        return float(1.0 - max(trial.train - 1.0, 0.0) / max(self.first.train - 1.0, 1e-9))


def critical(samples: int) -> float:
    """Fitness above which more than noise is left."""
    return 1.0 + 4.0 * math.sqrt(2.0 / (0.8 * samples))


def trace(
    bench: Bench,
    *,
    seed: int = 0,
    starts: int = 2,
    worth: float = WORTH,
    promised: float = PROMISED,
    given: Mapping[str, float] = MappingProxyType({}),
    say: Callable[[str], None] = lambda text: None,
) -> tuple[Tracer, Story]:
    """Traces the residual of the bench's training part, helped by the selection part; the first fit has at least so many ``starts``.

    A third effect is looked for if two explain the share ``worth`` of what exceeds the noise, and one more promises the share ``promised``
    of what they leave, to first order: less speaks for a cause that is not listed.
    ``given`` are the standard deviations of channels' noise that are known, SI; the others are estimated.

    Raises NumericsError if the simulation fails at the rig's own values.
    """
    say("preflight: what these inputs can show")
    with ThreadPoolExecutor(1) as pool:  # while the large programs are compiled, the small one fits
        first_fit = pool.submit(_first_fit, bench, seed, starts)
        bench.compiled()
        if not np.all(np.isfinite(bench.predict(Hypothesis(), bench.nominal, 0))):
            first_fit.result()
        seen, promise = preflight(bench)
        counts = [sum(s.status == status for s in seen.values()) for status in ("testable", "absorbed", "blind")]
        say("preflight: {} effects are testable, {} are absorbed, {} are blind".format(*counts))
        say("fitting the rig as it is written down")
        point, stop, noise, rests = first_fit.result()
    noise |= {c: (value, "rig file") for c, value in given.items() if c in noise}
    if not rests:
        say("it does not come to rest, so that its residual says little")
    bench.set_noise({c: value for c, (value, _) in noise.items()})
    tracer = Tracer(bench, seed)
    first = tracer.judged(tracer.base(point, stop))
    limit = critical(bench.samples)
    limit = max(limit, _ROUNDED) if any(source == "rounding" for _, source in noise.values()) else limit
    story = Story(seen, noise, first, first, limit, promise, rests)
    beam = [first]
    for turn in range(ROUNDS):
        if turn > 1 and story.explained < worth:
            break
        beam = _round(tracer, story, beam, turn, promised if turn > 1 else 0.0, say)
        if not beam:
            break
    _backward(tracer, story)
    _swap(tracer, story)
    story.last = tracer.timely(story.last)
    return tracer, story


def _first_fit(bench: Bench, seed: int, starts: int) -> tuple[np.ndarray, Stop, dict[str, tuple[float, str]], bool]:
    """The rig as it is written down, fitted from its own values and from points beside them: point, end, noise by channel, at rest or not.

    A step may leave the range in which the wire transforms at all, and end where nothing matters: so each search is first held near the
    rig's own values. Points are tried until two of them end at one cost, and at rest. Where a large effect is missing, there may be no
    such point: after a few, it goes on with the best.
    """
    plain = bench.plain
    near = lower, upper = plain.search_box()
    nominal, rng = np.clip(plain.nominal, lower, upper), np.random.default_rng(seed)

    def tried(beside: np.ndarray) -> Solved:
        held = _solved(bench, np.clip(nominal + 0.1 * beside * (upper - lower), lower, upper), near)
        on_edge = np.any((held.points[0] <= lower) | (held.points[0] >= upper))
        return _solved(bench, held.points[0], plain.box) if on_edge else held

    ends: list[Solved] = []
    while True:
        beside = [rng.uniform(-1, 1, len(nominal)) if ends or k else np.zeros(len(nominal)) for k in range(2)]
        ends = sorted([*ends, *in_pairs(tried, beside)], key=lambda one: one.costs[0] if one.stops[0] is not Stop.failed else math.inf)
        alike = [one for one in ends if one.costs[0] <= 1.01 * ends[0].costs[0]]
        best = next((one for one in alike if _at_rest(plain, one)), ends[0])
        rests = _at_rest(plain, best)
        if len(ends) >= starts and ((len(alike) > 1 and rests) or len(ends) >= (_TRIES if rests else _RESTLESS)):
            break
    if best.stops[0] is Stop.failed:
        raise NumericsError("the simulation fails at the rig's own values: check them by smajax simulate")
    return bench.padded(best.points[0]), best.stops[0], _noise(bench, plain, best.residuals[0]), rests


def _solved(bench: Bench, point: np.ndarray, box: tuple[np.ndarray, np.ndarray]) -> Solved:
    plain = bench.plain
    one = least_squares.Search(searchable.residual, plain, point[None], *box, size=plain.size, rtol=1e-8).advance().result()
    bench.count(one.simulations)
    return one


def _at_rest(plain: Problem, solved: Solved) -> bool:
    """Whether what is left has no slope worth speaking of along the parameters that are free to move."""
    jacobian, left, point = solved.jacobians[0], solved.residuals[0], solved.points[0]
    inside = (point > plain.box[0]) & (point < plain.box[1])
    return bool(np.linalg.norm(score.basis(jacobian[:, inside]).T @ left) <= _STATIONARY * np.linalg.norm(left))


def _noise(bench: Bench, plain: Problem, left: np.ndarray) -> dict[str, tuple[float, str]]:
    inputs, rows = bench.inputs(), bench.parts[0].rows()
    by = left.reshape(len(rows), len(plain.channels), -1)
    found = {}
    for i, channel in enumerate(plain.channels):
        series = np.concatenate([by[r, i, seen] for r, seen in enumerate(rows)]) * bench.noise[channel]
        found[channel] = residual.noise(series, inputs)
        rounded = max(rounding_noise(r.channels[channel]) for r in bench.parts[0].recordings)
        if rounded > found[channel][0]:
            found[channel] = rounded, "rounding"
    return found


def _round(tracer: Tracer, story: Story, beam: list[Trial], turn: int, promised: float, say: Callable[[str], None]) -> list[Trial]:
    """One round: adds an effect to each trial of the beam; gives the next beam, empty if no effect was accepted."""
    bench, current = tracer.bench, story.last
    samples = bench.samples
    beam = [t for t in beam if len(bench.moved(t.refit.hypothesis)) < SLOTS]
    if not beam or (turn and current.train < max(story.limit, 1.02)):
        return []
    say(f"round {turn + 1}: scoring {len(bench.effects) - len(bench.known) - turn} effects")
    if turn == 0:
        scores = tracer.scores(current.refit)
        story.stages = tracer.shares(current.refit, scores)
        story.ranking = _ranking(tracer, scores, current.refit)
        if scores.chance > DETECTED and current.train < story.limit:
            return []
        trials = _singles(tracer, story, scores, say)
    else:
        trials = _more(tracer, beam, turn, promised, say)
    trials = _arrived(tracer, trials, current)
    best = min(trials, key=lambda t: t.total, default=None)
    if best is None:
        return []
    best = tracer.settled(best)
    by: dict[frozenset, Trial] = {}
    for trial in sorted([best, *trials, *tracer.kin(best)], key=lambda t: t.total):
        by.setdefault(frozenset(trial.keys), trial)
    trials = list(by.values())
    # From where it was settled before it would only get to the same end.
    if set(trials[0].keys) != set(best.keys) and trials[0].total < best.total - _FALL * max(1.0, best.train) / samples:
        best = tracer.settled(trials[0])
    trials = _reconciled(tracer, trials, story.least)
    best = min([best, *trials], key=lambda t: t.total)
    beside = set(best.keys) - {best.key}
    alike = [t for t in trials if t.key not in beside and set(t.keys) - {t.key} == beside and (t.total - best.total) * samples < _ALIKE]
    best = min([best, *alike], key=tracer.unusual)  # of what does equally well, the most usual comes first
    if turn == 0:
        for t in trials:
            story.ranking[t.key] = dataclasses.replace(story.ranking[t.key], refit_rmse_select=t.rmse_select)
    if why := objection(current, best, samples):
        story.rejected.append((next((k for k in best.keys if k not in current.keys), best.key), why))
        return []
    say(f"with {' and '.join(best.keys)}: error over noise {math.sqrt(story.first.select):.3g} -> {math.sqrt(best.select):.3g}, selected")
    story.last = best
    story.way.append(best)
    others = sorted((t for t in trials if set(t.keys) != set(best.keys)), key=lambda t: t.total)
    for key in best.keys:
        swapped = [t for t in others if set(best.keys) - {key} <= set(t.keys) and key not in t.keys]
        if key == best.key or swapped:
            story.rivals[key] = swapped[:_RIVALS]
            story.equivalent[key] = tuple((set(t.keys) - set(best.keys)).pop() for t in swapped if _as_good(t, best, samples))
    return [best, *others[: _BEAM - 1]]


def _arrived(tracer: Tracer, trials: list[Trial], current: Trial) -> list[Trial]:
    """The trials that leave less of the training recording than ``current``, and the best of the others once they have come to their end.

    With one effect more nothing gets worse there but by a search that was held, or stopped early, whatever it predicts of another input.
    """
    done = [t for t in trials if t.train < current.train]
    least = min((t.total for t in done), default=math.inf)
    late = sorted((t for t in trials if t.train >= current.train and t.total < least), key=lambda t: t.total)[:_LATE]
    return [*done, *in_pairs(tracer.settled, late)]


def _reconciled(tracer: Tracer, trials: list[Trial], least: float) -> list[Trial]:
    """The trials, the best of those that explain the training recording to the noise fitted to both recordings where that explains both.

    Else a cause with an instant at which nothing moves is refused for a prediction that the training recording leaves open.
    """
    if any(t.at_noise for t in trials):
        return trials
    open_ones = sorted((t for t in trials if t.train < least), key=lambda t: t.train)[:_OPEN]
    both = {id(old): new for old, new in zip(open_ones, in_pairs(tracer.together, open_ones), strict=True) if new.at_noise}
    return [both.get(id(t), t) for t in trials]


def objection(current: Trial, best: Trial, samples: int) -> str:
    """Why ``best``, with an effect more than ``current``, is not accepted; empty if it is. ``samples`` count in the training recording."""
    if (current.train - best.train) * samples < _FALL * max(1.0, best.train):
        return "fits the training recording no better than chance would"
    cut = 1.0 - math.sqrt(best.select / current.select)
    if cut < CUT:
        return f"cuts the error on the selection recording by {100 * cut:.1f} %; a cause has to cut it by {100 * CUT:.0f} %"
    if not current.keys:
        return ""
    beside = " and ".join(current.keys)
    if current.select - best.select < MATERIAL:
        return f"moves the selection recording's prediction by less than the noise beside {beside}: perhaps a surrogate"
    before, after = (max(t.train + t.select - 2.0, 0.0) for t in (current, best))
    if before < LITTLE and after > LEFT * before:
        told = f"explains {100 * (1.0 - after / before):.0f} % of the little that {beside} left"
        return f"{told}: a cause would explain nearly all of it, a surrogate of kinetics that are a little off does not"
    return ""


def _singles(tracer: Tracer, story: Story, scores: Scores, say: Callable[[str], None]) -> list[Trial]:
    """Refits of every effect that the recording can show: at a biased fit even the cause may promise nothing to first order."""
    bench, refit = tracer.bench, story.last.refit
    near = [k for k, s in scores.found.items() if math.isfinite(s.smallest)]
    promising = sorted((k for k in near if story.promise[k].gain > 0.0), key=lambda k: -story.promise[k].gain)
    say(f"round 1: refitting {len(near)} effects")
    trials = tracer.race(
        [Extension(refit, k, scores.found[k].strength, scores.shapes[k], scores.found[k].gain) for k in near],
        [Extension(refit, k, story.promise[k].strength, story.promise[k].shape) for k in promising[:_AFAR]],
    )
    best = min(trials, key=lambda t: t.total, default=None)
    if best is not None and (best.at_noise or (story.rests and min(story.explained_by(best), story.fitted_by(best)) > EXPLAINED)):
        return trials
    # A large effect promises nothing to first order, neither at the fit nor at the rig's own values: each in its usual strength.
    say("round 1: refitting them from the rig's own values")
    usual = [
        Extension(refit, key, sign, shape)
        for key in near
        for shape in bench.grid(key)
        for sign in (-1.0, 1.0)
        if bench.plausible(key)[0] < sign < bench.plausible(key)[1]
    ]
    return [*trials, *tracer.race((), usual)]


def _more(tracer: Tracer, beam: list[Trial], turn: int, promised: float, say: Callable[[str], None]) -> list[Trial]:
    """Refits of the beam's fits with one effect more; none if on the first of them none is ``promised`` to explain enough."""
    extensions: list[Extension] = []
    seen: set[frozenset] = set()
    for trial in beam:
        scores = tracer.scores(trial.refit)
        excess = (trial.train - 1.0) * tracer.bench.samples
        if trial is beam[0] and max((one.gain for one in scores.found.values()), default=0.0) < promised * excess:
            return []
        for key, one in sorted(scores.found.items(), key=lambda item: -item[1].gain)[:_SECOND]:
            keys = frozenset((*trial.keys, key))
            if one.gain > 0.0 and keys not in seen:
                seen.add(keys)
                extensions.append(Extension(trial.refit, key, one.strength, scores.shapes[key], one.gain))
    say(f"round {turn + 1}: refitting {len(extensions)} sets of effects")
    return tracer.race(extensions)


def _as_good(trial: Trial, best: Trial, samples: int) -> bool:
    close = (trial.train - best.train) * samples < 10.0 * max(1.0, best.train)
    return close and trial.select < best.select + max(0.01, 10.0 * max(1.0, best.select) / samples)


def _backward(tracer: Tracer, story: Story) -> None:
    """Drops each accepted effect that is not missed by now."""
    samples = tracer.bench.samples
    for key in story.accepted:
        if len(story.accepted) < 2:
            return
        refit = story.last.refit
        rest = refit.hypothesis.without(key)
        known = [t for t in story.way if set(t.keys) == set(rest.keys)]
        judged = known[0] if known else tracer.judged(tracer.fit(rest, refit.base, tracer.stride(story.last.train)))
        if not math.isfinite(judged.total):
            continue
        loss = 1.0 - math.sqrt(story.last.select / judged.select)
        if (judged.train - story.last.train) * samples < _FALL * max(1.0, story.last.train) or loss < CUT:
            story.rejected.append((key, "is no longer missed beside the other effects"))
            story.last = judged


def _swap(tracer: Tracer, story: Story) -> None:
    """Puts in an effect's place what it may be confused with, where several nearly explain the residual and that leaves less.

    What was found first stood alone then, where it may have been the wrong one of two that are alike.
    """
    samples = tracer.bench.samples
    for key in story.accepted:
        last = story.last
        if len(last.keys) < 2 or last.train < story.least or last.total > 2.0 * _NEARLY:
            return
        others = tracer.kin(dataclasses.replace(last, refit=last.refit.with_last(key)))
        best = min(others, key=lambda t: t.total, default=None)
        if best is not None and best.total < last.total - _FALL * max(1.0, last.train) / samples:
            story.rejected.append((key, f"leaves more, beside the other effects, than {best.key} in its place"))
            story.last = tracer.settled(best)
            story.equivalent.pop(key, None)


def _ranking(tracer: Tracer, scores: Scores, base: Refit) -> dict[str, Ranked]:
    bench, ranking = tracer.bench, {}
    names = [u.label for u, free in zip(bench.problems[0].unknowns, tracer.free(base), strict=True) if free]
    inflated = math.sqrt(max(bench.fitness(base.residual, 0), 1.0))
    for key, kind in catalogue().items():
        if key not in scores.found:
            ranking[key] = Ranked(unseen(bench, kind))
            continue
        one = scores.found[key]
        seen = sight(kind, one, scores.columns[key, scores.shapes[key]], scores.jacobian, names)
        if seen.status != "testable" or seen.smallest is None:
            ranking[key] = Ranked(seen)
            continue
        estimate, spread = one.strength * kind.typical, 1.96 / score.DETECTABLE * seen.smallest * inflated
        ranking[key] = Ranked(seen, estimate, estimate - spread, estimate + spread, one.gain, scores.chances[key])
    return ranking
