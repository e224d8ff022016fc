"""Names, phrases and sizes that the code keeps to: the glossary's old names are gone, and files and functions stay short."""

import ast
import re
from collections.abc import Iterator
from pathlib import Path

import pytest

from tests.conftest import ROOT

LONGEST_FUNCTION, LONGEST_FILE, LONGEST_LINE = 60, 400, 120  # lines, lines, characters

# Names that a room had before version 0.2 and has no more, by the folder below smajax/ in which they are searched.
OLD_NAMES = {
    "diagnosis": """
        Story trace Ranked Tracer Extension Trial race _HEATS kin elsewhere settled timely together judged unusual chances
        expected objection worth promised WORTH PROMISED critical Sight unseen smallest Promise Look Bench plain known
        moved Part Form freeform design _apart column largest_by_noise evidence judge _helps
    """,
    "fitting": """
        Search Solved Stop apart ahead sparing Fit draw_starts Indistinct Family runs_away parted lay_out watch track
        Track cure kinked
    """,
    "simulation": "lay_out watch track Track _pushed cure Code kinks",
    "numerics": "larger smaller within swing kinks push end_tangent",
    "recordings": "plausible",
    "properties": "lay Lines corners _redrawn _slower turns inner_loops cycle_set guessed",
    "plant": """
        advance arrive land follow push end_tangent outputs traits Instant Where travel SecondNode engaged Surroundings
        around metres unloaded sticks beside LightRotary passed bend conduction max_strain grown_strain stiffened remaining
        due hardened
    """,
    "control": """
        DrivenPlant searches way Loop believes gaps Told hear Sensing Inertial Meters LastKnown BLIND TemperatureGuard
        AbstractThermometer AngleFilter ExtendedFilter EnsembleFilter drift walk trust unlimited soonest fastest tuner
        tuning behave given_up gain_search harder _calmer
    """,
    "control/estimators": "begin watch under memory",
    "sweeps": "look room front partial wave study reach as_values",
}

# Phrases that plain technical English says otherwise.
OLD_PHRASES = (
    "comes to rest",
    "come to rest",
    "what is left of",
    "tell apart",
    "told apart",
    "is no number",
    "to and fro",
    "lead on",
    "leads on",
    "goes with itself",
    "it says little",
    "its residual says little",
    "led on",
    "beside",
    "remembered at their beginning",
)
# Who may speak of old names: what reads old files, and this list.
EXCEPTIONS = ("smajax/files/renamed_keys.py", "experiments/diagnosis/catalogue.py", "tests/unit/test_language.py")

PACKAGE_FILES = sorted((ROOT / "smajax").rglob("*.py"))
CODE_FILES = [*PACKAGE_FILES, *sorted((ROOT / "experiments").rglob("*.py"))]
TEXT_FILES = [
    *CODE_FILES,
    ROOT / "README.md",
    ROOT / "CONTRIBUTING.md",
    *sorted((ROOT / "docs").rglob("*.md")),
    ROOT / "experiments" / "README.md",
    *sorted((ROOT / "smajax").rglob("*.md")),
    *sorted((ROOT / "smajax").rglob("*.json")),
    *sorted((ROOT / "data").glob("*/*.toml")),
]


def relative(path: Path) -> str:
    """The path below the checkout, for the names of tests."""
    return path.relative_to(ROOT).as_posix()


def identifiers(path: Path) -> Iterator[tuple[str, int]]:
    """All names that a file defines or uses, with their lines."""
    for node in ast.walk(ast.parse(path.read_text("utf-8"))):
        if isinstance(node, ast.Name):
            yield node.id, node.lineno
        elif isinstance(node, ast.Attribute):
            yield node.attr, node.lineno
        elif isinstance(node, ast.FunctionDef | ast.ClassDef):
            yield node.name, node.lineno
        elif isinstance(node, ast.arg) or (isinstance(node, ast.keyword) and node.arg):
            yield node.arg, node.lineno
        elif isinstance(node, ast.alias):
            yield node.asname or node.name, getattr(node, "lineno", 0)


@pytest.mark.parametrize("room", OLD_NAMES)
def test_old_names_are_gone(room):
    old = set(OLD_NAMES[room].split())
    left_over = [
        f"{relative(path)}:{line} {name}"
        for path in sorted((ROOT / "smajax" / room).rglob("*.py"))
        for name, line in identifiers(path)
        if name in old
    ]
    assert not left_over, "\n".join(left_over)


@pytest.mark.parametrize("path", TEXT_FILES, ids=relative)
def test_texts_are_plain(path):
    if relative(path) in EXCEPTIONS:
        return
    text = re.sub(r"\s+", " ", path.read_text("utf-8").replace("#", " ")).lower()
    assert not [phrase for phrase in OLD_PHRASES if re.search(rf"\b{phrase}\b", text)]


@pytest.mark.parametrize("path", CODE_FILES, ids=relative)
def test_files_and_functions_are_short(path):
    text = path.read_text("utf-8")
    lines = text.splitlines()
    long_functions = [
        f"{node.name}: {node.end_lineno - node.lineno + 1} lines"
        for node in ast.walk(ast.parse(text))
        if isinstance(node, ast.FunctionDef) and (node.end_lineno or 0) - node.lineno + 1 > LONGEST_FUNCTION
    ]
    assert not long_functions
    assert len(lines) <= LONGEST_FILE
    assert not [k for k, line in enumerate(lines, 1) if len(line) > LONGEST_LINE]


def test_every_source_that_is_cited_has_its_entry():
    keys = set(re.findall(r"^@\w+\{(\w+),", (ROOT / "docs" / "references.bib").read_text("utf-8"), re.MULTILINE))
    cited = {
        key
        for path in PACKAGE_FILES
        for sentence in re.findall(r"Sources?: ([^\n]+)", path.read_text("utf-8"))
        for key in re.findall(r"\b([a-z]+(?:19|20)\d\d[a-z]*)\b", sentence)
    }
    assert cited and cited <= keys, sorted(cited - keys)
