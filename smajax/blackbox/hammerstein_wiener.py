"""The Hammerstein-Wiener model: a static curve, a linear block with a delay, a static curve.

    w = f(u),     x(k) = -f_1 x(k-1) - f_2 x(k-2) + b_1 w(k-1-nk) + b_2 w(k-2-nk),     y = h(x)

(flexible-actuator paper). f and h are piecewise linear between knots. The block has unit gain at rest, since f and h scale it, and is
stable by construction: its poles are given by reflection coefficients between -1 and 1. Rows are equally far apart. The delay nk is given
in s and need not be whole rows: between rows, w is what lies on the straight line between them.
"""

import equinox as eqx
import jax
import jax.numpy as jnp

from smajax.hysteresis.operator import AbstractOperator


class HammersteinWiener(AbstractOperator):
    """``inlet`` and ``outlet``, shape ``(k,)`` each: values of f at ``knots``, shape ``(k,)``, and of h at k even points of 0..1.

    ``reflections``, shape ``(2,)``, give the poles; ``split`` is the share b_1 / (b_1 + b_2); ``delay`` in s; ``settled`` the share of the
    first input to which the block had settled before it.
    """

    knots: jax.Array
    inlet: jax.Array
    reflections: jax.Array
    split: jax.Array
    outlet: jax.Array
    delay: jax.Array = eqx.field(default=0.0, converter=jnp.asarray)
    settled: jax.Array = eqx.field(default=1.0, converter=jnp.asarray)

    def respond(self, time: jax.Array, values: jax.Array) -> jax.Array:
        """See ``AbstractOperator.respond``; ``time`` is equally spaced, and beyond its ends h goes on straight."""
        rest = self._inlet(self.settled * values[0])
        late = self._delayed(self._inlet(values), rest, self.delay * (len(time) - 1) / (time[-1] - time[0]))
        second = self.reflections[1]
        first = self.reflections[0] * (1.0 + second)
        driven = (1.0 + first + second) * (self.split * late + (1.0 - self.split) * jnp.append(rest, late[:-1]))

        def one(state: tuple[jax.Array, jax.Array], entering: jax.Array) -> tuple[tuple[jax.Array, jax.Array], jax.Array]:
            now, old = state
            return (entering - first * now - second * old, now), now

        _, inner = jax.lax.scan(one, (rest, rest), driven)
        return self._outlet(inner)

    def _inlet(self, value: jax.Array) -> jax.Array:
        return jnp.interp(value, self.knots, self.inlet)

    @staticmethod
    def _delayed(curve: jax.Array, before: jax.Array, rows: jax.Array) -> jax.Array:
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
