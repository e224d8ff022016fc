"""The knee of springs, motor and clutch against an integration by SciPy, and against closed forms of its parts."""

import math

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scipy.integrate import solve_ivp
from scipy.stats import qmc

from smajax import parameters
from smajax.actuators.knee import Knee
from smajax.errors import InputError
from smajax.files import actuator_file
from smajax.plant.materials.base import Fractions
from smajax.recordings.datasets import data_path
from tests.reference import knee as reference

# The springs alone, the motor alone, and both with the clutch slipping.
STATES = {
    "springs": {"second": 5.0, "first": 0.0, "motor": 0.0, "clutch": 0.0, "duration": 20.0},
    "motor": {"second": 0.0, "first": 0.0, "motor": 1.0, "clutch": 0.5, "duration": 1.0},
    "hybrid": {"second": 5.5, "first": 0.0, "motor": 2.0, "clutch": 0.01, "duration": 12.0},
}
SHARE = jnp.linspace(0.0, 1.0, 81)


@pytest.fixture(scope="module")
def knee() -> Knee:
    result = actuator_file.read_actuator(data_path("actuators", "knee", "rig.toml"))
    assert isinstance(result, Knee)
    return result


def commanded(knee: Knee, state: str) -> Knee:
    return parameters.replace(knee, {f"command.{key}": value for key, value in STATES[state].items()})


def exact(knee: Knee, **options: float) -> reference.Knee:
    return reference.Knee({n: float(parameters.get(knee, n)) for n in parameters.all_declarations(knee)}, **options)


@eqx.filter_jit
def figures(knee: Knee):
    return knee.metrics()


@eqx.filter_jit
def roll(knee: Knee):
    return knee.trajectory(SHARE)


@pytest.mark.slow
@pytest.mark.parametrize("state", STATES)
def test_agrees_with_scipy(knee, state):
    result = roll(commanded(knee, state))
    time = np.asarray(SHARE) * STATES[state]["duration"]
    true = exact(knee).roll(STATES[state], time)
    assert np.ptp(true[4]) > 0.5
    assert np.asarray(result.angle) == pytest.approx(true[4], abs=2e-4 * np.ptp(true[4]))
    assert np.asarray(result.temperature) == pytest.approx(true[:2].T, abs=1e-2)
    assert np.asarray(result.fractions.martensite) == pytest.approx(true[2:4].T, abs=1e-3)
    assert np.asarray(result.shaft_rate) == pytest.approx(true[6], abs=2e-3 * max(np.ptp(true[6]), 0.1))
    if state == "springs":
        # The time in which the fractions follow the law is too short to matter.
        quicker = exact(knee, follows=0.005).roll(STATES[state], time)
        assert quicker[4] == pytest.approx(true[4], abs=5e-3 * np.ptp(true[4]))


@pytest.mark.slow
def test_the_clutch_sticks_below_its_torque_and_slips_above(knee):
    motor, hybrid = commanded(knee, "motor"), commanded(knee, "hybrid")
    locked = exact(knee).locked(1.0, np.asarray(SHARE))
    assert np.asarray(roll(motor).angle) == pytest.approx(locked, abs=5e-3 * np.ptp(locked))
    assert float(figures(motor)["clutch_sticks"]) == 1.0 and abs(float(figures(motor)["slip"])) < 0.02
    assert float(figures(hybrid)["clutch_sticks"]) == 0.0 and float(figures(hybrid)["slip"]) > 1.0
    # The hybrid drive with a clutch that sticks: the joint moves with the motor, and a hot spring helps.
    both = parameters.replace(hybrid, {"command.clutch": 0.5, "command.motor": 0.05})
    way, alone = roll(both), roll(parameters.replace(both, {"command.second": 0.0}))
    assert float(figures(both)["clutch_sticks"]) == 1.0
    assert float(way.shaft[-1]) == pytest.approx(float(knee.clutch.belt * way.angle[-1]), rel=0.02)
    assert float(way.angle[-1]) > 1.1 * float(alone.angle[-1]) > 0.1
    passed = hybrid.clutch.transmitted_torque(figures(hybrid)["slip"], jnp.asarray(0.01))
    assert float(passed) == pytest.approx(6.0 * 0.01 / 0.5, rel=1e-6)
    for slip in (-3.0, 0.0, 3.0):
        assert float(knee.clutch.transmitted_torque(jnp.asarray(slip), jnp.asarray(0.0))) == 0.0
        assert slip * float(knee.clutch.transmitted_torque(jnp.asarray(slip), jnp.asarray(0.4))) >= 0.0


@pytest.mark.slow
def test_figures_of_a_command(knee):
    """Force, stroke, temperature and energy from the trajectory of the knee."""
    springs, motor = (
        {n: float(v) for n, v in figures(commanded(knee, state)).items()} for state in ("springs", "motor")
    )
    way = roll(knee)
    assert springs["stroke"] == pytest.approx(np.ptp(np.asarray(way.angle)), rel=1e-3)
    assert springs["peak_temperature"] == pytest.approx(np.max(np.asarray(way.temperature)), abs=0.1)
    assert springs["force"] == pytest.approx(np.max(np.asarray(jax.vmap(knee.forces)(way))), rel=5e-3)
    # 5 V for 20 s on a resistance that goes from martensite's to austenite's; the motor's current settles within a millisecond.
    wire, law = knee.wire, knee.material
    ends = [
        25.0 * 20.0 / float(rho * wire.length / wire.area)
        for rho in (law.resistivity_austenite, law.resistivity_martensite)
    ]
    assert ends[0] < springs["energy_per_cycle"] < ends[1]
    # On a finer grid: the work of the springs as they shorten; and the cooling, by steps of the heat balance.
    fine = eqx.filter_jit(lambda variant: variant.trajectory(jnp.linspace(0.0, 1.0, 2001)))(knee)
    pull, turned = np.asarray(jax.vmap(knee.forces)(fine)), np.diff(np.asarray(fine.angle))
    shortened = float(knee.joint.radius) * np.stack([-turned, turned], axis=1)
    work = np.sum(np.maximum(0.5 * (pull[1:] + pull[:-1]) * shortened, 0.0))
    assert springs["work_per_cycle"] == pytest.approx(work, rel=2e-3)
    assert springs["efficiency"] == pytest.approx(springs["work_per_cycle"] / springs["energy_per_cycle"], rel=1e-12)
    tau = 5.4e6 * 1e-3 / (4.0 * 70.0)  # h is a number
    assert springs["time_to_cool"] == pytest.approx(tau * np.log(10.0), rel=1e-9)
    assert springs["bandwidth"] == pytest.approx(1.0 / (20.0 + springs["time_to_cool"]), rel=1e-12)
    rising = parameters.replace(knee, {"heat.h0": 40.0, "heat.h2": 6e-3})
    hot = eqx.filter_jit(
        lambda variant: variant.time_to_cool(jax.tree.map(lambda leaf: leaf[-1], variant.trajectory(SHARE)))
    )(rising)
    top = float(np.asarray(roll(rising).temperature)[-1].max())
    cooling = solve_ivp(
        lambda _, t: -4.0 / 1e-3 / 5.4e6 * (40.0 + 6e-3 * t**2) * (t - 22.0),
        (0.0, 300.0),
        [top],
        rtol=1e-9,
        atol=1e-9,
        dense_output=True,
    )
    assert cooling.sol(float(hot))[0] - 22.0 == pytest.approx(0.1 * (top - 22.0), rel=1e-5)
    assert motor["time_to_cool"] == 0.0 and motor["bandwidth"] == 1.0 and 0.0 < motor["efficiency"] < 1.0
    current = np.asarray(roll(commanded(knee, "motor")).current)
    idle = figures(parameters.replace(knee, {"command.second": 0.0}))
    assert float(idle["efficiency"]) == 0.0 == float(idle["energy_per_cycle"])
    assert motor["energy_per_cycle"] == pytest.approx(np.trapezoid(current, np.asarray(SHARE)), rel=0.02)


@pytest.mark.slow
def test_figures_of_the_parts(knee):
    still = parameters.replace(commanded(knee, "motor"), {"command.motor": 24.0})
    assert float(still.motor_speed(jnp.asarray(24.0))) * 60 / (2 * math.pi) == pytest.approx(24 * 24.48, rel=1e-4)
    assert float(knee.stiffness(jnp.zeros(()))) == pytest.approx(298.1, abs=0.05)
    assert float(knee.stiffness(jnp.ones(()))) == pytest.approx(119.2, abs=0.05)
    printed = parameters.replace(knee, {"wire.diameter": 2e-3, "wire.coil_diameter": 12e-3})
    assert float(printed.stiffness(jnp.zeros(()))) == pytest.approx(596.2, abs=0.05)
    assert float(printed.stiffness(jnp.ones(()))) == pytest.approx(238.5, abs=0.05)
    # The heating time in closed form is that of the simulation, except for the resistance, which changes during heating.
    time = float(knee.heating_time(jnp.asarray(5.0)))
    temperature = np.asarray(roll(knee).temperature)[:, 1]
    assert np.interp(62.0, temperature, 20.0 * np.asarray(SHARE)) == pytest.approx(time, rel=0.1)
    assert math.isinf(float(knee.heating_time(jnp.asarray(0.0)))) and math.isinf(
        float(knee.heating_time(jnp.asarray(1.0)))
    )


def test_ordinary_designs_all_arrive(knee):
    """Springs thinner than the shipped ones stay partly twinned, so that under stress both lines of the law are crossed."""
    box = {"wire.diameter": (0.8e-3, 1.2e-3), "joint.radius": (15e-3, 40e-3), "command.second": (3.0, 5.5)}
    shares = np.vstack([qmc.Sobol(3, scramble=False).random(8), [[0.18, 0.19044, 0.901485]]])
    for share in shares:
        design = {name: low + u * (high - low) for u, (name, (low, high)) in zip(share, box.items(), strict=True)}
        way = roll(parameters.replace(knee, design))
        assert np.all(np.isfinite(way.angle)), design
        assert np.all(np.asarray(way.fractions.martensite) >= -1e-6) and np.all(
            np.asarray(way.fractions.martensite) <= 1.0 + 1e-6
        )


def test_what_the_law_asks_is_continuous_where_both_lines_are_passed(knee):
    law, twinned = knee.material, Fractions(jnp.asarray(0.34), jnp.asarray(0.05))
    temperature = jnp.linspace(60.0, 80.0, 20_001)
    due = jax.vmap(lambda t: law.equilibrium_increment(twinned, t, jnp.asarray(110e6)))(temperature)
    both = (np.asarray(due.twinned) < 0.0) & (np.asarray(due.detwinned) > 0.0)
    assert np.any(both)
    for part in due:
        assert np.max(np.abs(np.diff(np.asarray(part)))) < 1e-4
    # If only one line is crossed, the increment is that of the law's own step.
    detwinned = Fractions(jnp.asarray(0.39), jnp.asarray(0.0))
    for at, t in ((twinned, 65.0), (detwinned, 76.0)):
        step = law.evolve(at, (jnp.asarray(t),) * 2, (jnp.asarray(110e6),) * 2)
        increment = law.equilibrium_increment(at, jnp.asarray(t), jnp.asarray(110e6))
        assert np.asarray(increment) == pytest.approx(np.asarray(step) - np.asarray(at), abs=1e-12)
        assert 0.05 < abs(float(increment.martensite)) < 0.34
    # If the other line is reached as well, the step ends where both conditions hold.
    for t in (70.0, 76.0):
        step = law.evolve(twinned, (jnp.asarray(t),) * 2, (jnp.asarray(110e6),) * 2)
        assert abs(float(step.martensite) - 0.39) > 0.05
        assert np.asarray(law.equilibrium_increment(step, jnp.asarray(t), jnp.asarray(110e6))) == pytest.approx(
            0.0, abs=1e-12
        )


@pytest.mark.slow
def test_derivatives_and_batches(knee):
    names = ("joint.radius", "heat.h0", "material.austenite_finish", "clutch.torque", "command.duration")
    count, step = len(names), 1e-3

    def angle(scaled: jax.Array, knee: Knee) -> jax.Array:
        member = parameters.replace(knee, {n: scaled[i] * parameters.get(knee, n) for i, n in enumerate(names)})
        return member.trajectory(SHARE).angle[-1]

    @eqx.filter_jit
    def moved(points: jax.Array, directions: jax.Array, knee: Knee) -> tuple[jax.Array, jax.Array]:
        return jax.vmap(lambda point, direction: jax.jvp(lambda p: angle(p, knee), (point,), (direction,)))(
            points, directions
        )

    basis = np.eye(count)
    points = jnp.asarray(np.concatenate([1.0 + step * basis, 1.0 - step * basis, np.ones((count, count))]))
    directions = jnp.asarray(np.tile(basis, (3, 1)))
    for state in ("springs", "hybrid"):
        # While the springs still transform.
        variant = parameters.replace(commanded(knee, state), {"command.duration": 7.0})
        result, slopes = map(np.asarray, moved(points, directions, variant))
        slope, differences = slopes[-count:], (result[:count] - result[count:-count]) / (2 * step)
        assert slope == pytest.approx(differences, rel=2e-3, abs=5e-4 * np.max(np.abs(slope)))
        assert np.all(slope[[0, 4, *((1, 2) if state == "springs" else (3,))]] != 0.0)
        assert result[-1] == pytest.approx(float(roll(variant).angle[-1]), rel=1e-4)


def test_bands_that_run_backwards_are_refused():
    text = (
        data_path("actuators", "knee", "rig.toml")
        .read_text("utf-8")
        .replace('austenite_finish = "62 degC"', 'austenite_finish = "30 degC"')
    )
    with pytest.raises(
        InputError,
        match=r"^my.toml: material.austenite_finish = 30 degC \(my.toml line 23\) is not above material.austenite_start = 34 degC \(.*\): correct",
    ):
        actuator_file.parse_actuator(text, "my.toml")


def test_moduli_that_mix_give_a_stiffness_linear_in_martensite(knee):
    """Eq. 11; by default compliances mix."""
    xi = jnp.array([0.0, 0.5, 1.0])
    for share in (0.0, 1.0):
        k = parameters.replace(knee, {"material.voigt_share": share}).stiffness(xi)
        mean = 0.5 * (k[0] + k[2]) if share else 2.0 / (1.0 / k[0] + 1.0 / k[2])
        assert float(k[1]) == pytest.approx(float(mean), rel=1e-12)
