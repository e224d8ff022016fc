"""Nonparametric terms: a piecewise linear function of time or of a state that is added in a stage of the plant.

They describe a residual and name no cause. As functions of time they show which stage a residual can come from
(``localisation``); as functions of a state, the form of a term that the catalogue lacks (``nonparametric_fit``).
"""

import dataclasses
from typing import Any, ClassVar

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from smajax.numerics.nonsmooth import clip
from smajax.parameters import parameter
from smajax.plant.effects.base import AbstractEffect, HeatEffect, MaterialEffect, StageContext, WireState
from smajax.plant.plant import Plant

# Number of knots of a term: as a function of time they resolve a twenty-fourth of the recording. Chosen by trial;
# tests/unit/diagnosis holds it.
KNOTS = 24
# Variables of which a term may be a function, as in diagnosis.json; "travel" is the accumulated transformation.
VARIABLES = ("time", "temperature", "martensite", "travel")


class NonparametricEffect(AbstractEffect):
    """A piecewise linear function of one of ``VARIABLES``.

    Attributes:
        knots: Values at equally spaced points of the variable's range, in the unit ``adds``, shape ``(KNOTS,)``.
        selection: 1 for the variable that is used and 0 for the others, shape ``(variables,)``.
        low: Lower end of each variable's range, shape ``(variables,)``.
        high: Upper end of each variable's range, shape ``(variables,)``.
        strength: Factor of the term.
        adds: Unit of the term.
    """

    knots: Float[Array, " knots"]
    selection: Float[Array, " variables"]
    low: Float[Array, " variables"]
    high: Float[Array, " variables"]
    strength: jax.Array = parameter("1", "there or not", 0.0, 1.0, 1.0)
    typical: ClassVar[float] = 1.0
    source = "nonparametric"
    adds: ClassVar[str]

    def term(self, state: WireState) -> Float[Array, " wires"]:
        """Return the value of the term; 0 without a computation if no variable is selected."""
        return jax.lax.cond(
            jnp.any(self.selection != 0.0), lambda: self._interpolate(state), lambda: jnp.zeros_like(state.temperature)
        )

    def _interpolate(self, state: WireState) -> Float[Array, " wires"]:
        variables = (
            jnp.broadcast_to(state.time, state.temperature.shape),
            state.temperature,
            state.fractions.martensite,
            state.accumulated_transformation,
        )
        each = zip(self.selection, variables, self.low, self.high, strict=True)
        position = sum(selected * (value - low) / (high - low) for selected, value, low, high in each)
        position = clip(position, 0.0, 1.0) * (KNOTS - 1)
        k = jnp.clip(jnp.floor(position).astype(int), 0, KNOTS - 2)
        return self.strength * (self.knots[k] * (k + 1 - position) + self.knots[k + 1] * (position - k))


class FreeHeat(NonparametricEffect, HeatEffect):
    """Heat added to the wire."""

    key = "free-heat"
    adds = "W/m^3"

    def power(self, state: WireState, memory: Any, context: StageContext) -> Float[Array, " wires"]:
        """Return the heat added, W/m^3."""
        return self.term(state)


class FreeShift(NonparametricEffect, MaterialEffect):
    """Shift of the transformation temperatures."""

    key = "free-shift"
    adds = "K"

    def shift(self, state: WireState, context: StageContext) -> Float[Array, " wires"]:
        """Return the shift, K."""
        return self.term(state)


class FreeStrain(NonparametricEffect, MaterialEffect):
    """Strain added to the wire."""

    key = "free-strain"
    adds = "1"

    def strain(self, state: WireState, memory: Any, context: StageContext) -> Float[Array, " wires"]:
        """Return the strain added, dimensionless."""
        return self.term(state)


KINDS = (FreeHeat, FreeShift, FreeStrain)


def zero_terms() -> tuple[FreeHeat, FreeShift, FreeStrain]:
    """Return one term of each kind, all zero."""
    knots, zeros, ones = jax.device_put((np.zeros(KNOTS), np.zeros(len(VARIABLES)), np.ones(len(VARIABLES))))
    ranges = {"selection": zeros, "low": zeros, "high": ones}
    return FreeHeat(knots=knots, **ranges), FreeShift(knots=knots, **ranges), FreeStrain(knots=knots, **ranges)


def set_terms(
    plant: Plant,
    knots: Float[Array, "kinds knots"],
    selection: Float[Array, " variables"],
    low: Float[Array, " variables"],
    high: Float[Array, " variables"],
) -> Plant:
    """Return a plant with other values of its nonparametric terms.

    Args:
        plant: A plant with one term of each kind.
        knots: Values of the knots of each kind.
        selection: 1 for the variable that is used and 0 for the others.
        low: Lower end of each variable's range.
        high: Upper end of each variable's range.
    """
    effects = tuple(
        dataclasses.replace(e, knots=knots[KINDS.index(type(e))], selection=selection, low=low, high=high)
        if isinstance(e, KINDS)
        else e
        for e in plant.effects
    )
    return dataclasses.replace(plant, effects=effects)


def hat_functions(positions: Float[np.ndarray, " n"], nodes: int) -> Float[np.ndarray, "n nodes"]:
    """Evaluate the hat functions of equally spaced nodes on 0 to 1.

    Args:
        positions: Points, shape ``(n,)``.
        nodes: Number of nodes.

    Returns:
        The value of each hat function at each point, shape ``(n, nodes)``.
    """
    position = np.clip(positions, 0.0, 1.0) * (nodes - 1)
    return np.maximum(0.0, 1.0 - np.abs(position[:, None] - np.arange(nodes)[None, :]))
