"""The check of tuned gains on cases that no search has used, searches for cases that fail, and smaller loop gains."""

import dataclasses
import json
import math

import numpy as np
import pytest
from typer.testing import CliRunner

from smajax.app.cli import app
from smajax.control.analysis import case_check
from smajax.control.analysis.case_check import check_cases, excess_of_limits
from smajax.control.analysis.cases import SINGLE_PRECISION, Case, ambient_members, make_cases, rounded
from smajax.control.analysis.closed_loop_checks import evaluate_gains
from smajax.control.analysis.margins import Margins, has_usual_margins
from smajax.control.controller_file.read import read_controller
from smajax.control.loop.gains import gain
from smajax.control.loop.rollout import Scenario, simulate_loop
from smajax.control.tuning import case_retuning
from smajax.control.tuning.margin_backoff import reduce_loop_gain, reduced_points
from smajax.control.tuning.objective import SOFT_OVERSHOOT, TERMS, make_objective
from smajax.control.tuning.problem import TuningProblem, evaluate_points, noise_draws
from smajax.control.tuning.tune import TuningResult, tune
from smajax.errors import InputError
from smajax.files.rig_file import read_rig
from smajax.progress import Progress
from smajax.report.tuning import metric_rows, stage_head, tuning_summary
from smajax.report.tuning_checks import check_words, jump_rows, unsettled_words, usual_margin_words, worse_words
from smajax.report.tuning_metrics import format_entry
from tests.unit.control.test_tuning import FILE, RIG

NOISY = FILE + '[sensor]\nnoise = "5 um"\n'


def task_of(tmp_path, content=NOISY):
    (tmp_path / "c.toml").write_text(content)
    return read_controller(tmp_path / "c.toml", read_rig(RIG))


def own_gains(task):
    return {name: float(gain(task.loop, name)) for name in task.bounds}


def test_cases_have_new_noise_and_vary_plant_start_and_gains(tmp_path):
    task = task_of(tmp_path)
    cases = make_cases(task, {}, True, 0)
    search = np.asarray(noise_draws(task.loop, task.scenario, 8, 0))
    assert not any(np.array_equal(case.noise, row) for case in cases for row in search)
    again, other = make_cases(task, {}, True, 0), make_cases(task, {}, True, 0, 1)
    noise = [k for k, case in enumerate(cases) if case.group == "noise"]
    assert len(noise) >= 59 and all(np.array_equal(cases[k].noise, again[k].noise) for k in noise)
    assert not any(np.array_equal(cases[k].noise, other[k].noise) for k in noise)
    ambient = np.array([case.parameters["environment.ambient"] for case in cases])
    assert ambient.min() == 17.0 and ambient.max() == 23.0 and np.sum(ambient == 20.0) > 59
    assert {case.initial for case in cases if case.group == "start"} == {0.0, 4e-3}
    assert {case.digits for case in cases if case.group == "rounded"} == {5, SINGLE_PRECISION}
    assert rounded(0.123456789, 5) == 0.12346 and rounded(0.1, SINGLE_PRECISION) == float(np.float32(0.1))
    # Without noise there is nothing to draw; drawn parameters replace those of the rig.
    drawn = make_cases(task, {"load.mass": np.array([0.15, 0.25])}, False, 0)
    assert not any(case.group == "noise" for case in drawn) and not any(np.any(case.noise) for case in drawn)
    assert [case.parameters["load.mass"] for case in drawn if case.group == "drawn"] == [0.15, 0.25]
    assert ambient_members(task, 3, {})["environment.ambient"].tolist() == [20.0, 23.0, 17.0]
    assert ambient_members(task, 3, {"environment.ambient": [1.0]}) == {} == ambient_members(task, 1, {})


@pytest.mark.slow
def test_a_check_has_the_worst_value_of_each_metric_and_its_case(tmp_path):
    """Its rollout without noise is that of ``evaluate_gains``; another plant, start or gain is another rollout."""
    task = task_of(tmp_path)
    own, quiet = own_gains(task), np.zeros(len(task.scenario.reference))
    plain = {"environment.ambient": 20.0}
    cases = [
        Case("quiet", "plain", quiet, 0.0, plain),
        Case("ambient", "cold", quiet, 0.0, {"environment.ambient": 15.0}),
        Case("rounded", "coarse", quiet, 0.0, plain, 1),
    ]
    peaks = [v["peak_temperature"] for v in check_cases(task, {**own, "kp": 34.0}, cases).metrics]
    limit = 0.5 * (min(peaks) + max(peaks))
    task = dataclasses.replace(task, limits={"temperature": limit})
    check = check_cases(task, {**own, "kp": 34.0}, cases)
    still = dataclasses.replace(task, scenario=task.scenario.without_noise())
    expected, coarse = (evaluate_gains(still, {**own, "kp": kp}).metrics for kp in (34.0, 30.0))
    for name, value in expected.items():
        assert check.metrics[0][name] == pytest.approx(value, rel=1e-6), name
        assert check.metrics[2][name] == pytest.approx(coarse[name], rel=1e-6), name
    assert check.groups == {"quiet": 1, "ambient": 1, "rounded": 1} and not check.unstable
    energies = [values["energy"] for values in check.metrics]
    assert check.worst("energy") == (max(energies), 1)  # the cold wire needs more
    assert check.worst_response(0, "overshoot").value == max(r[0].overshoot for r in check.responses)
    beyond = tuple(k for k, peak in enumerate(peaks) if peak > limit)
    assert 0 < len(beyond) < 3 and check.beyond == {"temperature": beyond} and check.failing == beyond
    assert excess_of_limits(task.limits, check)["temperature"] == pytest.approx(max(peaks) - limit)


@pytest.mark.slow
def test_a_loop_that_rests_at_the_first_reference_continues_another_rollout(tmp_path):
    """Its first level is reached before the first sample: what follows is the end of a rollout with a longer level."""
    task = task_of(tmp_path)
    count, own = len(task.scenario.reference), own_gains(task)
    quiet, plain = np.zeros(count), {"environment.ambient": 20.0}
    resting = [case for case in make_cases(task, {}, True, 0) if case.rests]
    assert len(resting) == 8 and {case.initial for case in resting} == {4e-3}
    cases = [Case("start", "at rest", quiet, 4e-3, plain, rests=True), Case("quiet", "cold", quiet, 4e-3, plain)]
    check = check_cases(task, own, cases)
    level = np.full(count, task.scenario.reference[0])
    longer = Scenario.noiseless(np.concatenate([level, task.scenario.reference]), 4e-3)
    displacement = np.asarray(simulate_loop(task.system, task.loop, longer).channels["displacement"])
    error = displacement[count:] - np.asarray(task.scenario.reference)
    assert check.metrics[0]["rmse"] == pytest.approx(np.sqrt(np.mean(error**2)), rel=1e-6)
    assert check.metrics[0]["rmse"] < 0.9 * check.metrics[1]["rmse"]


def test_the_last_batch_is_padded(tmp_path, monkeypatch):
    task = task_of(tmp_path)
    cases = make_cases(task, {}, True, 0)[:5]
    whole = check_cases(task, own_gains(task), cases)
    monkeypatch.setattr(case_check, "BATCH", 3)
    parts = check_cases(task, own_gains(task), cases)
    assert len(parts.metrics) == 5
    for a, b in zip(whole.metrics, parts.metrics, strict=True):
        assert a["rmse"] == pytest.approx(b["rmse"], rel=1e-9)


def test_gains_are_tuned_again_for_cases_that_miss_a_limit(tmp_path, monkeypatch):
    """Failing cases are members of the next search, whose limits are tighter; each check has new cases."""
    task = dataclasses.replace(task_of(tmp_path), limits={"overshoot": 0.1})
    problem = TuningProblem.of(task.system, task.loop, task.scenario, task.bounds)
    result = TuningResult(problem.start, {"kp": 30.0, "ki": 10.0}, {}, {}, True, 0.0, 100, ())
    overshoots = {30.0: (0.05, 0.2, 0.12), 31.0: (0.05, 0.11, 0.1), 32.0: (0.09, 0.1, 0.1)}
    quiet = np.zeros(len(task.scenario.reference))
    repeats, searches = [], []

    def cases(repeat):
        repeats.append(repeat)
        return [Case("noise", f"{repeat}, {k}", quiet + 10 * repeat + k, 0.0, {}) for k in range(3)]

    def check_stub(task, gains, cases):
        values = overshoots.get(gains["kp"], (0.2, 0.2, 0.2))
        rows = tuple(k for k, v in enumerate(values) if v > 0.1)
        metrics = tuple({"overshoot": v} for v in values)
        return case_check.CaseCheck(tuple(cases), metrics, ((),) * 3, (), {"overshoot": rows} if rows else {})

    def search_stub(task, problem, result, cases, progress):
        searches.append((task.limits["overshoot"], [case.name for case in cases]))
        return result._replace(gains={"kp": result.gains["kp"] + 1.0, "ki": 10.0}, rollouts=7)

    monkeypatch.setattr(case_retuning, "check_cases", check_stub)
    monkeypatch.setattr(case_retuning, "_search", search_stub)
    judged = case_retuning.judge_gains(task, problem, result, cases, Progress(True))
    assert judged.result.gains["kp"] == 32.0 and judged.rounds == 2 and judged.result.rollouts == 114
    assert not judged.check.failing and repeats == [0, 1, 2]
    # The worst case first, then those of earlier checks; tightened by at most 5 %, then by at most 15 %.
    assert searches[0] == (pytest.approx(0.095), ["0, 1", "0, 2", "0, 0"])
    assert searches[1] == (pytest.approx(0.085), ["1, 1", "0, 1", "0, 2", "1, 0", "1, 2"])
    # Gains with more failing cases are not used, and limits that the search cannot keep are not searched again.
    overshoots[31.0] = (0.2, 0.2, 0.2)
    overshoots[32.0] = overshoots[33.0] = overshoots[31.0]
    judged = case_retuning.judge_gains(task, problem, result, cases, Progress(True))
    assert judged.result.gains["kp"] == 30.0 and judged.rounds == 3 and len(judged.check.failing) == 2
    judged = case_retuning.judge_gains(task, problem, result._replace(feasible=False), cases, Progress(True))
    assert judged.rounds == 0 and len(judged.check.failing) == 2
    # A smaller loop gain is the last resort.
    smaller = float(problem.gains(reduced_points(problem, problem.start, 3)[2])["kp"])
    overshoots[smaller] = (0.09, 0.1, 0.05)
    judged = case_retuning.judge_gains(task, problem, result, cases, Progress(True))
    assert judged.result.gains["kp"] == smaller == pytest.approx(30.0 * 0.9**2) and not judged.check.failing


def test_gains_are_tuned_again_for_unstable_draws(tmp_path, monkeypatch):
    """Unstable cases come before those beyond a limit, and gains that are unstable in fewer cases are used."""
    task = dataclasses.replace(task_of(tmp_path), limits={"overshoot": 0.1})
    draws = {"load.mass": np.linspace(0.15, 0.25, 64)}
    drawn = [case for case in make_cases(task, draws, True, 0) if case.group == "drawn"]
    quiet = [case for case in drawn if not np.any(case.noise)]
    assert len(drawn) == 96 and [c.parameters["load.mass"] for c in quiet] == draws["load.mass"][:32].tolist()
    problem = TuningProblem.of(task.system, task.loop, task.scenario, task.bounds)
    result = TuningResult(problem.start, {"kp": 30.0, "ki": 10.0}, {}, {}, True, 0.0, 100, ())
    unstable, members = {30.0: (2, 3), 31.0: (3,), 32.0: ()}, []

    def check_stub(task, gains, cases):
        beyond = {"overshoot": (1,)} if gains["kp"] == 30.0 else {}
        metrics = ({"overshoot": 0.05}, {"overshoot": 0.2}, {"overshoot": 0.02}, {"overshoot": 0.03})
        return case_check.CaseCheck(tuple(cases), metrics, ((),) * 4, unstable[gains["kp"]], beyond)

    def search_stub(task, problem, result, cases, progress):
        members.append([case.name for case in cases])
        return result._replace(gains={"kp": result.gains["kp"] + 1.0, "ki": 10.0}, rollouts=7)

    monkeypatch.setattr(case_retuning, "check_cases", check_stub)
    monkeypatch.setattr(case_retuning, "_search", search_stub)
    cases = [Case("drawn", f"draw {k}", np.ones(3) * (k < 2), 0.0, {}) for k in range(4)]
    judged = case_retuning.judge_gains(task, problem, result, lambda _: cases, Progress(True))
    assert judged.result.gains["kp"] == 32.0 and judged.rounds == 2 and not judged.check.failing
    assert members[0] == ["draw 3", "draw 2", "draw 1", "draw 0"] and members[1][0] == "draw 3"


def test_an_alternative_that_fails_in_no_case_replaces_the_gains(tmp_path, monkeypatch):
    """Also not in new cases, on which it was not chosen; no search is then repeated."""
    task = dataclasses.replace(task_of(tmp_path), limits={"overshoot": 0.1})
    problem = TuningProblem.of(task.system, task.loop, task.scenario, task.bounds)
    points = [np.full(len(problem.names), share) for share in (0.5, 0.6, 0.7, 0.8)]
    kps = [float(problem.gains(point)["kp"]) for point in points]
    # Overshoots on the first cases, on which alternatives are chosen, and on new ones.
    overshoots = {kps[0]: (0.2, 0.2), kps[1]: (0.12, 0.05), kps[2]: (0.05, 0.12), kps[3]: (0.05, 0.06)}

    def check_stub(task, gains, cases):
        value = overshoots[gains["kp"]][min(cases[0].digits, 1)]
        beyond = {"overshoot": (0,)} if value > 0.1 else {}
        return case_check.CaseCheck(tuple(cases), ({"overshoot": value},), ((),), (), beyond)

    def cases(repeat):
        return [Case("noise", "a", np.zeros(3), 0.0, {}, repeat)]

    monkeypatch.setattr(case_retuning, "check_cases", check_stub)
    own = {"kp": kps[0], "ki": 10.0}
    result = TuningResult(points[0], own, {}, {}, True, 0.0, 100, (), alternatives=tuple(points[1:]))
    judged = case_retuning.judge_gains(task, problem, result, cases, Progress(True))
    assert judged.result.gains["kp"] == kps[3] and judged.rounds == 0 and not judged.check.failing
    assert judged.check.cases[0].digits == 2  # the third check


@pytest.mark.slow
def test_alternatives_cost_more_and_keep_the_limits(tmp_path):
    task = task_of(tmp_path)
    problem = TuningProblem.of(task.system, task.loop, task.scenario, task.bounds)
    limits = {"overshoot": 0.1}
    result = tune(problem, {"tracking": 1.0}, limits)
    terms, violations = map(
        np.asarray,
        evaluate_points(
            problem, np.stack([result.point, *result.alternatives]), make_objective({"tracking": 1.0}, limits)
        ),
    )
    assert 3 <= len(result.alternatives) <= 16 and np.max(violations) <= 1e-3
    assert np.all(terms[1:, 0] > 1.029 * terms[:-1, 0])
    assert not tune(problem, {"tracking": 1.0}, {}).alternatives


@pytest.mark.slow
def test_a_limit_that_cases_miss_ends_with_the_numbers_and_exit_code_3(tmp_path, monkeypatch):
    """The limit lies between the overshoot of the file's own rollout and that of the worst case."""
    levels = NOISY.replace('levels = ["4 mm", "2 mm"]', 'levels = ["3 mm", "5 mm"]')
    task = task_of(tmp_path, levels)
    gains = {"kp": 60.0, "ki": 45.0}
    own = evaluate_gains(task, gains).metrics["overshoot"]
    limit = 0.5 * (own + check_cases(task, gains, make_cases(task, {}, True, 0)).worst("overshoot").value)
    fixed = TuningResult(np.full(2, 0.5), gains, {}, {}, True, 0.0, 1, ())
    monkeypatch.setattr("smajax.control.tuning.retuning.tune", lambda *_, **__: fixed)
    monkeypatch.setattr(case_retuning, "_search", lambda *_: fixed)
    monkeypatch.setattr(case_retuning, "_REDUCTIONS", 0)
    monkeypatch.setattr("smajax.control.tuning.tuning_study.reduce_loop_gain", lambda task, problem, *found: found)
    content = levels + f'[limits]\novershoot = "{100 * limit:.6f} %"\n'
    (tmp_path / "one.toml").write_text(content.replace("[tune]\n", "[tune]\ncheck = 1\n"))
    (tmp_path / "all.toml").write_text(content)
    documents = {}
    for name, code in (("one", 0), ("all", 3)):
        done = CliRunner().invoke(
            app, ["tune", str(RIG), str(tmp_path / f"{name}.toml"), "--out", str(tmp_path / name)]
        )
        assert done.exit_code == code, done.output
        documents[name] = json.loads((tmp_path / name / "tune.json").read_text())
        assert (tmp_path / name / "controller.h").is_file()
    assert "case_check" not in documents["one"] and documents["one"]["metrics"]["tuned"]["overshoot"] < limit
    entry = documents["all"]["case_check"]
    missed, worst = entry["beyond"]["overshoot"], entry["worst"]["overshoot"]
    assert 0 < missed < entry["cases"] and entry["failing"] >= missed and worst["value"] > limit
    assert entry["retunings"] == 3
    sentence = (
        f"the limit on overshoot is not met: it is {100 * limit:.2f} %, and the best gains exceed it in {missed} of "
        f"{entry['cases']} cases, with {100 * worst['value']:.2f} % at worst ({worst['case']})"
    )
    assert sentence in documents["all"]["problems"] and not documents["all"]["feasible"]
    jumps = documents["all"]["jumps"]
    assert [(j["number"], j["time"], j["before"], round(j["after"], 9)) for j in jumps] == [
        (1, 0.0, 0.0, 3e-3),
        (2, 8.0, pytest.approx(3e-3), 5e-3),
    ]
    assert max(j["worst"]["overshoot"] for j in jumps) == pytest.approx(worst["value"])


@pytest.mark.parametrize(("check", "refused"), [(1, False), (2, True), (58, True), (59, False)])
def test_too_few_draws_of_the_noise_are_refused(tmp_path, check, refused):
    content = NOISY.replace("[tune]\n", f"[tune]\ncheck = {check}\n")
    if refused:
        with pytest.raises(InputError, match=f"tune.check = {check} is too small to judge 95 % of all draws"):
            task_of(tmp_path, content)
    else:
        task = task_of(tmp_path, content)
        assert task.check == check
        assert sum(c.group == "noise" for c in make_cases(task, {}, True, 0, 0, check)) == check
    assert 0.95**59 < 0.05 < 0.95**58


@pytest.mark.slow
def test_the_default_objective_bounds_the_overshoot(tmp_path):
    """A word brings the overshoot's term unless the overshoot is limited; weights are used as they are."""
    overshoot = "overshoot"
    assert task_of(tmp_path).weights == {"tracking": 1.0, "effort": 0.01, overshoot: 1.0}
    limited = task_of(tmp_path, NOISY + '[limits]\novershoot = "5 %"\n')
    assert limited.weights == {"tracking": 1.0, "effort": 0.01} and limited.prefers_margins
    explicit = task_of(tmp_path, NOISY.replace("[tune]\n", "[tune]\nobjective = { tracking = 1 }\n"))
    assert explicit.weights == {"tracking": 1.0} and not explicit.prefers_margins
    # The term: the mean over the samples of the squared excess over the soft bound, in settling bands.
    task = task_of(tmp_path)
    problem = TuningProblem.of(task.system, task.loop, task.scenario, {"kp": (1.0, 500.0), "ki": (1.0, 500.0)})
    values = {"kp": 85.0, "ki": 160.0}
    point = np.log(np.array(list(values.values()))) / math.log(500.0)
    terms, _ = evaluate_points(problem, point[None], make_objective({}, {}))
    channel = np.asarray(problem.simulate(problem.gains(point)).channels["displacement"])[0]
    reference = np.asarray(task.scenario.reference)
    share = (channel - reference) / np.where(np.arange(len(reference)) < 160, 4e-3, -2e-3)
    expected = float(np.mean(np.maximum(share - SOFT_OVERSHOOT, 0.0) ** 2)) / 0.02**2
    assert float(terms[0, TERMS.index("overshoot")]) == pytest.approx(expected, rel=1e-9) and expected > 0.0


@pytest.mark.slow
def test_the_loop_gain_is_reduced_to_the_usual_margins(tmp_path):
    """Where a smaller gain has the usual margins at little cost; not where the objective grows by more than a tenth."""
    task = task_of(tmp_path)
    bounds = {"kp": (1.0, 500.0), "ki": (1.0, 500.0)}
    problem = TuningProblem.of(task.system, task.loop, task.scenario, bounds)
    values = {"kp": 80.0, "ki": 50.0}
    point = np.log(np.array(list(values.values()))) / math.log(500.0)
    result = TuningResult(point, values, {}, {}, True, 0.0, 10, ())
    before = evaluate_gains(task, values)
    assert not has_usual_margins(before.margins)
    # The effort alone falls with the gains, so that nothing holds them.
    free = dataclasses.replace(task, weights={"effort": 1.0})
    reduced, after = reduce_loop_gain(free, problem, result, before)
    assert has_usual_margins(after.margins) and reduced.rollouts > 10
    share = reduced.gains["kp"] / 80.0
    assert 0.4 < share < 1.0 and reduced.gains["ki"] / 50.0 == pytest.approx(share)
    assert math.log(share) / math.log(0.9) == pytest.approx(round(math.log(share) / math.log(0.9)))
    costly = dataclasses.replace(task, weights={"itae": 1.0})
    kept, same = reduce_loop_gain(costly, problem, result, before)
    assert kept.gains == values and same is before
    infeasible = result._replace(feasible=False)
    assert reduce_loop_gain(free, problem, infeasible, before)[0] is infeasible
    assert (
        before.low_margins.gain <= before.margins.gain and before.low_margins.sensitivity >= before.margins.sensitivity
    )
    assert has_usual_margins(Margins(2.0, 45.0, 1.8)) and not has_usual_margins(Margins(math.inf, 44.9, 1.0))


def test_the_summary_states_the_worst_case_each_jump_and_what_is_worse():
    response = {"rise": 1.0, "settling": 2.0, "overshoot": 0.01}
    margins = {"gain": 1.6, "phase": 50.0, "sensitivity": 1.9}
    doc = {
        "channel": "displacement",
        "objective": {"settle": False},
        "limits": {"overshoot": 0.05},
        "problems": [],
        "robust": {},
        "rollouts": 10,
        "margins": {"start": margins, "tuned": margins},
        "low_margins": {"start": margins, "tuned": margins},
        "metrics": {
            "start": {"rmse": 2e-3, "overshoot": 0.01, "settling": 2.0, "energy": 8.0},
            "tuned": {"rmse": 1e-3, "overshoot": 0.04, "settling": None, "energy": 8.1},
        },
        "jumps": [
            {
                "number": 2,
                "time": 4.0,
                "before": 3e-3,
                "after": 5e-3,
                "start": response,
                "tuned": {**response, "settling": None},
                "worst": {**response, "overshoot": 0.04, "settling": None},
            }
        ],
        "case_check": {
            "cases": 130,
            "groups": {"noise": 64, "quiet": 1},
            "failing": 0,
            "unstable": 0,
            "beyond": {},
            "worst": {
                "overshoot": {"value": 0.045, "case": "noise draw 7"},
                "settling": {"value": None, "case": "no noise"},
            },
            "start": {},
            "retunings": 1,
        },
    }
    assert format_entry(doc, 0.25, "mean_command") == "0.25"  # of an earlier version
    assert format_entry(doc | {"command_unit": "A"}, 0.25, "mean_command") == "0.25 A"
    assert check_words(doc) == (
        " Judged on 130 rollouts that no search used (64 for noise, 1 for no noise), all of which keep the limits: "
        "overshoot at worst 4.50 % (noise draw 7); a jump does not settle within 2 % of the jump (no noise). "
        "The gains were tuned again once for cases that missed a limit."
    )
    assert unsettled_words(doc) == (
        " With the tuned gains not settled within 2 % of the jump at the end of its hold: jump 2, 3 to 5 mm at 4 s."
    )
    assert worse_words(doc) == (
        " Worse than with the start gains: settling (not finite), overshoot 4.00 % instead of 1.00 %."
    )
    assert usual_margin_words(doc) == (
        " The median margins are not the usual ones: gain margin 1.6 instead of >= 2, largest sensitivity 1.9 instead "
        "of <= 1.8."
    )
    summary = tuning_summary(doc)
    assert all(words(doc) in summary for words in (check_words, unsettled_words, worse_words, usual_margin_words))
    assert jump_rows(doc)[0] == ("jump 2, 3 to 5 mm at 4 s", "rise 10 to 90 %", "1 s", "1 s", "1 s")
    assert jump_rows(doc)[2][2:] == ("1.00 %, 0.02 mm", "1.00 %, 0.02 mm", "4.00 %, 0.08 mm")
    assert stage_head(doc)[-1] == "worst of 130" and {len(row) for row in metric_rows(doc)} == {4}
