"""The check of an effect's class: what would do nothing without a word is refused, and the shipped effects pass."""

import dataclasses
import inspect
import textwrap

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import smajax as sma
from smajax.api.registration import register
from smajax.errors import InputError
from smajax.files.rig_file import read_rig
from smajax.parameters import parameter
from smajax.plant.effects import CAPABILITIES, catalogue
from smajax.plant.effects.base import AbstractEffect, HeatEffect, MechanismEffect, SensorEffect
from smajax.plant.effects.registry import EFFECTS, effect_problem
from smajax.recordings.datasets import data_path
from smajax.recordings.recording import Recording
from tests.support import plants

TIME = 0.1 * np.arange(20)  # s


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


def without_parameter(self, state):
    return self.strength * state.temperature


def in_another_order(self, state, context, memory):
    return self.strength * state.temperature


def optional(self, state, memory=(), context=None, scale=1.0):
    return scale * self.strength * state.temperature


@pytest.mark.parametrize(
    ("stage", "body", "sentence"),
    [
        (
            HeatEffect,
            {},
            "it does nothing, since it defines no hook of HeatEffect: define one of capacity, enthalpy, power",
        ),
        (
            HeatEffect,
            {"update_memory": lambda self, *rest: ()},
            "it does nothing, since it defines no hook of HeatEffect",
        ),
        (SensorEffect, {}, "it defines no hook of SensorEffect: define reading"),
        (HeatEffect, {"heat_power": power}, "no hook of HeatEffect (did you mean 'power'?): define one of"),
        (
            HeatEffect,
            {"powr": power},
            "it defines powr, which is not used (did you mean 'power'?): correct the name, or",
        ),
        (HeatEffect, {"power": power, "shape": ()}, "it defines shape, which is not used (did you mean 'shapes'?)"),
        (
            HeatEffect,
            {"strain": power},
            "it defines strain, a hook of MaterialEffect and not of HeatEffect: derive it from",
        ),
        (HeatEffect, {"power": 1.0}, "its power is not a method: write def power(self, state, memory, context)"),
        (
            HeatEffect,
            {"power": without_parameter},
            "its power(self, state) has other parameters than the hook: write def power(self, state, memory, context)",
        ),
        (
            HeatEffect,
            {"power": in_another_order},
            "its power(self, state, context, memory) has the parameters in another",
        ),
        (HeatEffect, {"power": power, "needs": None}, 'its needs is not a tuple: write needs = ("WORD",)'),
        (
            HeatEffect,
            {"power": power, "needs": ("one-wire",)},
            "its needs has 'one-wire', which is not a capability of rigs (did you mean 'one wire'?): name clock, one wire",
        ),
        (
            HeatEffect,
            {"power": power, "needs": "one wire"},
            'its needs is not a tuple: write needs = ("one wire",)',
        ),
        (
            HeatEffect,
            {"power": power, "confused_with": ("latent",)},
            "its confused_with has 'latent', which is not an effect (did you mean 'latent-heat'?): name an effect of",
        ),
        (
            MechanismEffect,
            {"displacement": displacement, "other_channels": ("forces",)},
            "its other_channels has 'forces', which is not a channel (did you mean 'force'?): name a channel such as",
        ),
        (
            SensorEffect,
            {"reading": displacement, "channel": "temperatur"},
            "its channel 'temperatur' is not a channel (did you mean 'temperature'?)",
        ),
    ],
)
def test_what_would_do_nothing_or_fail_later_is_refused(stage, body, sentence):
    assert sentence in problem(effect(stage, **body))


@pytest.mark.parametrize(
    ("stage", "body"),
    [
        (HeatEffect, {"power": power, "heat_power": power, "_powr": power}),
        (HeatEffect, {"power": optional}),
        (HeatEffect, {"no_mean_effect": "it scatters"}),
        (HeatEffect, {"power": power, "needs": ("one wire", "current", "temperature observed", "current_2 observed")}),
        (SensorEffect, {"reading": displacement, "channel": "temperature_2", "other_channels": ("current",)}),
    ],
)
def test_what_an_effect_may_have_is_accepted(stage, body):
    cls = effect(stage, **body)
    register("effect", "end-stop", cls)
    assert EFFECTS["end-stop"] is cls


def test_of_two_own_effects_the_second_names_the_first():
    first = effect(HeatEffect, power=power)
    second = type("Second", (effect(HeatEffect, power=power),), {"key": "second", "confused_with": ("end-stop",)})
    with pytest.raises(InputError, match="its confused_with has 'end-stop', which is not an effect"):
        register("effect", "second", second)
    register("effect", "end-stop", first)
    register("effect", "second", second)


@pytest.mark.parametrize("kind", ["dead-weight", "rotary", "bias-spring"])
def test_the_capabilities_of_a_rig_are_listed_words(kind):
    rig = read_rig(data_path("recordings", kind) / "rig.toml")
    words = rig.plant.capabilities(tuple(rig.plant.observable))
    assert words <= set(CAPABILITIES) and "clock" in words


def test_the_help_of_register_says_what_is_obligatory_and_where_an_example_is():
    text = inspect.getdoc(sma.register) or ""
    assert all(f"``{word}``" in text for word in ("strength", "key", "typical"))
    assert "``help(smajax.effects.AbstractEffect)``" in text and "complete example" in text


@pytest.mark.slow
def test_the_example_of_the_docstring_is_a_complete_effect():
    text = inspect.getdoc(AbstractEffect) or ""
    block = text.partition("::\n\n")[2].splitlines()
    end = next((i for i, line in enumerate(block) if line and not line.startswith(" ")), len(block))
    names = {"jax": jax, "sma": sma, "__name__": __name__}
    exec(textwrap.dedent("\n".join(block[:end])), names)
    leak = names["HolderLeak"]
    register("effect", "holder-leak", leak)
    plant = dataclasses.replace(plants.dead_weight(), effects=(leak(strength=1e5),))
    without, warm = (
        dataclasses.replace(plant, effects=()),
        Recording.from_arrays("warm", TIME, {"current": 0.25 + 0.0 * TIME}),
    )
    temperatures = [float(sma.simulate(p, warm).channels["temperature"][-1]) for p in (plant, without)]
    assert temperatures[0] < temperatures[1] - 0.1
    assert all(f"``{word}``" in text for word in ("strength", "key", "typical"))


@pytest.mark.slow
def test_a_positive_drag_hinders_the_contraction_by_its_force_over_the_area():
    class Pull(MechanismEffect):
        strength: jax.Array = parameter("N", "force against the contraction", 0.0, 10.0, 0.0)
        key, typical, has_drag, needs = "pull", 1.0, True, ("drag",)

        def drag(self, before, after, memory, step, context):
            return self.strength / context.wire.force_per_stress

    plant = dataclasses.replace(plants.dead_weight(), effects=(Pull(strength=0.5),))
    without, warm = (
        dataclasses.replace(plant, effects=()),
        Recording.from_arrays("warm", TIME, {"current": 0.25 + 0.0 * TIME}),
    )
    pulled, free = (sma.simulate(p, warm).channels for p in (plant, without))
    np.testing.assert_allclose(pulled["force"][1:] - free["force"][1:], 0.5, rtol=1e-9)
    assert pulled["displacement"][-1] < free["displacement"][-1]


def test_the_catalogue_lists_its_keys():
    assert repr(catalogue()).startswith("<effects: airflow-change, ambient-drift, ")
