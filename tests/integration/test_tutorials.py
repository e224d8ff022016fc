"""Notebooks of docs/tutorials as pages: the build executes them, and shows what their cells print and draw.

The pages themselves are executed by the build of the site only; a small notebook stands for them here.
"""

import json
from pathlib import Path

import jupytext
import pytest

from docs.generate import outputs, tutorial
from docs.generate.outputs import CommandError
from smajax.errors import InputError
from tests.conftest import ROOT

PAGES = sorted((ROOT / "docs" / "tutorials").glob("*.py"))
SITE = ROOT / "build" / "site" / "tutorials"
# Files that a page leaves behind, and lists in its last cell.
EXPECTED_FILES = {
    "close_the_loop": (
        "diagnosis.json",
        "rig-diagnosed.toml",
        "controller.h",
        "controller.json",
        "controller.fmu",
        "tune.json",
    )
}
FIGURE = """
# %% figure="A line"
class Line:
    def to_plotly_json(self):
        return {}

    def to_json(self):
        return '{"data": [], "layout": {"height": 300}}'


Line()
"""


@pytest.fixture
def notebook(tmp_path):
    """Return a function that writes a notebook with a text."""

    def write(text: str) -> Path:
        path = tmp_path / "small.py"
        path.write_text("# %% [markdown]\n# # Small\n" + text, "utf-8")
        return path

    yield write
    tutorial.forget()
    outputs.clean_up()


def test_cells_show_what_they_print_their_last_value_and_their_figure(notebook):
    path = notebook("\n# %%\nx = 2\nprint(x)\n\n# %%\nx + 1\n\n# %%\nx = 4\n" + FIGURE)
    assert tutorial.cell_output(0, path) == ""
    assert tutorial.cell_output(1, path) == "```text\n2\n```"
    assert tutorial.cell_output(2, path) == "```text\n3\n```"
    assert tutorial.cell_output(3, path) == ""
    figure = tutorial.cell_output(4, path)
    assert 'aria-label="A line"' in figure and "height: 300px" in figure and "```" not in figure


@pytest.mark.parametrize(
    "text, message",
    [
        ("# %%\nx = 1\n\n# %%\nx = 1 / 0\n", "cell 2.*ZeroDivisionError"),
        ("# %%\nimport warnings\n\nwarnings.warn('old')\n", "UserWarning: old"),
        (FIGURE.replace(' figure="A line"', ""), "no text"),
        ('# %%\nget("tamu-flexinol-isobarik")\n', "there is no data set"),
    ],
)
def test_an_error_a_warning_and_a_figure_without_text_fail_the_build(notebook, text, message):
    with pytest.raises((CommandError, InputError), match=rf"(?s){message}"):
        tutorial.cell_output(1, notebook(text))


def test_a_page_without_its_recordings_says_so_and_shows_no_outputs(notebook, tmp_path, monkeypatch):
    monkeypatch.setenv("SMAJAX_DATA", str(tmp_path))
    path = notebook('# %%\nfrom smajax.recordings.datasets import get\n\nget("tamu-flexinol-isobaric")\n')
    assert "`tamu-flexinol-isobaric` were not there" in tutorial.cell_output(0, path)
    assert tutorial.cell_output(1, path) == ""


@pytest.mark.parametrize("path", PAGES, ids=lambda path: path.stem)
def test_each_cell_of_a_notebook_has_a_place_for_its_output(path):
    text = tutorial.tutorial_pages()[f"tutorials/{path.stem}.md"]
    cells = [cell for cell in jupytext.read(path).cells if cell.cell_type == "code"]
    numbers = [int(number) for number, name in tutorial.CELL.findall(text) if name == path.name]
    assert numbers == list(range(len(cells) + 1))
    assert any(len(cell.metadata.get("figure", "").split()) > 5 for cell in cells)


@pytest.mark.parametrize("path", PAGES, ids=lambda path: path.stem)
def test_the_built_page_has_its_figures_with_names_on_their_axes_and_lists_its_files(path):
    """The build comes before the tests in CI; elsewhere there may be no site."""
    built = SITE / f"{path.stem}.html"
    if not built.is_file() or built.stat().st_mtime < path.stat().st_mtime:
        pytest.skip("the site is not built, or older than this page")
    text = built.read_text("utf-8")
    if "were not there when this site was built" in text:
        pytest.skip("the recordings of others were not there when the site was built")
    cells = [cell for cell in jupytext.read(path).cells if cell.cell_type == "code"]
    figures = [json.JSONDecoder().raw_decode(part)[0] for part in text.split("Object.assign(")[1:]]
    assert len(figures) == sum("figure" in cell.metadata for cell in cells) > 0
    for figure in figures:
        axes = [axis["title"]["text"] for name, axis in figure["layout"].items() if "axis" in name and "title" in axis]
        assert len(axes) >= 2 and all("[" in title or title == "row" for title in axes), axes
    assert not [name for name in EXPECTED_FILES.get(path.stem, ()) if name not in text]
