"""The catalogue: every module of this package that holds an effect, found by itself. A new effect is a new file here, and nothing else."""

import importlib
import pkgutil
from collections.abc import Mapping
from functools import cache

from smajax.plant.effect import AbstractEffect


@cache
def catalogue() -> Mapping[str, type[AbstractEffect]]:
    """All effects by key, in the order of their keys."""
    found = {}
    for module in pkgutil.iter_modules(__path__):
        for thing in vars(importlib.import_module(f"{__name__}.{module.name}")).values():
            if isinstance(thing, type) and issubclass(thing, AbstractEffect) and thing.__module__.startswith(__name__):
                found[thing.key] = thing
    return dict(sorted(found.items()))
