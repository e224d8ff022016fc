"""C text of JAX functions, compiled and compared with JAX."""

import ctypes
import shutil
import subprocess

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from smajax.control.export import c_templates
from smajax.control.export.c_source import CProgram, c_body, without_unused
from smajax.control.export.c_values import CValue
from smajax.errors import InputError
from tests.unit.control.test_fmu import FUNCTIONS

MATRIX = jnp.asarray([[0.5, -0.2, 0.1], [0.0, 0.9, 0.3], [0.2, 0.0, 0.7]])
OWN = {
    "state space": lambda x: (MATRIX @ x, MATRIX[1] @ x, jnp.sum(MATRIX * x[None, :], axis=1)),
    "ring buffer": lambda x: (jnp.append(x[1:], x[0] * 2.0), jnp.roll(x, 1), x[::-1]),
    "extrema": lambda x: (jnp.max(x), jnp.min(x), jnp.prod(x), jnp.any(x > 2.0), jnp.argmax(x > 9.0) * 0.0)[:4],
    "nested": lambda x: jax.lax.fori_loop(0, 4, lambda k, c: jax.lax.fori_loop(0, 3, lambda j, d: 0.9 * d + x, c), x),
    "table": lambda x: jnp.interp(0.3, jnp.asarray([0.0, 1.0]), x[:2]) if False else x * 1.0,
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


@pytest.mark.skipif(shutil.which("cc") is None, reason="there is no C compiler here")
@pytest.mark.parametrize("name", ALL)
def test_c_text_agrees_with_jax(tmp_path, name):
    x = jnp.asarray([-1.3, 0.4, 2.7])
    expected = np.concatenate([np.ravel(leaf) for leaf in jax.tree.leaves(ALL[name](x))] or [np.zeros(0)])
    (tmp_path / "c.c").write_text(program_of(ALL[name], x))
    flags = ["-std=c99", "-Wall", "-Wextra", "-Werror", "-ffp-contract=off", "-shared", "-fPIC", "-Wno-unused-function"]
    subprocess.run(["cc", *flags, "-o", "c.so", "c.c", "-lm"], cwd=tmp_path, check=True)
    results, pointer = np.full(len(expected), 9e9), ctypes.POINTER(ctypes.c_double)
    ctypes.CDLL(str(tmp_path / "c.so")).run(
        *(a.ctypes.data_as(pointer) for a in (np.asarray(x, float).copy(), results))
    )
    np.testing.assert_allclose(results, expected.astype(float), rtol=1e-13, atol=1e-15)


def test_an_operation_without_c_text_raises_with_its_name():
    with pytest.raises(InputError, match="the operation 'sort' cannot be written in C yet"):
        program_of(jnp.sort, jnp.zeros(3))
    with pytest.raises(InputError, match="the operation 'erf_inv'"):
        program_of(jax.scipy.special.erfinv, jnp.zeros(3))
