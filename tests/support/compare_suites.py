"""Compare the tests of two checkouts: test functions, assertions and tolerances, none of which may be lost.

    python -m tests.support.compare_suites OLD NEW

OLD and NEW are checkouts, such as one made by ``git worktree add OLD COMMIT``. A test function is known by its name, so
that it may move to another file. The exit code is 1 if a function is missing, has fewer assertions, or has other
tolerances.
"""

import ast
import sys
from collections import Counter
from pathlib import Path
from typing import NamedTuple

# Keywords that loosen a comparison.
_TOLERANCES = ("rel", "abs", "rtol", "atol")
# Calls that assert, beside the statement: functions of numpy.testing begin like this, and those of pytest are these.
_ASSERTING_PREFIX = "assert_"
_ASSERTING = ("raises", "warns")


class FunctionContent(NamedTuple):
    """What a test function asserts.

    Attributes:
        assertions: Number of assertions.
        tolerances: Tolerances in their order, as they are written.
    """

    assertions: int
    tolerances: tuple[str, ...]


def content_of(function: ast.AST) -> FunctionContent:
    """Count the assertions of a function.

    Args:
        function: The syntax tree of the function.
    """
    nodes = list(ast.walk(function))
    calls = [node for node in nodes if isinstance(node, ast.Call)]
    names = [ast.unparse(call.func).rsplit(".", 1)[-1] for call in calls]
    asserting = sum(name in _ASSERTING or name.startswith(_ASSERTING_PREFIX) for name in names)
    keywords = [keyword for call in calls for keyword in call.keywords]
    tolerances = [f"{k.arg}={ast.unparse(k.value)}" for k in keywords if k.arg in _TOLERANCES]
    return FunctionContent(asserting + sum(isinstance(node, ast.Assert) for node in nodes), tuple(sorted(tolerances)))


def tests_of(checkout: Path) -> dict[str, list[FunctionContent]]:
    """Return the test functions of a checkout by name; several files may have one of the same name.

    Args:
        checkout: Folder of the checkout.
    """
    tests: dict[str, list[FunctionContent]] = {}
    for path in sorted((checkout / "tests").rglob("*.py")):
        for node in ast.walk(ast.parse(path.read_text("utf-8"))):
            if isinstance(node, ast.FunctionDef):
                tests.setdefault(node.name, []).append(content_of(node))
    return tests


def differences(old: dict[str, list[FunctionContent]], new: dict[str, list[FunctionContent]]) -> list[str]:
    """Return what the new tests lack, a sentence each.

    Args:
        old: Test functions before.
        new: Test functions after.
    """
    found = []
    for name, before in old.items():
        after = new.get(name, [])
        if len(after) < len(before):
            found.append(f"{name}: {len(before)} functions before, {len(after)} after")
        counts = [sum(content.assertions for content in contents) for contents in (before, after)]
        if counts[1] < counts[0]:
            found.append(f"{name}: {counts[0]} assertions before, {counts[1]} after")
        tolerances = [Counter(t for content in contents for t in content.tolerances) for contents in (before, after)]
        if lost := tolerances[0] - tolerances[1]:
            found.append(f"{name}: tolerances that are gone or changed: {', '.join(lost.elements())}")
    return found


def main(arguments: list[str]) -> int:
    """Print the table, and return the exit code."""
    suites = [tests_of(Path(argument)) for argument in arguments]
    print(f"{'':24}{'before':>10}{'after':>10}")
    for words, number in (
        ("test functions", lambda tests: sum(len(v) for k, v in tests.items() if k.startswith("test_"))),
        ("assertions", lambda tests: sum(content.assertions for v in tests.values() for content in v)),
        ("tolerances", lambda tests: sum(len(content.tolerances) for v in tests.values() for content in v)),
    ):
        print(f"{words:24}" + "".join(f"{number(tests):10d}" for tests in suites))
    found = differences(*suites)
    print("\n".join(found) if found else "nothing is lost")
    return int(bool(found))


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
