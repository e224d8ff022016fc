"""The program of a diagnosis: the plant with every effect that its rig could have, those of the rig file as they are, all others at 0.

A vector holds the rig's free parameters, then ``SLOTS`` slots; which effect's strength or shape a slot moves is data (a matrix), so that no
hypothesis needs a compilation of its own.
"""

import dataclasses

import equinox as eqx
import jax

from smajax import parameters
from smajax.diagnose import freeform
from smajax.fit.problem import Problem

SLOTS = 6


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

    def residual(self, vector: jax.Array) -> jax.Array:
        """Model minus measurement over the noise, shape ``(r * c * n,)``."""
        base = len(self.problem.unknowns)
        values = self.fixed + self.moved @ vector[base:]
        plant = parameters.replace(self.problem.plant, {name: values[i] for i, name in enumerate(self.names)})
        plant = freeform.put(plant, values[len(self.names) :].reshape(len(freeform.KINDS), freeform.KNOTS), *self.free)
        return dataclasses.replace(self.problem, plant=plant).residual(vector[:base])


def residual(vector: jax.Array, model: Model) -> jax.Array:
    """``Model.residual`` as a search calls it."""
    return model.residual(vector)
