"""Loops and branches of a trace as C text: the base class of the writer in ``c_source``."""

import abc
from collections.abc import Sequence
from typing import Any

import numpy as np

from smajax.control.export.c_values import C_TYPES, CValue, kind_of_dtype
from smajax.control.export.source_writer import SourceWriter


class LoopWriter(SourceWriter[CValue]):
    """Writer of the loops and branches of a C function."""

    @abc.abstractmethod
    def new_name(self, noun: str) -> str:
        """Return a new name of a variable: the noun, with a number if it is taken."""

    @abc.abstractmethod
    def whole(self, value: CValue) -> CValue:
        """Return a value as a flat array from its first to its last element."""

    @abc.abstractmethod
    def copy(self, target: CValue, source: CValue) -> None:
        """Write the assignment of a value to a variable, or to the elements of an array."""

    def while_loop(self, options: dict[str, Any], inputs: list[CValue]) -> list[CValue]:
        """Write a ``while`` loop with the parameters of its equation; return its last carry."""
        in_condition, in_body = options["cond_nconsts"], options["body_nconsts"]
        condition, body = inputs[:in_condition], inputs[in_condition : in_condition + in_body]
        carry = [self._variable("carry", first) for first in inputs[in_condition + in_body :]]
        with self.block("for (;;) {", "}"):
            (is_true,) = self.inline(options["cond_jaxpr"], condition + carry)
            self.line(f"if (!{is_true.element(0)}) break;")
            self._assign(carry, self.inline(options["body_jaxpr"], body + carry))
        return _depending(carry, inputs)

    def scan_loop(self, options: dict[str, Any], inputs: list[CValue]) -> list[CValue]:
        """Write a ``scan`` as a ``for`` loop; return its last carry and its stacked results."""
        fixed, length, carries = options["num_consts"], options["length"], options["num_carry"]
        if not length:
            empty = [
                CValue("", (0, *a.aval.shape), "real", np.arange(0)) for a in options["jaxpr"].jaxpr.outvars[carries:]
            ]
            return inputs[fixed : fixed + carries] + empty
        carry = [self._variable("carry", first) for first in inputs[fixed : fixed + carries]]
        rows = [self.whole(value) if value.index is not None else value for value in inputs[fixed + carries :]]
        avals = [atom.aval for atom in options["jaxpr"].jaxpr.outvars[carries:]]
        stacks = [self._declared("rows", (length, *aval.shape), kind_of_dtype(aval.dtype)) for aval in avals]
        counter = self.new_name("k")
        order = f"for (int {counter} = 0; {counter} < {length}; {counter}++) {{"
        if options["reverse"]:
            order = f"for (int {counter} = {length - 1}; {counter} >= 0; {counter}--) {{"
        with self.block(order, "}"):
            each = [_row(row, counter) for row in rows]
            results = self.inline(options["jaxpr"], inputs[:fixed] + carry + each)
            for stack, result in zip(stacks, results[carries:], strict=True):
                self.copy(_row(stack, counter, always_array=True), result)
            self._assign(carry, results[:carries])
        return _depending(carry + stacks, inputs)

    def branches(self, options: dict[str, Any], inputs: list[CValue]) -> list[CValue]:
        """Write a ``cond`` or ``switch`` as branches; return its results."""
        which, rest = inputs[0], inputs[1:]
        closed = options["branches"]
        avals = [atom.aval for atom in closed[0].jaxpr.outvars]
        results = [self._declared("result", aval.shape, kind_of_dtype(aval.dtype)) for aval in avals]
        for place, branch in enumerate(closed):
            test = f"{which.element(0)} {'<=' if place == 0 else '=='} {place}"
            head = f"if ({test}) {{" if place == 0 else "else {" if place == len(closed) - 1 else f"else if ({test}) {{"
            with self.block(head, "}"):
                values = self.inline(branch, rest)
                self._assign(results, values)
            sources = frozenset().union(which.sources, *(value.sources for value in values))
            results = [result._replace(sources=result.sources | sources) for result in results]
        return results

    def _declared(self, noun: str, shape: tuple[int, ...], kind: Any) -> CValue:
        """A variable or an array without a value."""
        name, size = self.new_name(noun), int(np.prod(shape, dtype=int))
        self.line(f"{C_TYPES[kind]} {name}[{size}];" if shape else f"{C_TYPES[kind]} {name};")
        return CValue(name, shape, kind, np.arange(size) if shape else None)

    def _variable(self, noun: str, first: CValue) -> CValue:
        """A variable or an array with a start value."""
        variable = self._declared(noun, first.shape, first.kind)._replace(sources=first.sources)
        self.copy(variable, first)
        return variable

    def _assign(self, targets: Sequence[CValue], values: Sequence[CValue]) -> None:
        """Assign several values at once: those that are variables of the loop, or parts of them, are copied first."""
        names = {target.variable for target in targets}
        copies = [self._variable("next", v) if v.variable in names else v for v in values]
        for target, value in zip(targets, copies, strict=True):
            self.copy(target, value)


def _depending(values: Sequence[CValue], inputs: Sequence[CValue]) -> list[CValue]:
    """Results of a loop, which may depend on all of its inputs."""
    sources = frozenset().union(*(value.sources for value in inputs))
    return [value._replace(sources=sources) for value in values]


def _row(stack: CValue, counter: str, always_array: bool = False) -> CValue:
    """The row of an array at a counter of a loop."""
    shape = stack.shape[1:]
    if stack.index is None:
        return stack._replace(shape=shape)
    width = int(np.prod(shape, dtype=int))
    offset = counter if width == 1 else f"{width} * {counter}"
    row = stack._replace(shape=shape, index=np.arange(width), offset=offset)
    return row if shape or always_array else CValue(row.element(0), (), row.kind, sources=row.sources)
