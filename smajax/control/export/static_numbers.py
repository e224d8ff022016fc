"""Static numbers of a module by name in a trace, such as the period of a controller.

A static number is a literal in a trace, without a name. Before the module is traced, its static numbers are changed by
a few units in the last place, so that each differs from every other number: the literals then have names. What follows
from such a number in Python, before the trace, changes by rounding only.
"""

import dataclasses
from typing import Any

import equinox as eqx
import numpy as np

# Units in the last place by which the first static number is changed; each further one by one more.
_FIRST_STEP = 3


class StaticNumbers:
    """Static numbers of some modules.

    Attributes:
        names: Name of each number by its changed value.
        values: Original value of each number by its name.
    """

    def __init__(self) -> None:
        self.names: dict[float, str] = {}
        self.values: dict[str, float] = {}

    def mark(self, module: Any) -> Any:
        """Return a module whose static numbers, and those of the modules in it, are changed.

        A name that has another value already keeps the first one; the number then stays as it is.

        Args:
            module: The module.
        """
        if not isinstance(module, eqx.Module) or not dataclasses.is_dataclass(module):
            return module
        marked = object.__new__(type(module))
        for field in dataclasses.fields(module):
            value = getattr(module, field.name)
            static = field.metadata.get("static", False)
            new = self._marked_number(field.name, value) if static else self.mark(value)
            object.__setattr__(marked, field.name, new)
        return marked

    def _marked_number(self, name: str, value: Any) -> Any:
        """The changed number; anything else stays as it is."""
        if not isinstance(value, float) or not np.isfinite(value) or value == 0.0:
            return value
        if self.values.setdefault(name, value) != value:
            return value
        place = list(self.values).index(name)
        number = value
        for _ in range(_FIRST_STEP + place):
            number = float(np.nextafter(number, np.inf))
        self.names[number] = name
        return number
