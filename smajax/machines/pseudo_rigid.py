"""The pseudo-rigid body: a bending cantilever of length L replaced by a rigid rod on a hinge at (1 - lambda) L with a spring.

The knee-ankle paper's equations for a tip force F against a tip moment M at small slopes (eqs. 18-25), put right:

    eq. 18   deflection   F L^3 / (3 E I) - M L^2 / (2 E I)
             shortening   (8 F^2 L^5 - 25 F M L^4 + 20 M^2 L^3) / (120 E^2 I^2)
    eq. 19   theta      = F L^2 / (2 E I) - M L / (E I)                  the slope at the tip
    eq. 20   M          = F L / 3                                       where the deflection is theta L
    eq. 24   F          = 6 E I theta / L^2,   F_2 = F - M / L = 4 E I theta / L^2
    eq. 21   tan(alpha) = shortening / deflection = 17/30 theta         with eq. 20
    eq. 23   lambda     = theta / sin(2 alpha) = 15/17 (1 + (17/30 theta)^2)
    eq. 25   K          = 4 E I lambda^2 / L

Eq. 18 is printed without E I in its first term and with wrong powers in the second line. There L_x is the shortening, in eq. 22 the tip's
coordinate, L less the shortening. Eq. 23 is printed as 21 F theta^2 / 110, which has the unit of a force. lambda passes 1 at
0.64 rad, where small slopes no longer hold; Howell's constants (Compliant Mechanisms, 2001) and the elastica go on from there.
"""

from typing import NamedTuple, TypeVar

import jax
import jax.numpy as jnp

Value = TypeVar("Value", float, jax.Array)


def deflection(force: Value, moment: Value, length: Value, rigidity: Value) -> Value:
    """How far the tip moves across, m (eq. 18)."""
    return force * length**3 / (3.0 * rigidity) - moment * length**2 / (2.0 * rigidity)


def shortening(force: Value, moment: Value, length: Value, rigidity: Value) -> Value:
    """How far the tip moves back, m (eq. 18): the integral of half the slope's square."""
    square = 8.0 * force**2 * length**5 - 25.0 * force * moment * length**4 + 20.0 * moment**2 * length**3
    return square / (120.0 * rigidity**2)


def slope(force: Value, moment: Value, length: Value, rigidity: Value) -> Value:
    """Slope at the tip, rad (eq. 19)."""
    return force * length**2 / (2.0 * rigidity) - moment * length / rigidity


def balanced_force(theta: Value, length: Value, rigidity: Value) -> Value:
    """The force, N, that with the moment F L / 3 against it gives a slope at the tip (eqs. 20 and 24)."""
    return 6.0 * rigidity * theta / length**2


def driving_force(theta: Value, length: Value, rigidity: Value) -> Value:
    """F_2 = F - M / L, N, in the same state (eq. 24)."""
    return 4.0 * rigidity * theta / length**2


def share(theta: Value) -> Value:
    """lambda, the rigid rod's part of the length, in the same state (eq. 23)."""
    return 15.0 / 17.0 * (1.0 + (17.0 / 30.0 * theta) ** 2)


def stiffness(share: Value, length: Value, rigidity: Value) -> Value:
    """K, the hinge spring's stiffness, N m/rad (eq. 25)."""
    return 4.0 * rigidity * share**2 / length


def rod(x: jax.Array, y: jax.Array, length: Value) -> tuple[jax.Array, jax.Array]:
    """Angle 2 alpha (rad) and lambda of the rod whose tip is at the coordinates ``x`` along and ``y`` across (eqs. 21 and 22).

    Of an undeformed cantilever, at ``y`` = 0, lambda is none (NaN).
    """
    return rod_of_shortening(length - x, y, length)


def rod_of_shortening(shortening: jax.Array, y: jax.Array, length: Value) -> tuple[jax.Array, jax.Array]:
    """As ``rod``, by how far the tip moved back, which of small bends is known more precisely."""
    angle = 2.0 * jnp.arctan(shortening / y)
    return angle, y / (length * jnp.sin(angle))


class Howell(NamedTuple):
    """A pseudo-rigid body by Howell's constants: lambda, the spring's stiffness in E I / L, and the tip's slope over the rod's angle."""

    share: float
    stiffness: float
    slope: float

    def tip(self, angle: Value, length: Value) -> tuple[jax.Array, jax.Array]:
        """Coordinates of the tip along and across, m, at an angle of the rod."""
        return length * (1.0 - self.share * (1.0 - jnp.cos(angle))), length * self.share * jnp.sin(angle)


# Of a moment that is nearly nought: lambda, and the spring's stiffness in E I / L.
SMALL_MOMENT = (0.75, 1.5)
END_FORCE = Howell(0.85, 0.85 * 2.65, 1.24)
END_MOMENT = Howell(0.7346, 0.7346 * 2.0643, 1.5164)
