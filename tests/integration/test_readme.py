"""The README's commands and code, run as they stand there, and its links."""

import os
import re
import shlex
import shutil
import subprocess
import sys
import tomllib

import pytest

from tests.conftest import ROOT

README = (ROOT / "README.md").read_text("utf-8")
BLOCK = re.compile(r"(<!-- not executed: .+? -->\n)?```(\w+)\n(.*?)```", re.DOTALL)
INSTALL = re.compile(r'python3 -m venv \.venv && \.venv/bin/pip install "?\.(?:\[(\w+)\])?"? && \.venv/bin/(.+)')
LONGEST = 150  # lines


def blocks(language: str) -> list[str]:
    """The code blocks of a language that are to be executed."""
    return [text for skipped, name, text in BLOCK.findall(README) if name == language and not skipped]


def commands() -> list[str]:
    """The lines of the shell blocks, continued lines joined and comments left out."""
    text = "".join(blocks("sh")).replace("\\\n", " ")
    return [line for line in (line.partition(" #")[0].strip() for line in text.splitlines()) if line]


def run(words: list[str], folder) -> subprocess.CompletedProcess:
    """A command in a folder, with the checkout's smajax and no screen to open a browser on."""
    environment = {
        k: v for k, v in os.environ.items() if k not in ("DISPLAY", "WAYLAND_DISPLAY", "XLA_FLAGS", "EQX_ON_ERROR")
    }
    environment["PYTHONPATH"] = str(ROOT)
    return subprocess.run(words, cwd=folder, env=environment, capture_output=True, text=True, check=False)


@pytest.fixture
def bench(tmp_path):
    """A folder with the shipped data, as in a fresh clone."""
    shutil.copytree(ROOT / "data", tmp_path / "data")
    return tmp_path


def test_the_readme_is_one_page():
    assert len(README.splitlines()) <= LONGEST


def test_its_links_lead_somewhere():
    targets = re.findall(r"\]\(([^)#]+)\)", README)
    assert targets and not [t for t in targets if not t.startswith("http") and not (ROOT / t).exists()]


def test_its_two_commands_install_what_there_is_and_the_demo_runs(bench):
    installs = [INSTALL.fullmatch(line) for line in commands() if line.startswith("python3 -m venv")]
    assert len(installs) == 2 and all(installs)
    extras = tomllib.loads((ROOT / "pyproject.toml").read_text("utf-8"))["project"]["optional-dependencies"]
    assert {match[1] for match in installs if match} - {None} <= set(extras)
    assert [match[2] for match in installs if match] == ["smajax demo", "python -m pytest"]
    done = run([sys.executable, "-m", "smajax", "demo"], bench)
    assert done.returncode == 0, done.stderr


def test_its_other_commands_run(bench):
    own = [shlex.split(line) for line in commands() if not line.startswith("python3 -m venv")]
    assert {words[0] for words in own} == {"smajax"}
    for words in own:
        done = run([sys.executable, "-m", *words], bench)
        assert done.returncode == 0, f"{shlex.join(words)}\n{done.stderr}"


def test_its_python_runs(bench):
    for text in blocks("python"):
        done = run([sys.executable, "-c", text], bench)
        assert done.returncode == 0, done.stderr
