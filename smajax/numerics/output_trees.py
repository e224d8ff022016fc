"""Structures of pytrees as JSON: tuples, dictionaries, and classes of smajax and of the libraries of its solvers."""

import dataclasses
import sys
from collections.abc import Iterator
from typing import Any

import equinox as eqx

# Packages whose classes a structure may have; their modules are imported already where a structure is read.
_PACKAGES = ("smajax", "optimistix", "equinox", "diffrax", "lineax")


class UnknownStructureError(ValueError):
    """A pytree has something other than arrays in the classes that are known."""


def encode(tree: Any) -> Any:
    """Return the structure of a pytree of arrays as a JSON document.

    Args:
        tree: The pytree.

    Raises:
        UnknownStructureError: If it has leaves that are no arrays, or other classes.
    """
    if tree is None:
        return {"kind": "none"}
    if eqx.is_array(tree):
        return {"kind": "array"}
    # Not of classes derived from these: JAX flattens an OrderedDict in another order.
    if type(tree) is dict:
        # JAX flattens dictionaries in the order of their keys.
        return {"kind": "dict", "items": [[key, encode(tree[key])] for key in sorted(tree)]}
    if type(tree) in (tuple, list):
        return {"kind": type(tree).__name__, "items": [encode(item) for item in tree]}
    if type(tree) in (bool, int, float, str):
        return {"kind": "value", "value": tree}
    if isinstance(tree, eqx.Module) or (isinstance(tree, tuple) and hasattr(tree, "_fields")):
        return {"kind": "class", "class": _class_name(type(tree)), "items": [[n, encode(v)] for n, v in _fields(tree)]}
    raise UnknownStructureError(f"{type(tree).__qualname__} is no part of a structure")


def decode(document: Any, leaves: Iterator[Any]) -> Any:
    """Build a pytree from its structure.

    Args:
        document: The result of ``encode``.
        leaves: The arrays in the order of ``jax.tree.leaves``.

    Raises:
        UnknownStructureError: If a class of the structure is not there.
    """
    kind = document["kind"]
    if kind == "none":
        return None
    if kind == "value":
        return document["value"]
    if kind == "array":
        return next(leaves)
    if kind == "dict":
        return {key: decode(item, leaves) for key, item in document["items"]}
    if kind in ("tuple", "list"):
        items = [decode(item, leaves) for item in document["items"]]
        return tuple(items) if kind == "tuple" else items
    found = _class_of(document["class"])
    values = {name: decode(item, leaves) for name, item in document["items"]}
    if issubclass(found, tuple):
        return found(**values)
    # As equinox does when it unflattens a module: its __init__ may convert or check what arrays have been before.
    module = object.__new__(found)
    for name, value in values.items():
        object.__setattr__(module, name, value)
    return module


def _fields(tree: Any) -> list[tuple[str, Any]]:
    if not isinstance(tree, eqx.Module):
        return list(zip(tree._fields, tree, strict=True))
    names = [field.name for field in dataclasses.fields(tree)]
    return [(name, getattr(tree, name)) for name in names if hasattr(tree, name)]


def _class_name(found: type) -> str:
    if found.__module__.partition(".")[0] not in _PACKAGES:
        raise UnknownStructureError(f"{found.__module__} is no package of smajax's solvers")
    return f"{found.__module__}:{found.__qualname__}"


def _class_of(name: str) -> type:
    module, _, qualified = name.partition(":")
    value: Any = sys.modules.get(module) if module.partition(".")[0] in _PACKAGES else None
    for part in qualified.split("."):
        value = getattr(value, part, None)
    if not isinstance(value, type) or not (issubclass(value, tuple) or issubclass(value, eqx.Module)):
        raise UnknownStructureError(f"there is no class {name}")
    return value
