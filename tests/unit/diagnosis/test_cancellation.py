"""A progress callback that stops a diagnosis."""

from types import SimpleNamespace

import numpy as np
import pytest

from smajax.diagnosis import forward_selection, outcome
from smajax.diagnosis.candidates import CandidateFit, EffectSet, Refit
from smajax.diagnosis.forward_selection import select_effects
from smajax.diagnosis.outcome import diagnose
from smajax.diagnosis.selection_state import SelectionState
from smajax.diagnosis.structure import UNIFORM
from smajax.errors import Cancelled
from smajax.fitting.levenberg_marquardt import SolverStatus


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


@pytest.fixture
def selected(rounds, monkeypatch):
    """A diagnosis without simulations that accepts an effect and explains a part only; summaries are (fit, conclusion)."""
    rounds.current = fit_of("creep")
    evaluator = SimpleNamespace(problem=SimpleNamespace(samples=100))
    monkeypatch.setattr(outcome, "select_effects", lambda *_, **__: (evaluator, rounds))
    monkeypatch.setattr(outcome, "select_with_structure", lambda evaluator, state, *_: (evaluator, state, UNIFORM))
    monkeypatch.setattr(outcome, "judge_effects", lambda *_, **__: None)
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
    _, conclusion = diagnose(SimpleNamespace(), report_progress=stop_at(word, StopIteration))  # pyright: ignore[reportArgumentType, reportGeneralTypeIssues]
    assert called == calls and selected.interrupted == (word != "nothing")
    assert conclusion.verdict == "partial" and conclusion.unresolved_stage == ("heat" if "stage" in calls else None)


@pytest.mark.parametrize(("search", "stage"), [("_locate_residual", None), ("propose_experiment", "heat")])
def test_ctrl_c_after_the_selection_keeps_the_effects(selected, monkeypatch, search, stage):
    def interrupt(*_):
        raise KeyboardInterrupt

    monkeypatch.setattr(outcome, search, interrupt)
    refit, conclusion = diagnose(SimpleNamespace())  # pyright: ignore[reportArgumentType, reportGeneralTypeIssues]
    assert refit.effect_set.keys == ("creep",) and selected.interrupted
    assert conclusion.unresolved_stage == stage and conclusion.next_experiment is None


@pytest.mark.parametrize(
    ("verdict", "improves", "decided", "after"),
    [("named", False, False, ("creep",)), ("partial", True, True, ("creep",)), ("partial", False, True, ())],
)
def test_part_of_the_holdout_in_the_choice_is_recorded(selected, monkeypatch, verdict, improves, decided, after):
    monkeypatch.setattr(outcome, "_verdict", lambda *_: verdict)
    monkeypatch.setattr(outcome, "improves_holdout", lambda *_: improves)
    refit, conclusion = diagnose(SimpleNamespace())  # pyright: ignore[reportArgumentType, reportGeneralTypeIssues]
    assert refit.effect_set.keys == after and conclusion.holdout_decided == decided
    assert [(r.key, r.code) for r in selected.rejected] == ([] if after else [("creep", "holdout")])


def test_an_effect_of_strength_zero_in_the_last_fit_is_rejected(selected, monkeypatch):
    """Fitted to both recordings its strength is 0: the diagnosis goes on without it."""
    monkeypatch.setattr(outcome, "absent_effects", lambda _, refit: refit.effect_set.keys)
    evaluator = SimpleNamespace(problem=None, stride=lambda chi2: 1)
    monkeypatch.setattr(outcome, "select_effects", lambda *_, **__: (evaluator, selected))
    refit, _ = diagnose(SimpleNamespace())  # pyright: ignore[reportArgumentType, reportGeneralTypeIssues]
    assert refit.effect_set.keys == () and selected.current is selected.base_fit
    assert [(r.key, r.code) for r in selected.rejected] == [("creep", "zero")]
