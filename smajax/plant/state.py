"""The plant's state at one instant."""

from typing import Any, NamedTuple

from jaxtyping import Array, Float

from smajax.plant.materials.base import Fractions


class State(NamedTuple):
    """State of the plant at one instant.

    Attributes:
        temperature: Temperatures of the wires, shape ``(wires,)``, degC.
        fractions: Martensite fractions of the wires, shape ``(wires,)`` each.
        stress: Stresses of the wires, shape ``(wires,)``, Pa.
        unknown: Unknowns of the mechanism's balance, Pa; if an effect has a drag, followed by that drag, Pa.
        motion: State of the mechanism (``AbstractMechanism.initial_motion``), a pytree.
        memory: States of the effects: time, contraction and accumulated transformation (see ``WireState``), and an
            entry of each effect under its key. Empty without effects.
    """

    temperature: Float[Array, " wires"]
    fractions: Fractions
    stress: Float[Array, " wires"]
    unknown: Float[Array, " unknowns"]
    motion: Any
    memory: dict[str, Any]
