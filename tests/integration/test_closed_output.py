"""Help and version whose output cannot be written: the exit codes of every other command, without a traceback."""

import os
import subprocess
import sys
from pathlib import Path

import pytest

COMMANDS = (["--help"], ["--version"], ["fit", "--help"], [])


def run_into(output: int, arguments: list[str]) -> subprocess.CompletedProcess:
    command = [sys.executable, "-m", "smajax", *arguments]
    return subprocess.run(command, stdout=output, stderr=subprocess.PIPE, text=True, timeout=120)


@pytest.mark.parametrize("arguments", COMMANDS, ids=" ".join)
def test_a_full_disk_is_a_sentence(arguments):
    if not Path("/dev/full").exists():
        pytest.skip("needs a file that is always full")
    with open("/dev/full", "w") as full:
        done = run_into(full.fileno(), arguments)
    assert (done.returncode, done.stderr.count("\n")) == (3, 1)
    assert "make room on the disk" in done.stderr


@pytest.mark.parametrize("arguments", COMMANDS, ids=" ".join)
def test_a_closed_pipe_ends_the_command_without_a_word(arguments):
    reader, writer = os.pipe()
    os.close(reader)
    done = run_into(writer, arguments)
    os.close(writer)
    assert (done.returncode, done.stderr) == (130, "")
