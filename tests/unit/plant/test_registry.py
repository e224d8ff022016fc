"""Registration of own materials, mechanisms and effects: what it refuses, and the entry points of installed packages."""

import importlib
import inspect
import os
import pathlib
import pkgutil
import subprocess
import sys
import textwrap

import equinox as eqx
import jax
import pytest

from smajax.api.registration import register
from smajax.errors import InputError
from smajax.parameters import parameter
from smajax.plant.effects import Coating, HeatEffect, catalogue
from smajax.plant.effects.base import AbstractEffect
from smajax.plant.effects.registry import EFFECTS, effects_by_key
from smajax.plant.materials import AbstractBandKinetics, AbstractMaterial, Brinson, Tanaka
from smajax.plant.materials.registry import MATERIALS
from smajax.plant.mechanisms import AbstractElasticLoad, AbstractMechanism, DeadWeight
from smajax.plant.mechanisms.registry import MECHANISMS
from smajax.plant.registry import Registry
from tests.conftest import ROOT


@pytest.fixture(autouse=True)
def registered(monkeypatch):
    """The registries are as before after each test."""
    for registry in (MATERIALS, MECHANISMS, EFFECTS):
        monkeypatch.setattr(registry, "_added", {})
        monkeypatch.setattr(registry, "_broken", {})


class Linear(AbstractBandKinetics):
    """Kinetics that are linear in the progress."""

    def remaining_share(self, progress):
        return 1.0 - progress


class Leak(HeatEffect):
    """Heat that leaks into a holder."""

    strength: jax.Array = parameter("W/m^3/K", "heat loss per kelvin", 0.0, 1e6, 0.0)
    key = "leak"
    typical = 1e5

    def power(self, state, memory, context):
        return -self.strength * (state.temperature - context.environment.ambient)


class Band(AbstractElasticLoad):
    """Rubber band."""

    stiffness: jax.Array = parameter("N/m", "stiffness", 0.0, 1e5)

    def force(self, displacement):
        return self.stiffness * displacement


class WithoutKinetics(AbstractBandKinetics):
    pass


class WithoutEvolution(AbstractMaterial):
    pass


class WithPlainField(Linear):
    alpha: float = 1.0


class WithOption(Linear):
    order: int = eqx.field(static=True, default=1)


class WithoutStage(AbstractEffect):
    strength: jax.Array = parameter("1", "strength", 0.0, 1.0, 0.0)
    key = "my-effect"


class WithoutStrength(HeatEffect):
    key = "my-effect"


class WithoutTypical(HeatEffect):
    strength: jax.Array = parameter("1", "strength", 0.0, 1.0, 0.0)
    key = "my-effect"


class WithoutDefault(HeatEffect):
    delay: jax.Array = parameter("s", "delay", 0.0, 1.0)
    strength: jax.Array = parameter("1", "strength", 0.0, 1.0, 0.0)
    key = "my-effect"
    typical = 0.5


class WithUnknownShape(WithoutTypical):
    typical = 0.5
    shapes = (("delay", (1.0,)),)


class WithPlainStrength(HeatEffect):
    strength: float = 0.0
    key = "another-name"
    shapes = ("delay", (1.0,))  # pyright: ignore[reportAssignmentType]


class AlwaysPresent(HeatEffect):
    strength: jax.Array = parameter("1", "strength", 0.5, 1.0, 0.7)
    key = "my-effect"
    typical = 0.5


class WithUnknownChannel(Band):
    coordinate = "displacment"


class ThreeWires(Band):
    wires = 3


class WithWireField(AbstractElasticLoad):
    wire: Coating

    def force(self, displacement):
        return displacement


def test_registered_classes_are_known_by_their_names():
    register("material", "my-law", Linear)
    register("mechanism", "my-band", Band)
    register("effect", "leak", Leak)
    assert MATERIALS["my-law"] is Linear and list(MATERIALS)[-1] == "my-law"
    assert MECHANISMS["my-band"] is Band and Band.rig_sections() == {"mechanism": Band}
    assert catalogue()["leak"] is Leak and "leak" in catalogue() and len(catalogue()) == 1 + len(EFFECTS._shipped)
    MATERIALS.unregister("my-law")
    assert "my-law" not in MATERIALS
    with pytest.raises(InputError, match="material 'my-law' was not registered: there is nothing to remove"):
        MATERIALS.unregister("my-law")


def test_a_class_whose_definition_was_run_again_replaces_the_old_one():
    register("material", "my-law", Linear)
    again = type("Linear", (Linear,), {"__module__": Linear.__module__, "__qualname__": Linear.__qualname__})
    register("material", "my-law", again)
    assert MATERIALS["my-law"] is again


@pytest.mark.parametrize(
    ("kind", "name", "cls", "sentence"),
    [
        ("materials", "my-law", Linear, "'materials' cannot be registered (did you mean 'material'?): give one of"),
        ("material", "My_Law", Linear, "material 'My_Law': the name is not in small letters with hyphens"),
        ("material", "brinson", Linear, "the name is taken by smajax.plant.materials.brinson.Brinson: choose another"),
        ("material", "my-law", Linear.remaining_share, "is not a class: give the class itself"),
        (
            "material",
            "my-law",
            DeadWeight,
            "DeadWeight is not of this kind: derive it from smajax.plant.materials.base",
        ),
        (
            "material",
            "my-law",
            WithoutKinetics,
            "WithoutKinetics cannot be used: define the method 'remaining_share' (compute the share f that remains",
        ),
        ("material", "my-law", WithoutEvolution, "define the method 'evolve' (advance the fractions over a step"),
        ("material", "my-law", WithPlainField, "its field 'alpha' has no declaration: write alpha: jax.Array = "),
        ("effect", "my-effect", WithoutStage, "it has no stage: derive it from one of DriveEffect, HeatEffect"),
        ("effect", "my-effect", WithoutStrength, "define 'strength' in the body of the class"),
        ("effect", "my-effect", WithoutTypical, "it has no usual strength: write typical = ..."),
        ("effect", "my-effect", WithoutDefault, "its parameter 'delay' has no default"),
        ("effect", "my-effect", WithUnknownShape, "its shapes name 'delay', which is no declared parameter"),
        ("effect", "my-effect", AlwaysPresent, "a strength of 0 has to be possible and its default"),
        ("effect", "my-effect", Leak, 'its key is not its name: write key = "my-effect"'),
        ("effect", "coating", Leak, "the name is taken by smajax.plant.effects.coating.Coating"),
        ("mechanism", "my-band", WithUnknownChannel, "'displacment' is not a channel (did you mean 'displacement'?)"),
        ("mechanism", "my-band", ThreeWires, "it has 3 wires: write wires = 1 or wires = 2"),
        ("mechanism", "my-band", WithWireField, "its field 'wire' has the name of another section"),
    ],
)
def test_wrong_use_is_one_sentence(kind, name, cls, sentence):
    with pytest.raises(InputError) as caught:
        register(kind, name, cls)
    assert sentence in str(caught.value)


def test_all_that_a_class_lacks_is_said_at_once():
    with pytest.raises(InputError) as caught:
        register("effect", "my-effect", WithPlainStrength)
    sentences = (
        "its field 'strength' has no declaration: write strength: jax.Array = smajax.parameter(UNIT, MEANING",
        'its key is not its name: write key = "my-effect"',
        "its strength has no declaration: write strength: jax.Array = smajax.parameter(UNIT, MEANING, LOWER, UPPER, 0.0)",
        "it has no usual strength: write typical = ...",
        'its shapes have another form: write them like shapes = (("onset", (0.01, 0.02)),)',
    )
    assert all(sentence in str(caught.value) for sentence in sentences)
    incomplete = type("Incomplete", (AbstractElasticLoad,), {"coordinate": "displacment", "__module__": __name__})
    with pytest.raises(InputError) as caught:
        register("mechanism", "my-band", incomplete)
    assert all(
        sentence in str(caught.value) for sentence in ("define the method 'force'", "'displacment' is not a channel")
    )


def test_options_need_no_declaration():
    register("material", "my-law", WithOption)
    assert MATERIALS["my-law"] is WithOption


def test_two_effects_of_one_key_are_an_error():
    other = type("Other", (Leak,), {"key": "leak"})
    with pytest.raises(ValueError, match=r"two effects have the key 'leak', .*Leak and .*Other: rename one"):
        effects_by_key([Leak, other])


@pytest.mark.parametrize("cls", [WithoutKinetics, WithoutEvolution, AbstractElasticLoad])
def test_a_class_that_lacks_methods_is_told_at_construction(cls):
    with pytest.raises(TypeError, match=rf"{cls.__name__} cannot be constructed: define the method '\w+' \("):
        cls()


class EmptyMechanism(AbstractMechanism):
    pass


class EmptyEffect(HeatEffect):
    pass


@pytest.mark.parametrize(
    ("cls", "sentence"),
    [
        (
            EmptyMechanism,
            "EmptyMechanism cannot be constructed: define 'wires', 'unknowns', 'prescribed', 'coordinate' in the body of the "
            "class; define the methods 'balance' (evaluate the residual of the force balance",
        ),
        (EmptyEffect, "EmptyEffect cannot be constructed: define 'strength' in the body of the class"),
    ],
)
def test_a_class_that_lacks_attributes_is_told_in_the_same_words(cls, sentence):
    with pytest.raises(TypeError) as caught:
        cls()
    assert str(caught.value).startswith(sentence)
    with pytest.raises(InputError, match="in the body of the class"):
        register("mechanism" if cls is EmptyMechanism else "effect", "my-empty", cls)


def test_shipped_classes_are_importable_by_name_and_list_their_parameters():
    from smajax.plant import effects, materials, mechanisms

    assert effects.Coating is Coating and materials.Brinson is Brinson and "LatentHeat" in dir(effects)
    assert "Coating" in dir(effects) and mechanisms.DeadWeight is DeadWeight
    assert "detwinning_start_stress [Pa]: stress at which detwinning starts" in (Brinson.__doc__ or "")
    assert "austenite_start [degC]" in (Tanaka.__doc__ or "")
    with pytest.raises(AttributeError, match="has no attribute 'Coting'"):
        effects.Coting  # noqa: B018


PACKAGE = '''
import jax
from smajax.parameters import parameter
from smajax.plant.effects import HeatEffect
from smajax.plant.materials import AbstractBandKinetics
from smajax.plant.mechanisms import AbstractElasticLoad

class Law(AbstractBandKinetics):
    """Kinetics that are linear in the progress."""
    def remaining_share(self, progress):
        return 1.0 - progress

class Band(AbstractElasticLoad):
    """Rubber band."""
    stiffness: jax.Array = parameter("N/m", "stiffness", 0.0, 1e5)
    def force(self, displacement):
        return 1.0 + self.stiffness * displacement

class Leak(HeatEffect):
    """Heat that leaks into a holder."""
    strength: jax.Array = parameter("W/m^3/K", "heat loss per kelvin", 0.0, 1e6, 0.0)
    key, typical = "leak", 1e5
    def power(self, state, memory, context):
        return -self.strength * (state.temperature - context.environment.ambient)
'''
ENTRY_POINTS = """
[smajax.materials]
linear = sma_extra:Law
broken-law = sma_extra:NoSuchLaw

[smajax.mechanisms]
band = sma_extra:Band

[smajax.effects]
leak = sma_extra:Leak
lek = sma_extra:Leak
"""
SCRIPT = """
import sys, warnings
from smajax.errors import InputError
from smajax.files.rig_file import parse_rig
from smajax.recordings.datasets import data_path

warned = []
warnings.showwarning = lambda message, *where: warned.append(message)
text = data_path("templates", "dead-weight.toml").read_text("utf-8")
parse_rig(text)
assert "sma_extra" not in sys.modules, "a rig without own classes imports no package"
text = "\\n".join(line for line in text.splitlines() if not line.startswith("detwinning"))
text = text.replace('"brinson"', '"linear"').replace('"dead-weight"', '"band"')
text = text.replace("[load]\\nmass = ", '[mechanism]\\nstiffness = "200 N/m" #')
rig = parse_rig(text + '\\n[effects.leak]\\nstrength = "1e5 W/m^3/K"\\n')
assert [type(p).__name__ for p in (rig.plant.material, rig.plant.mechanism, *rig.plant.effects)] == ["Law", "Band", "Leak"]
assert parse_rig(rig.to_toml()).plant.mechanism.stiffness == 200.0
for wrong in (text.replace('"linear"', '"broken-law"'), text + "\\n[effects.lek]\\n"):
    try:
        parse_rig(wrong)
    except InputError as error:
        print(error)
from smajax.comparison.models import model_names
from smajax.plant.effects import catalogue
assert "linear" in model_names() and "broken-law" not in model_names()
assert "leak" in catalogue().keys() and "lek" not in list(catalogue())
print(*warned, sep="\\n")
"""


def install(folder: pathlib.Path, name: str, entry_points: str) -> None:
    """Write the metadata of an installed package."""
    info = folder / f"{name.replace('-', '_')}-1.0.dist-info"
    info.mkdir()
    (info / "METADATA").write_text(f"Metadata-Version: 2.1\nName: {name}\nVersion: 1.0\n", "utf-8")
    (info / "entry_points.txt").write_text(textwrap.dedent(entry_points), "utf-8")


@pytest.mark.slow
def test_an_installed_package_adds_classes_by_entry_points(tmp_path: pathlib.Path):
    (tmp_path / "sma_extra.py").write_text(PACKAGE, "utf-8")
    install(tmp_path, "sma-extra", ENTRY_POINTS)
    path = os.pathsep.join([str(ROOT), str(tmp_path)])
    run = subprocess.run(
        [sys.executable, "-c", SCRIPT],
        env=os.environ | {"PYTHONPATH": path, "JAX_ENABLE_X64": "1"},
        capture_output=True,
        text=True,
        check=False,
    )
    assert run.returncode == 0, run.stderr
    lines = run.stdout.splitlines()
    law = "the package sma-extra offers the material 'broken-law' (sma_extra:NoSuchLaw), which cannot be used: AttributeError"
    effect = "the package sma-extra offers the effect 'lek' (sma_extra:Leak), which cannot be used: effect 'lek': Leak cannot be used"
    assert len(lines) == 4
    for line, sentence in zip(lines, (law, effect, law, effect), strict=True):
        assert sentence in line and line.endswith("repair or uninstall sma-extra")


def test_two_installed_packages_of_one_name_are_a_conflict(tmp_path: pathlib.Path, monkeypatch):
    (tmp_path / "sma_extra.py").write_text(PACKAGE, "utf-8")
    install(tmp_path, "sma-extra", "[smajax.materials]\nlinear = sma_extra:Law\nown = sma_extra:Law\n")
    install(tmp_path, "sma-more", "[smajax.materials]\nlinear = sma_more:Other\n")
    monkeypatch.syspath_prepend(tmp_path)
    registry = Registry("material", AbstractMaterial, dict)
    sentence = (
        r"^the packages sma-(extra|more) \(sma_.*\) and sma-(extra|more) \(sma_.*\) offer the material 'linear': "
        "uninstall all but one of them$"
    )
    with pytest.raises(InputError, match=sentence) as caught:
        registry["linear"]
    assert all(part in str(caught.value) for part in ("sma-extra (sma_extra:Law)", "sma-more (sma_more:Other)"))
    assert registry["own"].__name__ == "Law"
    with pytest.warns(UserWarning, match=sentence):
        assert list(registry) == ["own"]


@pytest.mark.parametrize("room", ["plant", "laws", "actuators", "fitting", "sweeps"])
def test_every_concrete_class_defines_the_methods_of_its_base_classes(room):
    folder = importlib.import_module(f"smajax.{room}")
    for module in pkgutil.walk_packages(folder.__path__, f"smajax.{room}."):
        for name, cls in vars(importlib.import_module(module.name)).items():
            if inspect.isclass(cls) and issubclass(cls, eqx.Module) and cls.__module__ == module.name:
                assert inspect.isabstract(cls) <= name.startswith("Abstract"), f"{module.name}.{name}"
