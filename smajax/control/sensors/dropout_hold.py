"""Hold of a measurement that drops out: a value that is NaN is replaced by the last finite one, for a limited time."""

from typing import NamedTuple

import jax.numpy as jnp
from jaxtyping import Array, Bool, Float

# s without a finite measurement after which nothing is heated any more. Chosen by trial;
# tests/unit/control/test_control.py holds it.
DROPOUT_TIMEOUT = 1.0


class DropoutHold(NamedTuple):
    """Last finite ``value`` of a measurement, and the time since then, ``missing`` in s; scalars."""

    value: Float[Array, ""]
    missing: Float[Array, ""]

    @classmethod
    def init(cls, measured: Float[Array, ""]) -> "DropoutHold":
        """Return the state at the first sample; a first value that is not finite has timed out already."""
        finite = jnp.isfinite(measured)
        return cls(jnp.where(finite, measured, 0.0), jnp.where(finite, 0.0, DROPOUT_TIMEOUT))

    def update(self, measured: Float[Array, ""], period: float) -> "DropoutHold":
        """Return the state after the next sample, ``period`` s later."""
        finite = jnp.isfinite(measured)
        return DropoutHold(jnp.where(finite, measured, self.value), jnp.where(finite, 0.0, self.missing + period))

    @property
    def timed_out(self) -> Bool[Array, ""]:
        """Whether the measurement has been missing for ``DROPOUT_TIMEOUT``."""
        return self.missing >= DROPOUT_TIMEOUT
