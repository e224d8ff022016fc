"""The order of the rooms: a room imports only rooms listed above it, and no module imports itself by a detour."""

import ast
from pathlib import Path

import pytest

from tests.conftest import ROOT

# The order of ARCHITECTURE: top modules, then the rooms from numerics to app.
ROOMS = (
    ("errors",),
    ("arguments",),
    ("channels",),
    ("unit_parser",),
    ("units",),
    ("parameters", "progress"),
    ("numerics",),
    ("plant",),
    ("laws",),
    ("actuators",),
    ("recordings",),
    ("files",),
    ("simulation",),
    ("fitting",),
    ("diagnosis",),
    ("properties",),
    ("comparison",),
    ("control",),
    ("sweeps",),
    ("report",),
    ("api",),
    ("app",),
)
LEVEL = {name: level for level, names in enumerate(ROOMS) for name in names}
PACKAGE = ROOT / "smajax"
ENTRY_POINTS = {"smajax", "smajax.__main__"}


def module_name(path: Path) -> str:
    """The dotted name of a file of the package."""
    parts = path.relative_to(ROOT).with_suffix("").parts
    return ".".join(parts[:-1] if parts[-1] == "__init__" else parts)


MODULES = {module_name(path): path for path in sorted(PACKAGE.rglob("*.py"))}


def imports_of(name: str) -> set[str]:
    """The modules of the package that a module imports, anywhere in its text."""
    found = set()
    for node in ast.walk(ast.parse(MODULES[name].read_text("utf-8"))):
        if isinstance(node, ast.ImportFrom) and node.module and node.module.split(".")[0] == "smajax":
            whole = {f"{node.module}.{alias.name}" for alias in node.names}
            found |= {w if w in MODULES else node.module for w in whole}
        elif isinstance(node, ast.Import):
            found |= {alias.name for alias in node.names if alias.name in MODULES}
    return found - {name}


def room(name: str) -> str:
    """The room of a module: the first name below the package."""
    return name.split(".")[1]


def test_every_room_has_a_place_in_the_order():
    assert {room(name) for name in MODULES if name not in ENTRY_POINTS} <= set(LEVEL)


@pytest.mark.parametrize("name", [name for name in MODULES if name not in ENTRY_POINTS])
def test_a_room_imports_only_rooms_above_it(name):
    below = {
        other
        for other in imports_of(name) - {"smajax"}
        if room(other) != room(name) and LEVEL[room(other)] >= LEVEL[room(name)]
    }
    assert not below, f"{name} imports {sorted(below)}, which stand below it"


def test_no_module_imports_itself_by_a_detour():
    graph = {name: imports_of(name) - ENTRY_POINTS for name in MODULES}
    done: set[str] = set()

    def visit(name: str, path: tuple[str, ...]) -> None:
        assert name not in path, " -> ".join([*path[path.index(name) :], name])
        if name not in done:
            for other in sorted(graph[name]):
                visit(other, (*path, name))
            done.add(name)

    for name in graph:
        visit(name, ())


def test_the_top_of_the_package_has_at_most_eight_modules():
    assert len(list(PACKAGE.glob("*.py"))) <= 8
