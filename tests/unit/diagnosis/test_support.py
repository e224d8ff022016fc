"""Facts and candidates: what a rig is said to have, by what its effects explain on the selection split."""

from types import SimpleNamespace

import numpy as np
import pytest

from smajax.diagnosis.acceptance import RejectionCode
from smajax.diagnosis.candidates import CandidateFit, EffectSet, Refit
from smajax.diagnosis.selection_state import SelectionState
from smajax.diagnosis.support import judge_effects
from smajax.fitting.levenberg_marquardt import SolverStatus

# Reduced chi-squared of the selection split by the accepted effects.
BASE = 101.0
SAMPLES = 4000


def fit_of(keys: tuple[str, ...], chi2: float) -> CandidateFit:
    refit = Refit(EffectSet(keys), np.zeros(1), np.zeros(1), np.zeros((1, 1)), SolverStatus.converged)
    return CandidateFit(refit, chi2, chi2, 0.0)


def evaluator_of(chi2: dict[tuple[str, ...], float]):
    """An evaluator whose fits have given reduced chi-squared, and residuals of random signs."""
    signs = np.random.default_rng(0).standard_normal(SAMPLES)
    signs /= np.sqrt(np.mean(signs**2))
    problem = SimpleNamespace(
        predict=lambda effect_set, base, split: signs * np.sqrt(chi2[effect_set.keys]),
        counted_samples=lambda residual, split: residual,
    )
    return SimpleNamespace(
        seed=0,
        problem=problem,
        stride=lambda train: 1,
        fit=lambda effect_set, base, stride: fit_of(effect_set.keys, chi2[effect_set.keys]).refit,
        evaluate=lambda refit: fit_of(refit.effect_set.keys, chi2[refit.effect_set.keys]),
    )


def judged(chi2: dict[tuple[str, ...], float], accepted: tuple[str, ...]) -> SelectionState:
    chi2 = {(): BASE} | chi2
    state = SelectionState({}, {}, fit_of((), BASE), fit_of(accepted, chi2[accepted]), 1.05, {})
    judge_effects(evaluator_of(chi2), state)  # pyright: ignore[reportArgumentType]
    return state


@pytest.mark.parametrize(("chi2", "is_fact"), [(16.0, True), (50.0, True), (52.0, False), (95.0, False)])
def test_an_effect_is_a_fact_if_it_explains_half_of_the_excess(chi2, is_fact):
    state = judged({("latent-heat",): chi2}, ("latent-heat",))
    (support,) = state.supports
    assert (state.accepted, support.is_fact) == ((("latent-heat",) if is_fact else ()), is_fact)
    assert support.share == pytest.approx((BASE - chi2) / (BASE - 1.0))
    assert support.cut[0] > 0.0
    assert [r.code for r in state.rejected] == [] if is_fact else [RejectionCode.little_explained]


def test_of_two_effects_the_one_that_absorbs_a_part_of_the_rest_is_a_candidate():
    chi2 = {("latent-heat",): 16.0, ("slack",): 90.0, ("latent-heat", "slack"): 12.0}
    state = judged(chi2, ("latent-heat", "slack"))
    assert state.accepted == ("latent-heat",)
    assert [(s.key, s.is_fact) for s in state.supports] == [("latent-heat", True), ("slack", False)]
    assert state.supports[1].share == pytest.approx(4.0 / 15.0)


def test_two_effects_are_facts_if_each_explains_much_of_what_the_other_leaves():
    chi2 = {("latent-heat",): 41.0, ("slack",): 61.0, ("latent-heat", "slack"): 9.0}
    assert judged(chi2, ("latent-heat", "slack")).accepted == ("latent-heat", "slack")


def test_effects_that_explain_little_together_are_candidates_both():
    chi2 = {("creep",): 80.0, ("slack",): 85.0, ("creep", "slack"): 60.0}
    state = judged(chi2, ("creep", "slack"))
    assert state.accepted == () and state.current is state.base_fit
    assert {s.key for s in state.supports} == {"creep", "slack"} and not any(s.is_fact for s in state.supports)


def test_effects_down_to_the_noise_are_facts_although_the_excess_is_small():
    state = SelectionState({}, {}, fit_of((), 1.5), fit_of(("creep",), 1.2), 1.05, {})
    judge_effects(evaluator_of({(): 1.5, ("creep",): 1.2}), state)  # pyright: ignore[reportArgumentType]
    assert state.accepted == ("creep",) and state.supports[0].is_fact


def test_a_second_effect_that_explains_little_of_all_is_a_candidate():
    """It absorbs most of the background that the dominant effect leaves."""
    chi2 = {("latent-heat",): 5.0, ("slack",): 95.0, ("latent-heat", "slack"): 1.9}
    chi2 = {keys: 100.0 * value for keys, value in chi2.items()} | {(): 100.0 * BASE}
    state = SelectionState({}, {}, fit_of((), chi2[()]), fit_of(("latent-heat", "slack"), 190.0), 1.05, {})
    judge_effects(evaluator_of(chi2), state)  # pyright: ignore[reportArgumentType]
    assert state.accepted == ("latent-heat",)


@pytest.mark.parametrize("accepted", [("sensor-lag",), ("sensor-lag", "slack")])
def test_where_the_fit_without_effects_cannot_predict_the_share_is_that_of_the_training_split(accepted):
    chi2 = {(): 81.0, ("sensor-lag",): 41.0, ("slack",): 61.0, ("sensor-lag", "slack"): 9.0}
    base = CandidateFit(fit_of((), 81.0).refit, 81.0, np.nan, 0.0)
    state = SelectionState({}, {}, base, fit_of(accepted, chi2[accepted]), 1.05, {})
    evaluator = evaluator_of(chi2 | {(): np.nan})
    judge_effects(evaluator, state)  # pyright: ignore[reportArgumentType]
    assert state.accepted == accepted
    if len(accepted) == 1:
        (support,) = state.supports
        assert support.share == pytest.approx(0.5) and np.isnan(support.cut).all()


def test_effects_that_explain_the_training_split_are_judged_after_the_joint_refit():
    fit = fit_of(("airflow-change",), 60.0)
    state = SelectionState({}, {}, fit_of((), BASE), CandidateFit(fit.refit, 1.0, 60.0, 0.0), 1.05, {})
    evaluator = evaluator_of({(): BASE, ("airflow-change",): 60.0})
    judge_effects(evaluator, state)  # pyright: ignore[reportArgumentType]
    assert state.accepted == ("airflow-change",)
    judge_effects(evaluator, state, final=True)  # pyright: ignore[reportArgumentType]
    assert state.accepted == () and [s.key for s in state.supports] == ["airflow-change"]
