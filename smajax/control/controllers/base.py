"""Interface of the controllers of one channel.

A controller is sampled: once a period it takes the reference and the measured value, both in the channel's internal
unit, and returns a command in the unit of the drive (A, V, W or a duty cycle). ``reset`` and ``step`` are pure
functions of the state. Gains are the array leaves that are declared as parameters; in their units ``u`` stands for the
unit of the command and ``y`` for that of the channel.
"""

from typing import Any, Self

import equinox as eqx
import jax


class AbstractController(eqx.Module):
    """Base class of the controllers; each is built around a PID, ``inner``, with its period and output limits."""

    @property
    def inner(self) -> Any:
        """The PID inside, or the controller itself if it is a PID."""
        raise NotImplementedError

    def with_limits(self, lower: jax.Array, upper: jax.Array) -> Self:
        """Return the controller with other limits of its output.

        Args:
            lower: Smallest command, a scalar.
            upper: Largest command, a scalar.
        """
        return eqx.tree_at(lambda c: (c.inner.lower, c.inner.upper), self, (lower, upper))

    def reset(self, reference: jax.Array, value: jax.Array) -> Any:
        """Return the state of a controller that has been at rest.

        Args:
            reference: Constant reference so far, a scalar.
            value: Constant measured value so far, a scalar.
        """
        raise NotImplementedError

    def step(self, state: Any, reference: jax.Array, value: jax.Array) -> tuple[Any, jax.Array]:
        """Take one sample.

        Args:
            state: State after the previous sample.
            reference: Reference at this sample, a scalar.
            value: Measured value at this sample, a scalar.

        Returns:
            The state after this sample, and the command until the next one, a scalar.
        """
        raise NotImplementedError
