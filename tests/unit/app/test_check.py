"""Texts of ``smajax check``."""

from smajax.app.commands.check import describe
from tests.conftest import ROOT

FOLDER = ROOT / "data" / "recordings" / "dead-weight"
RIG = FOLDER / "rig.toml"


def test_free_parameters_have_the_units_of_the_rig_file(tmp_path):
    text = RIG.read_text().replace('"230 mm"', '"23 cm"').replace("free = [", 'free = ["wire.length", ')
    assert 'max_transformation_strain = "4.1 %"' in text
    (tmp_path / "rig.toml").write_text(text)
    rows = {line.split()[0]: line.split() for line in describe(tmp_path / "rig.toml", []).splitlines() if line}
    assert rows["material.max_transformation_strain"][1:8] == ["4.1", "%", "0.01", "%", "..", "12", "%"]
    assert rows["wire.length"][1:3] == ["23", "cm"]
    assert rows["material.austenite_shift"][1:3] == ["0", "K"]


def test_a_reversed_sensor_names_its_topic(tmp_path):
    header, *rows = (FOLDER / "train.csv").read_text().splitlines()[:1001]
    cells = [row.split(",") for row in rows]
    reversed_rows = [",".join([*row[:-1], str(-float(row[-1]))]) for row in cells]
    (tmp_path / "reversed.csv").write_text("\n".join([header, *reversed_rows]) + "\n")
    (tmp_path / "right.csv").write_text("\n".join([header, *rows]) + "\n")
    wrong, right = (describe(RIG, [tmp_path / name]) for name in ("reversed.csv", "right.csv"))
    assert "factor = -1" in wrong and "\nExplained by smajax explain TOPIC: displacement\n" in wrong
    assert "Explained by" not in right
