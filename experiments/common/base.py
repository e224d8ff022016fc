"""What the experiments share.

Their arguments, the shipped recordings, timing side by side, and the table with its JSON file.

An experiment is run as ``python experiments/NAME.py [--quick] [--json FILE] [--out DIR]``. It makes ``Row``s and
hands them to ``finish``.
"""

import argparse
import json
import os
import platform
import sys
import time
import warnings
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import asdict, dataclass, field, replace
from importlib.metadata import version
from pathlib import Path
from types import MappingProxyType
from typing import Any, NoReturn

import numpy as np

from smajax import parameters
from smajax.files.rig_file import Rig, read_rig
from smajax.fitting.fit import fit
from smajax.fitting.problem import Problem, build_problem
from smajax.fitting.result import FitResult
from smajax.plant.plant import Plant
from smajax.recordings.recording import Recording

ROOT = Path(__file__).resolve().parents[2]
EXPERIMENTS = ROOT / "experiments"
DATA = ROOT.parent / "shared" / "data"  # recordings by others


@dataclass(frozen=True)
class Row:
    """One line of the table.

    What was measured, what it should be, what it is, and whether that is met (``None``: there is no target).

    ``numbers`` go to the JSON file beside the texts.
    """

    what: str
    target: str
    measured: str
    met: bool | None
    numbers: dict[str, Any] = field(default_factory=dict)


def arguments(
    description: str,
    *,
    data: str = "",
    quick: str = "end within two minutes on two cores, with the same columns",
    more: Mapping[str, Mapping[str, Any]] = MappingProxyType({}),
) -> argparse.Namespace:
    """``quick`` (bool), ``json`` and ``out`` (paths or ``None``) from the command line; makes the folder ``out``.

    With ``data``, the usual folder of recordings by others, also ``data`` (path); ``more`` are further options.
    """
    parser = argparse.ArgumentParser(description=description, formatter_class=argparse.RawDescriptionHelpFormatter)
    if data:
        parser.add_argument(
            "--data",
            type=Path,
            default=DATA / data,
            metavar="DIR",
            help="folder of the recordings, or its name among those by others",
        )
    for name, options in more.items():
        parser.add_argument(name, **options)
    parser.add_argument("--quick", action="store_true", help=quick)
    parser.add_argument("--json", type=Path, metavar="FILE", help="write the numbers to FILE")
    parser.add_argument("--out", type=Path, metavar="DIR", help="write the pictures to DIR")
    given = parser.parse_args()
    if data and not given.data.exists() and (DATA / given.data).is_dir():
        given.data = DATA / given.data
    if given.out:
        given.out.mkdir(parents=True, exist_ok=True)
    return given


def read_cases(folder: Path | None) -> list[dict[str, Any]]:
    """The cases of ``cases.jsonl`` in a folder, none without; a line that a killed run left unfinished is none."""
    path = folder / "cases.jsonl" if folder else None
    lines = path.read_text("utf-8").splitlines(keepends=True) if path and path.is_file() else []
    return [json.loads(line) for line in lines if line.endswith("}\n")]


def add_case(folder: Path | None, case: dict[str, Any]) -> None:
    """Append a case that has ended to ``cases.jsonl`` in a folder, so that a later run skips it."""
    if folder:
        with (folder / "cases.jsonl").open("a", encoding="utf-8") as file:
            file.write(json.dumps(case) + "\n")


def shipped(name: str, part: str = "train") -> tuple[Rig, Recording]:
    """Rig and recording of a folder in data/recordings/."""
    folder = ROOT / "data" / "recordings" / name
    rig = read_rig(folder / "rig.toml")
    return rig, rig.read(folder / f"{part}.csv")


def drawn(plant: Plant, problem: Problem, box: tuple[np.ndarray, np.ndarray], seed: int) -> Plant:
    """The plant with the shared parameters drawn uniformly between the ends of a box of the problem's vector."""
    found = np.random.default_rng(1000 + seed).uniform(*box) * np.array([u.scale for u in problem.unknowns])
    return parameters.replace(plant, {name: found[i] for i, name in enumerate(problem.shared)})


def from_elsewhere(
    rig: Rig, recordings: Sequence[Recording], settings: Any, times: int, **options: Any
) -> list[FitResult]:
    """Fits from ``times`` points drawn over the search box, each with as many starts as ``settings`` has.

    The best fit first.

    The shared parameters are drawn, so that no fit but the first knows the rig file's values.
    """
    problem = build_problem(rig.plant, recordings, settings, interpolation=rig.interpolation, step=options.get("step"))
    fits = []
    for k in range(times):
        plant = drawn(rig.plant, problem, problem.search_bounds(), k) if k else rig.plant
        fits.append(fit(plant, recordings, replace(settings, seed=k), interpolation=rig.interpolation, **options))
        say(f"from start point {k + 1} of {times}: cost {fits[-1].cost:.6g}")
    return sorted(fits, key=lambda f: f.cost)


def agreement(fits: Sequence[FitResult]) -> Row:
    """How many of the fits from different start points end at the best one's cost, within 0.1 %."""
    same = sum(f.cost <= fits[0].cost * 1.001 for f in fits)
    costs = [f.cost for f in fits]
    apart = 100 * (max(costs) / costs[0] - 1)
    text = (
        f"{same} of {len(fits)} end within 0.1 % of the lowest cost, the worst {apart:.2f} % above; "
        f"{fits[0].starts} starts each; "
    )
    text += fits[0].status.text
    return Row(
        "is it the best that this model can do?",
        "one optimum from all start points",
        text,
        same == len(fits),
        {"costs": costs},
    )


def estimate_rows(result: FitResult, prefix: str = "") -> list[Row]:
    """One row for each shared parameter with its 95 % interval, and one for each collinear group."""
    rows = []
    for e in (e for e in result.estimates if "@" not in e.name):
        known = f"{e.lower95:.5g} .. {e.upper95:.5g}" if e.lower95 is not None else "-"
        rows.append(
            Row(
                f"{prefix}{e.name}",
                "-",
                f"{e.estimate:.5g} {e.unit} ({'held at its bound' if e.at_bound else known})",
                None,
            )
        )
    for group in result.collinear_groups:
        what = f"{', '.join(group.parameters)} together leave {100 * group.shrink:.1f} % of their effect"
        rows.append(Row(f"{prefix}not distinguishable", "-", what, None))
    return rows


def workbook(path: Path) -> dict[str, list[tuple]]:
    """The rows of a workbook by sheet, cells as they are stored. Refuses a file that is none."""
    try:
        import openpyxl
    except ImportError:
        refuse('reading a workbook needs openpyxl: pip install "smajax[io]"')
    try:
        with warnings.catch_warnings():
            warnings.filterwarnings("ignore", message="Unknown extension")
            book = openpyxl.load_workbook(path, read_only=True, data_only=True)
            return {name: list(book[name].iter_rows(values_only=True)) for name in book.sheetnames}
    except Exception as error:  # openpyxl raises whatever it stumbles over
        refuse(f"{path} cannot be read as a workbook: {str(error).splitlines()[0]}")


def refuse(sentence: str) -> NoReturn:
    """Ends the experiment for bad input: one sentence on stderr, exit code 2."""
    print(sentence, file=sys.stderr)
    sys.exit(2)


def say(text: str) -> None:
    """What is being done, on stderr."""
    print(f"... {text}", file=sys.stderr, flush=True)


def medians(repeats: int, functions: dict[str, Callable[[], Any]]) -> dict[str, float]:
    """Median wall seconds of each function, called in turn ``repeats`` times after one call to warm up.

    In turn, so that whatever else the machine does falls on all of them alike.
    """
    for function in functions.values():
        function()
    seconds: dict[str, list[float]] = {name: [] for name in functions}
    for _ in range(repeats):
        for name, function in functions.items():
            began = time.perf_counter()
            function()
            seconds[name].append(time.perf_counter() - began)
    return {name: float(np.median(taken)) for name, taken in seconds.items()}


def exponent(sizes: Sequence[float], seconds: Sequence[float]) -> float:
    """Slope of log(seconds) over log(sizes) by least squares."""
    return float(np.polyfit(np.log(sizes), np.log(seconds), 1)[0])


def experiment_name() -> str:
    """The path of the running experiment below experiments/, without suffix, as in ``papers/hip/hip_gains``."""
    path = Path(sys.argv[0]).resolve().with_suffix("")
    return path.relative_to(EXPERIMENTS).as_posix() if path.is_relative_to(EXPERIMENTS) else path.name


def finish(rows: Sequence[Row], args: argparse.Namespace, **facts: Any) -> None:
    """Print the table, and write it to the JSON file if the command line names one.

    Args:
        rows: The lines of the table.
        args: The command line, as ``arguments`` gives it.
        facts: Further entries of the JSON document.
    """
    print(table(["what", "target", "measured", "met"], [(r.what, r.target, r.measured, _word(r.met)) for r in rows]))
    if args.json:
        document = {
            "experiment": experiment_name(),
            "quick": args.quick,
            "rows": [asdict(row) for row in rows],
            "machine": machine(),
            **facts,
        }
        part = args.json.with_name(f".{args.json.name}.part")
        part.write_text(json.dumps(document, indent=1, default=_plain) + "\n", encoding="utf-8")
        os.replace(part, args.json)


def table(head: Sequence[str], rows: Iterable[Sequence[str]]) -> str:
    """A table in Markdown, its columns padded so that it reads well in a terminal, too."""
    lines = [list(head), *[[str(cell).replace("|", "/") for cell in row] for row in rows]]
    widths = [max(len(line[i]) for line in lines) for i in range(len(head))]
    lines.insert(1, ["-" * width for width in widths])
    return "\n".join(
        "| " + " | ".join(cell.ljust(width) for cell, width in zip(line, widths, strict=True)) + " |" for line in lines
    )


def machine() -> dict[str, Any]:
    """The machine and the versions that the numbers come from."""
    versions = {package: version(package) for package in ("jax", "diffrax", "equinox", "numpy", "scipy")}
    return {"processor": platform.machine(), "cores": os.cpu_count(), "python": platform.python_version()} | versions


def _word(met: bool | None) -> str:
    return "-" if met is None else "yes" if met else "no"


def _plain(value: Any) -> Any:
    return value.tolist() if hasattr(value, "tolist") else str(value)
