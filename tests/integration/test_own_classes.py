"""Own classes as a newcomer writes them: a material law that is fitted, a mechanism, and an effect that a diagnosis names."""

import dataclasses

import jax
import jax.numpy as jnp
import numpy as np
import pytest
import tomlkit

from smajax import parameters
from smajax.api.registration import register
from smajax.diagnosis.outcome import diagnose
from smajax.diagnosis.problem import DiagnosisProblem
from smajax.diagnosis.setup import diagnosed_rig
from smajax.files.parameter_sets import load_material
from smajax.files.rig_file import Rig, parse_rig
from smajax.fitting.fit import fit
from smajax.parameters import parameter
from smajax.plant import CurrentDrive, Plant, PolynomialConvection, Wire
from smajax.plant.effects import HeatEffect
from smajax.plant.effects.registry import EFFECTS
from smajax.plant.materials import AbstractBandKinetics
from smajax.plant.materials.registry import MATERIALS
from smajax.plant.mechanisms import AbstractElasticLoad, BiasSpring, Spring
from smajax.plant.mechanisms.registry import MECHANISMS
from smajax.recordings.datasets import data_path
from smajax.recordings.recording import Recording
from smajax.simulation.run import simulate

TEMPLATE = data_path("templates", "dead-weight.toml").read_text("utf-8")


@pytest.fixture(autouse=True)
def registered(monkeypatch):
    """The registries are as before after each test."""
    for registry in (MATERIALS, MECHANISMS, EFFECTS):
        monkeypatch.setattr(registry, "_added", {})


def with_fit(model: str, free: list[str]) -> str:
    """The rig file of the template with another material law and other free parameters."""
    rig = tomlkit.parse(TEMPLATE)
    rig["fit"] = {"model": model, "free": free, "observe": ["displacement"], "starts": 1}
    if model != "brinson":
        del rig["material"]["detwinning_start_stress"], rig["material"]["detwinning_finish_stress"]
    return tomlkit.dumps(rig)


def pulses(seed: int, rows: int = 400, step: float = 0.05) -> Recording:
    """A current that jumps between 0 and 0.35 A at random times."""
    rng = np.random.default_rng(seed)
    levels = np.repeat(rng.uniform(0.0, 0.35, rows // 40), 40)
    time = step * np.arange(rows)
    return Recording.from_arrays("pulses", time, {"current": levels})


def measured(rig: Rig, recording: Recording, noise: float, seed: int) -> Recording:
    """The recording with the simulated displacement and white noise."""
    displacement = np.asarray(simulate(rig.plant, recording, interpolation=rig.interpolation).channels["displacement"])
    noisy = displacement + noise * np.random.default_rng(seed).standard_normal(len(displacement))
    return dataclasses.replace(recording, channels={**recording.channels, "displacement": noisy})


class TanhLaw(AbstractBandKinetics):
    """An own material law: transformation along a hyperbolic tangent in place of a cosine."""

    steepness: jax.Array = parameter("1", "steepness k of the transformation", 0.5, 10.0, 2.0)

    def remaining_share(self, progress):
        full = jnp.tanh(0.5 * self.steepness)
        return 0.5 - 0.5 * jnp.tanh(self.steepness * (progress - 0.5)) / full


@pytest.mark.slow
def test_an_own_material_is_fitted_and_written_and_used_from_a_rig_file():
    register("material", "tanh", TanhLaw)
    text = with_fit("tanh", ["heat.h0", "material.max_transformation_strain", "material.steepness"])
    rig = parse_rig(text)
    truth = {"heat.h0": 95.0, "material.max_transformation_strain": 0.043, "material.steepness": 3.0}
    hidden = dataclasses.replace(rig, plant=parameters.replace(rig.plant, truth))
    recording = measured(hidden, pulses(1), 1e-5, seed=2)

    result = fit(rig.plant, [recording], rig.fit, interpolation=rig.interpolation)

    estimates = {e.name: e for e in result.estimates}
    for name, value in truth.items():
        assert estimates[name].estimate == pytest.approx(value, rel=0.02), name
    again = parse_rig(rig.to_toml({n: e.estimate for n, e in estimates.items()}))
    assert isinstance(again.plant.material, TanhLaw) and again.fit.model == "tanh"


class HardeningSpring(AbstractElasticLoad):
    """An own mechanism: one wire that stretches a spring whose stiffness grows, F = preload + k x + c x^3."""

    stiffness: jax.Array = parameter("N/m", "stiffness k of the spring at rest", 0.0, 1e5)
    cubic: jax.Array = parameter("N/m^3", "growth c of the stiffness", 0.0, 1e12, 0.0)
    preload: jax.Array = parameter("N", "force of the spring at the start", 0.0, 100.0, 1.0)

    def force(self, displacement):
        return self.preload + self.stiffness * displacement + self.cubic * displacement**3


@pytest.mark.slow
def test_an_own_mechanism_is_simulated_from_python_and_from_a_rig_file():
    mechanism = HardeningSpring(stiffness=250.0, preload=2.0)
    plant = Plant(
        wire=Wire(diameter=0.15e-3, length=0.23),
        material=load_material("rotary-table1"),
        mechanism=mechanism,
        drive=CurrentDrive(),
        heat=PolynomialConvection(h0=100.0),
    )
    spring = dataclasses.replace(plant, mechanism=BiasSpring(Spring(stiffness=250.0, preload=2.0)))
    recording = pulses(1)
    displacement = simulate(plant, recording).channels["displacement"]
    np.testing.assert_allclose(displacement, simulate(spring, recording).channels["displacement"], atol=1e-12)
    assert np.ptp(displacement) > 1e-3

    register("mechanism", "hardening-spring", HardeningSpring)
    text = with_fit("brinson", ["mechanism.stiffness"]).replace('kind = "dead-weight"', 'kind = "hardening-spring"')
    text = text.replace("[load]\nmass = ", '[mechanism]\nstiffness = "250 N/m"\npreload = "2 N"\ncubic = "1e7 N/m^3" #')
    rig = parse_rig(text)
    assert rig.fit.observe == ("displacement",)
    soft, hard = (simulate(parameters.replace(rig.plant, {"mechanism.cubic": c}), recording) for c in (0.0, 1e7))
    assert 0.3 < np.ptp(hard.channels["displacement"]) / np.ptp(soft.channels["displacement"]) < 0.9
    again = parse_rig(rig.to_toml({"mechanism.stiffness": 300.0})).plant.mechanism
    assert isinstance(again, HardeningSpring) and float(again.stiffness) == 300.0 and float(again.cubic) == 1e7


class GuideContact(HeatEffect):
    """An own effect: the wire loses heat s c (T - T_ambient) to a guide that it touches as it contracts by c."""

    strength: jax.Array = parameter("W/m^3/K", "heat loss per kelvin and contraction", 0.0, 5e8, 0.0)
    key = "guide-contact"
    typical = 3e7
    source = "estimate"

    def power(self, state, memory, context):
        return -self.strength * state.contraction * (state.temperature - context.environment.ambient)


@pytest.mark.slow
def test_an_own_effect_is_named_by_a_diagnosis(monkeypatch):
    shipped = {key: EFFECTS[key] for key in ("latent-heat", "coating", "encoder-gain")}
    monkeypatch.setattr(EFFECTS, "_shipped", shipped)  # three rivals instead of all, for the time of the test
    register("effect", "guide-contact", GuideContact)
    rig = parse_rig(with_fit("brinson", ["heat.h0", "heat.capacity", "material.max_transformation_strain"]))
    hidden = parse_rig(rig.to_toml() + '\n[effects.guide-contact]\nstrength = "8e7 W/m^3/K"\n')
    recordings = [measured(hidden, pulses(seed), 1e-5, seed) for seed in (1, 2, 3)]

    problem = DiagnosisProblem(rig.plant, recordings, rig.fit, interpolation=rig.interpolation)
    diagnosis = diagnose(problem, seed=0)

    assert diagnosis.after.effect_set.keys == ("guide-contact",)
    found = diagnosed_rig(rig, problem.fitted_plant(diagnosis.after), ()).to_toml()
    assert parse_rig(found).plant.effects[0].strength == pytest.approx(8e7, rel=0.1)
