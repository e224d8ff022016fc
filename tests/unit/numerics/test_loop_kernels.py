"""Functions with kernels give the numbers of the plain functions, also transformed, and XLA compiles them."""

import re
import subprocess
import sys

import equinox as eqx
import jax
import jax.export
import jax.numpy as jnp
import numpy as np
import pytest

from smajax.numerics.loop_kernels import jit_with_kernels
from tests.conftest import ROOT

KERNEL = 'xla_cpu_small_call = "true"'
ROWS = jnp.linspace(0.0, 1.0, 50)
START = jnp.linspace(0.1, 1.0, 300)  # more bytes than XLA's own threshold
SLOPES = jnp.asarray([0.5, 1.0, 2.0])


def loop(slope, start, rows, unused=None):
    """A loop over rows, whose state is an array; the sums after each row, and the number of rows."""

    def advance(state, row):
        state = jnp.sin(slope * state) + row * jnp.exp(-state)
        return state / (1.0 + jnp.sum(state**2)), jnp.sum(state)

    return jax.lax.scan(advance, start, rows)[1], jnp.asarray(len(rows))


def batch(function):
    return lambda slopes: jax.vmap(lambda slope: function(slope, START, ROWS)[0])(slopes)


def gradient(function):
    return jax.grad(lambda slope, start, rows: jnp.sum(function(slope, start, rows)[0] ** 2), argnums=(0, 1, 2))


def repeated(function):
    """The loop within another loop."""
    return lambda slope, rows: jax.lax.scan(
        lambda total, row: (total + function(slope + row, START, rows)[0][-1], total), 0.0, ROWS[:3]
    )


TRANSFORMED = {
    "jit": lambda f: jax.jit(lambda: f(0.7, START, ROWS)),
    "nested jit": lambda f: jax.jit(lambda: jax.jit(jax.jit(f))(0.7, START, ROWS)),
    "unused arguments": lambda f: jax.jit(lambda slope: f(slope, START, ROWS, ROWS + slope)[0]),
    "constant arguments": lambda f: jax.jit(lambda: f(jnp.asarray(0.7), jnp.ones(300), jnp.arange(50.0) / 50.0)),
    "called twice": lambda f: jax.jit(lambda slope: f(slope, START, ROWS)[0] + jax.jit(f)(2.0, START, ROWS)[0]),
    "vmap": lambda f: jax.jit(lambda: batch(f)(SLOPES)),
    "vmap of jit of vmap": lambda f: jax.jit(lambda: jax.vmap(jax.jit(batch(f)))(jnp.stack([SLOPES, 2.0 * SLOPES]))),
    "vmap of rows": lambda f: jax.jit(lambda: jax.vmap(lambda r: f(0.7, START, r))(jnp.stack([ROWS, 2.0 * ROWS]))),
    "jvp": lambda f: jax.jit(lambda: jax.jvp(lambda s: f(s, START, ROWS)[0], (0.7,), (1.0,))),
    "jacfwd": lambda f: jax.jit(lambda: jax.jacfwd(lambda s: f(0.7, s, ROWS)[0])(START[:30])),
    "grad": lambda f: jax.jit(lambda: gradient(f)(0.7, START, ROWS)),
    "vmap of grad": lambda f: jax.jit(lambda: jax.vmap(lambda s: gradient(f)(s, START, ROWS))(SLOPES)),
    "grad of checkpoint": lambda f: jax.jit(
        lambda: jax.grad(lambda s: jnp.sum(jax.checkpoint(lambda s: f(s, START, ROWS)[0])(s)))(0.7)
    ),
    "hessian": lambda f: jax.jit(lambda: jax.hessian(lambda s: jnp.sum(f(s, START, ROWS)[0]))(0.7)),
    "within a loop": lambda f: jax.jit(lambda: repeated(f)(0.7, ROWS)),
    "grad within a loop": lambda f: jax.jit(lambda: jax.grad(lambda s: repeated(f)(s, ROWS)[0])(0.7)),
    "marked within marked": lambda f: jax.jit(lambda: jit_with_kernels(repeated(f))(0.7, ROWS)),
}


def test_a_function_that_a_program_calls_twice_has_one_kernel():
    function = jit_with_kernels(loop)
    program = jax.jit(lambda s: (function(s, START, ROWS), function(2.0 * s, START, ROWS))).lower(0.7).as_text()
    assert program.count(KERNEL) == 1


def test_compiler_options_are_those_of_the_program():
    with pytest.raises(jax.errors.JaxRuntimeError, match="no_such_option"):
        jit_with_kernels(loop, compiler_options={"no_such_option": True})(0.7, START, ROWS)


@pytest.mark.slow
@pytest.mark.parametrize("name", TRANSFORMED)
def test_transformed_functions_give_the_same_numbers_and_are_kernels(name):
    marked = TRANSFORMED[name](jit_with_kernels(loop))
    arguments = (0.7,) if name in ("unused arguments", "called twice") else ()
    expected = TRANSFORMED[name](loop)(*arguments)
    for value, other in zip(jax.tree.leaves(marked(*arguments)), jax.tree.leaves(expected), strict=True):
        np.testing.assert_allclose(value, other, rtol=1e-12, atol=1e-14)
    assert KERNEL in marked.lower(*arguments).as_text()


def test_the_backward_pass_is_a_kernel_as_well():
    program = jax.jit(gradient(jit_with_kernels(loop))).lower(0.7, START, ROWS).as_text()
    assert program.count(KERNEL) == program.count("stablehlo.while") == 2


def test_without_jit_it_is_a_function_of_arrays():
    sums, count = jit_with_kernels(loop)(0.7, np.asarray(START), rows=ROWS)
    np.testing.assert_allclose(sums, loop(0.7, START, ROWS)[0], rtol=1e-12)
    assert count == 50


def test_pytrees_and_functions_are_arguments():
    @jit_with_kernels
    def apply(tree, function, name):
        return {name: jax.lax.map(function, tree["rows"])}

    assert jnp.all(apply({"rows": ROWS, "text": "a"}, jnp.sin, "sines")["sines"] == jnp.sin(ROWS))


def test_methods_of_modules_are_functions():
    class Model(eqx.Module):
        slope: jax.Array

        @jit_with_kernels
        def run(self, start):
            return loop(self.slope, start, ROWS)[0]

    model = Model(jnp.asarray(0.7))
    np.testing.assert_allclose(model.run(START), loop(0.7, START, ROWS)[0], rtol=1e-12)
    slope = eqx.filter_grad(lambda m: jnp.sum(m.run(START)))(model).slope
    expected = jax.grad(lambda s: jnp.sum(loop(s, START, ROWS)[0]))(0.7)
    assert float(slope) == pytest.approx(float(expected), rel=1e-12)


@pytest.mark.slow
@pytest.mark.parametrize(
    ("name", "unavailable"),
    [
        ("sort", lambda state: jnp.sort(state)),
        ("scatter", lambda state: state.at[jnp.asarray([3, 1, 3])].add(1.0, mode="promise_in_bounds")),
        ("linear algebra", lambda state: state + jnp.linalg.solve(jnp.eye(3) * (2.0 + state[0] ** 2), state[:3])[0]),
        ("fft", lambda state: jnp.fft.fft(state).real),
        ("top_k", lambda state: state * jax.lax.top_k(state, 2)[0][1]),
        ("callback", lambda state: jax.pure_callback(lambda s: np.asarray(s), state, state)),
        ("convolution", lambda state: jnp.convolve(state, jnp.ones(3) / 3.0, mode="same")),
        ("sum of a library", lambda state: state / jnp.sum(jnp.outer(state, state))),
        ("product of a library", lambda state: state * jnp.sum(jnp.outer(state, state)[:9] @ jnp.ones((300, 2)))),
    ],
)
def test_operations_that_xla_cannot_compile_into_a_kernel_are_left_outside(name, unavailable):
    """XLA would abort the process; other loops are kernels, also those inside such a loop."""

    def run(start):
        return jax.lax.scan(lambda state, _: (unavailable(state) / 2.0, state[0]), start, None, length=4)

    def with_inner_loop(start):
        return jax.lax.scan(
            lambda state, _: (unavailable(state) / 2.0, loop(0.7, state, ROWS)[0]), start, None, length=4
        )

    for function, expected in ((run, 0), (with_inner_loop, 1), (lambda s: (run(s), loop(0.7, s, ROWS)[0]), 1)):
        program = jax.jit(jit_with_kernels(function))
        for value, other in zip(jax.tree.leaves(program(START)), jax.tree.leaves(function(START)), strict=True):
            np.testing.assert_allclose(value, other, rtol=1e-12, atol=1e-14)
        assert program.lower(START).as_text().count(KERNEL) == expected


REDUCTIONS = {
    "sum": lambda n: lambda state: state / jnp.sum(jnp.resize(state, n)),
    "largest": lambda n: lambda state: state / jnp.max(jnp.resize(jnp.sin(state), n)),
    "sum over rows": lambda n: lambda state: state * jnp.sum(jnp.resize(state, (n // 16, 16)), axis=0)[1],
    "sum over columns": lambda n: lambda state: state * jnp.sum(jnp.resize(state, (16, n // 16)), axis=1)[1],
    "running sum": lambda n: lambda state: state / jnp.cumsum(jnp.resize(state, n))[-1],
    "position": lambda n: lambda state: state + jnp.argmax(jnp.resize(state, n)),
    "product with a vector": lambda n: lambda state: state / jnp.sum(jnp.resize(state, (n // 64, 64)) @ state[:64]),
    "products of vectors": lambda n: (
        lambda state: (
            state
            / jnp.sum(
                jnp.einsum("bi,bi->b", jnp.resize(state, (n // 64, 64)), jnp.resize(jnp.cos(state), (n // 64, 64)))
            )
        )
    ),
    "norm": lambda n: lambda state: state / jnp.sqrt(jnp.vdot(jnp.resize(state, n), jnp.resize(state, n))),
}
PRODUCTS = ((7, 7, 7), (8, 7, 2), (2, 8, 2), (2, 2, 8), (1, 8, 8), (8, 1, 8), (8, 8, 1), (20, 20, 20))


@pytest.mark.slow
@pytest.mark.parametrize("size", [4080, 4096, 5120])
@pytest.mark.parametrize("name", REDUCTIONS)
def test_loops_at_the_thresholds_of_the_library_compile(name, size):
    check_loop(REDUCTIONS[name](size))


@pytest.mark.slow
@pytest.mark.parametrize("shape", PRODUCTS)
@pytest.mark.parametrize("batch", [None, 3])
def test_loops_with_products_of_matrices_compile(shape, batch):
    m, k, n = shape
    first, second = ((m, k), (k, n)) if batch is None else ((batch, m, k), (batch, k, n))
    check_loop(lambda state: state / jnp.sum(jnp.resize(state, first) @ jnp.resize(jnp.cos(state), second)))


def check_loop(function):
    """The loop of a function gives the same numbers with kernels; the process may not end either."""

    def run(start):
        return jax.lax.scan(lambda state, _: (jnp.tanh(function(state)) + 0.1, state[0]), start, None, length=4)

    for value, other in zip(jax.tree.leaves(jit_with_kernels(run)(START)), jax.tree.leaves(run(START)), strict=True):
        np.testing.assert_allclose(value, other, rtol=1e-10)


def test_programs_are_exported():
    exported = jax.export.export(jax.jit(jit_with_kernels(loop)), platforms=["cpu"])(jnp.asarray(0.7), START, ROWS)
    assert KERNEL in exported.mlir_module()
    np.testing.assert_allclose(exported.call(jnp.asarray(0.7), START, ROWS)[0], loop(0.7, START, ROWS)[0], rtol=1e-12)
    several = jax.export.export(jax.jit(jit_with_kernels(loop)), platforms=["cpu", "cuda"])
    assert several(jnp.asarray(0.7), START, ROWS).platforms == ("cpu", "cuda")


def test_programs_of_symbolic_shapes_are_exported():
    def sines(rows):
        return jax.lax.scan(lambda state, row: (jnp.sin(state) + row, state[0]), START, rows)[1]

    shape = jax.ShapeDtypeStruct(jax.export.symbolic_shape("rows"), jnp.float64)
    exported = jax.export.export(jax.jit(jit_with_kernels(sines)), platforms=["cpu"])(shape)
    assert KERNEL not in exported.mlir_module()
    np.testing.assert_allclose(exported.call(ROWS), sines(ROWS), rtol=1e-12)


@pytest.mark.slow
def test_every_program_of_the_package_is_compiled_with_kernels():
    """Otherwise its digits and its speed would not be those of the same loop in another program."""
    # Steps that other programs contain, without a loop of their own over time; stored programs are traced with kernels.
    contained = {"knee.py": 1, "compilation.py": 2, "loop_kernels.py": 3, "rig_problem.py": 2, "stored_programs.py": 2}
    for path in (ROOT / "smajax").rglob("*.py"):
        found = re.findall(r"^[^#`]*\b(?:filter_jit|jax\.jit\()", path.read_text("utf-8"), re.MULTILINE)
        assert len(found) <= contained.get(path.name, 0), path


def test_a_program_for_several_devices_is_unchanged():
    code = """
import jax, jax.numpy as jnp, numpy as np
jax.config.update("jax_num_cpu_devices", 2)
from tests.unit.numerics.test_loop_kernels import KERNEL, ROWS, SLOPES, START, jit_with_kernels, loop
mesh = jax.make_mesh((2,), ("slopes",), axis_types=(jax.sharding.AxisType.Auto,))
slopes = jax.device_put(jnp.append(SLOPES, 3.0), jax.sharding.NamedSharding(mesh, jax.sharding.PartitionSpec("slopes")))
run = jax.jit(lambda f, slopes: jax.vmap(lambda slope: f(slope, START, ROWS)[0])(slopes), static_argnums=0)
np.testing.assert_allclose(run(jit_with_kernels(loop), slopes), run(loop, slopes), rtol=1e-12)
print(KERNEL in run.lower(jit_with_kernels(loop), slopes).as_text(), len(run(loop, slopes).devices()))
"""
    done = subprocess.run([sys.executable, "-c", code], cwd=ROOT, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
    assert done.stdout.split() == ["False", "2"]
