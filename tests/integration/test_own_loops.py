"""The plant in loops of others: an optimiser of optax, and a sampler of blackjax. Each is about thirty lines of a user."""

import dataclasses

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import smajax as sma
from tests.conftest import ROOT

NOISE = 2e-5  # m
RIG = ROOT / "data" / "recordings" / "dead-weight" / "rig.toml"


@pytest.fixture(scope="module")
def bench():
    """Return a rig, its inputs on a grid, and a noisy response to them with h0 = 120 W/m^2/K."""
    rig = sma.read_rig(RIG)
    time = np.arange(0.0, 12.0, 0.1)
    current = np.where((time % 6.0) < 3.0, 0.4, 0.05)
    recording = rig.read({"time [s]": time, "current [A]": current}, observed=False)
    inputs = sma.discretise(rig.plant, recording)
    truth = dataclasses.replace(rig.plant, heat=dataclasses.replace(rig.plant.heat, h0=jnp.asarray(120.0)))
    exact = sma.simulate(truth, inputs).channels["displacement"]
    noise = NOISE * np.random.default_rng(0).standard_normal(len(time))
    return rig, inputs, exact + noise


@pytest.mark.slow
def test_an_optimiser_of_optax_finds_a_parameter(bench):
    optax = pytest.importorskip("optax")
    rig, inputs, measured = bench

    def loss(log_h0):
        plant = dataclasses.replace(rig.plant, heat=dataclasses.replace(rig.plant.heat, h0=jnp.exp(log_h0)))
        residual = measured - sma.simulate(plant, inputs).channels["displacement"]
        return jnp.mean((residual / 1e-3) ** 2)

    optimiser = optax.adam(0.05)
    log_h0 = jnp.log(jnp.asarray(100.0))
    state = optimiser.init(log_h0)

    @jax.jit
    def update(log_h0, state):
        value, gradient = jax.value_and_grad(loss)(log_h0)
        change, state = optimiser.update(gradient, state)
        return optax.apply_updates(log_h0, change), state, value

    for _ in range(60):
        log_h0, state, value = update(log_h0, state)
    assert float(jnp.exp(log_h0)) == pytest.approx(120.0, rel=0.01)
    assert float(value) < 0.01


@pytest.mark.slow
def test_a_sampler_of_blackjax_takes_the_plant_as_a_log_density(bench):
    blackjax = pytest.importorskip("blackjax")
    rig, inputs, measured = bench

    def response(h0):
        plant = dataclasses.replace(rig.plant, heat=dataclasses.replace(rig.plant.heat, h0=h0))
        return sma.simulate(plant, inputs).channels["displacement"]

    def log_density(h0):
        return -0.5 * jnp.sum(((measured - response(h0)) / NOISE) ** 2)

    sensitivity = jax.jacfwd(response)(jnp.asarray(120.0)) / NOISE
    deviation = 1.0 / jnp.sqrt(jnp.sum(sensitivity**2))  # of the estimate, by the delta method
    sampler = blackjax.hmc(log_density, 0.6, inverse_mass_matrix=deviation[None] ** 2, num_integration_steps=3)

    def sample(state, key):
        state, info = sampler.step(key, state)
        return state, (state.position, info.acceptance_rate)

    keys = jax.random.split(jax.random.key(0), 150)
    start = sampler.init(jnp.asarray(120.0) + deviation)
    _, (positions, acceptance) = jax.jit(lambda: jax.lax.scan(sample, start, keys))()
    draws = np.asarray(positions[50:])
    assert float(jnp.mean(acceptance)) > 0.6
    assert draws.std() == pytest.approx(float(deviation), rel=0.4)
    assert abs(draws.mean() - 120.0) < 3.5 * draws.std()
