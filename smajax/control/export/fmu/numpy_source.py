"""JAX functions as NumPy source text.

A function is traced, and its trace is written operation by operation (``source_writer``), so that the same equations
of a plant or a controller run without JAX. An operation without a NumPy text raises an error with its name.
"""

import itertools
from collections.abc import Callable, Mapping
from typing import Any

import jax
import numpy as np
from jax.extend.core import Literal

from smajax.control.export.source_writer import MAX_PRODUCT_POWER, ROUND_TO_EVEN, SourceWriter
from smajax.errors import InputError

HEADER = "import numpy as np\nfrom numpy import inf, nan  # noqa: F401\n"
# NumPy texts of JAX's primitives by name.
_INFIX = {
    "add": "+",
    "add_any": "+",
    "sub": "-",
    "mul": "*",
    "div": "/",
    "pow": "**",
    "eq": "==",
    "ne": "!=",
    "lt": "<",
    "le": "<=",
    "gt": ">",
    "ge": ">=",
    "and": "&",
    "or": "|",
    "xor": "^",
}
_CALL = {
    "max": "np.maximum({}, {})",
    "min": "np.minimum({}, {})",
    "rem": "np.fmod({}, {})",
    "atan2": "np.arctan2({}, {})",
    "clamp": "np.minimum(np.maximum({1}, {0}), {2})",
    "neg": "-{}",
    "not": "~{}",
    "rsqrt": "1.0 / np.sqrt({})",
    "logistic": "1.0 / (1.0 + np.exp(-{}))",
    "is_finite": "np.isfinite({})",
    "asin": "np.arcsin({})",
    "acos": "np.arccos({})",
    "atan": "np.arctan({})",
    "asinh": "np.arcsinh({})",
    "acosh": "np.arccosh({})",
    "atanh": "np.arctanh({})",
}
_SAME_NAME = ("abs", "sign", "floor", "ceil", "exp", "exp2", "expm1", "log", "log1p", "sqrt", "cbrt")
_SAME_NAME += ("sin", "cos", "tan", "sinh", "cosh", "tanh")
_CALL |= {name: f"np.{name}({{}})" for name in _SAME_NAME}
_REDUCE = {
    "reduce_sum": "np.sum",
    "reduce_prod": "np.prod",
    "reduce_max": "np.max",
    "reduce_min": "np.min",
    "reduce_and": "np.all",
    "reduce_or": "np.any",
}
# Operations whose literals are written as Python numbers, next to a NumPy value.
_TAKES_NUMBERS = (*_INFIX, "max", "min", "clamp")


def numpy_source(name: str, function: Callable[..., Any], arguments: Mapping[str, Any]) -> str:
    """Return the source text of a NumPy function ``name`` that is equivalent to a JAX function.

    Args:
        name: Name of the function in the text.
        function: The JAX function.
        arguments: Example of each argument by name, a pytree of arrays.

    Returns:
        The text. An argument of the NumPy function is the sequence of the leaves of its pytree (or the array itself if
        the pytree is an array), which need NumPy types; the function returns the leaves of the result as a tuple.

    Raises:
        InputError: for an operation that has no text, with its name.
    """
    traced = jax.make_jaxpr(function)(*arguments.values())
    writer, flat = _Writer(name), []
    for argument, example in arguments.items():
        leaves = len(jax.tree.leaves(example))
        is_leaf = jax.tree_util.treedef_is_leaf(jax.tree.structure(example))
        names = [argument] if is_leaf else [f"{argument}_{i}" for i in range(leaves)]
        if not is_leaf and names:
            writer.line(f"{', '.join(names)}{',' * (leaves == 1)} = {argument}")
        flat += names
    results = writer.inline(traced, flat)
    writer.line(f"return ({', '.join(results)}{',' * (len(results) == 1)})")
    return "\n".join(
        [*writer.constants, *[""] * bool(writer.constants), f"def {name}({', '.join(arguments)}):", *writer.lines, ""]
    )


class _Writer(SourceWriter[str]):
    """Writer of the text of one function; its values are the names of variables.

    Attributes:
        prefix: Prefix of the names of constants.
        constants: Lines that assign the constants, before the function.
        count: Number of variables so far.
    """

    def __init__(self, prefix: str):
        super().__init__()
        self.prefix, self.constants, self.count = prefix.upper(), [], 0

    def new_name(self, letter: str) -> str:
        """Return a new name of a variable that begins with a letter."""
        self.count += 1
        return f"{letter}{self.count}"

    def value(self, text: str) -> str:
        """Write an assignment of an expression, unless it has a name already; return the name of its value."""
        if text not in self.names:
            self.names[text] = self.new_name("v")
            self.line(f"{self.names[text]} = {text}")
        return self.names[text]

    def constant(self, value: Any) -> str:
        """Write a constant before the function, unless it is there already; return its name."""
        array = np.asarray(value)
        text = f"np.array({array.tolist()!r}, np.{_dtype(array.dtype)})" if array.ndim else _scalar(array)
        if text not in self.names:
            self.names[text] = f"{self.prefix}_{len(self.constants)}"
            self.constants.append(f"{self.names[text]} = {text}")
        return self.names[text]

    def literal(self, value: Any, equation: Any) -> str:
        """Return a literal: a Python number next to a NumPy value, else a constant."""
        if equation is not None and _takes_numbers(equation) and np.isfinite(value):
            return repr(float(value))
        return self.constant(value)

    def operation(self, equation: Any, inputs: list[str]) -> list[str]:
        """Write an equation that is neither a call nor a loop nor a branch.

        Args:
            equation: The equation.
            inputs: Names of its inputs.

        Returns:
            Names of its results.

        Raises:
            InputError: for an operation that has no text.
        """
        kind, options = equation.primitive.name, equation.params
        if kind == "split":
            ends = np.cumsum([0, *options["sizes"]])
            before = ":, " * options["axis"]
            return [self.value(f"{inputs[0]}[{before}{a}:{b}]") for a, b in itertools.pairwise(ends)]
        text = _expression(kind, options, inputs, [atom.aval for atom in equation.invars], equation.outvars[0].aval)
        if text is None or len(equation.outvars) > 1:
            raise InputError(
                f"the operation '{kind}' cannot be written with NumPy yet: "
                "leave out the effect of the plant, or the part of the controller, that needs it"
            )
        return [text if text in inputs else self.value(text)]

    def carried(self, first: list[str]) -> list[str]:
        """Write the start values of a loop's carry; return the names that the loop updates."""
        names = [self.new_name("c") for _ in first]
        self.assign(names, first)
        return names

    def assign(self, names: list[str], values: list[str]) -> None:
        """Write one assignment of several values."""
        if names:
            self.line(f"{', '.join(names)} = {', '.join(values)}")

    def while_loop(self, options: dict[str, Any], inputs: list[str]) -> list[str]:
        """Write a ``while`` loop with the parameters of its equation; return the names of its last carry."""
        in_condition, in_body = options["cond_nconsts"], options["body_nconsts"]
        condition, body = inputs[:in_condition], inputs[in_condition : in_condition + in_body]
        carry = self.carried(inputs[in_condition + in_body :])
        with self.block("while True:"):
            (is_true,) = self.inline(options["cond_jaxpr"], condition + carry)
            self.line(f"if not {is_true}:")
            self.line("    break")
            self.assign(carry, self.inline(options["body_jaxpr"], body + carry))
        return carry

    def scan_loop(self, options: dict[str, Any], inputs: list[str]) -> list[str]:
        """Write a ``scan`` as a ``for`` loop; return the names of its last carry and of its stacked results."""
        fixed, length = options["num_consts"], options["length"]
        split = fixed + options["num_carry"]
        carry = self.carried(inputs[fixed:split])
        avals = [atom.aval for atom in options["jaxpr"].jaxpr.outvars[options["num_carry"] :]]
        rows, at = [self.new_name("r") for _ in avals], self.new_name("i")
        for row in rows:
            self.line(f"{row} = []")
        with self.block(f"for {at} in range({length}){'[::-1]' if options['reverse'] else ''}:"):
            each = [self.value(f"{x}[{at}]") for x in inputs[split:]]
            results = self.inline(options["jaxpr"], inputs[:fixed] + carry + each)
            for row, result in zip(rows, results[len(carry) :], strict=True):
                self.line(f"{row}.append({result})")
            self.assign(carry, results[: len(carry)])
            self.line("pass") if not results else None
        reversal = "[::-1]" if options["reverse"] else ""
        empty = [f"np.zeros({(0, *a.shape)}, np.{_dtype(a.dtype)})" for a in avals]
        return carry + [
            self.value(f"np.stack({r}{reversal})" if length else e) for r, e in zip(rows, empty, strict=True)
        ]

    def branches(self, options: dict[str, Any], inputs: list[str]) -> list[str]:
        """Write a ``cond`` or ``switch`` as branches; return the names of its results."""
        which, rest = inputs[0], inputs[1:]
        closed = options["branches"]
        results = [self.new_name("b") for _ in closed[0].jaxpr.outvars]
        for i, branch in enumerate(closed):
            head = f"if {which} <= 0:" if i == 0 else "else:" if i == len(closed) - 1 else f"elif {which} == {i}:"
            with self.block(head):
                self.assign(results, self.inline(branch, rest))
        return results


def _takes_numbers(equation: Any) -> bool:
    """Whether an operation takes Python numbers, next to a NumPy value."""
    atoms = equation.invars
    if equation.primitive.name not in _TAKES_NUMBERS or all(isinstance(atom, Literal) for atom in atoms):
        return False
    return all(atom.aval.dtype == np.float64 for atom in atoms)


def _expression(kind: str, options: dict[str, Any], inputs: list[str], avals: list[Any], out: Any) -> str | None:
    """Text of an operation with one result; ``None`` if there is none."""
    if text := _elementwise(kind, options, inputs, avals, out):
        return text
    return _rearranged(kind, options, inputs, avals, out) or _indexed(kind, options, inputs, avals)


def _elementwise(kind: str, options: dict[str, Any], inputs: list[str], avals: list[Any], out: Any) -> str | None:
    """Text of an elementwise operation, a reduction or a product."""
    first = inputs[0] if inputs else ""
    if kind in _INFIX and not (kind in ("div", "pow") and avals[0].dtype.kind != "f"):
        return f"{first} {_INFIX[kind]} {inputs[1]}"
    if kind in _CALL:
        return _CALL[kind].format(*inputs)
    if kind in _REDUCE:
        return f"{_REDUCE[kind]}({first}, axis={tuple(options['axes'])})"
    if kind in ("square", "integer_pow"):
        power = options.get("y", 2)
        return " * ".join([first] * power) if 1 <= power <= MAX_PRODUCT_POWER else f"{first} ** {power}"
    if kind == "select_n":
        if avals[0].dtype != np.bool_:
            return f"np.choose({first}, ({', '.join(inputs[1:])}))"
        scalar = f"{inputs[2]} if {first} else {inputs[1]}"
        return f"np.where({first}, {inputs[2]}, {inputs[1]})" if avals[0].shape else scalar
    if kind == "convert_element_type":
        return first if avals[0].dtype == out.dtype else f"np.{_dtype(out.dtype)}({first})"
    if kind == "cumsum":
        axis = options["axis"]
        if options["reverse"]:
            return f"np.flip(np.cumsum(np.flip({first}, {axis}), {axis}), {axis})"
        return f"np.cumsum({first}, {axis})"
    if kind == "dot_general" and not any(options["dimension_numbers"][1]):
        left, right = map(tuple, options["dimension_numbers"][0])
        return f"np.tensordot({first}, {inputs[1]}, ({left}, {right}))"
    if kind == "round" and int(options["rounding_method"]) == ROUND_TO_EVEN:
        return f"np.round({first})"
    return None


def _rearranged(kind: str, options: dict[str, Any], inputs: list[str], avals: list[Any], out: Any) -> str | None:
    """Text of an operation that rearranges or repeats its input."""
    first = inputs[0] if inputs else ""
    shape = avals[0].shape if avals else ()
    if kind in ("reshape", "squeeze", "expand_dims"):
        return first if shape == out.shape else f"{first}.reshape({out.shape})"
    if kind == "broadcast_in_dim":
        return _broadcast(first, shape, out.shape, options["broadcast_dimensions"])
    if kind == "concatenate":
        return f"np.concatenate([{', '.join(inputs)}], {options['dimension']})"
    if kind == "stack":
        return f"np.stack([{', '.join(inputs)}], {options['axis']})"
    if kind == "transpose":
        return f"np.transpose({first}, {tuple(options['permutation'])})"
    if kind == "tile":
        return f"np.tile({first}, {tuple(map(int, options['reps']))})"
    if kind == "rev":
        return f"np.flip({first}, {tuple(options['dimensions'])})"
    if kind == "iota":
        along = tuple(-1 if d == options["dimension"] else 1 for d in range(len(out.shape)))
        row = f"np.arange({out.shape[options['dimension']]}, dtype=np.{_dtype(out.dtype)})"
        return row if len(out.shape) == 1 else f"np.broadcast_to({row}.reshape({along}), {out.shape})"
    return None


def _indexed(kind: str, options: dict[str, Any], inputs: list[str], avals: list[Any]) -> str | None:
    """Text of a slice."""
    if kind == "slice":
        steps = options["strides"] or (1,) * len(avals[0].shape)
        parts = [
            f"{a}:{b}" + f":{c}" * (c != 1)
            for a, b, c in zip(options["start_indices"], options["limit_indices"], steps, strict=True)
        ]
        return f"{inputs[0]}[{', '.join(parts)}]"
    if kind == "dynamic_slice":
        sizes = options["slice_sizes"]
        ends = [n - size for n, size in zip(avals[0].shape, sizes, strict=True)]
        starts = [f"np.clip({k}, 0, {end})" for k, end in zip(inputs[1:], ends, strict=True)]
        return f"{inputs[0]}[{', '.join(f'{k}:{k} + {n}' for k, n in zip(starts, sizes, strict=True))}]"
    return None


def _broadcast(name: str, shape: tuple[Any, ...], new_shape: tuple[Any, ...], dimensions: tuple[Any, ...]) -> str:
    if shape == new_shape:
        return name
    if not shape:
        return f"np.full({new_shape}, {name})"
    aligned = tuple(shape[dimensions.index(d)] if d in dimensions else 1 for d in range(len(new_shape)))
    reshaped = name if aligned == shape else f"{name}.reshape({aligned})"
    return reshaped if aligned == new_shape else f"np.broadcast_to({reshaped}, {new_shape})"


def _dtype(dtype: Any) -> str:
    return "bool_" if dtype == np.bool_ else np.dtype(dtype).name


def _scalar(value: np.ndarray) -> str:
    return f"np.{_dtype(value.dtype)}({value.item()!r})"
