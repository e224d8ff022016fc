"""Interface of the input-output models: hysteresis operators and black boxes alike.

A model maps the input at the rows of a recording to the output there. It is a state machine: ``init`` gives the state
at the first row, ``step`` advances it from one row to the next, and ``output`` reads it. Inputs and outputs are in the
units of the fit; the arrays of a model are its parameters.
"""

from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Float


class AbstractInputOutputModel(eqx.Module):
    """Base class of the input-output models."""

    def init(self, first: Float[Array, ""]) -> Any:
        """Return the state at the first row: at rest before it, with its input ``first`` held for ever."""
        raise NotImplementedError

    def step(self, state: Any, before: Float[Array, ""], after: Float[Array, ""], duration: Float[Array, ""]) -> Any:
        """Return the state after ``duration`` s, in which the input goes from ``before`` to ``after``."""
        raise NotImplementedError

    def output(self, state: Any, value: Float[Array, ""]) -> Float[Array, ""]:
        """Return the output at a row whose input is ``value``."""
        raise NotImplementedError

    @property
    def history_length(self) -> int:
        """Number of past outputs that the state holds."""
        raise NotImplementedError

    def with_history(self, state: Any, outputs: Float[Array, " history"]) -> Any:
        """Return the state with its past outputs replaced by ``outputs``, newest first."""
        raise NotImplementedError

    def predict_ahead(
        self,
        time: Float[Array, " rows"],
        values: Float[Array, " rows"],
        measured: Float[Array, " rows"],
        every: jax.Array,
    ) -> Float[Array, " rows"]:
        """Return predictions that restart from the measured outputs every ``every`` rows.

        Args:
            time: Times of the rows, s. values: Inputs. measured: Measured outputs. every: Rows between restarts. 1 is
            open loop, the one-step-ahead prediction of each row; the number of rows is closed loop
                from the measured first row.
        """
        numbers = jnp.arange(1, len(values))
        past = measured[jnp.maximum(numbers[:, None] - 1 - jnp.arange(self.history_length)[None, :], 0)]

        def advance(state: Any, row: tuple) -> tuple[Any, jax.Array]:
            number, history, before, after, duration = row
            restarts = (number - 1) % every == 0
            state = jax.tree.map(lambda a, b: jnp.where(restarts, a, b), self.with_history(state, history), state)
            state = self.step(state, before, after, duration)
            return state, self.output(state, after)

        rows = (numbers, past, values[:-1], values[1:], jnp.diff(time))
        _, predicted = jax.lax.scan(advance, self.init(values[0]), rows)
        return jnp.append(measured[:1], predicted)

    def response(self, time: Float[Array, " rows"], values: Float[Array, " rows"]) -> Float[Array, " rows"]:
        """Return the outputs at all rows for the inputs ``values``."""

        def advance(state: Any, row: tuple) -> tuple[Any, jax.Array]:
            before, after, duration = row
            state = self.step(state, before, after, duration)
            return state, self.output(state, after)

        first = self.init(values[0])
        _, outputs = jax.lax.scan(advance, first, (values[:-1], values[1:], jnp.diff(time)))
        return jnp.append(self.output(first, values[0]), outputs)
