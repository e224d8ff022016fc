"""NARX network: the next output from past outputs and inputs, by two layers.

    y(k) = b + v . y_past + c . tanh(W [y_past, u_past] + d),     y_past = y(k-1)..y(k-n),  u_past = u(k-1)..u(k-n)

With the linear term v a small network can start as a linear model. Within the network, outputs and inputs are scaled to
a size of about 1. In *open loop* it predicts one row ahead from measured outputs; in *closed loop* (``response``) from
its own outputs. ``predict_ahead`` lies between the two: it restarts from measured outputs every few rows. A fit that
increases this interval from 1 row to all rows finds a network that does not diverge on the training recording. To avoid
divergence on other inputs, the weights have to be small: a ridge penalty keeps them so, chosen by cross-validation on
the training recordings (``smajax.fitting.io_models.networks``).

Source: copaci2020, equation 10.
"""

from typing import Any, ClassVar

import jax
import jax.numpy as jnp
from jaxtyping import Array, Float

from smajax.laws.base import AbstractInputOutputModel
from smajax.numerics.nonsmooth import clip

# Bound of the scaled output, in halves of the range of the outputs, that stops a diverging closed loop. Chosen by
# trial; tests/unit/laws/test_input_output_models.py holds it.
_OUTPUT_BOUND = 3.0


class Narx(AbstractInputOutputModel):
    """NARX network with ``m`` neurons and ``n`` past rows.

    Attributes:
        hidden: Weights W of the hidden layer, shape ``(m, 2 n)``.
        shift: Biases d of the hidden layer, shape ``(m,)``.
        outer: Weights c of the output layer, shape ``(m,)``.
        straight: Weights v of the linear term, shape ``(n,)``.
        constant: Bias b of the output.
        rest: Output before the first row.
        scale: Middle and size of the input, and middle and size of the output, shape ``(4,)``.
    """

    needs_even_rows: ClassVar[bool] = True
    hidden: jax.Array
    shift: jax.Array
    outer: jax.Array
    straight: jax.Array
    constant: jax.Array
    rest: jax.Array
    scale: jax.Array

    def init(self, first: Float[Array, ""]) -> tuple[jax.Array, jax.Array]:
        """Return past outputs and inputs, scaled, newest first, shape ``(n,)`` each."""
        past = jnp.ones_like(self.straight)
        return self.with_history(((), past * self._scaled_input(first)), past * self.rest)

    def step(
        self, state: tuple[Any, ...], before: Float[Array, ""], after: Float[Array, ""], duration: Float[Array, ""]
    ) -> tuple[jax.Array, jax.Array]:
        """Return past outputs and inputs at the next row."""
        outputs, inputs = state
        inputs = jnp.append(self._scaled_input(before), inputs[:-1])
        new = clip(self._next_output(outputs, inputs), -_OUTPUT_BOUND, _OUTPUT_BOUND)
        return jnp.append(new, outputs[:-1]), inputs

    def output(self, state: tuple[Any, ...], value: Float[Array, ""]) -> Float[Array, ""]:
        """Return the newest output."""
        return self.scale[2] + self.scale[3] * state[0][0]

    @property
    def history_length(self) -> int:
        """Number n of past outputs that the state holds."""
        return len(self.straight)

    def with_history(self, state: tuple[Any, ...], outputs: Float[Array, " history"]) -> tuple[jax.Array, jax.Array]:
        """Return the state with its past outputs replaced by ``outputs``, newest first."""
        return (outputs - self.scale[2]) / self.scale[3], state[1]

    def _next_output(self, outputs: jax.Array, inputs: jax.Array) -> jax.Array:
        past = jnp.concatenate([outputs, inputs])
        # Sums instead of matrix products: the matrices are too small for the overhead of a call in every row.
        inner = jnp.tanh(jnp.sum(self.hidden * past[None, :], axis=1) + self.shift)
        return self.constant + jnp.sum(self.straight * outputs) + jnp.sum(self.outer * inner)

    def _scaled_input(self, value: jax.Array) -> jax.Array:
        return (value - self.scale[0]) / self.scale[1]
