"""Dependencies: upper bounds have reasons, and the code imports nothing that one system only has."""

import ast
import re
import tomllib

import pytest
from packaging.requirements import Requirement

from tests.conftest import ROOT

PROJECT = tomllib.loads((ROOT / "pyproject.toml").read_text("utf-8"))["project"]
SECTION = (
    (ROOT / "CONTRIBUTING.md").read_text("utf-8").partition("## Versions of dependencies")[2].partition("\n## ")[0]
)
# Modules of the standard library that Windows lacks.
POSIX_ONLY = {"fcntl", "grp", "pty", "pwd", "resource", "syslog", "termios", "tty"}


def test_every_upper_bound_has_its_reason():
    extras = [text for texts in PROJECT["optional-dependencies"].values() for text in texts]
    requirements = [Requirement(text) for text in [*PROJECT["dependencies"], *extras]]
    bounded = {r.name for r in requirements if any(s.operator in ("<", "<=", "==", "~=") for s in r.specifier)}
    reasons = set(re.findall(r"`([\w-]+)` (?:below )?\d", SECTION))
    assert bounded == reasons


@pytest.mark.parametrize("path", sorted((ROOT / "smajax").rglob("*.py")), ids=lambda p: p.relative_to(ROOT).as_posix())
def test_nothing_that_windows_lacks_is_imported(path):
    for node in ast.walk(ast.parse(path.read_text("utf-8"))):
        names = [a.name for a in node.names] if isinstance(node, ast.Import) else []
        names += [node.module or ""] if isinstance(node, ast.ImportFrom) else []
        assert not POSIX_ONLY & {name.partition(".")[0] for name in names}


def test_result_folders_are_replaced_where_two_cannot_be_exchanged(tmp_path, monkeypatch):
    from smajax.files import result_folder

    monkeypatch.setattr(result_folder.sys, "platform", "win32")
    for number in (1, 2):
        result_folder.write_folder(
            tmp_path / "out", {"run": number}, lambda f, n=number: (f / "a.txt").write_text(str(n))
        )
    assert (tmp_path / "out" / "a.txt").read_text() == "2" and [p.name for p in tmp_path.iterdir()] == ["out"]
