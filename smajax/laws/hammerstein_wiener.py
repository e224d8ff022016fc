"""Hammerstein-Wiener model: a static curve, a linear block with a delay, a static curve.

    w = f(u),     x(k) = -f_1 x(k-1) - f_2 x(k-2) + b_1 w(k-1-nk) + b_2 w(k-2-nk),     y = h(x)

f and h are piecewise linear between knots. The linear block has unit static gain, since f and h scale it. It is stable
by construction: its poles are given by reflection coefficients between -1 and 1. Rows are equally spaced. The delay nk
is given in s and may be a fractional number of rows: w is interpolated linearly between rows.

Source: copaci2020.
"""

from typing import ClassVar

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Float

from smajax.laws.base import AbstractSeriesModel


class HammersteinWiener(AbstractSeriesModel):
    """Hammerstein-Wiener model with piecewise linear curves and two poles.

    Attributes:
        knots: Inputs at the knots of f, shape ``(k,)``.
        inlet: Values of f at the knots, shape ``(k,)``.
        reflections: Reflection coefficients that determine the poles, -1..1, shape ``(2,)``.
        split: Share b_1 / (b_1 + b_2).
        outlet: Values of h at equally spaced points of 0..1, shape ``(k,)``.
        delay: Delay, s.
        settled: Share of the first input to which the linear block had settled before the recording.
    """

    needs_even_rows: ClassVar[bool] = True
    knots: jax.Array
    inlet: jax.Array
    reflections: jax.Array
    split: jax.Array
    outlet: jax.Array
    delay: jax.Array = eqx.field(default=0.0, converter=jnp.asarray)
    settled: jax.Array = eqx.field(default=1.0, converter=jnp.asarray)

    def even_response(self, time: Float[Array, " rows"], values: Float[Array, " rows"]) -> Float[Array, " rows"]:
        """Compute the outputs at all rows, which are equally spaced. Outside 0..1 h is extrapolated linearly."""
        initial = self._inlet(self.settled * values[0])
        rows = self.delay * (len(time) - 1) / (time[-1] - time[0])
        delayed = self._delayed(self._inlet(values), initial, rows)
        second = self.reflections[1]
        first = self.reflections[0] * (1.0 + second)
        driven = (1.0 + first + second) * (
            self.split * delayed + (1.0 - self.split) * jnp.append(initial, delayed[:-1])
        )

        def advance(
            state: tuple[jax.Array, jax.Array], drive: jax.Array
        ) -> tuple[tuple[jax.Array, jax.Array], jax.Array]:
            newer, older = state
            return (drive - first * newer - second * older, newer), newer

        _, inner = jax.lax.scan(advance, (initial, initial), driven)
        return self._outlet(inner)

    def _inlet(self, value: jax.Array) -> jax.Array:
        return jnp.interp(value, self.knots, self.inlet)

    @staticmethod
    def _delayed(curve: jax.Array, before: jax.Array, rows: jax.Array) -> jax.Array:
        """A series delayed by a number of rows, with the value ``before`` in front of its first row."""
        whole = jnp.floor(rows)
        newer, older = (
            jnp.where(places >= 0, curve[jnp.maximum(places, 0)], before)
            for places in (jnp.arange(len(curve)) - whole.astype(int) - more for more in (0, 1))
        )
        return newer + (rows - whole) * (older - newer)

    def _outlet(self, inner: jax.Array) -> jax.Array:
        count = len(self.outlet)
        place = jnp.clip(jnp.floor(inner * (count - 1)).astype(int), 0, count - 2)
        return self.outlet[place] + (inner * (count - 1) - place) * (self.outlet[place + 1] - self.outlet[place])
