"""A command and the library give the same documents to the last digit; each runs in a separate process."""

import json
import subprocess
import sys
from typing import Any

import pytest

from smajax.recordings.datasets import data_path

BENCH = data_path("recordings", "dead-weight")
CONTROLLER = data_path("controllers", "dead-weight.toml")
FIT = [BENCH / "rig.toml", BENCH / "train.csv"]
# Arguments of the command, the document, and the call in Python.
STUDIES = {
    "fit": ([*FIT, "--holdout", BENCH / "holdout.csv"], "fit.json", "sma.fit({0!r}, {1!r}, holdout={3!r})"),
    "tune": ([BENCH / "rig.toml", CONTROLLER], "tune.json", "sma.tune({0!r}, {1!r})"),
}
PROGRAM = """
from smajax.numerics.process import prepare_jax
prepare_jax()
import smajax as sma
{call}.save({folder!r})
"""
TIMES = ("wall_s", "compile_s")


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
    program = PROGRAM.format(call=call.format(*texts), folder=str(library))
    subprocess.run([sys.executable, "-m", "smajax", name, *texts, "--out", str(command)], check=True)
    subprocess.run([sys.executable, "-c", program], check=True)
    first, second = (json.loads((folder / document).read_text("utf-8")) for folder in (command, library))
    assert without_times(first) == without_times(second)
    assert (command / "prediction.csv").read_bytes() == (library / "prediction.csv").read_bytes()
