"""Compiled functions whose loops are one machine function each on the CPU: what ``jit_with_kernels`` does.

XLA runs a loop on the CPU as a list of small machine functions (kernels), one for each group of fused operations, and
calls all of them in every iteration. The steps of a wire have a few numbers each, so that these calls take most of the
time. XLA compiles a call with the attribute ``xla_cpu_small_call`` into a single kernel instead. XLA's own pass
(SmallWhileLoopHoistingPass) moves a loop into such a call if it is below a threshold, which can be changed for the
whole process only. Here the outermost loops of single functions are moved, in the lowered module, so that a program is
the same with any settings of the process.

A kernel must not have the operations of ``_UNAVAILABLE``, nor sums and products that XLA leaves to a library: XLA would
abort the process. Such a loop stays as it is, and those inside it become kernels. Nor may the argument of the call be
unused after XLA's simplifications. A loop over (a, b) therefore becomes, with a tuple that is always used::

    caller:        call @smajax_kernel(tuple(a, b))   {xla_cpu_small_call = "true", inlineable = "false"}
    smajax_kernel: call @smajax_loop(tuple)           {inlineable = "false"}
    smajax_loop:   while(tuple[0], tuple[1])
"""

import functools
import math
import weakref
from collections.abc import Callable
from typing import Any

import equinox as eqx
import jax
import jax.extend.core
from jax.extend.mlir import ir
from jax.extend.mlir.dialects import func, stablehlo
from jax.interpreters import ad, batching, mlir

from smajax.numerics.lowered_modules import add_call, add_function, blocks_of, callee, children, operations_inside
from smajax.numerics.stored_values import store_repeated_values

# Operations that XLA does not compile into one kernel: those that SmallWhileLoopHoistingPass leaves out, and those that
# XLA expands to them.
_UNAVAILABLE = {
    "all_gather",
    "all_reduce",
    "all_to_all",
    "cholesky",
    "collective_broadcast",
    "collective_permute",
    "convolution",
    "custom_call",
    "fft",
    "infeed",
    "outfeed",
    "partition_id",
    "recv",
    "reduce_scatter",
    "replica_id",
    "rng",
    "scatter",
    "select_and_scatter",
    "send",
    "sort",
    "top_k",
    "triangular_solve",
}
# XLA of jaxlib 0.10 leaves reductions of at least this many numbers to the library YNNPACK, and products of two
# matrices with a dimension of at least this length; a product with a vector may become a reduction.
# test_loops_at_the_thresholds_of_the_library_compile of tests/unit/numerics/test_loop_kernels.py holds them.
_LIBRARY_REDUCTION, _LIBRARY_PRODUCT = 4096, 8


def jit_with_kernels(function: Callable[..., Any], **options: Any) -> Callable[..., Any]:
    """Compile a function as ``equinox.filter_jit`` does, with a single kernel for each of its outermost loops.

    Derivatives in both modes and batches have kernels as well. Kernels are for a program of one device, a CPU.

    Args:
        function: Function of pytrees.
        options: Options of ``jax.jit``, such as ``compiler_options``.
    """
    # The call of this function in a lowered module is found by the identities on its arguments and results. Transposed,
    # its arguments are results.
    called = eqx.filter_jit(function)

    @functools.wraps(function)
    def marked(*args: Any, **kwargs: Any) -> Any:
        args, kwargs = _bind(_argument, (args, kwargs))
        return _bind(_result, called(*args, **kwargs))

    return eqx.filter_jit(marked, **options)


def _bind(primitive: jax.extend.core.Primitive, tree: Any) -> Any:
    return jax.tree.map(lambda leaf: primitive.bind(leaf) if eqx.is_inexact_array(leaf) else leaf, tree)


def _identity(name: str) -> jax.extend.core.Primitive:
    """Return the identity of arrays as a primitive."""
    primitive = jax.extend.core.Primitive(name)
    primitive.def_impl(lambda leaf: leaf)
    primitive.def_abstract_eval(lambda leaf: leaf)
    mlir.register_lowering(primitive, lambda ctx, leaf: [leaf], cacheable=False)
    batching.defvectorized(primitive)
    return primitive


_argument, _result = _identity("smajax_argument"), _identity("smajax_result")
ad.deflinear2(_argument, lambda cotangent, _: [_result.bind(cotangent)])
ad.deflinear2(_result, lambda cotangent, _: [_argument.bind(cotangent)])


def _lower_result(ctx: mlir.LoweringRuleContext, leaf: Any) -> list[Any]:
    """Make kernels of the loops in the function whose call computes the result."""
    call, module = leaf.owner, ctx.module_context
    single_cpu = tuple(module.platforms) == ("cpu",) and getattr(module.axis_context, "num_devices", None) == 1
    # The owner of an argument is a block.
    if single_cpu and not isinstance(call, ir.Block) and call.name == "func.call":
        _make_kernels_of_function(module, callee(call))
    return [leaf]


mlir.register_lowering(_result, _lower_result, cacheable=False)
# Names of the functions of each module whose loops are kernels already.
_finished: weakref.WeakKeyDictionary[Any, set[str]] = weakref.WeakKeyDictionary()


def _make_kernels_of_function(module: mlir.ModuleContext, name: str) -> None:
    names = _finished.setdefault(module.module, set())
    if name not in names:
        names.add(name)
        _make_kernels(module, module.symbol_table[name].operation)


def _make_kernels(module: mlir.ModuleContext, operation: Any) -> None:
    """Make kernels of the outermost loops inside an operation and in the functions that it calls."""
    for inner in children(operation):
        if inner.name == "func.call":
            _make_kernels_of_function(module, callee(inner))
        elif inner.name == "stablehlo.while" and _has_arrays(inner) and _can_be_kernel(module, inner, set()):
            _move_to_kernel(module, inner)
        else:
            _make_kernels(module, inner)


def _has_arrays(loop: Any) -> bool:
    """Return whether all operands are arrays of known shapes: no tokens, nor the symbolic shapes of an export."""
    types = [operand.type for operand in loop.operands]
    return all(isinstance(kind, ir.RankedTensorType) and kind.has_static_shape for kind in types)


def _can_be_kernel(module: mlir.ModuleContext, operation: Any, checked: set[str]) -> bool:
    """Return whether all operations inside, and in the functions that they call, can be part of a kernel."""
    for inner in children(operation):
        if inner.name != "func.call":
            possible = _is_available(inner) and _can_be_kernel(module, inner, checked)
        else:
            name = callee(inner)
            possible = name in checked or _can_be_kernel(module, module.symbol_table[name].operation, checked)
            checked.add(name)
        if not possible:
            return False
    return True


def _is_available(operation: Any) -> bool:
    kind = operation.name.partition(".")[2]
    if kind in ("reduce", "reduce_window"):
        return math.prod(operation.operands[0].type.shape) < _LIBRARY_REDUCTION
    if kind == "dot_general":
        left, right = (operand.type.shape for operand in operation.operands)
        numbers = stablehlo.DotDimensionNumbers(operation.attributes["dot_dimension_numbers"])
        batch = math.prod(left[i] for i in numbers.lhs_batching_dimensions)
        shared = math.prod(left[i] for i in numbers.lhs_contracting_dimensions)
        rows, columns = (math.prod(shape) // max(1, batch * shared) for shape in (left, right))
        small = min(rows, columns) == 1 or max(rows, shared, columns) < _LIBRARY_PRODUCT
        return small and batch * rows * shared * columns < _LIBRARY_REDUCTION
    return kind not in _UNAVAILABLE


def _move_to_kernel(module: mlir.ModuleContext, loop: Any) -> None:
    """Move a loop into a new function, a kernel, and replace the loop by a call of that function."""
    used = [*loop.operands, *_values_from_outside(loop)]
    results, types = list(loop.results), [result.type for result in loop.results]
    packed = ir.Type.parse(f"tuple<{', '.join(str(value.type) for value in used)}>")

    def define(name: str) -> Any:
        function = add_function(module, name, [packed], types)
        _finished[module.module].add(function.name.value)
        return function

    with loop.location:
        body, kernel = define("smajax_loop"), define("smajax_kernel")
        with ir.InsertionPoint(loop):
            outputs = add_call(kernel, [stablehlo.tuple(used)], inlineable="false", xla_cpu_small_call="true").results
        for result, output in zip(results, outputs, strict=True):
            result.replace_all_uses_with(output)
        with ir.InsertionPoint(kernel.add_entry_block()):
            func.ReturnOp(list(add_call(body, [kernel.arguments[0]], inlineable="false").results))
        with ir.InsertionPoint(body.add_entry_block()):
            inputs = [stablehlo.get_tuple_element(body.arguments[0], k) for k in range(len(used))]
            loop.move_before(func.ReturnOp(results).operation)
    replacements = dict(zip(used, inputs, strict=True))
    for operation in (loop, *operations_inside(loop)):
        for k, operand in enumerate(operation.operands):
            if operand in replacements:
                operation.operands[k] = replacements[operand]
    store_repeated_values(module, loop)


def _values_from_outside(loop: Any) -> list[Any]:
    """The values that the operations inside a loop use and that are computed outside of it, without its operands."""
    operations = list(operations_inside(loop))
    blocks = [block for o in (loop, *operations) for block in blocks_of(o)]
    known = {*loop.operands}
    known |= {value for o in operations for value in o.results}
    known |= {value for block in blocks for value in block.arguments}
    return list(dict.fromkeys(value for o in operations for value in o.operands if value not in known))
