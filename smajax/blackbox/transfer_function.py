"""Linear transfer functions with a delay, in the four structures of the hip paper.

    one pole             K / (tau_1 s + 1)
    two poles            K / ((tau_1 s + 1)(tau_2 s + 1))
    underdamped          K / (tau^2 s^2 + 2 zeta tau s + 1)
    underdamped + pole   K / ((tau^2 s^2 + 2 zeta tau s + 1)(tau_1 s + 1))

each times exp(-delay s). Before its first row a recording was at rest, or in the steady state of its first input, or between the two:
``settled`` says so. The input is held between rows, which are equally far apart. Then the step from row to row is exact, and so is that
from a row to an instant before the next one, where a delay of some rows and a part of one reads the response. So the delay is a number
like the others, however few rows the lag has; at whole rows the response of one pole has a kink in it, and the derivative is that
towards longer delays.
"""

from typing import Literal

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np

from smajax.hysteresis.operator import AbstractOperator

Structure = Literal["one-pole", "two-poles", "underdamped", "underdamped-and-pole"]
STRUCTURES: tuple[Structure, ...] = ("one-pole", "two-poles", "underdamped", "underdamped-and-pole")


class TransferFunction(AbstractOperator):
    """A transfer function of one of the ``STRUCTURES``.

    ``gain`` in output per input, ``rest`` the output at no input, ``first`` and ``second`` time constants in s (of an underdamped pair the
    first is tau), ``damping`` its zeta, ``delay`` in s, ``settled`` the share of the first input to which the states had settled before it,
    0 from rest. What a structure has no use for is ignored.
    """

    gain: jax.Array
    rest: jax.Array
    first: jax.Array
    second: jax.Array
    damping: jax.Array
    delay: jax.Array
    settled: jax.Array = eqx.field(default=0.0, converter=jnp.asarray)
    structure: Structure = eqx.field(static=True, kw_only=True)

    def respond(self, time: jax.Array, values: jax.Array) -> jax.Array:
        """See ``AbstractOperator.respond``; ``time`` is equally spaced."""
        step = (time[-1] - time[0]) / (len(time) - 1)
        kept, entering = self.held(step)
        before = self.settled * values[0]
        moving = np.arange(self.order) == (1 if "underdamped" in self.structure else -1)  # a rate, which is 0 at rest
        state = jnp.where(moving, 0.0, before)

        def one(state: jax.Array, value: jax.Array) -> tuple[jax.Array, jax.Array]:
            return kept @ state + entering * value, state

        _, states = jax.lax.scan(one, state, values)
        whole = jnp.floor(self.delay / step)
        last = jnp.arange(len(values)) - whole.astype(int) - 1  # the row before the instant that is read
        kept, entering = self.held((whole + 1) * step - self.delay)
        prompt = states @ kept[0] + values * entering[0]
        return self.rest + self.gain * jnp.where(last >= 0, prompt[jnp.maximum(last, 0)], before)

    @property
    def order(self) -> int:
        """Number of states."""
        return {"one-pole": 1, "two-poles": 2, "underdamped": 2, "underdamped-and-pole": 3}[self.structure]

    def held(self, duration: jax.Array) -> tuple[jax.Array, jax.Array]:
        """What is kept of the states, shape ``(k, k)``, and what enters of an input held for ``duration`` s, shape ``(k,)``: exact."""
        rates, drive = self._equations()
        size = self.order
        whole = jnp.zeros((size + 1, size + 1)).at[:size, :size].set(rates).at[:size, size].set(drive)
        moved = jax.scipy.linalg.expm(whole * duration)
        return moved[:size, :size], moved[:size, size]

    def _equations(self) -> tuple[jax.Array, jax.Array]:
        """x' = rates x + drive u with the output x[0], of unit gain; in an underdamped pair x[1] is the rate of x[0]."""
        a, b = 1.0 / self.first, 1.0 / self.second
        nothing = jnp.zeros_like(a)
        if self.structure == "one-pole":
            return jnp.array([[-a]]), jnp.array([a])
        if self.structure == "two-poles":
            return jnp.array([[-a, a], [nothing, -b]]), jnp.array([nothing, b])
        oscillation = [[nothing, 1.0 + nothing], [-a * a, -2.0 * self.damping * a]]
        if self.structure == "underdamped":
            return jnp.array(oscillation), jnp.array([nothing, a * a])
        (p, q), (r, s) = oscillation
        return jnp.array([[p, q, nothing], [r, s, a * a], [nothing, nothing, -b]]), jnp.array([nothing, nothing, b])
