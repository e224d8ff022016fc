"""The verdict: what a trace found, looked at once on the third recording, in numbers."""

import dataclasses
import math
from collections.abc import Callable, Mapping
from types import MappingProxyType

import jax.numpy as jnp
import numpy as np

from smajax.diagnose import experiment, instants, localise, score
from smajax.diagnose.bench import Bench, in_pairs
from smajax.diagnose.effects import catalogue
from smajax.diagnose.experiment import Next
from smajax.diagnose.hypothesis import Hypothesis, Refit
from smajax.diagnose.joint import joined
from smajax.diagnose.localise import Shape
from smajax.diagnose.preflight import Sight, sight
from smajax.diagnose.residual import Look, look
from smajax.diagnose.step_errors import step_error
from smajax.diagnose.trace import EXPLAINED, Ranked, Story, trace
from smajax.diagnose.tracer import Tracer
from smajax.errors import NumericsError
from smajax.fit import uncertainty

PARTS = ("train", "select", "holdout")
_NOISY = 1.2


@dataclasses.dataclass(frozen=True)
class Diagnosis:
    """The whole of it. RMSEs in SI by channel; ``before`` and ``after`` are fitted to training and selection part together.

    ``rests`` says whether the first fit, without effects, came to rest. ``excluded`` are the effects that would have been seen from their
    ``smallest`` strength on. ``predictions`` hold model minus measurement, SI, by before /
    after, recording and channel; ``looks`` the residuals of the training recording by before / after and channel.
    """

    verdict: str
    effects: tuple[str, ...]
    equivalent: dict[str, tuple[str, ...]]
    unresolved_stage: str | None
    preflight: tuple[Sight, ...]
    ranking: tuple[Ranked, ...]
    excluded: tuple[Sight, ...]
    stages: dict[str, float]
    noise: dict[str, tuple[float, str]]
    before: Refit
    after: Refit
    rests: bool
    fitness: tuple[float, float, float]
    rmse: dict[str, dict[str, float]]
    cut95: dict[str, tuple[float, float]]
    rejected: tuple[tuple[str, str], ...]
    intervals: dict[str, tuple[float, float]]
    predictions: dict[str, list[dict[str, np.ndarray]]]
    looks: dict[str, dict[str, Look]]
    shape: Shape | None
    next: Next | None


def diagnose(
    bench: Bench, *, seed: int = 0, given: Mapping[str, float] = MappingProxyType({}), say: Callable[[str], None] = lambda text: None
) -> Diagnosis:
    """Traces, judges, and says what to do next. The bench holds three recordings, for training, selection and holdout.

    ``given`` are the standard deviations of channels' noise that are known, SI. Raises NumericsError if the first fit does not come to rest
    and is not at the noise either, and no effect lets it; its ``state`` holds the point where it ended.
    """
    tracer, story = trace(bench, seed=seed, given=given, say=say)
    take_back(story)
    if not (story.rests or story.accepted or story.first.train < story.least):
        told = "the fit of the rig as it is written down did not come to rest, so its residual says nothing: widen fit.bounds"
        values, _ = bench.problems[0].values(jnp.asarray(story.first.refit.base))
        raise NumericsError(told, {name: float(v) for name, v in values.items()})
    say("predicting the holdout")
    unfitted = Refit(Hypothesis(), bench.nominal, *bench.evaluate(Hypothesis(), bench.nominal, 0), story.first.refit.stop)
    ends = in_pairs(lambda refit: joined(bench, refit), [story.first.refit, *[story.last.refit] * bool(story.accepted)])
    first = predicting(bench, ends[0], story.first.refit, unfitted)
    last = predicting(bench, ends[1], story.last.refit) if story.accepted else first
    together = tuple(bench.fitness(bench.predict(last.hypothesis, last.base, k), k) for k in range(3))
    both = (0,) if bench.own else (0, 1)
    slow = not story.accepted and story.quiet  # then whatever is left is noise
    expected = tracer.expected(story.last.refit, 1, slow=slow), tracer.expected(last, 2, both, slow=slow)
    verdict = judge(story, together, expected)
    if verdict == "partial" and min(story.last.train, max(together[:2])) < story.least:
        # An instant may be open by more than its slope tells.
        open_by = instants.left_open(bench, story.last.refit, 1), instants.left_open(bench, last, 2, both)
        verdict = judge(story, together, (expected[0] + open_by[0], expected[1] + open_by[1]))
    if verdict == "partial" and not _helps(tracer, first, last):
        _reject(story, "does not lessen the error on the holdout")
        last, verdict = first, "unresolved"
    stage = shape = None
    if verdict in ("unresolved", "partial"):
        say("looking for the stage where the rest lives")
        stage, shape = _rest(tracer, story)
    designed = None
    if verdict != "named" and verdict != "nothing-missing":
        say("designing the next experiment")
        designed = experiment.design(bench, story.last.refit, _rivals(story), seed)
    return _conclude(tracer, story, (first, last), verdict, stage, shape, designed)


def predicting(bench: Bench, *refits: Refit) -> Refit:
    """The first of the refits that predicts selection and holdout part at all: a bad fit may run away under another input."""
    for refit in refits:
        if all(math.isfinite(bench.fitness(bench.predict(refit.hypothesis, refit.base, k), k)) for k in (1, 2)):
            return refit
    return refits[-1]


def take_back(story: Story) -> None:
    """Takes back effects that leave most of the excess unexplained."""
    if story.accepted and story.explained < EXPLAINED and story.last.train > story.least:
        _reject(story, f"together the effects found explain {100 * story.explained:.0f} % of what is missing, too little for a cause")


def _reject(story: Story, why: str) -> None:
    """Takes all effects back."""
    story.rejected += [(key, why) for key in story.accepted]
    story.equivalent, story.last = {}, story.first


def _helps(tracer: Tracer, first: Refit, last: Refit) -> bool:
    """Whether the holdout's error falls in any channel by more than chance, or ``first`` cannot predict it at all."""
    bench = tracer.bench
    before, after = (bench.series(bench.predict(refit.hypothesis, refit.base, 2), 2) for refit in (first, last))
    return any(not bootstrap(before[c], after[c], tracer.seed)[0] <= 0.0 for c in bench.channels)


def judge(story: Story, together: tuple[float, ...], expected: tuple[float, float]) -> str:
    """The verdict's word.

    ``together`` are the mean squares of the fit to training and selection part on these two and on the holdout; ``expected`` are those that
    noise and the parameters' own uncertainty would leave on the selection part, by the fit to the training part alone, and on the holdout:
    what is named has to predict both as well as that. Where the training part tells less than it seems to, such as of an instant at which
    nothing moves, it is enough that one fit does for both and predicts the holdout, all three to the noise.
    """
    last, least = story.last, story.least
    select, held = last.select / expected[0], together[2] / expected[1]
    if not story.accepted:
        missing = last.train > max(story.limit, 1.1) or select > _NOISY or held > _NOISY**2
        return "unresolved" if missing else "nothing-missing"
    if (last.train < least and max(select, held) < _NOISY**2) or max(*together[:2], held) < least:
        return "named-up-to-class" if any(story.equivalent.get(k) for k in story.accepted) else "named"
    return "partial"


def _rest(tracer: Tracer, story: Story) -> tuple[str | None, Shape | None]:
    """The stage where what is left unexplained lives, and its shape; if only another input shows it, the stage of what stands in for it.

    ``None`` if only another input shows it and nothing stands in for it.
    """
    refit = story.last.refit
    if story.accepted and story.last.train < story.least:
        return tracer.bench.effects[story.last.key].stage, None
    scores = tracer.scores(refit)
    left = tracer.shares(refit, scores) if story.accepted else story.stages
    stage = localise.likeliest(left)
    stride = tracer.stride(story.last.train)
    return stage, localise.shape(tracer.bench, refit, scores.q, scores.left, stage, stride) if stage else None


def _rivals(story: Story) -> dict[str, dict[str, float]]:
    """What could still be told apart: each accepted effect with its equivalents, or the best two trials where nothing was accepted."""
    found: dict[str, dict[str, float]] = {}
    for key in story.accepted:
        if story.equivalent.get(key) or story.last.train > story.limit:
            same = [t for t in story.rivals.get(key, ()) if t.key in story.equivalent.get(key, ()) or not story.equivalent.get(key)][:2]
            found |= {t.key: {n: v for n, v in t.refit.values.items() if n.split(".")[1] == t.key} for t in same}
            found[key] = {n: v for n, v in story.last.refit.values.items() if n.split(".")[1] == key}
    if not found:
        tried = sorted((r for r in story.ranking.values() if r.gain), key=lambda r: -(r.gain or 0.0))[:2]
        found = {r.sight.key: {f"effects.{r.sight.key}.strength": r.strength or 0.0} for r in tried}
    return found


def _excluded(tracer: Tracer, story: Story) -> tuple[Sight, ...]:
    """What the last fit's residual, which is noise, has no trace of: effects whose strength there may as well be 0."""
    scores, same = tracer.scores(story.last.refit), {k for keys in story.equivalent.values() for k in keys}
    found = []
    for key, one in scores.found.items():
        seen = sight(catalogue()[key], one, scores.columns[key, scores.shapes[key]], scores.jacobian, [])
        doubtful = key in same or any(key == k for k, _ in story.rejected)
        if seen.status == "testable" and not doubtful and abs(one.strength) < 1.96 / score.DETECTABLE * one.smallest:
            found.append(seen)
    return tuple(found)


def _conclude(
    tracer: Tracer, story: Story, fits: tuple[Refit, Refit], verdict: str, stage: str | None, shape: Shape | None, designed: Next | None
) -> Diagnosis:
    bench, (first, last) = tracer.bench, fits
    noise = bench.noise
    residuals = {
        "before": [first.residual, *(bench.predict(Hypothesis(), first.base, k) for k in (1, 2))],
        "after": [last.residual, *(bench.predict(last.hypothesis, last.base, k) for k in (1, 2))],
    }
    series = {when: [bench.series(r, k) for k, r in enumerate(found)] for when, found in residuals.items()}
    rmse, cut95 = {}, {}
    for c in bench.channels:
        rmse[c] = {
            f"{part}_{when}": float(np.sqrt(np.mean(series[when][k][c] ** 2))) * noise[c]
            for k, part in enumerate(PARTS)
            for when in ("before", "after")
        }
        cut95[c] = bootstrap(series["before"][2][c] * noise[c], series["after"][2][c] * noise[c], tracer.seed)
    looks = {when: {c: look(v * noise[c], bench.inputs()) for c, v in found[0].items()} for when, found in series.items()}
    return Diagnosis(
        verdict=verdict,
        effects=tuple(story.accepted),
        equivalent={k: story.equivalent[k] for k in story.accepted if story.equivalent.get(k)},
        unresolved_stage=stage,
        preflight=tuple(story.preflight.values()),
        ranking=tuple(story.ranking.values()),
        excluded=_excluded(tracer, story) if verdict not in ("partial", "unresolved") else (),
        stages=story.stages,
        noise=story.noise,
        before=first,
        after=last,
        rests=story.rests,
        fitness=(bench.fitness(first.residual, 0), bench.fitness(last.residual, 0), story.limit),
        rmse=rmse,
        cut95=cut95,
        rejected=tuple(story.rejected),
        intervals=_intervals(tracer, last),
        predictions={when: [{c: v * noise[c] for c, v in s.items()} for s in found] for when, found in series.items()},
        looks=looks,
        shape=shape,
        next=designed,
    )


def _intervals(tracer: Tracer, refit: Refit) -> dict[str, tuple[float, float]]:
    """95 % intervals of the effects' parameters: by the residual's own autocorrelation, and as far as the steps' length moves them."""
    bench, moved = tracer.bench, tracer.bench.moved(refit.hypothesis)
    if not moved:
        return {}
    free = tracer.free(refit)
    jacobians, residuals, whole = [], [], []
    for k in (0, 1)[: 1 if bench.own else 2]:
        left, jacobian = bench.evaluate(refit.hypothesis, refit.base, k, moved)
        columns = [bench.series(c, k) for c in jacobian[:, free].T]
        for name, series in bench.series(left, k).items():
            jacobians.append(np.column_stack([c[name] for c in columns]))
            residuals.append(series)
        whole.append(np.concatenate(jacobians[-len(bench.channels) :]))
    covariance = uncertainty.covariance(jacobians, residuals, int(np.sum(free)))
    spread = 1.96 * np.sqrt(np.diag(covariance))
    # Steps of finite length pull the parameters on the other recordings as they do on the first one.
    normal = np.linalg.pinv(sum(j.T @ j for j in whole), hermitian=True)
    spread += np.abs(normal @ (whole[0].T @ step_error(bench, refit))) * len(whole)
    return {
        name: (refit.values[name] - s * bench.scale(name), refit.values[name] + s * bench.scale(name))
        for name, s in zip(moved, spread[-len(moved) :], strict=True)
        if math.isfinite(s)
    }


def bootstrap(before: np.ndarray, after: np.ndarray, seed: int, draws: int = 1000) -> tuple[float, float]:
    """95 % interval of the fall of the RMSE, by blocks of a fiftieth of the recording."""
    length = max(1, len(before) // 50)
    count = len(before) // length
    squares = [np.mean((v[: count * length] ** 2).reshape(count, length), axis=1) for v in (before, after)]
    pick = np.random.default_rng(seed).integers(0, count, (draws, count))
    cut = np.sqrt(np.mean(squares[0][pick], axis=1)) - np.sqrt(np.mean(squares[1][pick], axis=1))
    low, high = np.quantile(cut, [0.025, 0.975])
    return float(low), float(high)
