"""The program of a diagnosis: the plant with every effect that its rig could have, those of the rig file as they are, all others at 0.

A vector holds the rig's free parameters, then ``SLOTS`` slots; which effect's strength or shape a slot moves is data (a matrix), so that no
hypothesis needs a compilation of its own. Simulation and derivatives are two programs, which compile side by side; the second one is asked
only where the first has led to something better.
"""

import dataclasses
import threading
from collections.abc import Callable
from typing import NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np

from smajax import parameters
from smajax.diagnose import freeform
from smajax.fit.least_squares import LARGE, Search
from smajax.fit.problem import Problem
from smajax.simulate import Track

SLOTS = 6


class Simulated(NamedTuple):
    """Where the plant goes in each recording, and the residual."""

    track: Track
    residual: jax.Array


class Model(eqx.Module):
    """What the compiled program takes beside the vector: a part's problem, the effects' parameters, and what the slots move.

    ``fixed``, shape ``(n,)``, and ``moved``, shape ``(n, SLOTS)``, hold the named parameters and then the knots of the free terms, which
    are functions of ``free``: what they stand against, its low and its high, each of shape ``(len(freeform.AGAINST),)``.
    """

    problem: Problem
    fixed: jax.Array
    moved: jax.Array
    free: tuple[jax.Array, jax.Array, jax.Array]
    names: tuple[str, ...] = eqx.field(static=True)

    def residual(self, vector: jax.Array, known: Track) -> jax.Array:
        """Model minus measurement over the noise, shape ``(r * c * n,)``; ``known`` is what ``track`` gives at this vector."""
        problem, base = self._filled(vector)
        return problem.residual(base, known)

    def track(self, vector: jax.Array) -> Track:
        """Where the plant goes in each recording."""
        problem, base = self._filled(vector)
        return problem.track(base)

    def blank_track(self, vector: jax.Array) -> Track:
        """A track of the right shapes that leads nowhere."""
        problem, base = self._filled(vector)
        return problem.blank_track(base)

    def _filled(self, vector: jax.Array) -> tuple[Problem, jax.Array]:
        """The problem with what the slots hold put into its plant, and the vector without the slots."""
        base = len(self.problem.unknowns)
        values = self.fixed + self.moved @ vector[base:]
        plant = parameters.replace(self.problem.plant, {name: values[i] for i, name in enumerate(self.names)})
        plant = freeform.put(plant, values[len(self.names) :].reshape(len(freeform.KINDS), freeform.KNOTS), *self.free)
        return dataclasses.replace(self.problem, plant=plant), vector[:base]


def residual(vector: jax.Array, args: tuple[Model, Simulated]) -> jax.Array:
    """``Model.residual`` as a search calls it."""
    model, simulated = args
    return model.residual(vector, simulated.track)


def _simulated(vector: jax.Array, model: Model) -> Simulated:
    track = model.track(vector)
    return Simulated(track, model.residual(vector, track))


# Where the plant goes, and what that leaves: all that a look needs that asks for no derivatives.
simulated: Callable[[jax.Array, Model], Simulated] = eqx.filter_jit(_simulated, compiler_options=LARGE)  # pyright: ignore[reportCallIssue]


def begin_search(
    model: Model,
    start: np.ndarray,
    lower: np.ndarray,
    upper: np.ndarray,
    rtol: float = 1e-7,
    ahead: Callable[[jax.Array, Model], Simulated] = simulated,
) -> Search:
    """A search for the vector from ``start``, within bounds of its shape; ``ahead`` simulates before each step."""
    return Search(residual, model, start[None], lower, upper, size=model.problem.size, rtol=rtol, ahead=ahead)


def compiling(model: Model, vector: np.ndarray) -> list[threading.Thread]:
    """Sets off the compiling of both programs, which is done when the threads have ended.

    Tracing keeps Python busy, compiling does not: what takes longer to compile is traced first, before this function returns.
    """
    at, free = jnp.asarray(vector), np.full(len(vector), np.inf)
    nowhere = Simulated(model.blank_track(at), jnp.zeros(model.problem.size))
    slopes = begin_search(model, vector, -free, free, ahead=lambda *_: nowhere)
    slopes.trace()
    threads = [threading.Thread(target=task, daemon=True) for task in ((lambda: slopes.advance(1)), (lambda: simulated(at, model)))]
    for thread in threads:
        thread.start()
    return threads
