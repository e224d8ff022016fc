"""A command and the library without any setting give the same documents to the last digit, each in its own process."""

import json
import os
import subprocess
import sys
from pathlib import Path
from typing import Any

import pytest
import tomlkit

from smajax.recordings.datasets import data_path

BENCH = data_path("recordings", "dead-weight")
FIT = [BENCH / "rig.toml", BENCH / "train.csv"]
# An input-output model of each family but networks, which take minutes; that of the transfer functions is linear algebra
# outside of any loop.
COMPARED = ["bouc-wen", "prandtl-ishlinskii", "hammerstein-wiener", "transfer-function-one-pole"]
# Arguments of the command, the document, and the call in Python.
STUDIES = {
    "fit": ([*FIT, "--holdout", BENCH / "holdout.csv"], "fit.json", "sma.fit({0!r}, {1!r}, holdout={3!r})"),
    "tune": ([BENCH / "rig.toml", "controller.toml"], "tune.json", "sma.tune({0!r}, {1!r})"),
    "diagnose": (
        [*FIT, "--select", BENCH / "select.csv", "--holdout", BENCH / "holdout.csv"],
        "diagnosis.json",
        "sma.diagnose({0!r}, {1!r}, select={3!r}, holdout={5!r})",
    ),
    "compare": (
        [*FIT, "--holdout", BENCH / "holdout.csv", "--models", ",".join(COMPARED)],
        "compare.json",
        "sma.compare({0!r}, {1!r}, holdout={3!r}, models={models})",
    ),
    "simulate": (FIT, "simulation.csv", "sma.predict({0!r}, {1!r})"),
}
PROGRAM = """
import smajax as sma
{call}.save({folder!r})
"""
TIMES = ("wall_s", "compile_s")
# Variables of the tests' own process, which sets JAX up as a command does and stores no programs.
OURS = ("XLA_FLAGS", "EQX_ON_ERROR", "JAX_ENABLE_X64", "SMAJAX_STORED_PROGRAMS")


def without_times(document: Any) -> Any:
    """Return a document without the times that it took."""
    if isinstance(document, dict):
        return {key: without_times(value) for key, value in document.items() if key not in TIMES}
    return [without_times(value) for value in document] if isinstance(document, list) else document


def write_short_controller(path: Path) -> None:
    """The shipped controller with a reference of seconds and fewer searches and draws."""
    shipped = tomlkit.parse(data_path("controllers", "dead-weight.toml").read_text("utf-8"))
    shipped["reference"] |= {"duration": "12 s", "hold": "4 s"}
    shipped["tune"] |= {"starts": 2, "check": 59}
    path.write_text(tomlkit.dumps(shipped), "utf-8")


def run_both(words: list[str], program: str) -> None:
    """Run a command, and a program in Python, each in a process without settings of the tests."""
    clean = {key: value for key, value in os.environ.items() if key not in OURS}
    subprocess.run([sys.executable, "-m", "smajax", *words], env=clean, check=True)
    subprocess.run([sys.executable, "-c", program], env=clean, check=True)


@pytest.mark.slow
@pytest.mark.parametrize("name", STUDIES)
def test_a_command_and_the_library_give_the_same_document(name, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    write_short_controller(tmp_path / "controller.toml")
    arguments, document, call = STUDIES[name]
    texts = [str(argument) for argument in arguments]
    command, library = tmp_path / "command", tmp_path / "library"
    program = PROGRAM.format(call=call.format(*texts, models=COMPARED), folder=str(library))
    run_both([name, *texts, "--out", str(command)], program)
    first, second = ((folder / document).read_text("utf-8") for folder in (command, library))
    if document.endswith(".json"):
        first, second = without_times(json.loads(first)), without_times(json.loads(second))
    assert first == second
    for table in command.glob("*.csv"):
        assert table.read_bytes() == (library / table.name).read_bytes()


# Keys of [sweep]: the cooling of a flexural actuator is no loop of small steps, and derivatives are another program.
SWEEPS = {"flexural": "designs = 16", "dead-weight": "designs = 16\ngradients = true"}


@pytest.mark.slow
@pytest.mark.parametrize("name", SWEEPS)
def test_a_command_and_the_library_give_the_same_sweep(name, tmp_path):
    shipped = tomlkit.parse(data_path("sweeps", f"{name}.toml").read_text("utf-8"))
    (key,) = {"rig", "actuator"} & set(shipped["sweep"])
    subject = data_path("sweeps", f"{name}.toml").parent / shipped["sweep"][key]
    shipped["sweep"] = tomlkit.parse(f"{key} = '{subject}'\n{SWEEPS[name]}")
    shipped.pop("refine", None)
    file, command, library = tmp_path / "sweep.toml", tmp_path / "command", tmp_path / "library"
    file.write_text(tomlkit.dumps(shipped), "utf-8")
    call = f"sma.sweep({str(file)!r})"
    run_both(["sweep", str(file), "--out", str(command)], PROGRAM.format(call=call, folder=str(library)))
    for document in ("sweep.json", "sweep.parquet"):
        assert (command / document).read_bytes() == (library / document).read_bytes()
