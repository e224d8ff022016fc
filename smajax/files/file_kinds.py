"""Kinds of TOML files, by their sections; nothing here needs JAX."""

from smajax.files.actuator_file import is_actuator
from smajax.files.toml import parse_toml


def kind_of_file(text: str, name: str) -> str:
    """Return what a TOML file is: ``controller``, ``sweep``, ``actuator``, or ``rig`` for any other.

    Args:
        text: The text of the file.
        name: Name of the file in messages.

    Raises:
        InputError: If it is not valid TOML.
    """
    data = parse_toml(text, name)
    kind = next((kind for kind in ("controller", "sweep") if kind in data), "rig")
    return "actuator" if kind == "rig" and is_actuator(text) else kind
