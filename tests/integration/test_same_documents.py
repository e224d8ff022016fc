"""A command and the library without any setting give the same documents to the last digit, each in its own process."""

import json
import os
import subprocess
import sys
from typing import Any

import pytest

from smajax.recordings.datasets import data_path

BENCH = data_path("recordings", "dead-weight")
CONTROLLER = data_path("controllers", "dead-weight.toml")
FIT = [BENCH / "rig.toml", BENCH / "train.csv"]
# An input-output model of each family but networks, which take minutes; that of the transfer functions is linear algebra
# outside of any loop.
COMPARED = ["bouc-wen", "prandtl-ishlinskii", "hammerstein-wiener", "transfer-function-one-pole"]
# Arguments of the command, the document, and the call in Python.
STUDIES = {
    "fit": ([*FIT, "--holdout", BENCH / "holdout.csv"], "fit.json", "sma.fit({0!r}, {1!r}, holdout={3!r})"),
    "tune": ([BENCH / "rig.toml", CONTROLLER], "tune.json", "sma.tune({0!r}, {1!r})"),
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
# Variables of the tests' own process, which sets JAX up as a command does.
OURS = ("XLA_FLAGS", "EQX_ON_ERROR", "JAX_ENABLE_X64")


def without_times(document: Any) -> Any:
    """Return a document without the times that it took."""
    if isinstance(document, dict):
        return {key: without_times(value) for key, value in document.items() if key not in TIMES}
    return [without_times(value) for value in document] if isinstance(document, list) else document


@pytest.mark.parametrize("name", STUDIES)
def test_a_command_and_the_library_give_the_same_document(name, tmp_path):
    arguments, document, call = STUDIES[name]
    texts = [str(argument) for argument in arguments]
    command, library = tmp_path / "command", tmp_path / "library"
    program = PROGRAM.format(call=call.format(*texts, models=COMPARED), folder=str(library))
    clean = {key: value for key, value in os.environ.items() if key not in OURS}
    subprocess.run([sys.executable, "-m", "smajax", name, *texts, "--out", str(command)], env=clean, check=True)
    subprocess.run([sys.executable, "-c", program], env=clean, check=True)
    first, second = ((folder / document).read_text("utf-8") for folder in (command, library))
    if document.endswith(".json"):
        first, second = without_times(json.loads(first)), without_times(json.loads(second))
    assert first == second
    for table in command.glob("*.csv"):
        assert table.read_bytes() == (library / table.name).read_bytes()
