"""The pseudo-rigid body's identities, Howell's constants, and the elastica against integration by Runge-Kutta and shooting."""

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scipy.integrate import quad, solve_bvp, solve_ivp
from scipy.optimize import brentq
from scipy.special import j0, j1, y0, y1

from smajax import parameters
from smajax.actuators import pseudo_rigid_body
from smajax.actuators.elastica import solve_elastica
from smajax.files import actuator_file
from smajax.recordings.datasets import data_path
from smajax.simulation.status import SimulationStatus
from smajax.sweeps.actuator_problem import ActuatorSweepProblem
from smajax.sweeps.compilation import evaluate_batch

_bend = jax.jit(solve_elastica)


def shot(pull: float, turn: float) -> tuple[float, float, float, float]:
    """Tip coordinates, slope and curvature at the clamp of a beam of unit length and rigidity: theta'' = F cos(theta), theta'(1) = M."""

    def end(curvature: float) -> np.ndarray:
        rates = lambda s, u: [u[1], pull * np.cos(u[0]), np.cos(u[0]), np.sin(u[0])]  # noqa: E731
        return solve_ivp(rates, (0.0, 1.0), [0.0, curvature, 0.0, 0.0], method="DOP853", rtol=1e-12, atol=1e-13).y[
            :, -1
        ]

    result = (
        brentq(lambda c: end(c)[1] - turn, turn - 1.5 * abs(pull), turn + 1.5 * abs(pull), xtol=1e-13) if pull else turn
    )
    theta, _, x, y = end(result)
    return x, y, theta, result


@pytest.mark.parametrize(("pull", "turn"), [(0.0, 1.2), (0.5, 0.0), (2.0, 0.3), (-3.0, 0.0), (1.0, 1.5), (1.5, 0.5)])
def test_elastica_is_that_of_shooting(pull: float, turn: float):
    length, rigidity = 0.12, 0.03
    bent = _bend(pull * rigidity / length**2, turn * rigidity / length, length, rigidity)
    x, y, theta, curvature = shot(pull, turn)
    true = [x * length, y * length, theta, curvature / length, length - x * length]
    np.testing.assert_allclose(np.array(bent), true, rtol=1e-9, atol=1e-11)


def followed(pull: float, turn: float, steps: int) -> np.ndarray:
    """Tip coordinates and slope of a beam of unit length and rigidity, by SciPy, continued from load to load."""
    along = np.linspace(0.0, 1.0, 400)
    state = np.array([0.0 * along, 0.0 * along, along, 0.0 * along])
    for share in np.linspace(0.0, 1.0, steps + 1)[1:]:

        def rates(s: np.ndarray, u: np.ndarray, share: float = share) -> np.ndarray:
            return np.array([u[1], share * pull * np.cos(u[0]), np.cos(u[0]), np.sin(u[0])])

        def ends(a: np.ndarray, b: np.ndarray, share: float = share) -> np.ndarray:
            return np.array([a[0], b[1] - share * turn, a[2], a[3]])

        result = solve_bvp(rates, ends, along, state, tol=1e-8, max_nodes=20_000)
        assert result.status == 0
        along, state = result.x, result.y
    return state[[2, 3, 0], -1]


@pytest.mark.slow
@pytest.mark.parametrize("force", [-1000.0, -500.0, -200.0, -100.0, -20.0, 10.0, 100.0, 500.0])
def test_elastica_is_that_which_comes_of_loads_that_grow(force: float):
    pull, turn = force * 0.12**2 / 0.0308, 0.7687
    bent = _bend(pull, turn, 1.0, 1.0)
    np.testing.assert_allclose(np.array(bent)[:3], followed(pull, turn, 50), atol=1e-5)


def test_a_bend_that_is_not_found_is_none():
    """A bend within a hundredth of the length is not resolved; in a sweep such designs count as failed."""
    assert np.all(np.isnan(np.array(_bend(-1e5, 0.7, 1.0, 1.0))))
    actuator = actuator_file.read_actuator(data_path("actuators", "soft-bending", "rig.toml"))
    study = ActuatorSweepProblem(("cable.force",), actuator, ("tip_slope", "rod_share"))
    result, codes = evaluate_batch(study, jnp.array([[-300.0], [0.0], [-1e4]]), 1)
    assert np.array_equal(np.asarray(codes) == SimulationStatus.done, [True, True, False])
    assert np.asarray(result["tip_slope"])[0] == pytest.approx(1.6357, abs=1e-4) and np.isnan(result["tip_slope"][2])


@pytest.mark.slow
def test_elastica_has_its_derivatives_and_its_limit():
    at = jnp.array([2.0, 0.2, 0.12, 0.03])
    slopes = np.array(jax.jit(jax.jacfwd(lambda p: jnp.stack(solve_elastica(*p))))(at))
    np.testing.assert_allclose(slopes, jax.jit(jax.jacrev(lambda p: jnp.stack(solve_elastica(*p))))(at), rtol=1e-10)
    many = jax.jit(jax.vmap(lambda p: jnp.stack(solve_elastica(*p))))
    steps = np.diag(1e-5 * np.array(at))
    ends = np.array(many(np.concatenate([np.array(at) + steps, np.array(at) - steps])))
    np.testing.assert_allclose(slopes * np.diag(steps), (ends[:4] - ends[4:]).T / 2, rtol=1e-7, atol=1e-13)
    # Small loads: deflection and slope of the small-slope theory, whose error falls with the square of the load.
    off = []
    for size in (1e-2, 1e-3):
        bent = _bend(3.0 * size, 1.3 * size, 1.0, 1.0)
        off.append(
            [
                float(bent.y + pseudo_rigid_body.deflection(3.0 * size, 1.3 * size, 1.0, 1.0)) / size,
                float(1.0 - bent.x - pseudo_rigid_body.shortening(3.0 * size, 1.3 * size, 1.0, 1.0)) / size**2,
            ]
        )
    assert np.all(np.abs(off[1]) < 1e-6) and np.all(np.abs(off[0]) > 30 * np.abs(off[1]))


def test_small_slopes_are_those_of_the_beam_integral():
    for force, moment, length, rigidity in ((0.4, 0.02, 0.12, 0.03), (-0.3, 0.05, 0.3, 0.7), (1.0, 0.0, 1.0, 2.0)):
        slope = lambda s, f=force, m=moment, n=length, r=rigidity: (f * (n * s - s**2 / 2) - m * s) / r  # noqa: E731
        assert pseudo_rigid_body.deflection(force, moment, length, rigidity) == pytest.approx(
            quad(slope, 0, length, epsrel=1e-13)[0], rel=1e-12
        )
        back = quad(lambda s, slope=slope: slope(s) ** 2 / 2, 0, length, epsrel=1e-13)[0]
        assert pseudo_rigid_body.shortening(force, moment, length, rigidity) == pytest.approx(back, rel=1e-12)
        assert pseudo_rigid_body.slope(force, moment, length, rigidity) == pytest.approx(slope(length), rel=1e-12)


@pytest.mark.parametrize(("theta", "share"), [(0.05, 0.883061), (0.3, 0.907853), (0.7, 1.021186)])
def test_identities_of_the_rigid_rod(theta: float, share: float):
    """Eqs. 18 to 25, corrected, fit together; and the values of eq. 23 that an independent script gives."""
    length, rigidity = 0.12, 0.031
    force = pseudo_rigid_body.balanced_force(theta, length, rigidity)
    moment = force * length / 3
    state = (force, moment, length, rigidity)
    assert pseudo_rigid_body.slope(*state) == pytest.approx(theta, rel=1e-12)
    assert pseudo_rigid_body.deflection(*state) == pytest.approx(theta * length, rel=1e-12)
    assert pseudo_rigid_body.shortening(*state) == pytest.approx(17 / 30 * theta**2 * length, rel=1e-12)
    assert pseudo_rigid_body.driving_force(theta, length, rigidity) == pytest.approx(force - moment / length, rel=1e-12)
    angle, result = pseudo_rigid_body.rigid_rod(
        jnp.asarray(length - pseudo_rigid_body.shortening(*state)),
        jnp.asarray(pseudo_rigid_body.deflection(*state)),
        length,
    )
    assert (
        float(result)
        == pytest.approx(pseudo_rigid_body.radius_factor(theta), rel=1e-12)
        == pytest.approx(share, abs=1e-6)
    )
    assert float(angle) == pytest.approx(2 * np.arctan(17 / 30 * theta), rel=1e-12)
    assert pseudo_rigid_body.radius_factor(theta) == pytest.approx(theta / np.sin(float(angle)), rel=1e-12)
    arm, turn = pseudo_rigid_body.radius_factor(theta) * length, theta / pseudo_rigid_body.radius_factor(theta)
    assert pseudo_rigid_body.hinge_stiffness(pseudo_rigid_body.radius_factor(theta), length, rigidity) == pytest.approx(
        pseudo_rigid_body.driving_force(theta, length, rigidity) * arm / turn, rel=1e-12
    )


def test_howells_constants():
    """Against the elastica: the rod's tip and its spring, which Howell fitted over the whole range."""
    for load in (0.3, 1.0, 2.0, 4.0):
        body, moment = pseudo_rigid_body.END_MOMENT, 0.4 * load
        bent = _bend(0.0, moment, 1.0, 1.0)
        angle = np.arctan2(float(bent.y), float(bent.x) - (1.0 - body.radius_factor))
        np.testing.assert_allclose(np.array(body.tip(angle, 1.0)), [bent.x, bent.y], atol=5e-3)
        assert body.stiffness * angle == pytest.approx(moment, rel=0.06)
    # As the load goes to 0: lambda 5/6, 3/4, and 15/17 for a moment F L / 3 against the force.
    for force, moment, share in ((1e-4, 0.0, 5 / 6), (0.0, 1e-4, 3 / 4), (1e-4, 1e-4 / 3, 15 / 17)):
        bent = _bend(force, moment, 1.0, 1.0)
        assert float(pseudo_rigid_body.rigid_rod(bent.x, bent.y, 1.0)[1]) == pytest.approx(share, rel=1e-5)


_figures = eqx.filter_jit(lambda actuator: actuator.metrics())


def test_wires_that_do_not_fit_into_the_bar_are_no_design():
    """Wires thicker than the bar, or wider than it side by side: the file is refused, and the design of a sweep fails."""
    actuator = actuator_file.read_actuator(data_path("actuators", "soft-bending", "rig.toml"))
    study = ActuatorSweepProblem(("wires.diameter", "wires.count"), actuator, ("tip_slope", "cold_strain"))
    result, codes = evaluate_batch(study, jnp.array([[1.2e-3, 4.0], [6e-3, 1.0], [1.2e-3, 13.0]]), 1)
    assert np.array_equal(np.asarray(codes) == SimulationStatus.done, [True, False, False])
    assert np.array_equal(np.isnan(result["cold_strain"]), [False, True, True])


@pytest.mark.slow
def test_soft_bending_figures():
    """The free tip turns by the published 44.04 degrees, for which the memory shape was chosen; a cable turns it back."""
    actuator = actuator_file.read_actuator(data_path("actuators", "soft-bending", "rig.toml"))
    metrics = {name: float(value) for name, value in _figures(actuator).items()}
    assert np.degrees(metrics["tip_slope"]) == pytest.approx(44.04, abs=2e-3)
    assert metrics["rigidity"] == pytest.approx(3.05e-2 + 2.8e-4, rel=2e-3)
    assert metrics["cold_rigidity"] == pytest.approx(1.22e-2 + 2.8e-4, rel=2e-3)
    arc = metrics["rigidity"] / metrics["moment"]
    assert metrics["tip_deflection"] == pytest.approx(arc * (1 - np.cos(metrics["tip_slope"])), rel=1e-9)
    assert 0.12 - metrics["tip_shortening"] == pytest.approx(arc * np.sin(metrics["tip_slope"]), rel=1e-9)
    assert 0.72 < metrics["rod_share"] < 0.78  # a pure moment: 3/4 at small bends
    # The hinge's spring holds the rod where the beam's tip is: of E I / L about Howell's 1.516, where eq. 25 would have 2.25; and 3/2 for a
    # small moment alone, 25/12 for a small force.
    per_length = metrics["rigidity"] / 0.12
    assert metrics["rod_stiffness"] * metrics["rod_angle"] == pytest.approx(metrics["moment"], rel=1e-12)
    assert metrics["rod_stiffness"] == pytest.approx(pseudo_rigid_body.END_MOMENT.stiffness * per_length, rel=0.02)
    for curvature, force, share in ((1e-3, 0.0, 3 / 2), (0.0, -1e-3, 25 / 12)):
        drawn = parameters.replace(actuator, {"wires.memory_curvature": curvature, "cable.force": force})
        assert float(_figures(drawn)["rod_stiffness"]) == pytest.approx(share * per_length, rel=1e-4)
    for curvature in (0.0, 1e-12, -1e-7):  # the rod of the smallest moment
        rest = _figures(parameters.replace(actuator, {"wires.memory_curvature": curvature}))
        assert float(rest["rod_share"]) == pytest.approx(3 / 4, rel=1e-9)
        assert float(rest["rod_stiffness"]) == pytest.approx(3 / 2 * per_length, rel=1e-9)
        assert float(rest["rod_angle"]) == pytest.approx(4 / 3 * float(rest["tip_deflection"]) / 0.12, rel=1e-9)
    at_rest, near = (
        jax.jit(jax.jacfwd(lambda k: parameters.replace(actuator, {"wires.memory_curvature": k}).metrics()))(k)
        for k in (0.0, 1e-4)
    )
    for name in ("rod_angle", "rod_share", "rod_stiffness", "tip_slope"):
        assert float(at_rest[name]) == pytest.approx(float(near[name]), rel=1e-6, abs=1e-5)
    pulled = _figures(parameters.replace(actuator, {"cable.force": 0.1 * metrics["blocking_force"]}))
    assert float(pulled["tip_deflection"]) == pytest.approx(0.9 * metrics["tip_deflection"], rel=0.05)
    small = parameters.replace(actuator, {"wires.memory_curvature": 1e-3})
    held = _figures(parameters.replace(small, {"cable.force": _figures(small)["blocking_force"]}))
    assert abs(float(held["tip_deflection"])) < 1e-6 * 0.12 * 1e-3


@pytest.mark.slow
def test_a_cycle_of_the_bar():
    """Against a hanging weight the tip moves from below to above; the wires are heated, transformed, and cooled in the silicone."""
    actuator = actuator_file.read_actuator(data_path("actuators", "soft-bending", "rig.toml"))
    pulled = parameters.replace(actuator, {"cable.force": 0.2})
    metrics = {name: float(value) for name, value in _figures(pulled).items()}
    cold = solve_elastica(jnp.asarray(0.2), jnp.asarray(0.0), jnp.asarray(0.12), jnp.asarray(metrics["cold_rigidity"]))
    assert float(cold.y) < 0.0 and metrics["stroke"] == pytest.approx(
        metrics["tip_deflection"] - float(cold.y), rel=1e-9
    )
    assert metrics["work_per_cycle"] == pytest.approx(0.2 * metrics["stroke"], rel=1e-12)
    mass = 4 * 0.12 * np.pi / 4 * 1.2e-3**2 * 6450.0
    assert metrics["energy_per_cycle"] == pytest.approx(mass * (837.4 * 24.0 + 24.2e3), rel=1e-9)
    assert metrics["efficiency"] == pytest.approx(metrics["work_per_cycle"] / metrics["energy_per_cycle"], rel=1e-12)
    resistance = 0.9e-6 * 4 * 0.12 / (np.pi / 4 * 1.2e-3**2)
    assert metrics["heating_time"] == pytest.approx(metrics["energy_per_cycle"] / (10.0**2 * resistance), rel=1e-9)
    assert metrics["bandwidth"] == pytest.approx(1.0 / (metrics["heating_time"] + metrics["time_to_cool"]), rel=1e-12)
    assert metrics["force"] == metrics["blocking_force"] and metrics["peak_temperature"] == 46.0
    # For one wire in much silicone, cooling is that of a cylinder in an infinite medium.
    wide = parameters.replace(
        pulled, {"wires.count": 1.0, "bar.width": 0.1, "bar.thickness": 0.05, "wires.diameter": 0.6e-3}
    )
    alone = float(_figures(wide)["time_to_cool"])
    assert alone == pytest.approx(_cylinder(0.3e-3, 5.4e6, 0.15, 970.0 * 1460.0, (46.0 - 36.0) / 24.0), rel=0.02)


def _cylinder(radius: float, stored: float, conductivity: float, around: float, lost: float) -> float:
    """Time in s in which a cylinder of uniform temperature loses a share of its heat to an infinite medium.

    Carslaw and Jaeger, Conduction of Heat in Solids (1959), 13.7 (8), without contact resistance.
    """
    a, diffusivity = 2.0 * around / stored, conductivity / around

    def remaining_share(time: float) -> float:
        def part(u: float) -> float:
            real, imaginary = u * j0(u) - a * j1(u), u * y0(u) - a * y1(u)
            return np.exp(-diffusivity * time * u**2 / radius**2) / (u * (real**2 + imaginary**2))

        # Evenly spaced on a logarithmic scale, along which it changes slowly.
        return 4.0 * a / np.pi**2 * quad(lambda s: part(np.exp(s)) * np.exp(s), -25.0, 7.0, limit=500)[0]

    return brentq(lambda time: remaining_share(time) - (1.0 - lost), 1e-4, 100.0)
