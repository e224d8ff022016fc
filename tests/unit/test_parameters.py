"""Parameters by name in a plant, and the files that hold them."""

import dataclasses
import math
import os
import pathlib
import subprocess
import sys

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from smajax import parameters
from smajax.errors import InputError
from smajax.files.material_limits import read_limits
from smajax.files.parameter_names import all_parameter_names, declarations_of
from smajax.files.parameter_sets import Entry, read_header, read_parameters, write_parameters
from smajax.files.rig_file import parse_rig
from smajax.plant.wire import Initial, Wire
from smajax.recordings.datasets import data_path


@pytest.fixture(scope="module")
def plant():
    return parse_rig(data_path("templates", "dead-weight.toml").read_text("utf-8")).plant


class TestNames:
    def test_all_names_can_be_read_and_replaced(self, plant):
        for name, declared in parameters.all_declarations(plant).items():
            value = min(max(0.25, declared.lower), declared.upper)
            changed = parameters.replace(plant, {name: value}, ordered=False)
            assert float(parameters.get(changed, name)) == value, name
            others = set(parameters.expand(parameters.all_declarations(plant))) - set(parameters.expand([name]))
            for other in others:
                before, after = parameters.get(plant, other), parameters.get(changed, other)
                assert jnp.array_equal(before, after, equal_nan=True), (name, other)

    def test_none_is_no_value(self, plant):
        with pytest.raises(InputError, match="^wire.length is None: give a number in m$"):
            parameters.replace(plant, {"wire.length": None})

    @pytest.mark.parametrize(
        ("values", "message"),
        [
            (
                {"material.austenite_start": 80.0},
                "material.austenite_finish = 73.8 degC is not above material.austenite_start = 80 degC: correct one of the two",
            ),
            (
                {"material.martensite_start": 40.0, "material.martensite_finish": np.asarray(40.0)},
                "material.martensite_start = 40 degC is not above material.martensite_finish = 40 degC: correct one of the two",
            ),
        ],
    )
    def test_a_transformation_ends_above_its_start(self, plant, values, message):
        with pytest.raises(InputError) as caught:
            parameters.replace(plant, values)
        assert str(caught.value) == message
        # Both ends may move past each other's present values, in any order.
        shifted = parameters.replace(plant, {"material.austenite_start": 150.0, "material.austenite_finish": 160.0})
        assert float(shifted.material.austenite_start) == 150.0
        traced = jax.jit(lambda value: parameters.replace(plant, {"material.austenite_start": value}))(80.0)
        assert float(traced.material.austenite_start) == 80.0

    def test_the_constructor_of_a_law_checks_the_order(self, plant):
        law, name = plant.material, type(plant.material).__name__
        message = (
            f"^{name}.austenite_finish = 40 degC is not above {name}.austenite_start = 68 degC: correct one of the two$"
        )
        with pytest.raises(InputError, match=message):
            dataclasses.replace(law, austenite_finish=40.0)
        with pytest.raises(InputError, match=f"^{name}.austenite_finish = 40 degC is not above"):
            dataclasses.replace(law, austenite_start=np.array([60.0, 50.0]), austenite_finish=np.array([70.0, 40.0]))
        traced = jax.jit(lambda finish: dataclasses.replace(law, austenite_finish=finish))(40.0)
        assert float(traced.austenite_finish) == 40.0
        grain = law.with_bands((0.1, 0.5), (-0.1, 0.5))
        assert float(grain.austenite_start) < float(grain.austenite_finish)

    def test_sections_of_the_mechanism_have_names_too(self, plant):
        assert {"load.mass", "wire.length", "sensor.displacement_gain", "heat.capacity"} <= set(
            parameters.all_declarations(plant)
        )
        assert "pulley.radius" not in parameters.all_declarations(plant)

    def test_a_tie_reaches_its_members_and_a_later_member_wins(self, plant):
        changed = parameters.replace(plant, {"heat.capacity": 3e6, "heat.capacity_martensite": 4e6})
        assert float(changed.heat.capacity_austenite) == 3e6
        assert float(changed.heat.capacity_martensite) == 4e6
        assert parameters.expand(["heat.h0", "heat.capacity"]) == [
            "heat.h0",
            "heat.capacity_austenite",
            "heat.capacity_martensite",
        ]

    def test_an_unknown_name_is_refused_with_the_nearest(self, plant):
        with pytest.raises(
            InputError,
            match=r"no parameter 'material\.max_transformation_strian' in this plant \(did you mean 'material\.max_transformation_strain'\?\)",
        ):
            parameters.declaration(plant, "material.max_transformation_strian")

    def test_a_state_left_to_the_plant_is_nan(self, plant):
        assert math.isnan(float(parameters.get(plant, "initial.detwinned")))

    def test_replacing_is_differentiable(self, plant):
        def cooling(h0):
            return parameters.replace(plant, {"heat.h0": h0}).heat.convection(jnp.asarray(80.0))

        assert float(jax.jit(jax.grad(cooling))(100.0)) == 1.0


class TestChecks:
    """Python refuses what files refuse, in the same sentence; what JAX traces is not checked."""

    def test_an_unknown_name_is_refused(self, plant):
        with pytest.raises(InputError, match=r"no parameter 'heat\.h00' in this plant \(did you mean 'heat\.h0'\?\)"):
            parameters.replace(plant, {"heat.h00": 1.0})

    def test_a_value_outside_of_its_bounds_is_refused_as_in_files(self, plant):
        sentence = r"wire\.length: {} is not possible for the wire length: give a value from 0\.1 mm to 100000 mm$"
        for value, shown in ((-3.0, "-3000 mm"), (1e3, "1000000 mm"), (math.nan, "nan m"), (math.inf, "inf m")):
            with pytest.raises(InputError, match="^" + sentence.format(shown)):
                parameters.replace(plant, {"wire.length": value})
        text = data_path("templates", "dead-weight.toml").read_text("utf-8")
        with pytest.raises(InputError, match=sentence.format("'-3000 mm'")):
            parse_rig(text.replace('length = "230 mm"', 'length = "-3000 mm"'))

    def test_a_tie_and_a_stack_of_values_are_checked(self, plant):
        with pytest.raises(InputError, match=r"^heat\.capacity: 1e-6 MJ/m\^3/K is not possible"):
            parameters.replace(plant, {"heat.capacity": 1.0})
        with pytest.raises(InputError, match=r"^load\.mass: -2 kg"):
            parameters.replace(plant, {"load.mass": jnp.array([1.0, -2.0])})

    def test_a_value_is_checked_at_construction(self):
        with pytest.raises(InputError, match=r"^Wire\.length: -3000 mm is not possible for the wire length"):
            Wire(1e-4, -3.0)
        with pytest.raises(InputError, match=r"^Wire\.diameter = '0\.1 mm' is text: give a number in m$"):
            Wire("0.1 mm", 0.2)
        assert Wire(np.float64(1e-4), np.int64(1)).length.dtype == jnp.float64
        assert Initial(temperature=25.0).temperature.dtype == jnp.float64 and Initial().temperature is None

    def test_an_argument_with_an_unknown_name_is_refused_at_construction(self):
        sentence = (
            r"^Wire has no argument 'diametre' \(did you mean 'diameter'\?\): it has diameter, length, prestrain$"
        )
        with pytest.raises(InputError, match=sentence):
            Wire(diametre=1e-4, length=0.2)

        class AnyNames(Wire):
            """Wire that takes arguments of any name."""

            def __init__(self, **options):
                super().__init__(options["d"], options["l"])

        assert AnyNames(d=1e-4, l=0.2).length == 0.2

    @pytest.mark.parametrize("library", [np, jnp])
    @pytest.mark.parametrize("kind", ["float16", "bfloat16", "float32", "bool", "complex128"])
    def test_arrays_without_double_precision_are_refused(self, plant, library, kind):
        value = library.asarray(1.0, jnp.dtype(kind))
        for make in (lambda: Wire(1e-4, value), lambda: parameters.replace(plant, {"wire.length": value})):
            with pytest.raises(InputError, match=rf"^a parameter is an array of {kind} and smajax needs double prec"):
                make()

    @pytest.mark.parametrize("value", [2, np.int8(2), np.array(2, np.uint32), jnp.array(2), jnp.array(2, jnp.int8)])
    def test_integers_become_parameters_of_double_precision(self, plant, value):
        length = Wire(1e-4, value).length
        assert length.dtype == jnp.float64 and float(length) == 2.0
        assert parameters.replace(plant, {"wire.length": value}).wire.length.dtype == jnp.float64
        assert jax.jit(lambda number: Wire(1e-4, number).length)(jnp.asarray(value)).dtype == jnp.float64

    def test_a_value_beyond_its_bound_by_rounding_passes(self):
        assert float(Wire(1e-6 * (1.0 - 1e-15), 100.0 * (1.0 + 1e-15)).length) > 100.0

    def test_traced_values_and_placeholders_are_not_checked(self, plant):
        def length(value):
            return parameters.replace(plant, {"wire.length": value}).wire.length + Wire(1e-4, value).length

        assert float(jax.jit(length)(-1.0)) == -2.0
        assert float(jax.grad(length)(1.0)) == 2.0
        assert jax.vmap(length)(jnp.array([-1.0, 1.0])).tolist() == [-2.0, 2.0]
        leaves, structure = jax.tree.flatten(Wire(1e-4, 1.0))
        assert isinstance(jax.tree.unflatten(structure, [object()] * len(leaves)), Wire)
        shapes = jax.eval_shape(lambda: Wire(1e-4, 1.0))
        assert shapes.length.shape == ()


NAMES = [name for name in all_parameter_names() if name != "heat.h2"]
finite = st.floats(0.0, 1.0)


@st.composite
def entries(draw) -> dict[str, Entry]:
    found = {}
    for name in draw(st.lists(st.sampled_from(NAMES), min_size=1, max_size=6, unique=True)):
        declaration = declarations_of(name)[0]
        low, high = max(declaration.lower, -1e12), min(declaration.upper, 1e12)
        a, value, b = sorted(low + (high - low) * draw(finite) for _ in range(3))
        bounds = draw(st.sampled_from([(-math.inf, math.inf), (a, b), (a, math.inf), (-math.inf, b)]))
        bounds = bounds if bounds[0] < bounds[1] else (-math.inf, math.inf)
        found[name if draw(st.booleans()) else f"{name}@50 MPa.txt"] = Entry(
            value,
            declaration.unit,
            *bounds,
            source=draw(st.text(st.characters(exclude_categories=["Cs"]), max_size=20)),
            interval95=draw(st.sampled_from([None, (a, b), (-math.inf, math.inf)])),
            free=draw(st.sampled_from([None, True, False])),
            at_bound=draw(st.sampled_from([None, True, False])),
        )
    return found


class TestFiles:
    @settings(max_examples=60, deadline=None, derandomize=True)
    @given(entries=entries(), title=st.text(st.characters(exclude_categories=["Cs"]), max_size=20))
    def test_written_and_read_it_is_the_same_to_the_last_bit(
        self, tmp_path_factory, entries: dict[str, Entry], title: str
    ):
        path = tmp_path_factory.mktemp("sets") / "fit.toml"
        header = {
            "title": title,
            "fit": {"rig": "rig.toml", "seed": 3, "recordings": [{"name": "a.csv", "sha256": "00"}]},
        }
        write_parameters(path, entries, header)
        assert read_parameters(path) == entries
        assert read_header(path) == header

    def test_the_text_is_what_a_person_would_write(self, tmp_path: pathlib.Path):
        path = tmp_path / "fit.toml"
        fitted = Entry(48.4, "degC", 30.0, 70.0, "train.csv", (47.9, 48.9), free=True, at_bound=False)
        offset = Entry(0.001, "1", interval95=(-math.inf, 0.002))
        write_parameters(
            path, {"material.martensite_start": fitted, "sensor.strain_offset@50MPa.txt": offset}, {"title": "a fit"}
        )
        assert path.read_text() == (
            'schema = "smajax.parameters/1"\n'
            'title = "a fit"\n\n'
            "[material.martensite_start]\n"
            'value = "48.4 degC"\n'
            'bounds = ["30 degC", "70 degC"]\n'
            'interval95 = ["47.9 degC", "48.9 degC"]\n'
            "free = true\n"
            "at_bound = false\n"
            'source = "train.csv"\n\n'
            '[per_recording."sensor.strain_offset@50MPa.txt"]\n'
            'value = "0.001"\n'
            'interval95 = ["none", "0.002"]\n'
        )

    def test_a_name_with_two_units_takes_the_one_that_fits(self, tmp_path: pathlib.Path):
        path = tmp_path / "set.toml"
        for unit in ("W/m^2/K^3", "W/m^2/K"):
            path.write_text(f'schema = "smajax.parameters/1"\n[heat.h2]\nvalue = "0.25 {unit}"\n')
            assert read_parameters(path) == {"heat.h2": Entry(0.25, unit)}

    def test_a_stopped_write_leaves_the_old_file(self, tmp_path: pathlib.Path, monkeypatch: pytest.MonkeyPatch):
        path = tmp_path / "fit.toml"
        write_parameters(path, {"load.mass": Entry(0.2, "kg")}, {})
        before = path.read_bytes()

        def stopped(descriptor: int) -> None:
            raise OSError(28, "No space left on device")

        monkeypatch.setattr(os, "fsync", stopped)
        with pytest.raises(
            InputError, match=r"fit\.toml: the file cannot be written \(No space left on device\): check the folder"
        ):
            write_parameters(path, {"load.mass": Entry(0.3, "kg")}, {})
        assert path.read_bytes() == before
        assert [p.name for p in tmp_path.iterdir()] == ["fit.toml"]

    def test_what_is_not_a_number_is_not_written(self, tmp_path: pathlib.Path):
        with pytest.raises(InputError, match=r"load\.mass is nan and cannot be written: give it a finite value"):
            write_parameters(tmp_path / "fit.toml", {"load.mass": Entry(math.nan, "kg")}, {})
        assert not list(tmp_path.iterdir())

    def test_shipped_sets_read(self):
        paths = sorted(data_path("parameters").glob("*.toml"))
        assert "rotary-table1" in [path.stem for path in paths]
        for path in paths:
            assert read_parameters(path) or read_limits(path, path.stem), path.name
            assert {"title", "source"} <= read_header(path).keys(), path.name


HEAD = 'schema = "smajax.parameters/1"\n'
BAD = {
    "a rig": (
        "schema = 1\n[rig]\nkind = 'path'\n",
        'this is not a parameter file: one begins with the line schema = "smajax.parameters/1"',
    ),
    "unknown name": (
        HEAD + '[material.martensit_start]\nvalue = "48 degC"\n',
        "there is no parameter 'material.martensit_start' (did you mean 'material.martensite_start'?): "
        "correct the name, or remove the table",
    ),
    "unknown section": (
        HEAD + '[magnet.field]\nvalue = "1 T"\n',
        "there is no parameter 'magnet.field': correct the name, or remove the table",
    ),
    "not a table": (
        HEAD + '[load]\nmass = "0.2 kg"\n',
        "load.mass = '0.2 kg' is not a table: write it as [load.mass] with a line value = \"...\"",
    ),
    "no value": (
        HEAD + "[load.mass]\nfree = true\n",
        'load.mass.value is missing: add a line like value = "..." to [load.mass]',
    ),
    "wrong key": (
        HEAD + '[load.mass]\nvalue = "0.2 kg"\nboundz = ["0 kg", "1 kg"]\n',
        "load.mass.boundz is not known (did you mean 'bounds'?): the keys of [load.mass] are value, bounds, source, interval95, "
        "free, at_bound",
    ),
    "bare number": (
        HEAD + "[load.mass]\nvalue = 0.2\n",
        "load.mass: '0.2' has no unit, and kg is expected: write it like '0.2 kg'",
    ),
    "wrong unit": (
        HEAD + '[load.mass]\nvalue = "0.2 N"\n',
        "load.mass: '0.2 N': the unit 'N' does not fit: a unit that converts to kg is expected, as in '0.2 kg'",
    ),
    "impossible": (
        HEAD + '[load.mass]\nvalue = "-0.2 kg"\n',
        "load.mass: '-0.2 kg' is not possible for the hanging mass: give a value from 0 kg to 10000 kg",
    ),
    "one bound": (
        HEAD + '[load.mass]\nvalue = "0.2 kg"\nbounds = ["0 kg"]\n',
        'load.mass.bounds = [\'0 kg\'] is not a list of 2 entries: write it like bounds = ["30 degC", "70 degC"]',
    ),
    "value outside": (
        HEAD + '[load.mass]\nvalue = "0.2 kg"\nbounds = ["0.3 kg", "1 kg"]\n',
        "load.mass.bounds = ['0.3 kg', '1 kg'] do not contain the value '0.2 kg': correct one of them",
    ),
    "interval reversed": (
        HEAD + '[load.mass]\nvalue = "0.2 kg"\ninterval95 = ["0.3 kg", "0.1 kg"]\n',
        "load.mass.interval95 = ['0.3 kg', '0.1 kg'] is in the wrong order: put the smaller end first",
    ),
    "free not boolean": (
        HEAD + '[load.mass]\nvalue = "0.2 kg"\nfree = "yes"\n',
        "load.mass.free = 'yes' is not true or false: write it like free = true",
    ),
    "per recording without recording": (
        HEAD + '[per_recording."load.mass"]\nvalue = "0.2 kg"\n',
        "there is no parameter 'load.mass': name it \"SECTION.KEY@RECORDING\"",
    ),
    "twice": (
        HEAD + '[load.mass]\nvalue = "0.2 kg"\n[load.mass]\nvalue = "0.3 kg"\n',
        "row 4, column 11: this section is in the file twice: put its keys together under one heading",
    ),
}


@pytest.mark.parametrize("case", BAD)
def test_malformed_parameter_file_gives_its_sentence(case: str, tmp_path: pathlib.Path):
    text, sentence = BAD[case]
    path = tmp_path / "set.toml"
    path.write_text(text)
    with pytest.raises(InputError) as error:
        read_parameters(path)
    assert str(error.value) == f"{path}: {sentence}"


@pytest.mark.parametrize(
    "module", ["smajax.control.estimators.thermal_observer", "smajax.laws.bouc_wen", "smajax.laws.narx"]
)
def test_whoever_imports_a_part_alone_computes_in_double_precision(module):
    words = f"import {module}, jax; assert jax.numpy.ones(3).dtype == 'float64'"
    subprocess.run([sys.executable, "-W", "error", "-c", words], check=True)
