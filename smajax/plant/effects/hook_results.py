"""What the hooks of an effect return: a wrong shape is an error that names the effect and the hook.

The checks compare shapes while JAX traces the equations, so a compiled program has none of them.
"""

from typing import TYPE_CHECKING, Any

import jax
import jax.numpy as jnp
import numpy as np

from smajax.errors import InputError

if TYPE_CHECKING:
    from smajax.plant.effects.base import AbstractEffect

_ARRAYS = (jax.Array, np.ndarray, np.generic, int, float)  # what an equation can add


def checked_result(effect: "AbstractEffect", hook: str, result: Any, shape: tuple[int, ...], axis: str = "") -> Any:
    """Return what a hook returned, after a check of its shape.

    Args:
        effect: The effect.
        hook: Name of the hook.
        result: What it returned.
        shape: Shape of what the result is added to.
        axis: Name of its axis, for the message: ``wires``.

    Raises:
        InputError: If the result is no array, or cannot be added without another shape.
    """
    if not isinstance(result, _ARRAYS):
        raise InputError(
            f"effect '{effect.key}': {hook} returned {_described(result)}, expected {_wanted(shape, axis)}"
        )
    own = jnp.shape(result)
    if own in ((), shape) or (len(own) == len(shape) and all(n in (1, m) for n, m in zip(own, shape, strict=True))):
        return result
    raise InputError(f"effect '{effect.key}': {hook} returned shape {own}, expected {_wanted(shape, axis)}")


def checked_type(effect: "AbstractEffect", hook: str, result: Any, kind: type[Any]) -> Any:
    """Return what a hook returned, after a check of its type.

    Args:
        effect: The effect.
        hook: Name of the hook.
        result: What it returned.
        kind: The expected class.

    Raises:
        InputError: If the result is of another class.
    """
    if isinstance(result, kind):
        return result
    raise InputError(f"effect '{effect.key}': {hook} returned {_described(result)}, expected {kind.__name__}")


def checked_memory(effect: "AbstractEffect", hook: str, memory: Any, before: Any) -> Any:
    """Return the memory that a hook returned, after a check of its structure and shapes.

    Args:
        effect: The effect.
        hook: Name of the hook.
        memory: What it returned.
        before: The memory at the start of the step.

    Raises:
        InputError: If the structure or a shape differs.
    """
    if jax.tree.structure(memory) == jax.tree.structure(before):
        shapes = [[jnp.shape(leaf) for leaf in jax.tree.leaves(tree)] for tree in (memory, before)]
        if shapes[0] == shapes[1]:
            return memory
    cure = "initial_memory and this hook have to return arrays of the same shapes"
    old, new = _described(before), _described(memory)
    raise InputError(f"effect '{effect.key}': {hook} returned {new} and the memory before is {old}: {cure}")


def _wanted(shape: tuple[int, ...], axis: str) -> str:
    return f"() or {shape}" + (f" = ({axis},)" if axis else "") if shape else "()"


def _described(result: Any) -> str:
    """A result in words: the shape of an array, and else the structure with the shapes of its arrays."""
    if isinstance(result, _ARRAYS):
        return f"shape {jnp.shape(result)}"
    name, leaves = type(result).__name__, jax.tree.leaves(result)
    if not isinstance(result, tuple | list | dict):
        return f"a {name}"
    return f"a {name} of {', '.join(map(_described, leaves))}" if leaves else f"an empty {name}"
