"""Texts of ``smajax check``."""

from smajax.app.commands.check import describe
from tests.conftest import ROOT

RIG = ROOT / "data" / "recordings" / "dead-weight" / "rig.toml"


def test_free_parameters_have_the_units_of_the_rig_file(tmp_path):
    text = RIG.read_text().replace('"230 mm"', '"23 cm"').replace("free = [", 'free = ["wire.length", ')
    assert 'max_transformation_strain = "4.1 %"' in text
    (tmp_path / "rig.toml").write_text(text)
    rows = {line.split()[0]: line.split() for line in describe(tmp_path / "rig.toml", []).splitlines() if line}
    assert rows["material.max_transformation_strain"][1:8] == ["4.1", "%", "0.01", "%", "..", "12", "%"]
    assert rows["wire.length"][1:3] == ["23", "cm"]
    assert rows["material.austenite_shift"][1:3] == ["0", "K"]
