"""Interfaces of the estimators of what a rig does not measure."""

from typing import Any, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp

from smajax.channels import numbered


class AbstractTemperatureEstimator(eqx.Module):
    """Base class of the estimators of the wires' temperatures, by which a temperature limiter goes.

    At each sample ``update`` takes the measured channels, then ``apply_command`` the commands until the next sample.
    """

    def init(self, measured: dict[str, jax.Array]) -> Any:
        """Return the state at rest.

        Args:
            measured: Channels at the first sample by name, scalars.
        """
        raise NotImplementedError

    def update(self, state: Any, measured: dict[str, jax.Array]) -> tuple[Any, jax.Array]:
        """Take the measurements of one sample.

        Args:
            state: State after the previous sample and its commands.
            measured: Channels at this sample by name, scalars.

        Returns:
            The state at this sample, and the estimated temperatures in degC, shape ``(wires,)``.
        """
        raise NotImplementedError

    def apply_command(self, state: Any, command: jax.Array) -> Any:
        """Return the state with the commands until the next sample.

        Args:
            state: State at this sample.
            command: Commands of the wires, shape ``(wires,)``.
        """
        raise NotImplementedError


class AbstractFilter(AbstractTemperatureEstimator):
    """Base class of the filters of the whole plant, whose estimate of a channel a controller may use."""

    def estimated_channel(self, state: Any, channel: str) -> jax.Array:
        """Return the estimate of a channel at this sample, a scalar."""
        raise NotImplementedError


class Estimate(NamedTuple):
    """Estimate of the whole plant at a sample.

    ``mean`` and ``standard_deviation`` are of the channels by name, scalars; ``martensite`` is the fraction of each
    wire, shape ``(wires,)``, with its standard deviation.
    """

    mean: dict[str, jax.Array]
    standard_deviation: dict[str, jax.Array]
    martensite: jax.Array
    martensite_standard_deviation: jax.Array


def per_wire(channels: dict[str, jax.Array], name: str) -> jax.Array:
    """Return a channel of all wires, shape ``(wires,)``."""
    return jnp.stack([channels[n] for n in numbered(name, 1 if name in channels else 2)])
