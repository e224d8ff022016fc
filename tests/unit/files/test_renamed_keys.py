"""Old keys and parameter names in rig files, parameter sets and actuator files."""

import tomllib
from pathlib import Path

import pytest

from smajax import parameters
from smajax.errors import InputError
from smajax.files.actuator_file import parse_actuator, to_toml
from smajax.files.parameter_sets import read_parameters
from smajax.files.renamed_keys import (
    RENAMED_PARAMETERS,
    RENAMED_RIG_KEYS,
    current_name,
    with_current_keys,
    with_current_names,
)
from smajax.files.rig_file import parse_rig, read_rig
from smajax.recordings.datasets import data_path

OLD_NAMES = {new: old for old, new in RENAMED_PARAMETERS.items()}
STRAIN = "material.max_transformation_strain"


def old_template(kind: str) -> str:
    """Return the shipped template of a kind with the old names of all keys and parameters."""
    text = data_path("templates", f"{kind}.toml").read_text("utf-8")
    for new, old in OLD_NAMES.items():
        text = text.replace(new, old)
        text = text.replace(f"\n{new.split('.')[1]} =", f"\n{old.split('.')[1]} =")
    return text


def with_fit(text: str, lines: str) -> str:
    """Return a rig file in which other lines of ``[fit]`` replace the list of free parameters."""
    free = next(line for line in text.splitlines() if line.startswith("free ="))
    return text.replace(free, lines)


@pytest.mark.parametrize("kind", ["dead-weight", "hip", "elbow", "wrist"])
def test_a_rig_with_old_names_is_the_same_rig_and_is_written_with_new_ones(kind: str):
    text = old_template(kind)
    assert "max_strain" in text and "max_transformation_strain" not in text
    rig, expected = parse_rig(text), parse_rig(data_path("templates", f"{kind}.toml").read_text("utf-8"))
    assert rig.to_toml() == expected.to_toml()
    assert rig.fit == expected.fit and rig.sources == expected.sources
    sections = tomllib.loads(rig.to_toml())
    keys = {f"{section}.{key}" for section, table in sections.items() if isinstance(table, dict) for key in table}
    assert STRAIN in keys and not keys & {*RENAMED_PARAMETERS, *RENAMED_RIG_KEYS}


@pytest.mark.parametrize(
    "lines",
    [
        'free = ["material.max_strain"]',
        'free = []\nper_recording = ["material.max_strain"]',
        'free = ["material.max_transformation_strain"]\nbounds = {"material.max_strain" = ["2 %", "6 %"]}',
        'free = ["material.max_strain"]\nbounds = {material.max_strain = ["2 %", "6 %"]}',
    ],
)
def test_old_names_in_the_fit_section(lines: str):
    rig = parse_rig(with_fit(old_template("dead-weight"), lines))
    assert rig.fit.names == (STRAIN,)
    assert set(rig.fit.bounds) <= {STRAIN} and bool(rig.fit.bounds) == ("bounds" in lines)
    assert "max_strain" not in rig.to_toml()


@pytest.mark.parametrize(
    ("lines", "old", "new"),
    [
        ('free = ["material.max_strain", "material.max_transformation_strain"]', "material.max_strain", STRAIN),
        (
            'free = []\nper_recording = ["sheath.bend", "sheath.wrap_angle"]',
            "sheath.bend",
            "sheath.wrap_angle",
        ),
        (
            'free = []\nbounds = {"sheath.conduction" = ["1", "6"], "sheath.conductance_ratio" = ["1", "6"]}',
            "sheath.conduction",
            "sheath.conductance_ratio",
        ),
    ],
)
def test_both_names_in_the_fit_section_are_refused(lines: str, old: str, new: str):
    with pytest.raises(InputError) as error:
        parse_rig(with_fit(data_path("templates", "elbow.toml").read_text("utf-8"), lines))
    assert str(error.value) == f"rig.toml: {old} is the old name of {new}, and both are given: remove {old}"


@pytest.mark.parametrize(("old", "new"), RENAMED_PARAMETERS.items())
def test_a_key_under_both_names_is_refused(old: str, new: str):
    key = new.split(".")[1]
    text = data_path("templates", "elbow.toml").read_text("utf-8")
    line = next(line for line in text.splitlines() if line.startswith(f"{key} ="))
    both = text.replace(line, f"{line}\n{line.replace(key, old.split('.')[1], 1)}")
    with pytest.raises(InputError) as error:
        parse_rig(both)
    assert str(error.value) == f"rig.toml: {old} is the old name of {new}, and both are given: remove {old}"


class TestParameterSetOfARig:
    def text(self, old: str = "", new: str = "") -> str:
        text = data_path("templates", "dead-weight.toml").read_text("utf-8").replace("martensite_start =", "# m =")
        return text.replace("[material]", f"[material]\n{old}", 1).replace("[rig]", f"[rig]\n{new}", 1)

    def write_set(self, folder: Path, name: str = "material.max_strain") -> None:
        entries = f'[material.martensite_start]\nvalue = "50 degC"\n[{name}]\nvalue = "5 %"\nbounds = ["3 %", "6 %"]\n'
        (folder / "wire.toml").write_text(f'schema = "smajax.parameters/1"\n{entries}')

    @pytest.mark.parametrize("lines", [{"old": 'set = "wire.toml"'}, {"new": 'parameters = "wire.toml"'}])
    def test_it_is_read_under_both_keys(self, lines: dict[str, str], tmp_path: Path):
        self.write_set(tmp_path)
        (tmp_path / "rig.toml").write_text(self.text(**lines))
        rig = read_rig(tmp_path / "rig.toml")
        assert float(parameters.get(rig.plant, "material.martensite_start")) == 50.0
        assert rig.sources["material.martensite_start"] == "parameter set wire.toml"

    def test_both_keys_are_refused(self):
        with pytest.raises(InputError) as error:
            parse_rig(self.text('set = "a.toml"', 'parameters = "b.toml"'))
        sentence = "material.set is the old name of rig.parameters, and both are given: remove material.set"
        assert str(error.value) == f"rig.toml: {sentence}"

    def test_messages_name_the_new_key(self):
        with pytest.raises(InputError, match=r"^rig\.toml: rig\.parameters = 'wyre' is not known"):
            parse_rig(self.text('set = "wyre"'))

    def test_a_missing_section_rig_is_still_reported(self):
        with pytest.raises(InputError, match=r"^rig\.toml: the section \[rig\] is missing"):
            parse_rig('[material]\nset = "rotary-table1"\n')

    def test_old_names_in_a_set(self, tmp_path: Path):
        self.write_set(tmp_path)
        assert set(read_parameters(tmp_path / "wire.toml")) == {"material.martensite_start", STRAIN}
        path = tmp_path / "one.toml"
        path.write_text('schema = "smajax.parameters/1"\n[per_recording."material.max_strain@a.csv"]\nvalue = "5 %"\n')
        assert set(read_parameters(path)) == {f"{STRAIN}@a.csv"}
        path.write_text(
            f'schema = "smajax.parameters/1"\n[material.max_strain]\nvalue = "5 %"\n[{STRAIN}]\nvalue = "5 %"\n'
        )
        with pytest.raises(InputError) as error:
            read_parameters(path)
        assert str(error.value) == f"{path}: {STRAIN} is also given under its old name: remove one of the two"


def test_an_actuator_with_old_names():
    text = data_path("actuators", "knee", "rig.toml").read_text("utf-8")
    assert "max_transformation_strain =" in text
    actuator = parse_actuator(text.replace("max_transformation_strain =", "max_strain ="))
    assert to_toml(actuator) == to_toml(parse_actuator(text))


def test_keys_of_other_files_are_renamed():
    assert current_name("sheath.bend@a.csv") == "sheath.wrap_angle@a.csv"
    assert current_name("heat.h0") == "heat.h0"
    assert with_current_names({"sheath": {"bend": 1}, "heat.h0": 2}) == {"sheath.wrap_angle": 1, "heat.h0": 2}
    data = {"robust": {"vary": 3}, "schema": 1}
    assert with_current_keys(data, {"robust.vary": "robust.uncertain"}) == {"robust": {"uncertain": 3}, "schema": 1}
    assert with_current_keys(data, {"robust.vary": "other.vary"}) == data
    with pytest.raises(InputError, match="and both are given: remove robust.vary"):
        with_current_keys({"robust": {"vary": 3, "uncertain": 4}}, {"robust.vary": "robust.uncertain"})
