"""Hysteresis that widens with the stress: a reverse transformation that dissipates more under a higher stress."""

from typing import ClassVar

import jax
import jax.numpy as jnp
from jaxtyping import Array, Float

from smajax.parameters import parameter
from smajax.plant.effects.base import MaterialEffect, Shapes, StageContext, WireState

# Stress in Pa to which the strength refers: a usual load of an actuator wire.
_REFERENCE_STRESS = 100e6


class HysteresisWidening(MaterialEffect):
    """Shift of A_s and A_f alone by s (sigma / 100 MPa)^n: the hysteresis widens by it, M_s and M_f stay.

    Laws with a dissipation that depends on the stress have it: the critical work is Y + D sigma H(sigma), with the
    transformation strain H. Where H is constant, n is 1 and the widening is a smaller slope C_A, which a free C_A has
    already; where H grows with the stress, the widening grows faster than the stress.
    """

    strength: jax.Array = parameter("K", "additional width of the hysteresis at 100 MPa", -15.0, 20.0, 0.0)
    power: jax.Array = parameter("1", "power of the stress with which the width grows", 0.5, 4.0, 2.0)
    key = "hysteresis-widening"
    typical: ClassVar[float] = 1.0
    source = "lagoudas2012: critical work Y + D sigma H(sigma) of the transformation"
    remedy = "Record cycles under at least three loads, slowly enough for the wire to have one temperature."
    confused_with: ClassVar[tuple[str, ...]] = ("clausius-curvature", "clausius-asymmetry")
    # On other rigs the stress varies with the transformation only.
    needs: ClassVar[tuple[str, ...]] = ("prescribed strain or stress",)
    shapes: ClassVar[Shapes] = (("power", (1.0, 2.0, 3.0)),)

    def reverse_shift(self, state: WireState, context: StageContext) -> Float[Array, " wires"]:
        """Compute the shift of austenite start and finish, K; a slack or pushed wire has none."""
        stress = state.stress / _REFERENCE_STRESS
        is_pulled = stress > 0.0
        powered = jnp.exp(self.power * jnp.log(jnp.where(is_pulled, stress, 1.0)))
        return self.strength * jnp.where(is_pulled, powered, 0.0)
