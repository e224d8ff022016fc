"""The executable tutorials: each jupytext page of docs/tutorials runs from its first to its last cell in an empty folder."""

import os
from pathlib import Path

import jupytext
import nbclient
import pytest

from tests.conftest import ROOT

PAGES = sorted((ROOT / "docs" / "tutorials").glob("*.py"))
CELL_SECONDS = 900
# Settings of the tests that a user does not have.
TEST_VARIABLES = ("XLA_FLAGS", "EQX_ON_ERROR", "JAX_ENABLE_X64")
# Files that a page leaves behind.
EXPECTED_FILES = {
    "close_the_loop": (
        "diagnosis/diagnosis.json",
        "diagnosis/rig-diagnosed.toml",
        "controller/controller.h",
        "controller/controller.json",
        "controller/controller.fmu",
        "controller/tune.json",
    )
}


@pytest.mark.slow
@pytest.mark.parametrize("page", PAGES, ids=lambda path: path.stem)
@pytest.mark.filterwarnings("ignore::DeprecationWarning", "ignore::ResourceWarning")
def test_a_page_runs_from_its_first_to_its_last_cell(page: Path, shared, tmp_path, monkeypatch):
    for name in TEST_VARIABLES:
        monkeypatch.delenv(name, raising=False)
    monkeypatch.setenv("SMAJAX_DATA", str(shared / "data"))
    monkeypatch.setenv("PYTHONPATH", os.pathsep.join([str(ROOT), os.environ.get("PYTHONPATH", "")]))
    monkeypatch.setenv("IPYTHONDIR", str(tmp_path / ".ipython"))
    folder = tmp_path / "work"
    folder.mkdir()
    notebook = jupytext.read(page)
    client = nbclient.NotebookClient(
        notebook, timeout=CELL_SECONDS, kernel_name="python3", resources={"metadata": {"path": str(folder)}}
    )
    client.execute()
    missing = [name for name in EXPECTED_FILES.get(page.stem, ()) if not (folder / name).is_file()]
    assert not missing
    cells = [cell for cell in notebook.cells if cell.cell_type == "code"]
    streams = [o.text for cell in cells for o in cell.outputs if o.output_type == "stream" and o.name == "stderr"]
    assert not [text for text in streams if "Warning" in text]
