r"""Formulas of pages, which MathJax draws in the browser from files of the site.

A page writes TeX between ``$`` or ``$$``; equations that ``, \quad`` separates may stand on several lines.
"""

import importlib.metadata
import posixpath
import re
from pathlib import Path

# Files of MathJax in the package that ships them: the program, and its fonts beside it.
_PACKAGE = "sphinx-mathjax-offline"
_FOLDER = "static/mathjax/"
_FILES = re.compile(r"tex-chtml\.js|output/chtml/fonts/woff-v2/[\w-]+\.woff")
# Folder of the site with these files.
_PLACE = "scripts/mathjax/"
_SCRIPT = f"{_PLACE}tex-chtml.js"
# MathJax looks for formulas only in elements of the class that the Markdown extension gives them. With these two
# packages it loads no further file, and an unknown command is an error.
_OPTIONS = (
    'window.MathJax = {tex: {packages: ["base", "ams"]}, '
    'options: {enableMenu: false, ignoreHtmlClass: ".*|", processHtmlClass: "arithmatex"}};'
)
_FORMULA = re.compile(r'<(span|div) class="arithmatex">(?:\\\((.*?)\\\)|\\\[(.*?)\\\])</\1>', re.DOTALL)
# The index of the search has no formulas.
_PLACE_OF_FORMULA = '<span class="arithmatex" data-search-exclude>'
# Between two equations of a formula.
_SEPARATOR = re.compile(r",\s*\\quad\s*")
_LEFT = re.compile(r"\\left(?!arrow)")


def mathjax_files() -> dict[str, Path]:
    """Return the files of MathJax that the site needs, by their place in the site."""
    files = {}
    for file in importlib.metadata.files(_PACKAGE) or ():
        name = file.as_posix().partition(_FOLDER)[2]
        if _FILES.fullmatch(name):
            files[_PLACE + name] = Path(str(file.locate()))
    return files


def prepare_formulas(content: str) -> str:
    """Return the content of a page with its formulas as MathJax expects them.

    Args:
        content: The content of a page as HTML.
    """
    return _FORMULA.sub(_prepared, content)


def with_mathjax(content: str, url: str) -> str:
    """Return a page of the site with MathJax, where it has formulas.

    Args:
        content: The page.
        url: Its address relative to the site.
    """
    if _PLACE_OF_FORMULA not in content:
        return content
    source = posixpath.relpath(_SCRIPT, posixpath.dirname(url) or ".")
    return content.replace("</body>", f'<script>{_OPTIONS}</script>\n<script src="{source}"></script>\n</body>')


def _prepared(match: re.Match[str]) -> str:
    """Return a formula; its equations stand side by side where there is room."""
    style = "" if match[3] is None else r"\displaystyle "
    places = (rf"{_PLACE_OF_FORMULA}\({style}{equation}\)</span>" for equation in _equations(match[2] or match[3]))
    return ", ".join(places) if match[3] is None else f'<div class="formula">{", ".join(places)}</div>'


def _equations(formula: str) -> list[str]:
    """Return the equations of a formula, which is one where brackets contain the space between them."""
    parts = _SEPARATOR.split(formula.strip())
    pairs = [(part.count("{"), part.count("}"), _LEFT.subn("", part)[1], part.count(r"\right")) for part in parts]
    whole = all(a == b and c == d for a, b, c, d in pairs)
    return parts if whole else [formula]
