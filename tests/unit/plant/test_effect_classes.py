"""The check of an effect's class: what would do nothing without a word is refused, and the shipped effects pass."""

import jax
import jax.numpy as jnp
import pytest

from smajax.api.registration import register
from smajax.errors import InputError
from smajax.parameters import parameter
from smajax.plant.effects.base import AbstractEffect, HeatEffect, MechanismEffect
from smajax.plant.effects.registry import EFFECTS, effect_problem


@pytest.fixture(autouse=True)
def registered(monkeypatch):
    """The registry is as before after each test."""
    monkeypatch.setattr(EFFECTS, "_added", {})


def effect(stage: type[AbstractEffect], **body) -> type[AbstractEffect]:
    """A class with what every effect must have, and further names in its body."""
    strength = parameter("1", "strength", 0.0, 1.0, 0.0)
    start = {"__module__": __name__, "__annotations__": {"strength": jax.Array}, "strength": strength}
    return type("EndStop", (stage,), start | {"key": "end-stop", "typical": 0.5} | body)


def drag(self, before, after, memory, step, context):
    return self.strength * jnp.ones(())


def displacement(self, motion, channels, time):
    return self.strength * motion


def power(self, state, memory, context):
    return -self.strength * state.temperature


def problem(cls: type[AbstractEffect]) -> str:
    """The sentence with which the class is refused."""
    with pytest.raises(InputError) as caught:
        register("effect", "end-stop", cls)
    assert "end-stop" not in EFFECTS
    return str(caught.value)


@pytest.mark.parametrize("key", sorted(EFFECTS.loaded))
def test_the_shipped_effects_pass(key):
    assert not effect_problem(key, EFFECTS[key])


def test_a_drag_without_its_flag_is_refused():
    sentence = (
        "EndStop cannot be used: it defines drag, which is called only with has_drag: write has_drag = True in the body"
    )
    assert sentence in problem(effect(MechanismEffect, drag=drag, needs=("drag",)))
    register("effect", "end-stop", effect(MechanismEffect, drag=drag, needs=("drag",), has_drag=True))


def test_the_flag_of_a_drag_without_a_drag_is_refused():
    cls = effect(MechanismEffect, displacement=displacement, needs=("drag",), has_drag=True)
    assert "it has has_drag = True and no drag: define drag, or leave has_drag out" in problem(cls)


def test_a_drag_needs_a_rig_that_can_have_one():
    text = problem(effect(MechanismEffect, drag=drag, has_drag=True))
    assert 'it has a drag, which not every rig can have: write needs = ("drag",) in the body of the class' in text


def test_other_channels_without_a_hook_that_uses_them_are_refused():
    text = problem(effect(HeatEffect, power=power, other_channels=("force",)))
    assert "it has other_channels, which only displacement and reading use: leave other_channels out" in text
    register("effect", "end-stop", effect(MechanismEffect, displacement=displacement, other_channels=("force",)))
