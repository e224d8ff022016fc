"""Terms of free form: what a stage would need, as a piecewise linear function of time or of a state. A description, not a cause.

As functions of time they say in which stage a residual can live; as functions of a state, how a term that the catalogue lacks would look.
"""

import dataclasses
from typing import Any, ClassVar

import jax
import jax.numpy as jnp
import numpy as np

from smajax.kinks import within
from smajax.parameters import parameter
from smajax.plant.effect import AbstractEffect, HeatEffect, Instant, MaterialEffect, Where
from smajax.plant.plant import Plant

KNOTS = 24
AGAINST = ("time", "temperature", "martensite", "travel")


class FreeForm(AbstractEffect):
    """A piecewise linear function of ``AGAINST[mix]`` over its ``low`` to ``high``, with ``knots`` of shape ``(KNOTS,)``."""

    knots: jax.Array
    mix: jax.Array
    low: jax.Array
    high: jax.Array
    strength: jax.Array = parameter("1", "there or not", 0.0, 1.0, 1.0)
    typical = 1.0
    source = "free form"
    adds: ClassVar[str]

    def term(self, now: Instant) -> jax.Array:
        """Its value, shape ``(wires,)``; without a state to stand against it costs nothing."""
        return jax.lax.cond(jnp.any(self.mix != 0.0), lambda: self._looked_up(now), lambda: jnp.zeros_like(now.temperature))

    def _looked_up(self, now: Instant) -> jax.Array:
        states = (jnp.broadcast_to(now.time, now.temperature.shape), now.temperature, now.fractions.martensite, now.travel)
        place = sum(m * (s - a) / (b - a) for m, s, a, b in zip(self.mix, states, self.low, self.high, strict=True))
        place = within(place, 0.0, 1.0) * (KNOTS - 1)
        left = jnp.clip(jnp.floor(place).astype(int), 0, KNOTS - 2)
        return self.strength * (self.knots[left] * (left + 1 - place) + self.knots[left + 1] * (place - left))


class FreeHeat(FreeForm, HeatEffect):
    """Heat added."""

    key = "free-heat"
    adds = "W/m^3"

    def power(self, now: Instant, memory: Any, where: Where) -> jax.Array:
        """See ``HeatEffect``."""
        return self.term(now)


class FreeShift(FreeForm, MaterialEffect):
    """Shift of the transformation temperatures."""

    key = "free-shift"
    adds = "K"

    def shift(self, now: Instant, where: Where) -> jax.Array:
        """See ``MaterialEffect``."""
        return self.term(now)


class FreeStrain(FreeForm, MaterialEffect):
    """Strain added."""

    key = "free-strain"
    adds = "1"

    def strain(self, now: Instant, memory: Any, where: Where) -> jax.Array:
        """See ``MaterialEffect``."""
        return self.term(now)


KINDS = (FreeHeat, FreeShift, FreeStrain)


def absent() -> tuple[FreeHeat, FreeShift, FreeStrain]:
    """One of each kind, all zero."""
    none, zeros, ones = jnp.zeros(KNOTS), jnp.zeros(len(AGAINST)), jnp.ones(len(AGAINST))
    ends = {"mix": zeros, "low": zeros, "high": ones}
    return FreeHeat(knots=none, **ends), FreeShift(knots=none, **ends), FreeStrain(knots=none, **ends)


def put(plant: Plant, knots: jax.Array, mix: jax.Array, low: jax.Array, high: jax.Array) -> Plant:
    """A plant whose free terms have these values: ``knots`` of shape ``(len(KINDS), KNOTS)``, the rest ``(len(AGAINST),)``."""
    effects = tuple(
        dataclasses.replace(e, knots=knots[KINDS.index(type(e))], mix=mix, low=low, high=high) if isinstance(e, KINDS) else e
        for e in plant.effects
    )
    return dataclasses.replace(plant, effects=effects)


def hats(where: np.ndarray, nodes: int) -> np.ndarray:
    """Piecewise linear functions on ``nodes`` equal parts of 0..1, at points ``(n,)``: shape ``(n, nodes)``."""
    place = np.clip(where, 0.0, 1.0) * (nodes - 1)
    return np.maximum(0.0, 1.0 - np.abs(place[:, None] - np.arange(nodes)[None, :]))
