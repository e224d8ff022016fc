"""Brinson's law against published vectors, the exact reference, and its own invariants."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from smajax.plant.materials.base import Fractions
from smajax.plant.materials.brinson import Brinson
from smajax.plant.materials.cosine_kinetics import cosine_remainder
from tests.reference import brinson as reference
from tests.support import plants

PAPER = Brinson(**plants.ROTARY_PAPER)
EXACT = reference.Material(**{k: plants.MATERIAL[k] for k in reference.Material._fields})
LAW = Brinson(**plants.MATERIAL)


def advance(law: Brinson, fractions: tuple, temperature: tuple, stress: tuple) -> tuple[float, float]:
    arrays = [tuple(jnp.asarray(float(v)) for v in pair) for pair in (fractions, temperature, stress)]
    end = law.evolve(Fractions(*arrays[0]), arrays[1], arrays[2])
    return float(end.detwinned), float(end.twinned)


@pytest.mark.parametrize(
    ("start", "temperature", "stress", "expected"),
    [
        ((0.1, 0.2), (60.0, 60.0), (0.0, 120e6), (0.423378572, 0.128138095)),
        ((0.1, 0.2), (60.0, 60.0), (0.0, 98e6), (0.1, 0.2)),
        ((0.2, 0.1), (50.0, 46.0), (0.0, 50e6), (0.564481642, 0.264895855)),
        ((0.2, 0.1), (50.0, 46.0), (10e6, 10e6), (0.2, 0.486584962)),
        ((0.2, 0.1), (50.0, 40.0), (0.0, 200e6), (1.0, 0.0)),
        ((0.5, 0.5), (20.0, 72.0), (0.0, 0.0), (0.109703234, 0.109703234)),
        ((0.5, 0.3), (20.0, 80.0), (60e6, 60e6), (0.225031452, 0.135018871)),
        ((0.5, 0.3), (20.0, 75.0), (100e6, 100e6), (0.5, 0.3)),
    ],
)
def test_published_vectors(start, temperature, stress, expected):
    assert advance(PAPER, start, temperature, stress) == pytest.approx(expected, abs=3e-9)


def test_constitutive_check_of_the_first_vector():
    fractions = Fractions(jnp.asarray(0.423378572), jnp.asarray(0.128138095))
    modulus = PAPER.modulus(fractions)
    assert float(modulus) == pytest.approx(25157.558e6, rel=1e-7)
    assert float(modulus * (0.02 - 0.041 * fractions.detwinned)) == pytest.approx(66.453151e6, rel=1e-7)


def test_thermal_stress_of_a_clamped_wire_is_compressive():
    hot, cold = jnp.asarray(60.0), jnp.asarray(20.0)
    for fractions, slope in (
        (Fractions(jnp.asarray(0.0), jnp.asarray(0.0)), -0.3465e6),
        (Fractions(jnp.asarray(0.0), jnp.asarray(1.0)), -0.132e6),
    ):
        law = Brinson(**(plants.MATERIAL | {"modulus_austenite": 31.5e9, "modulus_martensite": 20e9}))
        expansion = law.strain(fractions, hot, jnp.asarray(0.0), cold) - law.strain(
            fractions, cold, jnp.asarray(0.0), cold
        )
        assert float(-law.modulus(fractions) * expansion / 40.0) == pytest.approx(slope, rel=1e-3)


def test_remaining_share_is_the_half_cosine():
    x = np.linspace(-0.5, 1.5, 2001)
    exact = 0.5 * (1 + np.cos(np.pi * np.clip(x, 0, 1)))
    assert np.max(np.abs(np.asarray(cosine_remainder(jnp.asarray(x), 0.0)) - exact)) < 1e-15


@pytest.mark.slow
@settings(max_examples=300, deadline=None, derandomize=True)
@given(
    st.tuples(st.floats(0, 1), st.floats(0, 1)),
    st.tuples(st.floats(-20, 200), st.floats(-20, 200)),
    st.tuples(st.floats(0, 600e6), st.floats(0, 600e6)),
)
def test_agrees_with_the_exact_reference_and_stays_in_range(shares, temperature, stress):
    start = (shares[0], shares[1] * (1 - shares[0]))
    mine = advance(LAW, start, temperature, stress)
    exact = reference._monotone_leg(EXACT, *start, temperature[0], stress[0], temperature[1], stress[1])
    assert min(mine) >= -1e-12
    assert sum(mine) <= 1 + 1e-12
    # A leg that starts past its finish with a remaining share completes in the reference; here the smoothing limits it.
    progress = np.asarray(LAW._progress(jnp.asarray(temperature[0]), jnp.asarray(stress[0])))
    if np.all(progress < 0.999):
        assert mine == pytest.approx(exact, abs=3e-4)


@pytest.mark.slow
def test_smoothing_error_is_of_first_order():
    errors = []
    for smoothing in (1e-3, 1e-4, 1e-5):
        law = Brinson(**plants.MATERIAL, smoothing=smoothing)
        worst = 0.0
        for stop in np.linspace(70.0, 110.0, 41):
            exact = reference._monotone_leg(EXACT, 0.6, 0.3, 20.0, 50e6, stop, 50e6)
            worst = max(worst, abs(advance(law, (0.6, 0.3), (20.0, stop), (50e6, 50e6))[0] - exact[0]))
        errors.append(worst)
    orders = np.diff(np.log10(errors)) / -1.0
    assert np.all(np.abs(orders - 1.0) < 0.05), (errors, orders)


@pytest.mark.slow
def test_derivative_across_a_finished_transformation_is_finite():
    def remaining(finish):
        law = Brinson(**(plants.MATERIAL | {"austenite_finish": finish}))
        state = Fractions(jnp.asarray(1.0), jnp.asarray(0.0))
        for a, b in ((20.0, 75.0), (75.0, 79.999999), (79.999999, 80.0), (80.0, 95.0), (95.0, 20.0), (20.0, 70.0)):
            state = law.evolve(state, (jnp.asarray(a), jnp.asarray(b)), (jnp.asarray(0.0), jnp.asarray(0.0)))
        return state.martensite

    slope = jax.jacfwd(remaining)(jnp.asarray(80.0))
    numeric = (remaining(jnp.asarray(80.0 + 1e-5)) - remaining(jnp.asarray(80.0 - 1e-5))) / 2e-5
    assert np.isfinite(float(slope))
    assert float(slope) == pytest.approx(float(numeric), rel=1e-6)
