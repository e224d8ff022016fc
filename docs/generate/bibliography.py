"""The bibliography: docs/references.bib as a list."""

import re
from pathlib import Path

BIBLIOGRAPHY = Path(__file__).resolve().parents[1] / "references.bib"
ENTRY = re.compile(r"^@(\w+)\{([^,]+),\n(.*?)^\}", re.MULTILINE | re.DOTALL)
FIELD = re.compile(r"^\s*(\w+)\s*=\s*\{(.*?)\},?\s*$", re.MULTILINE | re.DOTALL)
# Marks of LaTeX in the file, and the characters they stand for.
MARKS = {"--": "-", r"{\textdegree}{C}": "degC", r"{\AA}": "Å", r"{\"o}": "ö", r"{\"u}": "ü", r"{\"a}": "ä"}


def entries() -> dict[str, dict[str, str]]:
    """Return the fields of each entry by key, in the order of the file."""
    text = BIBLIOGRAPHY.read_text("utf-8")
    return {
        match[2]: {name: _plain(value) for name, value in FIELD.findall(match[3])} for match in ENTRY.finditer(text)
    }


def bibliography() -> str:
    """Return the list, with an anchor for each key."""
    return "\n".join(f"- <a id='{key}'></a>**{key}**: {_reference(fields)}" for key, fields in entries().items())


def _reference(fields: dict[str, str]) -> str:
    title = f"*{fields['title']}*" if "title" in fields else ""
    place = ", ".join(
        part
        for part in (
            fields.get("journal") or fields.get("booktitle") or fields.get("publisher") or fields.get("institution"),
            " ".join(filter(None, (fields.get("volume"), f"({fields['number']})" if "number" in fields else ""))),
            f"pages {fields['pages']}" if "pages" in fields else "",
            fields.get("year"),
        )
        if part
    )
    link = f"[doi:{fields['doi']}](https://doi.org/{fields['doi']})" if "doi" in fields else ""
    address = f"<{fields['url']}>" if "url" in fields else ""
    parts = (fields.get("author", "").replace(" and ", "; "), title, place, fields.get("note"), link, address)
    return ". ".join(part.rstrip(".") for part in parts if part) + "."


def _plain(value: str) -> str:
    for mark, character in MARKS.items():
        value = value.replace(mark, character)
    return " ".join(re.sub(r"[{}]", "", value).split())
