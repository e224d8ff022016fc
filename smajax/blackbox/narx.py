"""The NARX network: the next output from the last outputs and inputs, by two layers.

    y(k) = b + v . y_past + c . tanh( W [y_past, u_past] + d ),     y_past = y(k-1)..y(k-n),  u_past = u(k-1)..u(k-n)

(flexible-actuator paper eq. 10). The straight term v lets a small network begin as a linear model. Outputs and inputs are scaled to a size
of about one inside. *Open loop* it predicts one row ahead from measured outputs; *closed loop*, which is what ``respond`` does, it feeds on
its own. In between, ``ahead`` lets it run so many rows on its own before it is told again: a fit that goes from 1 row to all of them finds
a network that does not run away on what it was fitted to. That it does not run away on another input either is a matter of small weights: a
ridge holds them, chosen by rows of the training recordings that the fit under it does not see (``smajax.fit.networks``).
"""

import jax
import jax.numpy as jnp

from smajax.hysteresis.operator import AbstractOperator
from smajax.kinks import within

_FAR = 3.0  # times half the range of the outputs: where closed loop ends that runs away


class Narx(AbstractOperator):
    """``hidden`` W, shape ``(m, 2 n)``, ``shift`` d and ``outer`` c, shape ``(m,)``, ``straight`` v, shape ``(n,)``, ``constant`` b.

    ``scale`` holds middle and size of the input and of the output, shape ``(4,)``; ``rest`` is the output before the first row.
    """

    hidden: jax.Array
    shift: jax.Array
    outer: jax.Array
    straight: jax.Array
    constant: jax.Array
    rest: jax.Array
    scale: jax.Array

    def start(self, first: jax.Array) -> tuple[jax.Array, jax.Array]:
        """See ``AbstractOperator.start``: past outputs and inputs, scaled, newest first, shape ``(n,)`` each."""
        past = jnp.ones_like(self.straight)
        return self.told(((), past * self._entering(first)), past * self.rest)

    def advance(self, state: tuple, before: jax.Array, after: jax.Array, step: jax.Array) -> tuple[jax.Array, jax.Array]:
        """See ``AbstractOperator.advance``."""
        outputs, inputs = state
        inputs = jnp.append(self._entering(before), inputs[:-1])
        new = within(self._next(outputs, inputs), -_FAR, _FAR)
        return jnp.append(new, outputs[:-1]), inputs

    def output(self, state: tuple, value: jax.Array) -> jax.Array:
        """See ``AbstractOperator.output``."""
        return self.scale[2] + self.scale[3] * state[0][0]

    @property
    def remembered(self) -> int:
        """See ``AbstractOperator.remembered``."""
        return len(self.straight)

    def told(self, state: tuple, past: jax.Array) -> tuple[jax.Array, jax.Array]:
        """See ``AbstractOperator.told``."""
        return (past - self.scale[2]) / self.scale[3], state[1]

    def _next(self, outputs: jax.Array, inputs: jax.Array) -> jax.Array:
        seen = jnp.concatenate([outputs, inputs])
        # Sums instead of products of matrices: these are too small for what calling one costs in every row.
        inner = jnp.tanh(jnp.sum(self.hidden * seen[None, :], axis=1) + self.shift)
        return self.constant + jnp.sum(self.straight * outputs) + jnp.sum(self.outer * inner)

    def _entering(self, value: jax.Array) -> jax.Array:
        return (value - self.scale[0]) / self.scale[1]
