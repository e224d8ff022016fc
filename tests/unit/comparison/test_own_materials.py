"""A registered material law among the models of a comparison and of start values."""

import jax
import pytest

from smajax.api.registration import register
from smajax.comparison.material_models import with_material_law
from smajax.comparison.models import model_names, select_models
from smajax.errors import InputError
from smajax.files.rig_file import parse_rig
from smajax.parameters import parameter
from smajax.plant.materials import AbstractBandKinetics
from smajax.plant.materials.registry import MATERIALS
from smajax.properties.start_values import make_start_values
from smajax.recordings.datasets import data_path


class Linear(AbstractBandKinetics):
    """Kinetics that are linear in the progress."""

    def remaining_share(self, progress):
        return 1.0 - progress


class Power(Linear):
    """Kinetics with an exponent that has no default."""

    exponent: jax.Array = parameter("1", "exponent of the kinetics", 0.1, 10.0)


@pytest.fixture(autouse=True)
def registered(monkeypatch):
    """Two own laws, which are not known after the test."""
    monkeypatch.setattr(MATERIALS, "_added", {})
    register("material", "linear", Linear)
    register("material", "power", Power)


def test_an_own_law_replaces_that_of_a_rig():
    rig = parse_rig(data_path("templates", "dead-weight.toml").read_text("utf-8"))
    changed = with_material_law(rig, "linear")
    assert isinstance(changed.plant.material, Linear) and changed.fit.model == "linear"
    assert isinstance(parse_rig(changed.to_toml()).plant.material, Linear)
    assert "linear" in model_names() and select_models(["linear", "brinson"]) == ["linear", "brinson"]
    with pytest.raises(InputError, match=r"'liner' is not known \(did you mean 'linear'\?\)"):
        select_models(["liner"])


def test_a_parameter_without_a_start_value_is_named():
    rig = parse_rig(data_path("templates", "dead-weight.toml").read_text("utf-8"))
    with pytest.raises(InputError, match=r"^power has no start value of material\.exponent: give it a default"):
        with_material_law(rig, "power")


def test_start_values_need_a_law_that_exists():
    with pytest.raises(InputError, match=r"'liner' is not a material law \(did you mean 'linear'\?\): choose brinson"):
        make_start_values([], "liner")
