"""Check of what an own controller returns, in words, before a compiler meets it."""

from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from smajax.control.controllers.base import AbstractController
from smajax.errors import InputError

_NUMBERS = bool | int | float | np.generic | np.ndarray | jax.Array


def check_step(controller: AbstractController) -> None:
    """Check that ``step`` returns a state like that of ``reset``, and one number; nothing is computed.

    Args:
        controller: The controller.

    Raises:
        InputError: If it returns anything else, or the state has leaves that are not numbers.
    """
    jax.eval_shape(lambda: _first_step(controller))


def _first_step(controller: AbstractController) -> jax.Array:
    """Check the first step; return 0, since a traced function has to return an array."""
    name = type(controller).__name__
    number = jnp.zeros(())
    state = controller.reset(number, number)
    result = controller.step(state, number, number)
    if not isinstance(result, tuple | list) or len(result) != 2:
        raise InputError(f"{name}: step has to return two things: write return state, command")
    following, command = result
    for method, tree in (("reset", state), ("step", following)):
        kinds = [type(leaf).__name__ for leaf in jax.tree.leaves(tree) if not isinstance(leaf, _NUMBERS)]
        if kinds:
            raise InputError(f"{name}: {method} returns a state with a {kinds[0]}: give numbers, flags or arrays")
    if _form(state) != _form(following):
        raise InputError(
            f"{name}: step returns another state than reset, {_described(following)} in place of "
            f"{_described(state)}: make their structure and shapes equal"
        )
    if not isinstance(command, _NUMBERS) or jnp.shape(command):
        shown = f"a command of shape {jnp.shape(command)}" if isinstance(command, _NUMBERS) else repr(command)
        raise InputError(f"{name}: step returns {shown}: return one number as the command")
    return jnp.zeros(())


def _form(state: Any) -> tuple[Any, list[tuple[int, ...]]]:
    """Structure of a state, and the shapes of its leaves."""
    return jax.tree.structure(state), [jnp.shape(leaf) for leaf in jax.tree.leaves(state)]


def _described(state: Any) -> str:
    """A state in words: its structure, with the shape of an array in place of each leaf."""
    return f"one of shapes {jax.tree.map(jnp.shape, state)}"
