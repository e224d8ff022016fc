"""Hook of MkDocs: generated pages and parts, links to files outside of docs, formulas and narrow screens."""

import posixpath
import re
import sys
from pathlib import Path
from typing import Any

from mkdocs.exceptions import PluginError
from mkdocs.structure.files import File

ROOT = Path(__file__).resolve().parents[2]
sys.path.insert(0, str(ROOT))

from docs.generate import execution, pages  # noqa: E402
from docs.generate.blocks import FILE, REASON  # noqa: E402
from docs.generate.figures import SCRIPT, plotly_script, with_figures  # noqa: E402
from docs.generate.formulas import mathjax_files, prepare_formulas, with_mathjax  # noqa: E402
from docs.generate.outputs import clean_up  # noqa: E402
from docs.generate.results import insert_results  # noqa: E402

PART = re.compile(r"^<!-- generated: ([\w-]+) -->$", re.MULTILINE)
LINK = re.compile(r"\]\(([^)#\s]+)(#[^)\s]*)?\)")
TABLE = re.compile(r"<table>.*?</table>", re.DOTALL)
# Columns from which stylesheets/site.css shows a table as lists on narrow screens.
LISTED_COLUMNS = 4
# An image of docs/images, and the screens for which NAME-narrow.svg takes the place of NAME.svg.
PICTURE = re.compile(r'<img\b[^>]*\bsrc="([^"]*images/)([\w-]+)\.svg"[^>]*>')
NARROW_SCREEN = "(max-width: 45em)"
# An address that a browser loads when the page opens; a link that a reader follows is none.
LOADED = re.compile(r'<(?:script|img|iframe|link(?! rel="canonical"))[^>]*\s(?:src|href)="?(https?:[^\s">]+)')
# End of a sentence before a literal block, which docstrings mark by two colons.
LITERAL = re.compile(r"::(?=</p>)")


def on_build_error(error: Exception) -> None:
    """Execute no further page."""
    execution.stop()


def on_shutdown() -> None:
    """Remove what the commands of the pages have written."""
    clean_up()


def on_post_build(config: Any) -> None:
    """Refuse a site that loads anything from a network."""
    for path in Path(config.site_dir).rglob("*.html"):
        if loaded := LOADED.search(path.read_text("utf-8")):
            raise PluginError(f"{path.name} loads {loaded[1]} from a network")


def on_files(files: Any, config: Any) -> Any:
    """Add generated pages and copies of files that pages link to, and begin to execute what pages show."""
    for name, text in pages.whole_pages().items():
        files.append(File.generated(config, name, content=text))
    for path in pages.LINKED_FILES:
        files.append(File.generated(config, f"files/{path}", abs_src_path=str(ROOT / path)))
    files.append(File.generated(config, SCRIPT, content=plotly_script()))
    for place, path in mathjax_files().items():
        files.append(File.generated(config, place, abs_src_path=str(path)))
    execution.begin({file.src_uri: file.content_string for file in files.documentation_pages()})
    return files


def on_post_page(output: str, page: Any, config: Any) -> str:
    """Add the figures of a page, and what draws its formulas."""
    return with_mathjax(with_figures(output, page.url), page.url)


def on_page_markdown(markdown: str, page: Any, config: Any, files: Any) -> str:
    """Insert generated parts, results and the output of commands, and let links point to pages of the site."""
    source = page.file.src_uri
    markdown = insert_results(PART.sub(lambda match: pages.PARTS[match[1]](), markdown))
    markdown = LINK.sub(lambda match: f"]({_target(match[1], source)}{match[2] or ''})", markdown)
    markdown = FILE.sub(lambda match: f"`{match[1]}`:\n", markdown)
    markdown = REASON.sub(lambda match: f"*Not executed by the tests of this site: {match[1]}.*\n", markdown)
    return execution.with_outputs(markdown, source)


def on_page_content(content: str, page: Any, config: Any, files: Any) -> str:
    """Prepare formulas for MathJax, and images and tables for narrow screens."""
    content = PICTURE.sub(_by_width, prepare_formulas(content))
    return TABLE.sub(_labelled, LITERAL.sub(":", content))


def _by_width(match: re.Match[str]) -> str:
    """Return an image with its drawing for narrow screens, where there is one."""
    if not (ROOT / "docs" / "images" / f"{match[2]}-narrow.svg").is_file():
        return match[0]
    narrow = f'<source media="{NARROW_SCREEN}" srcset="{match[1]}{match[2]}-narrow.svg">'
    return f"<picture>{narrow}{match[0]}</picture>"


def _labelled(match: re.Match[str]) -> str:
    """Return a table of four columns or more whose cells have the names of their columns, but for the first."""
    heads = re.findall(r"<th\b[^>]*>(.*?)</th>", match[0])
    names = ["", *(re.sub(r"<[^>]+>", "", head).strip().replace('"', "&quot;") for head in heads[1:])]
    if len(heads) < LISTED_COLUMNS:
        return match[0]

    def row(cells: re.Match[str]) -> str:
        labels = iter(names)
        return re.sub(r"<td\b", lambda _: f'<td data-label="{name}"' if (name := next(labels, "")) else "<td", cells[0])

    return re.sub(r"<tr>.*?</tr>", row, match[0], flags=re.DOTALL)


def _target(link: str, source: str) -> str:
    """Return the link from a page to what stands for a file in the site."""
    folder = posixpath.dirname(source)
    path = posixpath.normpath(posixpath.join("docs", folder, link))
    page = pages.PAGES_OF_FILES.get(path) or (f"files/{path}" if path in pages.LINKED_FILES else None)
    return posixpath.relpath(page, folder or ".") if page else link
