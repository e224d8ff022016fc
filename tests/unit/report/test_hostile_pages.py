"""Pages of all commands with texts in names, headers and cells that would end a tag, a script or a comment."""

import copy
import dataclasses
import re
from collections.abc import Callable, Iterator
from html.parser import HTMLParser
from pathlib import Path
from typing import Any

import plotly.offline
import pytest

from smajax.report.rebuild import build_page
from tests.support.browser import drawn_page
from tests.unit.report.example_documents import EXAMPLES, example_series, run

ATTACK, MARK = "document.documentElement.dataset.broken=1", "data-broken"
HOSTILE = (
    f"</script><script>{ATTACK}</script>", f'<img src=x onerror="{ATTACK}">', f'"><svg onload={ATTACK}>',
    f"'><svg/onload={ATTACK}>", f"&lt;script&gt;{ATTACK}", "<!--", "-->", "--!><b id=broken>", "]]>", "{{7*7}}",
    f"${{{ATTACK}}}", f"javascript:{ATTACK}", "</style><b id=broken>", "</title><b id=broken>", "</textarea><b id=broken>",
    "</pre><b id=broken>", "<plaintext>", f"<a href='javascript:{ATTACK}'>x</a>", f"<iframe srcdoc='<script>parent.{ATTACK}</script>'>",
    "<base href='//a.b/'>", "<meta http-equiv=refresh content=0>", "\u202ereversed", "\x1b[31mred", "a\nb\rc", "\u2028x\u2029",
    "%s%n%d", "'; DROP TABLE x;--", "\\u003c/script>", "=cmd|' /C calc'!A0", "<br>" * 50,
)  # fmt: skip
# A text without any sign that HTML knows, in the same places.
PLAIN = "zqplain"
Place = tuple[Any, ...]


class Outline(HTMLParser):
    """The elements of a page with the names of their attributes, and its texts in scripts."""

    def __init__(self, page: str):
        super().__init__()
        self.elements: list[tuple[str, tuple[str, ...]]] = []
        self.in_pictures: set[str] = set()
        self._depth = 0
        self.feed(page)
        self.close()

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        self._depth += tag == "svg"
        if self._depth:  # lines of text are as many as they need
            self.in_pictures.add(tag)
        else:
            self.elements.append((tag, tuple(sorted(name for name, _ in attrs))))

    def handle_endtag(self, tag: str) -> None:
        self._depth -= tag == "svg"

    def handle_comment(self, data: str) -> None:
        self.elements.append(("comment", ()))

    def outside_pictures(self) -> list[tuple[str, tuple[str, ...]]]:
        """The elements without those of style, of which plotly makes one for each picture in any order."""
        return [element for element in self.elements if element[0] != "style"]


def places(value: Any, path: Place = ()) -> Iterator[Place]:
    """The places of all texts of a document: values, and with a last ``None`` the keys of tables."""
    if isinstance(value, dict):
        for key, inner in value.items():
            yield (*path, key, None)
            yield from places(inner, (*path, key))
    elif isinstance(value, list):
        for number, inner in enumerate(value):
            yield from places(inner, (*path, number))
    elif isinstance(value, str):
        yield path


def extended(document: dict, path: Place, text: str) -> None:
    """Append a text to the value or the key at a place."""
    *above, last = path if path[-1] is not None else path[:-1]
    table: Any = document
    for key in above:
        table = table[key]
    if path[-1] is None:
        table[last + text] = table.pop(last)
    else:
        table[last] += text


def page_of(command: str, text: str, chosen: list[Place]) -> str:
    """The page of a command with a text at places of its document and of run.json, in the rig, and in names."""
    document = copy.deepcopy({"document": EXAMPLES[command], "run": run(command) | {"inputs": ["current"]}})
    if command == "simulate":
        document["document"]["inputs"] = ["current"]
    for path in sorted(chosen, key=lambda path: len(path) - (path[-1] is None), reverse=True):  # keys at the end
        extended(document, path, text)
    data: Any = example_series(command)
    if command not in ("sweep", "tune"):  # whose series have no names of files
        data = [dataclasses.replace(recording, name=text + recording.name) for recording in data]
    return build_page(command, document["document"], data, document["run"], f"[rig] {text}")


@pytest.fixture(scope="module")
def chosen_places() -> Callable[[str], list[Place]]:
    """The places whose texts are shown, and change nothing else; the page's own code compares the others."""
    found: dict[str, list[Place]] = {}

    def choose(command: str) -> list[Place]:
        if command not in found:
            page = page_of(command, PLAIN, [])
            usual, shown = Outline(page).elements, page.count(PLAIN)
            found[command] = []
            document = {"document": EXAMPLES[command], "run": run(command) | {"inputs": ["current"]}}
            for path in sorted(places(document), key=lambda path: path[-1] is None):
                try:
                    page = page_of(command, PLAIN, [*found[command], path])
                except Exception:  # a name that other parts of the document use
                    continue
                if page.count(PLAIN) > shown and Outline(page).elements == usual:
                    found[command].append(path)
                    shown = page.count(PLAIN)
        return found[command]

    return choose


@pytest.fixture
def without_plotly(monkeypatch):
    """Pages without the four megabytes of plotly.js."""
    monkeypatch.setattr(plotly.offline, "get_plotlyjs", lambda: "")


def test_there_are_thirty_texts():
    assert len(HOSTILE) == len(set(HOSTILE)) == 30


@pytest.mark.slow
@pytest.mark.parametrize("command", EXAMPLES)
def test_no_text_adds_or_ends_an_element(command, chosen_places, without_plotly):
    chosen = chosen_places(command)
    assert len(chosen) >= 8, chosen
    plain = Outline(page_of(command, PLAIN, chosen)).elements
    scripts = re.findall(r"</script", page_of(command, PLAIN, chosen))
    for text in HOSTILE:
        page = page_of(command, text, chosen)
        assert Outline(page).elements == plain, text
        assert re.findall(r"</script", page) == scripts, text


def test_the_outline_shows_what_breaks_out(chosen_places, without_plotly, monkeypatch):
    """The check above fails where a text is not escaped."""
    chosen = chosen_places("properties")
    monkeypatch.setattr("smajax.report.pages.escape", lambda text: text)
    plain, hostile = (Outline(page_of("properties", text, chosen)).elements for text in (PLAIN, HOSTILE[0]))
    assert plain != hostile


@pytest.fixture(scope="module")
def drawn_plainly(chosen_places, tmp_path_factory) -> Callable[[str], str]:
    """The page of a command with a plain text, drawn once."""
    found: dict[str, str] = {}

    def draw(command: str) -> str:
        if command not in found:
            found[command] = drawn(command, PLAIN, chosen_places(command), tmp_path_factory.mktemp("plain"))
        return found[command]

    return draw


def drawn(command: str, text: str, chosen: list[Place], folder: Path) -> str:
    """The elements of the page of a command with a text after a browser has drawn it, as HTML."""
    (folder / "report.html").write_text(page_of(command, text, chosen), "utf-8")
    return drawn_page(folder / "report.html", folder)


def check_in_browser(plain: str, page: str) -> None:
    """A browser draws all figures of a page with a text, and the same elements as of a page with a plain one."""
    assert plain.count('class="main-svg"') == page.count('class="main-svg"') > 0
    outlines = [Outline(plain), Outline(page)]
    assert outlines[0].outside_pictures() == outlines[1].outside_pictures()
    assert outlines[1].in_pictures <= outlines[0].in_pictures
    assert not [names for _, names in outlines[1].elements if MARK in names]


@pytest.mark.slow
@pytest.mark.parametrize("command", EXAMPLES)
def test_a_browser_executes_no_text(command, chosen_places, drawn_plainly, tmp_path):
    """All texts at once."""
    page = drawn(command, "".join(HOSTILE), chosen_places(command), tmp_path)
    check_in_browser(drawn_plainly(command), page)


@pytest.mark.slow
@pytest.mark.parametrize("number", range(len(HOSTILE)))
def test_a_browser_executes_none_of_the_texts(number, chosen_places, drawn_plainly, tmp_path):
    """Each text on the page of one command in turn; the test below has all of their pairs."""
    command = list(EXAMPLES)[number % len(EXAMPLES)]
    page = drawn(command, HOSTILE[number], chosen_places(command), tmp_path)
    check_in_browser(drawn_plainly(command), page)


@pytest.mark.fuzz
@pytest.mark.parametrize("number", range(len(HOSTILE)))
@pytest.mark.parametrize("command", EXAMPLES)
def test_a_browser_executes_no_text_of_any_command(command, number, chosen_places, drawn_plainly, tmp_path):
    page = drawn(command, HOSTILE[number], chosen_places(command), tmp_path)
    check_in_browser(drawn_plainly(command), page)
