"""Hard stop: the motion ends at a stop, which then holds the wire."""

from typing import ClassVar

import jax
from jaxtyping import Array, Float

from smajax.numerics.nonsmooth import maximum
from smajax.parameters import parameter
from smajax.plant.effects.base import MechanismEffect, Shapes, StageContext, WireState

# Stiffness of a wire that transforms, as stress over strain, in Pa, to which the strength refers: a Clausius-Clapeyron
# slope of 7 MPa/K times a transformation of 15 K over a strain of 4 %.
_WIRE_STIFFNESS = 2.6e9


class HardStop(MechanismEffect):
    """Stop at a motion p since the first row, which takes the share s of the motion beyond it.

    A part of it holds the wire, whose stress then rises, and the rest holds only what the sensor sees. With the motion
    x of the wire since the first row, the wire's length L, the stiffness E of a wire that transforms, and q = h s, the
    stress against the contraction and the motion that is seen are

        sigma = E q / (1 - q) e / L        x - (s - q) / (1 - q) e        e = max(x - p, 0)

    A free motion f beyond the stop becomes e = (1 - q) f, as between two springs, and (1 - s) f of it is seen: a
    strength of 1 would be a rigid stop. With h = 1 the wire is held, with h = 0 it goes on behind the stop.
    """

    strength: jax.Array = parameter("1", "share of the motion beyond the stop that the stop takes", 0.0, 0.9999, 0.0)
    place: jax.Array = parameter("m", "motion of the wire since the first row at which the stop is", 1e-5, 1.0, 5e-3)
    held: jax.Array = parameter(
        "1", "share of the stop that holds the wire, not only what the sensor sees", 0.0, 1.0, 1.0
    )
    key = "hard-stop"
    typical: ClassVar[float] = 0.97
    all_or_nothing = True
    source = "estimate: a stop of metal is 30 times as stiff as a wire that transforms, and more"
    remedy = "Look for what the mechanism touches at the end of its way, and move the stop or keep the input below it."
    confused_with: ClassVar[tuple[str, ...]] = ("slack", "backlash")
    needs: ClassVar[tuple[str, ...]] = ("drag",)
    has_drag = True
    obstacle_to_rates = "a stop"
    shapes: ClassVar[Shapes] = (("place", (0.9, 0.99, 0.6)), ("held", (1.0,)))

    def initial_memory(self, state: WireState, context: StageContext) -> Float[Array, ""]:
        """Return the contraction at the first row."""
        return state.contraction

    def drag(
        self,
        before: WireState,
        after: WireState,
        memory: Float[Array, ""],
        step: Float[Array, ""],
        context: StageContext,
    ) -> Float[Array, ""]:
        """Compute the stress with which the stop holds the wire, Pa."""
        taken = self.held * self.strength
        excess = maximum(after.contraction - memory - self.place / context.wire.motion_per_strain, 0.0)
        return _WIRE_STIFFNESS * taken / (1.0 - taken) * excess

    def displacement(
        self, motion: Float[Array, " rows"], channels: dict[str, jax.Array], time: Float[Array, " rows"]
    ) -> Float[Array, " rows"]:
        """Compute the motion that is not seen, in m at the wire."""
        excess = maximum(motion - motion[0] - self.place, 0.0)
        return -(1.0 - self.held) * self.strength / (1.0 - self.held * self.strength) * excess
