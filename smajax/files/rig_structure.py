"""Structure of the wire in a rig file: ``cells`` in ``[wire]`` and ``grains`` in ``[material]``."""

from collections.abc import Mapping
from typing import Any, NamedTuple

from pydantic import BaseModel, Field

from smajax.files.toml import STRICT, validate

# Largest numbers, far beyond those at which a simulation has converged (experiments/speed/cells_and_grains.py).
_MAX_CELLS = 101
_MAX_GRAINS = 64


# Keys of sections that are not parameters.
STRUCTURE_KEYS = {"wire": ("cells",), "material": ("grains",)}


class WireStructure(BaseModel):
    """The key of ``[wire]`` that is not a parameter."""

    model_config = STRICT
    cells: int = Field(
        1,
        ge=1,
        le=_MAX_CELLS,
        examples=["9"],
        description="number of cells along the wire; 1 is a wire of one temperature",
    )


class MaterialStructure(BaseModel):
    """The key of ``[material]`` that is not a parameter."""

    model_config = STRICT
    grains: int = Field(
        1,
        ge=1,
        le=_MAX_GRAINS,
        examples=["6"],
        description="number of grains in each cell, with transformation temperatures of their own",
    )


class Structure(NamedTuple):
    """Numbers of cells along a wire and of grains in each cell; 1 for a wire of one temperature or one grain."""

    cells: int = 1
    grains: int = 1


# A wire of one temperature and one grain.
UNIFORM = Structure()


def take_structure(data: Mapping[str, Any]) -> tuple[dict[str, Any], Structure]:
    """Take the structure of the wire out of the sections of a rig file.

    Args:
        data: Sections of the file.

    Returns:
        The sections without the keys of the structure, and the structure.

    Raises:
        InputError: If a number is not a whole number from 1 to its largest.
    """
    rest, counts = dict(data), {}
    for section, key, model in (("wire", "cells", WireStructure), ("material", "grains", MaterialStructure)):
        content = rest.get(section)
        if isinstance(content, Mapping) and key in content:
            counts[key] = getattr(validate(model, {key: content[key]}, section), key)
            rest[section] = {name: value for name, value in content.items() if name != key}
    return rest, Structure(**counts)
