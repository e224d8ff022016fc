"""Interface of the input-output models, for hysteresis operators and for black boxes.

A model maps the inputs at the rows of a recording to the outputs there. It is a state machine: ``init`` gives the state
at the first row, ``step`` advances it from one row to the next, and ``output`` computes the output from it. Inputs and
outputs are in the units of the fit; the arrays of a model are its parameters.

Models in discrete time need equally spaced rows. ``response`` refuses others; ``even_response`` does not look at the
times and is for rows that were checked before, as in a fit.
"""

import abc
from typing import Any, ClassVar

import jax
import jax.numpy as jnp
from jaxtyping import Array, Float, Int

from smajax.laws.row_spacing import refuse_uneven_rows
from smajax.parameters import CheckedModule


class AbstractInputOutputModel(CheckedModule):
    """Base class of the input-output models.

    Attributes:
        needs_even_rows: Whether the model is in discrete time, so that its rows have to be equally spaced.
    """

    needs_even_rows: ClassVar[bool] = False

    @abc.abstractmethod
    def init(self, first: Float[Array, ""]) -> Any:
        """Return the state at the first row, whose input is taken to have been held before it.

        Args:
            first: Input at the first row.

        Returns:
            The state, a pytree.
        """

    @abc.abstractmethod
    def step(self, state: Any, before: Float[Array, ""], after: Float[Array, ""], duration: Float[Array, ""]) -> Any:
        """Advance the state from one row to the next.

        Args:
            state: State at the first of the two rows.
            before: Input there.
            after: Input at the next row.
            duration: Time between the rows, s.

        Returns:
            The state at the next row.
        """

    @abc.abstractmethod
    def output(self, state: Any, value: Float[Array, ""]) -> Float[Array, ""]:
        """Compute the output at a row.

        Args:
            state: State at the row.
            value: Input at the row.
        """

    @property
    def history_length(self) -> int:
        """Number of past outputs that the state holds; by default none."""
        return 0

    def with_history(self, state: Any, outputs: Float[Array, " history"]) -> Any:
        """Return the state with its past outputs replaced; by default it holds none, and is unchanged.

        Args:
            state: The state.
            outputs: Past outputs, newest first, shape ``(history_length,)``.
        """
        return state

    def predict_ahead(
        self,
        time: Float[Array, " rows"],
        values: Float[Array, " rows"],
        measured: Float[Array, " rows"],
        every: Int[Array, ""],
        *,
        evenly_spaced: bool = False,
    ) -> Float[Array, " rows"]:
        """Predict the outputs, restarting from the measured outputs every few rows.

        Args:
            time: Times of the rows, s.
            values: Inputs at the rows.
            measured: Measured outputs at the rows.
            every: Number of rows between restarts. 1 gives the one-step-ahead prediction of each row (open loop); the
                number of rows gives the simulation from the measured first row (closed loop).
            evenly_spaced: Whether the rows are known to be equally spaced, as in a fit, which checks them.

        Returns:
            Predicted outputs at the rows; the first one is the measured output.

        Raises:
            InputError: The model is in discrete time, and the rows are not equally spaced.
        """
        if self.needs_even_rows and not evenly_spaced:
            values = refuse_uneven_rows(time, values, type(self).__name__)
        numbers = jnp.arange(1, len(values))
        past = measured[jnp.maximum(numbers[:, None] - 1 - jnp.arange(self.history_length)[None, :], 0)]

        def advance(state: Any, row: tuple[Any, ...]) -> tuple[Any, jax.Array]:
            number, history, before, after, duration = row
            restarts = (number - 1) % every == 0
            state = jax.tree.map(lambda a, b: jnp.where(restarts, a, b), self.with_history(state, history), state)
            state = self.step(state, before, after, duration)
            return state, self.output(state, after)

        rows = (numbers, past, values[:-1], values[1:], jnp.diff(time))
        _, predicted = jax.lax.scan(advance, self.init(values[0]), rows)
        return jnp.append(measured[:1], predicted)

    def response(self, time: Float[Array, " rows"], values: Float[Array, " rows"]) -> Float[Array, " rows"]:
        """Compute the outputs at all rows.

        Args:
            time: Times of the rows, s.
            values: Inputs at the rows.

        Raises:
            InputError: The model is in discrete time, and the rows are not equally spaced. Under ``jax.jit``, where the
                times are not known, the outputs are NaN instead.
        """
        if self.needs_even_rows:
            values = refuse_uneven_rows(time, values, type(self).__name__)
        return self.even_response(time, values)

    def even_response(self, time: Float[Array, " rows"], values: Float[Array, " rows"]) -> Float[Array, " rows"]:
        """Compute the outputs at all rows, whose times are not checked.

        Args:
            time: Times of the rows, s.
            values: Inputs at the rows.
        """

        def advance(state: Any, row: tuple[Any, ...]) -> tuple[Any, jax.Array]:
            before, after, duration = row
            state = self.step(state, before, after, duration)
            return state, self.output(state, after)

        first = self.init(values[0])
        _, outputs = jax.lax.scan(advance, first, (values[:-1], values[1:], jnp.diff(time)))
        return jnp.append(self.output(first, values[0]), outputs)


class AbstractSeriesModel(AbstractInputOutputModel):
    """Base class of the models that compute all rows at once (``compute_response``), and cannot take single steps."""

    def init(self, first: Float[Array, ""]) -> Any:
        """Refuse to start.

        Raises:
            TypeError: Always.
        """
        raise TypeError(self._without_steps())

    def step(self, state: Any, before: Float[Array, ""], after: Float[Array, ""], duration: Float[Array, ""]) -> Any:
        """Refuse to take a step.

        Raises:
            TypeError: Always.
        """
        raise TypeError(self._without_steps())

    def output(self, state: Any, value: Float[Array, ""]) -> Float[Array, ""]:
        """Refuse to compute a single output.

        Raises:
            TypeError: Always.
        """
        raise TypeError(self._without_steps())

    def _without_steps(self) -> str:
        return f"{type(self).__name__} has no steps: compute all rows with smajax.laws.response.compute_response"
