"""Successive halving: many refits take a few steps, then the best of them go on, in several rounds (jamieson2016)."""

import math
from collections.abc import Sequence

import numpy as np

from smajax.diagnosis.candidate_evaluation import FAR_FROM_NOISE, CandidateEvaluator
from smajax.diagnosis.candidates import Candidate, CandidateFit, EffectSet, RefitSearch
from smajax.diagnosis.data_split import TRAIN
from smajax.diagnosis.onset_times import scan_onset_times
from smajax.diagnosis.parallel import map_in_pairs

# Rounds: how many searches of each group go on, and for how many steps, the first of which only evaluates the start.
# Chosen by trial.
HALVING_SCHEDULE = (
    (99, 5),
    (8, 4),
    (5, 8),
    (3, 30),
)
# Steps of a round beyond which candidates that started near and far compete with each other: by then both have left
# their start errors.
_SEPARATE_STEPS = 5
# Cost over the least one beyond which a search is dropped in any round, and in those in which all compete. Chosen by
# trial.
_HOPELESS = 30.0
_BEHIND = 4.0
# Candidates, of the largest gains, that start a second time with their shape held. Chosen by trial.
_HELD_SHAPES = 3
# Sets of effects, at most, whose prediction of the selection split is evaluated; each costs a refit's end.
_MAX_EVALUATED = 10
# Start strengths in units of the typical one: small near a fit, so that all parameters move together from there; large
# from the rig's nominal values, within what a search recovers from. Chosen by trial.
_SMALL_STRENGTH = 0.1
_MIN_FAR_STRENGTH = 0.3
_MAX_FAR_STRENGTH = 2.0


def successive_halving(
    evaluator: CandidateEvaluator, near: Sequence[Candidate], far: Sequence[Candidate] = ()
) -> list[CandidateFit]:
    """Fit candidates with one effect more each: a few steps for all, then the best of them until they converge.

    Args:
        evaluator: The evaluator.
        near: Candidates that start at their parent's point with a small strength.
        far: Candidates that start at the rig's nominal values and stay near them: what a large effect has done to the
            other parameters may keep a search from leaving the parent's point.

    Returns:
        The fits of the best sets of effects; sets that most others have left behind by then are missing.

    Source: jamieson2016, with two groups of starts.
    """
    problem = evaluator.problem
    parents = (problem.reduced_chi2(c.parent.residual, TRAIN) for c in (*near, *far))
    stride = evaluator.stride(min(parents, default=0.0))
    starts = _Starts(evaluator, near, far, stride)
    groups, everyone = _halve(evaluator, starts, stride)
    everyone += map_in_pairs(evaluator.continue_if_needed, [s for s in groups[0] if s.stride > 1])
    scanned = map_in_pairs(lambda search: scan_onset_times(evaluator, search), groups[0])
    everyone += [search for searches in scanned for search in searches]
    best: dict[frozenset, RefitSearch] = {}
    for search in sorted(everyone, key=lambda s: s.cost):
        best.setdefault(frozenset(search.effect_set.keys), search)
    refits = map_in_pairs(problem.refit_from, list(best.values())[:_MAX_EVALUATED])
    fits = map_in_pairs(evaluator.evaluate, [r for r in refits if math.isfinite(r.chi2)])
    return [fit for fit in fits if math.isfinite(fit.total_chi2) and not evaluator.is_negligible(fit)]


def trusted_candidate(evaluator: CandidateEvaluator, candidates: Sequence[Candidate]) -> Candidate | None:
    """Return the candidate of the largest gain, if its parent is so near to the noise that a score holds there."""
    largest = max(candidates, key=lambda c: c.gain, default=None)
    if largest is None or largest.gain <= 0.0:
        return None
    near_noise = evaluator.problem.reduced_chi2(largest.parent.residual, TRAIN) < FAR_FROM_NOISE
    return largest if near_noise else None


class _Starts:
    """The searches at their start: ``near`` and ``far`` groups, and those that are ``trusted``."""

    def __init__(self, evaluator: CandidateEvaluator, near: Sequence[Candidate], far: Sequence[Candidate], stride: int):
        self._problem, self._stride = evaluator.problem, stride
        nominal = self._problem.nominal
        self.near = [self._search(c, _near_strength(c), c.parent.base) for c in near]
        self.far = [self._search(c, _far_strength(c), nominal, near_nominal=True) for c in far]
        # The largest gains start a second time, with their shape held: freed too early, a shape may drift away.
        promising = sorted((c for c in near if c.gain > 0.0 and c.shape), key=lambda c: -c.gain)[:_HELD_SHAPES]
        self.near += [self._search(c, _near_strength(c), c.parent.base, hold_shapes=True) for c in promising]
        # Near the noise the largest gain is trusted, and its search goes on though others fall sooner: its valley may
        # be a long one.
        trusted = trusted_candidate(evaluator, near)
        self.trusted = [s for c, s in zip(near, self.near, strict=False) if c is trusted]

    def _search(
        self,
        candidate: Candidate,
        size: float,
        base: np.ndarray,
        *,
        near_nominal: bool = False,
        hold_shapes: bool = False,
    ) -> RefitSearch:
        effect_set = self._effect_set(candidate, size)
        return self._problem.start_search(
            effect_set, base, near_nominal=near_nominal, hold_shapes=hold_shapes, stride=self._stride
        )

    def _effect_set(self, candidate: Candidate, size: float) -> EffectSet:
        """The parent's effects and the candidate's, with this start strength in units of the typical one."""
        key = candidate.key
        strength = math.copysign(size, candidate.strength or 1.0) * self._problem.effects[key].typical
        shape = {f"effects.{key}.{name}": value for name, value in candidate.shape}
        return candidate.parent.effect_set.with_effect(key, {f"effects.{key}.strength": strength, **shape})


def _near_strength(candidate: Candidate) -> float:
    return min(abs(candidate.strength) or _SMALL_STRENGTH, _SMALL_STRENGTH)


def _far_strength(candidate: Candidate) -> float:
    return min(max(abs(candidate.strength), _MIN_FAR_STRENGTH), _MAX_FAR_STRENGTH)


def _halve(
    evaluator: CandidateEvaluator, starts: _Starts, stride: int
) -> tuple[list[list[RefitSearch]], list[RefitSearch]]:
    """The searches of the last round, and all that were started.

    The two groups compete apart at first, since those from far begin with larger errors.
    """
    problem = evaluator.problem
    groups = [starts.near, starts.far]
    everyone = [s for group in groups for s in group]
    for count, steps in HALVING_SCHEDULE:
        least = min((s.cost for s in everyone), default=math.inf)
        groups = [
            sorted((s for s in g if not s.cost > _HOPELESS * least), key=lambda s: s.cost)[:count] for g in groups
        ]
        if steps > _SEPARATE_STEPS:
            ranked = sorted((s for g in groups for s in g), key=lambda s: s.cost)
            groups = [[s for s in ranked if s.cost < _BEHIND * ranked[0].cost][:count]]
            groups[0] += [
                s for s in starts.trusted if math.isfinite(s.cost) and all(s is not other for other in groups[0])
            ]
            if ranked and evaluator.stride(ranked[0].cost / problem.samples) < stride:
                groups = [[problem.continue_on_all_samples(s, 0) for s in groups[0]]]
                everyone += groups[0]
        map_in_pairs(lambda s, steps=steps: s.advance(steps), [s for g in groups for s in g])
    return groups, everyone
