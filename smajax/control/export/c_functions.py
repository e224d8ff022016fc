"""C functions with a state, written from JAX functions; ``c_header`` puts them together."""

import re
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np

from smajax.control.export.c_source import CProgram, c_body, without_unused
from smajax.control.export.c_templates import FUNCTION, STATE
from smajax.control.export.c_values import C_TYPES, CValue, constant_scalar, kind_of_dtype
from smajax.control.export.named_leaves import leaf_names
from smajax.control.export.static_numbers import static_numbers, with_static_numbers


def number_text(number: float) -> str:
    """Return a number as a C expression.

    Args:
        number: The number, which may be infinite.
    """
    if np.isfinite(number):
        return f"(smajax_real){number!r}"
    return "smajax_nan()" if np.isnan(number) else "smajax_infinity()" if number > 0.0 else "-smajax_infinity()"


class Constants:
    """Numbers of a module by name: scalars as ``#define``, arrays as constant arrays.

    Attributes:
        numbers: The module without anything but its numbers.
        others: The module without its numbers.
        static: Values of its static numbers that have names, by name.
        values: C values of the numbers, and of the static ones.
        defines: Lines that define the scalars.
    """

    def __init__(
        self,
        program: CProgram,
        module: Any,
        prefix: str = "",
        renamed: Mapping[str, str] | None = None,
        literal: Callable[[str, float], bool] = lambda name, number: False,
    ):
        """Name the numbers of a module.

        Args:
            program: The program that gets the constant arrays.
            module: The module.
            prefix: Prefix of the names.
            renamed: Other names of some numbers.
            literal: Whether a scalar is written as a number, by name and value.
        """
        numbers, others = eqx.partition(module, eqx.is_inexact_array)
        self.numbers: Any = numbers
        self.others: Any = others
        own = static_numbers(module)
        self.static: dict[str, float] = {name: value for name, value in program.static.items() if name in own}
        self.values: list[CValue] = []
        self.defines: list[str] = []
        for name, leaf in zip(leaf_names(self.numbers), jax.tree.leaves(self.numbers), strict=True):
            array, name = np.asarray(leaf), (renamed or {}).get(name, prefix + name)
            if array.ndim:
                self.values.append(program.array(array, f"smajax_{name}"))
            elif literal(name, float(array)):
                self.values.append(constant_scalar(array))
            else:
                self.defines.append(f"#define SMAJAX_{name.upper()} ({number_text(float(array))})")
                self.values.append(_named_scalar(name))
        self.values += map(_named_scalar, self.static)

    @property
    def argument(self) -> tuple[Any, list[CValue]]:
        """The numbers as an argument of ``c_body``."""
        return (self.numbers, tuple(self.static.values())), self.values

    def module(self, numbers: Any) -> Any:
        """Return the module with other numbers, given as in ``argument``."""
        leaves, static = numbers
        named = dict(zip(self.static, static, strict=True))
        return with_static_numbers(eqx.combine(leaves, self.others), self.static, named)


def _named_scalar(name: str) -> CValue:
    """A number that the header defines."""
    return CValue(f"SMAJAX_{name.upper()}", (), "real")


@dataclass(frozen=True)
class StateType:
    """A C structure for the state of a function.

    Attributes:
        name: Name of the structure.
        pointer: Name of the variable that points to it.
        example: Example of the state, a pytree of arrays.
        names: Name of the member of each leaf.
        needed: Whether each leaf influences any output.
    """

    name: str
    pointer: str
    example: Any
    names: list[str]
    needed: list[bool]

    @property
    def values(self) -> list[CValue]:
        """C values of the leaves."""
        values = []
        for name, leaf in zip(self.names, jax.tree.leaves(self.example), strict=True):
            text, index = f"{self.pointer}->{name}", np.arange(leaf.size) if leaf.shape else None
            values.append(CValue(text, leaf.shape, kind_of_dtype(leaf.dtype), index, sources=frozenset([name])))
        return values

    def definition(self, meaning: str) -> str:
        """Return the text of the structure."""
        members = [
            f"{C_TYPES[value.kind]} {name}{f'[{value.size}]' if value.shape else ''};"
            for name, value, needed in zip(self.names, self.values, self.needed, strict=True)
            if needed
        ]
        return STATE.format(meaning=meaning, members="\n    ".join(members or ["int unused;"]), name=self.name)

    def writes(self, results: Sequence[CValue]) -> list[str]:
        """Return the lines that assign the results of a function to the needed members."""
        before, after = [], []
        members = {value.text for value in self.values}
        for name, member, result, needed in zip(self.names, self.values, results, self.needed, strict=True):
            if not needed or (result.text == member.text and result.has_same_places(member)):
                continue
            if result.variable in members:  # a part of the state, which may be assigned before
                copy = member._replace(text=f"last_{name}")
                before.append(f"    {C_TYPES[member.kind]} last_{name}{f'[{member.size}]' if member.shape else ''};")
                before += _assignments(copy, result)
                result = copy
            after += _assignments(member, result)
        return [*before, *after]


def _assignments(target: CValue, source: CValue) -> list[str]:
    """Lines that assign a value to a variable, or to the elements of an array."""
    if target.size > 1 and source.steps is not None:
        text = f"{target.element_at('k')} = {source.element_at('k')};"
        return [f"    for (int k = 0; k < {target.size}; k++) {text}"]
    return [f"    {target.element(k)} = {source.element(k)};" for k in range(target.size)]


def state_type(
    name: str, pointer: str, init: Callable[..., Any], arguments: Sequence[Any], names: Callable[[Any], list[str]]
) -> StateType:
    """Return the structure of a state.

    Args:
        name: Name of the structure.
        pointer: Name of the variable that points to it.
        init: Function that returns the first state.
        arguments: Examples of its arguments.
        names: Function that returns the names of the leaves of the state.
    """
    example = jax.eval_shape(init, *arguments)
    members = names(example)
    return StateType(name, pointer, example, members, [True] * len(members))


def with_needed_leaves(
    program: CProgram, state: StateType, step: Callable[..., Any], arguments: Sequence[tuple[Any, Sequence[CValue]]]
) -> StateType:
    """Return the structure without the leaves on which no output of the step function depends, now or later.

    Args:
        program: The program.
        state: The structure with all leaves.
        step: Function of constants, state and inputs that returns the state and the outputs.
        arguments: Constants and inputs, between which the state stands.
    """
    results = _results(CProgram(program.static), state, step, arguments, [])[1]
    leaves, outputs = results[: len(state.names)], results[len(state.names) :]
    reached = frozenset().union(*(value.sources for value in outputs))
    while True:
        further = reached.union(*(v.sources for n, v in zip(state.names, leaves, strict=True) if n in reached))
        if further == reached:
            break
        reached = further
    return StateType(state.name, state.pointer, state.example, state.names, [n in reached for n in state.names])


def _results(
    program: CProgram,
    state: StateType | None,
    function: Callable[..., Any],
    arguments: Sequence[tuple[Any, Sequence[CValue]]],
    result_names: Sequence[str],
) -> tuple[list[str], list[CValue]]:
    """Lines and results of a function whose second argument is the state, if there is one."""
    every = list(arguments)
    if state is not None:
        every.insert(1, (state.example, state.values))
    reserved = [v.text for _, values in every for v in values if v.text.isidentifier()]
    count = len(jax.tree.leaves(jax.eval_shape(function, *(example for example, _ in every))))
    names = [*result_names, *["result"] * (count - len(result_names))]
    taken = ["k", *(() if state is None else (state.pointer,)), *reserved]
    return c_body(program, function, every, names, taken)


def state_function(
    program: CProgram,
    state: StateType,
    function: Callable[..., Any],
    arguments: Sequence[tuple[Any, Sequence[CValue]]],
    *,
    takes_state: bool = True,
    output: str = "",
) -> list[str]:
    """Return the lines of a function's body that updates a state and returns one output, or none.

    Args:
        program: The program.
        state: The structure of the state.
        function: Function of constants, state and inputs that returns the state and the output, or of constants and
            inputs that returns the state.
        arguments: Constants and inputs.
        takes_state: Whether the function takes the state.
        output: Name of the output; empty for none.
    """
    names = [f"next_{name}" if takes_state else f"first_{name}" for name in state.names]
    lines, results = _results(
        program, state if takes_state else None, function, arguments, [*names, *([output] if output else [])]
    )
    tail = state.writes(results[: len(state.names)])
    if output:
        tail.append(f"    return {results[-1].element(0)};")
        if any(v.text == results[-1].variable for v in state.values):  # a part of the state, which is assigned before
            lines = [*lines, f"    smajax_real output = {results[-1].element(0)};"]
            tail[-1] = "    return output;"
    return [*without_unused(lines, tail), *tail]


def pure_function(
    program: CProgram,
    function: Callable[..., Any],
    arguments: Sequence[tuple[Any, Sequence[CValue]]],
    result_names: Sequence[str],
) -> tuple[list[str], list[CValue]]:
    """Return the lines of a function without a state, and its results.

    Args:
        program: The program.
        function: Function of the arguments.
        arguments: Its arguments.
        result_names: Preferred names of the results' leaves.
    """
    lines, results = _results(program, None, function, arguments, result_names)
    texts = [value.element(k) for value in results for k in range(value.size)]
    return without_unused(lines, texts), results


def scalar_inputs(*names: str) -> list[tuple[Any, list[CValue]]]:
    """Return scalar arguments of a C function by name.

    Args:
        names: Their names.
    """
    return [(jnp.zeros(()), [CValue(name, (), "real")]) for name in names]


def vector_input(name: str, size: int) -> tuple[Any, list[CValue]]:
    """Return an argument of a C function that is an array, or a scalar if it has one element.

    Args:
        name: Its name.
        size: Number of elements.
    """
    return jnp.zeros(size), [CValue(name, (size,), "real", None if size == 1 else np.arange(size))]


def definition(meaning: str, result: str, name: str, parameters: Sequence[str], body: Sequence[str]) -> str:
    """Return the text of a C function.

    Args:
        meaning: Comment.
        result: Type of its result.
        name: Its name.
        parameters: Types and names of its parameters.
        body: Lines of its body.
    """
    unused = [f"    (void){p.split()[-1].lstrip('*')};" for p in parameters if not _is_used(p, body)]
    return FUNCTION.format(
        meaning=meaning, result=result, name=name, parameters=", ".join(parameters), body="\n".join([*unused, *body])
    )


def _is_used(parameter: str, body: Sequence[str]) -> bool:
    """Whether a parameter occurs in the lines of a body, other than as a member of the state."""
    name = parameter.split()[-1].lstrip("*").partition("[")[0]
    return any(re.search(rf"(?<!->)\b{name}\b", line) for line in body)
