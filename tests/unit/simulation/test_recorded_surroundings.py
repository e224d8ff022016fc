"""Recorded ambient temperature: the heat balance follows it, and a plant without the column is as before."""

import dataclasses

import diffrax as dfx
import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scipy.integrate import solve_ivp

from smajax import parameters
from smajax.errors import InputError
from smajax.files.rig_file import parse_rig
from smajax.fitting.fit import fit
from smajax.plant.convection import PolynomialConvection
from smajax.plant.drive import PowerDrive
from smajax.plant.effects.coating import Coating
from smajax.plant.effects.end_conduction import EndConduction
from smajax.plant.effects.fan_cooling import FanCooling
from smajax.plant.effects.temperature_distribution import TemperatureDistribution
from smajax.recordings.recording import Recording
from smajax.simulation.inputs import discretise, recorded_surroundings
from smajax.simulation.plant_functions import init, step
from smajax.simulation.run import simulate, simulate_channels
from tests.support import plants

H0, H2, CAPACITY = 60.0, 0.004, 2.05e6
DIAMETER, LENGTH = 0.15e-3, 0.23
TIME = np.arange(0.0, 30.0, 0.2)
POWER = np.where((TIME > 3.0) & (TIME < 12.0), 0.15, 0.0)
RAMP = np.interp(TIME, [0.0, 5.0, 25.0, 30.0], [20.0, 20.0, 32.0, 32.0])


def plant(*effects):
    heat = PolynomialConvection(h0=H0, h2=H2, capacity_austenite=CAPACITY, capacity_martensite=CAPACITY)
    return dataclasses.replace(plants.dead_weight(), drive=PowerDrive(), heat=heat, effects=effects)


def recording(ambient=RAMP, power=POWER, name="recording"):
    return Recording.from_arrays(name, TIME, {"power": power} | ({} if ambient is None else {"ambient": ambient}))


FAN = np.where((TIME > 6.0) & (TIME < 20.0), 0.6, 0.0)


def conductance(temperature):
    return 4.0 / DIAMETER * (H0 + H2 * temperature**2)


def lumped_wire(ambient, strength=0.0, time_constant=1.0, share=1.0, rise=None):
    """Temperatures by SciPy, segment by segment: the wire, and a node that takes ``strength`` times its conductance.

    ``rise`` is the rise of the convection coefficient, as a factor, by segment.
    """
    rise = np.zeros(len(TIME)) if rise is None else rise
    volume = np.pi / 4 * DIAMETER**2 * LENGTH
    state, temperatures = np.array([ambient[0], ambient[0]]), [ambient[0]]
    for k in range(len(TIME) - 1):
        begin, end = TIME[k], TIME[k + 1]
        power, first, last = POWER[k], ambient[k], ambient[k + 1]

        def rates(t, y, begin=begin, end=end, power=power, first=first, last=last, forced=1.0 + rise[k]):
            around = first + (last - first) * (t - begin) / (end - begin)
            flow = strength * conductance(around) * (y[0] - y[1])
            wire = (power / volume - forced * conductance(y[0]) * (y[0] - around) - flow) / CAPACITY
            return [wire, (around + share * (y[0] - around) - y[1]) / time_constant]

        state = solve_ivp(rates, (begin, end), state, rtol=1e-10, atol=1e-10).y[:, -1]
        temperatures.append(state[0])
    return np.array(temperatures)


@pytest.mark.slow
def test_the_wire_follows_a_ramp_of_the_ambient_temperature():
    response = simulate(plant(), recording(), step=0.05)
    np.testing.assert_allclose(response.channels["temperature"], lumped_wire(RAMP), atol=2e-5)
    constant = simulate(plant(), recording(None), step=0.05).channels["temperature"]
    assert np.max(np.abs(constant - response.channels["temperature"])) > 5.0


@pytest.mark.slow
@pytest.mark.parametrize(("effect", "share"), [(Coating, 1.0), (EndConduction, 0.5)])
def test_a_second_thermal_node_follows_the_ambient_temperature(effect, share):
    node = effect(strength=jnp.asarray(0.4), time_constant=jnp.asarray(2.5))
    response = simulate(plant(node), recording(), step=0.02)
    exact = lumped_wire(RAMP, 0.4, 2.5, share)
    np.testing.assert_allclose(response.channels["temperature"], exact, atol=2e-3)


@pytest.mark.slow
@pytest.mark.parametrize("exponent", [0.5, 0.8])
@pytest.mark.parametrize("ambient", [RAMP, None])
def test_a_recorded_fan_cools_the_wire(exponent, ambient):
    fan = FanCooling(strength=jnp.asarray(2.0), exponent=jnp.asarray(exponent))
    base = recording(ambient)
    driven = dataclasses.replace(base, channels={**base.channels, "fan": FAN})
    response = simulate(plant(fan), driven, step=0.05)
    around = np.full(len(TIME), 20.0) if ambient is None else ambient
    exact = lumped_wire(around, rise=2.0 * FAN**exponent)
    np.testing.assert_allclose(response.channels["temperature"], exact, atol=5e-4)
    without = simulate(plant(fan), base, step=0.05).channels["temperature"]
    np.testing.assert_allclose(without, simulate(plant(), base, step=0.05).channels["temperature"], rtol=1e-12)


@pytest.mark.slow
def test_derivatives_of_the_fan_agree_with_finite_differences():
    base = recording()
    inputs = discretise(plant(), dataclasses.replace(base, channels={**base.channels, "fan": FAN}))
    fan = FanCooling(strength=jnp.asarray(0.0))

    def last(theta):
        values = {"effects.fan-cooling.strength": theta[0], "effects.fan-cooling.exponent": theta[1]}
        return simulate_channels(parameters.replace(plant(fan), values), inputs, ("temperature",))[0]["temperature"][58]

    run, width = jax.jit(last), 1e-4
    for point in (jnp.array([0.0, 0.7]), jnp.array([2.0, 0.7])):
        finite = [(run(point.at[i].add(width)) - run(point.at[i].add(-width))) / (2 * width) for i in range(2)]
        np.testing.assert_allclose(jax.jit(jax.jacfwd(last))(point), finite, rtol=1e-5, atol=1e-7)
        assert abs(finite[0]) > 0.1


@pytest.mark.slow
def test_the_vector_field_follows_the_ambient_temperature():
    effects = (EndConduction(strength=jnp.asarray(0.3)), TemperatureDistribution(strength=jnp.asarray(0.1)))
    implicit = simulate(plant(*effects), recording(), step=0.02)
    adaptive = simulate(plant(*effects), recording(), step=0.2, solver=dfx.Tsit5())
    np.testing.assert_allclose(implicit.channels["temperature"], adaptive.channels["temperature"], atol=2e-3)
    np.testing.assert_allclose(implicit.channels["displacement"], adaptive.channels["displacement"], atol=2e-7)


@pytest.mark.slow
def test_a_column_of_the_constant_is_the_constant():
    constant = simulate(plant(), recording(None))
    column = simulate(plant(), recording(np.full(len(TIME), 20.0)))
    for channel, values in constant.channels.items():
        np.testing.assert_allclose(column.channels[channel], values, rtol=1e-9, atol=1e-12)


def test_the_reference_of_the_thermal_strain_stays_constant():
    still = recording(np.full(len(TIME), 35.0), np.zeros(len(TIME)))
    warm, cold = plant(), parameters.replace(plant(), {"environment.ambient": 35.0})
    change = simulate(cold, still).channels["strain"][0] - simulate(warm, still).channels["strain"][0]
    # Cold martensite, whose expansion counts from environment.ambient: 15 K less of it.
    assert change == pytest.approx(-15.0 * plants.MATERIAL["thermal_expansion_martensite"], rel=1e-6)


@pytest.mark.slow
def test_the_first_row_is_at_the_recorded_ambient_temperature():
    state = init(plant(), np.array([0.0, 27.5]))
    assert float(state.temperature[0]) == 27.5
    assert float(init(plant(), np.array([0.0, np.nan])).temperature[0]) == 20.0
    end, _ = step(plant(), state, np.array([0.0, 27.5]), 1.0)
    assert float(end.temperature[0]) == pytest.approx(27.5, abs=1e-9)
    with pytest.raises(InputError, match="signal has shape"):
        init(plant(), np.zeros(4))


def test_rows_without_a_value_are_interpolated():
    gaps = RAMP.copy()
    gaps[::2] = np.nan
    gaps[[0, -1]] = RAMP[[0, -1]]
    whole, partial = (simulate(plant(), recording(a)).channels["temperature"] for a in (RAMP, gaps))
    np.testing.assert_allclose(partial, whole, atol=0.05)
    nowhere = simulate(plant(), recording(np.full(len(TIME), np.nan))).channels["temperature"]
    np.testing.assert_allclose(nowhere, simulate(plant(), recording(None)).channels["temperature"], rtol=1e-9)


def test_the_amplitude_leaves_the_ambient_temperature_as_it_is():
    inputs = discretise(plant(), recording())
    scaled = inputs.scale(0.5)
    assert inputs.surroundings == scaled.surroundings == ("ambient",)
    np.testing.assert_array_equal(scaled.after[:, 0], 0.5 * inputs.after[:, 0])
    np.testing.assert_array_equal(scaled.after[:, 1], inputs.after[:, 1])


def test_longer_and_shorter_steps_keep_the_ambient_temperature_linear():
    frost = RAMP - 25.0  # a root mean square would have a kink at 0 degC
    inputs = discretise(plant(), recording(frost))
    coarse, (fine, _) = inputs.coarsen(5, held=True), inputs.halve()
    for grid in (coarse, fine):
        assert grid.surroundings == ("ambient",)
        np.testing.assert_allclose(grid.before[1:, 1], grid.after[:-1, 1])
    np.testing.assert_allclose(coarse.before[:, 1], np.interp(coarse.time[:-1], TIME, frost), atol=1e-12)
    assert coarse.pad(400, 200).surroundings == ("ambient",)


@pytest.mark.slow
def test_derivatives_agree_with_finite_differences():
    base = discretise(plant(), recording())

    def last(theta):
        changed = parameters.replace(plant(), {"heat.h0": H0 * theta[0], "environment.ambient": 20.0 * theta[1]})

        def warmed(signals):
            return signals.at[:, 1].add(theta[2])

        inputs = eqx.tree_at(lambda i: (i.before, i.after), base, (warmed(base.before), warmed(base.after)))
        return simulate_channels(changed, inputs, ("temperature",))[0]["temperature"][80]

    point, width = jnp.array([1.0, 1.0, 0.0]), 1e-4
    run = jax.jit(last)
    finite = [(run(point.at[i].add(width)) - run(point.at[i].add(-width))) / (2 * width) for i in range(3)]
    for derivative in (jax.jit(jax.jacfwd(last))(point), jax.jit(jax.jacrev(last))(point)):
        np.testing.assert_allclose(derivative, finite, rtol=1e-5, atol=1e-7)
    assert finite[1] == 0.0  # the constant has no part in the heat balance
    assert finite[2] > 0.9


def test_a_prescribed_temperature_has_no_surroundings():
    path, cycle = plants.stress_path(), plants.inputs("stress_path", 40, 0.1)
    with_column = dataclasses.replace(cycle, channels={**cycle.channels, "ambient": np.full(len(cycle), 25.0)})
    assert recorded_surroundings(path, [with_column]) == ()
    assert "ambient" not in path.driving_channels(with_column.channels)


RIG = """
schema = 1
[rig]
kind = "dead-weight"
control = "power"
parameters = "rotary-table1"
[heat]
h0 = "45 W/m^2/K"
capacity = "2.6 MJ/m^3/K"
[wire]
diameter = "0.15 mm"
length = "230 mm"
[load]
mass = "1 kg"
[fit]
free = ["heat.h0", "heat.capacity"]
observe = ["temperature"]
starts = 1
"""


def measured(ambient, name):
    """A recording as in the case of a measured ambient: SciPy's temperatures with noise of 0.05 K."""
    noise = 0.05 * np.random.default_rng(len(name)).standard_normal(len(TIME))
    column = {} if name.startswith("without") else {"ambient": ambient}
    channels = {"power": POWER, "temperature": lumped_wire(ambient) + noise} | column
    return Recording.from_arrays(name, TIME, channels)


@pytest.mark.slow
@pytest.mark.parametrize(
    "recordings",
    [
        [("with", RAMP)],
        [("with", RAMP), ("without column", np.full(len(TIME), 20.0))],
        [("with", RAMP - 15.0), ("colder", np.linspace(15.0, -5.0, len(TIME)))],
    ],
)
def test_a_fit_recovers_the_heat_balance_in_a_room_that_warms(recordings):
    rig = parse_rig(RIG.replace("starts", 'bounds = {"heat.h0" = ["20 W/m^2/K", "200 W/m^2/K"]}\nstarts'))
    own = parameters.replace(rig.plant, {"heat.h2": H2})
    result = fit(own, [measured(ambient, name) for name, ambient in recordings], rig.fit)
    estimates = {e.name: e.estimate for e in result.estimates}
    assert estimates["heat.h0"] == pytest.approx(60.0, rel=0.01)
    assert estimates["heat.capacity"] == pytest.approx(2.05e6, rel=0.01)
    for response in result.responses:
        residual = response.recording.channels["temperature"] - response.model["temperature"]
        assert np.std(residual) == pytest.approx(0.05, rel=0.2)
