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
    def init(
        cls,
        measured: Float[Array, ""],
        accept: Bool[Array, ""] | bool = True,
        timeout: Float[Array, ""] | float = DROPOUT_TIMEOUT,
    ) -> "DropoutHold":
        """Return the state at the first sample; if that measurement is not finite, the hold has timed out already.

        Args:
            measured: Measurement at that sample.
            accept: Whether the measurement counts at all.
            timeout: Time after which the hold times out, s.
        """
        finite = _counts(measured, accept)
        return cls(jnp.where(finite, measured, 0.0), jnp.where(finite, 0.0, timeout))

    def update(
        self,
        measured: Float[Array, ""],
        period: Float[Array, ""] | float,
        accept: Bool[Array, ""] | bool = True,
    ) -> "DropoutHold":
        """Return the state after the next sample.

        Args:
            measured: Measurement at that sample; NaN: a dropout.
            period: Time since the last sample, s.
            accept: Whether the measurement counts at all.
        """
        finite = _counts(measured, accept)
        return DropoutHold(jnp.where(finite, measured, self.value), jnp.where(finite, 0.0, self.missing + period))

    @property
    def timed_out(self) -> Bool[Array, ""]:
        """Whether the measurement has been missing for ``DROPOUT_TIMEOUT`` or longer."""
        return self.has_timed_out(DROPOUT_TIMEOUT)

    def has_timed_out(self, timeout: Float[Array, ""] | float) -> Bool[Array, ""]:
        """Return whether the measurement has been missing for a time or longer.

        Args:
            timeout: The time, s.
        """
        return self.missing >= timeout


def _counts(measured: Float[Array, ""], accept: Bool[Array, ""] | bool) -> Bool[Array, ""]:
    """Whether a measurement is finite and accepted."""
    finite = jnp.isfinite(measured)
    return finite if accept is True else finite & accept
