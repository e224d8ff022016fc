"""Dropouts of reference and measurement: the step of a controller whose inputs may be missing for a while.

A measurement is held by a ``DropoutHold``, a reference by a ``ReferenceHold``. Rollout, C header and FMU share these
functions.
"""

from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float

from smajax.control.controllers.base import AbstractController
from smajax.numerics.nonsmooth import clip


class ReferenceHold(NamedTuple):
    """Hold of a reference, scalars.

    Attributes:
        reference: Last finite reference; 0 before the first one.
        begun: Whether there has been a finite reference.
    """

    reference: Float[Array, ""]
    begun: Bool[Array, ""]

    @classmethod
    def init(cls, reference: Float[Array, ""]) -> "ReferenceHold":
        """Return the state at the first sample.

        Args:
            reference: Reference at that sample, which may be NaN.
        """
        begun = jnp.isfinite(reference)
        return cls(jnp.where(begun, reference, 0.0), begun)

    def update(self, reference: Float[Array, ""]) -> "ReferenceHold":
        """Return the state after the next sample.

        Args:
            reference: Reference at that sample, which may be NaN.
        """
        finite = jnp.isfinite(reference)
        return ReferenceHold(jnp.where(finite, reference, self.reference), self.begun | finite)

    def measurement(self, value: Float[Array, ""]) -> Float[Array, ""]:
        """Return the measured value; NaN until there has been a reference, so that nothing starts before it.

        Args:
            value: Measured value, which may be NaN.
        """
        return jnp.where(self.begun, value, jnp.nan)


def step_with_dropouts(
    controller: AbstractController,
    state: Any,
    timed_out: tuple[Bool[Array, ""], Bool[Array, ""]],
    reference: Float[Array, ""],
    value: Float[Array, ""],
) -> tuple[Any, Float[Array, ""]]:
    """Take one sample of a controller whose measurement may have dropped out.

    Args:
        controller: The controller.
        state: State after the previous sample.
        timed_out: Whether the hold of the measurement had timed out after the previous sample, and has after this one.
        reference: Reference at this sample.
        value: Held measurement at this sample.

    Returns:
        The state after this sample, and the command: that of the controller, which is reset at the first measurement
        after a timeout; during a timeout 0, or the limit nearest to it.
    """
    before, now = timed_out
    state = jax.tree.map(
        lambda fresh, present: jnp.where(before, fresh, present),
        controller.reset(reference, value),
        state,
    )
    state, command = controller.step(state, reference, value)
    return state, jnp.where(now, clip(jnp.zeros(()), controller.lower, controller.upper), command)
