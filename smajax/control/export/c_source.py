"""JAX functions as C source text: the dialect of ``source_writer`` for C99.

Scalars become variables, arrays flat C arrays in row-major order; slices and shapes are only other ways to index them.
There is no heap. Each equation is one statement (or one loop over the elements of an array); those on which nothing
depends are left out.
"""

import re
from collections.abc import Callable, Mapping, Sequence
from typing import Any

import jax
import numpy as np
from jax.extend.core import Literal

from smajax.control.export.c_loops import LoopWriter
from smajax.control.export.c_operations import NOUNS, elementwise, folded, math_functions, simplified
from smajax.control.export.c_values import C_TYPES, CValue, Kind, constant_scalar, kind_of_dtype
from smajax.errors import InputError

# Counter of the loops over the elements of an array, which are never nested.
_COUNTER = "i"
# Operations that only rearrange or repeat the elements of their operand.
_REARRANGING = ("reshape", "squeeze", "expand_dims", "broadcast_in_dim", "transpose", "slice", "rev", "tile")
# Reductions: start value and format of the next partial result.
_REDUCTIONS = {
    "reduce_sum": ("0", "{0} + {1}"),
    "reduce_prod": ("1", "{0} * {1}"),
    "reduce_max": ("", "smajax_max({0}, {1})"),
    "reduce_min": ("", "smajax_min({0}, {1})"),
    "reduce_and": ("1", "{0} && {1}"),
    "reduce_or": ("0", "{0} || {1}"),
}


class CProgram:
    """What the functions of a C program have in common.

    Attributes:
        static: Values of the static numbers that have names, by name.
        math: Functions of math.h that are used.
        arrays: Names of constant arrays by kind and text.
    """

    def __init__(self, static: Mapping[str, float] | None = None) -> None:
        self.static: dict[str, float] = dict(static or {})
        self.math: set[str] = set()
        self.arrays: dict[tuple[Kind, str], str] = {}

    def array(self, values: np.ndarray, name: str = "") -> CValue:
        """Define a constant array, unless it is there already; return it.

        Args:
            values: Its values.
            name: Its name; by default a number is made up.
        """
        kind = kind_of_dtype(values.dtype)
        flat = [constant_scalar(v).text for v in values.ravel()]
        text = f"[{len(flat)}] = {{{', '.join(flat)}}};"
        if (kind, text) not in self.arrays:
            self.arrays[kind, text] = name or f"smajax_constants_{len(self.arrays) + 1}"
        return CValue(self.arrays[kind, text], values.shape, kind, np.arange(values.size))

    @property
    def definitions(self) -> list[str]:
        """Lines that define the constant arrays."""
        return [f"static const {C_TYPES[kind]} {name}{text}" for (kind, text), name in self.arrays.items()]


def c_body(
    program: CProgram,
    function: Callable[..., Any],
    arguments: Sequence[tuple[Any, Sequence[CValue]]],
    result_names: Sequence[str],
    reserved: Sequence[str] = (),
) -> tuple[list[str], list[CValue]]:
    """Write the body of a C function that is equivalent to a JAX function.

    Args:
        program: What the functions of the program have in common.
        function: The JAX function.
        arguments: Example of each argument, a pytree of arrays, and the C values of its leaves.
        result_names: Preferred names of the variables of the results' leaves.
        reserved: Names that its variables must not have.

    Returns:
        The lines, and the C values of the results' leaves.

    Raises:
        InputError: for an operation that cannot be written, with its name.
    """
    traced = jax.make_jaxpr(function)(*(example for example, _ in arguments))
    writer = CWriter(program, reserved)
    for var, name in zip(traced.jaxpr.outvars, result_names, strict=True):
        if not isinstance(var, Literal):
            writer.result_names.setdefault(var, name)
    results = writer.inline(traced, [value for _, values in arguments for value in values])
    return writer.lines, results


class CWriter(LoopWriter):
    """Writer of the body of one C function.

    Attributes:
        program: What the functions of the program have in common.
        taken: Names of variables so far.
    """

    def __init__(self, program: CProgram, reserved: Sequence[str]):
        super().__init__()
        self.program: CProgram = program
        self.taken: set[str] = {_COUNTER, *reserved}
        self.counts: dict[str, int] = {}

    def new_name(self, noun: str) -> str:
        """Return a new name of a variable: the noun, with a number if it is taken."""
        name = noun
        while name in self.taken:
            self.counts[noun] = self.counts.get(noun, 1) + 1
            name = f"{noun}_{self.counts[noun]}"
        self.taken.add(name)
        return name

    def constant(self, value: Any) -> CValue:
        """Return a constant of the trace."""
        array = np.asarray(value)
        if array.size == 1:
            return self.literal(array, None)
        return self.program.array(array)

    def literal(self, value: Any, equation: Any) -> CValue:
        """Return a literal of the trace."""
        array = np.asarray(value)
        if array.dtype.kind == "f" and not np.all(np.isfinite(array)):
            sign = "-" if float(array.reshape(())) < 0.0 else ""
            text = "smajax_nan()" if np.isnan(array.reshape(())) else f"({sign}smajax_infinity())"
            return CValue(text, array.shape, "real", number=float(array.reshape(())))
        return constant_scalar(array)

    def scalar(self, noun: str, text: str, kind: Kind, shape: tuple[int, ...], operands: Sequence[CValue]) -> CValue:
        """Write the assignment of an expression to a variable, unless it has one already; return its value.

        Args:
            noun: Name of the variable.
            text: The expression.
            kind: Kind of number.
            shape: Shape of the value, of one element.
            operands: Values that the expression uses.
        """
        if text not in self.names:
            name = self.new_name(noun)
            self.line(f"{C_TYPES[kind]} {name} = {text};")
            self.names[text] = CValue(name, shape, kind, sources=_sources(operands))
        return self.names[text]._replace(shape=shape)

    def array(
        self, noun: str, shape: tuple[int, ...], kind: Kind, operands: Sequence[CValue], text: Callable[..., str]
    ) -> CValue:
        """Write an array whose elements are an expression of the elements of its operands; return its value.

        Args:
            noun: Name of the array.
            shape: Its shape.
            kind: Kind of its numbers.
            operands: Values of the same shape, or scalars.
            text: The expression of one element by those of the operands.
        """
        name, size = self.new_name(noun), int(np.prod(shape))
        result = CValue(name, shape, kind, np.arange(size), sources=_sources(operands))
        self.line(f"{C_TYPES[kind]} {name}[{size}];")
        if all(operand.steps is not None for operand in operands):
            counter = _COUNTER
            expression = text(*(operand.element_at(counter) for operand in operands))
            self.line(f"for (int {counter} = 0; {counter} < {size}; {counter}++) {name}[{counter}] = {expression};")
        else:
            for place in range(size):
                expression = text(*(operand.element(place) for operand in operands))
                self.line(f"{name}[{place}] = {expression};")
        return result

    def operation(self, equation: Any, inputs: list[CValue]) -> list[CValue]:
        """Write an equation that is neither a call nor a loop nor a branch.

        Raises:
            InputError: for an operation that has no text.
        """
        kind, options, out = equation.primitive.name, equation.params, equation.outvars[0].aval
        noun: str = self.result_names.get(equation.outvars[0]) or NOUNS.get(kind) or kind
        if (number := folded(equation, inputs)) is not None:
            return [self.literal(number, None)]
        if (operand := simplified(kind, inputs)) is not None:
            return [operand._replace(shape=out.shape)]
        if kind == "split":
            places = np.arange(inputs[0].size).reshape(inputs[0].shape)
            parts = np.split(places, np.cumsum(options["sizes"])[:-1], options["axis"])
            return [inputs[0].view(part.shape, part) for part in parts]
        if kind == "iota":
            return [self.constant(equation.primitive.bind(**options))]
        self.program.math.update(math_functions(kind, options))
        result = self._elementwise(kind, options, inputs, noun, out)
        if result is None and kind in _REARRANGING:
            places = np.arange(inputs[0].size).reshape(inputs[0].shape)
            result = inputs[0].view(out.shape, np.asarray(equation.primitive.bind(places, **options)))
        result = result or self._combined(kind, options, inputs, noun, out)
        if result is None or len(equation.outvars) > 1:
            raise InputError(
                f"the operation '{kind}' cannot be written in C yet: leave out the part of the controller that needs it"
            )
        return [result]

    def _elementwise(
        self, kind: str, options: dict[str, Any], inputs: list[CValue], noun: str, out: Any
    ) -> CValue | None:
        """An elementwise operation; ``None`` for another one."""
        kind_out = kind_of_dtype(out.dtype)
        if kind == "convert_element_type":
            form = (
                None
                if inputs[0].kind == kind_out
                else {"real": "(smajax_real){}", "int": "(int){}"}.get(kind_out, "{} != 0")
            )
            if form is None:
                return inputs[0]
        else:
            form = elementwise(kind, options, inputs)
        if form is None:
            return None
        inputs = [value.broadcast(out.shape) for value in inputs]
        if all(value.index is None for value in inputs) or out.size == 1:
            return self.scalar(noun, form.format(*(v.element(0) for v in inputs)), kind_out, out.shape, inputs)
        return self.array(noun, out.shape, kind_out, inputs, form.format)

    def _combined(self, kind: str, options: dict[str, Any], inputs: list[CValue], noun: str, out: Any) -> CValue | None:
        """A reduction, a product, a concatenation or a slice at a computed place; ``None`` for another one."""
        if kind in _REDUCTIONS:
            groups = np.moveaxis(
                np.arange(inputs[0].size).reshape(inputs[0].shape), options["axes"], range(-len(options["axes"]), 0)
            )
            return self._accumulated(noun, out, [inputs[0]], [groups.reshape(out.size, -1)], _REDUCTIONS[kind], "{0}")
        if kind == "dot_general" and not any(options["dimension_numbers"][1]):
            places = [
                _contracted(v, axes, k)
                for k, (v, axes) in enumerate(zip(inputs, options["dimension_numbers"][0], strict=True))
            ]
            groups = [np.repeat(places[0], len(places[1]), axis=0), np.tile(places[1], (len(places[0]), 1))]
            return self._accumulated(noun, out, inputs, groups, _REDUCTIONS["reduce_sum"], "{0} * {1}")
        if kind == "cumsum" and len(out.shape) == 1:
            groups = [np.arange(out.size)[::-1] if options["reverse"] else np.arange(out.size)]
            return self._running_sum(noun, inputs[0], groups[0])
        if kind in ("concatenate", "stack"):
            return self._joined(kind, options, noun, inputs, out)
        if kind == "dynamic_slice":
            return self._slice(inputs, options, out)
        return None

    def _accumulated(
        self, noun: str, out: Any, operands: list[CValue], groups: list[np.ndarray], rule: tuple[str, str], term: str
    ) -> CValue:
        """Sums, products or extrema over groups of elements, one for each element of the result."""
        start, form = rule
        kind, totals = kind_of_dtype(out.dtype), []
        for row in range(out.size):
            parts = [v.view((g.shape[1],), g[row]) for v, g in zip(operands, groups, strict=True)]
            name, count = self.new_name(noun), groups[0].shape[1]
            first = 0 if start else 1
            begin = start or term.format(*(part.element(0) for part in parts))
            self.line(f"{C_TYPES[kind]} {name} = {begin};")
            if all(part.steps is not None for part in parts) and not first:
                counter = _COUNTER
                text = form.format(name, term.format(*(part.element_at(counter) for part in parts)))
                self.line(f"for (int {counter} = 0; {counter} < {count}; {counter}++) {name} = {text};")
            else:
                for place in range(first, count):
                    self.line(f"{name} = {form.format(name, term.format(*(part.element(place) for part in parts)))};")
            totals.append(CValue(name, (), kind, sources=_sources(operands)))
        return totals[0]._replace(shape=out.shape) if out.size == 1 else self._concatenated(noun, totals, out)

    def _running_sum(self, noun: str, operand: CValue, order: np.ndarray) -> CValue:
        """Cumulative sums in an order of places."""
        total = self.new_name("total")
        result = self.array(noun, operand.shape, operand.kind, [operand], lambda element: element)
        self.line(f"{C_TYPES[operand.kind]} {total} = 0;")
        for place in order:
            self.line(f"{result.text}[{place}] = {total} = {total} + {operand.element(int(place))};")
        return result

    def _concatenated(self, noun: str, parts: Sequence[CValue], out: Any) -> CValue:
        """Values one after the other in one array."""
        name, kind, begin = self.new_name(noun), kind_of_dtype(out.dtype), 0
        self.line(f"{C_TYPES[kind]} {name}[{out.size}];")
        for part in parts:
            self.copy(CValue(name, part.shape, kind, begin + np.arange(part.size)), part)
            begin += part.size
        return CValue(name, out.shape, kind, np.arange(out.size), sources=_sources(parts))

    def _joined(self, kind: str, options: dict[str, Any], noun: str, parts: list[CValue], out: Any) -> CValue:
        """Values joined along an axis: one after the other in an array, of which the result is a view."""
        ends = np.cumsum([part.size for part in parts])
        places = [np.arange(end - p.size, end).reshape(p.shape) for end, p in zip(ends, parts, strict=True)]
        joined = np.stack(places, options["axis"]) if kind == "stack" else np.concatenate(places, options["dimension"])
        return self._concatenated(noun, parts, out).view(out.shape, joined)

    def _slice(self, inputs: list[CValue], options: dict[str, Any], out: Any) -> CValue | None:
        """A slice along the first axis from a computed place on; ``None`` for another slice."""
        source, starts = self.whole(inputs[0]), inputs[1:]
        if source.shape[1:] != out.shape[1:] or not source.size:
            return None
        last, width = source.shape[0] - options["slice_sizes"][0], source.size // source.shape[0]
        place = starts[0].element(0)
        text = f"({place} < 0 ? 0 : {place} > {last} ? {last} : {place})"
        start = self.scalar("place", text if width == 1 else f"{width} * {text}", "int", (), starts)
        return CValue(
            source.text,
            out.shape,
            source.kind,
            np.arange(out.size),
            sources=_sources([source, start]),
            offset=start.text,
        )

    def whole(self, value: CValue) -> CValue:
        """Return a value as a flat array from its first to its last element; it is copied if it is not."""
        if value.is_whole_array and not value.offset:
            return value
        return self.array("row", value.shape, value.kind, [value], lambda element: element)

    def copy(self, target: CValue, source: CValue) -> None:
        """Write the assignment of a value to a variable, or to the elements of an array.

        Args:
            target: The variable or array.
            source: The value.
        """
        if target.index is None:
            self.line(f"{target.text} = {source.element(0)};")
        elif target.size > 1 and source.steps is not None:
            counter = _COUNTER
            text = f"{target.element_at(counter)} = {source.element_at(counter)};"
            self.line(f"for (int {counter} = 0; {counter} < {target.size}; {counter}++) {text}")
        else:
            for place in range(target.size):
                self.line(f"{target.element(place)} = {source.element(place)};")


def _sources(values: Sequence[CValue]) -> frozenset[str]:
    """Names of the members of the state on which values depend."""
    return frozenset().union(*(value.sources for value in values))


def _contracted(value: CValue, axes: Sequence[int], side: int) -> np.ndarray:
    """Places of an operand of a product by its other axes and by its contracted ones."""
    places = np.arange(value.size).reshape(value.shape)
    moved = np.moveaxis(places, axes, range(-len(axes), 0))
    return moved.reshape(-1, int(np.prod([value.shape[a] for a in axes])))


def without_unused(lines: Sequence[str], results: Sequence[str]) -> list[str]:
    """Return the lines of a function's body without variables on which no result depends.

    Args:
        lines: The lines, each of them at most one statement; blocks stay as they are.
        results: Texts that follow the body.
    """
    used = set(re.findall(r"\w+", " ".join(results)))
    selected: list[str] = []
    for line in reversed(lines):
        target = re.match(r"    (?:for \([^)]*\) )?(?:(?:int|smajax_real) )?(\w+)(?:\[[^\]]*\])?(?: = |;)", line)
        if target is None or target.group(1) in used:
            selected.append(line)
            used |= set(re.findall(r"\w+", line))
    return selected[::-1]
