"""Checks of files before JAX is loaded: the sentences of the full check, and nothing of what needs the plant."""

import json
import os
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path

import pytest

from smajax import parameters
from smajax.app.command_line.early_checks import check_files
from smajax.control.controller_file.read import read_controller
from smajax.errors import InputError
from smajax.files.actuator_file import read_actuator
from smajax.files.rig_classes import rig_classes, without_classes
from smajax.files.rig_file import read_rig
from smajax.files.rig_sections import check_rig_sections
from smajax.files.templates import write_actuator_example, write_example
from smajax.plant.materials.registry import MATERIALS
from smajax.recordings.datasets import data_path
from smajax.sweeps.sweep_file import read_sweep
from tests.conftest import ROOT

KINDS = [path.stem for path in sorted(data_path("templates").glob("*.toml"))]
# Changes of the files of a wire that lifts a weight, text by text; a new text after "+" is put at the end.
RIG_MISTAKES = {
    "unknown section": ("[heat]", "[hoat]"),
    "unknown table": ("+", "[extra]\nx = 1\n"),
    "key outside": ("schema = 1", 'schema = 1\nmass = "0.2 kg"'),
    "unknown key": ("h0 =", "h00 ="),
    "key of another section": ('mass = "0.2 kg"', 'mass = "0.2 kg"\nlength = "2 m"'),
    "key of another kind": ('mass = "0.2 kg"', 'mass = "0.2 kg"\nstiffness = "2 N/m"'),
    "section of another kind": ("+", '[spring]\nstiffness = "2 N/m"\n'),
    "key of another law": ("[heat]", "hardening = 2\n[heat]"),
    "schema": ("schema = 1", "schema = 7"),
    "wrong type": ("[fit]", "[fit]\nstarts = 1.5"),
    "list for text": ('model = "brinson"', 'model = ["brinson"]'),
    "value too large": ("[fit]", "[fit]\nseed = -1"),
    "unknown kind": ('kind = "dead-weight"', 'kind = "dead-wait"'),
    "actuator": ('kind = "dead-weight"', 'kind = "knee"'),
    "unknown control": ('control = "current"', 'control = "curent"'),
    "no control": ('control = "current"', ""),
    "no rig": ("[rig]", "[rug]"),
    "unknown law": ('model = "brinson"', 'model = "brinsen"'),
    "unknown word": ('interpolation = "linear"', 'interpolation = "cubic"'),
    "wrong unit": ('diameter = "0.15 mm"', 'diameter = "0.15 kg"'),
    "unknown unit": ('diameter = "0.15 mm"', 'diameter = "0.15 mmm"'),
    "no number": ('diameter = "0.15 mm"', 'diameter = "thin"'),
    "out of bounds": ('diameter = "0.15 mm"', 'diameter = "15 m"'),
    "missing value": ('length = "230 mm"', ""),
    "wrong order": ('austenite_finish = "80 degC"', 'austenite_finish = "8 degC"'),
    "several cells of a path": ('kind = "dead-weight"', 'kind = "path"\nx = 1'),
    "cells": ("[wire]", '[wire]\ncells = "9"'),
    "old name twice": ("[material]", '[material]\nmax_strain = "4 %"'),
    "parameter set": ('control = "current"', 'control = "current"\nparameters = "flexinal"'),
    "missing set": ('control = "current"', 'control = "current"\nparameters = "none.toml"'),
    "unknown effect": ("+", '[effects.backlush]\nwidth = "1 mm"\n'),
    "key of an effect": ("+", '[effects.latent-heat]\nstrongth = "60 MJ/m^3"\n'),
    "effect's unit": ("+", '[effects.latent-heat]\nstrength = "60 MPa/K"\n'),
    "effects no section": ("schema = 1", "schema = 1\neffects = 3"),
    "sensor": ("+", "[sensor]\ndisplacement_gian = 1.0\n"),
    "sensor of no channel": ("+", "[sensor]\nangle_gain = 1.0\n"),
    "channels": ("+", '[channels]\ndisplacment = "x"\n'),
    "column": ("+", '[channels]\ndisplacement = {colum = "x"}\n'),
    "unit of a column": ("+", '[channels]\ndisplacement = {column = "x", unit = "kg"}\n'),
    "recording": ("+", "[recording]\nskip_row = 3\n"),
    "delimiter": ("+", '[recording]\ndecimal = ","\ndelimiter = ","\n'),
    "free": ('"heat.h0"', '"heat.h00"'),
    "free without section": ('"heat.h0"', '"h0"'),
    "free twice": ('"heat.h0"', '"heat.h2"'),
    "tie and member": ('"heat.h0"', '"heat.capacity_austenite"'),
    "initial": ("[fit]", '[fit]\ninitial = ["temprature"]'),
    "observe": ('observe = ["displacement"]', 'observe = ["displacment"]'),
    "observed input": ('observe = ["displacement"]', 'observe = ["current"]'),
    "bounds": ("[fit]", '[fit]\nbounds = {"heat.h0" = ["150 W/m^2/K", "200 W/m^2/K"]}'),
    "bounds' name": ("[fit]", '[fit]\nbounds = {"heat.h" = ["50 W/m^2/K", "200 W/m^2/K"]}'),
    "bounds' unit": ("[fit]", '[fit]\nbounds = {"heat.h0" = ["50 W", "200 W"]}'),
    "noise": ("[fit]", '[fit]\nnoise = {displacment = "1 mm"}'),
    "noise's unit": ("[fit]", '[fit]\nnoise = {displacement = "1 A"}'),
    "input noise": ("[fit]", '[fit]\ninput_noise = "1 mm"'),
}
CONTROLLER_MISTAKES = {
    "unknown section": ("[tune]", "[tone]"),
    "missing section": ("[gains]", "[sensor]\nnoise = 1\n[limits]"),
    "schema": ("schema = 1", "schema = true"),
    "unknown kind": ('kind = "pid"', 'kind = "pdi"'),
    "unknown key": ('period = "20 ms"', 'perod = "20 ms"'),
    "wrong type": ('period = "20 ms"', "period = 20"),
    "tune": ("starts = 4", "start = 4"),
    "tune's value": ("starts = 4", "starts = 0"),
    "limits": ('temperature = "110 degC"', 'temprature = "110 degC"'),
    "sensor": ('noise = "5 um"', 'nose = "5 um"'),
    "reference": ('hold = "20 s"', 'hald = "20 s"'),
    "reference's kind": ('kind = "staircase"', 'kind = "stairs"'),
    "key of another reference": ('hold = "20 s"', 'hold = "20 s"\nfrequency = "1 Hz"'),
    "change": ("+", '[[change]]\nparametr = "load.mass"\n'),
    "robust": ("+", "[robust]\ndraw = 8\n"),
    "limiter": ("+", '[temperature_limiter]\nlimit = "110 degC"\nkq = "1 A/K"\n'),
    "old section twice": ("+", "[guard]\nkp = 1\n[temperature_limiter]\nkp = 1\n"),
}
SWEEP_MISTAKES = {
    "unknown section": ("[objectives]", "[objective]"),
    "unknown table": ("schema = 1", "schema = 1\nextra = 1"),
    "tie": ("[objectives]", '[parameters.heat]\ncapacity = ["1 J/m^3/K", "2 J/m^3/K"]\n[objectives]'),
    "no sweep": ("[sweep]", "[swoop]"),
    "schema": ("schema = 1", "schema = 2"),
    "unknown key": ("designs = 1024", "design = 1024"),
    "wrong type": ("designs = 1024", 'designs = "1024"'),
    "unknown word": ('sampling = "sobol"', 'sampling = "sobel"'),
    "no such rig": ('rig = "example.toml"', 'rig = "exampel.toml"'),
    "input": ("duty = 0.5", "dutty = 0.5"),
    "wave": ('wave = "square"', 'wave = "squares"'),
    "no input": ("[input]", "[refine]\n[inputs]"),
    "parameter": ("wire.diameter =", "wire.diametre ="),
    "another parameter": ("input.amplitude =", "input.amplitud ="),
    "range": ('["0.1 mm", "0.3 mm"]', '["0.1 mm"]'),
    "range's unit": ('["0.1 mm", "0.3 mm"]', '["0.1 kg", "0.3 kg"]'),
    "empty range": ('["0.1 mm", "0.3 mm"]', '["0.3 mm", "0.1 mm"]'),
    "key of a range": ('scale = "log" }\ninput', 'scle = "log" }\ninput'),
    "constraint": ('{ at_most = "170 MPa" }', '{ at_mast = "170 MPa" }'),
    "refine": ("starts = 3", "begins = 3"),
    "margins": ("+", "[margins]\nvery = 1\n"),
}
ACTUATOR_MISTAKES = {
    "unknown section": ("[rig]", "[extra]\nx = 1\n[rig]"),
    "unknown key": ("[wire]", "[wire]\ndiametre = 1"),
    "wrong unit": ('diameter = "0.3 mm"', 'diameter = "0.3 kg"'),
    "missing value": ('diameter = "0.3 mm"', ""),
}


@pytest.fixture(scope="module")
def example(tmp_path_factory) -> Path:
    """The files that ``smajax init dead-weight`` writes."""
    folder = tmp_path_factory.mktemp("example")
    write_example("dead-weight", folder)
    return folder


def changed(path: Path, change: tuple[str, str]) -> Path:
    """Write a file with a mistake next to one without."""
    text, (old, new) = path.read_text("utf-8"), change
    assert old in text or old == "+"
    copy = path.with_name(f"wrong-{path.name}")
    copy.write_text(f"{text}\n{new}" if old == "+" else text.replace(old, new, 1), "utf-8")
    return copy


def sentences(check: Callable[[], object], full: Callable[[], object]) -> tuple[str, str]:
    """Return the sentences of both checks of a file with a mistake."""
    errors = []
    for function in (check, full):
        with pytest.raises(InputError) as caught:
            function()
        errors.append(str(caught.value))
    return errors[0], errors[1]


@pytest.mark.parametrize("mistake", RIG_MISTAKES)
def test_a_mistake_in_a_rig_gives_the_sentence_of_the_full_check(example, mistake):
    path = changed(example / "example.toml", RIG_MISTAKES[mistake])
    early, full = sentences(lambda: check_files(toml={"rig": path}), lambda: read_rig(path))
    assert early == full


@pytest.mark.parametrize("mistake", CONTROLLER_MISTAKES)
def test_a_mistake_in_a_controller_gives_the_sentence_of_the_full_check(example, mistake):
    rig, path = example / "example.toml", changed(example / "controller.toml", CONTROLLER_MISTAKES[mistake])
    early, full = sentences(
        lambda: check_files(toml={"rig": rig, "controller": path}), lambda: read_controller(path, read_rig(rig))
    )
    assert early == full


@pytest.mark.parametrize("mistake", SWEEP_MISTAKES)
def test_a_mistake_in_a_sweep_gives_the_sentence_of_the_full_check(example, mistake):
    path = changed(example / "sweep.toml", SWEEP_MISTAKES[mistake])
    early, full = sentences(lambda: check_files(toml={"sweep": path}), lambda: read_sweep(path))
    assert early == full


@pytest.mark.parametrize("mistake", ACTUATOR_MISTAKES)
def test_a_mistake_in_an_actuator_gives_the_sentence_of_the_full_check(tmp_path, mistake):
    path = changed(write_actuator_example("flexural", tmp_path)[0], ACTUATOR_MISTAKES[mistake])
    early, full = sentences(lambda: check_files(toml={"file": path}), lambda: read_actuator(path))
    assert early == full


@pytest.mark.parametrize(
    ("old", "new"), [("0.02,", "0.02x,"), ("current [A]", "curent [A]"), ("current [A]", "current [kg]")]
)
def test_a_mistake_in_a_recording_gives_the_sentence_of_the_full_check(example, old, new):
    rig, path = example / "example.toml", changed(example / "train.csv", (old, new))
    early, full = sentences(lambda: check_files(toml={"rig": rig}, recordings=[path]), lambda: read_rig(rig).read(path))
    assert early == full


@pytest.mark.parametrize("kind", KINDS)
def test_correct_files_pass_and_have_the_parameters_of_the_plant(tmp_path, kind):
    _, path, recordings, others, _ = write_example(kind, tmp_path)
    check_files(toml={"rig": path}, recordings=recordings)
    for other in others:
        check_files(toml={"file": other})
    rig = read_rig(path)
    with without_classes():
        checked = check_rig_sections(path.read_text("utf-8"), str(path), tmp_path)
    table = parameters.all_declarations(rig.plant)
    unused = {"initial.temperature"} if rig.plant.drive.control == "" else set()
    assert list(checked.parameters) == [name for name in table if name not in unused]
    assert {n: (d.unit, d.lower, d.upper) for n, d in checked.parameters.items()} == {
        n: (d.unit, d.lower, d.upper) for n, d in table.items() if n not in unused
    }
    assert checked.required == (*rig.plant.signals, *rig.plant.required_surroundings)
    assert checked.observed == rig.fit.observe


def test_shipped_tables_are_those_of_the_classes():
    # In a separate process, in which no other test has registered a class.
    program = "from docs.generate import class_tables; print(class_tables.text())"
    printed = subprocess.run([sys.executable, "-c", program], cwd=ROOT, capture_output=True, text=True, check=True)
    shipped = data_path("classes.json").read_text("utf-8")
    assert json.loads(shipped) == json.loads(printed.stdout), "run python -m docs.generate.class_tables"


def test_a_registered_class_is_left_to_the_full_check(example, monkeypatch):
    path = changed(example / "example.toml", ('model = "brinson"', 'model = "my-law"'))
    monkeypatch.setattr("smajax.files.rig_classes.has_installed_classes", lambda: True)
    check_files(toml={"rig": path})
    monkeypatch.undo()
    monkeypatch.setitem(MATERIALS._added, "my-law", MATERIALS["brinson"])
    check_files(toml={"rig": path})
    assert rig_classes().materials["my-law"] is MATERIALS["brinson"]
    with without_classes():
        assert "my-law" not in rig_classes().materials


@pytest.mark.slow
@pytest.mark.parametrize(
    ("words", "code"),
    [
        (("fit", "wrong-rig.toml", "train.csv", "--out", "result"), 2),
        (("check", "wrong-rig.toml"), 2),
        (("check", "example.toml", "wrong-train.csv"), 2),
        (("tune", "example.toml", "wrong-controller.toml", "--out", "result"), 2),
        (("sweep", "wrong-sweep.toml", "--out", "result"), 2),
        (("fit", "--nothing"), 2),
        (("fit", "example.toml", "missing.csv", "--out", "result"), 2),
    ],
)
def test_a_mistake_is_told_before_jax_is_loaded(example, words, code):
    for name, change in (("controller.toml", ("kp =", "kp = 1\nkq =")), ("train.csv", ("0.02,", "0.02x,"))):
        changed(example / name, change)
    changed(example / "example.toml", ("h0 =", "h00 =")).rename(example / "wrong-rig.toml")
    changed(example / "sweep.toml", ("wire.diameter =", "wire.diametre ="))
    changed(example / "controller.toml", ("starts = 4", "begins = 4"))
    program = "import sys; from smajax.app.cli import app\ntry: app()\nfinally: print('jax' in sys.modules)"
    result = subprocess.run(
        [sys.executable, "-c", program, *words],
        capture_output=True,
        text=True,
        cwd=example,
        env=os.environ | {"PYTHONPATH": str(ROOT)},
    )
    assert result.returncode == code and result.stdout.strip() == "False", result.stderr
    assert result.stderr.count("\n") == 1 and result.stderr.startswith("smajax: ")
