"""Hold of a measurement with dropouts: a value that is NaN is replaced by the last finite one, for a limited time."""

from typing import NamedTuple

import jax.numpy as jnp
from jaxtyping import Array, Bool, Float

# Time without a finite measurement, s, after which the wires get no command. Chosen by trial;
# tests/unit/control/test_control.py holds it.
DROPOUT_TIMEOUT = 1.0


class DropoutHold(NamedTuple):
    """State of the hold of one measurement, scalars.

    Attributes:
        value: Last finite measurement; 0 before the first one.
        missing: Time since that measurement, s.
    """

    value: Float[Array, ""]
    missing: Float[Array, ""]

    @classmethod
    def init(cls, measured: Float[Array, ""]) -> "DropoutHold":
        """Return the state at the first sample; if that measurement is not finite, the hold has timed out already."""
        finite = jnp.isfinite(measured)
        return cls(jnp.where(finite, measured, 0.0), jnp.where(finite, 0.0, DROPOUT_TIMEOUT))

    def update(self, measured: Float[Array, ""], period: float) -> "DropoutHold":
        """Return the state after the next sample.

        Args:
            measured: Measurement at that sample; NaN: a dropout.
            period: Time since the last sample, s.
        """
        finite = jnp.isfinite(measured)
        return DropoutHold(jnp.where(finite, measured, self.value), jnp.where(finite, 0.0, self.missing + period))

    @property
    def timed_out(self) -> Bool[Array, ""]:
        """Whether the measurement has been missing for ``DROPOUT_TIMEOUT`` or longer."""
        return self.missing >= DROPOUT_TIMEOUT
