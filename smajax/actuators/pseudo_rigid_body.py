"""Pseudo-rigid body: a bending cantilever as a rigid rod on a hinge with a spring.

The hinge is at (1 - lambda) L from the clamp of a cantilever of length L.
The equations for a tip force F against a tip moment M at small slopes, corrected:

    18   deflection   F L^3 / (3 E I) - M L^2 / (2 E I)
         shortening   (8 F^2 L^5 - 25 F M L^4 + 20 M^2 L^3) / (120 E^2 I^2)
    19   theta      = F L^2 / (2 E I) - M L / (E I)                  the slope at the tip
    20   M          = F L / 3                                        where the deflection is theta L
    24   F          = 6 E I theta / L^2,   F_2 = F - M / L = 4 E I theta / L^2
    21   tan(alpha) = shortening / deflection = 17/30 theta          with equation 20
    23   lambda     = theta / sin(2 alpha) = 15/17 (1 + (17/30 theta)^2)
    25   K          = 4 E I lambda^2 / L

Source: hybrid_knee_ankle_orthosis, equations 18 to 25. Equation 18 is printed without E I in its first term and with
wrong powers in the second line. L_x is the shortening there, in equation 22 the tip's coordinate, L less the
shortening. Equation 23 is printed as 21 F theta^2 / 110, which has the unit of a force. lambda passes 1 at 0.64 rad,
where small slopes no longer hold; Howell's constants (``HowellPseudoRigidBody``) and the elastica
(``smajax.actuators.elastica``) apply beyond. Howell calls lambda the characteristic radius factor.
"""

from typing import NamedTuple, TypeVar

import jax
import jax.numpy as jnp

Value = TypeVar("Value", float, jax.Array)


def deflection(force: Value, moment: Value, length: Value, rigidity: Value) -> Value:
    """Return the deflection of the tip across the axis, m.

    Source: hybrid_knee_ankle_orthosis, equation 18.
    """
    return force * length**3 / (3.0 * rigidity) - moment * length**2 / (2.0 * rigidity)


def shortening(force: Value, moment: Value, length: Value, rigidity: Value) -> Value:
    """Return how far the tip moves back along the axis, m: the integral of half the squared slope.

    Source: hybrid_knee_ankle_orthosis, equation 18.
    """
    square = 8.0 * force**2 * length**5 - 25.0 * force * moment * length**4 + 20.0 * moment**2 * length**3
    return square / (120.0 * rigidity**2)


def slope(force: Value, moment: Value, length: Value, rigidity: Value) -> Value:
    """Return the slope at the tip, rad.

    Source: hybrid_knee_ankle_orthosis, equation 19.
    """
    return force * length**2 / (2.0 * rigidity) - moment * length / rigidity


def balanced_force(theta: Value, length: Value, rigidity: Value) -> Value:
    """Return the force F, N, that with the moment F L / 3 against it gives the slope ``theta`` at the tip.

    Source: hybrid_knee_ankle_orthosis, equations 20 and 24.
    """
    return 6.0 * rigidity * theta / length**2


def driving_force(theta: Value, length: Value, rigidity: Value) -> Value:
    """Return F_2 = F - M / L, N, in the same state.

    Source: hybrid_knee_ankle_orthosis, equation 24.
    """
    return 4.0 * rigidity * theta / length**2


def radius_factor(theta: Value) -> Value:
    """Return lambda, the rigid rod's share of the length, in the same state.

    Source: hybrid_knee_ankle_orthosis, equation 23.
    """
    return 15.0 / 17.0 * (1.0 + (17.0 / 30.0 * theta) ** 2)


def hinge_stiffness(radius_factor: Value, length: Value, rigidity: Value) -> Value:
    """Return K, the stiffness of the hinge's spring, N m/rad.

    Source: hybrid_knee_ankle_orthosis, equation 25.
    """
    return 4.0 * rigidity * radius_factor**2 / length


def rigid_rod(x: jax.Array, y: jax.Array, length: Value) -> tuple[jax.Array, jax.Array]:
    """Return angle 2 alpha (rad) and lambda of the rod whose tip is at ``x`` along and ``y`` across the axis.

    For an undeformed cantilever, y = 0, both are NaN. Source: hybrid_knee_ankle_orthosis, equations 21 and 22.
    """
    return rigid_rod_from_shortening(length - x, y, length)


def rigid_rod_from_shortening(shortening: jax.Array, y: jax.Array, length: Value) -> tuple[jax.Array, jax.Array]:
    """Return what ``rigid_rod`` does, from the shortening, which is known more precisely for small bends."""
    angle = 2.0 * jnp.arctan(shortening / y)
    return angle, y / (length * jnp.sin(angle))


class HowellPseudoRigidBody(NamedTuple):
    """Pseudo-rigid body with Howell's constants.

    ``radius_factor`` is lambda (Howell's gamma), ``stiffness`` the spring's in E I / L, ``tip_slope_ratio`` the tip's
    slope over the rod's angle. Source: howell2001.
    """

    radius_factor: float
    stiffness: float
    tip_slope_ratio: float

    def tip(self, angle: Value, length: Value) -> tuple[jax.Array, jax.Array]:
        """Return the coordinates of the tip along and across the axis, m, at an angle of the rod."""
        return length * (1.0 - self.radius_factor * (1.0 - jnp.cos(angle))), length * self.radius_factor * jnp.sin(
            angle
        )


# Limit of a small end moment: lambda, and the spring's stiffness in E I / L. Derived from the circular arc of the bend.
SMALL_MOMENT = (0.75, 1.5)
# Force at the free end, across the undeformed axis. Source: howell2001.
END_FORCE = HowellPseudoRigidBody(0.85, 0.85 * 2.65, 1.24)
# Moment at the free end. Source: howell2001.
END_MOMENT = HowellPseudoRigidBody(0.7346, 0.7346 * 2.0643, 1.5164)
