"""What every input-output law answers: hysteresis operators and black boxes alike.

A law reads the input at the rows of a recording and gives the output there. It is a state machine: ``advance`` takes its state from one row
to the next, and ``output`` reads it. Inputs and outputs are in whatever units the user fits in; the arrays of a law are its parameters.
"""

from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp


class AbstractOperator(eqx.Module):
    """Base class of the input-output laws."""

    def start(self, first: jax.Array) -> Any:
        """The state at the first row, whose input is ``first``: as if it had been there for ever, coming from rest."""
        raise NotImplementedError

    def advance(self, state: Any, before: jax.Array, after: jax.Array, step: jax.Array) -> Any:
        """The state ``step`` s on, the input going from ``before`` to ``after``, scalars."""
        raise NotImplementedError

    def output(self, state: Any, value: jax.Array) -> jax.Array:
        """The output at a row whose input is ``value``; scalar."""
        raise NotImplementedError

    @property
    def remembered(self) -> int:
        """How many past outputs the state holds."""
        raise NotImplementedError

    def told(self, state: Any, past: jax.Array) -> Any:
        """The state with past outputs, newest first, shape ``(remembered,)``, in place of its own."""
        raise NotImplementedError

    def ahead(self, time: jax.Array, values: jax.Array, measured: jax.Array, every: jax.Array) -> jax.Array:
        """Outputs at all rows, shape ``(n,)``, where the law is told the measured ones every so many rows.

        1 is open loop: each row from the measured rows before it. ``n`` is closed loop from the measured first row.
        """
        numbers = jnp.arange(1, len(values))
        past = measured[jnp.maximum(numbers[:, None] - 1 - jnp.arange(self.remembered)[None, :], 0)]

        def one(state: Any, row: tuple) -> tuple[Any, jax.Array]:
            number, known, before, after, step = row
            now = (number - 1) % every == 0
            state = jax.tree.map(lambda a, b: jnp.where(now, a, b), self.told(state, known), state)
            state = self.advance(state, before, after, step)
            return state, self.output(state, after)

        rows = (numbers, past, values[:-1], values[1:], jnp.diff(time))
        _, found = jax.lax.scan(one, self.start(values[0]), rows)
        return jnp.append(measured[:1], found)

    def respond(self, time: jax.Array, values: jax.Array) -> jax.Array:
        """Outputs at all rows, shape ``(n,)``, for inputs of that shape."""

        def one(state: Any, row: tuple) -> tuple[Any, jax.Array]:
            before, after, step = row
            state = self.advance(state, before, after, step)
            return state, self.output(state, after)

        first = self.start(values[0])
        _, rest = jax.lax.scan(one, first, (values[:-1], values[1:], jnp.diff(time)))
        return jnp.append(self.output(first, values[0]), rest)
