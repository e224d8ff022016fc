"""Interfaces of the estimators of states that a rig does not measure."""

import abc
from typing import TYPE_CHECKING, Any, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Float

from smajax.channels import numbered
from smajax.errors import InputError
from smajax.parameters import CheckedModule


class AbstractTemperatureEstimator(CheckedModule):
    """Base class of the estimators of the wires' temperatures, which a temperature limiter uses.

    At each sample ``update`` takes the measured channels, then ``apply_command`` the commands until the next sample.

    Attributes:
        period: Period of the samples, s.
    """

    if TYPE_CHECKING:  # type checkers take abstract variables for constructor arguments

        @property
        def period(self) -> float: ...
    else:
        period: eqx.AbstractVar[float]

    @abc.abstractmethod
    def init(self, measured: dict[str, Float[Array, ""]]) -> Any:
        """Return the state at rest, from the measured channels at the first sample by name."""

    @abc.abstractmethod
    def update(self, state: Any, measured: dict[str, Float[Array, ""]]) -> tuple[Any, Float[Array, " wires"]]:
        """Take the measurements of one sample.

        Args:
            state: State after the previous sample and its commands.
            measured: Measured channels at this sample by name; NaN: not measured.

        Returns:
            The state at this sample, and the estimated temperatures of the wires, degC.
        """

    @abc.abstractmethod
    def apply_command(self, state: Any, command: Float[Array, " wires"]) -> Any:
        """Return the state with the commands until the next sample.

        Args:
            state: State at this sample.
            command: Commands of the wires, in the unit of the drive.
        """


class AbstractFilter(AbstractTemperatureEstimator):
    """Base class of the filters of the whole plant, whose estimate of a channel a controller may use."""

    @abc.abstractmethod
    def estimated_channel(self, state: Any, channel: str) -> Float[Array, ""]:
        """Return the estimate of a channel at this sample.

        Args:
            state: State of the filter at this sample.
            channel: Name of the channel.
        """


class Estimate(NamedTuple):
    """Estimate of the whole plant at a sample.

    Attributes:
        mean: Means of the channels by name, scalars in internal units.
        standard_deviation: Standard deviations of the channels by name, scalars in internal units.
        martensite: Mean martensite fraction of each wire, shape ``(wires,)``.
        martensite_standard_deviation: Standard deviation of these fractions, shape ``(wires,)``.
    """

    mean: dict[str, jax.Array]
    standard_deviation: dict[str, jax.Array]
    martensite: jax.Array
    martensite_standard_deviation: jax.Array


def per_wire(channels: dict[str, Float[Array, ""]], name: str) -> Float[Array, " wires"]:
    """Return a channel of all wires as one array.

    Args:
        channels: Channels by name.
        name: Name of the channel without the number of a wire, such as ``temperature``.
    """
    return jnp.stack([channels[n] for n in numbered(name, 1 if name in channels else 2)])


def check_uniform_wire(system: Any) -> None:
    """Check that a filter's plant has one temperature and one grain a wire.

    Args:
        system: The sampled plant or actuator of the filter.

    Raises:
        InputError: If the plant has cells or grains.
    """
    plant = getattr(system, "plant", None)
    if getattr(plant, "cells", None) is not None or getattr(plant, "grains", None) is not None:
        cure = "leave out cells under [wire] and grains under [material] in the rig of the filter"
        raise InputError(f"a Kalman filter takes a wire of one cell and one grain: {cure}")
