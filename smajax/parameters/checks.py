"""Checks of a declaration and of a value: its bounds, and the order of two that belong together."""

import math
import re
import sys
from collections.abc import Callable, Collection
from typing import Any

import numpy as np

from smajax.errors import InputError
from smajax.parameters.definitions import ORDERED_PAIRS, Declaration
from smajax.units import as_text

# Share of a bound by which a value may be beyond it: an estimate at its bound is so up to the rounding of its scale.
_BOUND_ROUNDING = 1e-9


def check_declaration(unit: Any, meaning: Any, lower: Any, upper: Any, default: Any) -> None:
    """Check the arguments of a declaration.

    Args:
        unit: Internal unit.
        meaning: Meaning in a few words.
        lower: Lower bound.
        upper: Upper bound.
        default: Default value; ``None`` or NaN for none.

    Raises:
        InputError: If unit or meaning is not a string, the bounds are not in order, or the default is not between them.
    """
    if not isinstance(unit, str) or not isinstance(meaning, str):
        raise InputError(f"parameter({unit!r}, {meaning!r}): give unit and meaning as strings, such as 'W/m^2/K'")
    numbers = (lower, upper, *(() if default is None else (default,)))
    if not all(isinstance(number, float | int) for number in numbers):
        raise InputError(f"parameter: {meaning}: give bounds and default as numbers, not as {numbers}")
    if not lower < upper:
        raise InputError(f"parameter: {meaning}: the lower bound {lower:g} is not below the upper one {upper:g}")
    if default is not None and not math.isnan(default) and not lower <= default <= upper:
        raise InputError(
            f"parameter: {meaning}: the default {default:g} is not between the bounds: give one from {lower:g} to "
            f"{upper:g}"
        )


def bounds_error(value: str, declaration: Declaration) -> str:
    """Return the sentence about a value outside of the bounds of its parameter.

    Args:
        value: The value as it was given.
        declaration: Declaration of the parameter.
    """
    ends = (declaration.lower, declaration.upper)
    low, high = (_shown(end, declaration.unit) if math.isfinite(end) else "" for end in ends)
    span = f"from {low} to {high}" if low and high else f"at least {low}" if low else f"at most {high}"
    return f"{value} is not possible for the {declaration.meaning}: give a value {span}"


def check_value(name: str, value: Any, declaration: Declaration) -> None:
    """Check that a value is within the bounds of its declaration; traced values and ``None`` pass.

    Args:
        name: Name of the parameter, for the message.
        value: A number or an array in the internal unit.
        declaration: Declaration of the parameter.

    Raises:
        InputError: If a value is outside of the bounds, NaN, or text.
    """
    if isinstance(value, str):
        raise InputError(f"{name} = '{value}' is text: give a number in {declaration.unit}")
    if not is_concrete(value):
        return
    numbers = np.asarray(value, float)
    lower = declaration.lower - _BOUND_ROUNDING * abs(declaration.lower)
    upper = declaration.upper + _BOUND_ROUNDING * abs(declaration.upper)
    outside = ~((lower <= numbers) & (numbers <= upper))
    if np.any(outside):
        worst = float(numbers[outside].flat[0])
        raise InputError(f"{name}: {bounds_error(_shown(worst, declaration.unit), declaration)}")


def _shown(value: float, unit: str) -> str:
    """A number with its unit; alone for a gain, whose unit depends on the drive and the channel, as in ``u/y``."""
    if re.search(r"\b[uy]\b", unit):
        return f"{value:g}"
    return as_text(value, unit) if math.isfinite(value) else f"{value} {unit}"


def is_concrete(value: Any) -> bool:
    """Return whether a value is a number or an array whose elements are known, and not traced by JAX.

    Args:
        value: The value.
    """
    if isinstance(value, np.ndarray | np.number | int | float):
        return True
    jax = sys.modules.get("jax")  # without it there are no arrays of JAX, and files are checked before it is loaded
    return jax is not None and isinstance(value, jax.Array) and not isinstance(value, jax.core.Tracer)


def check_order(
    value_of: Callable[[str], Any], describe: Callable[[str, float], str], names: Collection[str] | None = None
) -> None:
    """Check that the first value of each pair of ``ORDERED_PAIRS`` is below the second; traced values pass.

    Args:
        value_of: Returns the value of a parameter, a number or an array, in its internal unit; ``None`` if it has none.
        describe: Returns the text for the message of a parameter's name and value.
        names: Names of parameters; only pairs with one of them are checked. By default all pairs.

    Raises:
        InputError: If one is not.
    """
    for low, high in ORDERED_PAIRS:
        if names is not None and low not in names and high not in names:
            continue
        below, above = value_of(low), value_of(high)
        if is_concrete(below) and is_concrete(above):
            lower, upper = np.broadcast_arrays(np.asarray(below, float), np.asarray(above, float))
            wrong = ~(lower < upper)
            if np.any(wrong):
                first, second = describe(high, float(upper[wrong].flat[0])), describe(low, float(lower[wrong].flat[0]))
                raise InputError(f"{first} is not above {second}: correct one of the two")
