"""Parts of a report page: one HTML file that opens offline, with zoomable figures and the provenance of the result.

The file contains plotly.js once. Text from files is escaped by ``html.escape``. The figures are embedded as JSON
without any ``<``, so that no file name, header or comment can end the script or start another one.
"""

import json
from collections.abc import Iterable, Mapping, Sequence
from html import escape
from pathlib import Path
from typing import Any

from smajax.report.figures import Picture
from smajax.report.topics import plain_text, read_topics

_HERE = Path(__file__).parent
# The page may run its own scripts, and must not load anything else.
_CONTENT_POLICY = "default-src 'none'; script-src 'unsafe-inline'; style-src 'unsafe-inline'; img-src data: blob:"


def render_page(title: str, lead: str, sections: Iterable[str], pictures: Sequence[Picture]) -> str:
    """Build a whole page.

    Args:
        title: Its title.
        lead: Sentence below the title.
        sections: Sections as HTML.
        pictures: The figures; ``add_picture`` adds them and their places in the sections.

    Returns:
        The page as HTML.
    """
    from plotly.offline import get_plotlyjs  # slow to import

    style, script = ((_HERE / name).read_text("utf-8") for name in ("style.css", "page.js"))
    figures = safe_json([_figure_content(picture) for picture in pictures])
    return "\n".join(
        [
            '<!DOCTYPE html>\n<html lang="en">\n<head>\n<meta charset="utf-8">',
            '<meta name="viewport" content="width=device-width, initial-scale=1">',
            f'<meta http-equiv="Content-Security-Policy" content="{_CONTENT_POLICY}">',
            f"<title>{escape(title)}</title>\n<style>\n{style}</style>\n</head>\n<body>\n<main>",
            f'<h1>{escape(title)}</h1>\n<p class="lead">{escape(lead)}</p>',
            *sections,
            '<footer class="small">Drag in a picture to zoom, double-click to return. '
            "Includes plotly.js (MIT licence).</footer>",
            f'</main>\n<script type="application/json" id="figures">{figures}</script>',
            f"<script>{get_plotlyjs()}</script>\n<script>\n{script}</script>\n</body>\n</html>\n",
        ]
    )


def _figure_content(picture: Picture) -> dict[str, Any]:
    """Data and layout of a figure for plotly.js, without its empty template."""
    content = picture.figure.to_plotly_json()
    return {"data": content["data"], "layout": {k: v for k, v in content["layout"].items() if k != "template"}}


def safe_json(value: Any) -> str:
    """Format a value as JSON for a script element: no tag and no comment can begin in it."""
    text = json.dumps(value, allow_nan=False, separators=(",", ":"))
    return text.translate({ord(c): f"\\u{ord(c):04x}" for c in "<>&"})


def add_picture(picture: Picture, pictures: list[Picture]) -> str:
    """Append a figure to those of a page.

    Args:
        picture: The figure.
        pictures: The figures of the page, to which it is appended.

    Returns:
        The HTML of its title, its caption and the place where the page draws it.
    """
    pictures.append(picture)
    kind = "picture" if picture.wide else "picture square"
    return (
        f'<h3>{escape(picture.title)}</h3>\n<p class="caption">{escape(picture.caption)}</p>\n'
        f'<div class="{kind}" id="picture-{len(pictures) - 1}" style="height:{picture.height}px">'
        "<noscript>This picture needs JavaScript; prediction.csv has its numbers.</noscript></div>"
    )


def verdict_section(sentences: Sequence[str], *, bad: bool = False) -> str:
    """Return the summary of a result as a box of paragraphs.

    Args:
        sentences: A paragraph each.
        bad: Whether the box has the colour of a warning.
    """
    paragraphs = "".join(f"<p>{escape(sentence)}</p>" for sentence in sentences)
    return f'<div class="verdict{" bad" if bad else ""}">{paragraphs}</div>'


def recordings_table(entries: Sequence[Mapping[str, Any]]) -> str:
    """Return a table of recordings with their roles; ``entries`` are those of a result document."""
    rows = [(r["name"], r["role"], f"{r['rows']:,}", r["sha256"] or "-") for r in entries]
    return "<h3>Recordings</h3>" + table(("file", "role", "rows", "SHA-256"), rows, numbers=(2,), hash_column=3)


def provenance_sections(run: Mapping[str, Any], rig: str, *details: str) -> list[str]:
    """Return the sections at the end of a page that say how the result was obtained.

    Args:
        run: The document run.json.
        rig: Text of the rig file; empty if there is none.
        details: Sections of HTML that come first.
    """
    return [
        "<h2>Provenance</h2>",
        *details,
        _run_section(run),
        *([folded("The rig file", f"<pre>{escape(rig)}</pre>")] if rig else []),
    ]


def _run_section(run: Mapping[str, Any]) -> str:
    """Command, versions and timings of a run, folded."""
    rows = [("command", " ".join(run["argv"])), ("started", run["started"]), ("machine", run["machine"])]
    rows += [("versions", ", ".join(f"{name} {version}" for name, version in run["versions"].items()))]
    rows += [("seconds", ", ".join(f"{name} {value:.2f}" for name, value in run["timings"].items()))]
    return folded("Command, versions and timings", table(("", ""), rows))


def folded(title: str, content: str) -> str:
    """Return content that a click on its title unfolds.

    Args:
        title: The title; it is escaped.
        content: The content as HTML.
    """
    return f"<details><summary>{escape(title)}</summary>{content}</details>"


def topics_section(names: Sequence[str]) -> str:
    """Return the texts of ``smajax explain`` on words of a page, folded; effects are left out.

    Args:
        names: Names of topics.
    """
    known = read_topics()
    entries = [
        folded(f"{known[n].title} (smajax explain {n})", f"<pre>{escape(plain_text(known[n].text))}</pre>")
        for n in names
        if n in known
    ]
    return "<h2>Words of this page</h2>" + "".join(entries) if entries else ""


def bullets(sentences: Sequence[str]) -> str:
    """Return sentences as an HTML list; an empty string if there are none."""
    return "<ul>" + "".join(f"<li>{escape(s)}</li>" for s in sentences) + "</ul>" if sentences else ""


def table(
    head: Sequence[str],
    rows: Iterable[Sequence[str]],
    *,
    numbers: Sequence[int] = (),
    remark: int = -1,
    hash_column: int = -1,
) -> str:
    """Return an HTML table; all text is escaped.

    Args:
        head: Titles of the columns; all empty for none.
        rows: Cells, row by row.
        numbers: Indices of the columns of numbers, which are aligned to the right.
        remark: Index of the column of remarks, which are coloured; -1 for none.
        hash_column: Index of the column of check sums, which may break anywhere; -1 for none.
    """
    styles = {remark: "remark", hash_column: "hash"} | dict.fromkeys(numbers, "number")

    def style(column: int) -> str:
        return f' class="{styles[column]}"' if column in styles else ""

    def cells(tag: str, row: Sequence[str]) -> str:
        return "".join(f"<{tag}{style(k)}>{escape(cell)}</{tag}>" for k, cell in enumerate(row))

    top = f"<thead><tr>{cells('th', head)}</tr></thead>" if any(head) else ""
    body = "".join(f"<tr>{cells('td', row)}</tr>" for row in rows)
    return f'<div class="scroll"><table>{top}<tbody>{body}</tbody></table></div>'


def pretty_unit(unit: str) -> str:
    """Return a unit with superscript exponents and a degree sign."""
    return (
        unit.replace("^2", "\N{SUPERSCRIPT TWO}")
        .replace("^3", "\N{SUPERSCRIPT THREE}")
        .replace("degC", "\N{DEGREE SIGN}C")
    )
