"""Source text of JAX functions: the walk through a trace, which the dialects for NumPy and C share.

A function is traced, and its trace (a jaxpr) is written equation by equation. Calls are inlined; ``while``, ``scan``
and ``cond`` become loops and branches; equations on which no result depends are left out, and a repeated expression is
computed once. An operation that a dialect cannot write raises an error with its name.
"""

import abc
from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any, Generic, TypeVar

from jax.extend.core import ClosedJaxpr, Jaxpr, Literal

# Operations that return their inputs.
_IDENTITY = ("smajax_nondifferentiable", "stop_gradient", "copy", "copy_p", "optimization_barrier", "name")
# Parameters of a call that may hold the jaxpr that it calls.
_INNER = ("jaxpr", "call_jaxpr", "fun_jaxpr")
# Largest integer power that is written as a product. Chosen by trial; tests/unit/control/test_fmu.py compares results.
MAX_PRODUCT_POWER = 4
# Value of ``rounding_method`` for rounding to even.
ROUND_TO_EVEN = 1

Value = TypeVar("Value")


class SourceWriter(abc.ABC, Generic[Value]):
    """Writer of the text of one function in some language.

    Attributes:
        lines: Lines of the function's body.
        names: Value of each expression that has been written.
        depth: Level of indentation.
        result_names: Preferred names of the variables of a jaxpr by variable.
    """

    def __init__(self) -> None:
        self.lines: list[str] = []
        self.names: dict[str, Value] = {}
        self.depth = 1
        self.result_names: dict[Any, str] = {}

    def line(self, text: str) -> None:
        """Write an indented line."""
        self.lines.append("    " * self.depth + text)

    @contextmanager
    def block(self, head: str, end: str = "") -> Iterator[None]:
        """Write an indented block; names from inside are not used after it, since the block may not have run.

        Args:
            head: First line.
            end: Last line; empty for none.
        """
        self.line(head)
        outer_names, self.names = self.names, dict(self.names)
        self.depth += 1
        yield
        self.depth: int = self.depth - 1
        self.names = outer_names
        if end:
            self.line(end)

    def inline(self, closed: ClosedJaxpr | Jaxpr, inputs: list[Value]) -> list[Value]:
        """Write the equations of a jaxpr.

        Args:
            closed: The jaxpr.
            inputs: Its inputs.

        Returns:
            Its results.

        Raises:
            InputError: for an operation that cannot be written.
        """
        jaxpr, consts = (closed.jaxpr, closed.consts) if isinstance(closed, ClosedJaxpr) else (closed, [])
        values = dict(zip(jaxpr.invars, inputs, strict=True))
        values |= {var: self.constant(const) for var, const in zip(jaxpr.constvars, consts, strict=True)}

        def read(atom: Any, equation: Any = None) -> Value:
            return self.literal(atom.val, equation) if isinstance(atom, Literal) else values[atom]

        for equation in needed_equations(jaxpr):
            results = self.equation(equation, [read(atom, equation) for atom in equation.invars])
            values |= dict(zip(equation.outvars, results, strict=True))
        return [read(atom) for atom in jaxpr.outvars]

    def equation(self, equation: Any, inputs: list[Value]) -> list[Value]:
        """Write one equation of a jaxpr.

        Args:
            equation: The equation.
            inputs: Its inputs.

        Returns:
            Its results.

        Raises:
            InputError: for an operation that cannot be written.
        """
        kind, options = equation.primitive.name, equation.params
        inner = next((options[key] for key in _INNER if isinstance(options.get(key), ClosedJaxpr | Jaxpr)), None)
        if kind in ("while", "scan", "cond"):
            write = {"while": self.while_loop, "scan": self.scan_loop, "cond": self.branches}[kind]
            return write(options, inputs)
        if kind in _IDENTITY:
            return inputs
        if inner is not None:
            jaxpr = inner.jaxpr if isinstance(inner, ClosedJaxpr) else inner
            for outer, var in zip(equation.outvars, jaxpr.outvars, strict=True):
                if not isinstance(var, Literal):  # one jaxpr may be called several times
                    self.result_names.pop(var, None)
                    if outer in self.result_names:
                        self.result_names[var] = self.result_names[outer]
            return self.inline(inner, inputs)
        return self.operation(equation, inputs)

    @abc.abstractmethod
    def constant(self, value: Any) -> Value:
        """Return a constant of the trace."""

    @abc.abstractmethod
    def literal(self, value: Any, equation: Any) -> Value:
        """Return a literal of the trace, in an equation that it is for or ``None``."""

    @abc.abstractmethod
    def operation(self, equation: Any, inputs: list[Value]) -> list[Value]:
        """Write an equation that is neither a call nor a loop nor a branch; return its results."""

    @abc.abstractmethod
    def while_loop(self, options: dict[str, Any], inputs: list[Value]) -> list[Value]:
        """Write a ``while`` loop with the parameters of its equation; return its last carry."""

    @abc.abstractmethod
    def scan_loop(self, options: dict[str, Any], inputs: list[Value]) -> list[Value]:
        """Write a ``scan``; return its last carry and its stacked results."""

    @abc.abstractmethod
    def branches(self, options: dict[str, Any], inputs: list[Value]) -> list[Value]:
        """Write a ``cond`` or ``switch`` as branches; return its results."""


def needed_equations(jaxpr: Jaxpr) -> list[Any]:
    """Return the equations on which a jaxpr's results depend, in their order.

    Args:
        jaxpr: The jaxpr.
    """
    needed = {atom for atom in jaxpr.outvars if not isinstance(atom, Literal)}
    equations = []
    for equation in reversed(jaxpr.eqns):
        if any(var in needed for var in equation.outvars):
            equations.append(equation)
            needed |= {atom for atom in equation.invars if not isinstance(atom, Literal)}
    return equations[::-1]
