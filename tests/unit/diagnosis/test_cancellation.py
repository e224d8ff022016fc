"""A progress callback that stops a diagnosis."""

import math
from types import SimpleNamespace

import numpy as np
import pytest

from smajax.diagnosis import forward_selection, outcome
from smajax.diagnosis.candidates import CandidateFit, EffectSet, Refit
from smajax.diagnosis.forward_selection import select_effects
from smajax.diagnosis.other_laws import LawComparison
from smajax.diagnosis.outcome import diagnose
from smajax.diagnosis.selection_state import SelectionState, Support
from smajax.diagnosis.structure import UNIFORM
from smajax.errors import Cancelled
from smajax.fitting.levenberg_marquardt import SolverStatus
from tests.support import plants


def fit_of(*keys: str) -> CandidateFit:
    refit = Refit(EffectSet(keys), np.zeros(1), np.zeros(1), np.zeros((1, 1)), SolverStatus.converged)
    return CandidateFit(refit, 9.0, 9.0, 0.0)


def stop_at(word: str, error: type[BaseException]):
    """A callback that raises an error at the text with a word."""

    def report(text: str) -> None:
        if word in text:
            raise error

    return report


@pytest.fixture
def rounds(monkeypatch):
    """A selection without simulations that accepts an effect in each round."""
    evaluator = SimpleNamespace(problem=SimpleNamespace(samples=100))
    state = SelectionState({}, {}, fit_of(), fit_of(), 1.05, {})

    def run_round(evaluator, state, beam, round_index, min_gain, report_progress):
        report_progress(f"round {round_index + 1}")
        state.current = fit_of(*("creep", "backlash", "slack")[: round_index + 1])
        return [state.current]

    monkeypatch.setattr(forward_selection, "_start_selection", lambda *_: (evaluator, state))
    monkeypatch.setattr(forward_selection, "_run_round", run_round)
    monkeypatch.setattr(forward_selection, "drop_unneeded_effects", lambda *_: None)
    monkeypatch.setattr(forward_selection, "swap_confusable_effects", lambda *_: None)
    monkeypatch.setattr(forward_selection, "refine_onsets", lambda evaluator, fit: fit)
    return state


@pytest.mark.parametrize("error", [StopIteration, KeyboardInterrupt])
def test_selection_ends_with_the_effects_so_far(rounds, error):
    _, state = select_effects(SimpleNamespace(), report_progress=stop_at("round 2", error))  # pyright: ignore[reportArgumentType]
    assert state.accepted == ("creep",) and state.interrupted


@pytest.mark.parametrize("error", [StopIteration, KeyboardInterrupt])
def test_diagnosis_without_an_effect_is_cancelled(rounds, error):
    with pytest.raises(Cancelled, match="before the first effect"):
        select_effects(SimpleNamespace(), report_progress=stop_at("round 1", error))  # pyright: ignore[reportArgumentType]


@pytest.mark.parametrize("error", [StopIteration, KeyboardInterrupt])
def test_diagnosis_before_its_base_fit_is_cancelled(error):
    with pytest.raises(Cancelled, match="before the first effect"):
        diagnose(SimpleNamespace(), report_progress=stop_at("preflight", error))  # pyright: ignore[reportArgumentType]


def test_stop_iteration_of_other_code_is_a_fault(rounds, monkeypatch):
    monkeypatch.setattr(forward_selection, "_run_round", lambda *_: next(iter(())))
    with pytest.raises(StopIteration):
        select_effects(SimpleNamespace())  # pyright: ignore[reportArgumentType]


PROBLEM = SimpleNamespace(samples=100, own_count=0, base_problem=SimpleNamespace(plant=plants.dead_weight()))


def compared(cause) -> LawComparison:
    """A comparison of Brinson's law with that of Tanaka."""
    better, cut = (None, (math.nan, math.nan)) if cause == "none" else ("tanaka", (1.0, 2.0))
    return LawComparison("brinson", {"brinson": 9.0, "tanaka": 1.0}, 4.0, better, cut, cause, None, {})


@pytest.fixture
def selected(rounds, monkeypatch):
    """A diagnosis without simulations that accepts an effect and explains a part only; summaries are (fit, conclusion)."""
    rounds.current = fit_of("creep")
    evaluator = SimpleNamespace(problem=PROBLEM, seed=0)
    monkeypatch.setattr(outcome, "select_effects", lambda *_, **__: (evaluator, rounds))
    monkeypatch.setattr(
        outcome, "select_with_structure", lambda evaluator, state, *_, **__: (evaluator, state, UNIFORM)
    )
    monkeypatch.setattr(outcome, "judge_effects", lambda *_, **__: None)
    monkeypatch.setattr(outcome.OtherLaws, "compare", lambda *_: compared("none"))
    monkeypatch.setattr(outcome, "_joint_refit", lambda problem, refit: refit)
    monkeypatch.setattr(outcome, "_last_refit", lambda problem, state, *_: state.current.refit)
    monkeypatch.setattr(outcome, "error_budget", lambda *_: ())
    monkeypatch.setattr(outcome, "absent_effects", lambda *_: ())
    monkeypatch.setattr(outcome, "_verdict", lambda *_: "partial")
    monkeypatch.setattr(outcome, "improves_holdout", lambda *_: True)
    monkeypatch.setattr(outcome, "_locate_residual", lambda *_: ("heat", None))
    monkeypatch.setattr(outcome, "_rivals", lambda *_: {})
    monkeypatch.setattr(outcome, "propose_experiment", lambda *_: None)
    monkeypatch.setattr(outcome, "summarise", lambda *arguments, without: arguments[3:])
    return rounds


@pytest.mark.parametrize(
    ("word", "calls"),
    [("nothing", ["stage", "experiment"]), ("stage", []), ("designing", ["stage"]), ("holdout", [])],
)
def test_end_of_a_diagnosis_is_left_out(selected, monkeypatch, word, calls):
    """The effects are selected; the stage of the residual and the next experiment are not searched for any more."""
    called: list[str] = []
    monkeypatch.setattr(outcome, "_locate_residual", lambda *_: called.append("stage") or ("heat", None))
    monkeypatch.setattr(outcome, "propose_experiment", lambda *_: called.append("experiment"))
    _, conclusion = diagnose(PROBLEM, report_progress=stop_at(word, StopIteration))  # pyright: ignore[reportArgumentType, reportGeneralTypeIssues]
    assert called == calls and selected.interrupted == (word != "nothing")
    assert conclusion.verdict == "partial" and conclusion.unresolved_stage == ("heat" if "stage" in calls else None)


@pytest.mark.parametrize(("search", "stage"), [("_locate_residual", None), ("propose_experiment", "heat")])
def test_ctrl_c_after_the_selection_keeps_the_effects(selected, monkeypatch, search, stage):
    def interrupt(*_):
        raise KeyboardInterrupt

    monkeypatch.setattr(outcome, search, interrupt)
    refit, conclusion = diagnose(PROBLEM)  # pyright: ignore[reportArgumentType, reportGeneralTypeIssues]
    assert refit.effect_set.keys == ("creep",) and selected.interrupted
    assert conclusion.unresolved_stage == stage and conclusion.next_experiment is None


@pytest.mark.parametrize(
    ("verdict", "improves", "decided", "after"),
    [("named", False, False, ("creep",)), ("partial", True, True, ("creep",)), ("partial", False, True, ())],
)
def test_part_of_the_holdout_in_the_choice_is_recorded(selected, monkeypatch, verdict, improves, decided, after):
    monkeypatch.setattr(outcome, "_verdict", lambda *_: verdict)
    monkeypatch.setattr(outcome, "improves_holdout", lambda *_: improves)
    refit, conclusion = diagnose(PROBLEM)  # pyright: ignore[reportArgumentType, reportGeneralTypeIssues]
    assert refit.effect_set.keys == after and conclusion.holdout_decided == decided
    assert [(r.key, r.code) for r in selected.rejected] == ([] if after else [("creep", "holdout")])


def test_an_effect_of_strength_zero_in_the_last_fit_is_rejected(selected, monkeypatch):
    """Fitted to both recordings its strength is 0: the diagnosis goes on without it."""
    monkeypatch.setattr(outcome, "absent_effects", lambda _, refit: refit.effect_set.keys)
    evaluator = SimpleNamespace(problem=PROBLEM, seed=0, stride=lambda chi2: 1)
    monkeypatch.setattr(outcome, "select_effects", lambda *_, **__: (evaluator, selected))
    refit, _ = diagnose(PROBLEM)  # pyright: ignore[reportArgumentType, reportGeneralTypeIssues]
    assert refit.effect_set.keys == () and selected.current is selected.base_fit
    assert [(r.key, r.code) for r in selected.rejected] == [("creep", "zero")]


@pytest.mark.parametrize("cause", ["none", "either", "part", "effect", "law"])
def test_a_law_that_explains_more_replaces_the_effects(selected, monkeypatch, cause):
    """They become candidates, and no stage and no experiment are searched for."""
    selected.supports = (Support("creep", 0.6, (0.1, 0.2), True),)
    monkeypatch.setattr(outcome.OtherLaws, "compare", lambda *_: compared(cause))
    summaries = []
    monkeypatch.setattr(outcome, "summarise", lambda *arguments, without: summaries.append(arguments))
    diagnose(PROBLEM)  # pyright: ignore[reportArgumentType]
    _, state, _, _, conclusion = summaries[0]
    assert conclusion.law.cause == cause
    if cause == "law":
        assert state.accepted == () and conclusion.verdict == "unresolved" and conclusion.unresolved_stage == "material"
        assert [(r.key, r.code, r.others) for r in state.rejected] == [("creep", "law", ("tanaka",))]
        assert [s.is_fact for s in state.supports] == [False]
    else:
        assert state.accepted == ("creep",) and conclusion.verdict == "partial"


def test_ctrl_c_while_laws_are_fitted_keeps_the_effects(selected, monkeypatch):
    def interrupt(*_):
        raise KeyboardInterrupt

    monkeypatch.setattr(outcome.OtherLaws, "compare", interrupt)
    refit, conclusion = diagnose(PROBLEM)  # pyright: ignore[reportArgumentType, reportGeneralTypeIssues]
    assert refit.effect_set.keys == ("creep",) and selected.interrupted and conclusion.law is None
