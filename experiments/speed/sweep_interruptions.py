"""A sweep whose runs and workers are killed at random moments and resumed until it is complete.

    python experiments/speed/sweep_interruptions.py [--quick] [--json FILE] [--out DIR]

A sweep runs once in one process, and once on two workers, without interruption. Then it is resumed again and again, in
one process or on a local Dask cluster of worker processes, and the whole run is killed (SIGKILL) at a random moment; of
a cluster one worker is killed first. When the sweep is complete another one starts, until enough runs and workers have
been killed. The tables must be the same, byte for byte: no row lost, none doubled; and no chunk that was written before
a kill may be lost or computed again.
"""

import contextlib
import os
import random
import shutil
import signal
import subprocess
import sys
import tempfile
import time
from pathlib import Path

sys.path.insert(0, str(Path(__file__).resolve().parents[2]))  # the checkout: smajax, tests/reference, experiments

from experiments.common.base import ROOT, Row, arguments, finish, say

import numpy as np

from smajax.sweeps.table import read_table
from tests.support.processes import workers_of

SWEEP = """
[sweep]
rig = "{rig}"
designs = {count}
chunk = 64
metrics = ["stroke", "peak_temperature"]
sensitivity = false
[parameters]
wire.diameter = ["0.14 mm", "0.2 mm"]
load.mass = ["100 g", "300 g"]
input.amplitude = ["0.3 A", "0.6 A"]
[input]
wave = "square"
amplitude = "0.4 A"
frequency = "0.2 Hz"
cycles = 8
[objectives]
stroke = "max"
"""


def interrupt(folder: Path, kills: dict[str, int], deaths: int, span: float) -> tuple[int, int]:
    """Resume the sweep and kill a run or a worker at a random moment.

    Args:
        folder: Where the sweep works.
        kills: Runs and workers killed so far, which is updated.
        deaths: How many of each kind are to be killed.
        span: Seconds that an uninterrupted sweep takes.

    Returns:
        The number of chunks that were there before, and of those that were lost or computed again.
    """
    chunks_before = lost_chunks = 0
    # Runs of one process and of a cluster alternate until enough of one kind have been killed.
    clustered = kills["workers"] < deaths and (kills["runs"] >= deaths or kills["workers"] <= kills["runs"])
    process = start_sweep(folder, "torn", "--resume", *(("--scheduler", "local") if clustered else ()))
    before = chunks_in(folder)
    at_work = wait_for_chunk(process, folder, before)
    time.sleep(random.uniform(0.0, 0.2) * span if at_work else 0.0)
    if clustered and (workers := workers_of(process.pid)):
        random.choice(workers).kill()
        kills["workers"] += 1
        time.sleep(random.uniform(0.5, 3.0))
    if process.poll() is None:
        os.killpg(process.pid, signal.SIGKILL)
        kills["runs"] += 1
    process.communicate()
    after = chunks_in(folder)
    if not (folder / "torn").is_dir():
        chunks_before = len(before)
        lost_chunks = sum(after.get(file) != made for file, made in before.items())
    say(f"{kills['runs']} runs and {kills['workers']} workers killed, {len(after)} chunks there")
    return chunks_before, lost_chunks


def main() -> None:
    """Print the table."""
    args = arguments(__doc__ or "")
    deaths, count = (2, 8_000) if args.quick else (20, 40_000)
    random.seed(0)
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        (folder / "sweep.toml").write_text(
            SWEEP.format(rig=ROOT / "data" / "recordings" / "dead-weight" / "rig.toml", count=count), "utf-8"
        )
        start = time.perf_counter()
        say("once, undisturbed")
        start_sweep(folder, "whole").communicate()
        span = time.perf_counter() - start
        say("once on two workers, undisturbed")
        start_sweep(folder, "shared", "--scheduler", "local").communicate()
        whole = (folder / "whole" / "sweep.parquet").read_bytes()
        shared = (folder / "shared" / "sweep.parquet").read_bytes() == whole
        kills = {"runs": 0, "workers": 0}
        chunks_before, lost_total, results = 0, 0, []
        while min(kills.values()) < deaths:
            if (folder / "torn").is_dir():
                results.append(check_table(folder, whole, count))
            before, lost_chunks = interrupt(folder, kills, deaths, span)
            chunks_before = chunks_before + before
            lost_total = lost_total + lost_chunks
        _, errors = start_sweep(folder, "torn", "--resume").communicate()
        results.append(check_table(folder, whole, count))
    text = f"{kills['runs']} runs and {kills['workers']} workers killed"
    rows = [
        Row(
            "two workers against one process, undisturbed",
            "the same bytes",
            "the same" if shared else "others",
            shared,
        ),
        Row("deaths", f"{deaths} runs and {deaths} workers", text, min(kills.values()) >= deaths, kills),
        Row(
            "chunks there before a death that were lost or made again",
            "none",
            f"{lost_total:,} of {chunks_before:,}",
            not lost_total if chunks_before else None,
        ),
    ]
    finish([*rows, *table_rows(results, count, not errors)], args, designs=count)


def table_rows(results: list[dict[str, int]], count: int, ended_well: bool) -> list[Row]:
    """Return the rows about the tables of the sweeps.

    Args:
        results: What ``check_table`` has found of each sweep.
        count: Number of designs.
        ended_well: Whether the last run printed no error.
    """
    lost, doubled = (sum(result[key] for result in results) for key in ("lost", "doubled"))
    is_same = ended_well and all(result["same"] for result in results)
    return [
        Row(
            "rows lost or doubled",
            "none",
            f"{lost} and {doubled} of {count:,}, in {len(results)} sweeps",
            not lost and not doubled,
            {"lost": lost, "doubled": doubled, "sweeps": len(results)},
        ),
        Row("the table against the undisturbed one's", "the same bytes", "the same" if is_same else "others", is_same),
    ]


def check_table(folder: Path, whole: bytes, count: int) -> dict[str, int]:
    """Check the table of a sweep that was killed and completed, and remove it.

    Args:
        folder: Where the sweep works.
        whole: The uninterrupted sweep's table.
        count: Number of designs.

    Returns:
        Rows lost and doubled, and whether the table is that of the uninterrupted sweep.
    """
    table = folder / "torn" / "sweep.parquet"
    rows = read_table(table)["design"]
    result = {
        "lost": count - len(np.unique(rows)),
        "doubled": len(rows) - len(np.unique(rows)),
        "same": table.read_bytes() == whole,
    }
    shutil.rmtree(folder / "torn")
    return result


def wait_for_chunk(process: subprocess.Popen, folder: Path, before: dict[str, int]) -> bool:
    """Wait until a run has written a chunk, so that it is killed at work; return False if it ended.

    Args:
        process: The run.
        folder: Where the sweep works.
        before: The chunks that were there before.
    """
    while process.poll() is None:
        if len(chunks_in(folder)) > len(before):
            return True
        time.sleep(0.02)
    return False


def start_sweep(folder: Path, out: str, *options: str) -> subprocess.Popen:
    """Start the sweep as a user does, in its own process group."""
    call = [
        sys.executable,
        "-m",
        "smajax",
        "sweep",
        str(folder / "sweep.toml"),
        "--out",
        str(folder / out),
        "--quiet",
        *options,
    ]
    environment = {**os.environ, "PYTHONPATH": str(ROOT)}
    return subprocess.Popen(
        call, env=environment, stdout=subprocess.DEVNULL, stderr=subprocess.PIPE, text=True, start_new_session=True
    )


def chunks_in(folder: Path) -> dict[str, int]:
    """Return the chunks on disk by name, with the time at which each was written."""
    times = {}
    for path in (folder / "torn.partial").glob("chunk-*.parquet"):
        with contextlib.suppress(FileNotFoundError):  # the run has ended and removes its chunks
            times[path.name] = path.stat().st_mtime_ns
    return times


if __name__ == "__main__":
    main()
