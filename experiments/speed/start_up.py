"""Where the time of each command goes, with an empty cache of compiled programs and with a full one.

    python experiments/speed/start_up.py [--quick] [--json FILE] [--record]

Each command runs in a process of its own on the example of ``smajax init dead-weight`` (recordings of 6,001 rows):
first with an empty cache, and then, with the programs of that run, on another recording of the same kind where there is
one. The package is compiled to bytecode before, as an installation does. Seconds are split into importing, reading,
tracing, lowering, compiling, running and writing; each moment counts once. Commands of less than two seconds run five
times, others as often as the table says; the median counts.
"""

import shutil
import subprocess
import sys
import tempfile
from collections.abc import Sequence
from pathlib import Path
from typing import NamedTuple

sys.path.insert(0, str(Path(__file__).resolve().parents[2]))  # the checkout: smajax, tests/reference, experiments

from experiments.common.base import ROOT, Row, arguments, finish, say
from experiments.common.process_phases import ProcessTimes, compile_package, measure, median_of

# Runs of a command that takes less than two seconds.
REPEATS = 5
LAWS = "brinson,lagoudas,tanaka,liang-rogers"


class Case(NamedTuple):
    """A command.

    Attributes:
        name: Name in the table.
        words: The command with an empty cache; ``{run}`` is the number of the run.
        cold: Largest seconds with an empty cache; ``None`` for no target.
        again: The command with the programs of the first run; empty for none.
        warm: Largest seconds of that.
        code: Exit code.
        is_short: Whether it runs five times and without a cache, so that it is part of a quick run, too.
    """

    name: str
    words: str
    cold: float | None = None
    again: str = ""
    warm: float | None = None
    code: int = 0
    is_short: bool = False


CASES = (
    Case("a missing file", "fit missing.toml train.csv --out r", 1.0, code=2, is_short=True),
    Case("an unknown key", "fit wrong.toml train.csv --out r", 1.0, code=2, is_short=True),
    Case("a bad cell", "fit example.toml wrong.csv --out r", 1.0, code=2, is_short=True),
    Case("a wrong option", "fit --nothing", 1.0, code=2, is_short=True),
    Case("--help", "--help", 1.0, is_short=True),
    Case("init", "init hip --out another-{run}", 1.0, is_short=True),
    Case("check, rig", "check example.toml", 2.5, is_short=True),
    Case("explain", "explain at-bound", is_short=True),
    Case("effects", "effects", is_short=True),
    Case("sets", "sets", is_short=True),
    Case("datasets", "datasets list", is_short=True),
    Case("check, rig and recording", "check example.toml train.csv", None, "check example.toml select.csv", 2.5),
    Case("simulate", "simulate example.toml train.csv --out s1", None, "simulate example.toml select.csv --out s2"),
    Case("fit", "fit example.toml train.csv --out f1", 8.0, "fit example.toml select.csv --out f2", 3.0),
    Case("properties", "properties cycles.csv", None, "properties cycles.csv"),
    Case("demo", "demo --out d1 --no-open", 30.0, "demo --out d2 --no-open", 10.0),
    Case(
        "diagnose",
        "diagnose example.toml train.csv --select select.csv --holdout holdout.csv --out g1",
        45.0,
        "diagnose example.toml train.csv --select select.csv --holdout holdout.csv --out g2",
        15.0,
    ),
    Case(
        "compare of the four material laws",
        f"compare example.toml train.csv --holdout holdout.csv --models {LAWS} --out c1",
        None,
        f"compare example.toml train.csv --holdout holdout.csv --models {LAWS} --out c2",
        20.0,
    ),
    Case(
        "compare of all models",
        "compare example.toml train.csv --holdout holdout.csv --out c3",
        None,
        "compare example.toml train.csv --holdout holdout.csv --out c4",
        120.0,
    ),
    Case("tune", "tune example.toml controller.toml --out t1", None, "tune example.toml controller.toml --out t2"),
    Case("sweep of 1,024 designs", "sweep sweep.toml --out w1", None, "sweep sweep.toml --out w2"),
)


def write_files(folder: Path) -> None:
    """Write the files of the commands: the example, and each mistake."""
    subprocess.run([sys.executable, "-m", "smajax", "init", "dead-weight", "--out", str(folder)], check=True)
    rig, recording = ((folder / name).read_text("utf-8") for name in ("example.toml", "train.csv"))
    (folder / "wrong.toml").write_text(rig.replace("h0 =", "h00 ="), "utf-8")
    (folder / "wrong.csv").write_text(recording.replace("0.02,", "0.02x,", 1), "utf-8")
    shutil.copy(ROOT / "data" / "recordings" / "isobaric" / "cycles.csv", folder / "cycles.csv")


def row(what: str, target: float | None, runs: Sequence[ProcessTimes]) -> Row:
    """Return the line of a command in the table."""
    run = median_of(runs)
    of = f" (median of {len(runs)})" if len(runs) > 1 else " (one run)"
    numbers = {"wall": run.wall, "processor": run.processor, **run.seconds, "peak": run.peak, "programs": run.programs}
    met = None if target is None else run.wall <= target
    return Row(what, "-" if target is None else f"at most {target:g} s", run.text() + of, met, numbers)


def rows_of(case: Case, folder: Path, repeats: int) -> list[Row]:
    """Measure a command with an empty cache, and with the programs of that run."""
    say(case.name)
    rows = []
    with tempfile.TemporaryDirectory() as cache:
        times = REPEATS if case.is_short else 1
        runs = [measure(case.words.format(run=run).split(), folder, Path(cache)) for run in range(times)]
        if any(run.code != case.code for run in runs):
            raise RuntimeError(f"'smajax {case.words}' ended with code {runs[0].code}")
        rows.append(row(case.name if case.is_short else f"{case.name}, empty cache", case.cold, runs))
        if case.again:
            again = [measure(case.again.split(), folder, Path(cache)) for _ in range(repeats)]
            rows.append(row(f"{case.name}, full cache", case.warm, again))
    return rows


def import_row() -> Row:
    """Time ``import smajax`` alone, over the start of Python."""
    program = "import time; b = time.perf_counter(); import smajax; print(time.perf_counter() - b)"
    runs = [
        float(subprocess.run([sys.executable, "-c", program], capture_output=True, text=True, check=True).stdout)
        for _ in range(REPEATS)
    ]
    seconds = sorted(runs)[REPEATS // 2]
    return Row("import smajax", "at most 0.15 s", f"{seconds:.3f} s (median of {REPEATS})", seconds <= 0.15, {})


def main() -> None:
    """Run the experiment."""
    options = arguments(__doc__, more={"--repeats": {"type": int, "default": 1, "help": "runs with a full cache"}})
    with tempfile.TemporaryDirectory() as scratch:
        folder = Path(scratch)
        compile_package()
        write_files(folder)
        cases = [case for case in CASES if case.is_short or not options.quick]
        rows = [import_row(), *(line for case in cases for line in rows_of(case, folder, options.repeats))]
    finish(rows, options)


if __name__ == "__main__":
    main()
