"""What the methods of an own material or mechanism return is checked where a plant is made, in one sentence."""

import dataclasses

import jax.numpy as jnp
import numpy as np
import pytest

from smajax.errors import InputError
from smajax.files.parameter_sets import load_material
from smajax.files.rig_file import parse_rig
from smajax.plant import CurrentDrive, Plant, PolynomialConvection, Wire
from smajax.plant.cells import Cells
from smajax.plant.grains import Grains
from smajax.plant.materials import AbstractBandKinetics
from smajax.plant.materials.base import Fractions
from smajax.plant.materials.registry import MATERIALS
from smajax.plant.mechanisms import AbstractElasticLoad, DeadWeight, Load
from smajax.plant.mechanisms.registry import MECHANISMS, mechanism_problem
from smajax.recordings.datasets import data_path
from smajax.recordings.recording import Recording
from smajax.simulation.run import simulate

TIME = np.arange(0.0, 1.0, 0.1)
PULSE = Recording.from_arrays("pulse", TIME, {"current": 0.3 * (TIME < 0.5)})


class OwnLaw(AbstractBandKinetics):
    """Linear kinetics."""

    def remaining_share(self, progress):
        return 1.0 - progress


class OwnLoad(AbstractElasticLoad):
    """A spring."""

    def force(self, displacement):
        return 2.0 + 250.0 * displacement


def plant(material=None, mechanism=None, cells=None):
    return Plant(
        wire=Wire(diameter=0.15e-3, length=0.23),
        material=material or load_material("rotary-table1"),
        mechanism=mechanism or DeadWeight(Load(mass=0.2)),
        drive=CurrentDrive(),
        heat=PolynomialConvection(h0=100.0),
        cells=cells,
    )


def own(base, method, function):
    """A class derived from ``base`` with another method, of this module."""
    cls = type(base.__name__, (base,), {method: function, "__module__": __name__})
    if not issubclass(cls, AbstractBandKinetics):
        return cls()
    values = load_material("rotary-table1")
    names = [field.name for field in dataclasses.fields(cls)]
    return cls(**{name: getattr(values, name) for name in names})


LAWS = {
    "remaining_share": [
        (lambda self, progress: progress[..., None], "shape (1, 1), expected an array of shape (1,)"),
        (lambda self, progress: None, "None, expected an array of shape (1,)"),
        (lambda self, progress: progress.astype(jnp.float32), "an array of float32, expected one of float64"),
        (lambda self, progress: (progress < 0.5).astype(int), "an array of int64, expected one of float64"),
    ],
    "evolve": [
        (
            lambda self, fractions, temperature, stress: tuple(fractions),
            "a tuple, expected Fractions(detwinned, twinned)",
        )
    ],
    "modulus": [(lambda self, fractions: jnp.ones(2), "shape (2,), expected an array of shape (1,)")],
}


@pytest.mark.parametrize(("method", "function", "problem"), [(m, *row) for m, rows in LAWS.items() for row in rows])
def test_what_an_own_law_returns_is_one_sentence(method, function, problem):
    with pytest.raises(InputError) as raised:
        plant(material=own(OwnLaw, method, function))
    assert str(raised.value) == f"OwnLaw: {method} returned {problem}"


def test_one_fraction_of_an_own_law_is_named():
    law = own(OwnLaw, "evolve", lambda self, fractions, temperature, stress: Fractions(0.0, 0.0))
    with pytest.raises(InputError) as raised:
        plant(material=law, cells=Cells(count=3))
    expected = "OwnLaw: detwinned of evolve returned shape (), expected an array of shape (2, 1)"
    assert str(raised.value) == expected


LOADS = {
    "force": [(lambda self, x: 2.0 + x[0], "force returned shape (), expected an array of shape (1,)")],
    "balance": [(lambda self, *_: jnp.zeros(2), "balance returned shape (2,), expected an array of shape (1,)")],
    "update_motion": [
        (
            lambda self, unknown, strain, *_: strain,
            "update_motion returned a state of shapes (1,), expected a state of shapes () as that of initial_motion",
        ),
        (
            lambda self, *_: jnp.zeros((), int),
            "update_motion returned a state with int64, expected floating-point numbers or arrays of float64",
        ),
    ],
    "initial_motion": [
        (lambda self, strain: None, "initial_motion returned None, expected an array of shape ()"),
        (
            lambda self, strain: 0,
            "initial_motion returned a state with int64, expected floating-point numbers or arrays of float64",
        ),
    ],
    "channels": [
        (
            lambda self, strain, *_: {"angle": strain[0]},
            "channels returned the channels angle, expected a dictionary with displacement",
        ),
        (
            lambda self, strain, *_: {"displacement": strain},
            "displacement of channels returned shape (1,), expected an array of shape ()",
        ),
    ],
}


@pytest.mark.parametrize(("method", "function", "problem"), [(m, *row) for m, rows in LOADS.items() for row in rows])
def test_what_an_own_mechanism_returns_is_one_sentence(method, function, problem):
    with pytest.raises(InputError) as raised:
        plant(mechanism=own(OwnLoad, method, function))
    assert str(raised.value) == f"OwnLoad: {problem}"


ARGUMENTS = {
    "law, one too few": (OwnLaw, "remaining_share", lambda self: 1.0, "remaining_share(self)", "(self, progress)"),
    "law, one too many": (
        OwnLaw,
        "modulus",
        lambda self, fractions, temperature: 5e10,
        "modulus(self, fractions, temperature)",
        "(self, fractions)",
    ),
    "law, keyword only": (OwnLaw, "resistivity", lambda self, *, fractions: 1e-6, "fractions)", "(self, fractions)"),
    "load": (OwnLoad, "force", lambda self, x, stiffness: x, "force(self, x, stiffness)", "(self, displacement)"),
    "static": (OwnLoad, "force", staticmethod(lambda: 2.0), "force()", "(self, displacement)"),
}


@pytest.mark.parametrize("case", ARGUMENTS)
def test_a_method_with_other_arguments_is_one_sentence(case):
    base, method, function, taken, expected = ARGUMENTS[case]
    part = own(base, method, function)
    with pytest.raises(InputError) as raised:
        plant(**{"material" if base is OwnLaw else "mechanism": part})
    sentence = str(raised.value)
    assert sentence.startswith(f"{base.__name__}: {method}(") and taken in sentence
    assert f"takes other arguments than it is given: write def {method}{expected}, as in Abstract" in sentence


def test_something_else_in_place_of_a_method_is_one_sentence():
    with pytest.raises(InputError, match=r"^OwnLoad: force is a float and no method: write def force\(self, "):
        plant(mechanism=own(OwnLoad, "force", 2.0))


@pytest.mark.slow
@pytest.mark.parametrize(
    "function", [lambda self, *arguments: 2.0 + 250.0 * arguments[0], lambda self, x, offset=2.0: offset + 250.0 * x]
)
def test_a_method_may_take_more_where_it_need_not(function):
    assert simulate(plant(mechanism=own(OwnLoad, "force", function)), PULSE).status == 0


def test_what_a_method_raises_keeps_its_type_and_is_noted():
    def helper(x):
        return x

    with pytest.raises(TypeError, match="helper") as raised:
        plant(mechanism=own(OwnLoad, "force", lambda self, x: helper(x, 2.0)))
    assert "raised by force of OwnLoad, which is traced once where a plant is made" in raised.value.__notes__
    assert any(entry.name == "<lambda>" for entry in raised.traceback)


def test_nothing_is_computed_for_the_check_of_smajax_s_own_classes(monkeypatch):
    made = plant()

    def fail(self):
        raise AssertionError

    monkeypatch.setattr(Plant, "_mechanism_context", fail)
    dataclasses.replace(made, wire=Wire(diameter=0.2e-3, length=0.23))


@pytest.mark.slow
@pytest.mark.parametrize(("method", "number"), [("modulus", 5e10), ("resistivity", 9e-7)])
def test_an_own_law_may_return_one_number(method, number):
    whole = own(OwnLaw, method, lambda self, fractions: jnp.full_like(fractions.martensite, number))
    single = own(OwnLaw, method, lambda self, fractions: number)
    for cells in (None, Cells(count=3)):
        first, second = (simulate(plant(law, cells=cells), PULSE) for law in (whole, single))
        np.testing.assert_allclose(first.channels["resistance"], second.channels["resistance"], rtol=1e-12)


@pytest.mark.parametrize("count", ["2.0", "'1'", "-1", "True"])
def test_the_number_of_unknowns_is_whole(count):
    cls = type("OwnLoad", (OwnLoad,), {"unknowns": eval(count)})
    assert f"it has {count} unknowns: write a whole number" in mechanism_problem("own", cls)


@pytest.mark.parametrize("name", MATERIALS.names)
def test_the_check_accepts_all_laws(name):
    rig = parse_rig(data_path("templates", "dead-weight.toml").read_text("utf-8"))
    values = rig.plant.material
    cls = type("Own", (MATERIALS[name],), {"__module__": __name__})
    names = [field.name for field in dataclasses.fields(cls) if hasattr(values, field.name)]
    law = cls(**{name: getattr(values, name) for name in names})
    for parts in ({}, {"cells": Cells(count=3), "grains": Grains(count=2)}):
        dataclasses.replace(rig.plant, material=law, **parts)


@pytest.mark.parametrize("kind", [kind for kind in MECHANISMS.names if data_path("templates", f"{kind}.toml").exists()])
def test_the_check_accepts_all_mechanisms(kind):
    rig = parse_rig(data_path("templates", f"{kind}.toml").read_text("utf-8"))
    mechanism = rig.plant.mechanism
    cls = type("Own", (type(mechanism),), {"__module__": __name__})
    fields = {field.name: getattr(mechanism, field.name) for field in dataclasses.fields(mechanism)}
    dataclasses.replace(rig.plant, mechanism=cls(**fields))
