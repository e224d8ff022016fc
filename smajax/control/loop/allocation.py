"""Allocation of one command to one wire or to an antagonistic pair."""

import equinox as eqx
import jax.numpy as jnp
from jaxtyping import Array, Float

from smajax.numerics.nonsmooth import clip, maximum
from smajax.parameters import CheckedModule, parameter


class Allocation(CheckedModule):
    """Allocation of a command to the wires; a single wire gets it unchanged.

    Of an antagonistic pair, the first wire gets the positive part of the command and the second one the negative part.

    Attributes:
        upper: Largest command of the first wire.
        co_contraction: Command that both wires of a pair get at least, so that neither is slack when it has to pull.
        wires: Number of wires, 1 or 2.
        second_upper: Largest command of the second wire; ``None``: that of the first one.
    """

    upper: Float[Array, ""]
    co_contraction: Float[Array, ""] = parameter("u", "command that both wires of a pair get at least", 0.0)
    wires: int = eqx.field(static=True, default=1)
    second_upper: Float[Array, ""] | None = None

    @property
    def max_commands(self) -> Float[Array, " wires"]:
        """Largest command of each wire."""
        if self.wires == 1:
            return self.upper[None]
        return jnp.stack([self.upper, self.upper if self.second_upper is None else self.second_upper])

    def __call__(self, command: Float[Array, ""]) -> Float[Array, " wires"]:
        """Return the commands of the wires."""
        if self.wires == 1:
            return command[None]
        return clip(self.co_contraction + maximum(jnp.stack([command, -command]), 0.0), 0.0, self.max_commands)

    def command_limits(self, max_commands: Float[Array, " wires"]) -> tuple[Float[Array, ""], Float[Array, ""]]:
        """Return the smallest and the largest command that the wires can follow.

        Args:
            max_commands: Largest command of each wire at this sample.

        Returns:
            The smallest command (minus infinity for a single wire) and the largest one.
        """
        if self.wires == 1:
            return jnp.asarray(-jnp.inf), max_commands[0]
        first, second = maximum(max_commands - self.co_contraction, 0.0)
        return -second, first
