"""Nonsmooth functions: values, NaN, and derivatives that a compiled program keeps."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from smajax.laws.prandtl_ishlinskii import Envelope, PrandtlIshlinskii
from smajax.laws.response import compute_response
from smajax.numerics.nonsmooth import clip, largest, maximum, minimum, peak_to_peak

NUMBERS = st.floats(allow_nan=True, allow_infinity=True, allow_subnormal=False)


@settings(max_examples=200, deadline=None, derandomize=True)
@given(NUMBERS, NUMBERS)
def test_values_are_numpys(a, b):
    np.testing.assert_array_equal(maximum(a, b), np.maximum(a, b))
    np.testing.assert_array_equal(minimum(a, b), np.minimum(a, b))


@settings(max_examples=100, deadline=None, derandomize=True)
@given(st.lists(NUMBERS, min_size=1, max_size=6), NUMBERS, NUMBERS)
def test_of_many(values, low, high):
    np.testing.assert_array_equal(largest(jnp.asarray(values)), np.max(values))
    np.testing.assert_array_equal(clip(jnp.asarray(values), low, high), np.minimum(np.maximum(values, low), high))
    np.testing.assert_array_equal(
        largest(jnp.asarray([values, values[::-1]]), axis=1), np.max([values, values], axis=1)
    )
    if np.all(np.isfinite(values)) and np.isfinite(np.ptp(values)):
        assert float(peak_to_peak(jnp.asarray(values))) == np.ptp(values)


@pytest.mark.parametrize("side", [maximum, minimum])
def test_at_a_tie_both_sides_count_half(side):
    assert tuple(map(float, jax.grad(side, argnums=(0, 1))(0.3, 0.3))) == (0.5, 0.5)
    assert tuple(map(float, jax.grad(side, argnums=(0, 1))(-1.0, 0.3))) == (
        (0.0, 1.0) if side is maximum else (1.0, 0.0)
    )


@pytest.mark.parametrize("mode", [jax.jacfwd, jax.jacrev])
def test_a_compiled_program_keeps_the_derivatives_of_plays(mode):
    """Every row by every parameter against differences: a comparison of a play with its envelope, which the program may compute twice
    and round differently, says nothing of which of them moves it."""
    rng = np.random.default_rng(5)
    time = np.arange(200) * 0.1
    values = np.interp(time, time[::20], rng.uniform(0.0, 1.0, 10))
    point = np.array([0.5, 0.3, 0.2, 0.15, 0.62, 1.1, 4.0, -1.6, 0.9, 1.13, 4.1, -1.02, 0.95])

    @jax.jit
    def outputs(p):
        law = PrandtlIshlinskii(p[0], p[4] * jnp.arange(1, 4) / 3, p[1:4], Envelope(*p[5:9]), Envelope(*p[9:13]))
        return jax.vmap(lambda v: compute_response(law, jnp.asarray(time), v))(jnp.asarray(values)[None])[0]

    slopes = np.asarray(jax.jit(mode(outputs))(jnp.asarray(point)))
    for k in range(len(point)):
        step = 1e-6 * np.eye(len(point))[k]
        central = np.asarray(outputs(point + step) - outputs(point - step)) / 2e-6
        np.testing.assert_allclose(slopes[:, k], central, atol=1e-7)
