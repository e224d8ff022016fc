"""Equal operations are performed once, and results and side effects stay as they are."""

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np

from smajax.numerics.common_subexpressions import merge_equal_operations


def count(function, *args):
    """Number of operations of each kind in a function and in the functions that it calls."""
    numbers: dict[str, int] = {}

    def visit(jaxpr):
        for operation in jaxpr.eqns:
            numbers[operation.primitive.name] = numbers.get(operation.primitive.name, 0) + 1
            for option in jax.tree.leaves(list(operation.params.values()), is_leaf=lambda o: hasattr(o, "jaxpr")):
                if hasattr(option, "jaxpr"):
                    visit(option.jaxpr)

    visit(jax.make_jaxpr(function)(*args).jaxpr)
    return numbers


@jax.custom_jvp
def cube(x):
    return x * x * x


cube.defjvp(lambda p, t: (cube(p[0]), 3.0 * p[0] ** 2 * t[0]))


@jax.custom_vjp
def twice(x):
    return jnp.tanh(x) * 2.0


twice.defvjp(lambda x: (twice(x), None), lambda _, g: (2.0 * g,))


def test_equal_operations_are_performed_once_in_called_functions_too():
    part = jax.jit(lambda x, y: jnp.sin(x) * y + cube(x) + twice(x) + jnp.asarray(2.0) * jnp.clip(x, 0.0, 1.0))

    def function(x, y):
        return {"a": part(x, y) + part(x, y), "b": part(x, y) - jnp.sin(x) + part(x, 1.0 + y)}

    x, y = jnp.linspace(-1.0, 2.0, 7), jnp.linspace(0.0, 1.0, 7)
    merged = merge_equal_operations(function)
    # Up to rounding: a compiled function may round a product before it is added, or not.
    for name, value in function(x, y).items():
        np.testing.assert_allclose(merged(x, y)[name], value, rtol=1e-14, atol=1e-14)
    assert count(function, x, y)["sin"] == 5 and count(function, x, y)["tanh"] == 4
    assert count(merged, x, y)["sin"] == 1 and count(merged, x, y)["tanh"] == 1
    assert count(merged, x, y)["mul"] <= 6


def test_operations_of_other_options_or_values_are_kept_apart():
    def function(x):
        sums = jnp.sum(x, axis=0) @ jnp.ones(3), jnp.sum(x, axis=1) @ jnp.ones(3)
        return *sums, x + 1.0, x + np.float64(1.0), x + 1, -x + 0.0, x * 0.0 + -0.0, jnp.full(3, 1), jnp.full(3, True)

    x = jnp.arange(9.0).reshape(3, 3)
    for a, b in zip(merge_equal_operations(function)(x), function(x), strict=True):
        np.testing.assert_array_equal(a, b)
        assert a.dtype == b.dtype


def test_operations_inside_loops_and_branches_are_merged():
    def function(x, n):
        def body(k, c):
            return jnp.cos(c) * jnp.cos(c) + jax.lax.cond(k > 2, lambda c: jnp.exp(c) - jnp.exp(c) / 2, lambda c: c, c)

        swept = jax.lax.scan(lambda c, r: (c + jnp.sin(r) * jnp.sin(r), c), x[0], x)
        return jax.lax.fori_loop(0, n, body, x), swept

    x = jnp.linspace(0.1, 1.0, 5)
    merged = merge_equal_operations(function)
    jax.tree.map(np.testing.assert_allclose, merged(x, 5), function(x, 5))
    before, after = count(function, x, 5), count(merged, x, 5)
    assert all(before[name] == 2 and after[name] == 1 for name in ("cos", "exp", "sin"))
    np.testing.assert_allclose(jax.vmap(lambda x: merged(x, 5)[0])(jnp.stack([x, 2 * x]))[1], function(2 * x, 5)[0])


def test_side_effects_of_equal_operations_are_all_performed():
    seen = []

    def function(x):
        for _ in range(2):
            jax.debug.callback(lambda v: seen.append(float(v)), x)
        return x

    eqx.filter_jit(merge_equal_operations(function))(jnp.asarray(3.0))
    jax.effects_barrier()
    assert seen == [3.0, 3.0]
