"""C expressions of elementwise operations, by the names of JAX's primitives."""

from typing import Any

import numpy as np

from smajax.control.export.c_values import CValue
from smajax.control.export.source_writer import MAX_PRODUCT_POWER, ROUND_TO_EVEN

_INFIX = {"add": "+", "add_any": "+", "sub": "-", "mul": "*", "div": "/"}
_COMPARISONS = {"eq": "==", "ne": "!=", "lt": "<", "le": "<=", "gt": ">", "ge": ">="}
_FLAG_INFIX = {"and": "&&", "or": "||", "xor": "!="}
_BIT_INFIX = {"and": "&", "or": "|", "xor": "^"}
# Functions of math.h by primitive.
_MATH = {name: name for name in ("exp", "exp2", "expm1", "log", "log1p", "sqrt", "cbrt", "floor", "ceil", "pow")}
_MATH |= {
    f"{arc}{name}{h}": f"{arc}{name}{h}" for arc in ("", "a") for name in ("sin", "cos", "tan") for h in ("", "h")
}
_MATH |= {"atan2": "atan2", "rem": "fmod", "round": "rint"}
# Functions of the header by primitive.
_OWN = {"max": "smajax_max", "min": "smajax_min", "sign": "smajax_sign", "abs": "smajax_abs"}
_OWN |= {"is_finite": "smajax_is_number"}
# The same for integers.
_OF_INTEGERS = {
    "rem": "{} % {}",
    "max": "({0} > {1} ? {0} : {1})",
    "min": "({0} < {1} ? {0} : {1})",
    "abs": "({0} < 0 ? -{0} : {0})",
    "sign": "(({0} > 0) - ({0} < 0))",
}
# Nouns for the variables of results by primitive.
NOUNS = {
    **{"add": "sum", "add_any": "sum", "sub": "difference", "mul": "product", "div": "ratio", "neg": "opposite"},
    **{"max": "larger", "min": "smaller", "clamp": "clipped", "select_n": "choice", "abs": "size", "sign": "sign"},
    **{"eq": "is_equal", "ne": "is_other", "lt": "is_below", "le": "is_at_most", "gt": "is_above", "ge": "is_at_least"},
    **{"and": "both", "or": "either", "xor": "differ", "not": "contrary", "is_finite": "is_finite", "pow": "power"},
    **{"square": "square", "integer_pow": "power", "convert_element_type": "number", "dot_general": "product"},
    **{"reduce_sum": "total", "cumsum": "totals", "concatenate": "row", "stack": "row", "rsqrt": "ratio"},
    # A variable with the name of a function would hide it.
    **{name: f"{name}_value" for name in _MATH if name != "pow"},
}


def math_functions(kind: str, options: dict[str, Any]) -> tuple[str, ...]:
    """Return the functions of math.h that an operation needs.

    Args:
        kind: Name of the primitive.
        options: Its parameters.
    """
    if kind == "integer_pow" and not 1 <= options["y"] <= MAX_PRODUCT_POWER:
        return ("pow",)
    return {"rsqrt": ("sqrt",), "logistic": ("exp",)}.get(kind, (_MATH[kind],) if kind in _MATH else ())


def elementwise(kind: str, options: dict[str, Any], operands: list[CValue]) -> str | None:
    """Return the format of an operation's expression, with a field for each operand; ``None`` if it has none.

    Args:
        kind: Name of the primitive.
        options: Its parameters.
        operands: Its operands.
    """
    first = operands[0].kind if operands else "real"
    if kind in ("and", "or", "xor"):
        return f"{{}} {(_FLAG_INFIX if first == 'flag' else _BIT_INFIX)[kind]} {{}}"
    if kind in _INFIX or kind in _COMPARISONS:
        return f"{{}} {(_INFIX | _COMPARISONS)[kind]} {{}}"
    if first == "int" and kind in _OF_INTEGERS:
        return _OF_INTEGERS[kind]
    if kind == "round" and int(options["rounding_method"]) != ROUND_TO_EVEN:
        return None
    if kind in ("square", "integer_pow"):
        power = options.get("y", 2)
        if 1 <= power <= MAX_PRODUCT_POWER:
            return " * ".join(["{0}"] * power)
        return f"(smajax_real)SMAJAX_POW({{0}}, {power})"
    if kind in _MATH:
        fields = "{}, {}" if len(operands) > 1 else "{}"
        return f"(smajax_real)SMAJAX_{_MATH[kind].upper()}({fields})"
    if kind in _OWN:
        return f"{_OWN[kind]}({'{}, {}' if len(operands) > 1 else '{}'})"
    if kind == "select_n":
        return _selection(operands)
    return {
        "neg": "-{}",
        "not": "!{}" if first == "flag" else "~{}",
        "clamp": "smajax_min(smajax_max({1}, {0}), {2})",
        "rsqrt": "1 / (smajax_real)SMAJAX_SQRT({})",
        "logistic": "1 / (1 + (smajax_real)SMAJAX_EXP(-{}))",
    }.get(kind)


def _selection(operands: list[CValue]) -> str:
    """The format of the selection of one of several cases."""
    which, *cases = operands
    if which.kind == "flag":
        return "{0} ? {2} : {1}"
    tests = [f"{{0}} {'<=' if k == 0 else '=='} {k} ? {{{k + 1}}} : " for k in range(len(cases) - 1)]
    return "".join(tests) + f"{{{len(cases)}}}"


def simplified(kind: str, operands: list[CValue]) -> CValue | None:
    """Return the operand to which an operation with a constant reduces exactly for finite numbers; ``None`` if none.

    Args:
        kind: Name of the primitive.
        operands: Its operands.
    """
    if kind == "select_n" and operands[0].number is not None:
        return operands[1 + int(operands[0].number)]
    if kind == "select_n" and all(_is_same(case, operands[1]) for case in operands[2:]):
        return operands[1]
    if len(operands) != 2 or operands[0].kind != "real":
        return None
    first, second = operands
    for constant, other, is_first in ((first, second, True), (second, first, False)):
        if constant.number is None or constant.shape not in ((), other.shape):
            continue
        number = float(constant.number)
        if kind == "mul" and number == 0.0:
            return constant._replace(shape=other.shape)
        neutral = {"add": 0.0, "mul": 1.0, "max": -np.inf, "min": np.inf}
        neutral |= {} if is_first else {"sub": 0.0, "div": 1.0, "pow": 1.0}
        if neutral.get(kind) == number:
            return other
    return None


def _is_same(first: CValue, second: CValue) -> bool:
    """Whether two values are the same elements of the same variable."""
    return (first.text, first.offset) == (second.text, second.offset) and first.has_same_places(second)


def folded(equation: Any, operands: list[CValue]) -> Any:
    """Return the value of an operation on constant scalars; ``None`` if its operands are not constant scalars.

    Args:
        equation: The equation.
        operands: Its operands.
    """
    if len(equation.outvars) != 1 or equation.outvars[0].aval.shape or not operands:
        return None
    if any(operand.number is None or operand.shape for operand in operands):
        return None
    numbers = [np.asarray(o.number, atom.aval.dtype) for o, atom in zip(operands, equation.invars, strict=True)]
    return np.asarray(equation.primitive.bind(*numbers, **equation.params))
