"""What is wanted of a loop, as residuals of a least-squares search: terms to be made small, limits to be kept.

Terms are squares: the tracking error, ITAE by the square root of t |e|, energy by that of the power, and effort, which is how far the
commands move from sample to sample. Each counts relative to its value at the start gains; effort, where the command has limits, relative to
moves of a hundredth of their distance. A little effort has to count wherever the sensor is better than a real one, or else the best gains
shake the wire. A limit c <= 0 at every sample is kept by an augmented Lagrangian: sqrt(mu) max(0, c + lambda / mu) beside the terms, where
lambda is raised after each search by what is still violated.
"""

from collections.abc import Mapping
from typing import Any, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp

from smajax.control.metrics import BAND
from smajax.control.rollout import Rollout
from smajax.kinks import larger, largest
from smajax.units import numbered

TERMS = ("tracking", "itae", "energy", "effort")
LIMITS = ("overshoot", "settling", "temperature", "stress", "current")
_CORNER = 1e-4  # of the span, within which |e| is rounded off
_KELVIN, _SHARE = 10.0, 0.1  # what counts as a violation of order one: of a temperature, and of a stress or current


class Wanted(eqx.Module):
    """``weights`` of ``TERMS`` over their values at the start, and ``limits`` of ``LIMITS`` (infinite: none), arrays.

    Overshoot is a share of the jump, settling in s, temperature in degC, stress in Pa, current in A. ``band`` is that of settling.
    """

    weights: jax.Array
    limits: jax.Array
    band: float = eqx.field(static=True, default=BAND)


def wanted_of(weights: Mapping[str, float], limits: Mapping[str, float], band: float = BAND) -> Wanted:
    """What is wanted, from weights of ``objective.TERMS`` and limits of ``objective.LIMITS`` by name."""
    return Wanted(
        jnp.asarray([float(weights.get(t, 0.0)) for t in TERMS]), jnp.asarray([float(limits.get(k, jnp.inf)) for k in LIMITS]), band
    )


class Task(eqx.Module):
    """The reference and what its jumps are (see ``metrics.Jumps``), shape ``(n,)``, its ``span``, and the names of the channels."""

    reference: jax.Array
    since: jax.Array
    size: jax.Array
    span: jax.Array
    channel: str = eqx.field(static=True)
    period: float = eqx.field(static=True)
    wires: int = eqx.field(static=True)

    def each(self, channels: dict[str, jax.Array], name: str) -> jax.Array | None:
        """A channel of every wire, shape ``(wires, n)``; ``None`` where the plant has none."""
        names = numbered(name, self.wires)
        return jnp.stack([channels[n] for n in names]) if names[0] in channels else None


class Parts(NamedTuple):
    """``terms``, shape ``(4, n)``, whose squares sum to the terms of ``TERMS``; ``violated``, shape ``(5, n)``, c of each limit."""

    terms: jax.Array
    violated: jax.Array


def parts(done: Rollout, task: Task, wanted: Wanted) -> Parts:
    """The terms and limits of a rollout."""
    channels, dt = done.channels, task.period
    error = channels[task.channel] - task.reference
    count = error.shape[0]
    time = dt * jnp.arange(count)
    corner = _CORNER * task.span
    # sign(e) sqrt(t |e|), rounded off where e changes its sign, so that its derivative exists.
    itae = error * jnp.sqrt(dt * time) / jnp.sqrt(jnp.sqrt(error**2 + corner**2) + corner)
    power = task.each(channels, "power")
    energy = jnp.zeros(count) if power is None else _root(dt * jnp.sum(power, axis=0))
    moved = jnp.diff(done.command, axis=0, prepend=done.command[:1])
    effort = _root(jnp.sum(moved**2, axis=1))
    terms = jnp.stack([error / jnp.sqrt(count), itae, energy, effort])

    jumped = task.size != 0.0
    share = jnp.where(jumped, error / jnp.where(jumped, task.size, 1.0), 0.0)
    over, settling, hot, stressed, driven = wanted.limits
    late = jumped & (task.since >= settling)
    none = jnp.full(count, -1.0)
    violated = [
        jnp.where(jumped & jnp.isfinite(over), (share - _finite(over)) / wanted.band, -1.0),
        jnp.where(late, (jnp.abs(share) - wanted.band) / wanted.band, -1.0),
        *(
            none if (values := task.each(channels, name)) is None else _above(largest(values, axis=0), limit, scale)
            for name, limit, scale in (
                ("temperature", hot, _KELVIN),
                ("stress", stressed, _SHARE * _finite(stressed)),
                ("current", driven, _SHARE * _finite(driven)),
            )
        ),
    ]
    return Parts(terms, jnp.stack(violated))


def residual(found: Parts, scale: jax.Array, wanted: Wanted, multipliers: jax.Array, mu: jax.Array) -> jax.Array:
    """All residuals, shape ``(9 n,)``; ``scale``, shape ``(4,)``, are the terms at the start, ``multipliers``, shape ``(5, n)``."""
    terms = found.terms * jnp.sqrt(wanted.weights / scale)[:, None]
    limits = jnp.sqrt(mu) * larger(found.violated + multipliers / mu, 0.0)
    return jnp.concatenate([terms.ravel(), limits.ravel()])


def _above(values: jax.Array, limit: jax.Array, scale: Any) -> jax.Array:
    return jnp.where(jnp.isfinite(limit), (values - _finite(limit)) / larger(scale, 1e-12), -1.0)


def _finite(limit: jax.Array) -> jax.Array:
    return jnp.where(jnp.isfinite(limit), limit, 1.0)


def _root(value: jax.Array) -> jax.Array:
    positive = value > 0.0
    return jnp.where(positive, jnp.sqrt(jnp.where(positive, value, 1.0)), 0.0)
