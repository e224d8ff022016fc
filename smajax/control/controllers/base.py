"""Interface of the controllers of one channel.

A controller is sampled: once a period it takes the reference and the measured value, both in the channel's internal
unit, and returns a command in the unit of the drive (A, V, W or a duty cycle). ``reset`` and ``step`` are pure
functions of the state. Gains are the fields that are declared as parameters; in their units ``u`` stands for the unit
of the command and ``y`` for that of the channel.
"""

from typing import Any, TypeVar

import equinox as eqx
from jaxtyping import Array, Float

_Controller = TypeVar("_Controller", bound="AbstractController")


class AbstractController(eqx.Module):
    """Base class of the controllers; each is built around a PID, ``inner``, with its period and output limits."""

    @property
    def inner(self) -> Any:
        """The PID inside, or the controller itself if it is a PID."""
        raise NotImplementedError

    def with_limits(self: _Controller, lower: Float[Array, ""], upper: Float[Array, ""]) -> _Controller:
        """Return the controller with other limits of its output.

        Args:
            lower: Smallest command, in the unit of the drive.
            upper: Largest command, in the unit of the drive.
        """
        return eqx.tree_at(lambda c: (c.inner.lower, c.inner.upper), self, (lower, upper))

    def reset(self, reference: Float[Array, ""], value: Float[Array, ""]) -> Any:
        """Return the state of a controller whose reference and measured value have been constant.

        Args:
            reference: Reference so far, in the channel's unit.
            value: Measured value so far, in the channel's unit.
        """
        raise NotImplementedError

    def step(self, state: Any, reference: Float[Array, ""], value: Float[Array, ""]) -> tuple[Any, Float[Array, ""]]:
        """Take one sample.

        Args:
            state: State after the previous sample.
            reference: Reference at this sample, in the channel's unit.
            value: Measured value at this sample, in the channel's unit.

        Returns:
            The state after this sample, and the command until the next one, in the unit of the drive.
        """
        raise NotImplementedError
