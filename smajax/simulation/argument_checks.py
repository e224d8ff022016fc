"""Checks of the types of arguments, in words: what a function takes, and where to get it."""

from types import UnionType
from typing import Any

from smajax.errors import InputError

# What the messages ask for.
A_PLANT = "a Plant, such as rig.plant of a rig from read_rig"
A_RECORDING = (
    "a Recording, such as read_recording(...) or rig.read(..., observed=False) of a file or of a table in memory"
)
A_STATE = "the state that init returns, or the first result of step"


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
