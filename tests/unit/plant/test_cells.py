"""Cells along the wire: temperature profiles against exact ones, energy, resistance, and every stage and effect."""

import dataclasses
from typing import Any

import diffrax as dfx
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scipy.integrate import solve_ivp

from smajax import parameters
from smajax.plant.cells import Cells
from smajax.plant.convection import PolynomialConvection
from smajax.plant.effects import catalogue
from smajax.plant.grains import Grains
from smajax.plant.plant import Plant
from smajax.plant.state import State
from smajax.simulation.inputs import discretise
from smajax.simulation.run import simulate, simulate_channels, simulate_states
from tests.support import plants

AMBIENT, CURRENT = 20.0, 0.2
# Parameters of a wire that never transforms: its profile has an exact solution.
COLD = {"austenite_start": 500.0, "austenite_finish": 520.0}
STAGES = ("drive", "heat", "material", "mechanism", "sensor")
# Effects that this recording does not show with their default instant and place: a change at its end, and a stop beyond
# the motion.
NOT_SHOWN = {"airflow-change", "hard-stop"}
_VALUES: dict[str, Any] = {"h0": 80.0, "h2": 0.0, "capacity_austenite": 3e6, "capacity_martensite": 3e6}
HEAT = PolynomialConvection(**_VALUES)


def with_structure(plant: Plant, cells: int = 1, grains: int = 1, **values: Any) -> Plant:
    return dataclasses.replace(
        plant,
        cells=Cells(count=cells, **values) if cells > 1 else None,
        grains=Grains(count=grains) if grains > 1 else None,
    )


def cold_wire(cells: int, **values: Any) -> Plant:
    return with_structure(dataclasses.replace(plants.dead_weight(**COLD), heat=HEAT), cells, **values)


def states_under(plant: Plant, current: np.ndarray, time: np.ndarray) -> State:
    recording = plants.recording({"current": current, "displacement": 0.0 * time}, time)
    states, status = simulate_states(plant, discretise(plant, recording))
    assert int(status) == 0
    return states


def layout(plant: Plant) -> tuple[np.ndarray, np.ndarray]:
    """Shares of the cells in the length, and their boundaries in m."""
    assert plant.cells is not None
    ends = np.asarray(plant.cells.geometry(plant.wire, plant.heat, plant.environment, None).boundaries)
    return np.diff(ends) / ends[-1], ends


def exact_profile(plant: Plant, place: np.ndarray) -> np.ndarray:
    """A fin with uniform heat and ends at ambient temperature."""
    wire, rho = plant.wire, float(plant.material.resistivity_martensite)
    heat = rho * (CURRENT / float(wire.area)) ** 2
    per_kelvin = 4.0 * 80.0 / float(wire.diameter)
    fin, half = np.sqrt(18.0 / per_kelvin), 0.5 * float(wire.length)
    return AMBIENT + heat / per_kelvin * (1.0 - np.cosh((half - place) / fin) / np.cosh(half / fin))


def steady_errors(cells: int) -> tuple[float, float]:
    """Errors of the temperatures and of their mean over the wire in a steady state, K."""
    plant = cold_wire(cells, clamp_conductance=1e3)
    time = np.arange(0.0, 60.0, 0.5)
    last = np.asarray(states_under(plant, np.full(len(time), CURRENT), time).temperature)[-1, :, 0]
    shares, ends = layout(plant)
    fine = [np.linspace(a, b, 401) for a, b in zip(ends[:-1], ends[1:], strict=True)]
    means = np.array([np.trapezoid(exact_profile(plant, x), x) / (x[-1] - x[0]) for x in fine])
    return float(np.max(np.abs(last - means))), float(abs(shares @ (last - means)))


@pytest.mark.slow
def test_the_steady_profile_converges_to_that_of_a_fin():
    errors = [steady_errors(cells) for cells in (5, 9, 17, 33)]
    rise = exact_profile(cold_wire(9), np.array([0.115]))[0] - AMBIENT
    assert errors[1][1] < 0.005 * rise
    for coarse, fine in zip(errors[:-1], errors[1:], strict=True):
        assert fine[0] < 0.6 * coarse[0] and fine[1] < 0.5 * coarse[1], errors


@pytest.mark.slow
def test_transients_with_a_clamp_that_warms_up_agree_with_a_fine_grid_of_another_solver():
    clamp = {"clamp_conductance": 2e-4, "clamp_capacity": 2e-3}
    plant = cold_wire(33, **clamp)
    time = np.arange(0.0, 20.0, 0.1)
    current = np.where(time < 8.0, 0.3, 0.1)
    states = states_under(plant, current, time)
    nodes, half, area = 400, 0.5 * float(plant.wire.length), float(plant.wire.area)
    width = half / nodes
    rho, diameter = float(plant.material.resistivity_martensite), float(plant.wire.diameter)

    def rate(t: float, y: np.ndarray) -> np.ndarray:
        wire, end = y[:-1], y[-1]
        flow = np.empty(nodes + 1)  # towards the clamp, W/m^2
        flow[0], flow[1:-1], flow[-1] = 18.0 * (wire[0] - end) / (0.5 * width), 18.0 * np.diff(wire) / width, 0.0
        # The plant's current is held from each sample to the next one.
        joule = rho * (current[min(int(t / 0.1 + 1e-9), len(time) - 1)] / area) ** 2
        heating = joule - 320.0 / diameter * (wire - AMBIENT) + np.diff(flow) / width
        cooling = clamp["clamp_conductance"] * (end - AMBIENT)
        return np.append(heating / 3e6, (area * flow[0] - cooling) / clamp["clamp_capacity"])

    start = np.full(nodes + 1, AMBIENT)
    solution = solve_ivp(rate, (0.0, time[-1]), start, "LSODA", time, max_step=0.1, rtol=1e-8, atol=1e-8)
    mean = np.mean(solution.y[:-1], axis=0)
    shares, _ = layout(plant)
    computed = np.asarray(states.temperature)[:, :, 0] @ shares
    assert np.max(np.abs(computed - mean)) < 0.005 * np.ptp(mean)
    clamps = np.asarray(states.memory["clamp"])[:, 0]
    assert np.ptp(clamps) > 3.0
    assert np.max(np.abs(clamps - solution.y[-1])) < 0.03 * np.ptp(clamps)


@pytest.mark.slow
def test_heat_is_conserved_over_a_cycle_of_heating_transforming_and_cooling():
    latent = catalogue()["latent-heat"](strength=jnp.asarray(8e7))
    plant = with_structure(plants.dead_weight(), 9, 4, clamp_conductance=1e-3)
    plant = dataclasses.replace(plant, effects=(latent,))
    step = 0.01
    time = np.arange(0.0, 24.0, step)
    current = np.where(time < 6.0, 0.3, 0.0)
    states = states_under(plant, current, time)
    temperature, clamp = np.asarray(states.temperature)[:, :, 0], np.asarray(states.memory["clamp"])[:, 0]
    shares, ends = layout(plant)
    mean = [np.asarray(f).mean(axis=1)[:, :, 0] for f in states.fractions]
    martensite = mean[0] + mean[1]
    assert np.ptp(martensite @ shares) > 0.5
    rho = np.asarray(plant.material.resistivity_austenite) + martensite * float(
        plant.material.resistivity_martensite - plant.material.resistivity_austenite
    )
    joule = rho * (current[:, None] / float(plant.wire.area)) ** 2
    loss = (
        4.0
        / float(plant.wire.diameter)
        * np.asarray(plant.heat.convection(jnp.asarray(temperature)))
        * (temperature - AMBIENT)
    )
    to_clamp = 18.0 * (temperature[:, 0] - clamp) / (0.5 * ends[1]) / ends[-1]
    before = (joule[:-1] - loss[:-1]) @ shares - to_clamp[:-1]
    # The current is held, so heat at the end of a step has the current of its start.
    held = rho[1:] * (current[:-1, None] / float(plant.wire.area)) ** 2
    after = (held - loss[1:]) @ shares - to_clamp[1:]
    received = np.cumsum(0.5 * step * (before + after))
    capacity = plants.HEAT["capacity_austenite"]
    stored = capacity * ((temperature - temperature[0]) @ shares) - 8e7 * ((martensite - martensite[0]) @ shares)
    assert np.max(np.abs(received - stored[1:])) < 2e-3 * np.ptp(stored)


@pytest.mark.slow
def test_resistance_is_the_sum_over_cells_and_power_is_that_of_one_current():
    plant = with_structure(plants.bias_spring(), 9, 3)
    recording = plants.inputs("bias_spring", 200, 0.05)
    result = simulate(plant, discretise(plant, recording))
    channels = {name: np.asarray(value) for name, value in result.channels.items()}
    fractions = np.asarray(result.state.fractions.martensite).mean(axis=1)[:, :, 0]
    rho = 1.0e-6 + fractions * (0.8e-6 - 1.0e-6)
    shares, _ = layout(plant)
    ohms = rho @ shares * float(plant.wire.length) / float(plant.wire.area)
    np.testing.assert_allclose(channels["resistance"], ohms, rtol=1e-12)
    np.testing.assert_allclose(channels["voltage"], channels["current"] * ohms, rtol=1e-12)
    np.testing.assert_allclose(channels["power"], channels["current"] ** 2 * ohms, rtol=1e-12, atol=1e-15)
    assert np.ptp(ohms) > 0.02 * ohms.max()


@pytest.mark.slow
def test_a_wire_that_conducts_no_heat_is_that_of_one_cell():
    recording = plants.inputs("dead_weight", 200, 0.05)
    plant = plants.dead_weight()
    one = simulate(plant, discretise(plant, recording)).channels["displacement"]
    insulated = with_structure(plant, 9, conductivity=1e-3, clamp_conductance=1e-6)
    many = simulate(insulated, discretise(insulated, recording)).channels["displacement"]
    assert np.max(np.abs(np.asarray(many - one))) < 2e-3 * np.ptp(np.asarray(one))


def test_a_thermocouple_reads_its_place():
    time = np.arange(0.0, 20.0, 0.5)
    recording = plants.recording({"current": np.full(len(time), CURRENT), "displacement": 0.0 * time}, time)
    readings = []
    for place in (0.02, 0.98, 0.25, 0.5):
        plant = cold_wire(33, thermocouple_place=place, clamp_conductance=1e3)
        reading = simulate(plant, discretise(plant, recording)).channels["temperature"][-1]
        readings.append(float(reading))
        exact = exact_profile(plant, np.array([min(place, 1.0 - place) * 0.23]))[0]
        assert abs(float(reading) - exact) < 0.02 * (exact - AMBIENT)
    assert readings[0] == pytest.approx(readings[1]) and readings[1] < readings[2] < readings[3]


@pytest.mark.slow
def test_heat_is_conserved_under_a_recorded_ambient_temperature():
    """In a steady state at another ambient temperature than the rig's, the clamps get what the wire does not lose."""
    plant = with_structure(plants.dead_weight(**COLD), 9, clamp_conductance=1e3)
    time, recorded = np.arange(0.0, 120.0, 0.5), 90.0
    channels = {"current": np.full(240, CURRENT), "displacement": 0.0 * time, "ambient": np.full(240, recorded)}
    states, _ = simulate_states(plant, discretise(plant, plants.recording(channels, time)))
    shares, ends = layout(plant)
    last = np.asarray(states.temperature)[-1, :, 0]
    joule = float(plant.material.resistivity_martensite) * (CURRENT / float(plant.wire.area)) ** 2
    convection = np.asarray(plant.heat.convection(jnp.asarray(last)))
    received = shares @ (joule - 4.0 / float(plant.wire.diameter) * convection * (last - recorded))
    clamp = float(np.asarray(states.memory["clamp"])[-1, 0])
    assert received == pytest.approx(18.0 * (last[0] - clamp) / (0.5 * ends[1]) / ends[-1], rel=1e-6)


def test_uneven_convection_keeps_its_mean_and_cools_the_ends_more():
    plant = cold_wire(9, uneven_convection=0.3)
    assert plant.cells is not None
    _, ends = layout(plant)
    factors = np.asarray(plant.cells.convection_factors(jnp.asarray(ends)))
    assert np.all(np.diff(factors) < 0.0) and factors[0] > 1.25
    assert float(np.diff(ends) @ factors) == pytest.approx(float(ends[-1]))


@pytest.mark.slow
@pytest.mark.parametrize("kind", ["dead_weight", "bias_spring", "light_rotary", "limb", "duty_spring"])
def test_derivatives_agree_with_finite_differences_in_both_modes(kind):
    plant = with_structure(plants.KINDS[kind](), 4, 2, clamp_conductance=1e-3)
    inputs = discretise(plant, plants.inputs(kind, 80, 0.05))
    names = ["cells.conductivity", "cells.clamp_conductance", "grains.austenite_spread", "heat.h0", "wire.diameter"]
    values = jnp.stack([parameters.get(plant, name) for name in names])
    weights = jnp.cos(jnp.arange(80.0))

    def total(scale: jax.Array) -> jax.Array:
        changed = parameters.replace(plant, dict(zip(names, values * scale, strict=True)))
        return weights @ simulate(changed, inputs).channels[plant.mechanism.coordinate]

    total, ones = jax.jit(total), jnp.ones(len(names))
    forward, reverse = jax.jit(jax.jacfwd(total))(ones), jax.jit(jax.grad(total))(ones)
    np.testing.assert_allclose(reverse, forward, rtol=1e-6, atol=1e-9 * float(jnp.max(jnp.abs(forward))))
    step = 1e-5
    numeric = [float(total(ones.at[i].add(step)) - total(ones.at[i].add(-step))) / (2 * step) for i in range(5)]
    np.testing.assert_allclose(forward, numeric, rtol=2e-3, atol=2e-5 * float(jnp.max(jnp.abs(forward))))


@pytest.mark.slow
@pytest.mark.parametrize("law", ["tanaka", "liang-rogers", "lagoudas"])
def test_other_laws_have_cells_and_grains(law):
    from smajax.plant.materials.registry import MATERIALS

    values: dict[str, Any] = {
        name: value for name, value in plants.MATERIAL.items() if not name.startswith("detwinning")
    }
    plant = with_structure(dataclasses.replace(plants.dead_weight(), material=MATERIALS[law](**values)), 5, 3)
    moved = np.asarray(simulate(plant, discretise(plant, plants.inputs("dead_weight", 150))).channels["displacement"])
    assert np.all(np.isfinite(moved)) and np.ptp(moved) > 1e-3


@pytest.mark.slow
@pytest.mark.parametrize(("kind", "stage"), [("bias_spring", s) for s in STAGES] + [("light_rotary", "heat")])
def test_effects_act_on_a_wire_of_cells(kind, stage):
    plant = with_structure(plants.KINDS[kind](), 3, 2)
    recording = plants.inputs(kind, 60, 0.2)
    capabilities = plant.capabilities((*recording.channels, "temperature"))
    effects = [e for e in catalogue().values() if e.stage == stage and not e.unavailable_reason(capabilities)]
    typical = jnp.array([e.typical for e in effects])

    def response(strengths: jax.Array) -> jax.Array:
        added = tuple(effect(strength=s) for effect, s in zip(effects, strengths, strict=True))
        changed = dataclasses.replace(plant, effects=added)
        channels = simulate_channels(changed, discretise(changed, recording), plant.observable)[0]
        return jnp.stack([channels[c] for c in plant.observable])

    slopes = np.asarray(jax.jit(jax.jacfwd(response))(0.1 * typical)) * np.asarray(typical)
    assert np.all(np.isfinite(slopes))
    blind = [e.key for e, slope in zip(effects, np.moveaxis(slopes, -1, 0), strict=True) if not np.any(slope)]
    assert not set(blind) - NOT_SHOWN, blind


@pytest.mark.slow
@pytest.mark.parametrize(("cells", "grains"), [(3, 1), (1, 2), (3, 2)])
def test_a_law_that_changes_with_the_stress_acts_on_each_grain_of_each_cell(cells, grains):
    """A hysteresis that widens linearly with the stress is another slope C_A, with s sigma / 100 MPa + sigma / C_A."""
    plant = with_structure(plants.bias_spring(), cells, grains)
    slope = float(plant.material.clausius_clapeyron_austenite)
    widened = dataclasses.replace(plant, effects=(catalogue()["hysteresis-widening"](strength=3.0, power=1.0),))
    other = parameters.replace(plant, {"material.clausius_clapeyron_austenite": 1.0 / (1.0 / slope + 3.0 / 100e6)})
    inputs = discretise(plant, plants.inputs("bias_spring", 150))
    moved, expected, without = (
        np.asarray(simulate(p, inputs).channels["displacement"]) for p in (widened, other, plant)
    )
    np.testing.assert_allclose(moved, expected, rtol=0.0, atol=1e-9)
    assert np.max(np.abs(moved - without)) > 1e-4


@pytest.mark.slow
def test_the_step_converges_to_the_differential_equation():
    plant = with_structure(plants.dead_weight(), 5, 2)
    recording = plants.inputs("dead_weight", 40, 0.15)
    exact = simulate(plant, discretise(plant, recording), solver=dfx.Tsit5())
    errors = []
    for step in (0.15, 0.05, 0.015):
        result = simulate(plant, discretise(plant, recording, step=step))
        errors.append(float(jnp.max(jnp.abs(result.state.temperature - exact.state.temperature))))
    assert errors[1] < 0.5 * errors[0] and errors[2] < 0.6 * errors[1] and errors[2] < 2e-3, errors


@pytest.mark.slow
def test_compiled_and_eager_steps_agree():
    plant = with_structure(plants.bias_spring(), 5, 3)
    signal = jnp.asarray([2.5])
    state = plant.init(0.0 * signal)
    for _ in range(3):
        eager, failed = plant.step(state, signal, signal, jnp.asarray(0.05))
        compiled, _ = jax.jit(lambda p, s: p.step(s, signal, signal, jnp.asarray(0.05)))(plant, state)
        assert not bool(failed)
        jax.tree.map(lambda a, b: np.testing.assert_allclose(a, b, rtol=1e-9, atol=1e-9), eager, compiled)
        state = eager
