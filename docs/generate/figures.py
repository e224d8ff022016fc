"""Figures of results, which are drawn when the site is built: ``<!-- figure of: RESULT | WHAT IT SHOWS -->`` on a page.

RESULT is the folder of a command that the page shows, or a call such as ``sma.fit(...)``. The figure is that of its
``plot()``, which plotly draws in the browser, from a file of the site.
"""

import html
import json
import posixpath
import re

from docs.generate.outputs import run_python

FIGURE = re.compile(r"^<!-- figure of: ([^|>]+?) \| ([^>]+?) -->$", re.MULTILINE)
# File of the site with plotly, which the package plotly ships.
SCRIPT = "scripts/plotly.min.js"
_PLOT = "import smajax as sma; print({study}.plot().to_json())"
_PLACE = re.compile(r'<div class="figure" id="([^"]*)"')
_drawn: dict[str, str] = {}


def figure_of(result: str, text: str, page: str) -> str:
    """Draw the figure of a result, and return its place on the page.

    Args:
        result: The result folder, relative to that of the page's commands, or a call that returns a study.
        text: What the figure shows, for those who do not see it.
        page: The page.

    Raises:
        CommandError: If there is no such result.
    """
    study = result if "(" in result else f"sma.load({result!r})"
    return place_figure(run_python(_PLOT.format(study=study), page), text, page)


def place_figure(figure: str, text: str, page: str) -> str:
    """Return the place of a figure on a page.

    Args:
        figure: The figure of plotly as JSON.
        text: What it shows, for those who do not see it.
        page: The page.
    """
    content = json.loads(figure)
    content["layout"]["dragmode"] = False  # touching the figure scrolls the page
    height = content["layout"].get("height", 450)
    place = "figure-" + re.sub(r"\W+", "-", f"{page} {text}").strip("-")
    _drawn[place] = json.dumps(content).replace("</", "<\\/")
    label = html.escape(text, quote=True)
    return f'<div class="figure" id="{place}" role="img" aria-label="{label}" style="height: {height}px"></div>'


def with_figures(content: str, url: str) -> str:
    """Return a page of the site with the data of its figures, which the search index should not have.

    Args:
        content: The page.
        url: Its address relative to the site.
    """
    options = "{config: {responsive: true, displayModeBar: false}}"
    calls = [
        f"Plotly.newPlot('{place}', Object.assign({_drawn[place]}, {options}));" for place in _PLACE.findall(content)
    ]
    if not calls:
        return content
    source = posixpath.relpath(SCRIPT, posixpath.dirname(url) or ".")
    scripts = f'<script src="{source}"></script>\n<script>{" ".join(calls)}</script>\n'
    return content.replace("</body>", f"{scripts}</body>")


def plotly_script() -> str:
    """Return plotly as a script."""
    from plotly.offline import get_plotlyjs

    return get_plotlyjs()
