"""Solvers of fits: the bounded Levenberg-Marquardt under optimistix, and optimistix's solvers within bounds."""

import jax
import jax.numpy as jnp
import numpy as np
import optimistix as optx
import pytest
import scipy.optimize

import smajax as sma
from smajax.errors import InputError
from smajax.fitting import optimistix_search
from smajax.fitting.bound_transformation import BoundTransformation
from smajax.fitting.fit import check_solver, fit
from smajax.fitting.levenberg_marquardt import BoundedLevenbergMarquardt, SolverStatus
from smajax.fitting.multi_start import MultiStartSolver
from smajax.fitting.optimistix_search import OptimistixSearch
from smajax.recordings.datasets import data_path
from tests.support import plants
from tests.unit.fitting.test_fit import TRUTH, Settings, recorded

SOLVERS = [
    optx.LevenbergMarquardt(rtol=1e-10, atol=1e-10),
    optx.GaussNewton(rtol=1e-10, atol=1e-10),
    optx.Dogleg(rtol=1e-10, atol=1e-10),
    optx.BFGS(rtol=1e-10, atol=1e-10),
]
NAMES = [type(solver).__name__ for solver in SOLVERS]


def rosenbrock(y, args):
    return jnp.stack([args * (y[1] - y[0] ** 2), 1.0 - y[0]])


@pytest.mark.slow
@pytest.mark.parametrize("options", [{}, {"lazy_jacobian": True}, {"lazy_jacobian": True, "secant_updates": True}])
@pytest.mark.parametrize(
    ("lower", "upper", "expected"),
    [
        (-jnp.inf, jnp.inf, (1.0, 1.0)),
        (-2.0, jnp.array([0.5, 9.0]), (0.5, 0.25)),
        (jnp.array([1.3, 0.0]), 1.5, None),
        (jnp.array([0.7, 0.2]), jnp.array([0.7, 3.0]), (0.7, 0.49)),
    ],
    ids=["unbounded", "upper", "both", "fixed"],
)
def test_bounded_levenberg_marquardt_runs_under_optimistix(lower, upper, expected, options):
    solver = BoundedLevenbergMarquardt(1e-12, lower, upper, **options)
    solution = optx.least_squares(rosenbrock, solver, jnp.array([-1.2, 1.0]), 10.0)
    low, high = (np.broadcast_to(bound, 2) for bound in (lower, upper))
    if expected is None:
        free = scipy.optimize.least_squares(
            lambda y: rosenbrock(jnp.asarray(y), 10.0), np.clip([-1.2, 1.0], low, high), bounds=(low, high), xtol=1e-14
        )
        expected = free.x
    np.testing.assert_allclose(solution.value, expected, atol=1e-6)
    assert solution.result == optx.RESULTS.successful


def test_updates_of_the_jacobian_replace_most_of_its_evaluations():
    """Coupled valleys: the minimum is the same, with an exact Jacobian there, after fewer evaluations."""

    def residual(y, _):
        return jnp.concatenate([3.0 * (y[1:] - y[:-1] ** 2), 1.0 - y, jnp.sin(y)])

    def search(secant_updates, steps=400):
        start, ends = np.linspace(-1.5, 1.5, 20)[None], (np.full(20, -5.0), np.full(20, 5.0))
        options = {"size": 59, "rtol": 1e-12, "lazy_jacobian": True, "secant_updates": secant_updates}
        return MultiStartSolver(residual, None, start, *ends, **options).advance(steps).result()

    computed, updated = search(False), search(True)
    assert computed.statuses == updated.statuses == [SolverStatus.converged]
    assert updated.costs[0] == pytest.approx(computed.costs[0], rel=1e-9)
    # Also where the steps ran out: intervals need the exact Jacobian.
    for result in (updated, *(search(True, steps) for steps in range(2, 12))):
        assert result.updates[0] == 0
        jacobian = jax.jacfwd(residual)(jnp.asarray(result.points[0]), None)
        np.testing.assert_allclose(result.jacobians[0], jacobian, rtol=1e-12)
    assert updated.simulations < 0.7 * computed.simulations


def test_bounded_levenberg_marquardt_takes_pytrees_and_auxiliary_outputs():
    def residual(y, scale):
        output = {"valley": scale * (y["b"] - y["a"] ** 2), "slope": 1.0 - y["a"]}
        return output, {"sum": jnp.sum(y["a"]) + y["b"]}

    solver = BoundedLevenbergMarquardt(1e-12, upper={"a": jnp.array([0.5]), "b": 2.0})
    start = {"a": jnp.array([-1.2]), "b": jnp.asarray(1.0)}
    solution = optx.least_squares(residual, solver, start, 10.0, has_aux=True)
    np.testing.assert_allclose(solution.value["a"], [0.5], atol=1e-9)
    np.testing.assert_allclose(solution.aux["sum"], 0.75, atol=1e-7)


def test_bounded_levenberg_marquardt_reports_that_its_start_fails():
    solver = BoundedLevenbergMarquardt(1e-9)
    solution = optx.least_squares(lambda y, _: jnp.log(y), solver, jnp.array([-1.0]), throw=False)
    assert solution.result == optx.RESULTS.nonlinear_divergence


def test_a_solution_has_derivatives_in_the_arguments():
    def minimum(scale):
        solution = optx.least_squares(lambda y, a: y**2 - a, BoundedLevenbergMarquardt(1e-14, 0.0), jnp.ones(1), scale)
        return solution.value[0]

    assert float(jax.grad(minimum)(4.0)) == pytest.approx(0.25, rel=1e-5)


def test_transformation_keeps_to_the_bounds_and_begins_with_slope_1():
    inf = np.inf
    lower, upper = np.array([0.0, -1.0, -inf, -inf, 2.0]), np.array([1.0, inf, 3.0, inf, 2.0])
    start = np.array([0.25, 4.0, -2.0, 7.0, 2.0])
    transformation = BoundTransformation(start, lower, upper)
    np.testing.assert_allclose(transformation(jnp.asarray(start)), start, rtol=1e-12)
    np.testing.assert_allclose(jax.jacfwd(transformation)(jnp.asarray(start)), np.diag([1.0, 1, 1, 1, 0]), atol=1e-12)
    for change in (-1e3, -1.0, 1.0, 1e3):
        values = np.asarray(transformation(jnp.asarray(start + change)))
        assert np.all((lower <= values) & (values <= upper))
    at_bounds = BoundTransformation(np.array([0.0, -1.0, 3.0, 0.0, 2.0]), lower, upper)
    assert np.all(np.diag(jax.jacfwd(at_bounds)(jnp.asarray(at_bounds.start)))[:4] > 0.9)


@pytest.mark.parametrize("solver", SOLVERS, ids=NAMES)
def test_optimistix_solvers_search_within_bounds(solver):
    starts = np.array([[0.8, 0.9], [1.3, 1.5]])
    lower, upper = np.array([0.1, -np.inf]), np.array([2.6, 4.0])
    result = OptimistixSearch(solver, rosenbrock, 10.0, starts, lower, upper, size=2).advance(200).result()
    np.testing.assert_allclose(result.points, 1.0, atol=1e-6)
    assert result.statuses == [SolverStatus.converged] * 2


def test_a_search_that_ends_above_its_best_point_has_not_converged():
    """Gauss-Newton steps from here so near to a bound that no derivative is left: its best point is the start."""
    lower, upper = np.array([0.1, -np.inf]), np.array([2.6, 4.0])
    search = OptimistixSearch(SOLVERS[1], rosenbrock, 10.0, np.array([[0.2, 1.0]]), lower, upper, size=2)
    result = search.advance(200).result()
    assert result.statuses == [SolverStatus.diverged] and result.steps < 200
    np.testing.assert_allclose(result.points, [[0.2, 1.0]], rtol=1e-12)
    assert result.costs[0] == pytest.approx(float(np.sum(rosenbrock(jnp.array([0.2, 1.0]), 10.0) ** 2)), rel=1e-12)


@pytest.mark.parametrize(
    ("last", "status"), [(2.0, "diverged"), (np.nan, "diverged"), (1.001, "stalled"), (1.0 + 1e-12, "converged")]
)
def test_a_solver_that_ends_above_the_best_cost_has_not_converged(monkeypatch, last, status):
    """Without an error of the solver, and up to rounding."""
    steps = iter([(0.5, False, 1.0), (0.7, True, last)])

    def step(solver, fn, point, search, state):
        value, done, cost = next(steps)
        return point, state, done, False, jnp.full(2, value), cost

    monkeypatch.setattr(optimistix_search, "_step", step)
    inf = np.full(2, np.inf)
    search = OptimistixSearch(SOLVERS[0], lambda y, args: y - 0.5, 10.0, np.zeros((1, 2)), -inf, inf, size=2)
    result = search.advance(9).result()
    assert result.statuses == [SolverStatus[status]] and result.steps == 2
    assert search.simulations == 2 * (2 + 2) and result.points.tolist() == [[0.5, 0.5]] and result.costs == [1.0]


@pytest.mark.parametrize("solver", [SOLVERS[0], SOLVERS[3]], ids=[NAMES[0], NAMES[3]])
def test_damped_optimistix_solvers_end_at_a_bound(solver):
    starts = np.array([[0.2, 1.0], [2.0, 2.0]])
    lower, upper = np.array([0.1, -np.inf]), np.array([0.6, 4.0])
    result = OptimistixSearch(solver, rosenbrock, 10.0, starts, lower, upper, size=2).advance(200).result()
    np.testing.assert_allclose(result.points, [[0.6, 0.36]] * 2, atol=2e-4)
    np.testing.assert_allclose(result.costs, 0.16, atol=2e-4)
    np.testing.assert_allclose(result.jacobians[0], [[-12.0, 10.0], [-1.0, 0.0]], atol=5e-3)
    np.testing.assert_allclose(np.sum(result.residuals**2, axis=1), result.costs, rtol=1e-9)


@pytest.mark.parametrize("signal", [KeyboardInterrupt, StopIteration])
@pytest.mark.parametrize("search", [MultiStartSolver, OptimistixSearch])
def test_a_search_that_is_stopped_keeps_its_best_point(search, signal):
    def stop(step, cost):
        reported.append(cost)
        if step == 3:
            raise signal

    reported: list[float] = []
    solver = (SOLVERS[0],) if search is OptimistixSearch else ()
    inf = np.full(2, np.inf)
    result = search(*solver, rosenbrock, 10.0, np.array([[-1.2, 1.0]]), -inf, inf, size=2).advance(99, stop).result()
    assert result.steps == 3 and result.statuses == [SolverStatus.interrupted]
    assert result.costs[0] == reported[-1] == min(reported) and len(reported) == 3
    cost = float(np.sum(rosenbrock(jnp.asarray(result.points[0]), 10.0) ** 2))
    assert result.costs[0] == pytest.approx(cost, rel=1e-12)


@pytest.mark.parametrize("search", [MultiStartSolver, OptimistixSearch])
def test_what_a_callback_returns_does_not_stop_a_search(search):
    solver, inf = (SOLVERS[0],) if search is OptimistixSearch else (), np.full(2, np.inf)
    begun = search(*solver, rosenbrock, 10.0, np.array([[-1.2, 1.0]]), -inf, inf, size=2)
    result = begun.advance(3, lambda step, cost: True).result()
    assert result.steps == 3 and result.statuses == [SolverStatus.steps]


@pytest.mark.parametrize(("search", "method"), [(MultiStartSolver, "_step"), (OptimistixSearch, "_advance_one")])
def test_ctrl_c_is_raised_where_nobody_asks_for_the_status(search, method, monkeypatch):
    def interrupt(*_):
        raise KeyboardInterrupt

    solver, inf = (SOLVERS[0],) if search is OptimistixSearch else (), np.full(2, np.inf)
    begun = search(*solver, rosenbrock, 10.0, np.array([[-1.2, 1.0]]), -inf, inf, size=2)
    monkeypatch.setattr(search, method, interrupt)
    with pytest.raises(KeyboardInterrupt):
        begun.advance(5)
    assert begun.advance(5, lambda step, cost: None) is begun


@pytest.mark.parametrize(("search", "method"), [(MultiStartSolver, "_arguments"), (OptimistixSearch, "_advance_one")])
def test_a_stop_iteration_of_other_code_is_a_fault(search, method, monkeypatch):
    monkeypatch.setattr(search, method, lambda *_: next(iter(())))
    solver, inf = (SOLVERS[0],) if search is OptimistixSearch else (), np.full(2, np.inf)
    with pytest.raises(StopIteration):
        search(*solver, rosenbrock, 10.0, np.array([[-1.2, 1.0]]), -inf, inf, size=2).advance(5)


def test_a_start_that_fails_is_reported():
    search = OptimistixSearch(
        SOLVERS[0], lambda y, _: jnp.log(y), None, -np.ones((1, 1)), -np.ones(1) * 9, np.ones(1), size=1
    )
    assert search.advance(5).result().statuses == [SolverStatus.failed]


@pytest.fixture(scope="module")
def fitted():
    return fit(plants.dead_weight(), [recorded(TRUTH)], Settings(), step=0.04, solver=BoundedLevenbergMarquardt(1e-13))


@pytest.mark.slow
@pytest.mark.parametrize("solver", SOLVERS[:3], ids=NAMES[:3])
def test_a_fit_by_an_optimistix_solver_has_the_default_s_estimates(fitted, solver):
    result = fit(plants.dead_weight(), [recorded(TRUTH)], Settings(), step=0.04, solver=solver)
    assert result.status is SolverStatus.converged
    assert result.cost == pytest.approx(fitted.cost, rel=1e-9)
    for estimate, default in zip(result.estimates, fitted.estimates, strict=True):
        assert estimate.estimate == pytest.approx(default.estimate, rel=1e-6)
        assert estimate.upper95 == pytest.approx(default.upper95, rel=1e-5)


@pytest.mark.slow
def test_a_fit_s_own_solver_runs_under_optimistix(fitted):
    problem = fitted.problem
    lower, upper = problem.bounds
    solution = optx.least_squares(
        lambda v, p: p.residual(v),
        BoundedLevenbergMarquardt(1e-13, lower, upper),
        jnp.asarray(problem.nominal),
        problem,
    )
    values = np.asarray(solution.value) * [u.scale for u in problem.unknowns]
    np.testing.assert_allclose(values, [e.estimate for e in fitted.estimates], rtol=1e-6)


@pytest.mark.slow
def test_a_study_whose_solver_diverged_is_no_success():
    """Gauss-Newton without damping leaves these start values at once; it was a success with them as estimates."""
    rig = sma.read_rig(data_path("recordings", "dead-weight", "rig.toml"))
    train = rig.read(data_path("recordings", "dead-weight", "train.csv")).slice(0.0, 30.0)
    study = sma.fit(rig, train, starts=1, solver=optx.GaussNewton(1e-8, 1e-8))
    assert study.document["solver"]["code"] == "diverged" and study.exit_code == 3
    assert "far above its best point" in study.reason and study.reason == study.document["solver"]["text"]


def test_a_solver_that_ends_away_from_the_minimum_has_not_converged():
    """Its own test of the end is met at once by such tolerances, with a slope of the cost left."""
    inf = np.full(2, np.inf)
    starts = np.array([[-1.2, 1.0]])
    loose = OptimistixSearch(optx.BFGS(rtol=10.0, atol=10.0), rosenbrock, 10.0, starts, -inf, inf, size=2)
    result = loose.advance(200).result()
    assert result.costs[0] > 1.0 and result.steps < 200
    assert result.statuses == [SolverStatus.not_stationary]


@pytest.mark.slow
def test_a_study_whose_solver_ended_early_is_no_success():
    """It was a success, with an RMSE of several times that at the minimum."""
    rig = sma.read_rig(data_path("recordings", "dead-weight", "rig.toml"))
    train = rig.read(data_path("recordings", "dead-weight", "train.csv")).slice(0.0, 30.0)
    study = sma.fit(rig, train, starts=1, solver=optx.BFGS(1.0, 1.0))
    assert study.document["solver"]["code"] == "not_stationary" and study.exit_code == 3
    assert "which is no minimum" in study.reason and study.reason == study.document["solver"]["text"]
    study = sma.fit(rig, train, starts=1, max_steps=2, solver=optx.LevenbergMarquardt(1e-8, 1e-8))
    assert study.document["solver"]["code"] == "steps" and not study.success
    assert study.reason == SolverStatus.steps.text


def test_something_else_as_solver_is_refused():
    with pytest.raises(InputError, match="solver: give an optimistix least-squares solver"):
        check_solver("lm")
