"""Grains: a spread of transformation temperatures in each cell of a wire.

Each of k grains follows the material law with its own fractions, and so with its own memory of partial loops. The
fractions of a cell are the mean of those of its grains. Grain i transforms at temperatures that differ from those of
the whole wire by z_i times a standard deviation in the reverse, and by y_i times one in the forward transformation.
The z_i are the quantiles of a normal distribution, scaled to a variance of 1, and

    y_i = cos(theta) z_i + sin(theta) n_i

with the values n_i in another order, without what is correlated with z_i: the cosine of the angle theta is the
correlation between the two directions. At 0, the default, grains that transform back at a higher temperature also form
martensite at a higher one; at 90 deg the two are independent.

A wire has few grains along its section, so that their temperatures are hardly distributed normally. Shapes add to z_i
and y_i polynomials of z_i of degree 2 to 5, and 2 to 4, that are orthonormal to each other and to what is there, and
the sum is scaled to a variance of 1. With six grains they give each grain any shift. All are 0 by default.

The transformation temperatures in files are those of the whole wire. The spread phi, given for both directions apart,
is the share of the standard deviation s of the whole wire's transformation that is due to differences between grains.
With the width W of the wire's transformation (A_f - A_s, or M_s - M_f), a grain has, about the same middle,

    width = w c(phi) W sqrt(1 - phi^2)        shift = w c(phi) W s phi z_i, or y_i

The factor w on the width, again for both directions apart, is 1: a fit may free it, since the width of a law above M_s
depends on several of its parameters (``with_whole_width``).

The factor c(phi) is near 1. With it the mean over many grains has the steepest tangent of the law without grains, so
that the tangents at a measured cycle (ASTM E3097) give the same temperatures for every spread, as long as shapes are 0.
"""

import math
from collections.abc import Iterable
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
# Bounds of the shapes: with 3 the polynomial has nine tenths of the variance.
_SHAPES = (-3.0, 3.0)
# Standard deviation below which quantiles are 0 up to rounding.
_ROUNDING = 1e-9
# Degrees of the polynomials of the shapes. In the forward transformation one direction is taken by the n_i.
_AUSTENITE_SHAPES = {"austenite_quadratic": 2, "austenite_cubic": 3, "austenite_quartic": 4, "austenite_quintic": 5}
_MARTENSITE_SHAPES = {"martensite_quadratic": 2, "martensite_cubic": 3, "martensite_quartic": 4}
SHAPES = (*_AUSTENITE_SHAPES, *_MARTENSITE_SHAPES)


def _shape(side: str, degree: int) -> Any:
    meaning = f"coefficient of the polynomial of degree {degree} in the grains' shifts of the {side} transformation"
    return parameter("1", meaning, *_SHAPES, 0.0)


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
    austenite_quadratic: jax.Array = _shape("reverse", 2)
    austenite_cubic: jax.Array = _shape("reverse", 3)
    austenite_quartic: jax.Array = _shape("reverse", 4)
    austenite_quintic: jax.Array = _shape("reverse", 5)
    martensite_quadratic: jax.Array = _shape("forward", 2)
    martensite_cubic: jax.Array = _shape("forward", 3)
    martensite_quartic: jax.Array = _shape("forward", 4)
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

    @property
    def shifts(self) -> Float[Array, "count 2"]:
        """Shift of each grain's reverse and forward transformation over their standard deviations."""
        first, other = self.quantiles.T
        reverse = _orthonormal_powers((np.ones_like(first), first), first, _AUSTENITE_SHAPES.values())
        forward = _orthonormal_powers((np.ones_like(first), first, other), first, _MARTENSITE_SHAPES.values())
        second = jnp.cos(self.correlation_angle) * first + jnp.sin(self.correlation_angle) * other
        return jnp.stack(
            [
                self._shaped(jnp.asarray(first), reverse, _AUSTENITE_SHAPES),
                self._shaped(second, forward, _MARTENSITE_SHAPES),
            ],
            axis=1,
        )

    def _shaped(
        self, shifts: Float[Array, " count"], polynomials: np.ndarray, names: Iterable[str]
    ) -> Float[Array, " count"]:
        """Shifts with the shapes of a direction, scaled to a variance of 1."""
        shapes = jnp.stack([getattr(self, name) for name in names])
        variance = 1.0 + jnp.mean(polynomials**2, axis=0) @ (shapes * shapes)
        return (shifts + polynomials @ shapes) / jnp.sqrt(variance)

    def material_of(
        self, material: AbstractMaterial, shifts: tuple[Float[Array, "*grains"], Float[Array, "*grains"]]
    ) -> AbstractMaterial:
        """Return the law of one grain, or of several as one law with arrays.

        Args:
            material: The law of the whole wire.
            shifts: Both ``shifts`` of the grain or the grains.
        """
        reverse, forward = (
            _band(spread, width, shift, material)
            for spread, width, shift in (
                (self.austenite_spread, self.austenite_width, shifts[0]),
                (self.martensite_spread, self.martensite_width, shifts[1]),
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


def _orthonormal_powers(given: Iterable[np.ndarray], base: np.ndarray, degrees: Iterable[int]) -> np.ndarray:
    """Powers of values, orthonormal to each other and to given values, shape ``(count, degrees)``.

    A power that depends on those before, as with few values, is 0.
    """
    found, columns = list(given), []
    for degree in degrees:
        power = base**degree
        for other in found:
            power = power - np.mean(power * other) * other
        size = math.sqrt(np.mean(power**2))
        columns.append(power / size if size > _ROUNDING else np.zeros_like(power))
        found.append(columns[-1])
    return np.stack(columns, axis=1)


def _band(spread: jax.Array, width: jax.Array, shift: jax.Array, material: AbstractMaterial) -> tuple[Any, Any]:
    """Shift and width of a grain's transformation, as shares of the width of the wire's."""
    square = spread * spread
    factor = jnp.ones_like(square)
    power = square
    for coefficient in material.tangent_factor:
        factor = factor + coefficient * power
        power = power * square
    factor = width * factor
    return factor * material.band_deviation * spread * shift, factor * jnp.sqrt(1.0 - square)
