"""Loops of kernels store what they would compute again, and give the numbers of the plain functions."""

import re

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from smajax.numerics.loop_kernels import jit_with_kernels

COUNT = 5
ROWS, START = jnp.linspace(0.0, 1.0, 20), jnp.linspace(0.1, 1.0, COUNT)
WEIGHTS = jnp.linspace(-1.0, 1.0, COUNT * COUNT).reshape(COUNT, COUNT)
STORED = re.compile(r'call @smajax_stored\w*\(.*inlineable = "false".*-> tensor<([\dx]*)f64>')


def many_operations(x, times=20):
    """A value that takes many cheap operations, which XLA would repeat."""
    for k in range(times):
        x = 0.9 * x + 0.1 / (k + 1.0)
    return x


def coupled(state):
    """A value on which all entries depend: each of them uses all entries of a value of many operations."""
    return jnp.sum(WEIGHTS * many_operations(state)[None], axis=1) / COUNT


def steps(advance):
    """A loop over rows as a function of its start."""
    return lambda start: jax.lax.scan(lambda state, row: (advance(state, row), state), start, ROWS)


def halved(state):
    """A loop within the loop, whose end is found in a few steps."""
    return jax.lax.while_loop(lambda x: jnp.sum(jnp.abs(x)) > 1.0, lambda x: 0.5 * coupled(x), state)


called = jax.jit(coupled)
LOOPS = {
    "in the loop": steps(lambda state, row: coupled(state) + row),
    "in a function": steps(lambda state, row: called(state) + row),
    "in a loop in the loop": steps(lambda state, row: halved(state + row)),
    "in a branch": steps(lambda state, row: jax.lax.cond(row > 0.5, coupled, lambda x: x, state)),
    "twice in a row": steps(lambda state, row: coupled(jnp.sin(coupled(state))) + row),
    "a scalar for all entries": steps(lambda state, row: state * 0.9 + many_operations(row + state[0])),
}


def stored(function, *args):
    """Shapes of the values that a lowered program stores."""
    return STORED.findall(jax.jit(jit_with_kernels(function)).lower(*args).as_text())


@pytest.mark.parametrize("name", LOOPS)
def test_repeated_values_are_stored_and_numbers_stay(name):
    function = LOOPS[name]
    assert stored(function, START)
    for a, b in zip(jit_with_kernels(function)(START), jax.jit(function)(START), strict=True):
        np.testing.assert_allclose(a, b, rtol=1e-13, atol=1e-13)


def batch(function):
    """The function of three starts at once."""
    return lambda start: jax.vmap(function)(jnp.stack([start, 2.0 * start, -start]))


@pytest.mark.parametrize("transform", (jax.jacfwd, jax.jacrev, batch), ids=lambda t: t.__name__)
@pytest.mark.parametrize("name", [n for n in LOOPS if n != "in a loop in the loop"])  # which has no reverse mode
def test_derivatives_and_batches_have_the_numbers_of_the_plain_function(name, transform):
    function = transform(lambda start: LOOPS[name](start)[1])
    assert stored(function, START) or transform is jax.jacrev  # whose loop back needs few operations
    np.testing.assert_allclose(jit_with_kernels(function)(START), jax.jit(function)(START), rtol=1e-12, atol=1e-13)


def test_what_is_used_once_or_takes_few_operations_is_not_stored():
    assert not stored(steps(lambda state, row: many_operations(state) + row), START)
    assert not stored(steps(lambda state, row: jnp.sum(WEIGHTS * (2.0 * state)[None], axis=1) + row), START)


def test_a_batch_stores_what_takes_fewer_operations():
    def advance(state, row):
        value = many_operations(state, 3)
        return jnp.sin(value) * jnp.cos(value) + row

    assert not stored(steps(advance), START)
    assert stored(steps(advance), jnp.linspace(0.0, 1.0, 64))


def test_what_does_not_change_in_the_loop_is_not_stored():
    def function(factor, start):
        return steps(lambda state, row: jnp.sum(WEIGHTS * many_operations(factor)[None], axis=1) * state + row)(start)

    assert not stored(function, START, START)


def test_programs_without_kernels_store_nothing():
    assert "smajax_stored" not in jax.jit(LOOPS["in the loop"]).lower(START).as_text()


def test_a_compiled_loop_has_fewer_operations():
    def operations(program):
        return len(re.findall(r" (?:multiply|add)\(", program.lower(START).compile().as_text()))

    def advance(state, row):
        value = many_operations(state)
        return value / jnp.sum(value) + jnp.cumsum(value) / jnp.max(value) + row

    function = steps(advance)
    assert 2 * operations(jax.jit(jit_with_kernels(function))) < operations(jax.jit(function))
