"""Error budget: the error of each recording by what was added to the model, from a naive forecast to the noise."""

from collections.abc import Callable
from typing import NamedTuple

import numpy as np

from smajax.diagnosis.bootstrap import bootstrap_cut
from smajax.diagnosis.candidate_evaluation import CandidateEvaluator
from smajax.diagnosis.candidates import EffectSet, Refit
from smajax.diagnosis.data_split import HOLDOUT, SPLIT_NAMES, TRAIN
from smajax.diagnosis.joint_refit import refit_jointly
from smajax.diagnosis.selection_state import SelectionState
from smajax.diagnosis.structure import Structure

# Names of the entries that are not effects.
NAIVE, BASE, STRUCTURE = "naive", "base", "structure"

Errors = dict[str, dict[str, float]]
Series = list[dict[str, np.ndarray]]


class BudgetEntry(NamedTuple):
    """One entry of an error budget.

    Attributes:
        added: What the model has in addition to that of the entry before: the key of an effect, or "structure" for
            cells and grains; "base" for the rig's own model, and "naive" for the mean of the training recording.
        errors: RMSE by channel and split, SI; NaN where the prediction fails.
        cut95: 95 % interval of the fall of the RMSE from the entry before, by channel, SI, on the second half of the
            holdout, which had no part in any choice; empty for the first two entries.
        cut_if_last: Fall of the RMSE by channel and split, SI, if this is added last; empty for the first two entries.
    """

    added: str
    errors: Errors
    cut95: dict[str, tuple[float, float]]
    cut_if_last: Errors


def error_budget(
    rig: CandidateEvaluator,
    evaluator: CandidateEvaluator,
    state: SelectionState,
    structure: Structure,
    before: Refit,
    after: Refit,
) -> tuple[BudgetEntry, ...]:
    """Predict all recordings by each of the models from a naive forecast to that with all effects.

    Every model is fitted to training and selection split together.

    Args:
        rig: The evaluator of the rig without structure.
        evaluator: The evaluator of the structure that was found.
        state: The state at the end of the selection; its accepted effects are added in their order.
        structure: The structure of the wire.
        before: The fit of the rig's own model.
        after: The fit with structure and effects.
    """
    problem, keys = evaluator.problem, list(state.accepted)
    earlier = {frozenset(fit.keys): fit.refit for fit in (*state.accepted_fits, state.base_fit)}
    joint = {frozenset(keys): after}

    def fit(effect_set: EffectSet) -> Refit:
        names = frozenset(effect_set.keys)
        if names not in joint:
            stride = evaluator.stride(state.base_fit.train_chi2)
            start = earlier.get(names) or evaluator.fit(effect_set, np.clip(after.base, *problem.bounds), stride)
            joint[names] = refit_jointly(problem, start)
        return joint[names]

    models: list[tuple[str, Callable[[], Series]]] = [(BASE, lambda: _series(rig, before))]
    if structure.effects:
        models.append((STRUCTURE, lambda: _series(evaluator, fit(EffectSet()))))
    for count, key in enumerate(keys, 1):
        partly = after.effect_set
        for later in keys[count:]:
            partly = partly.without(later)
        models.append((key, lambda partly=partly: _series(evaluator, fit(partly))))
    last = _series(evaluator, after)
    entries = [BudgetEntry(NAIVE, _errors(evaluator, _naive_series(evaluator)), {}, {})]
    previous: Series = []
    for added, model in models:
        series = model()
        cut = _cuts(evaluator, previous, series) if previous else {}
        entries.append(BudgetEntry(added, _errors(evaluator, series), cut, {}))
        previous = series
    single = len(models) == 2
    for i, entry in enumerate(entries[2:], 2):
        if single:
            without = entries[i - 1].errors
        elif entry.added == STRUCTURE:
            # The rig's own model with the same effects.
            fitted = rig.fit(after.effect_set, before.base, 1)
            without = _errors(rig, _series(rig, refit_jointly(rig.problem, fitted)))
        else:
            without = _errors(evaluator, _series(evaluator, fit(after.effect_set.without(entry.added))))
        entries[i] = entry._replace(cut_if_last=_difference(without, _errors(evaluator, last)))
    return tuple(entries)


def second_half(series: np.ndarray) -> np.ndarray:
    """Return the second half of the samples of a series; the first may decide whether effects stay."""
    return series[len(series) // 2 :]


def first_half(series: np.ndarray) -> np.ndarray:
    """Return the first half of the samples of a series."""
    return series[: len(series) // 2]


def _series(evaluator: CandidateEvaluator, refit: Refit) -> Series:
    """Residuals over the noise by split and channel, NaN where the prediction fails."""
    problem = evaluator.problem
    return [problem.series(problem.report(refit, k)[0], k) for k in range(len(SPLIT_NAMES))]


def _naive_series(evaluator: CandidateEvaluator) -> Series:
    """Measurement less its mean over the training recordings, over the noise."""
    problem = evaluator.problem
    measured = [
        {
            channel: np.concatenate([r.channels[channel][rows] for r, rows in zip(s.recordings, s.rows(), strict=True)])
            for channel in problem.channels
        }
        for s in problem.splits
    ]
    means = {channel: float(np.mean(values)) for channel, values in measured[TRAIN].items()}
    return [{c: (values - means[c]) / problem.noise[c] for c, values in by_channel.items()} for by_channel in measured]


def _errors(evaluator: CandidateEvaluator, series: Series) -> Errors:
    """RMSE, SI, by channel and split."""
    noise = evaluator.problem.noise
    return {
        c: {
            name: float(np.sqrt(np.mean(by_channel[c] ** 2))) * noise[c]
            for name, by_channel in zip(SPLIT_NAMES, series, strict=True)
        }
        for c in series[TRAIN]
    }


def _cuts(evaluator: CandidateEvaluator, before: Series, after: Series) -> dict[str, tuple[float, float]]:
    noise, cuts = evaluator.problem.noise, {}
    for channel in after[HOLDOUT]:
        first, second = (second_half(series[HOLDOUT][channel]) * noise[channel] for series in (before, after))
        cuts[channel] = bootstrap_cut(first, second, evaluator.seed)
    return cuts


def _difference(before: Errors, after: Errors) -> Errors:
    return {c: {name: before[c][name] - error for name, error in by_split.items()} for c, by_split in after.items()}
