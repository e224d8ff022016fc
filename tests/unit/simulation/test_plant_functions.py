"""Simulation and single steps in loops of one's own: derivatives in both modes, batches, and refusals in words."""

import dataclasses

import diffrax
import jax
import jax.numpy as jnp
import numpy as np
import pytest

from smajax import parameters
from smajax.errors import DerivativeError, InputError, NumericsError
from smajax.files.rig_file import read_rig
from smajax.plant.wire import Wire
from smajax.recordings.datasets import data_path
from smajax.simulation.inputs import discretise
from smajax.simulation.plant_functions import init, observe, step
from smajax.simulation.run import simulate
from smajax.simulation.status import SimulationStatus
from tests.support import plants

STEPS = 20
DEAD_WEIGHT = data_path("recordings", "dead-weight")
DT = 0.05


@pytest.fixture(scope="module")
def plant():
    return plants.bias_spring()


@pytest.fixture(scope="module")
def recording():
    return plants.inputs("bias_spring", 30, 0.15)


@pytest.fixture(scope="module")
def inputs(plant, recording):
    return discretise(plant, recording)


def difference_quotient(function, at, width):
    return (function(at + width) - function(at - width)) / (2.0 * width)


@pytest.fixture(scope="module")
def own_loop(plant):
    """The displacement after some steps of a loop of one's own, as a function of h0 and of the voltage."""

    @jax.jit
    def displacement(values):
        h0, voltage = values
        heated, signal = parameters.replace(plant, {"heat.h0": 100.0 * h0}), jnp.asarray([1.5]) * voltage

        def advance(state, _):
            state, info = step(heated, state, signal, DT)
            return state, info.status

        state, status = jax.lax.scan(advance, init(heated, signal), None, length=STEPS)
        channels = observe(heated, state, signal)
        return jnp.where(jnp.max(status) == SimulationStatus.done, 1e3 * channels["displacement"], jnp.nan)

    return displacement


@pytest.mark.slow
def test_a_loop_over_steps_has_its_gradient_in_both_modes(own_loop):
    at = jnp.asarray([1.0, 1.0])
    forward, reverse = jax.jit(jax.jacfwd(own_loop))(at), jax.jit(jax.jacrev(own_loop))(at)
    assert np.asarray(forward) == pytest.approx(np.asarray(reverse), rel=1e-10)
    for k in (0, 1):
        width = 1e-5 * jnp.eye(2)[k]
        numeric = float(own_loop(at + width) - own_loop(at - width)) / 2e-5
        assert float(forward[k]) == pytest.approx(numeric, rel=1e-5)
        assert abs(numeric) > 1e-3


@pytest.mark.slow
def test_a_loop_over_steps_is_mapped(own_loop):
    at = jnp.asarray([[0.8, 1.0], [1.2, 1.1]])
    batch = jax.vmap(own_loop)(at)
    assert np.asarray(batch) == pytest.approx([float(own_loop(row)) for row in at], rel=1e-9)


@pytest.mark.parametrize(
    "twice",
    [
        lambda f: jax.jacfwd(jax.jacfwd(f)),
        lambda f: jax.jacrev(jax.jacrev(f)),
        lambda f: jax.jacfwd(jax.jacrev(f)),
        lambda f: jax.jacrev(jax.jacfwd(f)),
    ],
)
def test_a_second_derivative_of_a_step_is_refused(own_loop, twice):
    with pytest.raises(DerivativeError, match="derivatives of first order only"):
        twice(own_loop)(jnp.asarray([1.0, 1.0]))


def test_the_search_of_a_step_has_no_derivative(plant):
    signal = jnp.asarray([1.5])

    def temperature(voltage):
        state = plant.init(signal)
        return plant.solve_step(state, voltage * signal, voltage * signal, jnp.asarray(DT))[0].temperature[0]

    with pytest.raises(DerivativeError, match=r"use Plant\.step"):
        jax.grad(temperature)(1.0)


@pytest.mark.slow
def test_steps_are_those_of_the_simulation(plant, recording):
    inputs = discretise(plant, recording, step=0.15)
    result = simulate(plant, inputs)
    state = init(plant, inputs.sample_signals[0])
    assert state.temperature[0] == result.state.temperature[0]
    for k in range(3):
        state, info = jax.jit(step)(plant, state, inputs.after[k], inputs.time[k + 1] - inputs.time[k])
        assert int(info.status) == SimulationStatus.done
    assert float(state.temperature[0]) == pytest.approx(float(result.state.temperature[3, 0]), rel=1e-12)


def test_a_step_reports_its_failure(plant):
    signal = jnp.asarray([500.0])
    _, info = jax.jit(step)(plant, init(plant, signal), signal, 1.0)
    assert int(info.status) != SimulationStatus.done


@pytest.mark.slow
def test_a_peak_temperature_has_its_gradient_in_the_amplitude_of_the_input(plant, recording, inputs):
    def peak(amplitude):
        return jnp.max(simulate(plant, inputs.scale(amplitude)).channels["temperature"])

    numeric = float(difference_quotient(peak, 1.0, 1e-5))
    assert float(jax.grad(peak)(1.0)) == pytest.approx(numeric, rel=1e-5)
    assert float(jax.jit(jax.jacfwd(peak))(1.0)) == pytest.approx(numeric, rel=1e-5)
    for twice in (jax.grad(jax.grad(peak)), jax.jacfwd(jax.jacfwd(peak)), jax.hessian(peak)):
        with pytest.raises(DerivativeError, match="simulate has derivatives of first order only"):
            twice(1.0)


@pytest.mark.slow
def test_a_simulation_is_compiled_mapped_and_differentiated_in_a_parameter(plant, recording, inputs):
    def response(h0, driven=inputs, **options):
        return simulate(parameters.replace(plant, {"heat.h0": h0}), driven, **options).channels["displacement"]

    h0 = jnp.asarray([90.0, 110.0])
    batch = jax.jit(jax.vmap(response))(h0)
    for row, value in zip(batch, h0, strict=True):
        assert np.asarray(row) == pytest.approx(np.asarray(response(value)), abs=1e-12)
    # The grid of a recording is no function of the parameters: differentiation may make it, a batch may not.
    forward = jax.jacfwd(response)(h0[0])
    assert np.asarray(jax.jacfwd(lambda h: response(h, recording))(h0[0])) == pytest.approx(np.asarray(forward))
    with pytest.raises(InputError, match="call discretise outside jit and vmap, or give step="):
        jax.jit(lambda h: response(h, recording))(h0[0])
    compiled = jax.jit(lambda h: response(h, recording, step=0.15))(h0[0])
    assert np.asarray(compiled) == pytest.approx(np.asarray(response(h0[0])), abs=1e-5)


@pytest.mark.slow
def test_a_failure_is_raised_or_reported(plant, inputs):
    hot = inputs.scale(100.0)
    with pytest.raises(NumericsError, match=r"simulate: \w+: .*; parameters: "):
        simulate(plant, hot)
    assert int(simulate(plant, hot, throw=False).status) != SimulationStatus.done
    assert int(jax.jit(simulate)(plant, hot).status) != SimulationStatus.done


def test_a_missing_channel_is_named_with_the_cure(plant, recording):
    other = plants.recording({"current": recording.channels["voltage"]}, recording.time)
    with pytest.raises(InputError, match=r"there is no channel 'voltage'.*add a column 'voltage'"):
        discretise(plant, other)
    with pytest.raises(InputError, match="interpolation = 'cubic' is not known"):
        discretise(plant, recording, interpolation="cubic")


def test_what_does_not_fit_is_named(plant, inputs):
    signal = jnp.asarray([1.5])
    state = init(plant, signal)
    # One value for the voltage, and at most two more for the surroundings.
    with pytest.raises(InputError, match=r"signal has shape \(4,\): give one value for each of voltage"):
        step(plant, state, jnp.ones(4), DT)
    with pytest.raises(InputError, match="signal is of float32"):
        step(plant, state, signal.astype(jnp.float32), DT)
    with pytest.raises(InputError, match=r"inputs\.before is of float32"):
        simulate(plant, dataclasses.replace(inputs, before=inputs.before.astype(jnp.float32)))
    with pytest.raises(InputError, match="factor is of float32"):
        inputs.scale(jnp.float32(1.1))
    with pytest.raises(InputError, match="a parameter is an array of float32"):
        Wire(jnp.float32(1e-4), 0.1)
    with pytest.raises(InputError, match="the inputs have 1 signals and the plant is driven by current_1, current_2"):
        simulate(plants.light_rotary(), inputs)


def test_options_that_do_not_apply_are_refused(plant, inputs):
    with pytest.raises(InputError, match="simulate: the inputs are on a grid already: give step and interpolation to"):
        simulate(plant, inputs, step=0.01)
    with pytest.raises(InputError, match="simulate: the inputs are on a grid already"):
        simulate(plant, inputs, interpolation="hold")
    with pytest.raises(InputError, match="simulate: adjoint belongs to a diffrax solver"):
        simulate(plant, inputs, adjoint=diffrax.ForwardMode())


@pytest.mark.parametrize("function", [simulate, discretise])
def test_the_help_says_how_to_differentiate_in_the_inputs(function):
    assert "``Inputs.scale``" in function.__doc__


@pytest.mark.slow
def test_a_plant_of_a_rig_simulates_a_recording_as_its_rig_does():
    linear = read_rig(DEAD_WEIGHT / "rig.toml")
    recording = linear.read(DEAD_WEIGHT / "train.csv").slice(0.0, 6.0)
    assert linear.interpolation == linear.plant.interpolation == "linear"
    held = dataclasses.replace(linear, interpolation="hold")
    for rig in (linear, held):
        whole = simulate(rig.plant, recording, interpolation=rig.interpolation)
        alone = simulate(rig.plant, recording)
        by_hand = simulate(rig.plant, discretise(rig.plant, recording))
        for response in (alone, by_hand):
            np.testing.assert_array_equal(response.channels["displacement"], whole.channels["displacement"])
    motions = [simulate(rig.plant, recording).channels["displacement"] for rig in (linear, held)]
    assert np.max(np.abs(motions[0] - motions[1])) > 1e-6
    # A plant of another origin takes the interpolation of the rig that it is put into.
    other = dataclasses.replace(linear, plant=dataclasses.replace(linear.plant, interpolation="hold"))
    assert other.plant.interpolation == "linear"
    with pytest.raises(InputError, match="interpolation = 'cubic' is not known: it is 'hold' or 'linear'"):
        dataclasses.replace(linear.plant, interpolation="cubic")
