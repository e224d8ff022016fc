"""The catalogue: declarations of all effects, their absence at strength 0, and their derivatives there."""

import dataclasses
import functools
import math

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest

from smajax import parameters
from smajax.diagnosis.candidates import EffectSet
from smajax.diagnosis.detectability import assess_detectability
from smajax.diagnosis.problem import DiagnosisProblem
from smajax.diagnosis.sensitivities import effect_sensitivities
from smajax.errors import InputError
from smajax.files.rig_file import parse_rig, read_rig
from smajax.fitting.problem import Problem
from smajax.parameters import declarations, parameter
from smajax.plant.effects import catalogue
from smajax.plant.effects.airflow_change import AirflowChange
from smajax.plant.effects.base import AbstractEffect, DriveEffect
from smajax.plant.effects.infrared_spot import InfraredSpot
from smajax.plant.effects.memory import presliding_state
from smajax.plant.effects.minor_loop_shape import MinorLoopShape
from smajax.plant.effects.skip_at_zero import skip_at_zero
from smajax.plant.materials.base import Fractions
from smajax.plant.sensor import lag_series
from smajax.recordings.datasets import data_path
from smajax.simulation import run as simulate
from smajax.simulation.inputs import discretise
from tests.reference.hidden import Hidden, displacement
from tests.reference.hidden_pair import angle
from tests.reference.rig_file import read_rig as reference_rig
from tests.support import plants

KEYS = [
    "latent-heat",
    "convection-temperature",
    "convection-diameter",
    "radiation",
    "end-conduction",
    "ambient-drift",
    "airflow-change",
    "coating",
    "wire-crosstalk",
    "heat-capacity",
    "thermocouple-lag",
    "thermocouple-embedding",
    "thermocouple-attachment",
    "thermocouple-pickup",
    "infrared-spot",
    "time-skew",
    "sensor-lag",
    "encoder-gain",
    "quantisation",
    "current-limit",
    "lead-resistance",
    "resistivity-temperature",
    "resistivity-strain",
    "coulomb-friction",
    "viscous-friction",
    "backlash",
    "slack",
    "hard-stop",
    "compliance",
    "bias-nonlinearity",
    "load-change",
    "r-phase",
    "stress-dependent-strain",
    "clausius-asymmetry",
    "clausius-curvature",
    "ratcheting",
    "initial-set",
    "functional-fatigue",
    "transformation-shift",
    "minor-loop-shape",
    "heating-roundness",
    "stress-ratcheting",
    "two-slope-elasticity",
    "hysteresis-widening",
    "specimen-lag",
    "gradual-transformation",
    "creep",
    "temperature-distribution",
    "encoder-drift",
    "slip",
    "fan-cooling",
]


@functools.cache
def bench(kind: str, seconds: float, observe: str = "", stages: tuple[str, ...] = ()) -> DiagnosisProblem:
    """A shipped rig on the first seconds of its training recording, with other observed channels where these are given.

    With ``stages``, only effects of these: what those of the others do is the same on every rig with wires that are heated. The terms of
    free form are left out: they are half of such a program.
    """
    folder = data_path("recordings", kind)
    text = (folder / "rig.toml").read_text("utf-8")
    rig = (
        parse_rig(text)
        if not observe
        else parse_rig(text.replace('observe = ["displacement"]', f"observe = [{observe}]"))
    )
    recording = read_rig(folder / "rig.toml").read(folder / "train.csv").slice(0.0, seconds)
    if observe:  # channels of additional sensors; their values do not matter for derivatives
        channels = recording.channels | {
            "temperature": 20.0 + 1e3 * recording.channels["displacement"],
            "voltage": 9.0 * recording.channels["current"] + 1e-3,
        }
        recording = dataclasses.replace(
            recording, channels=channels, units=recording.units | {"temperature": "degC", "voltage": "V"}
        )
    noise = {"displacement": 2e-5, "temperature": 0.4, "voltage": 5e-3, "angle": 1e-3, "strain": 1e-4}
    settings = dataclasses.replace(rig.fit, noise={c: noise[c] for c in rig.fit.observe})
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr("smajax.diagnosis.problem.zero_terms", tuple)
        if stages:
            subset = {k: e for k, e in catalogue().items() if e.stage in stages or "two wires" in e.needs}
            patch.setattr("smajax.diagnosis.effect_parameters.catalogue", lambda: subset)
        return DiagnosisProblem(rig.plant, [recording], settings, interpolation=rig.interpolation)


def test_the_catalogue_is_whole():
    assert sorted(KEYS) == list(catalogue())


@pytest.mark.parametrize("key", KEYS)
def test_an_effect_says_what_it_is(key):
    kind: type[AbstractEffect] = catalogue()[key]
    low, high = kind.plausible_range()
    assert kind.stage in ("drive", "heat", "material", "mechanism", "sensor")
    assert low <= 0.0 < high
    assert 0.0 < kind.typical <= high
    assert kind.source and kind.__doc__
    assert set(kind.confused_with) <= set(KEYS)
    assert declarations(kind)["strength"].default == 0.0
    assert all(name in declarations(kind) for name, _ in kind.shapes)


@pytest.mark.slow
@pytest.mark.parametrize(
    ("kind", "seconds", "observe", "stages"),
    [
        ("dead-weight", 12.0, '"displacement", "temperature", "voltage"', ()),
        ("rotary", 6.0, "", ("mechanism", "sensor")),
        ("bias-spring", 8.0, "", ("drive", "mechanism")),
        ("isobaric", 300.0, "", ()),
    ],
)
def test_derivatives_at_zero_strength(kind, seconds, observe, stages):
    """All effects of a rig in one program: absent at 0, and the derivative there is that of a small step."""
    made = bench(kind, seconds, observe, stages)
    nominal = made.nominal
    nothing = made.predict(EffectSet(), nominal, 0)
    without = np.asarray(eqx.filter_jit(Problem.residual)(made.base_problem, nominal))
    without = without[np.asarray(made.base_problem.data.weight).ravel() > 0.0]
    assert np.max(np.abs(made.counted_samples(nothing) - without)) < 1e-6 * np.linalg.norm(without)
    silent, seen = set(), set()
    for (key, shape), column in effect_sensitivities(made, EffectSet(), nominal).items():
        assert np.all(np.isfinite(column)), key
        changes = []
        for size in (1e-4, -1e-4):  # wires that start just taut have one derivative to either side
            strength = (f"effects.{key}.strength", size * made.effects[key].typical)
            at = EffectSet((key,), (strength, *((f"effects.{key}.{n}", v) for n, v in shape)))
            changes.append((made.predict(at, nominal, 0) - nothing) / size)
        if np.linalg.norm(column) < 1e-6 * np.linalg.norm(nothing):
            silent.add(key)
            assert np.linalg.norm(changes[0]) < 1e-3 * np.linalg.norm(nothing), key
            continue
        seen.add(key)
        off = min(np.linalg.norm(change - column) for change in (*changes, 0.5 * (changes[0] + changes[1])))
        assert off < 2e-2 * np.linalg.norm(column), key
    silent -= seen  # a stop may lie beyond the motion
    if kind == "isobaric":  # without heating, motion and a moving load, only the strain is observed
        assert not silent & {
            "gradual-transformation",
            "r-phase",
            "ratcheting",
            "transformation-shift",
            "temperature-distribution",
            "stress-ratcheting",
        }
    else:
        assert silent <= {"compliance", "slip", "stress-dependent-strain"}, silent


@pytest.mark.slow
def test_what_is_planted_is_recovered():
    """Each visible effect at its usual strength is recovered by a fit that starts from a fifth of it.

    One that is there completely or not at all starts near its usual strength, as in a diagnosis.
    """
    made = bench("dead-weight", 12.0, '"displacement", "temperature", "voltage"')
    seen, _ = assess_detectability(made)
    base, problem = made.nominal, made.problems[0]
    weight = np.asarray(problem.data.weight)
    recovered = {}
    for key in (
        k
        for k, s in seen.items()
        if s.status == "testable" and 20.0 * (s.minimum_detectable_strength or math.inf) < catalogue()[k].typical
    ):
        strength, shapes = f"effects.{key}.strength", {f"effects.{key}.{n}": v for n, v in made.shape_grid(key)[0]}
        size = made.effects[key].typical
        truth = EffectSet((key,), tuple({strength: size, **shapes}.items()))
        made.problems[0] = problem
        residual = made.predict(truth, base, 0)
        moved = np.where(weight > 0, residual.reshape(weight.shape) / np.where(weight > 0, weight, 1.0), 0.0)
        made.problems[0] = eqx.tree_at(lambda p: p.data.measured, problem, problem.data.measured - moved)
        start = (0.9 if made.effects[key].all_or_nothing else 0.2) * size
        result = made.fit(EffectSet((key,), tuple({strength: start, **shapes}.items())), base, max_steps=20, rtol=1e-8)
        recovered[key] = (
            result.values[strength] / size,
            float(np.sqrt(np.mean(made.counted_samples(result.residual) ** 2))),
        )
    made.problems[0] = problem
    assert len(recovered) > 12, sorted(recovered)
    wrong = {k: v for k, v in recovered.items() if not (abs(v[0] - 1.0) < 0.03 and v[1] < 0.05)}
    assert not wrong, wrong


@pytest.mark.slow
@pytest.mark.parametrize(
    ("hidden", "effects"),
    [
        ({"latent_heat": 8e7}, {"latent-heat": {"strength": 8e7}}),
        ({"drift": 0.05}, {"ambient-drift": {"strength": 0.05}}),
        ({"coating": 0.5, "coating_time": 4.0}, {"coating": {"strength": 0.5, "time_constant": 4.0}}),
        ({"convection_slope": 0.3}, {"convection-temperature": {"strength": 0.3}}),
        ({"draught": 0.3, "draught_instant": 6.0}, {"airflow-change": {"strength": 0.3, "instant": 6.0}}),
        ({"friction": 1.2e7}, {"coulomb-friction": {"strength": 1.2e7}}),
        (
            {"friction": 1.2e7, "latent_heat": 8e7},
            {"coulomb-friction": {"strength": 1.2e7}, "latent-heat": {"strength": 8e7}},
        ),
        ({"play": 1.5e-4}, {"backlash": {"strength": 1.5e-4, "begin": -1.0}}),
        ({"lag": 0.05}, {"sensor-lag": {"strength": 0.05}}),
        ({"skew": 0.08}, {"time-skew": {"strength": 0.08}}),
        ({"exponent": 0.35}, {"minor-loop-shape": {"strength": 0.35}}),
        ({"exponent": -0.3}, {"minor-loop-shape": {"strength": -0.3}}),
        ({"encoder_drift": 1.5e-5}, {"encoder-drift": {"strength": 1.5e-5}}),
        ({"resistivity_slope": 8e-4}, {"resistivity-temperature": {"strength": 8e-4}}),
        ({"resistivity_strain": 1.0}, {"resistivity-strain": {"strength": 1.0}}),
        ({"shift": 0.5}, {"transformation-shift": {"strength": 0.5}}),
        ({"set_strain": 2e-3}, {"initial-set": {"strength": 2e-3}}),
        ({"stop": 4e-3}, {"hard-stop": {"strength": 0.9999, "place": 4e-3, "held": 1.0}}),
        ({"end_of_travel": 4e-3}, {"hard-stop": {"strength": 0.9999, "place": 4e-3, "held": 0.0}}),
    ],
    ids=lambda value: "+".join(value) if "strength" in str(value) else "",
)
def test_an_effect_does_what_the_reference_does_in_another_form(hidden, effects):
    """Fine steps, rigid friction, play and lag between samples, a sudden draught: the motions differ by a fraction of the noise."""
    apart, effect = beside_the_reference(hidden, effects)
    assert apart < 0.2 < 0.05 * effect


@pytest.mark.slow
@pytest.mark.parametrize(
    ("hidden", "effects"),
    [
        (
            {"r_strain": 4e-3, "r_above": 5.0, "r_spread": 2.2, "r_kept": 1.0},
            {"r-phase": {"strength": 4e-3, "above": 5.0, "width": 10.0, "kept": 1.0, "hump": 0.0}},
        ),
        (
            {"r_strain": 6e-3, "r_above": 15.0, "r_spread": 2.2, "r_hump": 0.09},
            {"r-phase": {"strength": 6e-3, "above": 15.0, "width": 10.0, "kept": 0.0, "hump": 0.15}},
        ),
        # A supply of 3.4 V, for a wire of 13 ohm as austenite and a largest current of 0.34 A.
        ({"ceiling": 3.4}, {"current-limit": {"strength": 0.2316757, "sharpness": 300.0, "by_voltage": 1.0}}),
        ({"viscous": 2e8}, {"viscous-friction": {"strength": 2e8}}),
    ],
    ids=lambda value: "+".join(value) if "strength" in str(value) else "",
)
def test_an_effect_comes_near_the_reference_where_their_laws_differ(hidden, effects):
    """Approximations (cosine for normal distribution, sharp for sudden limit, coarse drag steps) differ by 2 % of the effect."""
    apart, effect = beside_the_reference(hidden, effects)
    assert apart < 0.02 * effect and effect > 10.0


def beside_the_reference(hidden, effects):
    """Distance of the motion with effects to the reference, and of the reference to the motion without effects, over the noise."""
    made = bench("dead-weight", 12.0, '"displacement", "temperature", "voltage"')
    (recording,) = made.splits[0].recordings
    rig = reference_rig(data_path("recordings", "dead-weight") / "rig.toml")
    truth = [displacement(rig, Hidden(**own), recording.time, recording.channels["current"]) for own in ({}, hidden)]
    values = {f"effects.{key}.{name}": value for key, own in effects.items() for name, value in own.items()}
    residual = made.series(made.predict(EffectSet(tuple(effects), tuple(values.items())), made.nominal, 0))[
        "displacement"
    ]
    moved = recording.channels["displacement"] - residual * made.noise["displacement"]
    return (np.sqrt(np.mean((other - truth[1]) ** 2)) / made.noise["displacement"] for other in (moved, truth[0]))


@pytest.mark.slow
@pytest.mark.parametrize(
    ("hidden", "effects"),
    [
        ({"crosstalk": 0.06}, {"wire-crosstalk": {"strength": 0.06}}),
        ({"friction": 1.2e7}, {"coulomb-friction": {"strength": 1.2e7}}),
        (
            {"play": 7.5e-3},
            {"backlash": {"strength": 1.5e-4}},
        ),  # along the pulley of 20 mm, from the middle of the play
        ({"lag": 0.1}, {"sensor-lag": {"strength": 0.1}}),
        ({"skew": 0.08}, {"time-skew": {"strength": 0.08}}),
        ({"encoder_drift": 5e-3}, {"encoder-drift": {"strength": 1e-4}}),
    ],
    ids=lambda value: "+".join(value) if "strength" in str(value) else "",
)
def test_an_effect_on_two_wires_does_what_the_reference_does(hidden, effects):
    """A pulley that sticks while the wires' stresses differ by less than the friction, and heat that passes between the wires."""
    made = bench("rotary", 6.0, "", ("mechanism", "sensor"))
    (recording,) = made.splits[0].recordings
    rig = reference_rig(data_path("recordings", "rotary") / "rig.toml")
    currents = np.column_stack([recording.channels["current_1"], recording.channels["current_2"]])
    truth = [angle(rig, Hidden(**own), recording.time, currents, 40) for own in ({}, hidden)]
    values = {f"effects.{key}.{name}": value for key, own in effects.items() for name, value in own.items()}
    residual = made.series(made.predict(EffectSet(tuple(effects), tuple(values.items())), made.nominal, 0))["angle"]
    moved = recording.channels["angle"] - residual * made.noise["angle"]
    apart, effect = (np.sqrt(np.mean((other - truth[1]) ** 2)) for other in (moved, truth[0]))
    assert apart < 0.2 * made.noise["angle"] < 0.05 * effect


@pytest.mark.slow
def test_an_infrared_spot_adds_the_radiation_of_wire_and_background():
    """Absent at 0; by hand for a cold and for a warmed background; the derivative is that of a small change."""
    time, wire = jnp.linspace(0.0, 100.0, 201), 25.0 + jnp.concatenate([jnp.zeros(1), jnp.full(200, 55.0)])

    def change(share, warming=0.0):
        spot = InfraredSpot(strength=jnp.asarray(share), warming=jnp.asarray(warming), time_constant=jnp.asarray(5.0))
        return spot.reading(wire, {}, time)

    assert not np.any(change(0.0, 0.3))
    cold = (0.4 * (80.0 + 273.15) ** 4 + 0.6 * (25.0 + 273.15) ** 4) ** 0.25 - 273.15
    assert float(change(0.6)[-1]) == pytest.approx(cold - 80.0, abs=1e-9)
    warm = (0.4 * (80.0 + 273.15) ** 4 + 0.6 * (25.0 + 0.3 * 55.0 + 273.15) ** 4) ** 0.25 - 273.15
    assert float(change(0.6, 0.3)[-1]) == pytest.approx(warm - 80.0, abs=1e-6)
    assert float(change(0.6, 1.0)[-1]) == pytest.approx(0.0, abs=1e-6)  # after 20 time constants
    slope = jax.jacfwd(change, argnums=(0, 1))(0.3, 0.3)
    for k, step in enumerate(((1e-6, 0.0), (0.0, 1e-6))):
        finite = (change(0.3 + step[0], 0.3 + step[1]) - change(0.3 - step[0], 0.3 - step[1])) / 2e-6
        np.testing.assert_allclose(slope[k], finite, rtol=1e-6, atol=1e-6)
    assert np.all(np.asarray(jax.jacfwd(change)(0.0))[1:] < -10.0)


def test_a_draught_blows_for_its_share_of_a_step():
    draught = AirflowChange(strength=jnp.asarray(0.3), instant=jnp.asarray(2.5))
    times, steps = jnp.array([1.0, 2.0, 2.4, 2.4, 3.0]), jnp.array([1.0, 1.0, 0.4, 0.1, 1.0])
    shares = [float(draught.begin_step(jnp.asarray(0.0), t, s)) for t, s in zip(times, steps, strict=True)]
    assert shares == pytest.approx([0.0, 0.5, 0.75, 0.0, 1.0], abs=1e-12)
    assert (
        float(draught.begin_step(jnp.asarray(0.25), jnp.asarray(2.6), jnp.asarray(0.0))) == 0.25
    )  # no step: as before
    slope = jax.grad(
        lambda instant: AirflowChange(strength=jnp.asarray(0.3), instant=instant).begin_step(
            jnp.asarray(0.0), times[1], steps[1]
        )
    )
    assert float(slope(jnp.asarray(2.5))) == pytest.approx(-1.0)


def test_what_a_rig_cannot_have_is_not_tried_and_said():
    traits = plants.dead_weight().capabilities(("displacement",))
    assert "two wires" not in traits and "drag" in traits and "current" in traits
    text = (data_path("recordings", "dead-weight") / "rig.toml").read_text("utf-8")
    for section, said in (
        ('[effects.wire-crosstalk]\nstrength = "0.1"', "does not apply to this rig: it needs two wires"),
        ('[effects.latent-heet]\nstrength = "1 J/m^3"', "not in the catalogue (did you mean 'latent-heat'?)"),
        (
            '[effects.my-own-effect]\nstrength = "1"',
            "needs its module to be imported before, or an installed entry point",
        ),
        ('[effects.quantisation]\nstrength = "1"', "rounding scatters"),
        ('[effects.latent-heat]\nstrenght = "1 J/m^3"', "did you mean 'strength'?"),
        ('[effects.latent-heat]\nstrength = "9 GJ/m^3"', "is not possible"),
    ):
        with pytest.raises(InputError) as error:
            parse_rig(f"{text}\n{section}\n")
        assert said in str(error.value)


def test_a_rig_with_effects_is_written_and_read_back():
    text = (data_path("recordings", "dead-weight") / "rig.toml").read_text("utf-8")
    rig = parse_rig(
        text
        + '\n[effects.latent-heat]\nstrength = "60 MJ/m^3"\n[effects.coating]\nstrength = "0.2"\ntime_constant = "2 s"\n'
    )
    again = parse_rig(rig.to_toml())
    for name in ("effects.latent-heat.strength", "effects.coating.strength", "effects.coating.time_constant"):
        assert float(parameters.get(again.plant, name)) == float(parameters.get(rig.plant, name)) > 0.0
    assert math.isclose(float(parameters.get(rig.plant, "effects.latent-heat.strength")), 6e7)
    assert jax.tree.structure(again.plant) == jax.tree.structure(rig.plant)


def test_a_lag_is_exact_and_the_series_itself_at_zero():
    time = np.concatenate([np.arange(0.0, 2.0, 0.05), [2.0, 2.0, 2.3, 2.3]])
    ramp = 3.0 * time
    for constant in (0.004, 0.03, 0.7):
        exact = 3.0 * (time - constant * (1.0 - np.exp(-time / constant)))
        assert (
            np.max(np.abs(np.asarray(lag_series(jnp.asarray(ramp), jnp.asarray(time), jnp.asarray(constant))) - exact))
            < 1e-8
        )  # of instants 1e-9 s apart
    assert np.array_equal(lag_series(jnp.asarray(ramp), jnp.asarray(time), jnp.asarray(0.0)), ramp)
    slope = jax.jacfwd(lambda c: lag_series(jnp.asarray(ramp), jnp.asarray(time), c))(jnp.asarray(0.0))
    assert np.asarray(slope)[1:-4] == pytest.approx(-3.0)


def _response(key: str, strengths: list[float]) -> tuple[np.ndarray, np.ndarray]:
    """Displacements of a dead weight with an effect of several strengths, and the result codes."""
    plant, inputs = plants.dead_weight(), discretise(plants.dead_weight(), plants.inputs("dead_weight"))

    def response(strength: jax.Array) -> tuple[jax.Array, jax.Array]:
        member = dataclasses.replace(plant, effects=(catalogue()[key](strength=strength),))  # pyright: ignore[reportCallIssue]
        states, code = simulate.simulate_states(member, inputs)
        return simulate.observe(member, states, inputs, ("displacement",))["displacement"], code

    moved, codes = jax.jit(jax.vmap(response))(jnp.asarray(strengths))
    return np.asarray(moved), np.asarray(codes)


@pytest.mark.slow
def test_friction_of_any_strength_can_be_simulated_and_takes_motion():
    moved, codes = _response("coulomb-friction", [0.0, 1e5, 1e6, 3e6, 1e7, 2e7, 5e7, 1e8, 1.5e8])
    assert not codes.any()
    assert np.all(np.isfinite(moved))
    ways = np.sum(np.abs(np.diff(moved)), axis=1)
    assert np.all(np.diff(ways) < 0.0)


@pytest.mark.slow
def test_a_pulley_that_sticks_while_detwinning_begins_or_ends_can_be_simulated():
    """The balance is steep there and flat next to it: Newton's steps used to oscillate across the kink without converging."""
    friction = catalogue()["coulomb-friction"](reversal=1e-6)  # pyright: ignore[reportCallIssue]
    small = {"wire.diameter": 1.5e-4, "wire.length": 0.3, "wire.prestrain": 0.025, "pulley.radius": 0.012}
    plant = parameters.replace(dataclasses.replace(plants.light_rotary(), effects=(friction,)), small)
    levels = np.random.default_rng(0).uniform(0.15, 0.36, 20)
    first, rows = np.repeat(levels * (np.arange(20) % 2 == 0), 100), 2000
    channels = {"current_1": first, "current_2": np.repeat(levels, 100) - first, "angle": np.zeros(rows)}
    inputs = discretise(plant, plants.recording(channels, 0.02 * np.arange(rows)))

    def turned(strength: jax.Array) -> tuple[jax.Array, jax.Array]:
        member = parameters.replace(plant, {"effects.coulomb-friction.strength": strength})
        states, code = simulate.simulate_states(member, inputs)
        return code, jnp.ptp(simulate.observe(member, states, inputs, ("angle",))["angle"])

    codes, ranges = jax.jit(jax.vmap(turned))(jnp.append(jnp.geomspace(2e6, 4e7, 256)[249:], 2e6))
    assert not np.any(codes)
    assert np.all(np.asarray(ranges) > 1.0)


def test_friction_at_its_end_moves_with_nothing_however_rest_is_rounded():
    """Otherwise rounding would select different derivatives for start and end of a step, and tangents would grow at rest."""
    for end in (-1.0, 1.0):
        for rounding in (-1e-16, 0.0, 1e-16):
            z, (by_memory, by_motion) = jax.value_and_grad(presliding_state, (0, 1))(
                jnp.asarray(end), jnp.asarray(rounding), jnp.asarray(2e-6)
            )
            assert (z, by_memory, by_motion) == (end, 0.0, 0.0)
        assert abs(presliding_state(jnp.asarray(end), jnp.asarray(-end * 1e-6), jnp.asarray(2e-6)) - 0.5 * end) < 1e-12


class _Curved(DriveEffect):
    """Effect that may be ``spoilt``: NaN if it is evaluated at strength 0."""

    strength: jax.Array = parameter("1", "share", -1.0, 1.0, 0.0)
    spoilt: bool = eqx.field(static=True, default=True)
    key = "curved"

    @skip_at_zero
    def signal(self, signal, resistance):
        """Compute the addition to the inputs."""
        nothing = jnp.where(self.strength == 0.0, jnp.nan if self.spoilt else 1.0, 1.0)
        return nothing * self.strength * signal**3 * resistance


def test_a_hook_skipped_at_zero_is_computed_only_for_a_derivative_by_its_strength():
    """At 0 the hook of the base class is evaluated, in both modes; derivatives by the strength are those of the effect itself."""
    signal, ratio = jnp.array([0.4, -0.7]), jnp.array([0.8, 0.9])

    def added_signal(strength, signal, spoilt=True):
        return _Curved(strength=strength, spoilt=spoilt).signal(signal, ratio)

    nothing, some = jnp.asarray(0.0), jnp.asarray(0.3)
    assert np.array_equal(added_signal(nothing, signal), np.zeros(2))
    for mode in (jax.jacfwd, jax.jacrev):
        assert np.array_equal(mode(lambda x: added_signal(nothing, x))(signal), np.zeros((2, 2)))
        assert mode(lambda x: added_signal(some, x))(signal) == pytest.approx(
            np.diag(0.9 * np.asarray(signal**2 * ratio)), rel=1e-14
        )
        for strength in (nothing, some):
            assert mode(lambda s: added_signal(s, signal, False))(strength) == pytest.approx(
                np.asarray(signal**3 * ratio), rel=1e-14
            )
    strengths = jnp.array([0.0, 0.3])
    assert jax.vmap(lambda s: added_signal(s, signal))(strengths) == pytest.approx(
        np.outer(strengths, signal**3 * ratio), rel=1e-14
    )


@pytest.mark.parametrize("strength", [0.0, 0.4, -0.4])
def test_a_fraction_a_hair_below_none_is_left_as_it_is(strength):
    """A step may end slightly below 0; scaled by such a fraction, values and tangents would grow from step to step."""
    effect, before = MinorLoopShape(strength=jnp.asarray(strength)), Fractions(jnp.array([-2e-9]), jnp.array([0.0]))

    def after(detwinned):
        return effect.modify_fractions(before, Fractions(detwinned, jnp.array([0.0]))).detwinned

    assert after(jnp.array([-3e-9])) == pytest.approx([-3e-9], rel=1e-12)
    assert jax.jacfwd(after)(jnp.array([-3e-9])) == pytest.approx(np.ones((1, 1)), rel=1e-9)


def test_what_an_effect_strains_at_the_start_moves_no_zero():
    moved, _ = _response("stress-dependent-strain", [0.0, 1.0])
    assert moved[:, 0] == pytest.approx(0.0, abs=1e-12)
    assert np.ptp(moved[1]) < 0.99 * np.ptp(moved[0])


@pytest.mark.slow
def test_an_effect_of_strength_zero_changes_no_bit():
    """The simulation of a rig with it is the simulation of the rig without it; one of another strength is not."""
    rig = read_rig(data_path("recordings", "dead-weight") / "rig.toml")
    recording = rig.read(data_path("recordings", "dead-weight") / "train.csv").slice(0.0, 12.0)
    without = np.asarray(simulate.simulate(rig.plant, recording).channels["displacement"])

    def with_effect(key, strength):
        needed = {"reference": 0.33} if "reference" in declarations(catalogue()[key]) else {}
        plant = dataclasses.replace(rig.plant, effects=(catalogue()[key](strength=strength, **needed),))
        return np.asarray(simulate.simulate(plant, recording).channels["displacement"])

    possible = [
        key
        for key, kind in catalogue().items()
        if not kind.unavailable_reason(rig.plant.capabilities(("displacement",)))
    ]
    assert len(possible) > 20
    for key in possible:
        assert np.array_equal(with_effect(key, 0.0), without), key
    assert not np.array_equal(with_effect("latent-heat", 1e7), without)


def test_heating_roundness_changes_heating_only():
    """The rate of the reverse transformation is that of minor-loop-shape, the forward one that of the law."""
    none = jnp.zeros(1)
    effect = catalogue()["heating-roundness"](strength=jnp.asarray(0.5))  # pyright: ignore[reportCallIssue]
    both = MinorLoopShape(strength=jnp.asarray(0.5))
    high, low = Fractions(jnp.array([0.6]), none), Fractions(jnp.array([0.4]), none)
    assert effect.modify_fractions(low, high) == high
    heated = effect.modify_fractions(high, low).detwinned
    assert heated == both.modify_fractions(high, low).detwinned and heated[0] > 0.4

    def after_heating(strength):
        return dataclasses.replace(effect, strength=strength).modify_fractions(high, low).detwinned

    slope = jax.jacfwd(after_heating)(jnp.asarray(0.0))
    change = (after_heating(jnp.asarray(1e-6)) - after_heating(jnp.asarray(0.0))) / 1e-6
    assert slope[0] > 0.01 and np.asarray(slope) == pytest.approx(np.asarray(change), rel=1e-4)


@pytest.mark.slow
def test_plastic_strain_grows_with_the_power_of_the_stress():
    """Two cycles at 300 MPa with a power of 3 strain as 2 * 8 cycles at 150 MPa; a slack wire is not strained."""
    plant = plants.stress_path()
    phase = np.linspace(0.0, 4.0 * np.pi, 241)
    temperature = 85.0 - 75.0 * np.cos(phase)

    def last_strain(stress, **values):
        effect = catalogue()["stress-ratcheting"](**values)
        inputs = {"temperature": temperature, "stress": np.full(241, stress), "strain": 0.0 * phase}
        member = dataclasses.replace(plant, effects=(effect,))
        return float(np.asarray(simulate.simulate(member, plants.recording(inputs)).channels["strain"])[-1])

    for stress, power, cycles in ((150e6, 3.0, 2.0), (300e6, 3.0, 16.0), (0.0, 3.0, 0.0)):
        added = last_strain(stress, strength=1e-3, power=power) - last_strain(stress)
        assert added == pytest.approx(1e-3 * cycles, rel=1e-6, abs=1e-12)


@pytest.mark.slow
def test_elastic_part_has_two_slopes():
    plant = plants.stress_path()
    effect = catalogue()["two-slope-elasticity"](strength=1e-11, knee=1e8)  # pyright: ignore[reportCallIssue]
    stress = np.linspace(0.0, 2e8, 41)
    inputs = plants.recording({"temperature": np.full(41, 150.0), "stress": stress, "strain": 0.0 * stress})
    strains = [
        np.asarray(simulate.simulate(dataclasses.replace(plant, effects=effects), inputs).channels["strain"])
        for effects in ((), (effect,))
    ]
    assert strains[1] - strains[0] == pytest.approx(1e-11 * np.maximum(stress - 1e8, 0.0), abs=1e-15)
