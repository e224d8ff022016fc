"""Cantilever as a test bench: an actuator pushes it at a distance from the clamp, and its tip deflection is measured.

Euler-Bernoulli beam of length L and bending rigidity E I under a force P at the distance a from the clamp:

    deflection of the tip        delta = P a^2 (3 L - a) / (6 E I)        (equation 6)
    deflection at the force      delta_a = P a^3 / (3 E I)

Source: dauksher2021, equations 6 and 7. The published work, P delta / 2 (equation 7), uses the deflection of the tip.
The force moves by delta_a only, so its work is P delta_a / 2, which is 2 a / (3 L - a) times the published one.
``Cantilever`` computes both.
"""

import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float

from smajax.parameters import CheckedModule, parameter


class Cantilever(CheckedModule):
    """Round music wire, clamped at one end."""

    diameter: jax.Array = parameter("m", "diameter of the cantilever", 1e-5, 0.1)
    length: jax.Array = parameter("m", "length of the cantilever from the clamp to the tip", 1e-3, 10.0)
    position: jax.Array = parameter("m", "distance from the clamp at which the actuator pushes", 1e-4, 10.0)
    modulus: jax.Array = parameter("Pa", "Young's modulus of the cantilever", 1e8, 1e12, 210e9)

    @property
    def rigidity(self) -> Float[Array, "..."]:
        """Bending rigidity E I in N m^2."""
        return self.modulus * jnp.pi / 64.0 * self.diameter**4

    @property
    def contains_position(self) -> Bool[Array, "..."]:
        """Whether the actuator pushes within the length of the cantilever."""
        return self.position <= self.length

    @property
    def stiffness(self) -> Float[Array, "..."]:
        """Force per deflection at ``position``, 3 E I / a^3, in N/m; NaN if ``position`` is beyond the tip."""
        return jnp.where(self.contains_position, 3.0 * self.rigidity / self.position**3, jnp.nan)

    def tip_deflection(self, force: Float[Array, "..."] | float) -> Float[Array, "..."]:
        """Compute the deflection of the tip under a force at ``position``: P a^2 (3 L - a) / (6 E I).

        Args:
            force: Force P, N.

        Returns:
            Deflection in m.

        Source: dauksher2021, equation 6.
        """
        return force * self.position**2 * (3.0 * self.length - self.position) / (6.0 * self.rigidity)

    def force(self, tip_deflection: Float[Array, "..."] | float) -> Float[Array, "..."]:
        """Compute the force at ``position`` that deflects the tip: the inverse of ``tip_deflection``.

        Args:
            tip_deflection: Deflection of the tip, m.

        Returns:
            Force in N.
        """
        return tip_deflection * 6.0 * self.rigidity / (self.position**2 * (3.0 * self.length - self.position))

    def work(self, tip_deflection: Float[Array, "..."] | float) -> Float[Array, "..."]:
        """Compute the work of the force along its own path: P delta_a / 2.

        Args:
            tip_deflection: Deflection of the tip, m.

        Returns:
            Work in J.
        """
        return 0.5 * self.force(tip_deflection) ** 2 / self.stiffness

    def work_as_printed(self, tip_deflection: Float[Array, "..."] | float) -> Float[Array, "..."]:
        """Compute the published work, P delta / 2 with the deflection of the tip: (3 L - a) / (2 a) times ``work``.

        Args:
            tip_deflection: Deflection of the tip, m.

        Returns:
            Work in J.

        Source: dauksher2021, equation 7.
        """
        return 0.5 * self.force(tip_deflection) * tip_deflection
