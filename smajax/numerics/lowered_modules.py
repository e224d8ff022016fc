"""Operations of a lowered module under construction, and functions that are added to it."""

from collections.abc import Iterator, Sequence
from typing import Any

from jax.extend.mlir import ir
from jax.extend.mlir.dialects import func
from jax.interpreters import mlir


def blocks_of(operation: Any) -> list[Any]:
    """Return the blocks of an operation's regions."""
    return [block for region in operation.regions for block in region.blocks]


def children(operation: Any) -> list[Any]:
    """Return the operations directly inside an operation."""
    return [inner.operation for block in blocks_of(operation) for inner in block.operations]


def operations_inside(operation: Any) -> Iterator[Any]:
    """Yield all operations inside an operation."""
    for child in children(operation):
        yield child
        yield from operations_inside(child)


def callee(call: Any) -> str:
    """Return the name of the function that ``func.call`` calls."""
    return call.attributes["callee"].value


def add_function(module: mlir.ModuleContext, name: str, arguments: Sequence[Any], results: Sequence[Any]) -> Any:
    """Add a private function without a body, whose name gets a number if there is one of that name.

    Args:
        module: The module.
        name: Name of the function.
        arguments: Types of the arguments.
        results: Types of the results.
    """
    function = func.FuncOp(name, (list(arguments), list(results)), ip=module.ip)
    function.attributes["sym_visibility"] = ir.StringAttr.get("private")
    module.symbol_table.insert(function)
    return function


def add_call(function: Any, values: Sequence[Any], **attributes: str) -> Any:
    """Add the call of a function at the current place, with attributes for XLA.

    Args:
        function: The function.
        values: Its arguments.
        attributes: Frontend attributes of the call.
    """
    call = func.CallOp(function.type.results, ir.FlatSymbolRefAttr.get(function.name.value), list(values)).operation
    texts: dict[str, Any] = {key: ir.StringAttr.get(text) for key, text in attributes.items()}
    call.attributes["mhlo.frontend_attributes"] = ir.DictAttr.get(texts)
    return call
