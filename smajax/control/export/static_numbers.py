"""Static numbers of the parts of a loop by name, such as the period of a controller.

A static number is a literal in a trace, without a name. Here it becomes an argument of the traced function, as the
gains are. That is not possible where Python needs its value, as in ``if self.leak == 1.0``: it then stays a literal.
"""

import dataclasses
from collections.abc import Iterator, Mapping
from typing import Any

import equinox as eqx
import numpy as np


def static_numbers(module: Any) -> dict[str, float]:
    """Return the static numbers of a module, and of the modules in it, by name.

    Of several numbers of one name the first one has it. Numbers that are 0 or not finite have no name.

    Args:
        module: The module.
    """
    numbers: dict[str, float] = {}
    for part in _parts(module):
        for field in dataclasses.fields(part):
            value = getattr(part, field.name)
            if _is_static_number(field, value) and np.isfinite(value) and value != 0.0:
                numbers.setdefault(field.name, value)
    return numbers


def with_static_numbers(module: Any, values: Mapping[str, float], numbers: Mapping[str, Any]) -> Any:
    """Return a module, and the modules in it, with other values of its named static numbers.

    Args:
        module: The module.
        values: Values of the named numbers in the module; a number with another value is not the named one.
        numbers: Other values by name, which may be traced.
    """
    if not _is_module(module):
        return module
    other = object.__new__(type(module))
    for field in dataclasses.fields(module):
        value = getattr(module, field.name)
        if _is_static_number(field, value):
            value = numbers[field.name] if values.get(field.name) == value else value
        elif not field.metadata.get("static", False):
            value = with_static_numbers(value, values, numbers)
        object.__setattr__(other, field.name, value)
    return other


def _parts(module: Any) -> Iterator[Any]:
    """The module and the modules in it."""
    if _is_module(module):
        yield module
        for field in dataclasses.fields(module):
            if not field.metadata.get("static", False):
                yield from _parts(getattr(module, field.name))


def _is_module(value: Any) -> bool:
    return isinstance(value, eqx.Module) and dataclasses.is_dataclass(value)


def _is_static_number(field: dataclasses.Field, value: Any) -> bool:
    return field.metadata.get("static", False) and isinstance(value, float)
