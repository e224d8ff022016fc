"""The next experiment: the input on which the effects that remain differ most, beyond what the free parameters can make up for.

Inputs are drawn from a library (steps, pulses and slow ramps of several levels and paces) within the largest input recorded so far, so
that no wire gets hotter than it has been under it. Each is laid out like the training recording and costs the derivatives of one
simulation. The measure is how many standard deviations apart the two nearest rivals are, the better of them fitted.
"""

import dataclasses
import itertools
import math

import numpy as np

from smajax.diagnose import score
from smajax.diagnose.candidates import Bench, Refit
from smajax.recording import Recording

_TRIED = 24
_TOLD_APART = 5.0


@dataclasses.dataclass(frozen=True)
class Next:
    """The input to run next (``None`` if none helps), which effects it separates, by how many standard deviations, and advice."""

    recording: Recording | None
    separates: tuple[str, ...]
    sigma: float | None
    advice: str


def design(bench: Bench, refit: Refit, rivals: dict[str, dict[str, float]], seed: int) -> Next:
    """Looks for the input that separates ``rivals``: effects with the values of strength and shape that each was fitted with."""
    inputs = bench.problems[0].plant.signals
    keys = [k for k in rivals if k in bench.effects]
    if len(keys) < 2:
        return Next(None, (), None, "nothing is left to tell apart")
    now = _apart(bench, refit, rivals, keys, bench.recordings[0])
    tried = [r for r in library(bench.recordings[0], inputs, seed) if bench.under(r) is not None][:_TRIED]
    found = bench.many(lambda r: _apart(bench, refit, rivals, keys, r), tried)
    best = max(range(len(tried)), key=lambda i: found[i]) if tried else -1
    if best < 0 or found[best] < max(_TOLD_APART, 1.2 * now):
        return Next(None, tuple(keys), max([now, *found]), _channel(bench, keys))
    told = f"{tried[best].name}; it sets {' and '.join(keys)} {found[best]:.0f} standard deviations apart, the training input {now:.0f}"
    return Next(tried[best], tuple(keys), found[best], told)


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
        title = f"{kind}, {span / pieces:.3g} s each"
        recordings.append(Recording.from_arrays(title, time, channels, like.units))
    return recordings


def _apart(bench: Bench, refit: Refit, rivals: dict, keys: list[str], recording: Recording) -> float:
    """Least distance between two rivals in standard deviations, the weaker of them taken at its fitted strength."""
    problem = bench.under(recording)
    if problem is None:
        return 0.0
    base = refit.hypothesis
    for key in keys:
        base = base.without(key)
    shapes = [item for k in keys for item in rivals[k].items() if not item[0].endswith(".strength")]
    at = dataclasses.replace(base, values=(*base.values, *shapes))
    columns = []
    for pair in (keys[i : i + 6] for i in range(0, len(keys), 6)):
        _, jacobian = bench.evaluate_at(problem, at, refit.base, [f"effects.{k}.strength" for k in pair])
        columns += [jacobian[:, bench.size + j] for j in range(len(pair))]
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
