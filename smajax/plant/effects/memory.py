"""Dynamics that several effects share: the presliding state of dry friction, and a first-order lag over one step."""

import jax
import jax.numpy as jnp

# At least this large, the presliding state counts as fully engaged. At rest with full engagement, rounding would
# otherwise choose the branch of ``presliding_state``, possibly another one for the derivative by the step's start than
# for that by its end; such a tangent grows from step to step. Far above rounding (1e-16) and far below any effect on a
# force; tests/unit/plant/test_effects.py holds it.
_FULL_ENGAGEMENT = 1.0 - 1e-9


def presliding_state(z: jax.Array, contraction_change: jax.Array, reversal: jax.Array | float = 5e-5) -> jax.Array:
    """Return the presliding state of dry friction after a change of the contraction.

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
    value: jax.Array, before: jax.Array, after: jax.Array, step: jax.Array, time_constant: jax.Array
) -> jax.Array:
    """Return the output of a first-order lag after a step in which its input changes linearly in time.

    Solves time_constant dy/dt = u - y exactly, with u linear from ``before`` to ``after`` over ``step`` seconds and y =
    ``value`` at the start. A step of length 0 changes nothing.
    """
    ratio = step / time_constant
    decayed = -jnp.expm1(-ratio)
    lag = jnp.where(ratio > 0.0, decayed / jnp.where(ratio > 0.0, ratio, 1.0), 1.0)  # its limit 1 for a step of 0
    return value + decayed * (before - value) + (after - before) * (1.0 - lag)
