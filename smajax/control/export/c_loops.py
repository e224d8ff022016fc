"""Loops and branches of a trace as C text, for ``c_source``."""

from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

import numpy as np

from smajax.control.export.c_values import C_TYPES, CValue, kind_of_dtype

if TYPE_CHECKING:
    from smajax.control.export.c_source import CWriter


def write_while(writer: "CWriter", options: dict, inputs: list[CValue]) -> list[CValue]:
    """Write a ``while`` loop.

    Args:
        writer: The writer of the function.
        options: Parameters of the equation.
        inputs: Its inputs.

    Returns:
        The last carry.
    """
    in_condition, in_body = options["cond_nconsts"], options["body_nconsts"]
    condition, body = inputs[:in_condition], inputs[in_condition : in_condition + in_body]
    carry = [_variable(writer, "carry", first) for first in inputs[in_condition + in_body :]]
    with writer.block("for (;;) {", "}"):
        (is_true,) = writer.inline(options["cond_jaxpr"], condition + carry)
        writer.line(f"if (!{is_true.element(0)}) break;")
        _assign(writer, carry, writer.inline(options["body_jaxpr"], body + carry))
    return _depending(carry, inputs)


def write_scan(writer: "CWriter", options: dict, inputs: list[CValue]) -> list[CValue]:
    """Write a ``scan`` as a ``for`` loop.

    Args:
        writer: The writer of the function.
        options: Parameters of the equation.
        inputs: Its inputs.

    Returns:
        The last carry, and the stacked results.
    """
    fixed, length, carries = options["num_consts"], options["length"], options["num_carry"]
    if not length:
        empty = [CValue("", (0, *a.aval.shape), "real", np.arange(0)) for a in options["jaxpr"].jaxpr.outvars[carries:]]
        return inputs[fixed : fixed + carries] + empty
    carry = [_variable(writer, "carry", first) for first in inputs[fixed : fixed + carries]]
    rows = [writer.whole(value) if value.index is not None else value for value in inputs[fixed + carries :]]
    avals = [atom.aval for atom in options["jaxpr"].jaxpr.outvars[carries:]]
    stacks = [_declared(writer, "rows", (length, *aval.shape), kind_of_dtype(aval.dtype)) for aval in avals]
    counter = writer.new_name("k")
    order = f"for (int {counter} = 0; {counter} < {length}; {counter}++) {{"
    if options["reverse"]:
        order = f"for (int {counter} = {length - 1}; {counter} >= 0; {counter}--) {{"
    with writer.block(order, "}"):
        each = [_row(row, counter) for row in rows]
        results = writer.inline(options["jaxpr"], inputs[:fixed] + carry + each)
        for stack, result in zip(stacks, results[carries:], strict=True):
            writer.copy(_row(stack, counter, always_array=True), result)
        _assign(writer, carry, results[:carries])
    return _depending(carry + stacks, inputs)


def _depending(values: Sequence[CValue], inputs: Sequence[CValue]) -> list[CValue]:
    """Results of a loop, which may depend on all of its inputs."""
    sources = frozenset().union(*(value.sources for value in inputs))
    return [value._replace(sources=sources) for value in values]


def write_branches(writer: "CWriter", options: dict, inputs: list[CValue]) -> list[CValue]:
    """Write a ``cond`` or ``switch`` as branches.

    Args:
        writer: The writer of the function.
        options: Parameters of the equation.
        inputs: Its inputs.

    Returns:
        The results.
    """
    which, rest = inputs[0], inputs[1:]
    closed = options["branches"]
    avals = [atom.aval for atom in closed[0].jaxpr.outvars]
    results = [_declared(writer, "result", aval.shape, kind_of_dtype(aval.dtype)) for aval in avals]
    for place, branch in enumerate(closed):
        test = f"{which.element(0)} {'<=' if place == 0 else '=='} {place}"
        head = f"if ({test}) {{" if place == 0 else "else {" if place == len(closed) - 1 else f"else if ({test}) {{"
        with writer.block(head, "}"):
            values = writer.inline(branch, rest)
            _assign(writer, results, values)
        sources = frozenset().union(which.sources, *(value.sources for value in values))
        results = [result._replace(sources=result.sources | sources) for result in results]
    return results


def _declared(writer: "CWriter", noun: str, shape: tuple[int, ...], kind: Any) -> CValue:
    """A variable or an array without a value."""
    name, size = writer.new_name(noun), int(np.prod(shape, dtype=int))
    writer.line(f"{C_TYPES[kind]} {name}[{size}];" if shape else f"{C_TYPES[kind]} {name};")
    return CValue(name, shape, kind, np.arange(size) if shape else None)


def _variable(writer: "CWriter", noun: str, first: CValue) -> CValue:
    """A variable or an array with a start value."""
    variable = _declared(writer, noun, first.shape, first.kind)._replace(sources=first.sources)
    writer.copy(variable, first)
    return variable


def _assign(writer: "CWriter", targets: Sequence[CValue], values: Sequence[CValue]) -> None:
    """Assign several values at once: those that are variables of the loop themselves are copied first."""
    names = {target.text for target in targets}
    copies = [_variable(writer, "next", v) if v.text in names else v for v in values]
    for target, value in zip(targets, copies, strict=True):
        writer.copy(target, value)


def _row(stack: CValue, counter: str, always_array: bool = False) -> CValue:
    """The row of an array at a counter of a loop."""
    shape = stack.shape[1:]
    if stack.index is None:
        return stack._replace(shape=shape)
    width = int(np.prod(shape, dtype=int))
    offset = counter if width == 1 else f"{width} * {counter}"
    row = stack._replace(shape=shape, index=np.arange(width), offset=offset)
    return row if shape or always_array else CValue(row.element(0), (), row.kind, sources=row.sources)
