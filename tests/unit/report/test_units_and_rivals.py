"""Units of the rig's files in summaries and pages, and effects with a smaller error than the one named."""

import copy
import dataclasses

import pytest

import smajax as sma
from smajax import parameters
from smajax.files.file_units import file_units
from smajax.files.rig_file import parse_rig
from smajax.recordings.datasets import data_path
from smajax.report import diagnosis_page, diagnosis_summary, run_pages, summary
from smajax.report.documents import DiagnosisDocument
from tests.unit.report.example_documents import DIAGNOSIS

FOLDER = data_path("recordings", "dead-weight")


@pytest.fixture(scope="module")
def text():
    return (FOLDER / "rig.toml").read_text("utf-8")


def units_of(rig):
    return {name: declaration.unit for name, declaration in parameters.all_declarations(rig.plant).items()}


def test_units_are_those_of_the_file_where_it_gives_one(text):
    changed = text.replace('length = "230 mm"', 'length = "23 cm"').replace('mass = "0.2 kg"', 'mass = "200 g"')
    assert changed != text
    rig = parse_rig(changed)
    units = file_units(rig, units_of(rig))
    assert units["wire.length"] == "cm" and units["load.mass"] == "g"
    assert units["material.max_transformation_strain"] == "%"
    assert "material.austenite_shift" not in units  # the file does not give it
    assert file_units(dataclasses.replace(rig, text=None), units_of(rig)) == {}


@pytest.mark.slow
def test_a_fit_is_told_in_these_units_with_nominal_values_and_temperatures(text):
    changed = text.replace('mass = "0.2 kg"', 'mass = "210 g"')
    free = ("load.mass", "material.max_transformation_strain", "material.austenite_shift")
    rig = parse_rig(changed)
    rig = dataclasses.replace(rig, fit=dataclasses.replace(rig.fit, free=free, starts=1))
    study = sma.fit(rig, rig.read(FOLDER / "train.csv").slice(0.0, 40.0))
    entry = study.document["parameters"]["load.mass"]
    assert entry["unit"] == "kg" and entry["file_unit"] == "g" and entry["nominal"] == pytest.approx(0.21)
    cells = [line.split() for line in str(study).splitlines()]
    (row,) = (line for line in cells if line[:1] == ["load.mass"])
    assert row[1] == "210" and float(row[2]) == pytest.approx(1e3 * entry["estimate"], rel=0.01) and "g" in row
    (strain,) = (line for line in cells if line[:1] == ["material.max_transformation_strain"])
    assert strain[1] == "4.1" and strain[-1] == "%"
    shift = study.parameters["material.austenite_shift"].value
    temperatures = study.document["transformation_temperatures"]
    assert temperatures["material.austenite_start"] == pytest.approx(64.0 + shift)
    assert temperatures["material.martensite_start"] == 50.0
    assert f"M_f 36.0, M_s 50.0, A_s {64.0 + shift:.1f}, A_f {80.0 + shift:.1f} degC." in str(study)
    assert "Transformation temperatures at zero stress" in run_pages.parameter_table(study.document)


def test_earlier_documents_have_no_nominal_values():
    assert summary.readable(0.041, None, None, unit="1", shown="%")[0] == "4.1"
    assert summary.temperature_sentences({}) == []


def with_ranking(*others, **changes):
    """Return a diagnosis that names latent-heat and has further entries of its ranking: (key, error)."""
    document = copy.deepcopy(DIAGNOSIS) | changes
    (named,) = document["ranking"]
    document["ranking"] += [named | {"key": key, "refit_rmse_select": error} for key, error in others]
    return document


def test_strengths_and_errors_have_the_units_of_their_kind():
    assert "The rig has latent-heat of 80 MJ/m^3 (95 %: 70 to 90 MJ/m^3)" in " ".join(
        diagnosis_summary.sentences(DIAGNOSIS)
    )
    length = with_ranking() | {"effects": ["backlash"]}
    length["ranking"] = [
        DIAGNOSIS["ranking"][0]
        | {"key": "backlash", "unit": "m", "strength": 2.97e-4, "lower95": 2.9e-4, "upper95": 3.04e-4}
    ]
    assert "backlash of 0.297 mm (95 %: 0.29 to 0.304 mm)" in " ".join(diagnosis_summary.sentences(length))
    page = "".join(diagnosis_page.effects_section(DIAGNOSIS))
    assert "error after refit, mm" in page and "80 ± 10" in page and "MJ/m" in page
    assert "RMSE of displacement on the selection recording, in mm" in page


def test_a_rival_with_a_smaller_error_is_explained():
    assert diagnosis_summary.rival_sentences(with_ranking(("coating", 0.03))) == []
    (by_choice,) = diagnosis_summary.rival_sentences(with_ranking(("coating", 0.019)))
    assert by_choice.startswith("coating alone has a smaller error on the selection recording than latent-heat alone")
    assert "(0.019 against 0.02 mm)" in by_choice and "training and selection recording together" in by_choice
    (rejected,) = diagnosis_summary.rival_sentences(with_ranking(("backlash", 0.019)))
    assert rejected.endswith("and is not named: it is absorbed.")
    (equivalent,) = diagnosis_summary.rival_sentences(
        with_ranking(("coating", 0.019), equivalent={"latent-heat": ["coating"]})
    )
    assert "do not distinguish it" in equivalent
    assert by_choice in diagnosis_summary.sentences(with_ranking(("coating", 0.019)))


def test_a_diagnosis_begins_with_what_its_recordings_show():
    text = "own.csv: displacement begins at 12.4 mm where the rig is at 0: subtract it."
    entry = {"code": "offset", "channel": "displacement", "recordings": ["own.csv"], "text": text}
    document = with_ranking() | {"bench": [entry]}
    DiagnosisDocument.check(document)
    assert diagnosis_summary.text(document).startswith(f"{text}\n\nVerdict: named\n")
    assert diagnosis_summary.sentences(document)[0] == text
    words = " ".join(diagnosis_summary.sentences(document))
    assert "The rig has" not in words and "The rig has latent-heat" in " ".join(diagnosis_summary.sentences(DIAGNOSIS))
    assert "With the recordings as they are, latent-heat of 80 MJ/m^3" in words
    assert "what they show about their bench: correct that first, and diagnose again." in words
