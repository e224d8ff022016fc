"""C text of JAX functions, compiled and compared with JAX."""

import ctypes
import shutil
import subprocess
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from smajax.control.export import c_templates
from smajax.control.export.c_functions import definition, scalar_inputs, state_function, state_type
from smajax.control.export.c_source import CProgram, c_body, without_unused
from smajax.control.export.c_values import CValue
from smajax.errors import InputError
from tests.unit.control.test_fmu import FUNCTIONS

MATRIX = jnp.asarray([[0.5, -0.2, 0.1], [0.0, 0.9, 0.3], [0.2, 0.0, 0.7]])
OWN = {
    "state space": lambda x: (MATRIX @ x, MATRIX[1] @ x, jnp.sum(MATRIX * x[None, :], axis=1)),
    "ring buffer": lambda x: (jnp.append(x[1:], x[0] * 2.0), jnp.roll(x, 1), x[::-1]),
    "extrema": lambda x: (jnp.max(x), jnp.min(x), jnp.prod(x), jnp.any(x > 2.0), jnp.all(x < 2.0)),
    "nested": lambda x: jax.lax.fori_loop(0, 4, lambda k, c: jax.lax.fori_loop(0, 3, lambda j, d: 0.9 * d + x, c), x),
    "table": lambda x: jax.lax.dynamic_slice(MATRIX[1] * 3.0, (jnp.sum(x > 0.0),), (1,)),
    "carried element": lambda x: jax.lax.fori_loop(
        0, 5, lambda k, c: (0.5 * c[0] + c[1], c[0][2], c[0][1]), (x, x[0], x[1])
    ),
    "carried view": lambda x: jax.lax.fori_loop(0, 5, lambda k, c: (c[0][::-1], c[0][1:], c[1][0]), (x, x[:2], x[0])),
    "integers": lambda x: jax.lax.fori_loop(
        0, 5, lambda k, c: c + jnp.abs(k - 3) * jnp.sign(k - 2) + (k - 2) % 3 + jnp.maximum(k, 2), jnp.asarray(0)
    ),
    "remainder": lambda x: (x % 0.7, jnp.fmod(x, -0.7), x % -0.7),
}
ALL = FUNCTIONS | OWN


def program_of(function, x):
    """Text of a C file with a function ``run(x, results)``."""
    program = CProgram()
    lines, results = c_body(
        program,
        function,
        [(x, [CValue("x", x.shape, "real", np.arange(x.size))])],
        ["y"] * len(jax.tree.leaves(function(x))),
    )
    texts = [value.element(k) for value in results for k in range(value.size)]
    writes = [f"    results[{k}] = (double)({text});" for k, text in enumerate(texts)]
    math = [c_templates.MATH.format(name=name.upper(), function=name) for name in sorted(program.math)]
    parts = [
        "#include <math.h>",
        *math,
        "typedef double smajax_real;",
        *c_templates.HELPERS.values(),
        *program.definitions,
    ]
    return "\n".join(
        [
            *parts,
            "void run(const double *x, double *results) {\n    (void)x;",
            *without_unused(lines, texts),
            *writes,
            "}\n",
        ]
    )


def results_in_c(folder, text, x, count):
    """Results of the function ``run`` of a C file."""
    (folder / "c.c").write_text(text)
    flags = ["-std=c99", "-Wall", "-Wextra", "-Werror", "-ffp-contract=off", "-shared", "-fPIC", "-Wno-unused-function"]
    subprocess.run(["cc", *flags, "-o", "c.so", "c.c", "-lm"], cwd=folder, check=True)
    results, pointer = np.full(count, 9e9), ctypes.POINTER(ctypes.c_double)
    ctypes.CDLL(str(folder / "c.so")).run(*(a.ctypes.data_as(pointer) for a in (np.asarray(x, float).copy(), results)))
    return results


@pytest.mark.skipif(shutil.which("cc") is None, reason="there is no C compiler here")
@pytest.mark.parametrize("name", ALL)
def test_c_text_agrees_with_jax(tmp_path, name):
    x = jnp.asarray([-1.3, 0.4, 2.7])
    expected = np.concatenate([np.ravel(leaf) for leaf in jax.tree.leaves(ALL[name](x))] or [np.zeros(0)])
    results = results_in_c(tmp_path, program_of(ALL[name], x), x, len(expected))
    np.testing.assert_allclose(results, expected.astype(float), rtol=1e-13, atol=1e-15)


class Delays(NamedTuple):
    values: jax.Array
    mirrored: jax.Array
    oldest: jax.Array


def delayed(constants, state, value):
    """Next state, whose parts are parts of the state before, and an element of that."""
    values = jnp.stack([state.values[1], state.values[2], value])
    return Delays(values, state.values[::-1], state.mirrored[0]), state.values[0]


@pytest.mark.skipif(shutil.which("cc") is None, reason="there is no C compiler here")
def test_a_state_is_read_before_it_is_written(tmp_path):
    first = Delays(jnp.asarray([1.0, 2.0, 3.0]), jnp.asarray([4.0, 5.0, 6.0]), jnp.asarray(7.0))
    program, constants = CProgram(), ((), [])
    state = state_type("state", "s", lambda constants: first, [()], lambda s: list(s._fields))
    each = [constants, *scalar_inputs("value")]
    step = state_function(program, state, delayed, each, output="delayed")
    text = [
        "typedef double smajax_real;",
        state.definition("Delays."),
        definition("One sample.", "smajax_real", "step", ["state *s", "smajax_real value"], step),
        "void run(const double *x, double *results) {\n"
        "    state s = {{1, 2, 3}, {4, 5, 6}, 7};\n    for (int k = 0; k < 6; k++) results[k] = step(&s, x[k]);\n"
        "    for (int k = 0; k < 3; k++) results[6 + k] = s.values[k], results[9 + k] = s.mirrored[k];\n"
        "    results[12] = s.oldest;\n}\n",
    ]
    x = np.linspace(8.0, 13.0, 6)
    last, commands = jax.lax.scan(lambda s, value: delayed((), s, value), first, jnp.asarray(x))
    expected = np.concatenate([commands, last.values, last.mirrored, [last.oldest]])
    np.testing.assert_array_equal(results_in_c(tmp_path, "\n".join(text), x, 13), expected)


def test_an_operation_without_c_text_raises_with_its_name():
    with pytest.raises(InputError, match="the operation 'sort' cannot be written in C yet"):
        program_of(jnp.sort, jnp.zeros(3))
    with pytest.raises(InputError, match="the operation 'erf_inv'"):
        program_of(jax.scipy.special.erfinv, jnp.zeros(3))
