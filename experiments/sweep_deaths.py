"""A sweep that dies: runs and workers are killed at random moments, and what is left is gone on with, until it is done.

A sweep runs once in one process. Then it runs again and again from what is there, in one process or on a local Dask cluster of worker
processes; at a random moment either the whole run or one of its workers is killed (SIGKILL). In the end the tables have to be the same,
byte for byte: no row lost, none doubled.
"""

import os
import random
import signal
import subprocess
import sys
import tempfile
import time
from pathlib import Path

import numpy as np
from _common import ROOT, Row, arguments, finish, say

from smajax.sweep.table import read_table
from tests.processes import workers_of

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


def main() -> None:
    args = arguments(__doc__ or "")
    deaths, count = (4, 2_000) if args.quick else (20, 40_000)
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
        died = {"runs": 0, "workers": 0}
        lost, resumed = [], 0
        while died["runs"] + died["workers"] < deaths and not (folder / "torn").is_dir():
            clustered = resumed % 2 == 1  # every other time, and then a worker dies first
            process = command(folder, "torn", "--resume", *(("--scheduler", "local") if clustered else ()))
            resumed += 1
            before = chunks_in(folder)
            until = time.monotonic() + random.uniform(0.3, 1.0) * span / max(1, deaths // 4) + (14.0 if clustered else 4.0)
            while process.poll() is None and time.monotonic() < until:
                time.sleep(0.02)
            if process.poll() is not None:
                break
            if workers := workers_of(process.pid):
                random.choice(workers).kill()
                died["workers"] += 1
                say(f"a worker killed with {chunks_in(folder)} chunks there")
                time.sleep(random.uniform(3.0, 8.0))
            os.killpg(process.pid, signal.SIGKILL)
            process.wait()
            died["runs"] += 1
            lost.append(before <= chunks_in(folder))
            say(f"killed: {chunks_in(folder)} chunks there")
        _, errors = command(folder, "torn", "--resume").communicate()
        torn, whole = (folder / out / "sweep.parquet" for out in ("torn", "whole"))
        same = not errors and torn.read_bytes() == whole.read_bytes()
        rows = np.sort(read_table(torn)["design"])
    exact = bool(np.array_equal(rows, np.arange(count)))
    told = f"{died['runs']} runs and {died['workers']} workers killed"
    finish(
        "sweep_deaths",
        [
            Row("deaths", f"{deaths}", told, None, died),
            Row("chunks never fewer after a death than before it", "yes", f"{sum(lost)} of {len(lost)}", all(lost)),
            Row("rows lost or doubled", "none", f"{count:,} designs, {len(rows):,} rows, {len(np.unique(rows)):,} different", exact),
            Row("the table against the undisturbed one's", "the same bytes", "the same" if same else "others", same),
        ],
        args,
        designs=count,
    )


def command(folder: Path, out: str, *more: str) -> subprocess.Popen:
    """The sweep as a user runs it, in a group of processes of its own."""
    call = [sys.executable, "-m", "smajax.cli", "sweep", str(folder / "sweep.toml"), "--out", str(folder / out), "--quiet", *more]
    environment = {**os.environ, "PYTHONPATH": str(ROOT)}
    return subprocess.Popen(call, env=environment, stdout=subprocess.DEVNULL, stderr=subprocess.PIPE, text=True, start_new_session=True)


def chunks_in(folder: Path) -> int:
    """Chunks on the disk; all of them once the folder is there."""
    return 10**9 if (folder / "torn").is_dir() else len(list((folder / "torn.partial").glob("chunk-*.parquet")))


if __name__ == "__main__":
    main()
