"""Pseudo-rigid body: a bent cantilever modelled as a rigid rod on a hinge with a spring.

The hinge is at (1 - lambda) L from the clamp of a cantilever of length L. With a tip force F against a tip moment M and
the bending rigidity E I, the equations at small slopes, corrected, are:

    18   deflection   F L^3 / (3 E I) - M L^2 / (2 E I)
         shortening   (8 F^2 L^5 - 25 F M L^4 + 20 M^2 L^3) / (120 E^2 I^2)
    19   theta      = F L^2 / (2 E I) - M L / (E I)                  the slope at the tip
    20   M          = F L / 3                                        where the deflection is theta L
    24   F          = 6 E I theta / L^2,   F_2 = F - M / L = 4 E I theta / L^2
    21   tan(alpha) = shortening / deflection = 17/30 theta          with equation 20
    23   lambda     = theta / sin(2 alpha) = 15/17 (1 + (17/30 theta)^2)
    25   K          = 4 E I lambda^2 / L

Source: hybrid_knee_ankle_orthosis, equations 18 to 25. Equation 18 is printed without E I in its first term and with
wrong powers in the second line. In equation 18 L_x is the shortening, in equation 22 the coordinate of the tip, L less
the shortening. Equation 23 is printed as 21 F theta^2 / 110, which has the unit of a force. lambda exceeds 1 from 0.64
rad on, where the assumption of small slopes no longer holds. For larger bends use Howell's constants
(``HowellPseudoRigidBody``) or the elastica (``smajax.actuators.elastica``). Howell calls lambda the characteristic
radius factor.
"""

from typing import NamedTuple, TypeVar

import jax
import jax.numpy as jnp
from jaxtyping import Array, Float

Value = TypeVar("Value", float, jax.Array)


def deflection(force: Value, moment: Value, length: Value, rigidity: Value) -> Value:
    """Compute the deflection of the tip across the axis at small slopes: F L^3 / (3 E I) - M L^2 / (2 E I).

    Args:
        force: Force F at the tip, N.
        moment: Moment M at the tip, against the force, N m.
        length: Length L of the cantilever, m.
        rigidity: Bending rigidity E I, N m^2.

    Returns:
        Deflection in m.

    Source: hybrid_knee_ankle_orthosis, equation 18.
    """
    return force * length**3 / (3.0 * rigidity) - moment * length**2 / (2.0 * rigidity)


def shortening(force: Value, moment: Value, length: Value, rigidity: Value) -> Value:
    """Compute the motion of the tip along the axis at small slopes: the integral of half the squared slope.

    Args:
        force: Force F at the tip, N.
        moment: Moment M at the tip, against the force, N m.
        length: Length L of the cantilever, m.
        rigidity: Bending rigidity E I, N m^2.

    Returns:
        Shortening in m.

    Source: hybrid_knee_ankle_orthosis, equation 18.
    """
    square = 8.0 * force**2 * length**5 - 25.0 * force * moment * length**4 + 20.0 * moment**2 * length**3
    return square / (120.0 * rigidity**2)


def slope(force: Value, moment: Value, length: Value, rigidity: Value) -> Value:
    """Compute the slope at the tip at small slopes: F L^2 / (2 E I) - M L / (E I).

    Args:
        force: Force F at the tip, N.
        moment: Moment M at the tip, against the force, N m.
        length: Length L of the cantilever, m.
        rigidity: Bending rigidity E I, N m^2.

    Returns:
        Slope theta in rad.

    Source: hybrid_knee_ankle_orthosis, equation 19.
    """
    return force * length**2 / (2.0 * rigidity) - moment * length / rigidity


def balanced_force(theta: Value, length: Value, rigidity: Value) -> Value:
    """Compute the tip force F that, with the moment M = F L / 3 against it, gives a slope at the tip.

    F = 6 E I theta / L^2.

    Args:
        theta: Slope at the tip, rad.
        length: Length L of the cantilever, m.
        rigidity: Bending rigidity E I, N m^2.

    Returns:
        Force F in N.

    Source: hybrid_knee_ankle_orthosis, equations 20 and 24.
    """
    return 6.0 * rigidity * theta / length**2


def driving_force(theta: Value, length: Value, rigidity: Value) -> Value:
    """Compute F_2 = F - M / L = 4 E I theta / L^2 in the state of ``balanced_force``.

    Args:
        theta: Slope at the tip, rad.
        length: Length L of the cantilever, m.
        rigidity: Bending rigidity E I, N m^2.

    Returns:
        Force F_2 in N.

    Source: hybrid_knee_ankle_orthosis, equation 24.
    """
    return 4.0 * rigidity * theta / length**2


def radius_factor(theta: Value) -> Value:
    """Compute lambda, the share of the length that is the rigid rod, in the state of ``balanced_force``.

    lambda = 15/17 (1 + (17/30 theta)^2).

    Args:
        theta: Slope at the tip, rad.

    Source: hybrid_knee_ankle_orthosis, equation 23.
    """
    return 15.0 / 17.0 * (1.0 + (17.0 / 30.0 * theta) ** 2)


def hinge_stiffness(radius_factor: Value, length: Value, rigidity: Value) -> Value:
    """Compute the stiffness K of the hinge's spring: 4 E I lambda^2 / L.

    Args:
        radius_factor: Share lambda of the length that is the rigid rod.
        length: Length L of the cantilever, m.
        rigidity: Bending rigidity E I, N m^2.

    Returns:
        Stiffness in N m/rad.

    Source: hybrid_knee_ankle_orthosis, equation 25.
    """
    return 4.0 * rigidity * radius_factor**2 / length


def rigid_rod(
    x: Float[Array, "..."], y: Float[Array, "..."], length: Float[Array, "..."] | float
) -> tuple[Float[Array, "..."], Float[Array, "..."]]:
    """Compute the rigid rod whose tip is that of a bent cantilever.

    Args:
        x: Coordinate of the tip along the undeformed axis, m.
        y: Coordinate of the tip across the undeformed axis, m.
        length: Length L of the cantilever, m.

    Returns:
        Angle 2 alpha of the rod in rad, and its share lambda of the length; NaN for an undeformed cantilever, y = 0.

    Source: hybrid_knee_ankle_orthosis, equations 21 and 22.
    """
    return rigid_rod_from_shortening(length - x, y, length)


def rigid_rod_from_shortening(
    shortening: Float[Array, "..."], y: Float[Array, "..."], length: Float[Array, "..."] | float
) -> tuple[Float[Array, "..."], Float[Array, "..."]]:
    """Compute the rod of ``rigid_rod`` from the shortening, which is more precise for small bends.

    Args:
        shortening: L - x, m.
        y: Coordinate of the tip across the undeformed axis, m.
        length: Length L of the cantilever, m.

    Returns:
        Angle 2 alpha of the rod in rad, and its share lambda of the length; NaN for an undeformed cantilever, y = 0.

    Source: hybrid_knee_ankle_orthosis, equations 21 and 22.
    """
    angle = 2.0 * jnp.arctan(shortening / y)
    return angle, y / (length * jnp.sin(angle))


class HowellPseudoRigidBody(NamedTuple):
    """Pseudo-rigid body with Howell's constants.

    Attributes:
        radius_factor: Share lambda of the length that is the rigid rod (Howell's gamma).
        stiffness: Stiffness of the hinge's spring in E I / L.

    Source: howell2001.
    """

    radius_factor: float
    stiffness: float

    def tip(self, angle: Value, length: Value) -> tuple[Float[Array, "..."], Float[Array, "..."]]:
        """Compute the position of the tip.

        Args:
            angle: Angle of the rod, rad.
            length: Length L of the cantilever, m.

        Returns:
            Coordinates of the tip along and across the undeformed axis, in m.
        """
        x = length * (1.0 - self.radius_factor * (1.0 - jnp.cos(angle)))
        return x, length * self.radius_factor * jnp.sin(angle)


# Limit of a small end moment: lambda, and the spring's stiffness in E I / L. Derived from the circular arc of the bend.
SMALL_MOMENT = (0.75, 1.5)
# Moment at the free end. Source: howell2001.
END_MOMENT = HowellPseudoRigidBody(0.7346, 0.7346 * 2.0643)
