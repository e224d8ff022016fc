"""A heating model and a cooling curve that take turns (flexible-actuator paper): the wire follows one while it is driven, else the other.

While the input is above ``off``, a NARX network gives the output. While it is not, the output recovers towards ``rest`` as the sum of two
exponentials from where it was, whatever the input was before: what the paper fits to one recovery. The curve has no input of its own, so
it holds for the airflow and the load under which it was recorded, and for no other.
"""

import jax
import jax.numpy as jnp

from smajax.blackbox.narx import Narx
from smajax.hysteresis.operator import AbstractOperator


class Switched(AbstractOperator):
    """``heating`` network; ``share`` of the recovery with the time constant ``fast`` s, the rest of it with ``slow`` s."""

    heating: Narx
    share: jax.Array
    fast: jax.Array
    slow: jax.Array
    rest: jax.Array
    off: jax.Array

    def start(self, first: jax.Array) -> tuple:
        """See ``AbstractOperator.start``: the network's state, the two parts of the recovery, and whether the wire was driven."""
        network = self.heating.start(first)
        away = self.heating.output(network, first) - self.rest
        return network, self.share * away, (1.0 - self.share) * away, first > self.off

    def advance(self, state: tuple, before: jax.Array, after: jax.Array, step: jax.Array) -> tuple:
        """See ``AbstractOperator.advance``."""
        network, fast, slow, driven = state
        drives = before > self.off
        outputs, inputs = network
        # Driven again, the network goes on from where the recovery is; its past is taken to have stood there.
        recovered = (self.rest + fast + slow - self.heating.scale[2]) / self.heating.scale[3]
        outputs = jnp.where(drives & ~driven, recovered, outputs)
        network = self.heating.advance((outputs, inputs), before, after, step)
        away = self.heating.scale[2] + self.heating.scale[3] * outputs[0] - self.rest
        fast, slow = (jnp.where(driven & ~drives, share * away, part) for part, share in ((fast, self.share), (slow, 1.0 - self.share)))
        cooled = fast * jnp.exp(-step / self.fast), slow * jnp.exp(-step / self.slow)
        fast, slow = (jnp.where(drives, part, c) for part, c in zip((fast, slow), cooled, strict=True))
        return network, fast, slow, drives

    @property
    def remembered(self) -> int:
        """See ``AbstractOperator.remembered``."""
        return self.heating.remembered

    def told(self, state: tuple, past: jax.Array) -> tuple:
        """See ``AbstractOperator.told``: the recovery, too, goes on from there."""
        network, _, _, driven = state
        away = past[0] - self.rest
        return self.heating.told(network, past), self.share * away, (1.0 - self.share) * away, driven

    def output(self, state: tuple, value: jax.Array) -> jax.Array:
        """See ``AbstractOperator.output``."""
        network, fast, slow, driven = state
        return jnp.where(driven, self.heating.output(network, value), self.rest + fast + slow)
