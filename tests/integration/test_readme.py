"""README: its commands and code run, and its links exist."""

import os
import re
import shlex
import shutil
import subprocess
import sys
import tomllib

import pytest

from docs.generate.blocks import blocks, commands
from tests.conftest import ROOT

README = (ROOT / "README.md").read_text("utf-8")
INSTALL = re.compile(r'python3 -m venv \.venv && \.venv/bin/pip install "?\.(?:\[(\w+)\])?"? && \.venv/bin/(.+)')
LONGEST = 150  # lines


def executed(language: str) -> list[str]:
    """Return the code blocks of a language that are executed."""
    return [block.text for block in blocks(README) if block.language == language and not block.reason]


def readme_commands() -> list[str]:
    """Return the commands of the shell blocks."""
    return [command for text in executed("sh") for command in commands(text)]


def run(words: list[str], folder) -> subprocess.CompletedProcess:
    """Run a command in a folder with the smajax of the checkout and without a display."""
    environment = {
        k: v for k, v in os.environ.items() if k not in ("DISPLAY", "WAYLAND_DISPLAY", "XLA_FLAGS", "EQX_ON_ERROR")
    }
    environment["PYTHONPATH"] = str(ROOT)
    return subprocess.run(words, cwd=folder, env=environment, capture_output=True, text=True, check=False)


@pytest.fixture
def bench(tmp_path):
    """Return a folder with the shipped data, as in a fresh clone."""
    shutil.copytree(ROOT / "data", tmp_path / "data")
    return tmp_path


def test_the_readme_is_one_page():
    assert len(README.splitlines()) <= LONGEST


def test_links_exist():
    targets = re.findall(r"\]\(([^)#]+)\)", README)
    assert targets and not [t for t in targets if not t.startswith("http") and not (ROOT / t).exists()]


@pytest.mark.slow
def test_the_installation_commands_and_the_demo(bench):
    installs = [INSTALL.fullmatch(line) for line in readme_commands() if line.startswith("python3 -m venv")]
    assert len(installs) == 2 and all(installs)
    extras = tomllib.loads((ROOT / "pyproject.toml").read_text("utf-8"))["project"]["optional-dependencies"]
    assert {match[1] for match in installs if match} - {None} <= set(extras)
    assert [match[2] for match in installs if match] == ["smajax demo", "python -m pytest"]
    result = run([sys.executable, "-m", "smajax", "demo"], bench)
    assert result.returncode == 0, result.stderr


@pytest.mark.slow
def test_the_other_commands_run(bench):
    arguments = [shlex.split(line) for line in readme_commands() if not line.startswith("python3 -m venv")]
    assert {words[0] for words in arguments} == {"smajax"}
    for words in arguments:
        result = run([sys.executable, "-m", *words], bench)
        assert result.returncode == 0, f"{shlex.join(words)}\n{result.stderr}"


@pytest.mark.slow
def test_the_python_code_runs(bench):
    for text in executed("python"):
        result = run([sys.executable, "-c", text], bench)
        assert result.returncode == 0, result.stderr
