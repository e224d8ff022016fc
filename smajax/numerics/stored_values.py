"""Values in a loop that are stored where XLA would compute them again for each of their uses.

XLA fuses an operation into every operation that uses its result, and so performs it once for each of them. Where the
unknowns of a step are coupled, that multiplies the operations of a loop. Here such values are found in a lowered loop,
before XLA sees it: those whose computation from stored values takes many more operations, over all uses, than storing
them. XLA does not fuse across the call of a function that must not be inlined. The call of one that returns its
argument therefore has a value stored.

What does not change in a loop stays as it is, since XLA computes it before the loop.

With it the shipped wire that lifts a weight is differentiated in 0.66 times the time, and one of nine cells simulated
in 0.39 and differentiated in 0.33 times (experiments/speed/compiled_loops.py).
"""

import itertools
import math
from collections import Counter
from typing import Any

from jax.extend.mlir import ir
from jax.extend.mlir.dialects import func
from jax.interpreters import mlir

from smajax.numerics.lowered_modules import add_call, add_function, blocks_of, callee, operations_inside

# Repeated operations for each number of a value from which the value is stored. Chosen by trial.
REPEATED_OPERATIONS = 12
# The same for values of so many numbers, such as those of a batch of designs, or of all grains of all cells.
REPEATED_IN_BATCH, BATCH = 4, 24
# Operations that only move numbers.
_MOVES = {
    "broadcast_in_dim",
    "concatenate",
    "constant",
    "convert",
    "dynamic_slice",
    "get_tuple_element",
    "iota",
    "pad",
    "reshape",
    "reverse",
    "slice",
    "transpose",
    "tuple",
}
# Operations that compute a number from many numbers.
_SUMS = {"reduce", "dot_general"}
# Operations that use as many numbers of an argument as their result has, not each of them once.
_SELECTIONS = {"broadcast_in_dim", "dynamic_slice", "slice"}


def store_repeated_values(module: mlir.ModuleContext, loop: Any) -> None:
    """Store values in the body of a loop, and in the loops and functions inside.

    Args:
        module: The module under construction.
        loop: The operation ``stablehlo.while``.
    """
    _Storage(module).store_in(loop)


class _Storage:
    """Stores values in the loops of a module."""

    def __init__(self, module: mlir.ModuleContext):
        self._module = module
        self._identities: dict[Any, Any] = {}
        self._calls = Counter(callee(o) for o in operations_inside(module.module.operation) if o.name == "func.call")

    def store_in(self, loop: Any) -> None:
        """Store values in the body of a loop and in its condition."""
        for block in blocks_of(loop):
            changing = {*block.arguments} - _unchanged(block)
            self._store_in_block(block, changing, {})

    def _store_in_block(self, block: Any, changing: set[Any], costs: dict[Any, float]) -> list[float]:
        """Store values in a block.

        Args:
            block: The block.
            changing: Values that change in the loop; those that the block computes are added.
            costs: Operations that a number of a value takes, from stored values; 0 of values that are not there.

        Returns:
            The costs of what the block returns.
        """
        operations = [o.operation for o in block.operations]
        for value in block.arguments:
            if value in changing:
                self._store_if_repeated(value, changing, costs, operations[0])
        for operation, following in itertools.pairwise(operations):
            # No costs: what the operation computes does not change.
            for result, cost in zip(operation.results, self._result_costs(operation, changing, costs), strict=False):
                changing.add(result)
                costs[result] = cost
                self._store_if_repeated(result, changing, costs, following)
        return [costs.get(value, 0.0) for value in operations[-1].operands]

    def _result_costs(self, operation: Any, changing: set[Any], costs: dict[Any, float]) -> list[float]:
        """Return the costs of the results of an operation, none if they do not change, and store values inside it."""
        results, kind = operation.results, _kind(operation)
        if kind == "while":
            self.store_in(operation)
            return [0.0] * len(results)
        if kind in ("case", "if"):
            for block in blocks_of(operation):
                self._store_in_block(block, changing, {})
            return [0.0] * len(results)
        if not any(operand in changing for operand in operation.operands):
            return []
        total = sum(costs.get(operand, 0.0) for operand in operation.operands)
        if operation.name != "func.call":
            total += kind not in _MOVES
            repeats = max(map(_size, operation.operands)) / max(1, _size(results[0])) if kind in _SUMS else 1.0
            return [total * max(1.0, repeats)] * len(results)
        function = self._module.symbol_table[callee(operation)].operation
        if self._calls[callee(operation)] > 1:
            inside = sum(_kind(o) not in _MOVES for o in operations_inside(function))
            return [total + inside] * len(results)
        (block,) = blocks_of(function)
        passed = list(zip(block.arguments, operation.operands, strict=True))
        inner = {argument: costs.get(operand, 0.0) for argument, operand in passed}
        return self._store_in_block(block, {argument for argument, operand in passed if operand in changing}, inner)

    def _store_if_repeated(self, value: Any, changing: set[Any], costs: dict[Any, float], following: Any) -> None:
        """Store a value, before the operation that follows, if its uses would repeat many operations."""
        size = _size(value)
        if not size or not isinstance(value.type.element_type, ir.F64Type):
            return
        used = sum(_size(use.owner.results[0]) if _kind(use.owner) in _SELECTIONS else size for use in value.uses)
        least = REPEATED_IN_BATCH if size >= BATCH else REPEATED_OPERATIONS
        if costs.get(value, 0.0) * (used - size) <= least * size:
            return
        with following.location, ir.InsertionPoint(following):
            call = add_call(self._identity(value.type), [value], inlineable="false")
        (stored,) = call.results
        value.replace_all_uses_except(stored, call)
        changing.add(stored)

    def _identity(self, kind: Any) -> Any:
        """Return the function that returns its argument of a type."""
        if kind not in self._identities:
            function = self._identities[kind] = add_function(self._module, "smajax_stored", [kind], [kind])
            with ir.InsertionPoint(function.add_entry_block()):
                func.ReturnOp(list(function.arguments))
        return self._identities[kind]


def _kind(operation: Any) -> str:
    return operation.name.partition(".")[2]


def _size(value: Any) -> int:
    """Return the number of numbers in an array, 0 for anything else."""
    return math.prod(value.type.shape) if isinstance(value.type, ir.RankedTensorType) else 0


def _unchanged(block: Any) -> set[Any]:
    """Return the arguments that the body of a loop returns as they are."""
    *_, last = block.operations
    return {
        value for value, returned in zip(block.arguments, last.operation.operands, strict=False) if value == returned
    }
