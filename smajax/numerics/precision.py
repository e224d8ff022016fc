"""Refusal of single precision, in which a step's equations cannot be solved to their tolerances."""

from typing import Any

import equinox as eqx
import jax
import numpy as np

from smajax.errors import InputError
from smajax.parameters import require_x64


def require_double(**arguments: Any) -> None:
    """Check that JAX computes in double precision, and that all floating-point arrays are of float64.

    Args:
        **arguments: Pytrees by the name that the message uses.

    Raises:
        InputError: If JAX computes in single precision, or an array has another type.
    """
    require_x64()
    for name, tree in arguments.items():
        for path, leaf in jax.tree_util.tree_leaves_with_path(tree):
            if eqx.is_inexact_array(leaf) and leaf.dtype != np.float64:
                place = f"{name}{jax.tree_util.keystr(path)}"
                raise InputError(
                    f"{place} is of {leaf.dtype} and smajax needs double precision: make it with dtype=jnp.float64"
                )
