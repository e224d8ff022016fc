"""Functions of JAX as source text of NumPy.

A function is traced, and its trace (a jaxpr) written out operation by operation, so that what a plant or a controller does stands in
one place and runs where no JAX is. Calls are written in line, ``while``, ``scan`` and ``cond`` as loops and branches; what is not needed
is left out, and what was computed before is not computed again. An operation that is not known here is refused by its name.
"""

import itertools
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from typing import Any

import jax
import numpy as np
from jax.extend.core import ClosedJaxpr, Jaxpr, Literal

from smajax.errors import InputError

HEADER = "import numpy as np\nfrom numpy import inf, nan  # noqa: F401\n"
_INFIX = {
    "add": "+", "add_any": "+", "sub": "-", "mul": "*", "div": "/", "pow": "**",
    "eq": "==", "ne": "!=", "lt": "<", "le": "<=", "gt": ">", "ge": ">=", "and": "&", "or": "|", "xor": "^",
}  # fmt: skip
_CALL = {
    "max": "np.maximum({}, {})", "min": "np.minimum({}, {})", "rem": "np.fmod({}, {})", "atan2": "np.arctan2({}, {})",
    "clamp": "np.minimum(np.maximum({1}, {0}), {2})", "neg": "-{}", "not": "~{}", "rsqrt": "1.0 / np.sqrt({})",
    "logistic": "1.0 / (1.0 + np.exp(-{}))", "is_finite": "np.isfinite({})",
    "asin": "np.arcsin({})", "acos": "np.arccos({})", "atan": "np.arctan({})",
    "asinh": "np.arcsinh({})", "acosh": "np.arccosh({})", "atanh": "np.arctanh({})",
}  # fmt: skip
_ALIKE = (
    "abs",
    "sign",
    "floor",
    "ceil",
    "exp",
    "exp2",
    "expm1",
    "log",
    "log1p",
    "sqrt",
    "cbrt",
    "sin",
    "cos",
    "tan",
    "sinh",
    "cosh",
    "tanh",
)
_CALL |= {name: f"np.{name}({{}})" for name in _ALIKE}
_PLAIN = (*_INFIX, "max", "min", "clamp")
_REDUCE = {
    "reduce_sum": "np.sum", "reduce_prod": "np.prod", "reduce_max": "np.max", "reduce_min": "np.min",
    "reduce_and": "np.all", "reduce_or": "np.any",
}  # fmt: skip
_SAME = ("stop_gradient", "copy", "copy_p", "optimization_barrier")
_INNER = ("jaxpr", "call_jaxpr", "fun_jaxpr")  # where calls keep what they call


def numpy_source(name: str, function: Callable, arguments: Mapping[str, Any]) -> str:
    """Source text of ``def name(...)`` that does with NumPy what ``function(*arguments.values())`` does, after ``HEADER``.

    ``arguments`` give each argument's name and an example of it, a pytree of arrays. The text takes each as the sequence of its leaves (an
    array as itself), which have to be of NumPy's types, and returns the leaves of the result as a tuple. Raises ``InputError`` for an
    operation that has no text here, with its name.
    """
    traced = jax.make_jaxpr(function)(*arguments.values())
    writer, flat = _Writer(name), []
    for argument, example in arguments.items():
        leaves = len(jax.tree.leaves(example))
        alone = jax.tree_util.treedef_is_leaf(jax.tree.structure(example))
        names = [argument] if alone else [f"{argument}_{i}" for i in range(leaves)]
        if not alone and names:
            writer.line(f"{', '.join(names)}{',' * (leaves == 1)} = {argument}")
        flat += names
    results = writer.inline(traced, flat)
    writer.line(f"return ({', '.join(results)}{',' * (len(results) == 1)})")
    return "\n".join([*writer.constants, *[""] * bool(writer.constants), f"def {name}({', '.join(arguments)}):", *writer.lines, ""])


class _Writer:
    """The text so far. Every value has a name of its own; ``known`` says under which name a text was computed before."""

    def __init__(self, prefix: str):
        self.prefix, self.lines, self.constants = prefix.upper(), [], []
        self.known: dict[str, str] = {}
        self.count, self.depth = 0, 1

    def line(self, text: str) -> None:
        self.lines.append("    " * self.depth + text)

    def new(self, letter: str) -> str:
        self.count += 1
        return f"{letter}{self.count}"

    def value(self, text: str) -> str:
        """The name of what ``text`` computes."""
        if text not in self.known:
            self.known[text] = self.new("v")
            self.line(f"{self.known[text]} = {text}")
        return self.known[text]

    @contextmanager
    def block(self, head: str) -> Iterator[None]:
        """An indented block: what is computed within may not have been computed after it."""
        self.line(head)
        before, self.known = self.known, dict(self.known)
        self.depth += 1
        yield
        self.depth, self.known = self.depth - 1, before

    def constant(self, value: Any) -> str:
        array = np.asarray(value)
        text = f"np.array({array.tolist()!r}, np.{_dtype(array.dtype)})" if array.ndim else _scalar(array)
        if text not in self.known:
            self.known[text] = f"{self.prefix}_{len(self.constants)}"
            self.constants.append(f"{self.known[text]} = {text}")
        return self.known[text]

    def inline(self, closed: ClosedJaxpr | Jaxpr, inputs: list[str]) -> list[str]:
        """Writes what a jaxpr does with the named inputs; the names of its results."""
        jaxpr, consts = (closed.jaxpr, closed.consts) if isinstance(closed, ClosedJaxpr) else (closed, [])
        names = dict(zip(jaxpr.invars, inputs, strict=True))
        names |= {var: self.constant(const) for var, const in zip(jaxpr.constvars, consts, strict=True)}

        def read(atom: Any, plain: bool = False) -> str:
            if not isinstance(atom, Literal):
                return names[atom]
            return repr(float(atom.val)) if plain and np.isfinite(atom.val) else self.constant(atom.val)

        for equation in _needed(jaxpr):
            plain = _takes_numbers(equation)
            results = self.equation(equation, [read(atom, plain) for atom in equation.invars])
            names |= dict(zip(equation.outvars, results, strict=True))
        return [read(atom) for atom in jaxpr.outvars]

    def equation(self, equation: Any, inputs: list[str]) -> list[str]:
        """Writes one operation; the names of its results."""
        kind, given = equation.primitive.name, equation.params
        inner = next((given[key] for key in _INNER if isinstance(given.get(key), ClosedJaxpr | Jaxpr)), None)
        if kind in ("while", "scan", "cond"):
            return getattr(self, f"{kind}_loop" if kind != "cond" else "branches")(given, inputs)
        if kind in _SAME:
            return inputs
        if inner is not None:
            return self.inline(inner, inputs)
        if kind == "split":
            ends = np.cumsum([0, *given["sizes"]])
            before = ":, " * given["axis"]
            return [self.value(f"{inputs[0]}[{before}{a}:{b}]") for a, b in itertools.pairwise(ends)]
        text = _expression(kind, given, inputs, [atom.aval for atom in equation.invars], equation.outvars[0].aval)
        if text is None or len(equation.outvars) > 1:
            raise InputError(f"the operation '{kind}' cannot be written with NumPy yet: leave out the effect of the plant that needs it")
        return [text if text in inputs else self.value(text)]

    def carried(self, first: list[str]) -> list[str]:
        """Names that a loop assigns anew, set to their first values."""
        names = [self.new("c") for _ in first]
        self.assign(names, first)
        return names

    def assign(self, names: list[str], values: list[str]) -> None:
        if names:
            self.line(f"{', '.join(names)} = {', '.join(values)}")

    def while_loop(self, given: dict, inputs: list[str]) -> list[str]:
        asked, done = given["cond_nconsts"], given["body_nconsts"]
        around, within = inputs[:asked], inputs[asked : asked + done]
        carry = self.carried(inputs[asked + done :])
        with self.block("while True:"):
            (goes,) = self.inline(given["cond_jaxpr"], around + carry)
            self.line(f"if not {goes}:")
            self.line("    break")
            self.assign(carry, self.inline(given["body_jaxpr"], within + carry))
        return carry

    def scan_loop(self, given: dict, inputs: list[str]) -> list[str]:
        """A scan as a ``for``: the names of its last carry and of the rows that it gathers."""
        fixed, length = given["num_consts"], given["length"]
        split = fixed + given["num_carry"]
        carry = self.carried(inputs[fixed:split])
        avals = [atom.aval for atom in given["jaxpr"].jaxpr.outvars[given["num_carry"] :]]
        rows, at = [self.new("r") for _ in avals], self.new("i")
        for row in rows:
            self.line(f"{row} = []")
        with self.block(f"for {at} in range({length}){'[::-1]' if given['reverse'] else ''}:"):
            each = [self.value(f"{x}[{at}]") for x in inputs[split:]]
            results = self.inline(given["jaxpr"], inputs[:fixed] + carry + each)
            for row, result in zip(rows, results[len(carry) :], strict=True):
                self.line(f"{row}.append({result})")
            self.assign(carry, results[: len(carry)])
            self.line("pass") if not results else None
        turned = "[::-1]" if given["reverse"] else ""
        empty = [f"np.zeros({(0, *a.shape)}, np.{_dtype(a.dtype)})" for a in avals]
        return carry + [self.value(f"np.stack({r}{turned})" if length else e) for r, e in zip(rows, empty, strict=True)]

    def branches(self, given: dict, inputs: list[str]) -> list[str]:
        which, rest = inputs[0], inputs[1:]
        closed = given["branches"]
        results = [self.new("b") for _ in closed[0].jaxpr.outvars]
        for i, branch in enumerate(closed):
            head = f"if {which} <= 0:" if i == 0 else "else:" if i == len(closed) - 1 else f"elif {which} == {i}:"
            with self.block(head):
                self.assign(results, self.inline(branch, rest))
        return results


def _needed(jaxpr: Jaxpr) -> list[Any]:
    """The equations on which a jaxpr's results depend, in their order."""
    wanted = {atom for atom in jaxpr.outvars if not isinstance(atom, Literal)}
    kept = []
    for equation in reversed(jaxpr.eqns):
        if any(var in wanted for var in equation.outvars):
            kept.append(equation)
            wanted |= {atom for atom in equation.invars if not isinstance(atom, Literal)}
    return kept[::-1]


def _takes_numbers(equation: Any) -> bool:
    """Whether numbers can stand as they are in an operation: beside a value of NumPy's."""
    atoms = equation.invars
    if equation.primitive.name not in _PLAIN or all(isinstance(atom, Literal) for atom in atoms):
        return False
    return all(atom.aval.dtype == np.float64 for atom in atoms)


def _expression(kind: str, given: dict, inputs: list[str], avals: list[Any], out: Any) -> str | None:
    """Text of an operation of one result; ``None`` if it is not known."""
    first = inputs[0] if inputs else ""
    shape = avals[0].shape if avals else ()
    if kind in _INFIX and not (kind in ("div", "pow") and avals[0].dtype.kind != "f"):
        return f"{first} {_INFIX[kind]} {inputs[1]}"
    if kind in _CALL:
        return _CALL[kind].format(*inputs)
    if kind in _REDUCE:
        return f"{_REDUCE[kind]}({first}, axis={tuple(given['axes'])})"
    if kind in ("square", "integer_pow"):
        power = given.get("y", 2)
        return " * ".join([first] * power) if 1 <= power <= 4 else f"{first} ** {power}"
    if kind in ("reshape", "squeeze", "expand_dims"):
        return first if shape == out.shape else f"{first}.reshape({out.shape})"
    if kind == "select_n":
        if avals[0].dtype != np.bool_:
            return f"np.choose({first}, ({', '.join(inputs[1:])}))"
        return f"np.where({first}, {inputs[2]}, {inputs[1]})" if shape else f"{inputs[2]} if {first} else {inputs[1]}"
    if kind == "convert_element_type":
        return first if avals[0].dtype == out.dtype else f"np.{_dtype(out.dtype)}({first})"
    if kind == "broadcast_in_dim":
        return _broadcast(first, shape, out.shape, given["broadcast_dimensions"])
    if kind == "slice":
        steps = given["strides"] or (1,) * len(shape)
        parts = [f"{a}:{b}" + f":{c}" * (c != 1) for a, b, c in zip(given["start_indices"], given["limit_indices"], steps, strict=True)]
        return f"{first}[{', '.join(parts)}]"
    if kind == "dynamic_slice":
        ends = [n - size for n, size in zip(shape, given["slice_sizes"], strict=True)]
        starts = [f"np.clip({k}, 0, {end})" for k, end in zip(inputs[1:], ends, strict=True)]
        return f"{first}[{', '.join(f'{k}:{k} + {n}' for k, n in zip(starts, given['slice_sizes'], strict=True))}]"
    if kind == "concatenate":
        return f"np.concatenate([{', '.join(inputs)}], {given['dimension']})"
    if kind == "stack":
        return f"np.stack([{', '.join(inputs)}], {given['axis']})"
    if kind == "transpose":
        return f"np.transpose({first}, {tuple(given['permutation'])})"
    if kind == "tile":
        return f"np.tile({first}, {tuple(map(int, given['reps']))})"
    if kind == "rev":
        return f"np.flip({first}, {tuple(given['dimensions'])})"
    if kind == "iota":
        along = tuple(-1 if d == given["dimension"] else 1 for d in range(len(out.shape)))
        row = f"np.arange({out.shape[given['dimension']]}, dtype=np.{_dtype(out.dtype)})"
        return row if len(out.shape) == 1 else f"np.broadcast_to({row}.reshape({along}), {out.shape})"
    if kind == "cumsum":
        axis = given["axis"]
        return f"np.flip(np.cumsum(np.flip({first}, {axis}), {axis}), {axis})" if given["reverse"] else f"np.cumsum({first}, {axis})"
    if kind == "dot_general" and not any(given["dimension_numbers"][1]):
        left, right = map(tuple, given["dimension_numbers"][0])
        return f"np.tensordot({first}, {inputs[1]}, ({left}, {right}))"
    if kind == "round":
        return f"np.round({first})" if int(given["rounding_method"]) == 1 else None
    return None


def _broadcast(name: str, shape: tuple, wanted: tuple, dimensions: tuple) -> str:
    if shape == wanted:
        return name
    if not shape:
        return f"np.full({wanted}, {name})"
    aligned = tuple(shape[dimensions.index(d)] if d in dimensions else 1 for d in range(len(wanted)))
    turned = name if aligned == shape else f"{name}.reshape({aligned})"
    return turned if aligned == wanted else f"np.broadcast_to({turned}, {wanted})"


def _dtype(dtype: Any) -> str:
    return "bool_" if dtype == np.bool_ else np.dtype(dtype).name


def _scalar(value: np.ndarray) -> str:
    return f"np.{_dtype(value.dtype)}({value.item()!r})"
