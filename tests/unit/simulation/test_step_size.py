"""The default step of a plant of which some parameters are traced."""

import dataclasses

import jax
import numpy as np
import pytest

from smajax.errors import InputError
from smajax.plant.effects import catalogue
from smajax.simulation.inputs import discretise
from tests.support import plants


def test_the_grid_is_known_where_only_an_effect_is_traced():
    plant, recording = plants.KINDS["bias_spring"](), plants.inputs("bias_spring", 10, 0.2)

    @jax.jit
    def times(strength: jax.Array) -> jax.Array:
        added = dataclasses.replace(plant, effects=(catalogue()["radiation"](strength=strength),))
        return discretise(added, recording).time

    assert np.array_equal(times(0.1), discretise(plant, recording).time)


def test_a_step_that_depends_on_traced_parameters_is_refused():
    plant, recording = plants.KINDS["bias_spring"](), plants.inputs("bias_spring", 10, 0.2)
    with pytest.raises(InputError, match="call discretise outside jit and vmap, or give step="):
        jax.jit(lambda plant: discretise(plant, recording).time)(plant)
