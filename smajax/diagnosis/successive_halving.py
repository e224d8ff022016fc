"""Successive halving: all refits take a few steps, and the best of them continue, in several rounds.

Source: jamieson2016.
"""

import math
from collections.abc import Sequence

import numpy as np

from smajax.diagnosis.candidate_evaluation import FAR_FROM_NOISE, CandidateEvaluator
from smajax.diagnosis.candidates import Candidate, CandidateFit, EffectSet, RefitSearch
from smajax.diagnosis.data_split import TRAIN
from smajax.diagnosis.onset_times import scan_onset_times
from smajax.numerics.ensemble import share_among_cores

# Rounds: number of searches of each group that continue, and number of their steps, the first of which only evaluates
# the start. Chosen by trial.
HALVING_SCHEDULE = (
    (99, 5),
    (8, 4),
    (5, 8),
    (3, 30),
)
# The same where each step is expensive. Chosen by trial.
SHORT_SCHEDULE = (
    (99, 4),
    (4, 4),
    (3, 25),
)
# Number of steps of a round above which near and far starts compete with each other: by then both have reduced the
# errors of their start. It is that of the first round.
_SEPARATE_STEPS = 5
# Cost over the least one above which a search is dropped in any round, and in those in which all compete. Chosen by
# trial.
_HOPELESS = 30.0
_BEHIND = 4.0
# Number of candidates, those of the largest gains, that start a second time with their shape held. Chosen by trial.
_HELD_SHAPES = 3
# Largest number of sets of effects whose prediction of the selection split is evaluated; each costs a simulation with
# derivatives. Chosen by trial.
_MAX_EVALUATED = 10
# Start strengths in units of the typical strength: small near a fit, so that all parameters move together from there;
# larger from the rig's nominal values, within the range from which a search converges. Chosen by trial.
_SMALL_STRENGTH = 0.1
_MIN_FAR_STRENGTH = 0.3
_MAX_FAR_STRENGTH = 2.0


def successive_halving(
    evaluator: CandidateEvaluator,
    near: Sequence[Candidate],
    far: Sequence[Candidate] = (),
    schedule: Sequence[tuple[int, int]] = HALVING_SCHEDULE,
) -> list[CandidateFit]:
    """Fit candidates with one more effect each: a few steps for all, then more for the best of them.

    Args:
        evaluator: The evaluator.
        near: Candidates that start at the point of their parent with a small strength.
        far: Candidates that start at the rig's nominal values and are bounded near them. A large effect may have biased
            the parameters of the parent so much that a search from there does not find it.
        schedule: Number of searches that continue in each round, and of their steps.

    Returns:
        The fits of the best sets of effects that improve by the new effect.

    Source: jamieson2016, with two groups of starts.
    """
    problem = evaluator.problem
    parents = (problem.reduced_chi2(c.parent.residual, TRAIN) for c in (*near, *far))
    stride = evaluator.stride(min(parents, default=0.0))
    starts = _Starts(evaluator, near, far, stride)
    groups, searches = _halve(evaluator, starts, stride, schedule)
    searches += share_among_cores(evaluator.continue_if_needed, [s for s in groups[0] if s.stride > 1])
    by_search = share_among_cores(lambda search: scan_onset_times(evaluator, search), groups[0])
    searches += [search for scanned in by_search for search in scanned]
    best: dict[frozenset[str], RefitSearch] = {}
    for search in sorted(searches, key=lambda s: s.cost):
        best.setdefault(frozenset(search.effect_set.keys), search)
    refits = share_among_cores(problem.refit_from, list(best.values())[:_MAX_EVALUATED])
    fits = share_among_cores(evaluator.evaluate, [r for r in refits if math.isfinite(r.chi2)])
    return [fit for fit in fits if math.isfinite(fit.total_chi2) and not evaluator.is_negligible(fit)]


def trusted_candidate(evaluator: CandidateEvaluator, candidates: Sequence[Candidate]) -> Candidate | None:
    """Return the candidate of the largest gain, if its parent is so near the noise that its score is reliable.

    Args:
        evaluator: The evaluator.
        candidates: The candidates.

    Returns:
        The candidate; ``None`` if no gain is positive, or the parent's reduced chi-squared is 9 or more.
    """
    largest = max(candidates, key=lambda c: c.gain, default=None)
    if largest is None or largest.gain <= 0.0:
        return None
    near_noise = evaluator.problem.reduced_chi2(largest.parent.residual, TRAIN) < FAR_FROM_NOISE
    return largest if near_noise else None


class _Starts:
    """The searches at their start: ``near`` and ``far`` groups, and the ``trusted`` one, which is not dropped."""

    def __init__(self, evaluator: CandidateEvaluator, near: Sequence[Candidate], far: Sequence[Candidate], stride: int):
        self._problem, self._stride = evaluator.problem, stride
        nominal = self._problem.nominal
        self.near = [self._search(c, self._near_strength(c), c.parent.base) for c in near]
        self.far = [self._search(c, self._far_strength(c), nominal, near_nominal=True) for c in far]
        # The largest gains start a second time with their shape held: a shape may drift away if it is freed too early.
        promising = sorted((c for c in near if c.gain > 0.0 and c.shape), key=lambda c: -c.gain)[:_HELD_SHAPES]
        self.near += [self._search(c, self._near_strength(c), c.parent.base, hold_shapes=True) for c in promising]
        # Near the noise the largest gain is trusted: its search continues although the cost of others falls sooner,
        # because it may need many steps along a curved valley.
        trusted = trusted_candidate(evaluator, near)
        self.trusted = [s for c, s in zip(near, self.near, strict=False) if c is trusted]

    def _search(
        self,
        candidate: Candidate,
        start_strength: float,
        base: np.ndarray,
        *,
        near_nominal: bool = False,
        hold_shapes: bool = False,
    ) -> RefitSearch:
        effect_set = self._effect_set(candidate, start_strength)
        return self._problem.start_search(
            effect_set, base, near_nominal=near_nominal, hold_shapes=hold_shapes, stride=self._stride
        )

    def _effect_set(self, candidate: Candidate, start_strength: float) -> EffectSet:
        """The effects of the parent and the candidate; the start strength is in units of the typical strength."""
        key = candidate.key
        strength = math.copysign(start_strength, candidate.strength or 1.0) * self._problem.effects[key].typical
        shape = {f"effects.{key}.{name}": value for name, value in candidate.shape}
        return candidate.parent.effect_set.with_effect(key, {f"effects.{key}.strength": strength, **shape})

    def _near_strength(self, candidate: Candidate) -> float:
        if self._problem.effects[candidate.key].all_or_nothing:
            return 1.0
        return min(abs(candidate.strength) or _SMALL_STRENGTH, _SMALL_STRENGTH)

    def _far_strength(self, candidate: Candidate) -> float:
        if self._problem.effects[candidate.key].all_or_nothing:
            return 1.0
        return min(max(abs(candidate.strength), _MIN_FAR_STRENGTH), _MAX_FAR_STRENGTH)


def _halve(
    evaluator: CandidateEvaluator, starts: _Starts, stride: int, schedule: Sequence[tuple[int, int]]
) -> tuple[list[list[RefitSearch]], list[RefitSearch]]:
    """The searches of the last round in one group, and all searches.

    The two groups compete separately at first, since far starts begin with larger errors.
    """
    problem = evaluator.problem
    groups = [starts.near, starts.far]
    searches = [s for group in groups for s in group]
    for count, steps in schedule:
        least = min((s.cost for s in searches), default=math.inf)
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
                searches += groups[0]
        share_among_cores(lambda s, steps=steps: s.advance(steps), [s for g in groups for s in g])
    return groups, searches
