"""Shared parts of the experiments: command line, shipped recordings, timing, and the table with its JSON file.

An experiment is run as ``python experiments/FOLDER/NAME.py [--quick] [--json FILE] [--out DIR]``. It makes ``Row``s
and hands them to ``finish``.
"""

import argparse
import json
import sys
import time
import warnings
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import asdict, dataclass, field, replace
from pathlib import Path
from types import MappingProxyType
from typing import Any, NoReturn

from experiments.common import results

import numpy as np

from smajax import parameters
from smajax.files.rig_file import Rig, read_rig
from smajax.fitting.fit import fit
from smajax.fitting.problem import Problem, build_problem
from smajax.fitting.result import FitResult
from smajax.plant.plant import Plant
from smajax.recordings.recording import Recording

ROOT = Path(__file__).resolve().parents[2]
DATA = ROOT.parent / "shared" / "data"  # recordings by others


@dataclass(frozen=True)
class Row:
    """One line of the table.

    Attributes:
        what: What was measured.
        target: What it should be.
        measured: What it is.
        met: Whether the target is met; ``None`` where there is none.
        numbers: The numbers behind the texts, for the JSON file.
    """

    what: str
    target: str
    measured: str
    met: bool | None
    numbers: dict[str, Any] = field(default_factory=dict)


def arguments(
    description: str | None,
    *,
    data: str = "",
    quick: str = "end within two minutes on two cores, with the same columns",
    more: Mapping[str, Mapping[str, Any]] = MappingProxyType({}),
) -> argparse.Namespace:
    """Read the command line, and make the folder of ``--out``.

    Args:
        description: Text above the help.
        data: Usual folder of recordings by others; adds the option ``--data``.
        quick: Help of ``--quick``.
        more: Further options, by name, with the keywords of ``add_argument``.

    Returns:
        ``quick`` (bool), ``json`` and ``out`` (paths or ``None``), ``data`` (path) if it is an option, and the options
            of ``more``.
    """
    parser = argparse.ArgumentParser(description=description, formatter_class=argparse.RawDescriptionHelpFormatter)
    if data:
        parser.add_argument(
            "--data",
            type=Path,
            default=DATA / data,
            metavar="DIR",
            help="folder of the recordings, or its name in the folder of recordings by others",
        )
    for name, options in more.items():
        parser.add_argument(name, **options)
    parser.add_argument("--quick", action="store_true", help=quick)
    parser.add_argument("--json", type=Path, metavar="FILE", help="write the numbers to FILE")
    parser.add_argument("--record", action="store_true", help="write the table to experiments/results")
    parser.add_argument("--out", type=Path, metavar="DIR", help="write the pictures to DIR")
    args = parser.parse_args()
    if data and not args.data.exists() and (DATA / args.data).is_dir():
        args.data = DATA / args.data
    if args.out:
        args.out.mkdir(parents=True, exist_ok=True)
    return args


def read_cases(folder: Path | None) -> list[dict[str, Any]]:
    """Read the cases of ``cases.jsonl`` in a folder; skip a line that a killed run left unfinished."""
    path = folder / "cases.jsonl" if folder else None
    lines = path.read_text("utf-8").splitlines(keepends=True) if path and path.is_file() else []
    return [json.loads(line) for line in lines if line.endswith("}\n")]


def add_case(folder: Path | None, case: dict[str, Any]) -> None:
    """Append a finished case to ``cases.jsonl`` in a folder, so that a later run skips it."""
    if folder:
        with (folder / "cases.jsonl").open("a", encoding="utf-8") as file:
            file.write(json.dumps(case) + "\n")


def total_seconds(cases: Iterable[dict[str, Any]]) -> float | None:
    """Return the running time of cases, of this run and of earlier ones; ``None`` if one has no ``seconds``."""
    seconds = [case.get("seconds") for case in cases]
    return None if None in seconds else sum(seconds)


def read_shipped(name: str, part: str = "train") -> tuple[Rig, Recording]:
    """Read the rig and a recording of a folder of data/recordings."""
    folder = ROOT / "data" / "recordings" / name
    rig = read_rig(folder / "rig.toml")
    return rig, rig.read(folder / f"{part}.csv")


def draw_plant(plant: Plant, problem: Problem, box: tuple[np.ndarray, np.ndarray], seed: int) -> Plant:
    """Draw the shared parameters of a plant uniformly within a box.

    Args:
        plant: The plant.
        problem: The fit problem, whose shared parameters are drawn.
        box: Lower and upper ends of the problem's vector.
        seed: Seed of the draw.
    """
    values = np.random.default_rng(1000 + seed).uniform(*box) * np.array([u.scale for u in problem.unknowns])
    return parameters.replace(plant, {name: values[i] for i, name in enumerate(problem.shared)})


def fit_from_starts(
    rig: Rig, recordings: Sequence[Recording], settings: Any, times: int, **options: Any
) -> list[FitResult]:
    """Fit from several points drawn over the search box.

    The shared parameters are drawn, so that no fit but the first knows the rig file's values.

    Args:
        rig: The rig.
        recordings: The recordings that are fitted.
        settings: Settings of each fit, with its number of starts.
        times: Number of points; the first is that of the rig file.
        options: Further arguments of ``fit``.

    Returns:
        The fits, the best first.
    """
    problem = build_problem(rig.plant, recordings, settings, interpolation=rig.interpolation, step=options.get("step"))
    fits = []
    for k in range(times):
        plant = draw_plant(rig.plant, problem, problem.search_bounds(), k) if k else rig.plant
        fits.append(fit(plant, recordings, replace(settings, seed=k), interpolation=rig.interpolation, **options))
        say(f"from start point {k + 1} of {times}: cost {fits[-1].cost:.6g}")
    return sorted(fits, key=lambda f: f.cost)


def agreement(fits: Sequence[FitResult]) -> Row:
    """Count the fits from different start points that end within 0.1 % of the lowest cost."""
    matching = sum(f.cost <= fits[0].cost * 1.001 for f in fits)
    costs = [f.cost for f in fits]
    spread = 100 * (max(costs) / costs[0] - 1)
    text = (
        f"{matching} of {len(fits)} end within 0.1 % of the lowest cost, the worst {spread:.2f} % above; "
        f"{fits[0].starts} starts each; "
    )
    text += fits[0].status.text
    return Row(
        "is it the best that this model can do?",
        "one optimum from all start points",
        text,
        matching == len(fits),
        {"costs": costs},
    )


def estimate_rows(result: FitResult, prefix: str = "") -> list[Row]:
    """Return a row for each shared parameter with its 95 % interval, and one for each collinear group."""
    rows = []
    for e in (e for e in result.estimates if "@" not in e.name):
        interval = f"{e.lower95:.5g} .. {e.upper95:.5g}" if e.lower95 is not None else "-"
        rows.append(
            Row(
                f"{prefix}{e.name}",
                "-",
                f"{e.estimate:.5g} {e.unit} ({'held at its bound' if e.at_bound else interval})",
                None,
            )
        )
    for group in result.collinear_groups:
        what = f"{', '.join(group.parameters)} together leave {100 * group.shrink:.1f} % of their effect"
        rows.append(Row(f"{prefix}not distinguishable", "-", what, None))
    return rows


def workbook(path: Path) -> dict[str, list[tuple]]:
    """Read the rows of a workbook by sheet, cells as they are stored; exit where the file is not a workbook."""
    try:
        import openpyxl
    except ImportError:
        refuse('reading a workbook needs openpyxl: pip install "smajax[io]"')
    try:
        with warnings.catch_warnings():
            warnings.filterwarnings("ignore", message="Unknown extension")
            book = openpyxl.load_workbook(path, read_only=True, data_only=True)
            return {name: list(book[name].iter_rows(values_only=True)) for name in book.sheetnames}
    except Exception as error:  # openpyxl raises many types
        refuse(f"{path} cannot be read as a workbook: {str(error).splitlines()[0]}")


def refuse(sentence: str) -> NoReturn:
    """Exit because of bad input: one sentence on stderr, exit code 2."""
    print(sentence, file=sys.stderr)
    sys.exit(2)


def say(text: str) -> None:
    """Print the progress of an experiment on stderr."""
    print(f"... {text}", file=sys.stderr, flush=True)


def medians(repeats: int, functions: dict[str, Callable[[], Any]]) -> dict[str, float]:
    """Return the median wall time of each function, called in turn ``repeats`` times after one call to warm up.

    They are called in turn, so that other load on the machine affects all of them equally.
    """
    for function in functions.values():
        function()
    seconds: dict[str, list[float]] = {name: [] for name in functions}
    for _ in range(repeats):
        for name, function in functions.items():
            start = time.perf_counter()
            function()
            seconds[name].append(time.perf_counter() - start)
    return {name: float(np.median(samples)) for name, samples in seconds.items()}


def exponent(sizes: Sequence[float], seconds: Sequence[float]) -> float:
    """Return the slope of log(seconds) over log(sizes) by least squares."""
    return float(np.polyfit(np.log(sizes), np.log(seconds), 1)[0])


def finish(
    rows: Sequence[Row],
    args: argparse.Namespace,
    *,
    words: str = "",
    resumed: bool = False,
    seconds: float | None = None,
    **facts: Any,
) -> None:
    """Print the table, and write it to the JSON file and to the folder of results if the command line asks for it.

    Args:
        rows: The lines of the table.
        args: The command line, as ``arguments`` gives it.
        words: Options that change the result, as they are written on the command line, with a blank before each.
        resumed: Whether a part of the numbers is of an earlier run.
        seconds: Running time of all parts of a resumed run, if it is known.
        facts: Further entries of the JSON document.
    """
    print(
        table(["what", "target", "measured", "met"], [(r.what, r.target, r.measured, _yes_or_no(r.met)) for r in rows])
    )
    document = results.document_of([asdict(row) for row in rows], words, args.quick, resumed, seconds)
    if args.json:
        results.write(args.json, document | facts)
    if args.record:
        say(f"recorded in {results.record(document)}")


def table(head: Sequence[str], rows: Iterable[Sequence[str]]) -> str:
    """Return a table in Markdown, its columns padded so that it is readable in a terminal."""
    lines = [list(head), *[[str(cell).replace("|", "/") for cell in row] for row in rows]]
    widths = [max(len(line[i]) for line in lines) for i in range(len(head))]
    lines.insert(1, ["-" * width for width in widths])
    return "\n".join(
        "| " + " | ".join(cell.ljust(width) for cell, width in zip(line, widths, strict=True)) + " |" for line in lines
    )


def _yes_or_no(met: bool | None) -> str:
    return "-" if met is None else "yes" if met else "no"
