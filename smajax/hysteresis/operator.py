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

    def respond(self, time: jax.Array, values: jax.Array) -> jax.Array:
        """Outputs at all rows, shape ``(n,)``, for inputs of that shape."""

        def one(state: Any, row: tuple) -> tuple[Any, jax.Array]:
            before, after, step = row
            state = self.advance(state, before, after, step)
            return state, self.output(state, after)

        first = self.start(values[0])
        _, rest = jax.lax.scan(one, first, (values[:-1], values[1:], jnp.diff(time)))
        return jnp.append(self.output(first, values[0]), rest)
