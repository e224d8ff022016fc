"""Lagoudas' law against published curves and vectors, the exact reference, and the second law."""

import dataclasses
import json
import math

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.optimize import brentq
from typer.testing import CliRunner

from smajax import parameters
from smajax.app.cli import app
from smajax.files.rig_file import parse_rig, read_rig
from smajax.fitting.fit import fit
from smajax.parameters import declarations
from smajax.plant.effects import catalogue
from smajax.plant.materials.base import Fractions
from smajax.plant.materials.hardening import hardening, inverse_hardening
from smajax.plant.materials.lagoudas import Lagoudas
from smajax.recordings.recording import Recording
from smajax.simulation.inputs import discretise
from smajax.simulation.run import simulate, simulate_batch, simulate_inputs
from tests.reference import lagoudas as reference

VALUES = {
    "martensite_start": 45.0,
    "martensite_finish": 30.0,
    "austenite_start": 60.0,
    "austenite_finish": 78.0,
    "clausius_clapeyron_austenite": 7.5e6,
    "clausius_clapeyron_martensite": 6.5e6,
    "modulus_austenite": 60e9,
    "modulus_martensite": 30e9,
    "max_transformation_strain": 0.045,
    "min_strain_share": 0.2,
    "strain_saturation": 1.5e-8,
    "critical_stress": 10e6,
    "calibration_stress": 150e6,
    "n1": 0.3,
    "n2": 0.6,
    "n3": 0.4,
    "n4": 0.2,
}
LAW, EXACT = Lagoudas(**VALUES), reference.Law(**VALUES)
ANCHORS = ("lin", "smooth05", "smoothmix")


@eqx.filter_jit
def evolved(law: Lagoudas, start: Fractions, *ends: tuple[jax.Array, jax.Array]) -> Fractions:
    return law.evolve(start, *ends)


def advance(law: Lagoudas, state: reference.State, temperature: float, stress: tuple[float, float]) -> reference.State:
    detwinned = state.strain / float(law.max_transformation_strain)
    start = Fractions(jnp.asarray(detwinned), jnp.asarray(state.martensite - detwinned))
    end = evolved(law, start, (jnp.asarray(0.0), jnp.asarray(temperature)), tuple(jnp.asarray(s) for s in stress))
    return reference.State(float(end.martensite), float(law.transformation_strain(end)))


STEEP = VALUES | {
    "clausius_clapeyron_austenite": 9.4e6,
    "clausius_clapeyron_martensite": 5.2e6,
    "martensite_start": 55.0,
}


def apart(law: reference.Law, stress: float) -> float:
    """Smallest difference of the temperatures at which a fraction shrinks and grows, by the forces of the exact law."""
    e, direction, least = reference.energy(law), reference.current_strain(law, stress), math.inf
    for fraction in np.linspace(0.0, 1.0, 201):
        grows = brentq(lambda t, f=fraction: reference.forward_force(law, e, t, stress, f), -500.0, 900.0)
        shrinks = brentq(lambda t, f=fraction: reference.reverse_force(law, e, t, stress, f, direction), -500.0, 900.0)
        least = min(least, shrinks - grows)
    return least


@pytest.mark.parametrize(
    "change", [{}, {"n1": 1.0, "n2": 1.0, "n3": 1.0, "n4": 1.0}, {"n1": 0.1, "n4": 0.1}, {"min_strain_share": 0.9}]
)
def test_the_lines_cross_where_the_exact_law_has_no_hysteresis(change):
    values = STEEP | change
    crossing = Lagoudas(**values).crossing_stress()
    assert 50e6 < crossing < 500e6
    assert apart(reference.Law(**values), crossing) == pytest.approx(0.0, abs=0.02)
    assert (
        apart(reference.Law(**values), 0.8 * crossing) > 0.5 and apart(reference.Law(**values), 1.2 * crossing) < -0.5
    )
    shifted = Lagoudas(**values, austenite_shift=4.0, martensite_shift=-3.0)
    assert shifted.crossing_stress() == pytest.approx(
        Lagoudas(
            **(
                values
                | {
                    "austenite_start": 64.0,
                    "austenite_finish": 82.0,
                    "martensite_start": 52.0,
                    "martensite_finish": 27.0,
                }
            )
        ).crossing_stress()
    )


def test_lines_that_do_not_approach_each_other_never_cross():
    assert Lagoudas(**(STEEP | {"clausius_clapeyron_martensite": 9.4e6})).crossing_stress() == math.inf
    assert Lagoudas(**(STEEP | {"clausius_clapeyron_martensite": 12e6})).crossing_stress() == math.inf
    assert Lagoudas(**(STEEP | {"austenite_start": 29.0})).crossing_stress() == 0.0


@pytest.mark.slow
def test_lost_hysteresis_is_said(tmp_path):
    """The check, a simulation and a fit warn of a recording above the stress at which the lines cross, and not below it."""
    units = {"Pa": "Pa", "Pa/K": "Pa/K", "degC": "degC", "1": "", "1/Pa": "1/Pa"}
    lines = "\n".join(f'{n} = "{v} {units[declarations(Lagoudas)[n].unit]}"' for n, v in STEEP.items())
    rig, out = tmp_path / "rig.toml", tmp_path / "out"
    rig.write_text(
        f'[rig]\nkind = "path"\n[material]\n{lines}\n[fit]\nmodel = "lagoudas"\nfree = ["material.max_transformation_strain"]\nobserve = ["strain"]\nstarts = 1\n'
    )
    crossing = Lagoudas(**STEEP).crossing_stress()
    warm = np.r_[np.linspace(200.0, 20.0, 60), np.linspace(20.0, 200.0, 60)]
    run = lambda *words: CliRunner().invoke(app, [*map(str, words)])  # noqa: E731
    for stress, said in ((0.9 * crossing, False), (1.5 * crossing, True)):
        simulated = simulate(
            read_rig(rig).plant,
            Recording.from_arrays("a", None, {"temperature": warm, "stress": np.full(120, stress)}, {}),
        )
        strain = np.asarray(simulated.channels["strain"])
        path = tmp_path / "a.csv"
        table = np.column_stack([warm, np.full(120, stress / 1e6), 100.0 * strain + 0.001 * np.sin(np.arange(120.0))])
        np.savetxt(
            path, table, delimiter=",", header="temperature [degC],stress [MPa],strain [%]", comments="", fmt="%.9g"
        )
        sentence = f"from {crossing / 1e6:.4g} MPa on Lagoudas' lines of heating and cooling cross"
        for words in (("check", rig, path), ("simulate", rig, path, "--out", out), ("fit", rig, path, "--out", out)):
            done = run(*words)
            text = " ".join(done.stdout.split())
            assert done.exit_code == 0, done.output
            assert (
                (sentence in text) == said == ("(9.4 MPa/K) is above clausius_clapeyron_martensite (5.2 MPa/K)" in text)
            ), words
            if words[0] != "check":
                assert ("lines of heating and cooling cross" in (out / "report.html").read_text("utf-8")) == said


def path_rig(observe: str, **values: str):
    lines = "\n".join(f'{name} = "{value}"' for name, value in values.items())
    return parse_rig(f'[rig]\nkind = "path"\n[material]\n{lines}\n[fit]\nmodel = "lagoudas"\nobserve = ["{observe}"]\n')


def anchor(shared, name: str, observe: str):
    """Plant, inputs and exact curve of a published case."""
    folder = shared / "anchors" / "lagoudas-curves"
    made = json.loads((folder / f"{name}.params.json").read_text())
    p, warm = made["props"], made["T_init_K"]
    plant = path_rig(
        observe, martensite_start=f"{p['Ms0']} K", martensite_finish=f"{p['Mf0']} K", austenite_start=f"{p['As0']} K",
        austenite_finish=f"{p['Af0']} K", clausius_clapeyron_austenite=f"{p['C_A']} MPa/K", clausius_clapeyron_martensite=f"{p['C_M']} MPa/K",
        modulus_austenite=f"{p['E_A']} MPa", modulus_martensite=f"{p['E_M']} MPa", max_transformation_strain=str(p["Hmax"]),
        min_strain_share=str(p["Hmin"] / p["Hmax"]), strain_saturation=f"{p['k1']} 1/MPa", critical_stress=f"{p['sigma_crit']} MPa",
        calibration_stress=f"{p['sigma_caliber']} MPa", thermal_expansion=f"{p['alpha_A']} 1/K",
        n1=str(p["n1"]), n2=str(p["n2"]), n3=str(p["n3"]), n4=str(p["n4"]),
    ).plant  # fmt: skip
    plant = parameters.replace(plant, {"environment.ambient": warm - 273.15})
    return plant, warm, np.loadtxt(folder / f"{name}_exact.csv", delimiter=",", skiprows=1)


@pytest.mark.parametrize("hardening_of", ANCHORS)
@pytest.mark.parametrize("stress", [100, 200])
def test_isobaric_cycles_are_the_published_ones(shared, stress, hardening_of):
    plant, warm, exact = anchor(shared, f"iso{stress}_{hardening_of}", "strain")
    channels = {"temperature": np.append(warm, exact[:, 0]) - 273.15, "stress": np.full(len(exact) + 1, stress * 1e6)}
    computed = simulate(plant, Recording.from_arrays("cycle", None, channels, {})).channels["strain"]
    assert np.max(np.abs(np.asarray(computed)[1:] - exact[:, 1])) < 1e-8  # required: 1e-5


@pytest.mark.slow
@pytest.mark.parametrize("hardening_of", ANCHORS)
def test_superelastic_loops_are_the_published_ones(shared, hardening_of):
    plant, warm, exact = anchor(shared, f"super_{hardening_of}", "stress")
    strain = np.append(0.0, exact[:, 0])
    channels = {"temperature": np.full(len(strain), warm - 273.15), "strain": strain}
    computed = simulate(plant, Recording.from_arrays("loop", None, channels, {})).channels["stress"]
    assert np.max(np.abs(np.asarray(computed)[1:] / 1e6 - exact[:, 1])) < 0.05  # required: 0.5 MPa


@pytest.mark.parametrize(
    ("temperature", "stress", "forward", "reverse"),
    [
        (46.0, 0.0, 0.5, 0.571429),
        (60.0, 50e6, 0.257653, 0.329082),
        (70.0, 100e6, 0.163265, 0.234694),
        (50.0, 20e6, 0.459592, 0.531020),
    ],
)
def test_exponents_of_one_give_the_older_law(temperature, stress, forward, reverse):
    law = Lagoudas(
        martensite_start=60.0, martensite_finish=32.0, austenite_start=34.0, austenite_finish=62.0, clausius_clapeyron_austenite=7e6,
        clausius_clapeyron_martensite=7e6, modulus_austenite=75e9, modulus_martensite=30e9, max_transformation_strain=0.05,
    )  # fmt: skip
    assert advance(law, reference.State(0.0, 0.0), temperature, (stress, stress)).martensite == pytest.approx(
        forward, abs=1e-6
    )
    assert advance(law, reference.State(1.0, 0.05), temperature, (stress, stress)).martensite == pytest.approx(
        reverse, abs=1e-6
    )


@pytest.mark.parametrize(("share", "half"), [("0", 42.857142857), ("1", 52.5), ("0.5", 47.678571429)])
def test_a_rig_chooses_the_knee_ankle_papers_law_and_how_the_moduli_mix(share, half):
    """Temperatures, slopes, moduli and strain alone give the law with linear hardening; the paper mixes moduli."""
    law = path_rig(
        "strain", martensite_start="60 degC", martensite_finish="32 degC", austenite_start="34 degC", austenite_finish="62 degC",
        clausius_clapeyron_austenite="7 MPa/K", clausius_clapeyron_martensite="7 MPa/K", modulus_austenite="75 GPa",
        modulus_martensite="30 GPa", max_transformation_strain="5 %", voigt_share=share,
    ).plant.material  # fmt: skip
    xi = jnp.array([0.0, 0.5, 1.0])
    modulus = jax.vmap(lambda v: law.modulus(Fractions(v, jnp.zeros(()))))(xi)
    np.testing.assert_allclose(modulus, [75e9, 1e9 * half, 30e9], rtol=1e-9)
    for temperature, stress, forward in (
        (60.0, 50e6, 0.257653),
        (50.0, 20e6, 0.459592),
    ):  # the lines do not follow the mixture
        assert advance(law, reference.State(0.0, 0.0), temperature, (stress, stress)).martensite == pytest.approx(
            forward, abs=1e-6
        )
    assert path_rig("strain", **TEXT).plant.material.voigt_share == 0.0


@settings(max_examples=300, deadline=None, derandomize=True)
@given(st.floats(0.0, 1.0), st.floats(0.01, 1.0), st.floats(0.01, 1.0))
def test_hardening_is_inverted(share, n, m):
    fraction = float(jax.jit(inverse_hardening)(*(jnp.asarray(v) for v in (share, n, m))))
    low, high = 0.0, 1.0
    for _ in range(64):
        middle = 0.5 * (low + high)
        low, high = (middle, high) if 0.5 * (1 + middle**n - (1 - middle) ** m) < share else (low, middle)
    assert fraction == pytest.approx(0.5 * (low + high), abs=2e-9)


@pytest.mark.parametrize("share", [-0.2, 0.0, 1.0, 1.3])
def test_before_and_after_its_band_nothing_transforms(share):
    value, slope = jax.value_and_grad(inverse_hardening)(jnp.asarray(share), jnp.asarray(0.3), jnp.asarray(0.6))
    assert (float(value), float(slope)) == (float(share >= 1.0), 0.0)


@pytest.mark.parametrize("at", [(0.02, 0.3, 0.6), (0.4, 1.0, 1.0), (0.5, 0.05, 0.9), (0.97, 0.2, 0.15)])
def test_derivatives_of_the_inverse_are_those_of_differences(at):
    for k in range(3):
        step = np.eye(3)[k] * 1e-6
        ends = [float(inverse_hardening(*(jnp.asarray(v) for v in np.array(at) + side * step))) for side in (1, -1)]
        slope = float(jax.grad(inverse_hardening, argnums=k)(*(jnp.asarray(v) for v in at)))
        assert slope == pytest.approx((ends[0] - ends[1]) / 2e-6, rel=2e-5, abs=1e-8)


def test_the_inverse_is_one_of_hardening():
    fractions = jnp.linspace(0.001, 0.999, 500)
    n, m = jnp.full(500, 0.3), jnp.full(500, 0.45)
    np.testing.assert_allclose(inverse_hardening(hardening(fractions, n, m), n, m), fractions, atol=1e-13)


@pytest.mark.parametrize("stress", [0.0, 5e6, 80e6, 250e6])
def test_a_walk_of_partial_loops_is_the_reference(stress):
    rng = np.random.default_rng(0)
    computed = exact = reference.State(0.0, 0.0)
    turned = 0
    for temperature in rng.uniform(25.0, 70.0, 200) + stress / 7e6:
        new = reference.advance(EXACT, exact, float(temperature), (stress, stress))
        turned += 0.0 < new.martensite < 1.0 and new != exact
        computed, exact = advance(LAW, computed, float(temperature), (stress, stress)), new
        assert computed == pytest.approx(exact, abs=1e-8)
    assert turned > 20


def exchanged(state: reference.State, temperature: float, stress: float, part: float) -> reference.State:
    """The reference, with martensite that shrinks in small steps and grows back where the forward condition holds."""
    e = reference.energy(EXACT)
    while state.martensite > 1e-9:
        direction = state.strain / state.martensite
        if reference.reverse_force(EXACT, e, temperature, stress, state.martensite, direction) <= 0.0:
            break
        fewer = reference.State(state.martensite * (1.0 - part), state.strain * (1.0 - part))
        state = reference.advance(EXACT, fewer, temperature, (stress, stress))
    return state


def test_twinned_martensite_under_a_high_stress_is_exchanged_for_detwinned():
    """The reverse transformation begins below the end of the forward one: martensite that shrinks grows again, under the stress."""
    stress, ends = 300e6, (64.0, 72.0, 78.0, 84.0)
    exact, state = [], reference.State(1.0, 0.0)
    for temperature in np.linspace(60.0, 84.0, 481):
        state = exchanged(state, float(temperature), stress, 1e-3)
        if float(temperature) in ends:
            exact.append((state.martensite, state.strain / VALUES["max_transformation_strain"]))
    assert len(exact) == len(ends) and exact[0][0] == 1.0 and exact[1][1] > 0.2

    def errors(count):
        states, _ = led(
            LAW,
            Fractions(jnp.asarray(0.0), jnp.asarray(1.0)),
            jnp.linspace(20.0, 84.0, count + 1),
            jnp.full(count + 1, stress),
        )
        assert bool(jnp.all(jnp.diff(states.martensite) <= 1e-12))
        rows = [round((end - 20.0) / 64.0 * count) for end in ends]
        return np.abs(np.stack([states.martensite, states.detwinned], axis=1)[rows] - np.array(exact))

    coarse, finer, finest = (float(np.max(errors(count))) for count in (64, 256, 2048))
    assert coarse < 0.12 and finer < 0.4 * coarse and finest < 0.006, (coarse, finer, finest)


def test_steps_of_stress_converge_on_the_reference():
    temperature, ends = 85.0, (10e6, 400e6)
    exact = reference.advance(EXACT, reference.State(0.0, 0.0), temperature, ends, parts=20_000)
    errors = []
    for count in (10, 20, 40, 80):
        state, levels = reference.State(0.0, 0.0), np.linspace(*ends, count + 1)
        for before, after in zip(levels[:-1], levels[1:], strict=True):
            state = advance(LAW, state, temperature, (float(before), float(after)))
        errors.append(abs(state.strain - exact.strain))
    assert errors[-1] < 1e-7 and np.log2(errors[0] / errors[-1]) / 3 > 1.8, errors


@eqx.filter_jit
def led(law: Lagoudas, start: Fractions, temperature: jax.Array, stress: jax.Array) -> tuple[Fractions, jax.Array]:
    """States and strains along a path."""

    def step(state, ends):
        state = law.evolve(state, ends[:2], ends[2:])
        return state, state

    _, states = jax.lax.scan(step, start, (temperature[:-1], temperature[1:], stress[:-1], stress[1:]))
    states = jax.tree.map(jnp.append, start, states)
    return states, law.strain(states, temperature, stress, temperature)


NOTHING = Fractions(jnp.asarray(0.0), jnp.asarray(0.0))


def round_trip(
    count: int, warm: tuple[float, float], load: tuple[float, float], ahead: float
) -> tuple[np.ndarray, np.ndarray]:
    """A closed path on which temperature and stress (middle and amplitude of each) change together, with a phase angle."""
    phase = np.linspace(0.0, 2.0 * np.pi, count + 1)
    return warm[0] + warm[1] * np.sin(phase + ahead), load[0] + load[1] * np.sin(phase)


@pytest.mark.slow
@pytest.mark.parametrize("voigt_share", [0.0, 1.0])
def test_paths_of_temperature_and_stress_together_converge_on_the_reference(voigt_share):
    """Two closed paths, wide and narrow, on which martensite grows and shrinks under a changing stress."""

    def walked(count):
        wide, narrow = (
            round_trip(count, (75.0, 35.0), (180e6, 150e6), 2.0),
            round_trip(count, (75.0, 22.0), (180e6, 90e6), 2.4),
        )
        lead = np.linspace(wide[0][-1], narrow[0][0], count + 1), np.linspace(wide[1][-1], narrow[1][0], count + 1)
        return (np.concatenate([a[:-1], b[:-1], c]) for a, b, c in zip(wide, lead, narrow, strict=True))

    law, reference_law = Lagoudas(**VALUES, voigt_share=voigt_share), EXACT._replace(voigt_share=voigt_share)
    finest = 1600
    state, exact, previous = reference.State(0.0, 0.0), [], 0.0
    for t, s in zip(*walked(finest), strict=True):
        state = reference.advance(
            reference_law, state, float(t), (previous, float(s)) if exact else (float(s), float(s))
        )
        previous = float(s)
        exact.append((state.martensite, reference.strain(reference_law, state, float(s))))
    martensite, strain = np.array(exact).T
    assert np.ptp(martensite) > 0.9
    errors = []
    for count in (50, 100, 200, 400):
        t, s = walked(count)
        begun = law.evolve(NOTHING, (jnp.asarray(200.0), jnp.asarray(t[0])), (jnp.asarray(s[0]), jnp.asarray(s[0])))
        states, computed = led(law, begun, jnp.asarray(t), jnp.asarray(s))
        errors.append(float(np.max(np.abs(np.asarray(computed) - strain[:: finest // count]))))
        np.testing.assert_allclose(states.martensite, martensite[:: finest // count], atol=2e-3 * (50 / count))
    assert errors[-1] < 2e-6 and errors[0] > 16 * errors[-1], errors


compiled = eqx.filter_jit(Lagoudas.evolve)


@pytest.mark.slow
def test_compiled_is_eager():
    rng = np.random.default_rng(3)
    for temperature, stress, share in zip(
        rng.uniform(20.0, 110.0, 40), rng.uniform(0.0, 3e8, 40), rng.uniform(0.0, 0.5, 40), strict=True
    ):
        arguments = (
            Fractions(jnp.asarray(share), jnp.asarray(0.3)),
            (jnp.asarray(0.0), jnp.asarray(temperature)),
            (jnp.asarray(1e8), jnp.asarray(stress)),
        )
        for eager, other in zip(LAW.evolve(*arguments), compiled(LAW, *arguments), strict=True):
            assert float(eager) == pytest.approx(float(other), abs=1e-14)


@pytest.mark.parametrize("voigt_share", [0.0, 1.0])
@settings(max_examples=60, deadline=None, derandomize=True)
@given(st.lists(st.tuples(st.floats(0.0, 130.0), st.floats(0.0, 4e8)), min_size=5, max_size=5))
def test_no_closed_cycle_yields_energy(voigt_share, turns):
    """On any closed path from austenite, the dissipation is the work less the heat of the entropy."""
    corners = np.array([(200.0, 0.0), *turns, (200.0, turns[-1][1]), (200.0, 0.0)])
    t, s = (np.interp(np.linspace(0.0, len(corners) - 1.0, 701), np.arange(len(corners)), side) for side in corners.T)
    states, strain = led(Lagoudas(**VALUES, voigt_share=voigt_share), NOTHING, jnp.asarray(t), jnp.asarray(s))
    martensite, strain = np.asarray(states.martensite), np.asarray(strain)
    assert martensite[-1] < 1e-12 and abs(strain[-1]) < 1e-12
    work = np.sum(0.5 * (s[1:] + s[:-1]) * np.diff(strain))
    heat = reference.energy(EXACT).ds * np.sum(0.5 * (martensite[1:] + martensite[:-1]) * np.diff(t))
    assert work - heat > (1e5 if np.max(martensite) > 0.1 else -1.0)  # J/m^3; a full cycle's is 1e7


@pytest.mark.slow
@settings(max_examples=200, deadline=None, derandomize=True)
@given(st.lists(st.tuples(st.floats(-20.0, 150.0), st.floats(0.0, 6e8)), min_size=2, max_size=8))
def test_fractions_stay_possible(path):
    evolve = eqx.filter_jit(LAW.evolve)
    state = Fractions(jnp.asarray(0.0), jnp.asarray(0.0))
    before = 0.0
    for temperature, after in path:
        state = evolve(state, (jnp.asarray(0.0), jnp.asarray(temperature)), (jnp.asarray(before), jnp.asarray(after)))
        before = after
        assert (
            float(state.detwinned) >= 0.0
            and float(state.twinned) + 1e-15 >= 0.0
            and float(state.martensite) <= 1.0 + 1e-15
        )


@pytest.mark.slow
def test_a_closed_loop_costs_work():
    plant = path_rig("stress", **{**TEXT, "n1": "0.3"}).plant
    strain = np.concatenate([np.linspace(0.0, 0.05, 400), np.linspace(0.05, 0.0, 400)[1:]])
    channels = {"temperature": np.full(len(strain), 95.0), "strain": strain}
    stress = np.asarray(simulate(plant, Recording.from_arrays("loop", None, channels, {})).channels["stress"])
    work = float(np.sum(0.5 * (stress[1:] + stress[:-1]) * np.diff(strain)))
    assert stress[-1] == pytest.approx(0.0, abs=1e5) and work > 1e6  # J/m^3, all of it dissipated


TEXT = {
    "martensite_start": "45 degC", "martensite_finish": "30 degC", "austenite_start": "60 degC", "austenite_finish": "78 degC",
    "clausius_clapeyron_austenite": "7.5 MPa/K", "clausius_clapeyron_martensite": "6.5 MPa/K", "modulus_austenite": "60 GPa",
    "modulus_martensite": "30 GPa", "max_transformation_strain": "4.5 %", "min_strain_share": "20 %", "strain_saturation": "1.5e-8 1/Pa",
    "critical_stress": "10 MPa", "calibration_stress": "150 MPa", "n1": "0.3", "n2": "0.6", "n3": "0.4", "n4": "0.2",
}  # fmt: skip


def dead_weight():
    """A wire under a dead weight with Lagoudas' law, in time."""
    lines = "\n".join(f'{k} = "{v}"' for k, v in TEXT.items())
    text = '[rig]\nkind = "dead-weight"\ncontrol = "current"\n[wire]\ndiameter = "0.15 mm"\nlength = "230 mm"\n[load]\nmass = "200 g"\n'
    heat = '[heat]\nh0 = "100.6 W/m^2/K"\nh2 = "0.001 W/m^2/K^3"\ncapacity = "2.046 MJ/m^3/K"\n'
    return parse_rig(
        f'{text}{heat}[material]\n{lines}\n[fit]\nmodel = "lagoudas"\nfree = []\nobserve = ["displacement"]\n'
    )


def pulses(count: int = 600) -> Recording:
    seconds = np.arange(count) * 0.05
    current = np.where(seconds % 10.0 < 5.0, 0.33, 0.08) * (1.0 + 0.1 * np.sin(seconds))
    return Recording.from_arrays("pulses", seconds, {"current": current}, {})


@pytest.mark.slow
def test_a_wire_in_time_is_the_reference():
    """Heat by many small steps, fractions by bisection: an independent implementation."""
    rig, recording = dead_weight(), pulses()
    computed = np.asarray(simulate(rig.plant, recording).channels["displacement"])
    area = np.pi / 4 * 0.15e-3**2
    stress = 0.2 * 9.81 / area
    grown = reference.current_strain(EXACT, stress)
    temperature, state = 20.0, reference.State(1.0, grown)
    first, lifted = reference.strain(EXACT, state, stress), [0.0]
    for before, after, current in zip(
        recording.time[:-1], recording.time[1:], recording.channels["current"][:-1], strict=True
    ):
        step = (after - before) / 40
        for _ in range(40):
            resistivity = 1e-6 - 0.2e-6 * state.martensite
            heat = resistivity * (current / area) ** 2 - 4 / 0.15e-3 * (100.6 + 0.001 * temperature**2) * (
                temperature - 20.0
            )
            temperature += step * heat / 2.046e6
            state = reference.advance(EXACT, state, temperature, (stress, stress))
        lifted.append(0.23 * (first - reference.strain(EXACT, state, stress)))
    assert np.ptp(lifted) > 4e-3
    assert np.sqrt(np.mean((computed - lifted) ** 2)) < 0.01e-3


@pytest.mark.slow
def test_derivatives_and_batches_of_a_wire():
    rig, recording = dead_weight(), pulses(300)
    names = (
        "material.n1",
        "material.n4",
        "material.max_transformation_strain",
        "material.strain_saturation",
        "material.clausius_clapeyron_austenite",
    )
    at = {name: float(parameters.get(rig.plant, name)) for name in names}

    def mean_square(values):
        result = simulate(parameters.replace(rig.plant, values), recording, throw=False)
        return jnp.mean((result.channels["displacement"] * 1e3) ** 2)

    slopes = jax.jacfwd(mean_square)(at)
    for name in names:
        step = 1e-5 * at[name]
        ends = [float(mean_square(at | {name: at[name] + side * step})) for side in (1, -1)]
        assert float(slopes[name]) == pytest.approx((ends[0] - ends[1]) / (2 * step), rel=2e-3), name
    values = {"material.n1": jnp.array([0.3, 0.5])}
    batch, codes = simulate_batch(rig.plant, values, discretise(rig.plant, recording), ("displacement",))
    for k, n1 in enumerate((0.3, 0.5)):
        alone = simulate(parameters.replace(rig.plant, {"material.n1": n1}), recording).channels["displacement"]
        np.testing.assert_allclose(batch["displacement"][k], alone, atol=1e-12)
    assert not np.any(codes)


@pytest.mark.slow
def test_every_effect_goes_with_it():
    """Absent effects change nothing, and each has a derivative: the law supports all hooks of effects."""
    rig, recording = dead_weight(), pulses(120)
    plain = np.asarray(simulate(rig.plant, recording).channels["displacement"])
    traits = rig.plant.capabilities(("displacement",))
    kinds = {
        k: kind
        for k, kind in catalogue().items()
        if kind.stage in ("heat", "material") and not kind.unavailable_reason(traits)
    }
    kinds["coulomb-friction"] = catalogue()["coulomb-friction"]  # a drag is solved for with the law
    made = tuple(
        kind(**({"strength": 0.0} | ({"reference": 0.33} if "reference" in declarations(kind) else {})))
        for kind in kinds.values()
    )
    plant = dataclasses.replace(rig.plant, effects=made)
    assert np.array_equal(simulate(plant, recording).channels["displacement"], plain)
    inputs = discretise(plant, recording)
    names = [f"effects.{key}.strength" for key in kinds]

    def response(values):
        changed = parameters.replace(plant, dict(zip(names, values, strict=True)))
        return simulate_inputs(changed, inputs).channels["displacement"]

    # The sum over all effects is NaN if one of them is.
    along = jax.jit(lambda at: jax.jvp(response, (at,), (jnp.ones(len(names)),)))
    there, slopes = map(np.asarray, along(jnp.zeros(len(names))))
    # With friction the heat balance is solved more closely.
    np.testing.assert_allclose(there, plain, atol=1e-9)
    assert np.all(np.isfinite(slopes)) and len(kinds) > 15


@pytest.mark.slow
def test_planted_parameters_are_found():
    """Thermal cycles made by the reference, with noise; the strain's own parameters and the forward line are free."""
    rng = np.random.default_rng(1)
    temperature = np.concatenate([np.linspace(110.0, 10.0, 120), np.linspace(10.0, 110.0, 120)[1:]])
    recordings = []
    for stress in (30e6, 100e6, 250e6):
        state, strains = reference.State(0.0, 0.0), []
        for t in temperature:
            state = reference.advance(EXACT, state, float(t), (stress, stress))
            strains.append(reference.strain(EXACT, state, stress))
        channels = {"temperature": temperature, "stress": np.full(len(temperature), stress)}
        recordings.append(
            Recording.from_arrays(
                f"{stress}", None, channels | {"strain": strains + 2e-5 * rng.standard_normal(239)}, {}
            )
        )
    rig = path_rig(
        "strain",
        **(
            TEXT
            | {
                "max_transformation_strain": "4 %",
                "strain_saturation": "2e-8 1/Pa",
                "n1": "0.5",
                "martensite_start": "50 degC",
            }
        ),
    )
    free = (
        "material.max_transformation_strain",
        "material.strain_saturation",
        "material.n1",
        "material.martensite_start",
    )
    fit_settings = dataclasses.replace(rig.fit, free=free, noise={"strain": 2e-5}, starts=1)
    computed = {e.name: e for e in fit(rig.plant, recordings, fit_settings).estimates}
    for name, truth in zip(free, (0.045, 1.5e-8, 0.3, 45.0), strict=True):
        e = computed[name]
        assert e.lower95 is not None and e.upper95 is not None
        assert e.lower95 - 0.5 * (e.upper95 - e.lower95) < truth < e.upper95 + 0.5 * (e.upper95 - e.lower95), name
        assert e.estimate == pytest.approx(truth, rel=0.02)
