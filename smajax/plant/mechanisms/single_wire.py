"""Base classes of the mechanisms with a single wire: those that move a load, and those that only have a strain."""

from typing import Any

from jaxtyping import Array, Float

from smajax.plant.mechanisms.base import AbstractMechanism, MechanismContext


class AbstractDisplacement(AbstractMechanism):
    """Base class of one wire that moves a load along a line: the displacement is the contraction in m.

    The state of the mechanism is the strain at zero displacement.
    """

    wires, prescribed, coordinate = 1, (), "displacement"

    def initial_motion(self, strain: Float[Array, " wires"]) -> Float[Array, ""]:
        """Return the strain at zero displacement."""
        return strain[0]

    def update_motion(
        self,
        unknown: Float[Array, " unknowns"],
        strain: Float[Array, " wires"],
        motion: Any,
        context: MechanismContext,
        step: Float[Array, ""],
    ) -> Float[Array, ""]:
        """Return the strain at zero displacement unchanged."""
        return motion

    def channels(
        self,
        strain: Float[Array, " wires"],
        stress: Float[Array, " wires"],
        motion: Any,
        context: MechanismContext,
    ) -> dict[str, Float[Array, ""]]:
        """Compute the displacement in m."""
        return {"displacement": context.wire.motion_per_strain * (motion - strain[0])}


class AbstractMaterialPoint(AbstractMechanism):
    """Base class of one wire whose strain is its only motion, counted from ``wire.prestrain``; without a state."""

    wires, coordinate = 1, "strain"

    def initial_motion(self, strain: Float[Array, " wires"]) -> tuple:
        """Return no state."""
        return ()

    def update_motion(
        self,
        unknown: Float[Array, " unknowns"],
        strain: Float[Array, " wires"],
        motion: Any,
        context: MechanismContext,
        step: Float[Array, ""],
    ) -> tuple:
        """Return no state."""
        return ()

    def channels(
        self,
        strain: Float[Array, " wires"],
        stress: Float[Array, " wires"],
        motion: Any,
        context: MechanismContext,
    ) -> dict[str, Float[Array, ""]]:
        """Compute the strain, counted from ``wire.prestrain``; a slack wire may be longer than prescribed."""
        return {"strain": strain[0] - context.wire.prestrain}
