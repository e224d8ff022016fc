"""The experiments on recordings by others: what they read, and what they say of folders that they cannot use. Their fits are no tests."""

import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

from tests.conftest import ROOT


def run(name: str, *words: str) -> subprocess.CompletedProcess:
    command = [sys.executable, str(ROOT / "experiments" / f"{name}.py"), *words]
    return subprocess.run(command, capture_output=True, text=True, cwd=ROOT, check=False)


def levels(folder: Path, *stresses: int) -> Path:
    """A folder of cycles as ``...MPa.txt``: temperature, strain, stress."""
    temperature = np.concatenate([np.linspace(20, 140, 40), np.linspace(140, 20, 40)])
    for stress in stresses:
        strain = 0.03 / (1 + np.exp((temperature - 70) / 5))
        np.savetxt(folder / f"isobaric_{stress}MPa.txt", np.column_stack([temperature, strain, np.full(80, stress)]))
    return folder


@pytest.mark.parametrize("name", ["measured_isobaric", "measured_muscle_electric"])
def test_a_folder_that_is_not_there_is_named(name, tmp_path):
    done = run(name, "--data", str(tmp_path / "nowhere"))
    assert done.returncode == 2
    assert "nowhere" in done.stderr and "--data" in done.stderr


def test_a_level_that_is_not_there_is_refused_with_those_that_are(tmp_path):
    done = run("measured_isobaric", "--data", str(levels(tmp_path, 50, 100, 200)), "--holdout", "150")
    assert done.returncode == 2
    assert "50, 100, 200 MPa" in done.stderr


def test_two_levels_are_too_few(tmp_path):
    done = run("measured_isobaric", "--data", str(levels(tmp_path, 50, 150)), "--holdout", "150")
    assert done.returncode == 2
    assert "at least three" in done.stderr


def test_the_measured_levels_are_found(shared):
    done = run("measured_isobaric", "--data", str(shared / "data" / "tamu-flexinol-isobaric"), "--holdout", "1")
    assert done.returncode == 2
    assert "50, 100, 150, 172, 200 MPa" in done.stderr
