"""The plant as a differential equation, integrated by diffrax: a second opinion on the implicit step."""

import dataclasses
from functools import partial

import diffrax as dfx
import jax
import jax.numpy as jnp
import numpy as np
import pytest

from smajax import parameters
from smajax.errors import DerivativeError, InputError
from smajax.files.rig_file import parse_rig, read_rig
from smajax.plant.effects import Quantisation
from smajax.plant.effects.specimen_lag import SpecimenLag
from smajax.plant.materials import Lagoudas
from smajax.plant.materials.base import Fractions
from smajax.plant.mechanisms import AbstractMechanism, DeadWeight, Joint, Link, Load, Pulley
from smajax.plant.plant import Plant
from smajax.plant.wire import Initial
from smajax.recordings.datasets import data_path
from smajax.simulation.inputs import discretise
from smajax.simulation.integration import check_solver
from smajax.simulation.run import simulate
from smajax.simulation.vector_field import FieldArguments, check_vector_field, initial_variables, rates
from tests.support import plants

# K. Bound on the difference of the implicit step at the finest grid; chosen by trial.
DIFFERENCE = 5e-4
LAGOUDAS = {name: value for name, value in plants.MATERIAL.items() if not name.startswith("detwinning")}


@pytest.mark.slow
@pytest.mark.parametrize("kind", ["dead_weight", "bias_spring"])
def test_the_implicit_step_converges_to_the_differential_equation(kind):
    plant, recording = plants.KINDS[kind](), plants.inputs(kind, 60, 0.15)
    exact = simulate(plant, discretise(plant, recording), solver=dfx.Tsit5())
    grids = [discretise(plant, recording, step=step) for step in (0.15, 0.05, 0.015)]
    results = [simulate(plant, grid) for grid in grids]
    errors = [float(np.max(np.abs(r.channels["temperature"] - exact.channels["temperature"]))) for r in results]
    assert errors[1] < 0.4 * errors[0] and errors[2] < 0.6 * errors[1] and errors[2] < DIFFERENCE, errors
    moved = np.asarray(exact.channels["displacement"])
    assert np.max(np.abs(np.asarray(results[-1].channels["displacement"]) - moved)) < 1e-3 * np.ptp(moved)
    assert np.ptp(np.asarray(exact.state.fractions.martensite)) > 0.1


@pytest.mark.slow
@pytest.mark.parametrize(("current", "temperature"), [(0.15, None), (0.27, 84.0)])
def test_the_implicit_step_has_order_four_away_from_the_ends_of_a_transformation(current, temperature):
    """Without a transformation, and within one whose start was before the first sample."""
    plant = plants.dead_weight()
    if temperature is not None:
        stress, one = plant.mechanism._load_stress(plant._mechanism_context()), jnp.ones(1)
        at_start = plant.material.evolve(Fractions(one, 0.0 * one), (20.0 * one, temperature * one), (stress, stress))
        initial = Initial(temperature, at_start.detwinned[0], at_start.twinned[0])
        plant = dataclasses.replace(plant, initial=initial)
    recording = plants.recording({"current": np.full(4, current)}, 0.5 * np.arange(4))
    exact = simulate(plant, discretise(plant, recording), solver=dfx.Tsit5())
    martensite = np.asarray(exact.state.fractions.martensite)[:, 0]
    assert np.ptp(martensite) > 0.5 if temperature else np.ptp(martensite) < 1e-12
    errors = []
    for step in (0.5, 0.25):
        result = simulate(plant, discretise(plant, recording, step=step))
        errors.append(float(np.max(np.abs(result.channels["temperature"] - exact.channels["temperature"]))))
    assert 3.5 < np.log2(errors[0] / errors[1]) < 4.5, errors


@pytest.fixture(scope="module")
def last_temperature():
    """The temperature at the last of a few samples as a function of the convection coefficient."""
    plant, recording = plants.dead_weight(), plants.inputs("dead_weight", 12, 0.15)
    inputs = discretise(plant, recording)

    def function(h0, **options):
        grid = inputs if options else discretise(plant, recording, step=0.01)
        result = simulate(parameters.replace(plant, {"heat.h0": h0}), grid, **options)
        return result.channels["temperature"][-1]

    return function


@pytest.fixture(scope="module")
def numeric(last_temperature):
    """Its derivative by finite differences."""
    ends = [float(last_temperature(h0, solver=dfx.Tsit5())) for h0 in (100.1, 99.9)]
    return (ends[0] - ends[1]) / 0.2


@pytest.mark.slow
@pytest.mark.parametrize("adjoint", [None, dfx.ForwardMode()])
def test_the_differential_equation_has_its_derivative(adjoint, last_temperature, numeric):
    assert abs(numeric) > 1e-3
    options = {"solver": dfx.Tsit5(), "adjoint": adjoint}
    program = (jax.jacfwd if adjoint else jax.grad)(lambda h0: last_temperature(h0, **options))
    assert float(program(100.0)) == pytest.approx(numeric, rel=1e-4)
    if adjoint is None:
        assert float(jax.grad(last_temperature)(100.0)) == pytest.approx(numeric, rel=1e-3)  # of the implicit step


@pytest.mark.slow
@pytest.mark.parametrize(
    ("adjoint", "sentence"),
    [
        (dfx.ForwardMode(), "adjoint ForwardMode has no derivatives in reverse mode: use jax.jvp or jax.jacfwd, or"),
        (dfx.ImplicitAdjoint(), "adjoint ImplicitAdjoint needs a steady state or an input without jumps: give diffrax"),
        (dfx.BacksolveAdjoint(), "adjoint BacksolveAdjoint needs a steady state or an input without jumps: give"),
    ],
)
def test_an_adjoint_without_reverse_mode_is_refused(adjoint, sentence, last_temperature):
    with pytest.raises(InputError, match=f"^simulate: {sentence}"):
        jax.grad(lambda h0: last_temperature(h0, solver=dfx.Tsit5(), adjoint=adjoint))(100.0)


@pytest.mark.slow
def test_the_default_adjoint_names_what_has_forward_mode(last_temperature):
    with pytest.raises(
        DerivativeError, match="^simulate: adjoint RecursiveCheckpointAdjoint has no derivatives in forward"
    ):
        jax.jacfwd(lambda h0: last_temperature(h0, solver=dfx.Tsit5()))(100.0)


@pytest.mark.slow
def test_a_rejected_step_does_not_spoil_the_gradient():
    """Within these samples the solver tries steps at which the search for the rates fails; the gradient was NaN."""
    rig = read_rig(data_path("recordings", "bias-spring", "rig.toml"))
    recording = rig.read(data_path("recordings", "bias-spring", "train.csv")).slice(0.0, 3.0)
    inputs = discretise(rig.plant, recording, interpolation=rig.interpolation)

    def mean(h0, **options):
        plant = parameters.replace(rig.plant, {"heat.h0": h0})
        return jnp.mean(simulate(plant, inputs, **options).channels["displacement"])

    implicit, by_diffrax = (float(jax.grad(partial(mean, **o))(100.0)) for o in ({}, {"solver": dfx.Tsit5()}))
    assert by_diffrax == pytest.approx(implicit, rel=0.01) and abs(implicit) > 1e-6


@pytest.mark.slow
def test_a_solver_without_an_error_estimate_takes_the_steps_of_the_grid():
    plant, recording = plants.dead_weight(), plants.inputs("dead_weight", 12, 0.15)
    exact = simulate(plant, discretise(plant, recording), solver=dfx.Tsit5()).channels["temperature"]
    errors = [
        float(
            jnp.max(jnp.abs(simulate(plant, recording, step=step, solver=dfx.Euler()).channels["temperature"] - exact))
        )
        for step in (0.02, 0.01)
    ]
    assert 0.8 < np.log2(errors[0] / errors[1]) < 1.2, errors


@pytest.mark.parametrize(
    ("solver", "sentence"),
    [
        ("Tsit5", "solver = 'Tsit5' is not a solver of diffrax: give one, such as diffrax"),
        (dfx.Tsit5, "solver = Tsit5 is not a solver of diffrax: give one"),
        (dfx.KenCarp4(), "solver KenCarp4 is for several terms or for noise, and a plant has one vector field: give a"),
        (dfx.SemiImplicitEuler(), "solver SemiImplicitEuler is for several terms or for noise"),
    ],
)
def test_what_is_no_solver_of_one_vector_field_is_refused(solver, sentence):
    with pytest.raises(InputError, match=f"^simulate: {sentence}"):
        check_solver(solver)
    check_solver(dfx.HalfSolver(dfx.Heun()))


@pytest.mark.slow
def test_the_rates_have_first_derivatives_in_both_modes():
    plant, recording = plants.bias_spring(), plants.inputs("bias_spring", 12, 0.15)
    inputs = discretise(plant, recording)
    variables = initial_variables(plant, inputs.sample_signals[0])
    variables = variables._replace(temperature=variables.temperature + 66.0)

    def temperature_rate(h0, start):
        heated = parameters.replace(plant, {"heat.h0": h0})
        moved = variables._replace(temperature=variables.temperature + start)
        return rates(0.1, moved, FieldArguments(heated, inputs)).temperature[0]

    forward, reverse = (jax.jit(mode(temperature_rate, (0, 1)))(100.0, 0.0) for mode in (jax.jacfwd, jax.grad))
    numeric = [
        (temperature_rate(100.0 + 0.01 * k, 1e-4 * (1 - k)) - temperature_rate(100.0 - 0.01 * k, 1e-4 * (k - 1)))
        / (0.02 if k else 2e-4)
        for k in (1, 0)
    ]
    np.testing.assert_allclose(forward, numeric, rtol=1e-5)
    np.testing.assert_allclose(reverse, forward, rtol=1e-12)
    with pytest.raises(DerivativeError, match="simulate has derivatives of first order only"):
        jax.grad(jax.grad(temperature_rate))(100.0, 0.0)


def joint() -> Plant:
    return dataclasses.replace(plants.rotary(), mechanism=Joint(Pulley(0.02, 1e-4, 1e-2), Link(0.05, 0.08)))


@pytest.mark.slow
@pytest.mark.parametrize(
    ("kind", "plant"),
    [("rotary", lambda: plants.rotary(2e-4, 2e-3)), ("rotary", joint), ("limb", lambda: plants.limb(False))],
)
def test_the_implicit_step_converges_to_the_equation_of_motion(kind, plant):
    plant, recording = plant(), plants.inputs(kind, 40, 0.1)
    exact = simulate(plant, discretise(plant, recording), solver=dfx.Tsit5())
    moved = {channel: np.asarray(exact.channels[channel]) for channel in ("angle", "torque")}
    errors = []
    for step in (0.005, 0.00125):
        result = simulate(plant, discretise(plant, recording, step=step))
        errors.append([np.max(np.abs(result.channels[c] - moved[c])) / np.ptp(moved[c]) for c in moved])
    assert np.max(errors[1]) < 0.02, errors
    assert errors[1][0] < 2e-3 and errors[1][0] < 0.25 * errors[0][0], errors


@pytest.mark.slow
def test_an_implicit_solver_of_diffrax_solves_the_equation_of_motion():
    plant, recording = plants.rotary(2e-4, 2e-3), plants.inputs("rotary", 40, 0.1)
    results = [simulate(plant, discretise(plant, recording), solver=s) for s in (dfx.Tsit5(), dfx.Kvaerno5())]
    angles = [np.asarray(r.channels["angle"]) for r in results]
    assert np.ptp(angles[0]) > 0.02
    np.testing.assert_allclose(angles[1], angles[0], atol=1e-4 * np.ptp(angles[0]))


@pytest.fixture(scope="module")
def lagoudas_inputs():
    """A wire of Lagoudas' law, and a current that makes partial loops."""
    plant = with_part(material=Lagoudas(**LAGOUDAS, n1=0.5, n2=0.6, n3=0.7, n4=0.4))
    time = np.arange(0.0, 13.0, 0.1)
    current = 0.26 + 0.06 * np.sin(2.0 * np.pi * time / 9.0) + 0.06 * np.sin(2.0 * np.pi * time / 2.1)
    return plant, plants.recording({"current": current}, time)


@pytest.mark.slow
@pytest.mark.parametrize("solver", [dfx.Tsit5(), dfx.Kvaerno3()])
def test_fractions_on_the_surface_of_a_driving_force_follow_the_differential_equation(solver, lagoudas_inputs):
    plant, recording = lagoudas_inputs
    exact = simulate(plant, discretise(plant, recording), solver=solver)
    implicit = simulate(plant, recording, step=0.01)
    martensite = np.asarray(exact.state.fractions.martensite)[:, 0]
    turns = np.flatnonzero(np.diff(np.sign(np.diff(martensite)[np.abs(np.diff(martensite)) > 1e-4])))
    assert len(turns) >= 2 and np.ptp(martensite) > 0.5
    for channel, bound in (("temperature", 5e-3), ("displacement", 3e-6)):
        assert np.max(np.abs(np.asarray(implicit.channels[channel] - exact.channels[channel]))) < bound, channel


@pytest.mark.slow
@pytest.mark.parametrize("mode", [jax.grad, jax.jacfwd])
@pytest.mark.parametrize(
    ("kind", "plant"),
    [("dead_weight", lambda: with_part(material=Lagoudas(**LAGOUDAS))), ("rotary", lambda: plants.rotary(2e-4, 2e-3))],
)
def test_inaccurate_derivatives_are_refused(mode, kind, plant):
    plant, inputs = plant(), plants.inputs(kind, 20, 0.1)
    grid = discretise(plant, inputs)

    def last_temperature(h0):
        made = parameters.replace(plant, {"heat.h0": h0})
        return jnp.sum(simulate(made, grid, solver=dfx.Tsit5()).state.temperature[-1])

    with pytest.raises(DerivativeError, match="no derivatives for a material law with driving forces or.* leave out"):
        mode(last_temperature)(100.0)


@pytest.mark.slow
def test_no_transformation_is_passed_by_a_long_step():
    """A wire is warmed from below its transformation to above it between two samples."""
    plant, recording = plants.rotary(2e-4, 2e-3), plants.inputs("rotary", 12, 0.2)
    exact = simulate(plant, discretise(plant, recording), solver=dfx.Tsit5())
    implicit = simulate(plant, recording, step=0.002)
    angle = np.asarray(implicit.channels["angle"])
    assert np.ptp(angle) > 0.3
    np.testing.assert_allclose(exact.channels["angle"], angle, atol=5e-3 * np.ptp(angle))


@pytest.mark.slow
def test_latent_heat_and_a_second_node_are_part_of_the_differential_equation():
    text = (data_path("recordings", "dead-weight") / "rig.toml").read_text("utf-8")
    effects = '\n[effects.latent-heat]\nstrength = "60 MJ/m^3"\n[effects.coating]\nstrength = "0.5"\n'
    rig = parse_rig(text + effects)
    recording = rig.read(data_path("recordings", "dead-weight") / "train.csv").slice(0.0, 4.0)
    exact = simulate(rig.plant, discretise(rig.plant, recording), solver=dfx.Tsit5())
    implicit = simulate(rig.plant, recording, step=0.01)
    for channel, scale in (("temperature", 100.0), ("displacement", 0.01)):
        difference = np.asarray(implicit.channels[channel] - exact.channels[channel])
        assert np.max(np.abs(difference)) < 1e-4 * scale, channel
    assert np.ptp(np.asarray(exact.channels["temperature"])) > 20.0


@pytest.mark.parametrize(
    ("plant", "reason"),
    [
        (plants.light_rotary, "the mechanism has play between two slack wires"),
        (lambda: plants.rotary(0.0, 2e-4), "the mechanism has an inertia of 0"),
        (plants.limb, "dry friction in a sheath"),
        (lambda: without_inertia(plants.limb(False)), "the mechanism has an inertia of 0"),
        (lambda: with_effect("coulomb-friction", "5 MPa"), "the effect 'coulomb-friction' has dry friction"),
        (lambda: with_effect("backlash", "0.1 mm"), "the effect 'backlash' has play"),
        (lambda: with_effect("viscous-friction", "1 MPa s"), "the effect 'viscous-friction' has a drag"),
        (lambda: with_part(effects=(Quantisation(0.01),)), "the effect 'quantisation' has rounded readings"),
        (lambda: with_effect("slip", "1 %"), "the effect 'slip' has a memory of the highest stress"),
        (lambda: with_part(effects=(SpecimenLag(1.0),)), "the effect 'specimen-lag' has a thermometer that lags"),
        (lambda: with_part(mechanism=Moving(load=Load(0.2))), "the mechanism has a state of motion whose rates"),
    ],
)
def test_a_plant_without_a_vector_field_is_refused(plant, reason):
    made = plant()
    with pytest.raises(InputError, match=f"{reason}.*no vector field for a diffrax solver: leave out solver="):
        check_vector_field(made)


def test_a_plant_with_a_vector_field_passes_the_check():
    assert check_vector_field(read_rig(data_path("recordings", "dead-weight") / "rig.toml").plant) is None


class Moving(DeadWeight):
    """A mechanism that says nothing of the rates of its motion."""

    obstacle_to_rates = AbstractMechanism.obstacle_to_rates


def without_inertia(plant: Plant) -> Plant:
    return parameters.replace(plant, {"pulley.inertia": 0.0})


def with_part(**parts):
    return dataclasses.replace(plants.dead_weight(), **parts)


def with_effect(key: str, strength: str):
    text = (data_path("recordings", "dead-weight") / "rig.toml").read_text("utf-8")
    return parse_rig(text + f'\n[effects.{key}]\nstrength = "{strength}"\n').plant
