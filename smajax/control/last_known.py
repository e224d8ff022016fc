"""A measurement that may be no number: it counts as the last one that was, but not for ever."""

from typing import NamedTuple

import jax
import jax.numpy as jnp

BLIND = 1.0  # s without a number after which nothing is heated by what was known before


class LastKnown(NamedTuple):
    """The last ``value`` that was a number, and for how long there has been none since, ``missing`` in s; scalars."""

    value: jax.Array
    missing: jax.Array

    @classmethod
    def begin(cls, measured: jax.Array) -> "LastKnown":
        """At the start, when what is no number is lost already."""
        known = jnp.isfinite(measured)
        return cls(jnp.where(known, measured, 0.0), jnp.where(known, 0.0, BLIND))

    def after(self, measured: jax.Array, period: float) -> "LastKnown":
        """A sample later, ``period`` in s."""
        known = jnp.isfinite(measured)
        return LastKnown(jnp.where(known, measured, self.value), jnp.where(known, 0.0, self.missing + period))

    @property
    def lost(self) -> jax.Array:
        """Whether it has been missing for too long."""
        return self.missing >= BLIND
