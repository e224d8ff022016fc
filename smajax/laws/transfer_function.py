"""Linear transfer functions with a delay, in four structures.

    one pole             K / (tau_1 s + 1)
    two poles            K / ((tau_1 s + 1)(tau_2 s + 1))
    underdamped          K / (tau^2 s^2 + 2 zeta tau s + 1)
    underdamped + pole   K / ((tau^2 s^2 + 2 zeta tau s + 1)(tau_1 s + 1))

each times exp(-delay s). Before its first row a recording was at rest, in the steady state of its first input, or
between the two (``settled``). The input is held between rows, so the step from row to row is exact; where rows are
equally spaced, one matrix serves all steps. The step from a row to an instant before the next row is exact, too: a
delay of a fractional number of rows takes the response at such an instant. So the delay is a continuous parameter, even
for a lag of a few rows. At whole rows the response of one pole has a kink in the delay; the derivative there is that
towards longer delays.

Source: ali2026.
"""

from typing import Any, Literal

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from smajax.laws.base import AbstractSeriesModel
from smajax.laws.row_spacing import ROUNDING, is_evenly_spaced

Structure = Literal["one-pole", "two-poles", "underdamped", "underdamped-and-pole"]
STRUCTURES: tuple[Structure, ...] = ("one-pole", "two-poles", "underdamped", "underdamped-and-pole")


class TransferFunction(AbstractSeriesModel):
    """Transfer function of one of the ``STRUCTURES``; parameters that a structure does not use are ignored.

    Attributes:
        gain: Static gain K, output per input.
        rest: Output at zero input.
        first: Time constant tau_1, or tau of an underdamped pair, s.
        second: Time constant tau_2, or tau_1 of the pole next to an underdamped pair, s.
        damping: Damping ratio zeta of an underdamped pair.
        delay: Delay, s.
        settled: Share of the first input to which the states had settled before the recording; 0 from rest.
        structure: One of ``STRUCTURES``.
    """

    gain: jax.Array
    rest: jax.Array
    first: jax.Array
    second: jax.Array
    damping: jax.Array
    delay: jax.Array
    settled: jax.Array = eqx.field(default=0.0, converter=jnp.asarray)
    structure: Structure = eqx.field(static=True, kw_only=True)

    def response(self, time: Float[Array, " rows"], values: Float[Array, " rows"]) -> Float[Array, " rows"]:
        """Compute the outputs at all rows, equally spaced or not.

        Args:
            time: Times of the rows, s.
            values: Inputs at the rows.
        """
        if is_evenly_spaced(time, tolerance=ROUNDING):
            return self.even_response(time, values)
        before, initial = self._before(values[0])
        # One matrix after the other: a large batch of them can lock up the linear algebra of compiled programs.
        transitions, input_gains = jax.lax.map(self.zero_order_hold, jnp.diff(time))

        def advance(state: jax.Array, row: tuple[Any, ...]) -> tuple[jax.Array, jax.Array]:
            transition, input_gain, value = row
            after = transition @ state + input_gain * value
            return after, after

        _, later = jax.lax.scan(advance, initial, (transitions, input_gains, values[:-1]))
        states = jnp.concatenate([initial[None], later])
        delayed = time - self.delay
        last = jnp.searchsorted(time, delayed) - 1  # the last row before the delayed instant
        row = jnp.maximum(last, 0)
        elapsed = jnp.maximum(delayed - time[row], 0.0)  # of rows before the delay, which ``where`` leaves out
        transitions, input_gains = jax.lax.map(self.zero_order_hold, elapsed)
        undelayed = jnp.sum(states[row] * transitions[:, 0], axis=1) + values[row] * input_gains[:, 0]
        return self.rest + self.gain * jnp.where(last >= 0, undelayed, before)

    def even_response(self, time: Float[Array, " rows"], values: Float[Array, " rows"]) -> Float[Array, " rows"]:
        """Compute the outputs at rows that are equally spaced."""
        step = (time[-1] - time[0]) / (len(time) - 1)
        transition, input_gain = self.zero_order_hold(step)
        before, initial = self._before(values[0])

        def advance(state: jax.Array, value: jax.Array) -> tuple[jax.Array, jax.Array]:
            return transition @ state + input_gain * value, state

        _, states = jax.lax.scan(advance, initial, values)
        whole = jnp.floor(self.delay / step)
        last = jnp.arange(len(values)) - whole.astype(int) - 1  # the last row before the delayed instant
        transition, input_gain = self.zero_order_hold((whole + 1) * step - self.delay)
        undelayed = states @ transition[0] + values * input_gain[0]
        return self.rest + self.gain * jnp.where(last >= 0, undelayed[jnp.maximum(last, 0)], before)

    def _before(self, first: Float[Array, ""]) -> tuple[Float[Array, ""], Float[Array, " states"]]:
        """Output, without gain and rest, and states before the first row, whose input is ``first``."""
        before = self.settled * first
        # The rate of an underdamped pair, which is 0 at rest.
        is_rate = np.arange(self.order) == (1 if "underdamped" in self.structure else -1)
        return before, jnp.where(is_rate, 0.0, before)

    @property
    def order(self) -> int:
        """Number of states."""
        return {"one-pole": 1, "two-poles": 2, "underdamped": 2, "underdamped-and-pole": 3}[self.structure]

    def zero_order_hold(
        self, duration: Float[Array, ""]
    ) -> tuple[Float[Array, "states states"], Float[Array, " states"]]:
        """Compute the exact step with a constant input: x(t + duration) = transition x(t) + input_gain u.

        Args:
            duration: Duration of the step, s.

        Returns:
            Transition matrix and input gain.
        """
        rates, drive = self._equations()
        size = self.order
        augmented = jnp.zeros((size + 1, size + 1)).at[:size, :size].set(rates).at[:size, size].set(drive)
        exponential = jax.scipy.linalg.expm(augmented * duration)
        return exponential[:size, :size], exponential[:size, size]

    def _equations(self) -> tuple[jax.Array, jax.Array]:
        """x' = rates x + drive u with output x[0] and unit gain; in an underdamped pair x[1] is the rate of x[0]."""
        a, b = 1.0 / self.first, 1.0 / self.second
        zero = jnp.zeros_like(a)
        if self.structure == "one-pole":
            return jnp.array([[-a]]), jnp.array([a])
        if self.structure == "two-poles":
            return jnp.array([[-a, a], [zero, -b]]), jnp.array([zero, b])
        oscillation = [[zero, 1.0 + zero], [-a * a, -2.0 * self.damping * a]]
        if self.structure == "underdamped":
            return jnp.array(oscillation), jnp.array([zero, a * a])
        (p, q), (r, s) = oscillation
        return jnp.array([[p, q, zero], [r, s, a * a], [zero, zero, -b]]), jnp.array([zero, zero, b])
