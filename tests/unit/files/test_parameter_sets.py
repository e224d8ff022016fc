"""Materials from parameter sets, from Python."""

import pytest

from smajax.errors import InputError
from smajax.files.parameter_sets import load_material, shipped_sets
from smajax.files.rig_file import parse_rig
from smajax.parameters import declarations
from smajax.plant.materials import Brinson, Lagoudas
from smajax.recordings.datasets import data_path


def test_a_material_of_a_set_is_that_of_a_rig_that_names_the_set():
    text = data_path("templates", "dead-weight.toml").read_text("utf-8")
    start, end = text.index("[material]"), text.index("[heat]")
    named = text[:start] + text[end:].replace('capacity = "', '# capacity = "')
    rig = parse_rig(named.replace('control = "current"', 'control = "current"\nparameters = "rotary-table1"', 1))
    material = load_material("rotary-table1")
    assert isinstance(material, Brinson) and "rotary-table1" in shipped_sets()
    for key in declarations(Brinson):
        assert float(getattr(material, key)) == float(getattr(rig.plant.material, key)), key


def test_the_law_and_single_values_can_be_chosen():
    material = load_material("rotary-table1", "lagoudas", n1=0.5, martensite_start=50.0)
    assert isinstance(material, Lagoudas)
    assert float(material.n1) == 0.5 and float(material.martensite_start) == 50.0


@pytest.mark.parametrize(
    ("arguments", "values", "sentence"),
    [
        (
            ("rotary-table",),
            {},
            "parameter set 'rotary-table' is not known (did you mean 'rotary-table1'?): the shipped",
        ),
        (("rotary-table1", "brinsn"), {}, "there is no material 'brinsn' (did you mean 'brinson'?): choose brinson"),
        (("rotary-table1",), {"martensite_strat": 1.0}, "brinson has no parameter 'martensite_strat' (did you mean"),
        (("rotary-table1",), {"martensite_start": 1e3}, "Brinson.martensite_start: 1000 degC is not possible for the"),
        (("flexinol",), {}, "parameter set flexinol has no martensite_start, martensite_finish"),
    ],
)
def test_what_a_material_lacks_is_one_sentence(arguments, values, sentence):
    with pytest.raises(InputError) as caught:
        load_material(*arguments, **values)
    assert sentence in str(caught.value)
