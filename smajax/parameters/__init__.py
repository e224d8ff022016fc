"""Parameters: their declarations, their checks, and the names under which the leaves of a plant are read and set.

A parameter is declared once, as a field of the stage that uses it. Unit, meaning, bounds and default are in the field's
metadata, from which the rig file, the fit, the parameter files and the report read them. Its name is ``section.key``.
The section is a field of the plant (``heat.h0``) or of its mechanism (``pulley.radius``). Some names are *ties*: one
number that sets several leaves, such as ``heat.capacity`` for a capacity that does not depend on the phase.

``definitions`` and ``checks`` need no JAX. ``modules`` has the classes and functions that do; it is imported when one
of them is used, so that a mistake in a file is reported before JAX is loaded.
"""

from typing import TYPE_CHECKING, Any

from smajax.parameters.definitions import TIES, Declaration, by_leaf, declarations, expand

if TYPE_CHECKING:
    from smajax.parameters.modules import (
        CheckedModule,
        all_declarations,
        as_float,
        declaration,
        field_annotation,
        get,
        module_types,
        parameter,
        replace,
        require_x64,
        sections,
    )

__all__ = [
    "TIES",
    "CheckedModule",
    "Declaration",
    "all_declarations",
    "as_float",
    "by_leaf",
    "declaration",
    "declarations",
    "expand",
    "field_annotation",
    "get",
    "module_types",
    "parameter",
    "replace",
    "require_x64",
    "sections",
]


def __getattr__(name: str) -> Any:
    """Return a name of ``modules`` when it is first used."""
    if name not in __all__:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    from smajax.parameters import modules

    value = getattr(modules, name)
    globals()[name] = value
    return value
