"""A sweep that dies: runs and workers are killed at random moments, and the sweep is resumed until it is done.
 A sweep runs once in one process, and once on two workers. Then it runs again and again from what is there, in one
process or on a local Dask cluster of worker processes; at a random moment the whole run is killed (SIGKILL), of a
cluster one of its workers first. A sweep that is done is followed by another, until both kinds have died often
enough. In the end the tables have to be the same, byte for byte: no row lost, none doubled; and no chunk that was
there before a death may be lost or made again.
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


def interrupt(folder: Path, died: dict[str, int], deaths: int, span: float) -> tuple[int, int]:
    """Resume the sweep and kill a run or a worker at a random moment.

    Args:
        folder: Where the sweep works.
        died: Runs and workers killed so far; counted on.
        deaths: How many of each kind are wanted.
        span: Seconds that an undisturbed sweep takes.

    Returns:
        The chunks that were there before, and how many of them were lost or made again.
    """
    kept = again = 0
    # Runs of one process and of a cluster in turn, until one kind has died often enough.
    clustered = died["workers"] < deaths and (died["runs"] >= deaths or died["workers"] <= died["runs"])
    process = command(folder, "torn", "--resume", *(("--scheduler", "local") if clustered else ()))
    before = chunks_in(folder)
    at_work = wait_for_more(process, folder, before)
    time.sleep(random.uniform(0.0, 0.2) * span if at_work else 0.0)
    if clustered and (workers := workers_of(process.pid)):
        random.choice(workers).kill()
        died["workers"] += 1
        time.sleep(random.uniform(0.5, 3.0))
    if process.poll() is None:
        os.killpg(process.pid, signal.SIGKILL)
        died["runs"] += 1
    process.communicate()
    after = chunks_in(folder)
    if not (folder / "torn").is_dir():
        kept = len(before)
        again = sum(after.get(file) != made for file, made in before.items())
    say(f"{died['runs']} runs and {died['workers']} workers killed, {len(after)} chunks there")
    return kept, again


def main() -> None:
    args = arguments(__doc__ or "")
    deaths, count = (2, 8_000) if args.quick else (20, 40_000)
    random.seed(0)
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        (folder / "sweep.toml").write_text(
            SWEEP.format(rig=ROOT / "data" / "recordings" / "dead-weight" / "rig.toml", count=count), "utf-8"
        )
        began = time.perf_counter()
        say("once, undisturbed")
        command(folder, "whole").communicate()
        span = time.perf_counter() - began
        say("once on two workers, undisturbed")
        command(folder, "shared", "--scheduler", "local").communicate()
        whole = (folder / "whole" / "sweep.parquet").read_bytes()
        shared = (folder / "shared" / "sweep.parquet").read_bytes() == whole
        died = {"runs": 0, "workers": 0}
        kept, again, laps = 0, 0, []
        while min(died.values()) < deaths:
            if (folder / "torn").is_dir():
                laps.append(lap(folder, whole, count))
            before, lost_chunks = interrupt(folder, died, deaths, span)
            kept, again = kept + before, again + lost_chunks
        _, errors = command(folder, "torn", "--resume").communicate()
        laps.append(lap(folder, whole, count))
    lost, doubled = (sum(one[key] for one in laps) for key in ("lost", "doubled"))
    same = not errors and all(one["same"] for one in laps)
    told = f"{died['runs']} runs and {died['workers']} workers killed"
    finish(
        [
            Row(
                "two workers against one process, undisturbed",
                "the same bytes",
                "the same" if shared else "others",
                shared,
            ),
            Row("deaths", f"{deaths} runs and {deaths} workers", told, min(died.values()) >= deaths, died),
            Row(
                "chunks there before a death that were lost or made again",
                "none",
                f"{again:,} of {kept:,}",
                not again if kept else None,
            ),
            Row(
                "rows lost or doubled",
                "none",
                f"{lost} and {doubled} of {count:,}, in {len(laps)} sweeps",
                not lost and not doubled,
                {"lost": lost, "doubled": doubled, "sweeps": len(laps)},
            ),
            Row("the table against the undisturbed one's", "the same bytes", "the same" if same else "others", same),
        ],
        args,
        designs=count,
    )


def lap(folder: Path, whole: bytes, count: int) -> dict[str, int]:
    """What a sweep that was done after deaths has.

    Rows lost and doubled, and whether it is the undisturbed one's table; removes it.
    """
    table = folder / "torn" / "sweep.parquet"
    rows = read_table(table)["design"]
    found = {
        "lost": count - len(np.unique(rows)),
        "doubled": len(rows) - len(np.unique(rows)),
        "same": table.read_bytes() == whole,
    }
    shutil.rmtree(folder / "torn")
    return found


def wait_for_more(process: subprocess.Popen, folder: Path, before: dict[str, int]) -> bool:
    """Waits until a run has written a chunk, so that a death is one at work; False if it ended."""
    while process.poll() is None:
        if len(chunks_in(folder)) > len(before):
            return True
        time.sleep(0.02)
    return False


def command(folder: Path, out: str, *more: str) -> subprocess.Popen:
    """The sweep as a user runs it, in a group of processes of its own."""
    call = [
        sys.executable,
        "-m",
        "smajax.app.cli",
        "sweep",
        str(folder / "sweep.toml"),
        "--out",
        str(folder / out),
        "--quiet",
        *more,
    ]
    environment = {**os.environ, "PYTHONPATH": str(ROOT)}
    return subprocess.Popen(
        call, env=environment, stdout=subprocess.DEVNULL, stderr=subprocess.PIPE, text=True, start_new_session=True
    )


def chunks_in(folder: Path) -> dict[str, int]:
    """Chunks on the disk by name, with the time at which each was written."""
    found = {}
    for path in (folder / "torn.partial").glob("chunk-*.parquet"):
        with contextlib.suppress(FileNotFoundError):  # the run is done and clears up
            found[path.name] = path.stat().st_mtime_ns
    return found


if __name__ == "__main__":
    main()
