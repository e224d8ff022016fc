"""A cantilever as a test bench: an actuator pushes at a distance from the clamp, and the deflection of the tip is read.

Euler-Bernoulli beam of length L and rigidity E I under a force P at the distance a (flexural paper, eqs. 6 and 7):

    tip   delta = P a^2 (3 L - a) / (6 E I)        (eq. 6)        where the force is   delta_a = P a^3 / (3 E I)

The paper's work P delta / 2 (eq. 7) takes the tip's path for the force's own. The force moves by delta_a, so that the work it does is
2 a / (3 L - a) times that. Both are offered.
"""

import equinox as eqx
import jax
import jax.numpy as jnp

from smajax.parameters import parameter


class Cantilever(eqx.Module):
    """A round music wire, clamped at one end."""

    diameter: jax.Array = parameter("m", "diameter of the cantilever", 1e-5, 0.1)
    length: jax.Array = parameter("m", "length of the cantilever from the clamp to the tip", 1e-3, 10.0)
    position: jax.Array = parameter("m", "distance from the clamp at which the actuator pushes", 1e-4, 10.0)
    modulus: jax.Array = parameter("Pa", "Young's modulus of the cantilever", 1e8, 1e12, 210e9)

    @property
    def rigidity(self) -> jax.Array:
        """E I in N m^2."""
        return self.modulus * jnp.pi / 64.0 * self.diameter**4

    @property
    def reaches(self) -> jax.Array:
        """Whether there is a cantilever where the actuator pushes."""
        return self.position <= self.length

    @property
    def stiffness(self) -> jax.Array:
        """Force per deflection where the actuator pushes, N/m; NaN where there is no cantilever."""
        return jnp.where(self.reaches, 3.0 * self.rigidity / self.position**3, jnp.nan)

    def tip_deflection(self, force: jax.Array) -> jax.Array:
        """Deflection of the tip under a force at ``position``, m (eq. 6)."""
        return force * self.position**2 * (3.0 * self.length - self.position) / (6.0 * self.rigidity)

    def force(self, tip_deflection: jax.Array) -> jax.Array:
        """The force at ``position`` that deflects the tip so far, N."""
        return tip_deflection * 6.0 * self.rigidity / (self.position**2 * (3.0 * self.length - self.position))

    def work(self, tip_deflection: jax.Array) -> jax.Array:
        """Work of the force along its own path, J."""
        return 0.5 * self.force(tip_deflection) ** 2 / self.stiffness

    def work_as_printed(self, tip_deflection: jax.Array) -> jax.Array:
        """P delta / 2 with the tip's deflection, J (eq. 7): more than the work done, by (3 L - a) / (2 a)."""
        return 0.5 * self.force(tip_deflection) * tip_deflection
