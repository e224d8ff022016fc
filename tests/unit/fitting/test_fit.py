"""Fits: planted truths come back, bounds hold, intervals cover, and collinear parameters are named.

Truths are made by tests/reference, which shares no code with what is fitted.
"""

import dataclasses

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest

from smajax import parameters
from smajax.errors import Cancelled, InputError, NumericsError
from smajax.fitting import fit as fit_module
from smajax.fitting import intervals, multi_start
from smajax.fitting.autoregression import fit_autoregression
from smajax.fitting.estimates import estimates_with_intervals
from smajax.fitting.fit import fit
from smajax.fitting.fit_warnings import copied_holdout_warnings, fit_warnings
from smajax.fitting.levenberg_marquardt import SolverStatus
from smajax.fitting.multi_start import MultiStartSolver, screen_starts
from smajax.fitting.noise import difference_noise
from smajax.fitting.preparation import _take_a_step
from smajax.fitting.problem import Problem, build_problem
from smajax.fitting.profile import crossing, profile_labels, profile_likelihood
from smajax.fitting.responses import simulate_responses, start_responses
from smajax.plant.cells import Cells
from smajax.plant.grains import Grains
from smajax.report.prediction import recording_series
from smajax.simulation.status import SimulationStatus
from tests.reference import rigs
from tests.reference.brinson import Material
from tests.reference.wire import Heat, Wire
from tests.support import plants

NAMES = (
    "heat.h0",
    "heat.capacity",
    "material.max_transformation_strain",
    "material.austenite_shift",
    "material.martensite_shift",
)
TRUTH = {
    "heat.h0": 108.0,
    "heat.capacity": 1.95e6,
    "material.max_transformation_strain": 0.0418,
    "material.austenite_shift": -1.7,
    "material.martensite_shift": 1.2,
}
NOISE = 2e-5


@dataclasses.dataclass(frozen=True)
class Settings:
    free: tuple = NAMES
    per_recording: tuple = ()
    initial: tuple = ()
    bounds: dict = dataclasses.field(default_factory=dict)
    observe: tuple = ("displacement",)
    noise: dict = dataclasses.field(default_factory=dict)
    starts: int = 1
    seed: int = 0


def exact(values: dict, recording, mass: float = 0.2) -> np.ndarray:
    """The exact displacement of the dead-weight rig with some of its values replaced."""
    material = {k: plants.MATERIAL[k] for k in Material._fields}
    for key in ("austenite", "martensite"):
        for end in ("start", "finish"):
            material[f"{key}_{end}"] += values.get(f"material.{key}_shift", 0.0)
    material["max_transformation_strain"] = values.get(
        "material.max_transformation_strain", material["max_transformation_strain"]
    )
    capacity = values.get("heat.capacity", 2.046e6)
    heat = Heat(values.get("heat.h0", 100.6), 0.0, 0.001, 2.0, capacity, capacity, 0.0)
    wire = Wire(0.15e-3, 0.23, 0.0, 20.0)
    return rigs.dead_weight(
        Material(**material), heat, wire, mass, recording.time, recording.channels["current"], interpolation="hold"
    ).position


def recorded(
    values: dict,
    *,
    rows: int = 500,
    step: float = 0.08,
    seed: int = 0,
    noise=NOISE,
    name: str = "made.csv",
    offset: float = 0.0,
):
    """A noisy recording of the exact rig, its current drawn by ``seed``."""
    time = np.arange(rows) * step
    current = plants.pulses(rows, 0.0, 0.33, seed=seed)
    blank = plants.recording({"current": current, "displacement": 0 * time}, time, name)
    white = np.random.default_rng(100 + seed).standard_normal(rows) * noise
    return plants.recording({"current": current, "displacement": exact(values, blank) + white + offset}, time, name)


@pytest.fixture(scope="module")
def result():
    return fit(
        plants.dead_weight(),
        [recorded(TRUTH)],
        Settings(starts=3),
        holdout=[recorded(TRUTH, seed=7, name="held.csv")],
        step=0.04,
    )


def test_planted_truth_comes_back_within_its_intervals(result):
    for estimate in result.estimates:
        deviation = (estimate.upper95 - estimate.lower95) / 3.92
        assert abs(estimate.estimate - TRUTH[estimate.name]) < 4 * deviation, estimate
        assert deviation < 0.1 * max(abs(TRUTH[estimate.name]), 1.0)
    assert result.status is SolverStatus.converged
    assert result.starts_at_best >= 2


def test_residual_is_the_noise_in_sample_and_out(result):
    assert result.rmse("displacement") == pytest.approx(NOISE, rel=0.08)
    assert result.rmse("displacement", "holdout") == pytest.approx(NOISE, rel=0.08)
    assert result.noise_floor["displacement"] == pytest.approx(NOISE, rel=0.15)
    assert result.discretisation_errors["displacement"] < 0.2 * NOISE
    assert result.rmse("displacement", "select") is None


@pytest.mark.slow
def test_a_fit_s_residual_is_measured_minus_model_like_its_response_s(result):
    """The solver's residual, the response's and the one that pages show have one sign."""
    problem, response = result.problem, result.responses[0]
    weighted = np.asarray(problem.residual(jnp.asarray(result.vector)))[: len(response.recording)]
    series = recording_series(response.recording, "train", response.model)
    factor = np.asarray(problem.data.weight)[0, 0, : len(response.recording)]
    np.testing.assert_allclose(weighted, response.residual("displacement") * factor, rtol=0.0, atol=1e-6)
    np.testing.assert_allclose(series.residual("displacement"), response.residual("displacement"), atol=1e-12)
    assert np.max(np.abs(weighted)) > 1.0


@pytest.mark.slow
@pytest.mark.parametrize("recordings", [1, 2])
def test_simulation_and_derivatives_as_two_programs_say_what_one_does(recordings):
    problem = build_problem(
        plants.dead_weight(), [recorded(TRUTH, seed=k, rows=150) for k in range(recordings)], Settings(), step=0.04
    )
    at = jnp.asarray(problem.nominal)
    track = eqx.filter_jit(lambda v: problem.trajectories(v))(at)
    blank = problem.blank_trajectories(at)
    assert (blank.flat_states.shape, blank.status.shape, blank.status.dtype) == (
        track.flat_states.shape,
        track.status.shape,
        track.status.dtype,
    )
    whole, from_trajectory = eqx.filter_jit(problem.residual)(at), eqx.filter_jit(problem.residual)(at, track)
    np.testing.assert_allclose(from_trajectory, whole, rtol=0, atol=1e-9)
    slopes, slopes_from_trajectory = (
        eqx.filter_jit(lambda v, *k: jax.jacfwd(lambda v: problem.residual(v, *k))(v))(at, *more)
        for more in ((), (track,))
    )
    np.testing.assert_allclose(slopes_from_trajectory, slopes, rtol=1e-9, atol=1e-9 * float(np.max(np.abs(slopes))))


def test_a_search_with_a_primal_function_takes_the_same_steps():
    """The residual asks for what it was given at the same point; where that is worse than before, no derivatives are asked for."""

    def bent(v, rest):
        return jnp.stack([v[0] - 1.0, rest * (v[1] - v[0] ** 2)])

    def ahead(v, rest):
        evaluated.append(np.asarray(v))
        return bent(v, rest)

    evaluated = []
    start, ends = np.array([[-1.2, 1.0]]), (np.full(2, -5.0), np.full(2, 5.0))
    plain = MultiStartSolver(bent, jnp.asarray(10.0), start, *ends, size=2).advance(60)
    led = MultiStartSolver(
        lambda v, args: args[1] + (bent(v, args[0]) - args[1]), jnp.asarray(10.0), start, *ends, size=2, primal_fn=ahead
    )
    led.trace_program()
    assert led.advance(60).steps == plain.steps == len(evaluated) - 1
    np.testing.assert_allclose(led.result().points, plain.result().points, rtol=1e-9)
    np.testing.assert_allclose(led.result().points, [[1.0, 1.0]], rtol=1e-6)


@pytest.mark.slow
def test_profile_agrees_with_the_interval(result):
    profile = profile_likelihood(result, "material.max_transformation_strain")
    estimate = next(e for e in result.estimates if e.name == "material.max_transformation_strain")
    width = estimate.upper95 - estimate.lower95
    assert profile["lower95"] == pytest.approx(estimate.lower95, abs=0.1 * width)
    assert profile["upper95"] == pytest.approx(estimate.upper95, abs=0.1 * width)
    assert np.argmin(profile["rise"]) == len(profile["rise"]) // 2
    with pytest.raises(InputError, match=r"'heat.h2' is not a free parameter of this fit"):
        profile_likelihood(result, "heat.h2")


@pytest.mark.parametrize(
    ("shape", "expected"),
    [
        (lambda d: d**2, 1.9599639845400538),
        (lambda d: d**2 + 0.5 * d**4, 1.3948),
        (lambda d: 3.0 * (1.0 - np.exp(-(d**2) / 3.0)), None),
        (lambda d: np.where(d > 1.6, np.nan, d**2), None),
        (lambda d: np.where(d > 2.9, np.nan, d**2), 1.9599639845400538),
        (lambda d: np.full_like(d, np.nan), None),
    ],
    ids=["parabola", "steep", "saturates", "unknown-before", "unknown-beyond", "unknown"],
)
@pytest.mark.parametrize("side", [-1.0, 1.0])
def test_ends_of_a_profile(shape, expected, side):
    """The exact ends of d^2 + d^4 / 2, and none where the rise stays below the level or is not known up to it."""
    distance = np.linspace(0.0, 3.0, 5)
    end = crossing(2.0 + side * distance, np.append(0.0, shape(distance)[1:]))
    assert end == (None if expected is None else pytest.approx(2.0 + side * expected, abs=0.005))


def test_a_profile_that_a_bound_cuts_off_has_no_end_there():
    values = np.array([2.0, 2.75, 3.2, 3.2, 3.2])
    assert crossing(values, np.array([0.0, 0.6, 1.4, 1.4, 1.4])) is None
    parabola = ((values - 2.0) / 0.5) ** 2  # its end is exact: the root of the rise is a straight line
    assert crossing(values, parabola) == pytest.approx(2.0 + 0.5 * 1.9599639845400538, rel=1e-12)


def test_a_fit_that_is_interrupted_in_its_first_step_has_no_result(monkeypatch):
    def interrupt(self, group):
        raise KeyboardInterrupt

    monkeypatch.setattr(MultiStartSolver, "_arguments", interrupt)
    with pytest.raises(Cancelled):
        fit(plants.dead_weight(), [recorded(TRUTH)], Settings(), step=0.04)


@pytest.mark.parametrize("signal", [KeyboardInterrupt, StopIteration])
def test_a_fit_that_is_stopped_has_the_best_point_so_far(signal):
    def stop(step, cost):
        costs.append(cost)
        if step == 2:
            raise signal

    costs: list[float] = []
    result = fit(plants.dead_weight(), [recorded(TRUTH)], Settings(), step=0.04, progress=stop)
    assert result.status is SolverStatus.interrupted and result.steps == 2 and result.cost == costs[-1]
    assert all(estimate.lower95 is not None for estimate in result.estimates)


def test_labels_of_profiles():
    settings = Settings(free=("heat.h0", "load.mass"), per_recording=("load.mass",), initial=("temperature",))
    recordings = ["a.csv", "b.csv"]
    assert profile_labels(["heat.h0", "load.mass"], settings, recordings) == [
        "heat.h0", "load.mass@a.csv", "load.mass@b.csv"
    ]  # fmt: skip
    assert profile_labels(["initial.temperature@b.csv"], settings, recordings) == ["initial.temperature@b.csv"]
    with pytest.raises(InputError, match=r"profile heat.h1: this parameter is not free \(did you mean 'heat.h0'\?\)"):
        profile_labels(["heat.h1"], settings, recordings)


def test_warnings_and_start_values_of_a_fit(result):
    train = [dataclasses.replace(recorded(TRUTH), sha256="1" * 64)]
    copies = [dataclasses.replace(recorded(TRUTH), sha256="1" * 64, name="copy.csv"), recorded(TRUTH, seed=7)]
    (sentence,) = copied_holdout_warnings(train, copies)
    assert sentence == "copy.csv has the same content as made.csv: it is not an independent test."
    arguments = (plants.dead_weight(), [recorded(TRUTH)], Settings(starts=3))
    # The made recordings of the fit have one checksum, as two parts of a file have, and other rows.
    assert fit_warnings(result, *arguments) == []
    fitted, held = result.responses
    same_rows = dataclasses.replace(held, recording=dataclasses.replace(fitted.recording, name="held.csv"))
    copied = dataclasses.replace(result, responses=(fitted, same_rows))
    sentence = "held.csv has the same content as made.csv: it is not an independent test."
    assert fit_warnings(copied, *arguments) == [sentence]
    train_response, held = start_responses(
        plants.dead_weight(), train, ("displacement",), holdout=copies[1:], step=0.04
    )
    assert (train_response.role, held.role) == ("train", "holdout")
    assert held.status is SimulationStatus.done and held.rmse("displacement") > 10 * NOISE


@pytest.mark.parametrize("points", [-3, 1, 2, 8])
def test_a_profile_without_a_middle_is_refused(result, points):
    with pytest.raises(InputError, match=rf"^points: a profile has .* and {points} is not an odd number of at least 3"):
        profile_likelihood(result, "heat.h0", points=points)


@pytest.mark.parametrize("width", [0.0, -1.0, np.nan, np.inf])
def test_a_profile_without_a_range_is_refused(result, width):
    with pytest.raises(InputError, match=r"^width: the values cannot reach .* give a number above 0, such as 3$"):
        profile_likelihood(result, "heat.h0", width=width)


@pytest.mark.slow
def test_an_interrupted_profile_is_no_profile(result, monkeypatch):
    advance = MultiStartSolver.advance

    def interrupt(step, cost):
        raise KeyboardInterrupt

    monkeypatch.setattr(MultiStartSolver, "advance", lambda solver, **_: advance(solver, progress=interrupt))
    with pytest.raises(Cancelled):
        profile_likelihood(result, "heat.h0")


def test_a_parameter_at_its_bound_is_held_there_and_said_so():
    bounded = Settings(bounds={"heat.capacity": (2.0e6, 3.0e6)})
    estimates = {e.name: e for e in fit(plants.dead_weight(), [recorded(TRUTH)], bounded, step=0.04).estimates}
    assert estimates["heat.capacity"].at_bound
    assert estimates["heat.capacity"].estimate == pytest.approx(2.0e6, rel=1e-9)
    assert estimates["heat.capacity"].lower95 is None
    assert not estimates["material.max_transformation_strain"].at_bound


@pytest.mark.slow
@pytest.mark.parametrize(("away", "held"), [(1e-7, True), (1e-4, False)])
def test_what_comes_near_a_bound_that_the_data_press_against_is_there(result, away, held):
    """Steps towards a bound may grow ever shorter before they reach it."""
    problem = result.problem
    first = dataclasses.replace(
        problem.unknowns[0], lower=problem.unknowns[0].scale, upper=3.0 * problem.unknowns[0].scale
    )
    problem = dataclasses.replace(problem, unknowns=(first, *problem.unknowns[1:]))
    vector = np.append(1.0 + 2.0 * away, result.vector[1:])
    jacobian = np.asarray(jax.jacfwd(problem.residual)(jnp.asarray(result.vector)))
    pressed = 1e-3 * jacobian[:, 0]  # less of the parameter leaves less
    estimates, *_ = estimates_with_intervals(problem, vector, pressed, jacobian)
    assert estimates[0].at_bound == held and (estimates[0].lower95 is None) == held


@pytest.mark.slow
def test_an_end_that_its_own_steps_cannot_simulate_gives_way_to_the_next_best(monkeypatch):
    """Sound on the steps of the fit, and not on those that the plant found asks for: here that is said of the first that is asked."""
    convections, failing = [], 1
    right = simulate_responses

    def respond(plants_, *given):
        responses, change = right(plants_, *given)
        convections.append(float(plants_[0].heat.h0))
        status = SimulationStatus.overheated if len(convections) <= failing else SimulationStatus.done
        return [dataclasses.replace(r, status=status) for r in responses], change

    monkeypatch.setattr(fit_module, "simulate_responses", respond)
    settings = Settings(free=("heat.h0", "material.max_transformation_strain"), starts=3)
    plant = parameters.replace(plants.dead_weight(), {k: v for k, v in TRUTH.items() if k not in settings.free})
    result = fit(plant, [recorded(TRUTH)], settings, step=0.08)
    assert len(convections) == 2 and float(result.plant.heat.h0) == convections[1]
    assert all(r.status is SimulationStatus.done for r in result.responses)
    convections.clear()
    failing = 3
    none = fit(plant, [recorded(TRUTH)], settings, step=0.08)
    assert len(convections) == 3 and float(none.plant.heat.h0) == convections[0]  # the best is what is known of it
    assert none.responses[0].status is SimulationStatus.overheated


@pytest.mark.slow
def test_recordings_share_some_parameters_and_own_others():
    made = [
        recorded(TRUTH, seed=s, rows=r, name=f"{s}.csv", offset=o)
        for s, r, o in ((1, 500, 0.0), (2, 420, 3e-4), (3, 460, -2e-4))
    ]
    settings = Settings(
        free=("heat.h0", "material.max_transformation_strain"), per_recording=("sensor.displacement_offset",)
    )
    plant = parameters.replace(plants.dead_weight(), {k: v for k, v in TRUTH.items() if k not in settings.free})
    result = fit(plant, made, settings, step=0.08)
    values = {e.name: e.estimate for e in result.estimates}
    assert values["heat.h0"] == pytest.approx(108.0, rel=2e-3)
    assert [values[f"sensor.displacement_offset@{s}.csv"] for s in (1, 2, 3)] == pytest.approx(
        [0.0, 3e-4, -2e-4], abs=1e-5
    )
    assert [len(r.model["displacement"]) for r in result.responses] == [500, 420, 460]
    assert result.simulations == 3 * result.steps * (1 + 5)  # each of the recordings, and the columns of its Jacobian
    assert float(result.plants[1].sensor.offset["displacement"]) == pytest.approx(3e-4, abs=1e-5)


@pytest.fixture(scope="module")
def unclear():
    """A fit of parameters of which three are nearly two, and one does nothing at a constant load."""
    resistivities = ("material.resistivity_austenite", "material.resistivity_martensite")
    settings = Settings(free=("drive.gain", *resistivities, "material.max_transformation_strain", "wire.prestrain"))
    return fit(plants.dead_weight(), [recorded({})], settings, step=0.08)


def test_collinear_parameters_are_named_with_their_direction(unclear):
    groups = [g for g in unclear.collinear_groups if "drive.gain" in g.parameters]
    assert groups, unclear.collinear_groups
    assert groups[0].shrink < 1e-6
    named = dict(zip(groups[0].parameters, groups[0].direction, strict=True))
    # Heat goes as gain^2 times resistivity: doubling the resistivities undoes a gain smaller by half as much, relatively.
    assert named["material.resistivity_austenite"] / named["drive.gain"] == pytest.approx(-2.0, rel=0.02)


def test_a_parameter_without_any_effect_is_named_alone(unclear):
    assert any(g.parameters == ("wire.prestrain",) and g.shrink == 0.0 for g in unclear.collinear_groups)
    estimate = next(e for e in unclear.estimates if e.name == "wire.prestrain")
    assert estimate.lower95 is None


@pytest.mark.slow
def test_free_initial_temperature_is_found():
    made = recorded(TRUTH, rows=200)
    warm = parameters.replace(plants.dead_weight(), {"initial.temperature": 45.0})
    problem_plant = plants.dead_weight()
    from smajax.simulation.run import simulate

    series = np.asarray(simulate(warm, made, step=0.04).channels["displacement"]) + NOISE * np.random.default_rng(
        3
    ).standard_normal(200)
    made = plants.recording({"current": made.channels["current"], "displacement": series}, made.time)
    result = fit(
        problem_plant,
        [made],
        Settings(free=("material.max_transformation_strain",), initial=("temperature",)),
        step=0.04,
    )
    value = next(e for e in result.estimates if e.name.startswith("initial.temperature"))
    assert value.estimate == pytest.approx(45.0, abs=1.0)
    assert result.plant.initial.temperature is None


@pytest.mark.parametrize(
    ("cells", "grains"), [(Cells(count=5), None), (None, Grains(count=3)), (Cells(count=5), Grains(count=3))]
)
def test_a_free_initial_state_of_a_wire_with_cells_or_grains_starts_at_that_of_the_plant(cells, grains):
    plant = dataclasses.replace(plants.dead_weight(), cells=cells, grains=grains)
    settings = Settings(free=("material.max_transformation_strain",), initial=("temperature", "detwinned"))
    nominal = {
        u.name: u.nominal for u in build_problem(plant, [recorded(TRUTH, rows=60)], settings, step=0.04).unknowns
    }
    assert nominal["initial.temperature"] == pytest.approx(float(plant.environment.ambient))
    assert 0.0 <= nominal["initial.detwinned"] <= 1.0


def test_fits_repeat_and_scaling_of_noise_changes_nothing():
    made = recorded(TRUTH)
    first = fit(plants.dead_weight(), [made], Settings(noise={"displacement": 1e-5}), step=0.04)
    second = fit(plants.dead_weight(), [made], Settings(noise={"displacement": 1e-4}), step=0.04)
    for a, b in zip(first.estimates, second.estimates, strict=True):
        assert a.estimate == pytest.approx(b.estimate, rel=1e-5, abs=1e-6)
        assert a.upper95 - a.lower95 == pytest.approx(b.upper95 - b.lower95, rel=1e-3)


@pytest.mark.slow
def test_starts_that_all_fail_end_with_a_reason():
    impossible = eqx.tree_at(lambda p: p.drive.gain, plants.dead_weight(), jnp.asarray(1e6))
    with pytest.raises(NumericsError, match=r"at the start values: .*wire.diameter"):
        fit(impossible, [recorded({})], Settings(), step=0.04)


@pytest.mark.slow
def test_a_search_takes_no_step_into_states_in_which_the_simulation_fails():
    recording, settings = recorded({}), Settings(free=("drive.gain",))
    problem = build_problem(plants.dead_weight(), [recording], settings, step=0.04)
    for gain, code, times in ((20.0, SimulationStatus.overheated, 1e3), (1.5, SimulationStatus.done, 1.0)):
        model, result = problem.predict(jnp.asarray([gain]))
        assert result[0] == code
        plain = (problem.data.measured - model) * problem.data.weight
        np.testing.assert_allclose(problem.residual(jnp.asarray([gain])), times * plain.ravel(), rtol=1e-12)
    # From here it is all the way downhill into the melt.
    result = fit(parameters.replace(plants.dead_weight(), {"drive.gain": 8.0}), [recording], settings, step=0.04)
    assert 12.0 < result.estimates[0].estimate < 14.0 and result.responses[0].status == SimulationStatus.done


ENDS = (
    "material.martensite_finish",
    "material.martensite_start",
    "material.detwinning_start_stress",
    "material.detwinning_finish_stress",
)


@pytest.mark.slow
def test_ends_of_a_transformation_that_a_search_lets_cross_change_places():
    """The plant is the same on the other side, and what a fit gives can be read again."""
    problem = build_problem(plants.dead_weight(), [recorded({})], Settings(free=ENDS), step=0.04)
    names, scales = [u.name for u in problem.unknowns], np.asarray(problem.scales)
    right = problem.nominal
    crossed = (right * scales)[[1, 0, 3, 2]] / scales
    for point in (right, crossed):
        shared, _ = problem.values(jnp.asarray(point))
        assert [float(shared[n]) for n in names] == pytest.approx(list(right * scales), rel=1e-12)
    slopes = jax.jit(jax.jacfwd(problem.residual))
    ordered, jacobian = problem.order_transformation_ends(crossed, np.asarray(slopes(jnp.asarray(crossed))))
    np.testing.assert_allclose(ordered, right, rtol=1e-12)
    np.testing.assert_allclose(jacobian, slopes(jnp.asarray(right)), rtol=1e-6, atol=1e-6)
    same = np.array([5.0, 5.0, 1.0, 1.0])
    shared, _ = problem.values(jnp.asarray(same))
    assert float(shared[names[0]]) < float(shared[names[1]]) and float(shared[names[2]]) < float(shared[names[3]])


@pytest.mark.parametrize(("name", "other", "below"), [(*ENDS[:2], True), (*ENDS[1::-1], False)])
def test_an_end_of_a_transformation_stays_on_its_side_of_one_that_is_held(name, other, below):
    plant = plants.dead_weight()
    problem = build_problem(
        plant, [recorded({}, rows=50)], Settings(free=(name,), bounds={name: (-50.0, 200.0)}), step=0.04
    )
    there, unknown = float(parameters.get(plant, other)), problem.unknowns[0]
    assert (
        (unknown.upper < there and unknown.lower == -50.0)
        if below
        else (unknown.lower > there and unknown.upper == 200.0)
    )


def test_bad_settings_are_refused():
    made = recorded({}, rows=50)
    with pytest.raises(InputError, match="made.csv has no channel 'angle'"):
        build_problem(plants.dead_weight(), [made], Settings(observe=("angle",)))
    with pytest.raises(InputError, match="nothing is free"):
        build_problem(plants.dead_weight(), [made], Settings(free=()))
    with pytest.raises(InputError, match=r"there is no parameter 'heat.h9' in this plant \(did you mean 'heat.h"):
        build_problem(plants.dead_weight(), [made], Settings(free=("heat.h9",)))


def test_drawn_starts_lie_in_the_box_and_repeat():
    problem = build_problem(plants.dead_weight(), [recorded(TRUTH)], Settings(), step=0.04)
    starts, count = screen_starts(problem, 4, 3)
    again, _ = screen_starts(problem, 4, 3)
    lower, upper = problem.search_bounds()
    assert np.array_equal(starts, again)
    assert np.all((starts >= lower) & (starts <= upper))
    assert count == 48


def test_levenberg_marquardt_on_known_problems():
    def rosenbrock(v, rest):
        return jnp.array([10.0 * (v[1] - v[0] ** 2), 1.0 - v[0]])

    def solve(starts, lower, upper, steps=100):
        box = np.array(lower), np.array(upper)
        return MultiStartSolver(rosenbrock, None, np.array(starts), *box, size=2, rtol=1e-14).advance(steps).result()

    free = solve([[-1.2, 1.0], [3.0, -2.0]], [-10.0, -10.0], [10.0, 10.0])
    assert free.points == pytest.approx(np.ones((2, 2)), abs=1e-6)
    bounded = solve([[-1.2, 1.0]], [-10.0, -10.0], [0.5, 10.0])
    assert bounded.points[0] == pytest.approx([0.5, 0.25], abs=1e-6)
    fixed = solve([[-1.2, 1.0]], [-1.2, -10.0], [-1.2, 10.0])
    assert fixed.points[0] == pytest.approx([-1.2, 1.44], abs=1e-6)
    few = solve([[-1.2, 1.0]], [-10.0, -10.0], [10.0, 10.0], steps=3)
    assert few.statuses == [SolverStatus.steps]
    assert few.simulations == 9


def test_starts_end_alike_with_any_number_of_cores():
    def rosenbrock(v, rest):
        return jnp.array([10.0 * (v[1] - v[0] ** 2), 1.0 - v[0]])

    starts, box = np.array([[-1.2, 1.0], [3.0, -2.0], [0.1, 0.2]]), (np.full(2, -10.0), np.full(2, 10.0))
    ends = [
        MultiStartSolver(rosenbrock, None, starts, *box, size=2, workers=workers).advance(60).result()
        for workers in (1, 2, 3)
    ]
    assert all(np.array_equal(end.points, ends[0].points) and end.steps == ends[0].steps for end in ends)
    assert ends[0].simulations == ends[2].simulations and ends[0].statuses == [SolverStatus.converged] * 3


def test_a_fit_uses_the_program_that_was_compiled_in_the_background():
    plant, recordings = plants.dead_weight(), [recorded(TRUTH)]
    _take_a_step(plant, recordings, Settings(), "hold")
    compiled = set(multi_start._step_starts._called)
    fit(plant, recordings, Settings(starts=2), interpolation="hold", max_steps=2)
    assert compiled and multi_start._step_starts._called == compiled


def test_a_search_that_is_resumed_ends_where_one_run_does():
    def rosenbrock(v, rest):
        return jnp.array([10.0 * (v[1] - v[0] ** 2), 1.0 - v[0]])

    def search():
        return MultiStartSolver(
            rosenbrock, None, np.array([[-1.2, 1.0]]), np.full(2, -10.0), np.full(2, 10.0), size=2, rtol=1e-14
        )

    whole, parts = search().advance(40), search()
    for steps in (1, 2, 3, 5, 8, 21):
        parts.advance(steps)
    assert np.array_equal(whole.result().points, parts.result().points)
    assert whole.result().simulations == parts.result().simulations


def test_autoregression_is_found():
    draw = np.random.default_rng(0)
    series = np.zeros(20000)
    for k in range(2, len(series)):
        series[k] = 1.2 * series[k - 1] - 0.5 * series[k - 2] + draw.standard_normal()
    coefficients, variance = fit_autoregression(series)
    assert coefficients[:2] == pytest.approx([1.2, -0.5], abs=0.05)
    assert variance == pytest.approx(1.0, abs=0.03)


def test_noise_estimate_from_differences():
    time = np.linspace(0, 10, 5000)
    noisy = 0.01 * np.sin(time) + 2e-5 * np.random.default_rng(0).standard_normal(5000)
    assert difference_noise(noisy) == pytest.approx(2e-5, rel=0.05)
    assert difference_noise(np.round(time, 1)) >= 0.1 / np.sqrt(12) * 0.999


def test_rows_at_which_a_channel_was_not_measured_weigh_nothing():
    whole = recorded(TRUTH)
    gaps = np.arange(len(whole)) % 3 != 0
    seen = np.where(gaps, np.nan, whole.channels["displacement"])
    sparse = dataclasses.replace(whole, channels=whole.channels | {"displacement": seen})
    wrong = dataclasses.replace(whole, channels=whole.channels | {"displacement": np.where(gaps, 1.0, seen)})
    built = build_problem(plants.dead_weight(), [sparse], Settings(), step=0.04)
    every = build_problem(plants.dead_weight(), [wrong], Settings(noise={"displacement": NOISE}), step=0.04)
    residual = eqx.filter_jit(Problem.residual)
    sparse_residual, whole_residual = (np.asarray(residual(p, jnp.asarray(p.nominal))) for p in (built, every))
    assert np.all(sparse_residual[: len(whole)][gaps] == 0.0)
    assert difference_noise(seen) == pytest.approx(difference_noise(seen[~gaps]))
    np.testing.assert_allclose(
        sparse_residual[: len(whole)][~gaps] * difference_noise(seen),
        whole_residual[: len(whole)][~gaps] * NOISE,
        rtol=1e-9,
    )
    result = fit(plants.dead_weight(), [sparse], Settings(), step=0.04)
    assert result.rmse("displacement") == pytest.approx(NOISE, rel=0.15)


def test_intervals_cover_the_truth_under_autocorrelated_noise():
    """Linear in the unknowns, so that 400 repetitions are cheap; the experiment interval_coverage.py does it on the wire itself."""
    draw = np.random.default_rng(1)
    time = np.linspace(0, 1, 600)
    columns = np.column_stack([np.ones(600), time, np.sin(9 * time)])
    inside = []
    for _ in range(400):
        noise = np.zeros(700)
        for k in range(1, 700):
            noise[k] = 0.8 * noise[k - 1] + draw.standard_normal()
        estimate, *_ = np.linalg.lstsq(columns, noise[100:], rcond=None)
        spread = np.sqrt(
            np.diag(intervals.covariance_under_autocorrelation([columns], [noise[100:] - columns @ estimate], 3))
        )
        inside.append(np.abs(estimate) < intervals.student_quantile(600, 3) * spread)
    assert np.all(np.abs(np.mean(inside, axis=0) - 0.94) < 0.04), np.mean(inside, axis=0)


def test_parameters_without_effect_on_the_residual_have_no_interval():
    """Two columns that are one multiples of each other, and a third; and fewer samples than parameters."""
    draw = np.random.default_rng(2)
    columns = draw.standard_normal((300, 3))
    columns[:, 2] = -4.0 * columns[:, 0]
    determined = np.isfinite(
        np.diag(intervals.covariance_under_autocorrelation([columns], [draw.standard_normal(300)], 3))
    )
    assert determined.tolist() == [False, True, False]
    few = intervals.covariance_under_autocorrelation([draw.standard_normal((4, 4))], [draw.standard_normal(4)], 4)
    assert np.all(np.isinf(np.diag(few)))
