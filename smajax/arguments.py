"""Checks of the arguments of public functions, in words: what a function takes, and where to get it."""

import math
import operator
import os
from collections.abc import Sequence
from pathlib import Path
from types import UnionType
from typing import Any

from smajax.errors import InputError, shortened

# Largest seed of NumPy's and JAX's random generators.
MAX_SEED = 2**32 - 1
# Largest number of starting points. Chosen by trial.
MAX_STARTS = 10_000
# Electrical inputs between the samples of a recording.
INTERPOLATIONS = ("hold", "linear")


def check_type(function: str, argument: str, value: Any, kind: type[Any] | UnionType, takes: str) -> None:
    """Check the type of an argument.

    Args:
        function: Name of the function, for the message.
        argument: Name of the argument.
        value: Its value.
        kind: The class or classes that the function takes.
        takes: The same in words, and where to get it.

    Raises:
        InputError: If the value is of another type.
    """
    if not isinstance(value, kind):
        raise InputError(f"{function}: {argument} is of type {type(value).__name__}: give {takes}")


def as_path(function: str, argument: str, value: Any, takes: str) -> Path:
    """Return a path.

    Args:
        function: Name of the function, for the message.
        argument: Name of the argument.
        value: Its value.
        takes: What the path is of, in words: "the path of a rig file".

    Raises:
        InputError: If the value is neither text nor a path.
    """
    check_type(function, argument, value, str | os.PathLike, takes)
    return Path(value)


def whole_number(function: str, argument: str, value: Any, lower: int, upper: int) -> int:
    """Return a whole number of Python.

    Args:
        function: Name of the function, for the message.
        argument: Name of the argument.
        value: Its value, an integer of Python or NumPy.
        lower: Lower bound.
        upper: Upper bound.

    Raises:
        InputError: If the value is no integer, or outside of the bounds.
    """
    try:
        number = None if isinstance(value, bool) else operator.index(value)
    except TypeError:
        number = None
    if number is None or not lower <= number <= upper:
        raise InputError(
            f"{function}: {argument} = {shortened(repr(value))} is not possible: give a whole number from {lower} to "
            f"{upper}"
        )
    return number


def seed_or_default(function: str, value: Any, default: int) -> int:
    """Return the seed of random numbers.

    Args:
        function: Name of the function, for the message.
        value: The seed that was given; ``None`` for the default.
        default: Seed of the file.

    Raises:
        InputError: If the value cannot be a seed.
    """
    return default if value is None else whole_number(function, "seed", value, 0, MAX_SEED)


def as_names(function: str, argument: str, value: Any) -> Sequence[str]:
    """Return a sequence of names; a single name is a sequence of one.

    Args:
        function: Name of the function, for the message.
        argument: Name of the argument.
        value: A name, or several.

    Raises:
        InputError: If it is anything else.
    """
    names = (value,) if isinstance(value, str) else value
    if not isinstance(names, Sequence) or not all(isinstance(name, str) for name in names):
        raise InputError(f"{function}: {argument} = {shortened(repr(value))} is not possible: give a list of names")
    return names


def check_duration(function: str, argument: str, value: Any) -> None:
    """Check that a duration is a number above 0.

    Args:
        function: Name of the function, for the message.
        argument: Name of the argument.
        value: The duration in s.

    Raises:
        InputError: If it is not.
    """
    try:
        number = None if isinstance(value, str) else float(value)
    except (TypeError, ValueError):
        number = None
    if number is None or not 0.0 < number < math.inf:
        shown = shortened(repr(value)) if number is None else f"{number:g} s"
        raise InputError(f"{function}: {argument} = {shown} is not possible: give a time above 0 s")


def check_interpolation(interpolation: Any) -> None:
    """Check that inputs between samples are held or linear.

    Args:
        interpolation: The name.

    Raises:
        InputError: If it is another one.
    """
    if interpolation not in INTERPOLATIONS:
        raise InputError(f"interpolation = '{interpolation}' is not known: it is 'hold' or 'linear'")
