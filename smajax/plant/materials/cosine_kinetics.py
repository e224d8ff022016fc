"""Cosine kinetics of a transformation: the share that remains to transform, and its fast evaluation.

    f(p) = cos^2(pi/2 p)        p = progress through the transformation's band, limited to 0..1

f falls from 1 at the start of the band to 0 at the finish. The laws use f limited to at least ``smoothing``: a share of
that size never transforms, so that ratios of f and their derivatives are finite at the finish.

Measures for speed, all in this file: the cosine is a quotient of polynomials, since the cosine of the library is not
vectorised on a CPU, which would slow down batches. Outside of a kernel XLA computes a polynomial anew for each use of
its value, a quotient once. The derivative is written out, since that of the quotient would cost more.
"""

import math
from functools import partial
from typing import Any

import jax
import jax.numpy as jnp
from jaxtyping import Array, Float

from smajax.numerics.nonsmooth import clip

# Share that never transforms, by default: far below the resolution of a measurement, far above rounding (1e-16).
DEFAULT_SMOOTHING = 1e-9

# sin(pi/2 m) = m * P(m^2) / Q(m^2) on [0, 1], interpolated at the Chebyshev points of m^2, with a relative error below
# 5e-16; coefficients of P and Q, the lowest power first.
_NUMERATOR = (
    1.5707963267948968,
    -0.5788698130619749,
    0.05339501735179596,
    -0.0017979905694495456,
    2.1226913788392643e-05,
)
_DENOMINATOR = (1.0, 0.04271354809008384, 0.0008236648040608502, 7.5545349118197834e-06)


def _sine(share: jax.Array) -> jax.Array:
    """sin(pi/2 share) for a share of 0..1."""
    square = share * share
    return share * _polynomial(_NUMERATOR, square) / _polynomial(_DENOMINATOR, square)


def _polynomial(coefficients: tuple[float, ...], value: jax.Array) -> jax.Array:
    """A polynomial by Horner's scheme."""
    series = jnp.full_like(value, coefficients[-1])
    for coefficient in coefficients[-2::-1]:
        series = series * value + coefficient
    return series


def cosine_remainder(progress: Float[Array, "..."], smoothing: float) -> Float[Array, "..."]:
    """Compute the share that remains to transform: cos^2(pi/2 progress), scaled to at least ``smoothing``.

    Args:
        progress: Progress through the band, 0 at the start and 1 at the finish; limited to 0..1.
        smoothing: Share that never transforms.
    """
    return _cosine_remainder(progress, smoothing)


@partial(jax.custom_jvp, nondiff_argnums=(1,))
def _cosine_remainder(progress: jax.Array, smoothing: float) -> jax.Array:
    sine = _sine(1.0 - clip(progress, 0.0, 1.0))
    return smoothing + (1.0 - smoothing) * sine * sine


@_cosine_remainder.defjvp
def _cosine_remainder_jvp(
    smoothing: float, primals: tuple[Any, ...], tangents: tuple[Any, ...]
) -> tuple[jax.Array, jax.Array]:
    (progress,), (tangent,) = primals, tangents
    inside = clip(progress, 0.0, 1.0)
    sine, cosine = _sine(1.0 - inside), _sine(inside)
    slope = jnp.where((progress > 0.0) & (progress < 1.0), -(1.0 - smoothing) * math.pi * sine * cosine, 0.0)
    return smoothing + (1.0 - smoothing) * sine * sine, slope * tangent
