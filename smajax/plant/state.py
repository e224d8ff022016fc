"""The plant's state at one instant."""

from typing import Any, NamedTuple

import jax.numpy as jnp
from jaxtyping import Array, Float

from smajax.plant.materials.base import Fractions


class State(NamedTuple):
    """State of the plant at one instant.

    Attributes:
        temperature: Temperatures of the wires, shape ``(wires,)``, degC; with cells (``smajax.plant.cells``) those of
            the cells from a clamp to the middle, shape ``(cells, wires)``.
        fractions: Martensite fractions of the wires, shape ``(wires,)`` each; with grains (``smajax.plant.grains``)
            or cells those of each, shape ``(grains, cells, wires)`` without the axes that there are not.
        stress: Stresses of the wires, shape ``(wires,)``, Pa.
        unknown: Unknowns of the mechanism's balance, Pa; if an effect has a drag, followed by that drag, Pa.
        motion: State of the mechanism (``AbstractMechanism.initial_motion``), a pytree.
        memory: Temperature of the clamps, if there are cells, and states of the effects: time, contraction and
            accumulated transformation (see ``WireState``), and an entry of each effect under its key. Empty without
            effects and cells. With cells, the memory of an effect on heat or material has their axis in front.
    """

    temperature: Float[Array, "*cells wires"]
    fractions: Fractions
    stress: Float[Array, " wires"]
    unknown: Float[Array, " unknowns"]
    motion: Any
    memory: dict[str, Any]

    @property
    def step_unknowns(self) -> Float[Array, " unknowns"]:
        """The unknowns of a step that ends in this state: all temperatures, then ``unknown``."""
        return jnp.concatenate([self.temperature.ravel(), self.unknown])
