"""From one command to the wires: one error, one or two wires, and how the drive pulses."""

import equinox as eqx
import jax
import jax.numpy as jnp

from smajax.kinks import larger, smaller, within
from smajax.parameters import parameter


class Allocation(eqx.Module):
    """Gives a command to ``wires`` wires; one wire takes it as it is.

    Of an antagonistic pair the first wire takes what is positive, up to ``upper``, and the second what is negative, up to ``second``
    (``None``: as much); ``co_contraction`` heats both, so that none hangs slack when its turn comes.
    """

    upper: jax.Array
    co_contraction: jax.Array = parameter("u", "command that both wires of a pair get at least", 0.0)
    wires: int = eqx.field(static=True, default=1)
    second: jax.Array | None = None

    @property
    def most(self) -> jax.Array:
        """The largest command of each wire, shape ``(wires,)``."""
        if self.wires == 1:
            return self.upper[None]
        return jnp.stack([self.upper, self.upper if self.second is None else self.second])

    def __call__(self, command: jax.Array) -> jax.Array:
        """Commands of the wires, shape ``(wires,)``."""
        if self.wires == 1:
            return command[None]
        return within(self.co_contraction + larger(jnp.stack([command, -command]), 0.0), 0.0, self.most)

    def ends(self, most: jax.Array) -> tuple[jax.Array, jax.Array]:
        """The least and the largest command that make use of what each wire may get at most, shape ``(wires,)``."""
        if self.wires == 1:
            return jnp.asarray(-jnp.inf), most[0]
        first, second = larger(most - self.co_contraction, 0.0)
        return -second, first


def pulsed(duty: jax.Array, start: jax.Array, step: jax.Array, carrier: float) -> jax.Array:
    """Share of the time from ``start`` to ``start + step`` (s) in which a pulse-width modulator at ``carrier`` Hz is on, for a duty 0..1.

    Each period begins switched on. Within a step the switch is averaged; steps shorter than a period resolve it.
    """

    def on_until(time: jax.Array) -> jax.Array:
        periods = time * carrier
        whole = jnp.floor(periods)
        return (whole * duty + smaller(periods - whole, duty)) / carrier

    return (on_until(start + step) - on_until(start)) / step
