"""Every block of the README and of the pages: executed here, executed by the build of the site, or marked with a reason.

The blocks of a page run in their order in a clean folder with the shipped data, as those of a reader of the page do.
"""

import json
import os
import shutil
import subprocess
import sys
import tomllib

import pytest
import tomlkit

from docs.generate.blocks import EXECUTED, OUTPUT, REFUSAL, Block, blocks, commands
from smajax.files.material_limits import read_catalogue, read_limits
from smajax.files.parameter_sets import read_parameters
from smajax.files.rig_file import read_rig
from smajax.sweeps.sweep_file import read_sweep
from tests.conftest import ROOT, SHARED
from tests.integration.test_import import OF_OTHERS
from tests.integration.test_readme import INSTALL

TEXTS = {
    path.relative_to(ROOT).as_posix(): path.read_text("utf-8")
    for path in [
        *(ROOT / name for name in ("README.md", "CONTRIBUTING.md", "experiments/README.md")),
        ROOT / "smajax" / "plant" / "effects" / "README.md",
        *sorted((ROOT / "docs").rglob("*.md")),
    ]
}
# Languages of blocks that are files, which are read or compiled here, or a diagram.
SHOWN = ("toml", "c", "mermaid")
# Runs the blocks of a page; those of Python have one namespace.
DRIVER = """
import json, subprocess, sys
namespace = {"__name__": "__main__"}
for language, text, place in json.loads(sys.argv[1]):
    print(place, file=sys.stderr)
    if language == "file":
        with open(place, "w", encoding="utf-8") as file:
            file.write(text)
    elif language == "python":
        exec(compile(text, place, "exec"), namespace)
    else:
        subprocess.run(["bash", "-euo", "pipefail", "-c", text], check=True)
"""


def shown_commands(page: str) -> set[str]:
    """Return the commands whose outputs a page shows, which the build executes."""
    return {" ".join(command.split()) for command in (OUTPUT.findall(TEXTS[page]) + REFUSAL.findall(TEXTS[page]))}


# Commands with shipped data only, which some page shows: their folders are not needed elsewhere.
SHOWN_SOMEWHERE = {c for page in TEXTS for c in shown_commands(page) if " data/" in c}


def is_built(page: str, block: Block) -> bool:
    """Return whether the build of the site executes a shell block."""
    known = shown_commands(page) | SHOWN_SOMEWHERE
    return block.language == "sh" and all(command in known for command in commands(block.text))


def executed(page: str) -> list[Block]:
    """Return the blocks of a page that are executed here; ``test_import.py`` executes those on logs of others."""
    every = [b for b in blocks(TEXTS[page]) if b.language in EXECUTED and not b.reason and not is_built(page, b)]
    every = [b for b in every if b.text not in OF_OTHERS]
    return [b for b in every if not all(INSTALL.fullmatch(c) for c in commands(b.text))]


@pytest.mark.parametrize("page", TEXTS)
def test_no_block_is_left_out_silently(page):
    unknown = [(b.line, b.language) for b in blocks(TEXTS[page]) if b.language not in (*EXECUTED, *SHOWN)]
    assert not unknown, "a block is sh, python or toml; outputs are generated"
    assert TEXTS[page].count("\n```") == 2 * len(blocks(TEXTS[page]))


def test_few_blocks_are_not_executed_and_each_says_why():
    reasons = [block.reason for text in TEXTS.values() for block in blocks(text) if block.reason]
    assert len(reasons) <= 4 and all(len(reason) > 10 for reason in reasons)


PAGES = [page for page in TEXTS if page != "README.md" and executed(page)]


@pytest.mark.slow
@pytest.mark.parametrize("page", PAGES)
def test_the_blocks_of_a_page_run(page, tmp_path):
    tools = tmp_path / "tools"
    tools.mkdir()
    for name, words in (("smajax", "-m smajax"), ("python", "")):
        (tools / name).write_text(f'#!/bin/sh\nexec "{sys.executable}" {words} "$@"\n', "utf-8")
        (tools / name).chmod(0o755)
    folder = tmp_path / "page"
    folder.mkdir()
    shutil.copytree(ROOT / "data", folder / "data")
    (folder / "experiments").symlink_to(ROOT / "experiments")  # as in a checkout
    environment = {k: v for k, v in os.environ.items() if k not in ("DISPLAY", "XLA_FLAGS", "EQX_ON_ERROR")}
    environment |= {"PYTHONPATH": str(ROOT), "PATH": f"{tools}{os.pathsep}{environment['PATH']}"}
    if any("datasets get" in block.text for block in executed(page)):
        if not SHARED.is_dir():
            pytest.skip("the recordings of others are not next to this checkout (../shared)")
        environment["SMAJAX_DATA"] = str(SHARED / "data")
    if any(c.startswith("cc ") for b in executed(page) for c in commands(b.text)) and not shutil.which("cc"):
        pytest.skip("there is no C compiler")
    files = [("file", block.text, block.file) for block in blocks(TEXTS[page]) if block.file]
    steps = files + [(block.language, block.text, f"{page}:{block.line}") for block in executed(page)]
    words = [sys.executable, "-c", DRIVER, json.dumps(steps)]
    done = subprocess.run(words, cwd=folder, env=environment, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr[-3000:]


def merged(sections: dict, block: dict) -> dict:
    """Return a file whose sections are replaced by those of a block; effects are added."""
    effects = {**sections.get("effects", {}), **block.get("effects", {})}
    return {**sections, **block, **({"effects": effects} if effects else {})}


RIGS = {
    page: [tomllib.loads(b.text) for b in blocks(text) if b.language == "toml"]
    for page, text in TEXTS.items()
    if any(b.language == "toml" for b in blocks(text))
}


@pytest.mark.parametrize("page", RIGS)
def test_the_toml_of_a_page_is_a_file_that_is_read(page, tmp_path, monkeypatch):
    """A block of some sections replaces those of the shipped file, or of the block before."""
    monkeypatch.chdir(tmp_path)  # to which the paths of a rig in memory are relative
    folder = ROOT / "data" / "recordings" / "dead-weight"
    shutil.copy(folder / "rig.toml", tmp_path / "example.toml")
    rig, sweep = tomllib.loads((folder / "rig.toml").read_text("utf-8")), {}
    for block in RIGS[page]:
        if block.get("schema") == "smajax.parameters/1":
            path = tmp_path / "my-alloy.toml"
            path.write_text(tomlkit.dumps(block), "utf-8")
            if "limits" in block or "catalogue" in block:
                assert read_limits(path, "set") is not None and read_catalogue(path, "set") is not None
            else:
                assert read_parameters(path)
        elif "sweep" in block:
            sweep = block if "schema" in block else merged(sweep, block)
            (tmp_path / "bench").mkdir(exist_ok=True)
            shutil.copy(folder / "rig.toml", tmp_path / "bench" / "example.toml")
            path = tmp_path / "sweep.toml"
            path.write_text(tomlkit.dumps({"schema": 1, **sweep}), "utf-8")
            read_sweep(path)
        elif "project" in block:
            assert all(group.startswith("smajax.") for group in block["project"]["entry-points"])
        else:
            rig = merged(rig, block)
            read_rig({name: content for name, content in rig.items() if content})
