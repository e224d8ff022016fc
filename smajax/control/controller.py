"""What every controller of one channel answers.

A controller is sampled: every period it is told the reference and the measured value, both in the channel's internal unit, and gives
a command in the drive's (A, V, W or a duty). ``reset`` and ``step`` are pure functions of its state. Gains are the array leaves that are
declared as parameters; in their units ``u`` stands for the unit of the command and ``y`` for that of the channel.
"""

from typing import TYPE_CHECKING, Any, Self

import equinox as eqx
import jax

if TYPE_CHECKING:
    from smajax.control.pid import PID


class AbstractController(eqx.Module):
    """Base class of the controllers. All are built around a PID, ``inner``, whose period and limits are theirs."""

    @property
    def inner(self) -> "PID":
        """The PID within, or the controller itself if it is one."""
        raise NotImplementedError

    def limited(self, lower: jax.Array, upper: jax.Array) -> Self:
        """The same with its output between other limits, scalars: what else acts on the actuator leaves the controller less."""
        return eqx.tree_at(lambda c: (c.inner.lower, c.inner.upper), self, (lower, upper))

    def reset(self, reference: jax.Array, value: jax.Array) -> Any:
        """The state of a controller that has been at rest with this reference and this value; scalars."""
        raise NotImplementedError

    def step(self, state: Any, reference: jax.Array, value: jax.Array) -> tuple[Any, jax.Array]:
        """The state after a sample, and the command until the next one; scalars."""
        raise NotImplementedError
