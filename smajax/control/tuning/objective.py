"""The objective of a tuning: terms that are minimised, and limits that are kept.

Terms are sums of squares over the n samples of a rollout with error e, time t and period T:

    tracking  e^2 / n                          energy  T sum of the wires' power
    itae      T t |e|                          effort  squared moves of the commands from sample to sample
    overshoot max(0, e / jump - SOFT_OVERSHOOT)^2 / band^2 / n

Each term is divided by its value at the start gains; effort, if the command is bounded, by that of changes of a
hundredth of its range at every sample; overshoot by 1, its value if the error is always a settling band larger than
allowed. A small weight of effort is needed if the simulated sensor is better than the real one: otherwise the best
gains make the command oscillate with the noise.

A limit is kept where its violation c is at most 0 at every sample.
"""

from collections.abc import Mapping
from typing import Any, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Float

from smajax.channels import numbered
from smajax.control.analysis.closed_loop_checks import RELATIVE_SCALE, TEMPERATURE_SCALE
from smajax.control.analysis.step_response import SETTLING_BAND
from smajax.control.loop.rollout import Rollout
from smajax.numerics.nonsmooth import largest, maximum

TERMS = ("tracking", "itae", "energy", "effort", "overshoot")
LIMITS = ("overshoot", "settling", "temperature", "stress", "current")
# Overshoot as a share of a jump up to which the overshoot term is 0: that of a damping ratio of 0.745, about the usual
# 0.7 of a step response.
SOFT_OVERSHOOT = 0.03
# Share of the reference's span within which |e| is rounded off in the ITAE term, so that its derivative exists: far
# below any settling band.
_CORNER = 1e-4


class Objective(eqx.Module):
    """Weights and limits of a tuning.

    Attributes:
        weights: Weights of the terms (``TERMS``) relative to their values at the start, shape ``(5,)``.
        limits: Limits (``LIMITS``), shape ``(5,)``; infinite where there is none. Overshoot is a share of the jump,
            settling time in s, temperature in degC, stress in Pa, current in A.
        band: Settling band as a share of the jump.
    """

    weights: jax.Array
    limits: jax.Array
    band: float = eqx.field(static=True, default=SETTLING_BAND)


def make_objective(weights: Mapping[str, float], limits: Mapping[str, float], band: float = SETTLING_BAND) -> Objective:
    """Return the objective with weights and limits that are given by name.

    Args:
        weights: Weights of ``TERMS`` by name; 0 for those that are missing.
        limits: Limits of ``LIMITS`` by name, internal units; none for those that are missing.
        band: Settling band as a share of the jump.
    """
    return Objective(
        jnp.asarray([float(weights.get(t, 0.0)) for t in TERMS]),
        jnp.asarray([float(limits.get(k, jnp.inf)) for k in LIMITS]),
        band,
    )


class ReferenceSignal(eqx.Module):
    """Reference of a channel, and its jumps.

    Attributes:
        values: Reference at the samples, unit of the channel, shape ``(n,)``.
        since_jump: Time since the last jump in s, shape ``(n,)``; see ``step_response.Jumps``.
        jump_size: Size of the last jump, shape ``(n,)``.
        span: Largest minus smallest value, a scalar.
        channel: Name of the channel.
        period: Time between samples, s.
        wires: Number of wires.
    """

    values: jax.Array
    since_jump: jax.Array
    jump_size: jax.Array
    span: jax.Array
    channel: str = eqx.field(static=True)
    period: float = eqx.field(static=True)
    wires: int = eqx.field(static=True)

    def wire_channels(
        self, channels: dict[str, Float[Array, " samples"]], name: str
    ) -> Float[Array, "wires samples"] | None:
        """Return a channel of all wires.

        Args:
            channels: Channels of a rollout by name, shape ``(n,)`` each.
            name: Name of the channel without the number of a wire.

        Returns:
            The channel, shape ``(wires, n)``; ``None`` if the plant does not have it.
        """
        names = numbered(name, self.wires)
        return jnp.stack([channels[n] for n in names]) if names[0] in channels else None


class ObjectiveTerms(NamedTuple):
    """Terms and limits of a rollout.

    Attributes:
        terms: Residuals whose squares sum to the terms (``TERMS``), shape ``(5, n)``.
        violations: c of each limit (``LIMITS``), dimensionless, shape ``(5, n)``; a limit is kept where c <= 0.
    """

    terms: jax.Array
    violations: jax.Array


def evaluate_objective(rollout: Rollout, reference: ReferenceSignal, objective: Objective) -> ObjectiveTerms:
    """Compute terms and limits of a single rollout.

    Args:
        rollout: The rollout of one member.
        reference: The reference and its jumps.
        objective: Limits and settling band.
    """
    error = rollout.channels[reference.channel] - reference.values
    share = _share_of_jump(reference, error)
    terms = _terms(rollout, reference, objective, error, share)
    return ObjectiveTerms(terms, _violations(rollout, reference, objective, share))


def _share_of_jump(reference: ReferenceSignal, error: jax.Array) -> jax.Array:
    """Error as a share of the last jump, shape ``(n,)``; 0 before the first jump."""
    after_jump = reference.jump_size != 0.0
    return jnp.where(after_jump, error / jnp.where(after_jump, reference.jump_size, 1.0), 0.0)


def _terms(
    rollout: Rollout, reference: ReferenceSignal, objective: Objective, error: jax.Array, share: jax.Array
) -> jax.Array:
    """Residuals of the terms, shape ``(5, n)``."""
    count, period = error.shape[0], reference.period
    time = period * jnp.arange(count)
    corner = _CORNER * reference.span
    # sign(e) sqrt(t |e|), rounded off where e changes its sign, so that its derivative exists.
    itae = error * jnp.sqrt(period * time) / jnp.sqrt(jnp.sqrt(error**2 + corner**2) + corner)
    power = reference.wire_channels(rollout.channels, "power")
    energy = jnp.zeros(count) if power is None else _safe_sqrt(period * jnp.sum(power, axis=0))
    moves = jnp.diff(rollout.command, axis=0, prepend=rollout.command[:1])
    effort = _safe_sqrt(jnp.sum(moves**2, axis=1))
    overshoot = maximum(share - SOFT_OVERSHOOT, 0.0) / (objective.band * jnp.sqrt(count))
    return jnp.stack([error / jnp.sqrt(count), itae, energy, effort, overshoot])


def _violations(rollout: Rollout, reference: ReferenceSignal, objective: Objective, share: jax.Array) -> jax.Array:
    """Violations of the limits, shape ``(5, n)``; -1 where a limit does not apply."""
    count = share.shape[0]
    after_jump = reference.jump_size != 0.0
    overshoot, settling, temperature, stress, current = objective.limits
    late = after_jump & (reference.since_jump >= settling)
    no_violation = jnp.full(count, -1.0)
    violations = [
        jnp.where(after_jump & jnp.isfinite(overshoot), (share - _finite_or_one(overshoot)) / objective.band, -1.0),
        jnp.where(late, (jnp.abs(share) - objective.band) / objective.band, -1.0),
        *(
            no_violation
            if (values := reference.wire_channels(rollout.channels, name)) is None
            else _excess(largest(values, axis=0), limit, scale)
            for name, limit, scale in (
                ("temperature", temperature, TEMPERATURE_SCALE),
                ("stress", stress, RELATIVE_SCALE * _finite_or_one(stress)),
                ("current", current, RELATIVE_SCALE * _finite_or_one(current)),
            )
        ),
    ]
    return jnp.stack(violations)


def _excess(values: jax.Array, limit: jax.Array, scale: Any) -> jax.Array:
    """Excess of a channel over its limit, over the scale; -1 without a limit."""
    return jnp.where(jnp.isfinite(limit), (values - _finite_or_one(limit)) / maximum(scale, 1e-12), -1.0)


def _finite_or_one(limit: jax.Array) -> jax.Array:
    return jnp.where(jnp.isfinite(limit), limit, 1.0)


def _safe_sqrt(value: jax.Array) -> jax.Array:
    """The square root, with the derivative 0 where the value is not positive."""
    positive = value > 0.0
    return jnp.where(positive, jnp.sqrt(jnp.where(positive, value, 1.0)), 0.0)
