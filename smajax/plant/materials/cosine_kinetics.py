"""Cosine kinetics of a transformation: the share that remains to transform, and its fast evaluation.

    f(p) = cos^2(pi/2 p)        p = progress through the transformation's band, limited to 0..1

f falls from 1 at the start of the band to 0 at the finish. The laws use f limited to at least ``smoothing``: a share of
that size never transforms, so that ratios of f and their derivatives are finite at the finish.

Measures for speed, all in this file: the cosine is a polynomial, since the cosine of the library is not vectorised on a
CPU, which would slow down batches, and its derivative is written out, since that of the polynomial would cost more.
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

# sin(pi/2 m) = m * P(m^2) on [0, 1], interpolated at the Chebyshev points of m^2, with a relative error below 5e-16.
_SINE = (
    1.5707963267948963,
    -0.6459640975062273,
    0.0796926262457332,
    -0.004681754131665194,
    0.00016044117004586423,
    -3.598811286059924e-06,
    5.688354048912463e-08,
    -6.450375339764774e-10,
)


def _sine(share: jax.Array) -> jax.Array:
    """sin(pi/2 share) for a share of 0..1."""
    square = share * share
    series = jnp.full_like(square, _SINE[-1])
    for coefficient in _SINE[-2::-1]:
        series = series * square + coefficient
    return share * series


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
