"""Checks of the types of arguments, in words: what a function takes, and where to get it."""

from typing import Any

from smajax.errors import InputError
from smajax.plant.plant import Plant
from smajax.plant.state import State
from smajax.recordings.recording import Recording

# What the messages ask for.
A_PLANT = "a Plant, such as rig.plant of a rig from read_rig"
A_RECORDING = "a Recording, such as rig.read(..., observed=False) of a file or of a table in memory"


def type_error(function: str, argument: str, value: Any, takes: str) -> InputError:
    """Return the error for an argument of a wrong type.

    Args:
        function: Name of the function, for the message.
        argument: Name of the argument.
        value: Its value.
        takes: What the function takes, and where to get it.
    """
    return InputError(f"{function}: {argument} is of type {type(value).__name__}: give {takes}")


def check_plant(function: str, plant: Any) -> None:
    """Check that an argument is a plant.

    Args:
        function: Name of the function, for the message.
        plant: The argument.

    Raises:
        InputError: If it is something else, such as a rig.
    """
    if not isinstance(plant, Plant):
        raise type_error(function, "plant", plant, A_PLANT)


def check_recording(function: str, recording: Any) -> None:
    """Check that an argument is a recording.

    Args:
        function: Name of the function, for the message.
        recording: The argument.

    Raises:
        InputError: If it is something else, such as a table in memory or a path.
    """
    if not isinstance(recording, Recording):
        raise type_error(function, "recording", recording, A_RECORDING)


def check_state(function: str, state: Any) -> None:
    """Check that an argument is the state of a plant.

    Args:
        function: Name of the function, for the message.
        state: The argument.

    Raises:
        InputError: If it is something else, such as both results of ``step``.
    """
    if not isinstance(state, State):
        raise type_error(function, "state", state, "the state that init returns, or the first result of step")
