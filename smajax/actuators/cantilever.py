"""Cantilever as a test bench: an actuator pushes at a distance from the clamp, and the deflection of the tip is read.

Euler-Bernoulli beam of length L and rigidity E I under a force P at the distance a:

    at the tip     delta = P a^2 (3 L - a) / (6 E I)        (equation 6)
    at the force   delta_a = P a^3 / (3 E I)

Source: dauksher2021, equations 6 and 7. Its work P delta / 2 (equation 7) uses the tip's path instead of the force's
own. The force moves by delta_a, so its work is 2 a / (3 L - a) times that. Both are offered.
"""

import equinox as eqx
import jax
import jax.numpy as jnp

from smajax.parameters import parameter


class Cantilever(eqx.Module):
    """Round music wire, clamped at one end."""

    diameter: jax.Array = parameter("m", "diameter of the cantilever", 1e-5, 0.1)
    length: jax.Array = parameter("m", "length of the cantilever from the clamp to the tip", 1e-3, 10.0)
    position: jax.Array = parameter("m", "distance from the clamp at which the actuator pushes", 1e-4, 10.0)
    modulus: jax.Array = parameter("Pa", "Young's modulus of the cantilever", 1e8, 1e12, 210e9)

    @property
    def rigidity(self) -> jax.Array:
        """Bending rigidity E I in N m^2."""
        return self.modulus * jnp.pi / 64.0 * self.diameter**4

    @property
    def contains_position(self) -> jax.Array:
        """Whether the actuator pushes within the length of the cantilever."""
        return self.position <= self.length

    @property
    def stiffness(self) -> jax.Array:
        """Force per deflection where the actuator pushes, N/m; NaN beyond the tip."""
        return jnp.where(self.contains_position, 3.0 * self.rigidity / self.position**3, jnp.nan)

    def tip_deflection(self, force: jax.Array | float) -> jax.Array:
        """Return the deflection of the tip under a force at ``position``, m.

        Source: dauksher2021, equation 6.
        """
        return force * self.position**2 * (3.0 * self.length - self.position) / (6.0 * self.rigidity)

    def force(self, tip_deflection: jax.Array | float) -> jax.Array:
        """Return the force at ``position`` for a deflection of the tip, N."""
        return tip_deflection * 6.0 * self.rigidity / (self.position**2 * (3.0 * self.length - self.position))

    def work(self, tip_deflection: jax.Array | float) -> jax.Array:
        """Return the work of the force along its own path, J."""
        return 0.5 * self.force(tip_deflection) ** 2 / self.stiffness

    def work_as_printed(self, tip_deflection: jax.Array | float) -> jax.Array:
        """Return P delta / 2 with the tip's deflection, J: (3 L - a) / (2 a) times the work done.

        Source: dauksher2021, equation 7.
        """
        return 0.5 * self.force(tip_deflection) * tip_deflection
