"""Grains: a spread of transformation temperatures in each cell of a wire.

Each of k grains follows the material law with its own fractions, and so with its own memory of partial loops. The
fractions of a cell are the mean of those of its grains. Grain i transforms at temperatures that differ from those of
the whole wire by z_i times a standard deviation in the reverse, and by y_i times one in the forward transformation.
The z_i are the quantiles of a normal distribution, scaled to a variance of 1, and

    y_i = cos(theta) z_i + sin(theta) n_i

with the values n_i in another order, without what is correlated with z_i: the cosine of the angle theta is the
correlation between the two directions. At 0, the default, grains that transform back at a higher temperature also form
martensite at a higher one; at 90 deg the two are independent.

The transformation temperatures in files are those of the whole wire. The spread phi, given for both directions apart,
is the share of the standard deviation s of the whole wire's transformation that is due to differences between grains.
With the width W of the wire's transformation (A_f - A_s, or M_s - M_f), a grain has, about the same middle,

    width = w c(phi) W sqrt(1 - phi^2)        shift = w c(phi) W s phi z_i, or y_i

The factor w on the width, again for both directions apart, is 1: a fit may free it, since the width of a law above M_s
depends on several of its parameters (``with_whole_width``).

The factor c(phi) is near 1. With it the mean over many grains has the steepest tangent of the law without grains, so
that the tangents at a measured cycle (ASTM E3097) give the same temperatures for every spread.
"""

import math
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from smajax.parameters import CheckedModule, parameter
from smajax.plant.materials.base import AbstractMaterial

# Largest spread: a grain then has 0.3 of the wire's width. A narrower one transforms within a time step.
_LARGEST_SPREAD = 0.95
# Bounds of the factors on the widths, far beyond the differences between wires of one alloy. Chosen by trial.
_WIDTHS = (0.2, 5.0)
# Standard deviation below which quantiles are 0 up to rounding.
_ROUNDING = 1e-9


class Grains(CheckedModule):
    """Spread of the transformation temperatures of the grains.

    Attributes:
        count: Number of grains in each cell, at least 2.
    """

    austenite_spread: jax.Array = parameter(
        "1",
        "share of the width of the reverse transformation that is due to differences between grains",
        0.0,
        _LARGEST_SPREAD,
        0.7,
    )
    martensite_spread: jax.Array = parameter(
        "1",
        "share of the width of the forward transformation that is due to differences between grains",
        0.0,
        _LARGEST_SPREAD,
        0.7,
    )
    austenite_width: jax.Array = parameter(
        "1", "width of the reverse transformation over that of the file's temperatures", *_WIDTHS, 1.0
    )
    martensite_width: jax.Array = parameter(
        "1", "width of the forward transformation over that of the file's temperatures", *_WIDTHS, 1.0
    )
    correlation_angle: jax.Array = parameter(
        "rad",
        "angle whose cosine is the correlation of a grain's shifts of both transformations",
        0.0,
        math.pi,
        0.0,
    )
    count: int = eqx.field(static=True, default=6)

    @property
    def quantiles(self) -> np.ndarray:
        """The z_i and the n_i of each grain, with means of 0 and variances of 1, shape ``(count, 2)``.

        Two grains have no n_i other than 0.
        """
        from scipy.special import ndtri  # slow to import, and seldom needed

        quantiles = ndtri((np.arange(self.count) + 0.5) / self.count)
        quantiles = quantiles / np.sqrt(np.mean(quantiles**2))
        other = np.concatenate([quantiles[::2], quantiles[1::2]])
        other = other - np.mean(other * quantiles) * quantiles
        return np.stack([quantiles, other / max(math.sqrt(np.mean(other**2)), _ROUNDING)], axis=1)

    def material_of(
        self, material: AbstractMaterial, quantiles: tuple[Float[Array, "*grains"], Float[Array, "*grains"]]
    ) -> AbstractMaterial:
        """Return the law of one grain, or of several as one law with arrays.

        Args:
            material: The law of the whole wire.
            quantiles: Quantiles z_i and n_i of the grain or the grains.
        """
        first, other = quantiles
        second = jnp.cos(self.correlation_angle) * first + jnp.sin(self.correlation_angle) * other
        reverse, forward = (
            _band(spread, width, quantile, material)
            for spread, width, quantile in (
                (self.austenite_spread, self.austenite_width, first),
                (self.martensite_spread, self.martensite_width, second),
            )
        )
        return material.with_bands(reverse, forward)

    def with_whole_width(self, material: AbstractMaterial) -> tuple["Grains", AbstractMaterial]:
        """Move the factors on the widths into the temperatures of the law, about the same middles.

        Args:
            material: The law of the whole wire.

        Returns:
            Grains with factors of 1, and the law with which they are the same wire.
        """
        zero, one = jnp.zeros(()), jnp.ones(())
        whole = material.with_bands((zero, self.austenite_width), (zero, self.martensite_width))
        return eqx.tree_at(lambda g: (g.austenite_width, g.martensite_width), self, (one, one)), whole


def _band(spread: jax.Array, width: jax.Array, quantile: jax.Array, material: AbstractMaterial) -> tuple[Any, Any]:
    """Shift and width of a grain's transformation, as shares of the width of the wire's."""
    square = spread * spread
    factor = jnp.ones_like(square)
    power = square
    for coefficient in material.tangent_factor:
        factor = factor + coefficient * power
        power = power * square
    factor = width * factor
    return factor * material.band_deviation * spread * quantile, factor * jnp.sqrt(1.0 - square)
