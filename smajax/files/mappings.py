"""Dictionaries from Python in place of TOML files, with values of the types that TOML has."""

import os
from collections.abc import Mapping
from typing import Any

from smajax.errors import InputError
from smajax.files.toml import check_sizes, show


def plain_tables(data: Mapping[str, Any], name: str) -> dict[str, Any]:
    """Return a dictionary as a TOML file would give it: tuples become lists, and numbers of NumPy those of Python.

    Args:
        data: Tables by section, as ``tomllib`` returns them.
        name: Name of the dictionary in messages.

    Raises:
        InputError: If TOML has no such value; the message names its key.
    """
    check_sizes(data, name)
    return {str(key): _plain(value, f"{name}: {key}") for key, value in data.items()}


def _plain(value: Any, place: str) -> Any:
    if isinstance(value, Mapping):
        return {str(key): _plain(item, f"{place}.{key}") for key, item in value.items()}
    if isinstance(value, list | tuple):
        return [_plain(item, place) for item in value]
    if hasattr(value, "tolist") and not getattr(value, "shape", ()):  # a number of NumPy or JAX
        value = value.tolist()
    if isinstance(value, os.PathLike):
        value = os.fspath(value)
    if not isinstance(value, str | bool | int | float):
        problem = f"{place} = {show(value)} is of type {type(value).__name__}"
        raise InputError(f"{problem}: give text, a number, true or false, a list or a dictionary, or leave the key out")
    return value
