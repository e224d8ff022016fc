"""The commands on the pages of the documentation: each is one that smajax has, with files that are there."""

import shlex
import shutil

import pytest
import typer
from typer.testing import CliRunner

from smajax.app.cli import app
from tests.conftest import ROOT
from tests.integration.test_readme import blocks

PAGES = sorted((ROOT / "docs").rglob("*.md"))
# Files that a page begins with: shipped ones, and those of ``smajax init dead-weight --out bench``.
PRESENT = ("data/", "bench/")


def lines(page: str) -> list[str]:
    """Return the smajax commands of a page, without comments and line continuations."""
    text = "".join(blocks("sh", page)).replace("\\\n", " ")
    return [line.partition(" #")[0].strip() for line in text.splitlines() if line.startswith("smajax ")]


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    """Return a folder with the shipped data and the files of ``init``."""
    folder = tmp_path_factory.mktemp("docs")
    shutil.copytree(ROOT / "data", folder / "data")
    assert CliRunner().invoke(app, ["init", "dead-weight", "--out", str(folder / "bench")]).exit_code == 0
    return folder


@pytest.mark.parametrize("page", [p for p in PAGES if lines(p.read_text("utf-8"))], ids=lambda p: p.stem)
def test_each_command_of_a_page_is_understood(page, folder, monkeypatch):
    monkeypatch.chdir(folder)

    def stop(*_: object, **__: object):  # the work itself is tested elsewhere
        raise typer.Exit(1)

    for module in ("models", "designs", "files", "properties"):
        monkeypatch.setattr(f"smajax.app.command_line.{module}.start_run", stop)
    for line in lines(page.read_text("utf-8")):
        words = shlex.split(line)[1:]
        if words[0] in ("init", "import"):  # they write; other tests cover the pages about them
            continue
        missing = [word for word in words if word.startswith(PRESENT) and not (folder / word).exists()]
        assert not missing, line
        result = CliRunner().invoke(app, words)
        assert "Usage:" not in result.output, f"{line}\n{result.output}"
        if "there is no such file" not in result.output:  # a file of the reader's own, such as RIG
            assert result.exit_code in (0, 1), f"{line}\n{result.output}"
