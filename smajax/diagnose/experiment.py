"""The next experiment: the input on which the effects that remain differ most, beyond what the free parameters can make up for.

Inputs are drawn from a library (steps, pulses and slow ramps of several levels and paces) within the range of the inputs recorded so far;
one that makes a wire hotter than the training or the selection input does, by the fitted plant without its effects, is left out. Each is
laid out like the training recording and costs the derivatives of one simulation. The measure is how many standard deviations apart the
two nearest rivals are, the better of them fitted.
"""

import dataclasses
import itertools
import math

import jax
import numpy as np

from smajax.diagnose import score
from smajax.diagnose.bench import Bench, in_pairs
from smajax.diagnose.hypothesis import Refit
from smajax.diagnose.program import SLOTS
from smajax.fit.problem import Problem
from smajax.recording import Recording

_TRIED = 24
_TOLD_APART = 5.0
_HOTTER = 1.0  # K


@dataclasses.dataclass(frozen=True)
class Next:
    """The input to run next (``None`` if none helps), which effects it would separate, by how many standard deviations, and advice."""

    recording: Recording | None
    separates: tuple[str, ...]
    sigma: float | None
    advice: str


def design(bench: Bench, refit: Refit, rivals: dict[str, dict[str, float]], seed: int) -> Next | None:
    """Looks for the input that separates ``rivals``: effects with the values of strength and shape that each was fitted with.

    ``None`` where fewer than two are left.
    """
    keys = [k for k in rivals if k in bench.effects]
    if len(keys) < 2:
        return None
    now = _apart(bench, refit, rivals, keys, bench.problems[0])
    limit = max(_hottest(bench, refit, bench.problems[k]) for k in (0, 1))
    tried: list[tuple[Recording, Problem]] = []
    for recording in library(bench.parts[0].recordings[0], bench.plain.plant.signals, seed):
        problem = bench.under(recording)
        if problem is not None and _hottest(bench, refit, problem) <= limit + _HOTTER:
            tried.append((recording, problem))
        if len(tried) == _TRIED:
            break
    found = in_pairs(lambda pair: _apart(bench, refit, rivals, keys, pair[1]), tried)
    best = max(range(len(tried)), key=lambda i: found[i]) if tried else -1
    if best < 0 or found[best] < max(_TOLD_APART, 1.2 * now):
        return Next(None, tuple(keys), max([now, *found]), _channel(bench, keys))
    chosen = tried[best][0]
    told = f"{chosen.name}; it sets {' and '.join(keys)} {found[best]:.0f} standard deviations apart, the training input {now:.0f}"
    return Next(chosen, tuple(keys), found[best], told)


def library(like: Recording, inputs: tuple[str, ...], seed: int) -> list[Recording]:
    """Inputs on a recording's own clock, within the range of its inputs: staircases, pulse trains and ramps."""
    rng, time = np.random.default_rng(seed), like.time
    span = time[-1] - time[0]
    recordings = []
    kinds = itertools.cycle(("steps of several levels", "pulses of several levels", "ramps of several levels"))
    for kind, pieces in zip(kinds, np.repeat([4, 6, 8, 12, 16, 24, 32, 48, 64, 96], 3), strict=False):
        channels = {}
        for name in inputs:
            low, high = float(like.channels[name].min()), float(like.channels[name].max())
            levels = low + (high - low) * rng.choice([0.0, 0.3, 0.5, 0.7, 0.85, 1.0], pieces + 1)
            at = (time - time[0]) / span * pieces
            k = np.minimum(at.astype(int), pieces - 1)
            if kind.startswith("steps"):
                channels[name] = levels[k]
            elif kind.startswith("pulses"):
                channels[name] = np.where(at - k < 0.4, levels[k], low)
            else:
                channels[name] = levels[k] + (at - k) * (levels[k + 1] - levels[k])
        title = f"{kind}, {span / pieces:.3g} {'s' if like.has_clock else 'rows'} each"
        recordings.append(Recording.from_arrays(title, time if like.has_clock else None, channels, like.units))
    return recordings


def _hottest(bench: Bench, refit: Refit, problem: Problem) -> float:
    """Highest temperature under a problem's inputs, degC."""
    members = range(problem.data.measured.shape[0])
    inputs = [jax.tree.map(lambda leaf, k=k: leaf[k], problem.data.inputs) for k in members]
    return max(float(np.max(np.asarray(bench.states(refit, one).temperature))) for one in inputs)


def _apart(bench: Bench, refit: Refit, rivals: dict, keys: list[str], problem: Problem) -> float:
    """Least distance between two rivals in standard deviations, the weaker of them taken at its fitted strength."""
    base = refit.hypothesis
    for key in keys:
        base = base.without(key)
    shapes = [item for k in keys for item in rivals[k].items() if not item[0].endswith(".strength")]
    at = dataclasses.replace(base, values=(*base.values, *shapes))
    columns = []
    for some in (keys[i : i + SLOTS] for i in range(0, len(keys), SLOTS)):
        _, jacobian = bench.evaluate_at(problem, at, refit.base, [f"effects.{k}.strength" for k in some])
        columns += [jacobian[:, bench.size + j] for j in range(len(some))]
    q = score.basis(jacobian[:, : bench.size])
    size = {k: abs(rivals[k].get(f"effects.{k}.strength", 0.0)) / bench.effects[k].typical or 1.0 for k in keys}
    left = {k: score.project(q, c) * size[k] for k, c in zip(keys, columns, strict=True)}
    least = math.inf
    for a, b in itertools.combinations(keys, 2):
        norms = np.linalg.norm(left[a]), np.linalg.norm(left[b])
        if min(norms) == 0.0 or not all(map(np.isfinite, norms)):
            return 0.0
        cosine = float(left[a] @ left[b]) / (norms[0] * norms[1])
        least = min(least, float(min(norms)) * math.sqrt(max(0.0, 1.0 - cosine**2)))
    return least


def _channel(bench: Bench, keys: list[str]) -> str:
    """What to record instead, where no input within the limits separates the rivals."""
    seen = set(bench.channels)
    stages = {bench.effects[k].stage for k in keys}
    wanted = [c for c in ("temperature", "voltage") if c not in seen and stages & {"drive", "heat", "material"}]
    if stages & {"mechanism", "sensor"}:
        wanted.append("a second sensor of the motion")
    more = f"record {' or '.join(wanted)} as well, or " if wanted else ""
    told = f"no input within these limits tells {' and '.join(keys)} apart"
    return f"{told}: {more}repeat the recording under another load or with another wire"
