"""Result documents: models, published schemas, folders of earlier versions, and errors that name file, key and cure."""

import copy
import json
from pathlib import Path
from typing import Any, get_args

import jsonschema
import pydantic
import pytest

from smajax.control.export.json_document import SCHEMA as CONTROLLER_SCHEMA
from smajax.diagnosis.acceptance import RejectionCode
from smajax.errors import InputError
from smajax.report.documents import DOCUMENTS, ControllerDocument, FitDocument, read_document, read_fit, read_run
from smajax.report.documents.diagnosis import RejectionCode as DocumentedCode
from smajax.report.documents.schemas import schemas, write_schemas
from smajax.report.documents.write import write_result
from smajax.report.prediction import write_predictions
from smajax.report.rebuild import rebuild_report
from smajax.report.result_figures import FIGURES
from smajax.report.summaries import summarise
from smajax.sweeps.table import write_table
from tests.conftest import ROOT
from tests.unit.report.example_documents import CONTROLLER, EXAMPLES, FIT, SIMULATION, example_series, run

_OLD_NAME, _NAME = "material.max_strain", "material.max_transformation_strain"


def changed(document: dict, path: str, value: Any) -> dict:
    """Return a document with another value at a path such as ``solver.code``; ``None`` for an absent key is written."""
    document = copy.deepcopy(document)
    *above, last = path.split("/")
    place: Any = document
    for key in above:
        place = place[int(key) if isinstance(place, list) else key]
    place[last] = value
    return document


def write_run(folder: Path, command: str, document: dict, **more: Any) -> Path:
    """Write the documents of a result folder, and return the folder."""
    folder.mkdir(parents=True, exist_ok=True)
    (folder / "run.json").write_text(json.dumps(run(command, **more)), "utf-8")
    (folder / DOCUMENTS[command].name).write_text(json.dumps(document), "utf-8")
    return folder


@pytest.mark.parametrize("command", EXAMPLES)
def test_a_document_is_read_as_it_was_written(tmp_path, command):
    example = EXAMPLES[command]
    assert DOCUMENTS[command].model.check(example) is example
    document = read_document(write_run(tmp_path, command, example))
    assert isinstance(document, DOCUMENTS[command].model)
    # To the last digit and in the same order.
    assert json.dumps(document.to_dict()) == json.dumps(example)


def test_the_record_of_a_run_and_a_controller_have_models(tmp_path):
    assert read_run(write_run(tmp_path, "fit", FIT)).command == "fit"
    assert read_run(write_run(tmp_path / "s", "simulate", SIMULATION)).timings == {"read": 0.5}
    assert ControllerDocument.check(CONTROLLER) is CONTROLLER and ControllerDocument.SCHEMA == CONTROLLER_SCHEMA
    write_result(tmp_path / "new", {k: v for k, v in run("fit").items() if k != "files"}, lambda folder: None)
    assert read_run(tmp_path / "new").files == ["run.json"]
    with pytest.raises(pydantic.ValidationError):
        write_result(tmp_path / "newer", run("fit") | {"seeds": 3}, lambda folder: None)


def test_values_of_a_fit_by_name(tmp_path):
    entry = read_fit(write_run(tmp_path, "fit", FIT)).parameters["heat.h0"]
    assert entry.value == 100.0 and entry.interval == (90.0, 110.00000000000001) and entry.unit == "W/m^2/K"


@pytest.mark.parametrize(
    ("command", "path", "value", "words"),
    [
        ("fit", "schema", "smajax.fit/1", "schema"),
        ("fit", "seed", None, "seed"),
        ("fit", "seed", True, "seed"),
        ("fit", "solver/code", "bored", "solver.code"),
        ("fit", "recordings", [], "recordings"),
        ("fit", "parameters/heat.h0/estimate", float("nan"), "should be a finite number"),
        ("fit", "parameters/heat.h0/lower95", 120.0, "lower95 is above upper95"),
        ("fit", "indistinct/0/direction", [1.0], "direction and parameters have different lengths"),
        ("fit", "correlations/matrix", [[1.0, 0.5]], "a row and a column for each"),
        ("fit", "profiles/x", FIT["profiles"]["heat.h0"], "profiles.x is none of the parameters"),
        ("fit", "rmse/angle", FIT["rmse"]["displacement"], "rmse and noise_floor have different channels"),
        ("fit", "more", 1, "more"),
        ("diagnose", "verdict", "maybe", "verdict"),
        ("diagnose", "effects", ["backlash"], "backlash is not in the ranking"),
        ("diagnose", "equivalent/backlash", [], "equivalent.backlash is none of the effects"),
        ("diagnose", "recordings", FIT["recordings"], "train, select and holdout"),
        ("diagnose", "left_out", [{"why": "it is saturated"}], "either a channel or an effect"),
        ("compare", "models/0/rmse_holdout", "0.02", "models.0.rmse_holdout"),
        ("tune", "metrics/start", {"rmse": 1.0}, "different names"),
        ("tune", "gains/kp/bounds", [1.0], "gains.kp.bounds"),
        ("sweep", "codes", {"done": 2}, "codes do not add up"),
        ("sweep", "objectives/mass", "min", "objectives.mass is none of the metrics"),
        ("sweep", "metrics/stroke/lowest", "huge", "metrics.stroke.lowest"),
        ("properties", "recordings/0/mean", None, "mean belongs to recordings with cycles"),
        ("simulate", "channels/displacement/unit", 3, "channels.displacement.unit"),
    ],
)
def test_a_document_with_a_fault_is_neither_written_nor_read(tmp_path, command, path, value, words):
    document = changed(EXAMPLES[command], path, value)
    with pytest.raises(pydantic.ValidationError) as refused:
        DOCUMENTS[command].model.check(document)
    assert words in str(refused.value)
    if path in ("schema", "more") or value != value:
        return
    folder = write_run(tmp_path, command, document)
    with pytest.raises(InputError) as error:
        read_document(folder)
    message = str(error.value)
    assert str(folder / DOCUMENTS[command].name) in message and "run the command again" in message
    assert words.replace(".0.", "[0].") in message and "\n" not in message


def test_keys_of_a_later_version_are_kept(tmp_path):
    document = changed(changed(FIT, "more", 1), "solver/restarts", 3)
    assert read_document(write_run(tmp_path, "fit", document)).to_dict()["solver"]["restarts"] == 3
    later = write_run(tmp_path / "later", "fit", FIT | {"schema": "smajax.fit/3"})
    with pytest.raises(InputError, match="later version of smajax, this one reads smajax.fit/1 and smajax.fit/2: upd"):
        read_document(later)
    other = write_run(tmp_path / "other", "fit", FIT | {"schema": "smajax.tune/1"})
    with pytest.raises(InputError, match=r"fit\.json: schema = 'smajax.tune/1' is not that of this file"):
        read_document(other)


def test_a_missing_key_and_a_missing_document_are_named(tmp_path):
    folder = write_run(tmp_path, "fit", {k: v for k, v in FIT.items() if k != "solver"})
    with pytest.raises(InputError, match=r"fit\.json: solver is missing: .*run the command again"):
        read_document(folder)
    failed = write_run(tmp_path / "failed", "diagnose", {}, exit_code=3)
    (failed / "diagnosis.json").unlink()
    with pytest.raises(InputError, match=r"'smajax diagnose' failed \(exit code 3\) and left no diagnosis.json"):
        read_document(failed)
    with pytest.raises(InputError, match="there is no such folder"):
        read_document(tmp_path / "none")


@pytest.mark.parametrize("command", ["fit", "diagnose", "compare", "tune", "sweep"])
def test_documents_of_version_1_are_read_under_the_current_names(tmp_path, command):
    text = json.dumps(EXAMPLES[command]).replace(_NAME, _OLD_NAME).replace("/2", "/1")
    folder = write_run(tmp_path, command, json.loads(text))
    assert read_document(folder).to_dict() == EXAMPLES[command]


def test_the_first_documents_of_version_1_are_readable(tmp_path, shared):
    for command, name in (("fit", "fit"), ("diagnose", "diagnosis")):
        example = json.loads((shared / "design" / "examples" / f"{name}.json").read_text("utf-8"))
        content = read_document(write_run(tmp_path / name, command, example)).to_dict()
        assert content["rmse"] == example["rmse"]
        assert summarise(command, content)


def test_draws_from_a_fit_of_version_1_use_the_current_names(tmp_path):
    text = json.dumps(FIT).replace(_NAME, _OLD_NAME).replace("smajax.fit/2", "smajax.fit/1")
    assert _NAME in read_fit(write_run(tmp_path, "fit", json.loads(text))).parameters


def test_the_published_schemas_are_those_of_the_models(tmp_path):
    published = ROOT / "docs" / "reference" / "schemas"
    written = write_schemas(tmp_path)
    assert sorted(path.name for path in published.iterdir()) == sorted(path.name for path in written)
    for path in written:
        cure = "run python -m smajax.report.documents docs/reference/schemas"
        assert (published / path.name).read_text("utf-8") == path.read_text("utf-8"), cure


def test_the_schemas_accept_what_the_models_accept():
    for command, example in EXAMPLES.items():
        name = "simulation" if command == "simulate" else DOCUMENTS[command].name.removesuffix(".json")
        schema = schemas()[f"{name}.schema.json"]
        jsonschema.Draft202012Validator.check_schema(schema)
        jsonschema.validate(example, schema)
        with pytest.raises(jsonschema.ValidationError):
            jsonschema.validate(example | {"more": 1}, schema)
    jsonschema.validate(run("fit"), schemas()["run.schema.json"])
    jsonschema.validate(CONTROLLER, schemas()["controller.schema.json"])


def test_every_field_has_a_meaning():
    for name, schema in schemas().items():
        for part in [schema, *schema.get("$defs", {}).values()]:
            for key, field in part.get("properties", {}).items():
                assert field.get("description"), f"{name}: {part.get('title')}.{key}"


@pytest.mark.parametrize("command", EXAMPLES)
def test_the_summary_needs_the_document_only(command):
    text = summarise(command, EXAMPLES[command])
    assert text and "out" not in text.splitlines()[-1].split()
    in_folder = summarise(command, EXAMPLES[command], "out")
    assert in_folder.startswith(text.splitlines()[0]) and in_folder.rstrip().endswith("out")


@pytest.mark.parametrize("command", EXAMPLES)
def test_every_command_has_a_figure(command):
    figure: Any = FIGURES[command](EXAMPLES[command], example_series(command))
    names = [trace.name for trace in figure.data]
    expected = {
        "fit": ["measured", "model", "residual of displacement", "current"],
        "diagnose": ["measured", "before", "before", "after", "after"],
        "compare": ["measured", "brinson", "brinson"],
        "tune": ["reference", "start gains", "tuned gains"],
        "sweep": ["satisfies all constraints", "best"],
        "properties": ["cycles.csv"],
        "simulate": ["measured", "model", "residual of displacement", "current"],
    }[command]
    assert [name for name in names if name != "violates a constraint"] == expected
    assert figure.layout.height > 300
    if command == "properties":
        assert len(figure.layout.shapes) == 8
        assert {a.text for a in figure.layout.annotations} == {f"{x}<sub>{y}</sub>" for x in "MA" for y in "sf"}
    assert json.loads(figure.to_json())["data"]


def test_a_fit_document_is_frozen(tmp_path):
    document = read_fit(write_run(tmp_path, "fit", FIT))
    assert isinstance(document, FitDocument)
    with pytest.raises(pydantic.ValidationError):
        document.seed = 3


@pytest.mark.parametrize("command", EXAMPLES)
def test_a_page_is_rebuilt_from_the_folder(tmp_path, command):
    inputs = {"inputs": ["current"]} if command in ("diagnose", "compare") else {}
    folder = write_run(tmp_path, command, EXAMPLES[command], **inputs)
    if command == "sweep":
        write_table(folder / "sweep.parquet", example_series(command))
    else:
        write_predictions(folder / "prediction.csv", example_series(command))
    if command != "properties":
        with pytest.raises(InputError, match=r"rig\.toml: the file cannot be read .*: run the command again"):
            rebuild_report(folder)
        (folder / "rig.toml").write_text("[rig]", "utf-8")
    page = rebuild_report(folder).read_text("utf-8")
    assert page.startswith("<!DOCTYPE html>") and 'id="picture-0"' in page
    assert ("The rig file" in page) == (command != "properties")


def test_a_document_takes_every_code_of_a_rejection():
    assert set(get_args(DocumentedCode)) == set(RejectionCode)
