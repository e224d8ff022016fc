"""The plant's state at one instant."""

from typing import Any, NamedTuple

from jaxtyping import Array, Float

from smajax.plant.materials.base import Fractions


class State(NamedTuple):
    """The plant's state at one instant.

    Attributes:
        temperature: temperature of each wire in degC.
        fractions: martensite fractions of each wire, both of shape ``(wires,)``.
        stress: stress of each wire in Pa.
        unknown: unknowns of the mechanism's balance in Pa and, where an effect has a drag, that drag.
        motion: what the mechanism remembers from step to step (``AbstractMechanism.initial_motion``), a pytree.
        memory: what effects remember: time, contraction and accumulated transformation (see ``WireState``), and an
            entry of each effect under its key. Empty without effects.
    """

    temperature: Float[Array, " wires"]
    fractions: Fractions
    stress: Float[Array, " wires"]
    unknown: Float[Array, " unknowns"]
    motion: Any
    memory: dict[str, Any]
