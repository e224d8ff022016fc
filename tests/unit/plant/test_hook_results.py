"""A hook that returns another shape or type is named, with its effect, before JAX fails in the equations."""

import dataclasses

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from smajax.errors import InputError
from smajax.parameters import parameter
from smajax.plant.effects.base import (
    AbstractEffect,
    DriveEffect,
    HeatEffect,
    MaterialEffect,
    MechanismEffect,
    SensorEffect,
)
from smajax.recordings.recording import Recording
from smajax.simulation.run import simulate
from tests.support import plants

THREE = jnp.zeros(3)
CURRENT = Recording.from_arrays("constant", 0.1 * np.arange(4), {"current": np.full(4, 0.2)})


def effect(stage: type[AbstractEffect], **body) -> AbstractEffect:
    """An effect that is present, with hooks that are written without types as those of a user."""
    strength = parameter("1", "strength", 0.0, 1.0, 0.5)
    start = {"__module__": __name__, "__annotations__": {"strength": jax.Array}, "strength": strength}
    return type("BadShape", (stage,), start | {"key": "bad-shape", "typical": 0.5} | body)()


@pytest.mark.slow
@pytest.mark.parametrize(
    ("stage", "body", "sentence"),
    [
        (HeatEffect, {"power": lambda *a: THREE}, "power returned shape (3,), expected () or (1,) = (wires,)"),
        (HeatEffect, {"power": lambda *a: None}, "power returned a NoneType, expected () or (1,) = (wires,)"),
        (HeatEffect, {"capacity": lambda *a: THREE}, "capacity returned shape (3,)"),
        (HeatEffect, {"enthalpy": lambda *a: THREE}, "enthalpy returned shape (3,)"),
        (DriveEffect, {"signal": lambda *a: THREE}, "signal returned shape (3,)"),
        (DriveEffect, {"voltage": lambda *a: THREE}, "voltage returned shape (3,)"),
        (MaterialEffect, {"strain": lambda *a: THREE}, "strain returned shape (3,)"),
        (MaterialEffect, {"shift": lambda *a: THREE}, "shift returned shape (3,)"),
        (MaterialEffect, {"resistivity": lambda *a: THREE}, "resistivity returned shape (3,)"),
        (
            MaterialEffect,
            {"modify_material": lambda *a: 1.0},
            "modify_material returned shape (), expected AbstractMaterial",
        ),
        (
            MaterialEffect,
            {"modify_fractions": lambda *a: 1.0},
            "modify_fractions returned shape (), expected Fractions",
        ),
        (
            MaterialEffect,
            {"modify_fractions": lambda self, before, after: after._replace(twinned=THREE)},
            "modify_fractions returned shape (3,), expected () or (1,) = (wires,)",
        ),
        (MechanismEffect, {"has_drag": True, "drag": lambda *a: jnp.zeros(1)}, "drag returned shape (1,), expected ()"),
        (
            MechanismEffect,
            {"displacement": lambda *a: THREE},
            "displacement returned shape (3,), expected () or (4,) = (rows,)",
        ),
        (SensorEffect, {"reading": lambda *a: THREE}, "reading returned shape (3,), expected () or (4,) = (rows,)"),
        (
            HeatEffect,
            {"update_memory": lambda *a: jnp.zeros(1)},
            "update_memory returned shape (1,) and the memory before is an empty tuple: initial_memory and this hook have to",
        ),
        (
            HeatEffect,
            {"initial_memory": lambda *a: (0.0, jnp.zeros(1)), "begin_step": lambda *a: 0.0},
            "begin_step returned shape () and the memory before is a tuple of shape (), shape (1,): initial_memory and",
        ),
    ],
)
def test_a_wrong_result_is_named_with_effect_and_hook(stage, body, sentence):
    plant = dataclasses.replace(plants.dead_weight(), effects=(effect(stage, **body),))
    with pytest.raises(InputError) as caught:
        simulate(plant, CURRENT)
    assert str(caught.value).startswith(f"effect 'bad-shape': {sentence}")


@pytest.mark.slow
def test_a_scalar_result_counts_for_all_wires():
    plant = dataclasses.replace(plants.dead_weight(), effects=(effect(HeatEffect, power=lambda *a: 0.0),))
    without = dataclasses.replace(plant, effects=())
    for channel in ("temperature", "displacement"):
        np.testing.assert_allclose(
            simulate(plant, CURRENT).channels[channel], simulate(without, CURRENT).channels[channel], rtol=1e-12
        )
