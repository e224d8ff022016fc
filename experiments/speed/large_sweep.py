"""Sweeps of up to a million designs on a local Dask cluster: time, memory and table by number of designs.

    python experiments/speed/large_sweep.py [--quick] [--json FILE] [--out DIR]

The shipped wire that lifts a weight is swept over diameter, load and current by ``smajax sweep --scheduler local``,
with a worker on each of two cores. Memory is the resident one of the run, its workers and the scheduler together, read
every fifth of a second; the time is that of the whole process. --quick takes 4,000 to 64,000 designs.
"""

import subprocess
import sys
import tempfile
import threading
import time
from pathlib import Path
from typing import NamedTuple

sys.path.insert(0, str(Path(__file__).resolve().parents[2]))  # the checkout: smajax, tests/reference, experiments

from experiments.common.base import ROOT, Row, arguments, finish, say
from experiments.speed.sweep_interruptions import SWEEP

import numpy as np
import psutil
import pyarrow.parquet as parquet

COUNTS = (62_500, 250_000, 1_000_000)
QUICK_COUNTS = (4_000, 16_000, 64_000)
# Growth of the time with the number of designs that counts as linear, as in sweep_throughput.py.
EXPONENT = 1.05
# Memory of two workers, scheduler and run; the table with its copies is 0.4 GB for a million designs.
LARGEST_MEMORY = 4e9
MEGABYTE = 1e6
BILLION = 1e9
# Workers of a local cluster on two cores.
WORKERS = 2
_PAUSE = 0.2


class Sweep(NamedTuple):
    """What a sweep took.

    Attributes:
        designs: Number of designs.
        seconds: Seconds of the process.
        memory: Largest memory of the run, its workers and the scheduler together, bytes.
        workers: Largest memory of one worker, bytes.
        rows: Rows of the table.
        file: Bytes of the table in its file.
    """

    designs: int
    seconds: float
    memory: int
    workers: int
    rows: int
    file: int


def main() -> None:
    """Print the table."""
    args = arguments(__doc__)
    with tempfile.TemporaryDirectory() as folder:
        sweeps = [run(Path(folder), count) for count in (QUICK_COUNTS if args.quick else COUNTS)]
    finish(rows_of(sweeps), args)


def run(folder: Path, designs: int) -> Sweep:
    """Run a sweep in a separate process, and measure its memory."""
    rig = ROOT / "data" / "recordings" / "dead-weight" / "rig.toml"
    text = SWEEP.format(rig=rig, count=designs).replace("chunk = 64\n", "")
    (folder / "sweep.toml").write_text(text, "utf-8")
    out = folder / f"sweep-{designs}"
    words = ["sweep", str(folder / "sweep.toml"), "--out", str(out), "--scheduler", "local", "--quiet"]
    start = time.perf_counter()
    process = subprocess.Popen([sys.executable, "-m", "smajax", *words], cwd=folder)
    peaks = [0, 0]
    watcher = threading.Thread(target=watch, args=(process, peaks))
    watcher.start()
    code = process.wait()
    seconds = time.perf_counter() - start
    watcher.join()
    if code:
        raise SystemExit(f"smajax sweep of {designs:,} designs ended with {code}")
    table = out / "sweep.parquet"
    sweep = Sweep(designs, seconds, *peaks, parquet.read_metadata(table).num_rows, table.stat().st_size)
    say(f"{designs:,} designs: {seconds:.0f} s, {sweep.memory / MEGABYTE:,.0f} MB")
    return sweep


def watch(process: subprocess.Popen, peaks: list[int]) -> None:
    """Keep the largest memory of a process with its children, and of one child, until the process has ended."""
    while process.poll() is None:
        try:
            own = psutil.Process(process.pid)
            children = [child.memory_info().rss for child in own.children(recursive=True)]
            peaks[0] = max(peaks[0], own.memory_info().rss + sum(children))
            peaks[1] = max([peaks[1], *children])
        except psutil.NoSuchProcess:
            pass
        time.sleep(_PAUSE)


def rows_of(sweeps: list[Sweep]) -> list[Row]:
    """Return the rows of the table."""
    largest = sweeps[-1]
    counts, seconds = ([getattr(s, name) for s in sweeps] for name in ("designs", "seconds"))
    more, longer = np.diff(counts), np.diff(seconds)  # without the start-up, which is the same for all
    exponent = float(np.log(longer[-1] / longer[0]) / np.log(more[-1] / more[0]))
    rate = (counts[-1] - counts[0]) / (seconds[-1] - seconds[0])
    hours, size = WORKERS * BILLION / rate / 3600.0, BILLION * largest.file / largest.designs / 1e9
    sizes = [f"{s.designs:,}: {s.seconds:.0f} s" for s in sweeps]
    memory = [f"{s.designs:,}: {s.memory / MEGABYTE:,.0f} MB" for s in sweeps]
    return [
        Row("designs in the table", "all", f"{largest.rows:,}", all(s.rows == s.designs for s in sweeps)),
        Row("time", "-", ", ".join(sizes), None, {"seconds": dict(zip(map(str, counts), seconds, strict=True))}),
        Row(
            "growth of the time with the number of designs, start-up left out",
            f"exponent <= {EXPONENT}",
            f"{exponent:.3f}",
            exponent <= EXPONENT,
        ),
        Row("designs a second, two workers, start-up left out", "-", f"{rate:,.0f}", None, {"rate": rate}),
        Row(
            "memory of all processes",
            f"<= {LARGEST_MEMORY / 1e9:.0f} GB",
            ", ".join(memory),
            largest.memory <= LARGEST_MEMORY,
            {"memory": {str(s.designs): s.memory for s in sweeps}},
        ),
        Row("memory of one worker", "-", f"{largest.workers / MEGABYTE:,.0f} MB", None, {"worker": largest.workers}),
        Row(
            "bytes of a design in the table's file",
            "-",
            f"{largest.file / largest.designs:.0f}",
            None,
            {"bytes": largest.file / largest.designs},
        ),
        Row(
            "a billion designs at this rate",
            "-",
            f"{hours:,.0f} core-hours, {size:.0f} GB of tables",
            None,
        ),
    ]


if __name__ == "__main__":
    main()
