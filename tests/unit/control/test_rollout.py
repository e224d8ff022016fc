"""The public rollout and loop: defaults, one period for all parts, status, and derivatives in both modes."""

import dataclasses
from typing import Literal

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import optimistix
import pytest

from smajax.control.controllers.base import AbstractController
from smajax.control.controllers.pid import PID
from smajax.control.estimators.extended_kalman_filter import ExtendedKalmanFilter
from smajax.control.estimators.thermal_observer import ThermalObserver, UnstableObserverError
from smajax.control.loop import Allocation, ClosedLoop, Rollout, Scenario, TemperatureLimiter, rollout
from smajax.control.loop.gains import with_gains
from smajax.control.sampled_plant import SampledPlant
from smajax.control.sensors import Instruments, ideal_sensor
from smajax.control.sensors.sensor_model import SensorModel
from smajax.control.tuning.problem import TuningProblem
from smajax.errors import InputError, NumericsError
from smajax.files.rig_file import read_rig
from smajax.simulation.status import SimulationStatus
from tests.conftest import ROOT
from tests.unit.control.test_control import pid

PERIOD = 0.1
REFERENCE = np.full(20, 1e-3)


@pytest.fixture(scope="module")
def plant():
    return read_rig(ROOT / "data" / "recordings" / "dead-weight" / "rig.toml").plant


@pytest.fixture(scope="module")
def sampled(plant):
    return SampledPlant.of(plant, PERIOD)


def loop_of(dt=PERIOD, **options) -> ClosedLoop:
    return ClosedLoop(pid(400.0, 50.0, 0.0, low=0.0, high=1.0, dt=dt), channel="displacement", **options)


@pytest.mark.parametrize("a2", [0.1, np.nan])
def test_an_observer_that_heats_the_wire_without_power_is_refused(a2):
    with pytest.raises(
        InputError, match=r"^ThermalObserver: a2 = (0.1|nan) would heat the wire without power: give a heat"
    ):
        ThermalObserver(*map(jnp.asarray, (12.0, a2, 1.0, 20.0, 0.2)), period=0.05)


@pytest.mark.slow
def test_a_plant_and_a_reference_are_enough(plant, sampled):
    """The defaults are an exact sensor, no limiter, no allocation, and rest at the channel's own value."""
    result = rollout(plant, loop_of(), REFERENCE)
    rest = float(sampled.observe(sampled.start(), jnp.zeros(1))["displacement"])
    explicit = rollout(
        sampled, loop_of(allocation=Allocation(jnp.asarray(1.0), jnp.asarray(0.0))), Scenario.noiseless(REFERENCE, rest)
    )
    assert isinstance(result, Rollout) and result.command.shape == (20, 1)
    np.testing.assert_array_equal(result.channels["displacement"], explicit.channels["displacement"])
    assert int(result.status) == SimulationStatus.done and float(jnp.ptp(result.channels["displacement"])) > 1e-6
    assert float(jnp.max(rollout(plant, loop_of(limits=(0.0, 0.2)), REFERENCE).command)) == 0.2


def test_two_wires_get_an_allocation_by_themselves():
    plant = read_rig(ROOT / "data" / "recordings" / "rotary" / "rig.toml").plant
    controller = pid(3.0, 4.0, 0.0, low=-0.4, high=0.7, dt=PERIOD)
    result = rollout(plant, ClosedLoop(controller, channel="angle"), np.radians([5.0, 5.0, -5.0, -5.0]))
    assert result.command.shape == (4, 2) and float(result.command[0, 0]) > 0.0 and float(result.command[3, 1]) > 0.0
    assert ClosedLoop(controller, channel="angle").for_wires(2).max_commands.tolist() == [0.7, 0.4]
    one = ClosedLoop(controller, Allocation(jnp.asarray(0.7), jnp.asarray(0.0)), channel="angle")
    with pytest.raises(InputError, match="the plant has 2 wires, and the loop is for 1"):
        rollout(plant, one, np.zeros(3))
    pair = Allocation(jnp.asarray(0.7), jnp.asarray(0.0), 2)
    for loop in (ClosedLoop(controller, allocation, channel="angle", limits=(0.0, 0.7)) for allocation in (None, pair)):
        with pytest.raises(
            InputError, match="limited to 0 to 0.7, and .* below 0 the second: give a lower limit below"
        ):
            rollout(plant, loop, np.zeros(3))


def test_all_parts_have_one_period(plant, sampled):
    other = pid(0.05, 0.0, 0.0, tf=0.0, low=0.0, high=0.5, dt=0.05)
    cure = "and the controller one of 0.1 s: build both with the same period"
    with pytest.raises(InputError, match=f"the temperature limiter has a period of 0.05 s, {cure}"):
        loop_of(temperature_limiter=TemperatureLimiter(other, jnp.asarray(90.0)))
    with pytest.raises(InputError, match=f"the instruments has a period of 0.05 s, {cure}"):
        loop_of(instruments=Instruments({"temperature": ideal_sensor()}, 0.05))
    observer = ThermalObserver(*map(jnp.asarray, (12.0, -0.9, 1.0, 20.0, 0.2)), period=0.05)
    with pytest.raises(InputError, match=f"the estimator has a period of 0.05 s, {cure}"):
        loop_of(estimator=observer)
    for run in (
        lambda: rollout(SampledPlant.of(plant, 0.05), loop_of(), REFERENCE),
        lambda: TuningProblem.of(
            SampledPlant.of(plant, 0.05), loop_of(), Scenario.noiseless(REFERENCE), {"kp": (1.0, 100.0)}
        ),
    ):
        with pytest.raises(InputError, match=f"the plant has a period of 0.05 s, {cure}"):
            run()
    with pytest.raises(InputError, match=f"the rollout has a period of 0.2 s, {cure}"):
        rollout(plant, loop_of(), REFERENCE, period=0.2)
    noisy = Instruments({"voltage": SensorModel(jnp.asarray(1e-3), jnp.asarray(0.0))}, 0.05)
    with pytest.raises(
        InputError, match="the plant of the filter has a period of 0.1 s, and the instruments one of 0.05 s"
    ):
        ExtendedKalmanFilter.of(sampled, noisy, {})


def test_mistakes_are_named(plant):
    with pytest.raises(InputError, match="the plant has no channel 'displacment' .did you mean 'displacement'"):
        rollout(plant, ClosedLoop(pid(dt=PERIOD), channel="displacment"), REFERENCE)
    with pytest.raises(InputError, match="the plant has no channel 'displacment' .did you mean 'displacement'"):
        rollout(plant, ClosedLoop(pid(dt=PERIOD), channel="displacment"), Scenario.noiseless(REFERENCE, 0.0))
    with pytest.raises(InputError, match="the first command has to be below the second"):
        loop_of(limits=(0.5, 0.1))
    with pytest.raises(InputError, match="give one value for each sample"):
        rollout(plant, loop_of(), 1e-3)
    with pytest.raises(InputError, match="the number of steps in a period cannot depend on a traced plant: give step"):
        jax.eval_shape(
            lambda mass: rollout(eqx.tree_at(lambda p: p.mechanism.load.mass, plant, mass), loop_of(), REFERENCE), 0.2
        )


@pytest.mark.parametrize(
    ("current", "status", "sentence"),
    [
        (5.0, SimulationStatus.overheated, "rollout: overheated: the wire exceeded 1300 degC, where it melts"),
        (60.0, SimulationStatus.diverged, "rollout: diverged: the state became NaN or infinite"),
    ],
)
def test_a_failed_rollout_raises_or_carries_its_status(sampled, current, status, sentence):
    loop = ClosedLoop(pid(1e6, 0.0, 0.0, low=0.0, high=current, dt=PERIOD), channel="displacement")
    assert int(rollout(sampled, loop, REFERENCE, throw=False).status) == status
    with pytest.raises(NumericsError, match=f"^{sentence}"):
        rollout(sampled, loop, REFERENCE)
    batch = jax.vmap(
        lambda high: rollout(
            sampled, loop.__class__(loop.controller.with_limits(jnp.zeros(()), high), channel="displacement"), REFERENCE
        )
    )(jnp.asarray([0.3, current]))
    assert batch.status.tolist() == [SimulationStatus.done, status]


def last_position(sampled):
    def position(numbers):
        system = sampled.with_parameters({"load.mass": numbers[1]})
        return rollout(system, with_gains(loop_of(), {"kp": numbers[0]}), REFERENCE).channels["displacement"][-1]

    return position


@pytest.mark.slow
def test_derivatives_in_both_modes_are_those_of_differences(sampled):
    """With respect to a gain and a parameter of the plant, under jit; and the same from a plant that is not sampled."""
    position, at = last_position(sampled), jnp.asarray([400.0, 0.2])
    value = jax.jit(position)
    steps = np.diag([0.1, 1e-5])
    central = np.array([(value(at + h) - value(at - h)) / (2.0 * np.sum(h)) for h in steps])
    for derivative in (jax.jit(jax.grad(position)), jax.jit(jax.jacfwd(position))):
        np.testing.assert_allclose(derivative(at), central, rtol=1e-3)
    assert np.all(np.abs(central) > 1e-10)

    def from_plant(mass):
        plant = eqx.tree_at(lambda p: p.mechanism.load.mass, sampled.plant, mass)
        return rollout(plant, loop_of(), REFERENCE, step=PERIOD / sampled.substeps).channels["displacement"][-1]

    np.testing.assert_allclose(jax.jit(jax.grad(from_plant))(0.2), central[1], rtol=1e-3)


def test_gains_are_batched_by_vmap(sampled):
    gains = jnp.asarray([200.0, 300.0, 400.0])
    batch = jax.vmap(lambda kp: rollout(sampled, with_gains(loop_of(), {"kp": kp}), REFERENCE))(gains)
    for kp, values in zip(gains, batch.channels["displacement"], strict=True):
        single = rollout(sampled, with_gains(loop_of(), {"kp": kp}), REFERENCE)
        np.testing.assert_allclose(values, single.channels["displacement"], rtol=1e-9)
    assert batch.status.tolist() == [0, 0, 0]


@pytest.mark.slow
def test_a_batch_that_was_traced_before_is_differentiable(sampled):
    """As in the solvers of optimistix, which trace their function once and differentiate the traced program."""
    gains = jnp.asarray([200.0, 300.0])

    def errors(numbers, _):
        def error(kp):
            result = rollout(sampled, with_gains(loop_of(), {"kp": numbers[0] * kp}), REFERENCE)
            return jnp.mean((result.channels["displacement"] - REFERENCE) ** 2)

        return 1e6 * jnp.mean(jax.vmap(error)(gains))

    start = jnp.asarray([0.5])
    found = optimistix.minimise(errors, optimistix.BFGS(1e-3, 1e-3), start, max_steps=8, throw=False).value
    assert errors(found, None) < errors(start, None)


@pytest.mark.slow
@pytest.mark.parametrize("second", [jax.grad, jax.jacfwd])
@pytest.mark.parametrize("first", [jax.grad, jax.jacfwd])
def test_a_second_derivative_raises(sampled, first, second):
    position = last_position(sampled)
    with pytest.raises(InputError, match="derivatives of first order only"):
        second(lambda x: jnp.sum(first(position)(x)))(jnp.asarray([400.0, 0.2]))


@pytest.mark.parametrize(
    ("numbers", "cause"),
    [
        ((12.0, -30.0, 1.0, 20.0, 0.2), "a2"),
        ((12.0, -0.9, 1.0, 20.0, 30.0), "gain"),
        ((12.0, -0.9, 2.0, 20.0, 30.0), "gain"),
    ],
)
def test_an_unstable_observer_is_refused(numbers, cause):
    with pytest.raises(
        UnstableObserverError, match=f"the thermal observer's {cause} acts faster than its period of 0.1 s"
    ) as raised:
        ThermalObserver(*map(jnp.asarray, numbers), period=PERIOD)
    assert raised.value.longest_period < PERIOD


def test_a_nonlinear_observer_has_to_be_stable_up_to_the_limit():
    limiter = TemperatureLimiter(pid(0.05, 0.0, 0.0, tf=0.0, low=0.0, high=0.5, dt=PERIOD), jnp.asarray(90.0))
    observer = ThermalObserver(*map(jnp.asarray, (12.0, -0.1, 2.0, 20.0, 0.2)), period=PERIOD)
    with pytest.raises(UnstableObserverError, match="a2 acts faster"):
        loop_of(temperature_limiter=limiter, estimator=observer)
    assert (
        loop_of(temperature_limiter=limiter, estimator=dataclasses.replace(observer, a2=jnp.asarray(-0.01))).wires == 1
    )


def test_limits_of_a_controller_without_a_pid():
    class Constant(AbstractController):
        lower: jax.Array
        upper: jax.Array
        period: float = eqx.field(static=True)

        def reset(self, reference, value):
            return ()

        def step(self, state, reference, value):
            return state, self.upper

    constant = Constant(jnp.zeros(()), jnp.asarray(0.3), PERIOD)
    limited = constant.with_limits(jnp.asarray(0.1), jnp.asarray(0.2))
    assert [float(v) for v in limited.limits] == [0.1, 0.2] and constant.constants() == {}


def test_a_reference_of_single_precision_is_refused(plant):
    single = REFERENCE.astype(np.float32)
    with pytest.raises(InputError, match="^reference is of float32 and smajax needs double precision"):
        rollout(plant, loop_of(), single)
    with pytest.raises(InputError, match="^initial_reference is of float32"):
        rollout(plant, loop_of(), REFERENCE, initial_reference=jnp.float32(0.0))
    with pytest.raises(InputError, match=r"^changes\['environment.ambient'\] is of float32"):
        Scenario.noiseless(REFERENCE, 0.0, {"environment.ambient": single})


@pytest.mark.parametrize(
    ("fields", "sentence"),
    [
        ({"period": 0.0}, "PID: period = 0 s is not possible: give a time above 0 s"),
        ({"period": -0.1}, "PID: period = -0.1 s is not possible: give a time above 0 s"),
        ({"lower": 0.5, "upper": 0.4}, "PID: lower = 0.5 is above upper = 0.4: exchange the two"),
    ],
)
def test_a_controller_of_python_is_checked_like_one_of_a_file(fields, sentence):
    with pytest.raises(InputError, match=sentence):
        PID(**{"kp": 2.0, "period": 0.1, **fields})


class Switched(PID):
    """The types of smajax's own classes are checked before, by the import hook of the tests."""

    mode: Literal["fast", "slow"] = eqx.field(static=True, kw_only=True, default="fast")


def test_an_option_of_a_controller_is_one_of_its_choices():
    sentence = r"Switched: mode = 'slw' is not known \(did you mean 'slow'\?\): give one of 'fast', 'slow'"
    with pytest.raises(InputError, match=sentence):
        Switched(kp=2.0, period=0.1, mode="slw")
