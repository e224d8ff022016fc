"""Switched model: a NARX network while the wire is heated, an exponential recovery while it cools.

While the input is above ``off``, a NARX network gives the output. Otherwise the output y decays from its last value y_0
towards ``rest``, as the sum of two exponentials, independent of the input before:

    y = rest + (y_0 - rest) (share exp(-t / fast) + (1 - share) exp(-t / slow))

The paper fits them to a single recovery. The recovery has no input, so it holds only for the airflow and the load under
which it was recorded.

Source: copaci2020.
"""

from typing import Any, ClassVar

import jax
import jax.numpy as jnp
from jaxtyping import Array, Float

from smajax.laws.base import AbstractInputOutputModel
from smajax.laws.narx import Narx


class Switched(AbstractInputOutputModel):
    """NARX network while the input is on, exponential recovery while it is off.

    The state holds the network's state, the two parts of the recovery, and whether the input is above ``off``.

    Attributes:
        heating: The network.
        share: Share of the recovery that has the time constant ``fast``.
        fast: Shorter time constant of the recovery, s.
        slow: Longer time constant of the recovery, s.
        rest: Output that the recovery approaches.
        off: Input up to which the wire cools.
    """

    needs_even_rows: ClassVar[bool] = True
    heating: Narx
    share: jax.Array
    fast: jax.Array
    slow: jax.Array
    rest: jax.Array
    off: jax.Array

    def init(self, first: Float[Array, ""]) -> tuple[Any, ...]:
        """Return the state at the first row."""
        network = self.heating.init(first)
        excess = self.heating.output(network, first) - self.rest
        return network, self.share * excess, (1.0 - self.share) * excess, first > self.off

    def step(
        self, state: tuple[Any, ...], before: Float[Array, ""], after: Float[Array, ""], duration: Float[Array, ""]
    ) -> tuple[Any, ...]:
        """Return the state at the next row."""
        network, fast, slow, was_heated = state
        is_heated = before > self.off
        outputs, inputs = network
        # When heating begins again, the network continues from the recovery: its past outputs are set to the recovered
        # output.
        recovered = (self.rest + fast + slow - self.heating.scale[2]) / self.heating.scale[3]
        outputs = jnp.where(is_heated & ~was_heated, recovered, outputs)
        network = self.heating.step((outputs, inputs), before, after, duration)
        excess = self.heating.scale[2] + self.heating.scale[3] * outputs[0] - self.rest
        fast, slow = (
            jnp.where(was_heated & ~is_heated, share * excess, part)
            for part, share in ((fast, self.share), (slow, 1.0 - self.share))
        )
        cooled = fast * jnp.exp(-duration / self.fast), slow * jnp.exp(-duration / self.slow)
        fast, slow = (jnp.where(is_heated, part, c) for part, c in zip((fast, slow), cooled, strict=True))
        return network, fast, slow, is_heated

    @property
    def history_length(self) -> int:
        """Number of past outputs that the network's state holds."""
        return self.heating.history_length

    def with_history(self, state: tuple[Any, ...], outputs: Float[Array, " history"]) -> tuple[Any, ...]:
        """Return the state with its past outputs replaced; the recovery continues from the newest, too."""
        network, _, _, is_heated = state
        excess = outputs[0] - self.rest
        return (
            self.heating.with_history(network, outputs),
            self.share * excess,
            (1.0 - self.share) * excess,
            is_heated,
        )

    def output(self, state: tuple[Any, ...], value: Float[Array, ""]) -> Float[Array, ""]:
        """Return the output of the network or of the recovery."""
        network, fast, slow, is_heated = state
        return jnp.where(is_heated, self.heating.output(network, value), self.rest + fast + slow)
