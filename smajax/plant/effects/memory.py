"""Dynamics that several effects share: the presliding state of dry friction, and a first-order lag over one step."""

import jax.numpy as jnp
from jaxtyping import Array, Float

# From this magnitude on, the presliding state counts as fully engaged. At rest with full engagement, rounding would
# otherwise select the branch of ``presliding_state``, possibly another one for the derivative with respect to the start
# of the step than for that with respect to its end; such a tangent grows from step to step. Far above rounding (1e-16)
# and far below any effect on a force; tests/unit/plant/test_effects.py holds it.
_FULL_ENGAGEMENT = 1.0 - 1e-9


def presliding_state(
    z: Float[Array, "..."], contraction_change: Float[Array, "..."], reversal: Float[Array, ""] | float = 5e-5
) -> Float[Array, "..."]:
    """Compute the presliding state of dry friction after a change of the contraction.

    Args:
        z: Presliding state before: -1 (full friction while the wire extends) to 1 (while it contracts).
        contraction_change: Change of the contraction, as a strain.
        reversal: Strain over which z goes from 0 to 1.

    Returns:
        z + contraction_change / reversal, limited to -1..1.
    """
    unlimited = z + contraction_change / reversal
    return jnp.where(jnp.abs(unlimited) < _FULL_ENGAGEMENT, unlimited, jnp.sign(unlimited))


def first_order_lag(
    value: Float[Array, "..."],
    before: Float[Array, "..."],
    after: Float[Array, "..."],
    step: Float[Array, ""],
    time_constant: Float[Array, ""],
) -> Float[Array, "..."]:
    """Compute the output y of a first-order lag, time_constant dy/dt = u - y, after a step with a linear input u.

    The solution is exact. A step of 0 s changes nothing.

    Args:
        value: Output y at the start of the step.
        before: Input u at the start.
        after: Input u at the end.
        step: Duration, s.
        time_constant: Time constant, s.

    Returns:
        Output y at the end.
    """
    ratio = step / time_constant
    decayed = -jnp.expm1(-ratio)
    lag = jnp.where(ratio > 0.0, decayed / jnp.where(ratio > 0.0, ratio, 1.0), 1.0)  # its limit 1 for a step of 0
    return value + decayed * (before - value) + (after - before) * (1.0 - lag)
