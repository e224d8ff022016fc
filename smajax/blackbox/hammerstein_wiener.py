"""The Hammerstein-Wiener model: a static curve, a linear block, a static curve.

    w = f(u),     x(k) = -f_1 x(k-1) - f_2 x(k-2) + b_1 w(k-1) + b_2 w(k-2),     y = h(x)

f and h are piecewise linear between knots. The block has unit gain at rest, since f and h scale it, and is stable by construction: its
poles are given by reflection coefficients between -1 and 1. Rows are equally far apart.
"""

import equinox as eqx
import jax
import jax.numpy as jnp

from smajax.hysteresis.operator import AbstractOperator


class HammersteinWiener(AbstractOperator):
    """``inlet`` and ``outlet``, shape ``(k,)`` each: values of f at ``knots``, shape ``(k,)``, and of h at k even points of 0..1.

    ``reflections``, shape ``(2,)``, give the poles; ``split`` is the share b_1 / (b_1 + b_2); ``settled`` that of the first input to which
    the block had settled before it.
    """

    knots: jax.Array
    inlet: jax.Array
    reflections: jax.Array
    split: jax.Array
    outlet: jax.Array
    settled: jax.Array = eqx.field(default=1.0, converter=jnp.asarray)

    def start(self, first: jax.Array) -> tuple[jax.Array, jax.Array, jax.Array]:
        """See ``AbstractOperator.start``: x now and before, and the last w."""
        w = self._inlet(self.settled * first)
        return w, w, w

    def advance(self, state: tuple, before: jax.Array, after: jax.Array, step: jax.Array) -> tuple[jax.Array, jax.Array, jax.Array]:
        """See ``AbstractOperator.advance``."""
        now, old, earlier = state
        w = self._inlet(before)
        second = self.reflections[1]
        first = self.reflections[0] * (1.0 + second)
        driven = (1.0 + first + second) * (self.split * w + (1.0 - self.split) * earlier)
        return driven - first * now - second * old, now, w

    def output(self, state: tuple, value: jax.Array) -> jax.Array:
        """See ``AbstractOperator.output``; beyond its ends h goes on straight."""
        count = len(self.outlet)
        place = jnp.clip(jnp.floor(state[0] * (count - 1)).astype(int), 0, count - 2)
        share = state[0] * (count - 1) - place
        return self.outlet[place] + share * (self.outlet[place + 1] - self.outlet[place])

    def _inlet(self, value: jax.Array) -> jax.Array:
        return jnp.interp(value, self.knots, self.inlet)
