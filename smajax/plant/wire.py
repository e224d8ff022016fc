"""The wire's geometry, its surroundings, and the state it starts from: what several stages share."""

import equinox as eqx
import jax
import jax.numpy as jnp

from smajax.parameters import parameter


class Wire(eqx.Module):
    """A round wire. Where a rig has several, they are alike."""

    diameter: jax.Array = parameter("m", "wire diameter", 1e-6, 0.02)
    length: jax.Array = parameter("m", "wire length", 1e-4, 100.0)
    prestrain: jax.Array = parameter("1", "strain of the wire as installed, where the mechanism's coordinate is zero", -0.02, 0.12, 0.0)

    @property
    def area(self) -> jax.Array:
        """Cross-section in m^2."""
        return jnp.pi / 4 * self.diameter**2


class Environment(eqx.Module):
    """The air around the wire, and gravity."""

    ambient: jax.Array = parameter("degC", "temperature of the surroundings", -100.0, 300.0, 20.0)
    gravity: jax.Array = parameter("m/s^2", "gravitational acceleration", 0.0, 30.0, 9.81)


class Initial(eqx.Module):
    """The state in which a recording starts. What is ``None`` follows from the rig: at rest, at ambient, as installed."""

    temperature: jax.Array | None = parameter("degC", "temperature of the wires at the first row", -150.0, 800.0, jnp.nan)
    detwinned: jax.Array | None = parameter("1", "detwinned martensite fraction at the first row", 0.0, 1.0, jnp.nan)
    twinned: jax.Array | None = parameter("1", "twinned martensite fraction at the first row", 0.0, 1.0, jnp.nan)
