"""The one-fraction laws against their published closed forms, the correction by Elahinia and Ahmadian, and wires against a reference."""

import dataclasses
import math

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from smajax import parameters
from smajax.files.rig_file import parse_rig
from smajax.fitting.fit import fit
from smajax.plant.materials.base import Fractions
from smajax.plant.materials.liang_rogers import LiangRogers
from smajax.plant.materials.tanaka import Tanaka
from smajax.recordings.recording import Recording
from smajax.simulation.inputs import discretise
from smajax.simulation.run import simulate, simulate_batch, simulate_inputs
from tests.reference import one_fraction as reference
from tests.reference.brinson import Material
from tests.reference.wire import Wire, polynomial_heat
from tests.support import plants

VALUES = {k: v for k, v in plants.MATERIAL.items() if not k.startswith("detwinning")}
MS, MF, AS, AF, CA, CM = 50.0, 36.0, 64.0, 80.0, 6.73e6, 6.32e6
LAWS = {"tanaka": Tanaka(**VALUES), "liang-rogers": LiangRogers(**VALUES)}


def forward(law: str, temperature: float, stress: float, start: float) -> float:
    """Martensite after cooling from above its band, as published: from a fraction ``start``."""
    if law == "tanaka":
        return 1.0 - (1.0 - start) * math.exp(min(math.log(0.01) / (MS - MF) * (MS - temperature + stress / CM), 0.0))
    phase = math.pi / (MS - MF) * (temperature - MF - stress / CM)
    return (1.0 - start) / 2 * math.cos(min(max(phase, 0.0), math.pi)) + (1.0 + start) / 2


def reverse(law: str, temperature: float, stress: float, start: float) -> float:
    """Martensite after heating from below its band."""
    if law == "tanaka":
        return start * math.exp(min(math.log(0.01) / (AF - AS) * (temperature - AS - stress / CA), 0.0))
    phase = math.pi / (AF - AS) * (temperature - AS - stress / CA)
    return start / 2 * (math.cos(min(max(phase, 0.0), math.pi)) + 1.0)


def advance(
    law: str, fractions: tuple[float, float], temperature: tuple[float, float], stress: tuple[float, float]
) -> float:
    start, warm, loaded = (tuple(jnp.asarray(float(v)) for v in pair) for pair in (fractions, temperature, stress))
    return float(LAWS[law].evolve(Fractions(*start), warm, loaded).martensite)


@pytest.mark.slow
@pytest.mark.parametrize("law", LAWS)
@pytest.mark.parametrize("stress", [0.0, 80e6, 200e6])
@pytest.mark.parametrize("start", [0.0, 0.3])
def test_legs_are_the_published_ones(law, stress, start):
    for temperature in np.linspace(20.0, 140.0, 61):
        cooled = advance(law, (start, 0.0), (200.0, temperature), (stress, stress))
        assert cooled == pytest.approx(forward(law, temperature, stress, start), abs=3e-9)
        heated = advance(law, (1.0 - start, 0.0), (-50.0, temperature), (stress, stress))
        assert heated == pytest.approx(reverse(law, temperature, stress, 1.0 - start), abs=3e-9)


@pytest.mark.parametrize("law", LAWS)
def test_many_steps_are_one(law):
    path = np.linspace(100.0, 30.0, 57)
    state = 0.0
    for before, after in zip(path[:-1], path[1:], strict=True):
        state = advance(law, (state, 0.0), (before, after), (80e6, 80e6))
    assert state == pytest.approx(advance(law, (0.0, 0.0), (100.0, 30.0), (80e6, 80e6)), abs=1e-12)


@pytest.mark.parametrize("law", LAWS)
def test_heating_under_a_stress_that_rises_faster_transforms_nothing_back(law):
    """As published, only the sign of the temperature change would count."""
    partly = reverse(law, 90.0, 100e6, 1.0)
    assert 0.0 < partly < 1.0
    assert advance(law, (partly, 0.0), (90.0, 92.0), (100e6, 100e6 + 3.0 * CA)) == pytest.approx(partly, abs=1e-12)
    assert (
        advance(law, (partly, 0.0), (90.0, 89.0), (100e6, 100e6 - 3.0 * CA)) < partly - 0.01
    )  # unloading transforms while it cools


def rig_of(law: str, **changed: str):
    """A wire against a spring."""
    values = {
        "martensite_start": "50 degC", "martensite_finish": "36 degC", "austenite_start": "64 degC", "austenite_finish": "80 degC",
        "clausius_clapeyron_austenite": "6.73 MPa/K", "clausius_clapeyron_martensite": "6.32 MPa/K", "modulus_austenite": "31.5 GPa",
        "modulus_martensite": "20 GPa", "max_transformation_strain": "4.1 %", "thermal_expansion": "8e-6 1/K",
    }  # fmt: skip
    lines = "\n".join(f'{k} = "{v}"' for k, v in (values | changed).items())
    return parse_rig(
        '[rig]\nkind = "bias-spring"\ncontrol = "current"\n[wire]\ndiameter = "0.15 mm"\nlength = "230 mm"\n[spring]\nstiffness = "300 N/m"\n'
        'preload = "2 N"\n[heat]\nh0 = "100.6 W/m^2/K"\nh2 = "0.001 W/m^2/K^3"\ncapacity = "2.046 MJ/m^3/K"\n'
        f'[material]\n{lines}\n[fit]\nmodel = "{law}"\nfree = []\nobserve = ["displacement"]\n'
    )


def exact_rig(law: str) -> reference.Rig:
    material = Material(**plants.MATERIAL | {"thermal_expansion_austenite": 8e-6, "thermal_expansion_martensite": 8e-6})
    return reference.Rig(
        law == "tanaka", material, polynomial_heat(100.6, 2.046e6, h2=0.001), Wire(0.15e-3, 0.23, 0.0, 20.0), 300.0, 2.0
    )


def pulses(rows: int = 400) -> Recording:
    """Levels of the current that begin and end partial loops."""
    return plants.recording({"current": plants.pulses(rows, 0.05, 0.36)}, np.arange(rows) * 0.05)


@pytest.mark.slow
@pytest.mark.parametrize("law", LAWS)
def test_a_wire_in_time_is_the_reference_and_converges_on_it(law):
    recording, plant = pulses(), rig_of(law).plant
    exact = reference.simulate(exact_rig(law), recording.time, recording.channels["current"], 40)
    stroke, errors = np.ptp(exact[:, 0]), []
    assert stroke > 8e-3
    for step in (0.05, 0.0125):
        computed = simulate(plant, recording, step=step)
        errors.append(np.sqrt(np.mean((np.asarray(computed.channels["displacement"]) - exact[:, 0]) ** 2)) / stroke)
    assert errors[0] < 3e-4 and errors[1] < errors[0] / 12.0  # second order: a sixteenth
    np.testing.assert_allclose(np.asarray(computed.state.temperature)[:, 0], exact[:, 1], atol=0.1)
    np.testing.assert_allclose(np.asarray(computed.state.fractions.martensite)[:, 0], exact[:, 3], atol=1e-3)


@pytest.mark.slow
@pytest.mark.parametrize("law", LAWS)
def test_every_derivative_is_that_of_differences_and_a_batch_is_a_loop(law):
    plant, recording = rig_of(law).plant, pulses(120)
    inputs = discretise(plant, recording)
    names = [
        n
        for n in parameters.all_declarations(plant)
        if n.startswith(("material.", "heat.", "spring.", "wire.")) and n not in parameters.TIES
    ]
    at = np.array([float(parameters.get(plant, n)) for n in names])
    scale = np.where(np.abs(at) > 0.0, np.abs(at), 1.0)
    scale[[n.startswith("material.thermal") for n in names]] = 1e-5

    def response(share):
        made = parameters.replace(plant, {n: at[i] + share[i] * scale[i] for i, n in enumerate(names)})
        return simulate_inputs(made, inputs).channels["displacement"] * 1e3

    slopes = np.asarray(jax.jit(jax.jacfwd(response))(jnp.zeros(len(names))))
    changes = 1e-6 * np.vstack([np.eye(len(names)), -np.eye(len(names)), np.zeros(len(names))])
    values = {n: jnp.asarray(at[i] + changes[:, i] * scale[i]) for i, n in enumerate(names)}
    batch, codes = simulate_batch(plant, values, inputs, ("displacement",))
    ends = np.asarray(batch["displacement"]) * 1e3
    assert not np.any(codes)
    central = (ends[: len(names)] - ends[len(names) : -1]).T / 2e-6
    for i, name in enumerate(names):
        size = max(np.sqrt(np.mean(slopes[:, i] ** 2)), 1e-3)
        assert np.sqrt(np.mean((slopes[:, i] - central[:, i]) ** 2)) < 2e-3 * size, name
    used = {n for i, n in enumerate(names) if np.max(np.abs(slopes[:, i])) > 1e-3}
    assert {n for n in names if n.startswith("material.")} <= used
    np.testing.assert_allclose(ends[-1], simulate(plant, recording).channels["displacement"] * 1e3, atol=1e-9)


@pytest.mark.slow
@pytest.mark.parametrize("law", LAWS)
def test_compiled_is_eager(law):
    plant, recording = rig_of(law).plant, pulses()
    inputs = discretise(plant, recording)
    state, compiled = plant.init(inputs.sample_signals[0]), simulate(plant, recording)
    for k in range(int(inputs.sample_indices[1])):
        state, failed = plant.step(state, inputs.before[k], inputs.after[k], inputs.time[k + 1] - inputs.time[k])
        assert not failed
    assert np.asarray(compiled.state.temperature[1]) == pytest.approx(np.asarray(state.temperature), rel=1e-12)
    assert np.asarray(compiled.state.stress[1]) == pytest.approx(np.asarray(state.stress), rel=1e-9)


@pytest.mark.slow
@pytest.mark.parametrize("law", LAWS)
def test_planted_parameters_are_found(law):
    """A recording simulated by the reference, with noise, and a fit from other start values."""
    recording = pulses()
    exact = reference.simulate(exact_rig(law), recording.time, recording.channels["current"], 40)
    noisy = exact[:, 0] + 5e-6 * np.random.default_rng(2).standard_normal(len(exact))
    made = dataclasses.replace(recording, channels=recording.channels | {"displacement": noisy})
    rig = rig_of(
        law,
        max_transformation_strain="3.7 %",
        austenite_finish="84 degC",
        martensite_finish="33 degC",
        clausius_clapeyron_austenite="7.5 MPa/K",
    )
    truths = {
        "max_transformation_strain": 0.041,
        "austenite_finish": AF,
        "martensite_finish": MF,
        "clausius_clapeyron_austenite": CA,
    }
    free = tuple(f"material.{name}" for name in truths)
    result = fit(rig.plant, [made], dataclasses.replace(rig.fit, free=free, noise={"displacement": 5e-6}, starts=1))
    for e in result.estimates:
        truth = truths[e.name.removeprefix("material.")]
        assert e.lower95 is not None and e.upper95 is not None
        assert abs(e.estimate - truth) < e.upper95 - e.lower95, e.name
        assert e.estimate == pytest.approx(truth, rel=0.01), e.name


@pytest.mark.slow
@pytest.mark.parametrize("law", LAWS)
@settings(max_examples=30, deadline=None, derandomize=True)
@given(st.lists(st.tuples(st.floats(10.0, 160.0), st.floats(0.0, 4e8)), min_size=3, max_size=8), st.floats(0.0, 1.0))
def test_whatever_the_way_a_state_stays_inside_the_full_loop(law, path, share):
    """States lie between those of cooling from austenite and of heating from martensite at the same temperature and stress."""

    def edges(temperature, stress):
        return forward(law, temperature, stress, 0.0), reverse(law, temperature, stress, 1.0)

    low, high = edges(*path[0])
    state = low + share * (high - low)
    for (t0, s0), (t1, s1) in zip(path[:-1], path[1:], strict=True):
        state = advance(law, (state, 0.0), (t0, t1), (s0, s1))
        low, high = edges(t1, s1)
        assert low - 1e-8 <= state <= high + 1e-8


@eqx.filter_jit
def led(law, start: jax.Array, temperature: jax.Array, stress: jax.Array) -> tuple[jax.Array, jax.Array]:
    """Martensite and strain along a path of stresses at one temperature."""
    warm = jnp.full(stress.shape, temperature)

    def step(state, ends):
        state = law.evolve(state, (temperature, temperature), ends)
        return state, state

    first = Fractions(start, jnp.zeros(()))
    _, states = jax.lax.scan(step, first, (stress[:-1], stress[1:]))
    states = jax.tree.map(lambda a, b: jnp.append(a, b), first, states)
    return states.martensite, law.strain(states, warm, stress, warm)


def work(stress: np.ndarray, strain: np.ndarray) -> float:
    return float(np.sum(0.5 * (stress[1:] + stress[:-1]) * np.diff(strain)))


@pytest.mark.parametrize("law", LAWS)
@settings(max_examples=60, deadline=None, derandomize=True)
@given(st.floats(20.0, 130.0), st.floats(0.0, 8e8), st.floats(0.0, 8e8))
def test_a_closed_cycle_of_stress_never_yields_work(law, temperature, one, other):
    """Between any two stresses, from the fraction to which the cycle returns; its map is linear."""
    there = np.linspace(min(one, other), max(one, other), 200)
    stress, warm = np.concatenate([there, there[-2::-1]]), jnp.asarray(temperature)
    least, most = (float(led(LAWS[law], jnp.asarray(start), warm, jnp.asarray(stress))[0][-1]) for start in (0.0, 1.0))
    fixed = least / (1.0 - most + least) if most - least < 1.0 - 1e-12 else 0.5
    martensite, strain = (np.asarray(v) for v in led(LAWS[law], jnp.asarray(fixed), warm, jnp.asarray(stress)))
    assert martensite[-1] == pytest.approx(fixed, abs=1e-9)
    assert work(stress, strain) >= -1e-9 * max(stress)


@pytest.mark.parametrize("law", LAWS)
def test_a_superelastic_cycle_costs_work(law):
    stress = np.concatenate([np.linspace(0.0, 5e8, 400), np.linspace(5e8, 0.0, 400)[1:]])
    martensite, strain = (
        np.asarray(v) for v in led(LAWS[law], jnp.asarray(0.0), jnp.asarray(95.0), jnp.asarray(stress))
    )
    assert max(martensite) > 0.9 and martensite[-1] < 1e-3
    assert work(stress, strain) > 1e6  # J/m^3, all of it dissipated
