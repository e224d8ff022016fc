"""Execution of the cells of a notebook: ``python -m docs.generate.run_cells CELLS.json OUTPUTS.json``.

The first file has the sources of the cells, the second one gets their outputs in the same order.
"""

import ast
import contextlib
import io
import json
import pprint
import sys
from pathlib import Path
from typing import Any, TypedDict

# Width of a value that a cell shows, in columns.
WIDTH = 100


class Output(TypedDict):
    """Output of a cell.

    Attributes:
        text: What it prints, and the value of its last expression.
        figure: The plotly figure that its last expression is, as JSON; empty for none.
    """

    text: str
    figure: str


def execute(sources: list[str]) -> list[Output]:
    """Execute cells in one namespace, as a notebook does.

    Args:
        sources: Source of each cell.

    Returns:
        Output of each cell.

    Raises:
        Exception: The error of a cell; the cells after it are not executed.
    """
    namespace: dict[str, Any] = {"__name__": "__main__"}
    return [_output(source, f"cell {number}", namespace) for number, source in enumerate(sources, 1)]


def _output(source: str, name: str, namespace: dict[str, Any]) -> Output:
    statements = ast.parse(source, name).body
    last = statements.pop() if statements and isinstance(statements[-1], ast.Expr) else None
    printed, value = io.StringIO(), None
    with contextlib.redirect_stdout(printed):
        exec(compile(ast.Module(statements, []), name, "exec"), namespace)
        if isinstance(last, ast.Expr):
            value = eval(compile(ast.Expression(last.value), name, "eval"), namespace)
    if hasattr(value, "to_plotly_json"):
        return {"text": printed.getvalue(), "figure": value.to_json()}
    shown = "" if value is None else pprint.pformat(value, width=WIDTH, compact=True)
    return {"text": printed.getvalue() + shown, "figure": ""}


if __name__ == "__main__":
    cells = json.loads(Path(sys.argv[1]).read_text("utf-8"))
    Path(sys.argv[2]).write_text(json.dumps(execute(cells)), "utf-8")
