"""Registry of controllers, and what base classes say of incomplete subclasses."""

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest

from smajax.control.controllers import PID, AbstractController, controller_class, register_controller
from smajax.control.controllers.adaptive_pid import AdaptivePID
from smajax.control.estimators import AbstractTemperatureEstimator
from smajax.control.export.c_header import c_header
from smajax.control.export.fmu.controller_model import controller_model
from smajax.control.export.json_document import controller_document
from smajax.control.loop.allocation import Allocation
from smajax.control.loop.gains import gains, with_gains
from smajax.control.sampled_plant import AbstractSampledSystem
from smajax.control.sensors import AbstractSensor, Instruments
from smajax.errors import InputError
from smajax.parameters import parameter
from tests.unit.control.test_control import pid


class Plain(AbstractController):
    """Proportional controller."""

    kp: jax.Array = parameter("u/y", "proportional gain", 0.0)
    lower: jax.Array = parameter("u", "least output", default=0.0)
    upper: jax.Array = parameter("u", "largest output", default=1.0)
    period: float = eqx.field(static=True, kw_only=True)

    def reset(self, reference, value):
        return jnp.zeros(())

    def step(self, state, reference, value):
        return state, jnp.clip(self.kp * (reference - value), self.lower, self.upper)


def test_a_registered_class_is_found_by_its_name():
    register_controller("plain-p", Plain)
    register_controller("plain-p", Plain)  # as when a notebook's cell runs again
    assert controller_class("plain-p") is Plain and controller_class("pid") is PID
    with pytest.raises(InputError, match="there is no controller 'plain-q' .did you mean 'plain-p'"):
        controller_class("plain-q")


@pytest.mark.parametrize(
    ("name", "cls", "sentence"),
    [
        (
            "pid",
            Plain,
            "controller 'pid': the name is taken by smajax.control.controllers.pid.PID: choose another name",
        ),
        ("My Controller", Plain, "controller 'My Controller': the name is not in small letters with hyphens"),
        ("number", 3, "3 is not a class: give the class itself"),
        ("a-dict", dict, "dict is not of this kind: derive it from"),
        (
            "abstract",
            AbstractController,
            "define 'lower', 'period', 'upper' in the body of the class; define the methods",
        ),
        (
            "an-instance",
            Plain(1.0, period=0.1),
            r"controller 'an-instance': Plain\(.* is not a class: give the class itself",
        ),
    ],
)
def test_what_cannot_be_registered(name, cls, sentence):
    with pytest.raises(InputError, match=sentence):
        register_controller(name, cls)


@pytest.mark.parametrize(
    ("base", "sentence"),
    [
        (
            AbstractController,
            "the methods 'reset' (return the state of a controller whose .*), 'step' (take one sample)",
        ),
        (
            AbstractTemperatureEstimator,
            "'apply_command' (.*), 'init' (.*), 'update' (take the measurements of one sample)",
        ),
        (
            AbstractSampledSystem,
            "'observe' (.*), 'step' (take one period), 'wires' (number of commands), 'with_param.*",
        ),
        (AbstractSensor, "the methods 'reset' (return the state of a sensor .*), 'step' (take one sample)"),
    ],
)
def test_an_incomplete_subclass_says_what_is_missing(base, sentence):
    class Incomplete(base):
        def start(self):
            return None

    pattern = sentence.replace("(", "[(]").replace(")", "[)]")
    with pytest.raises(TypeError, match=f"^Incomplete cannot be constructed: define .*{pattern}$"):
        Incomplete()


@pytest.mark.parametrize(
    ("build", "sentence"),
    [
        (
            lambda: PID(kp=-1.0, period=0.1),
            "PID.kp: -1 is not possible for the proportional gain: give a value at least 0",
        ),
        (
            lambda: with_gains(pid(), {"ki": -2.0}),
            "ki: -2 is not possible for the integral gain: give a value at least 0",
        ),
        (lambda: PID(kp=np.nan, period=0.1), "PID.kp: nan is not possible for the proportional gain"),
        (lambda: Instruments({}, 0.1, lag=-1.0), "Instruments.lag: -1000 ms is not possible for the time constant"),
        (lambda: Allocation(jnp.asarray(1.0), -0.1, 2), "Allocation.co_contraction: -0.1 is not possible"),
        (lambda: Plain(kp=-1.0, period=0.1), "Plain.kp: -1 is not possible"),
    ],
)
def test_numbers_outside_of_their_bounds_are_refused(build, sentence):
    with pytest.raises(InputError, match=f"^{sentence}"):
        build()


def test_two_gains_of_one_name_are_refused():
    class Cascade(Plain):
        inner: PID = None  # pyright: ignore[reportAssignmentType]

    cascade = Cascade(jnp.asarray(1.0), inner=pid(), period=0.1)
    with pytest.raises(InputError, match="two parts of the Cascade declare the gain 'kp': rename one of them"):
        gains(cascade)


@pytest.mark.parametrize("law", ["printed", "gradient"])
def test_a_gain_that_starts_at_zero_cannot_adapt(law):
    rates = (0.01, 0.0, 0.03)
    with pytest.raises(InputError, match="kd starts at 0 and has the adaptation rate rate_d.*give kd a value above 0"):
        AdaptivePID(pid(kd=0.0), *map(jnp.asarray, rates), law=law)
    complete = AdaptivePID(pid(), *map(jnp.asarray, rates), law=law)
    with pytest.raises(InputError, match="kp starts at 0"):
        with_gains(complete, {"kp": 0.0}).check_gains()


@pytest.mark.parametrize(
    ("value", "shown"),
    [(object(), "an object of type object"), (3, "an object of type int"), (Plain, "the class Plain")],
)
def test_what_is_no_controller_is_refused_in_one_sentence(value, shown):
    message = f"^{shown} is no controller: give an instance of a class derived from AbstractController"
    exports = (
        lambda: controller_document(value, {}),
        lambda: c_header(value, ("A", "m"), "0"),
        lambda: controller_model(value, ("A", "m"), {}, "loop"),
    )
    for export in exports:
        with pytest.raises(InputError, match=message):
            export()
    with pytest.raises(InputError, match=r"needs its channel: give a ClosedLoop\(controller, channel="):
        controller_model(Plain(kp=1.0, period=0.1), ("A", "m"), {}, "loop")


def test_the_document_of_an_own_controller_that_is_not_registered_has_the_name_of_its_class():
    class Unregistered(Plain):
        """Proportional controller."""

    own = Unregistered(kp=2.0, period=0.1)
    with pytest.raises(InputError, match="^the gain 'kp' has no unit: give a unit for each of kp$"):
        controller_document(own, {})
    document = controller_document(own, {"kp": "A/m"})
    assert document["kind"] == "Unregistered" and document["gains"]["kp"]["value"] == 2.0
