"""Bias spring: a wire that pulls on a linear spring."""

import jax
from jaxtyping import Array, Float

from smajax.parameters import CheckedModule, parameter
from smajax.plant.mechanisms.single_wire import AbstractElasticLoad


class Spring(CheckedModule):
    """Linear spring, which the wire stretches as it contracts."""

    stiffness: jax.Array = parameter("N/m", "stiffness of the bias spring", 0.0, 1e7)
    preload: jax.Array = parameter("N", "force of the spring at the start", 0.0, 1e5)


class BiasSpring(AbstractElasticLoad):
    """One wire that pulls on a linear spring: F = preload + stiffness x.

    It starts as detwinned martensite under the preload, where the displacement x is 0. The unknown is the wire's
    stress.

    Attributes:
        spring: The spring.
    """

    spring: Spring

    def force(self, displacement: Float[Array, "..."]) -> Float[Array, "..."]:
        """Compute the force of the spring, preload + stiffness x, in N."""
        return self.spring.preload + self.spring.stiffness * displacement
