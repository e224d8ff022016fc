"""The generated parts of the documentation: complete, and with a meaning for each key."""

import re
import tomllib

import pytest
from pydantic import BaseModel

import smajax
from docs.generate import api, bibliography, blocks, effect_equations, figures, formulas, keys, markdown, outputs, pages
from smajax.control.controller_file import schema as controller
from smajax.files import channel_settings, material_limits, parameter_sets, rig_schema, rig_structure
from smajax.files.rig_file import read_rig
from smajax.plant.effects import catalogue
from smajax.report.topics import read_topics
from smajax.sweeps import axis_sections, goal_sections, input_section, margin_section, sweep_file
from tests.conftest import ROOT
from tests.support.browser import drawn_page

MODULES = (
    rig_schema,
    rig_structure,
    channel_settings,
    material_limits,
    parameter_sets,
    controller,
    sweep_file,
    axis_sections,
    goal_sections,
    input_section,
    margin_section,
)
SECTIONS = {
    f"{module.__name__}.{name}": model
    for module in MODULES
    for name, model in vars(module).items()
    if isinstance(model, type) and issubclass(model, BaseModel) and model.__module__ == module.__name__
}
MARKER = re.compile(r"^<!-- generated: ([\w-]+) -->$", re.MULTILINE)


def test_the_page_of_other_actuators_has_every_key_of_the_shipped_files():
    text = pages.PARTS["device-keys"]()
    for path in sorted((ROOT / "data" / "actuators").glob("*/rig.toml")):
        kind = path.parent.name
        part = text.partition(f"\n## {kind} ")[2].partition("\n## ")[0]
        for section, keys_of in tomllib.loads(path.read_text("utf-8")).items():
            if section not in ("schema", "rig"):
                rows = part.partition(f"\n### [{section}] ")[2].partition("\n### ")[0]
                assert keys_of and all(f"| `{key}` |" in rows for key in keys_of), (kind, section)
    assert "nan" not in text


def test_the_page_of_parameter_sets_has_every_key_of_the_shipped_sets():
    text = pages.PARTS["set-keys"]()
    for path in sorted((ROOT / "data" / "parameters").glob("*.toml")):
        for section, content in tomllib.loads(path.read_text("utf-8")).items():
            tables = (
                [content]
                if section == "catalogue"
                else [t for t in content.values()]
                if isinstance(content, dict)
                else []
            )
            known = [t for entry in tables for t in (entry if isinstance(entry, list) else [entry])]
            assert all(f"| `{key}` |" in text for table in known if isinstance(table, dict) for key in table), path.name


@pytest.mark.parametrize("model", SECTIONS.values(), ids=SECTIONS)
def test_each_key_of_a_file_has_a_meaning(model):
    assert not [name for name, field in model.model_fields.items() if not field.description]


def test_each_generated_part_is_on_one_page():
    texts = [path.read_text("utf-8") for path in (ROOT / "docs").rglob("*.md")]
    assert sorted(name for text in texts for name in MARKER.findall(text)) == sorted(pages.PARTS)


def test_each_public_name_is_on_one_page():
    names = [name for _, _, listed in api.GROUPS.values() for name in listed.split()] + list(api.MODULES)
    assert sorted(names) == sorted(set(smajax.__all__) - {"__version__"})


def test_each_room_is_listed():
    folders = {path.parent.name for path in (ROOT / "smajax").glob("*/__init__.py")}
    assert sorted(api.ROOMS) == sorted(folders)


def test_the_rig_page_has_sections_bounds_and_shipped_examples():
    text = keys.rig_keys()
    headings = re.findall(r"^## \[([\w.]+)\]", text, re.MULTILINE)
    assert {"rig", "fit", "wire", "material", "heat", "load", "pulley", "sensor", "channels", "recording"} <= set(
        headings
    )
    row = next(line for line in text.splitlines() if line.startswith("| `diameter` |"))
    assert "0.001 mm to 20 mm; required" in row and '"0.15 mm"' in row
    assert "glove-finger; required" in next(line for line in text.splitlines() if line.startswith("| `kind` |"))
    assert "list of texts; empty by default" in next(
        line for line in text.splitlines() if line.startswith("| `free` |")
    )
    assert '"...' not in text, "an example is a value"


def test_the_catalogue_has_a_section_for_each_effect():
    text = pages.PARTS["effects"]()
    for key, effect in catalogue().items():
        section = text.partition(f"\n## {key} ")[2].partition("\n## ")[0]
        assert effect.remedy and effect.remedy in section
        assert all(
            f"- **{name}**: " in section for name in ("Typical strength", "Confusable with", "A rig shows it that has")
        )
        assert f"[effects.{key}]" in section and "`strength`" in section


def test_each_effect_has_an_equation_with_its_strength():
    assert set(effect_equations.EQUATIONS) == set(catalogue())
    for key, formula in effect_equations.EQUATIONS.items():
        assert re.search(r"(?<!\\)\bs\b", formula), f"{key}: the strength s is not in it"
    assert effect_equations.effect_equations().count("| [") == len(catalogue())


@pytest.mark.slow
def test_pictures_have_names_and_units_on_their_axes(tmp_path):
    pytest.importorskip("matplotlib", reason="the optional dependencies experiments are not installed")
    from docs.generate import pictures

    pictures.main(tmp_path)
    names = sorted(path.name for path in tmp_path.iterdir())
    assert len(names) == 7 and not set(names) - {path.name for path in pictures.IMAGES.iterdir()}
    charts = [path.read_text("utf-8") for path in tmp_path.iterdir() if "tick" in path.read_text("utf-8")]
    assert len(charts) == 3
    for text in charts:
        labels = re.findall(r">([^<>]+ \[[^<>\]]+\])</text>", text)
        assert len(labels) == 2 * text.count('id="axes_'), labels


def test_each_picture_is_on_a_page():
    texts = [path.read_text("utf-8") for path in [*(ROOT / "docs").rglob("*.md"), ROOT / "README.md"]]
    shown = {name for text in texts for name in re.findall(r"images/([\w-]+\.svg)", text)}
    pictures = {path.name for path in (ROOT / "docs" / "images").iterdir()}
    narrow = {name for name in pictures if name.endswith("-narrow.svg")}
    assert shown == pictures - narrow and {name.replace("-narrow", "") for name in narrow} < shown


# Width of a page on a screen of 390 pixels, and the smallest text in pixels that is read there without a lens.
PAGE_PIXELS, TEXT_PIXELS = 343, 9


@pytest.mark.parametrize("path", sorted((ROOT / "docs" / "images").iterdir()), ids=lambda path: path.name)
def test_texts_of_a_picture_can_be_read_on_a_phone(path):
    narrow = path.with_name(f"{path.stem}-narrow.svg")
    text = (narrow if narrow.is_file() else path).read_text("utf-8")
    width = float(re.search(r'viewBox="0 0 ([\d.]+) ', text)[1])
    sizes = [float(size) for size in re.findall(r"font(?:-size)?: (?:\w+ )*([\d.]+)px", text)]
    assert sizes and min(sizes) * PAGE_PIXELS / width >= TEXT_PIXELS


@pytest.mark.parametrize("page", sorted((ROOT / "docs" / "tutorials").glob("*.md")), ids=lambda path: path.stem)
def test_a_tutorial_opens_as_a_notebook(page):
    """Its commands and its Python code are cells, which a notebook runs in their order."""
    jupytext = pytest.importorskip("jupytext", reason="the optional dependencies docs are not installed")
    notebook = jupytext.read(page)
    assert notebook.metadata["kernelspec"]["name"] == "python3"
    cells = [cell.source.removeprefix("%%sh\n") for cell in notebook.cells if cell.cell_type == "code"]
    executed = [block for block in blocks.blocks(page.read_text("utf-8")) if block.language in blocks.EXECUTED]
    assert cells == [block.text.rstrip("\n") for block in executed]


@pytest.mark.parametrize("page", sorted((ROOT / "docs" / "tutorials").glob("*.md")), ids=lambda path: path.stem)
def test_a_tutorial_shows_a_figure_of_what_it_computes(page):
    text = page.read_text("utf-8")
    found = figures.FIGURE.findall(text)
    assert found
    for result, shows in found:
        assert "(" in result or f" --out {result} -->" in text, "the folder of a command of the page"
        assert len(shows.split()) > 5


def test_a_figure_is_drawn_from_the_files_of_the_site(monkeypatch):
    drawn = '{"data": [{"name": "</script>"}], "layout": {"height": 300}}'
    monkeypatch.setattr(figures, "run_python", lambda code, page: drawn if "sma.load('found')" in code else "")
    place = figures.figure_of("found", 'a "b"', "tutorials/a.md")
    assert "height: 300px" in place and 'aria-label="a &quot;b&quot;"' in place
    page = figures.with_figures(f"<body>{place}</body>", "tutorials/a.html")
    assert '<script src="../scripts/plotly.min.js"></script>' in page and page.count("</script>") == 2
    assert "Plotly.newPlot(" in page and figures.with_figures("<body></body>", "a.html") == "<body></body>"


def test_steps_of_a_page_stand_in_place_of_their_lines_and_its_error_is_one_of_the_page(monkeypatch):
    pytest.importorskip("jupytext", reason="the optional dependencies docs are not installed")
    from docs.generate import execution

    def output_of(command: str, page: str) -> str:
        if "fail" in command:
            raise outputs.CommandError(f"{page} failed")
        return f"{command} on {page}"

    monkeypatch.setattr(execution, "output_of", output_of)
    monkeypatch.setattr(execution, "refusal_of", lambda command, page: f"refused: {command}")
    text = "a\n<!-- output of: smajax b -->\n<!-- refusal of: smajax c -->\n"
    execution.begin({"a.md": text, "b.md": "<!-- output of: smajax fail -->", "c.md": "plain"})
    assert execution.with_outputs(text, "a.md") == "a\nsmajax b on a.md\nrefused: smajax c\n"
    assert execution.with_outputs("plain", "c.md") == "plain"
    with pytest.raises(outputs.CommandError, match=r"b\.md failed"):
        execution.with_outputs("<!-- output of: smajax fail -->", "b.md")
    execution.stop()
    outputs.clean_up()


def test_a_picture_has_another_one_for_narrow_screens():
    pytest.importorskip("mkdocs", reason="the optional dependencies docs are not installed")
    from docs.generate import hook

    image = '<img alt="a" src="../images/stages.svg" />'
    content = hook.on_page_content(f"<p>{image}</p>", None, None, None)
    assert content.endswith(f"{image}</picture></p>") and 'srcset="../images/stages-narrow.svg"' in content
    other = '<img alt="a" src="../images/rollout.svg" />'
    assert hook.on_page_content(other, None, None, None) == other


def test_each_entry_of_the_bibliography_is_plain_text():
    text = (ROOT / "docs" / "references.bib").read_text("utf-8")
    entries = bibliography.entries()
    assert len(entries) == text.count("\n@") and all("title" in fields for fields in entries.values())
    assert not re.search(r"[{}\\]", "".join(value for fields in entries.values() for value in fields.values()))
    assert all(f"**{key}**" in bibliography.bibliography() for key in entries)


def test_the_command_page_has_each_option():
    text = pages.PARTS["commands"]()
    assert "### smajax explain" in text and "`--holdout H.csv ...`" in text and "[options of reading]" in text
    assert "`--on-bad-rows TEXT`" in pages.PARTS["reading-options"]()


@pytest.mark.parametrize("page", [f"data/topics/{name}.md" for name in read_topics()])
def test_the_sections_of_a_page_are_those_of_a_rig(page):
    sections = re.findall(r"^```toml\n(.*?)^```", (ROOT / page).read_text("utf-8"), re.MULTILINE | re.DOTALL)
    rig = tomllib.loads((ROOT / "data" / "recordings" / "dead-weight" / "rig.toml").read_text("utf-8"))
    for block in map(tomllib.loads, sections):
        effects = {**rig.get("effects", {}), **block.get("effects", {})}
        rig = {**rig, **block, "effects": effects}
    read = read_rig({name: content for name, content in rig.items() if content})
    assert {effect.key for effect in read.plant.effects} == set(rig.get("effects", {}))


def test_pages_load_nothing_from_a_network():
    pytest.importorskip("mkdocs", reason="the optional dependencies docs are not installed")
    from docs.generate import hook

    loading = '<script src="https://example.org/a.js">', '<link rel="stylesheet" href="https://example.org/a.css">'
    assert all(hook.LOADED.search(text) for text in loading)
    assert not hook.LOADED.search(
        '<a href="https://example.org"><script src="../a.js"><link rel="canonical" href="https://a">'
    )


def test_equations_of_a_formula_may_stand_on_several_lines():
    def parts(formula: str) -> int:
        block = formulas.prepare_formulas(rf'<div class="arithmatex">\[{formula}\]</div>')
        inline = formulas.prepare_formulas(rf'<span class="arithmatex">\({formula}\)</span>')
        assert block.count("<span") == block.count(r"\displaystyle") == inline.count("<span")
        return block.count("<span")

    assert parts(r"a = \frac{b}{c}, \quad d = e") == 2
    assert parts(r"a = \left( b, \quad c \right)") == 1
    assert parts(r"a \leftarrow b, \quad c = d") == 2


def test_a_browser_draws_each_formula_of_the_pages(tmp_path):
    """With the files of MathJax that the site has. One formula is wrong on purpose. A page without formulas loads none."""
    reader = pytest.importorskip("markdown", reason="the optional dependencies docs are not installed")
    pytest.importorskip("pymdownx", reason="the optional dependencies docs are not installed")
    extensions = {"tables": {}, "pymdownx.superfences": {}, "pymdownx.arithmatex": {"generic": True}}
    texts = [page.read_text("utf-8") for page in sorted((ROOT / "docs").rglob("*.md"))]
    texts += [pages.PARTS["effect-equations"](), pages.PARTS["effects"](), r"$a \unknowncommand$"]
    body = "".join(reader.markdown(t, extensions=list(extensions), extension_configs=extensions) for t in texts)
    page = formulas.with_mathjax(f"<html><body>{formulas.prepare_formulas(body)}</body></html>", "a/page.html")
    for place, path in formulas.mathjax_files().items():
        (tmp_path / place).parent.mkdir(parents=True, exist_ok=True)
        (tmp_path / place).write_bytes(path.read_bytes())
    (tmp_path / "a").mkdir()
    (tmp_path / "a" / "page.html").write_text(page, "utf-8")
    drawn = drawn_page(tmp_path / "a" / "page.html", tmp_path / "browser")
    assert drawn.count("<mjx-container") == page.count(r"\(") > len(catalogue())
    assert drawn.count("<mjx-merror") == 1 and "unknowncommand" in drawn, "the formula that is wrong, and no other"
    assert formulas.with_mathjax("<body>a $ b</body>", "page.html") == "<body>a $ b</body>"


def test_cells_of_wide_tables_have_the_names_of_their_columns():
    pytest.importorskip("mkdocs", reason="the optional dependencies docs are not installed")
    from docs.generate import hook

    head, row = "<tr>{}</tr>".format("<th>{}</th>" * 4), "<tr>{}</tr>".format('<td style="x">1</td>' * 4)
    content = hook.on_page_content(
        f"<table>{head.format('a', '<code>b</code>', '', 'd')}{row}</table>", None, None, None
    )
    assert re.findall(r"<td( data-label=\"\w+\")? style", content) == ["", ' data-label="b"', "", ' data-label="d"']
    narrow = "<table><tr><th>a</th><th>b</th></tr><tr><td>1</td><td>2</td></tr></table>"
    assert hook.on_page_content(narrow, None, None, None) == narrow


def test_a_bar_in_code_is_no_border():
    assert markdown.cell("`a | b` | c") == "`a | b` \\| c"


@pytest.mark.slow
def test_the_output_of_a_command_is_what_it_prints():
    first = outputs.output_of("smajax init path --out bench", "a.md")
    assert first.startswith("```text\nWrote bench") and "bench/holdout.csv" in first
    assert "Fitted and scored: strain" in outputs.output_of("smajax check bench/example.toml bench/train.csv", "a.md")
    with pytest.raises(outputs.CommandError, match="there is no such file"):
        outputs.output_of("smajax check bench/example.toml bench/train.csv", "b.md")  # another page, another folder
    refusal = outputs.refusal_of("smajax check bench/example.toml bench/train.csv", "b.md")
    assert refusal.startswith("```text\n$ smajax check") and "there is no such file" in refusal
    with pytest.raises(outputs.CommandError, match="ended with 0, not 2"):
        outputs.refusal_of("smajax check bench/example.toml bench/train.csv", "a.md")
    outputs.clean_up()
