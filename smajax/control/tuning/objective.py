"""The objective of a tuning: terms that are minimised and limits that are kept, as residuals of a least-squares search.

Terms are sums of squares over the n samples of a rollout with error e, time t and period T:

    tracking  e^2 / n                          energy  T sum of the wires' power
    itae      T t |e|                          effort  squared moves of the commands from sample to sample

Each counts relative to its value at the start gains; effort, where the command is bounded, relative to moves of a
hundredth of its range. A small weight of effort is needed wherever the simulated sensor is better than a real one:
otherwise the best gains shake the wire.

A limit c <= 0 at every sample is kept by an augmented Lagrangian (nocedal2006, section 17.3): the residual sqrt(mu)
max(0, c + lambda / mu) next to the terms, where the multiplier lambda grows after each search by what is still
violated.
"""

from collections.abc import Mapping
from typing import Any, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp

from smajax.channels import numbered
from smajax.control.analysis.step_response import SETTLING_BAND
from smajax.control.loop.rollout import Rollout
from smajax.numerics.nonsmooth import largest, maximum

TERMS = ("tracking", "itae", "energy", "effort")
LIMITS = ("overshoot", "settling", "temperature", "stress", "current")
# Share of the reference's span within which |e| is rounded off in the ITAE term, so that its derivative exists: far
# below any settling band.
_CORNER = 1e-4
# What counts as a violation of order one: for a temperature in K, for a stress or a current as a share of the limit.
# They put the limits on the scale of the terms, which are near 1.
_TEMPERATURE_SCALE = 10.0
_RELATIVE_SCALE = 0.1


class Objective(eqx.Module):
    """Weights and limits of a tuning.

    Args:
        weights: Weights of ``TERMS`` over their values at the start, shape ``(4,)``.
        limits: Limits of ``LIMITS``, shape ``(5,)``; infinite for none. Overshoot is a share of the jump, settling in
            s, temperature in degC, stress in Pa, current in A.
        band: Settling band as a share of the jump.
    """

    weights: jax.Array
    limits: jax.Array
    band: float = eqx.field(static=True, default=SETTLING_BAND)


def make_objective(weights: Mapping[str, float], limits: Mapping[str, float], band: float = SETTLING_BAND) -> Objective:
    """Return the objective from weights of ``TERMS`` and limits of ``LIMITS`` by name."""
    return Objective(
        jnp.asarray([float(weights.get(t, 0.0)) for t in TERMS]),
        jnp.asarray([float(limits.get(k, jnp.inf)) for k in LIMITS]),
        band,
    )


class ReferenceSignal(eqx.Module):
    """The reference that a channel has to follow, and its jumps.

    Args:
        values: Reference at the samples, shape ``(n,)``.
        since_jump: Time since the last jump, see ``step_response.Jumps``.
        jump_size: Size of the last jump.
        span: Largest less smallest value, a scalar.
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

    def wire_channels(self, channels: dict[str, jax.Array], name: str) -> jax.Array | None:
        """Return a channel of every wire, shape ``(wires, n)``; ``None`` where the plant has none."""
        names = numbered(name, self.wires)
        return jnp.stack([channels[n] for n in names]) if names[0] in channels else None


class ObjectiveTerms(NamedTuple):
    """Terms and limits of a rollout.

    Args:
        terms: Residuals whose squares sum to the terms of ``TERMS``, shape ``(4, n)``.
        violations: c of each limit of ``LIMITS``, shape ``(5, n)``; a limit is kept where c <= 0.
    """

    terms: jax.Array
    violations: jax.Array


def evaluate_objective(rollout: Rollout, reference: ReferenceSignal, objective: Objective) -> ObjectiveTerms:
    """Return the terms and limits of a rollout."""
    channels, period = rollout.channels, reference.period
    error = channels[reference.channel] - reference.values
    count = error.shape[0]
    time = period * jnp.arange(count)
    corner = _CORNER * reference.span
    # sign(e) sqrt(t |e|), rounded off where e changes its sign, so that its derivative exists.
    itae = error * jnp.sqrt(period * time) / jnp.sqrt(jnp.sqrt(error**2 + corner**2) + corner)
    power = reference.wire_channels(channels, "power")
    energy = jnp.zeros(count) if power is None else _safe_sqrt(period * jnp.sum(power, axis=0))
    moves = jnp.diff(rollout.command, axis=0, prepend=rollout.command[:1])
    effort = _safe_sqrt(jnp.sum(moves**2, axis=1))
    terms = jnp.stack([error / jnp.sqrt(count), itae, energy, effort])

    after_jump = reference.jump_size != 0.0
    share = jnp.where(after_jump, error / jnp.where(after_jump, reference.jump_size, 1.0), 0.0)
    overshoot, settling, temperature, stress, current = objective.limits
    late = after_jump & (reference.since_jump >= settling)
    kept = jnp.full(count, -1.0)
    violations = [
        jnp.where(after_jump & jnp.isfinite(overshoot), (share - _finite_or_one(overshoot)) / objective.band, -1.0),
        jnp.where(late, (jnp.abs(share) - objective.band) / objective.band, -1.0),
        *(
            kept
            if (values := reference.wire_channels(channels, name)) is None
            else _excess(largest(values, axis=0), limit, scale)
            for name, limit, scale in (
                ("temperature", temperature, _TEMPERATURE_SCALE),
                ("stress", stress, _RELATIVE_SCALE * _finite_or_one(stress)),
                ("current", current, _RELATIVE_SCALE * _finite_or_one(current)),
            )
        ),
    ]
    return ObjectiveTerms(terms, jnp.stack(violations))


def residual(
    evaluated: ObjectiveTerms, scale: jax.Array, objective: Objective, multipliers: jax.Array, mu: jax.Array
) -> jax.Array:
    """Return all residuals of the augmented Lagrangian.

    Args:
        evaluated: Terms and limits of a rollout.
        scale: Terms at the start, shape ``(4,)``.
        objective: Weights and limits.
        multipliers: Multipliers of the limits at the samples, shape ``(5, n)``.
        mu: Penalty, a scalar.

    Returns:
        Residuals, shape ``(9 n,)``.
    """
    terms = evaluated.terms * jnp.sqrt(objective.weights / scale)[:, None]
    limits = jnp.sqrt(mu) * maximum(evaluated.violations + multipliers / mu, 0.0)
    return jnp.concatenate([terms.ravel(), limits.ravel()])


def _excess(values: jax.Array, limit: jax.Array, scale: Any) -> jax.Array:
    return jnp.where(jnp.isfinite(limit), (values - _finite_or_one(limit)) / maximum(scale, 1e-12), -1.0)


def _finite_or_one(limit: jax.Array) -> jax.Array:
    return jnp.where(jnp.isfinite(limit), limit, 1.0)


def _safe_sqrt(value: jax.Array) -> jax.Array:
    """The square root, with the derivative 0 where the value is not positive."""
    positive = value > 0.0
    return jnp.where(positive, jnp.sqrt(jnp.where(positive, value, 1.0)), 0.0)
