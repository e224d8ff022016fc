"""Pulley with inertia and damping, and the time integration of its rotation."""

from typing import Any

import jax
import jax.numpy as jnp
from jax.core import Tracer
from jaxtyping import Array, Float

from smajax.parameters import CheckedModule, parameter


class Pulley(CheckedModule):
    """Pulley that wires turn."""

    radius: jax.Array = parameter("m", "radius at which the wires act", 1e-5, 1.0)
    inertia: jax.Array = parameter("kg m^2", "moment of inertia of all that turns", 0.0, 100.0, 0.0)
    damping: jax.Array = parameter("N m s/rad", "viscous damping of the rotation", 0.0, 1e4, 0.0)

    def step(self, motion: tuple[Any, ...], angle: Float[Array, ""], step: Float[Array, ""]) -> tuple[Any, ...]:
        """Compute angle, rate and acceleration after a step by the generalised-alpha rule.

        The rule has alpha_m = -1, alpha_f = 0, beta = 1 and gamma = 3/2: second order, with spectral radius 0 at
        infinite frequency.

        Args:
            motion: Angle in rad, rate in rad/s and acceleration of the rule in rad/s^2 at the start.
            angle: Angle at the end, rad.
            step: Duration, s; a step of 0 s leaves rate and acceleration unchanged.

        Returns:
            Angle, rate and acceleration at the end.

        Source: chung1993.
        """
        before, rate, acceleration = motion
        moving = step > 0
        safe = jnp.where(moving, step, 1.0)
        new = (angle - before - safe * rate + 0.5 * safe**2 * acceleration) / safe**2
        new = jnp.where(moving, new, acceleration)
        return angle, rate + step * (1.5 * new - 0.5 * acceleration), new

    def moment(self, before: tuple[Any, ...], after: tuple[Any, ...], inertia: Float[Array, ""]) -> Float[Array, ""]:
        """Compute I theta'' + c theta' at the end of a step, by the same rule.

        Args:
            before: Angle, rate and acceleration at the start.
            after: Angle, rate and acceleration at the end.
            inertia: Moment of inertia I of all rotating parts, kg m^2.

        Returns:
            Moment in N m.
        """
        return inertia * (2.0 * after[2] - before[2]) + self.damping * after[1]

    def acceleration(
        self, rate: Float[Array, ""], moment: Float[Array, ""], inertia: Float[Array, ""]
    ) -> Float[Array, ""]:
        """Compute theta'' = (M - c theta') / I, in rad/s^2.

        Args:
            rate: Rate theta', rad/s.
            moment: Moment M on the pulley, positive in the direction of the angle, N m.
            inertia: Moment of inertia I of all rotating parts, kg m^2.
        """
        return (moment - self.damping * rate) / inertia


def zero_inertia_obstacle(inertia: Float[Array, ""]) -> str:
    """Return what prevents rates of a rotation, in words that follow "has"; empty if the inertia is positive.

    Args:
        inertia: Moment of inertia of all rotating parts, kg m^2; a traced one is taken to be positive.
    """
    if isinstance(inertia, Tracer) or float(inertia) > 0.0:
        return ""
    return "an inertia of 0, so that no acceleration follows from its moments"
