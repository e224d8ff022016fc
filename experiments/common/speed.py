"""Compiled programs of a fit and their cost: growth with the size of the data, and the time of a whole command."""

import os
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable, Sequence
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace
from typing import Any

from experiments.common.base import ROOT, Row, exponent, medians, read_shipped, say
from experiments.common.process_phases import compile_package

import jax
import jax.numpy as jnp
import numpy as np

from smajax.fitting.problem import Problem, build_problem
from smajax.numerics.loop_kernels import jit_with_kernels
from smajax.recordings.recording import Recording
from smajax.simulation import run as simulate


@jit_with_kernels
def simulate_residual(problem: Problem, vector: jax.Array) -> jax.Array:
    """Return the residual of a fit at a point: one simulation of each recording."""
    return problem.residual(vector)


@jit_with_kernels
def linearise_residual(problem: Problem, vector: jax.Array) -> tuple[jax.Array, jax.Array]:
    """Return the Jacobian of the residual, and the residual."""

    def residual_twice(v: jax.Array) -> tuple[jax.Array, jax.Array]:
        residual = problem.residual(v)
        return residual, residual

    return jax.jacfwd(residual_twice, has_aux=True)(vector)


def ready(function: Callable[..., Any], *args: Any) -> Callable[[], Any]:
    """Return a call of a function that waits for its result."""
    return lambda: jax.block_until_ready(function(*args))


def fit_problem(recordings: Sequence[Recording], extra: Sequence[str] = ()) -> Problem:
    """Return the fit problem of the shipped dead weight.

    Args:
        recordings: The recordings.
        extra: Names of parameters that are free in addition to those of the rig file.
    """
    rig, _ = read_shipped("dead-weight")
    settings = SimpleNamespace(
        free=(*rig.fit.free, *extra), observe=rig.fit.observe, noise={c: 1e-5 for c in rig.fit.observe}
    )
    settings.per_recording, settings.initial, settings.bounds = (), (), {}
    return build_problem(rig.plant, recordings, settings, interpolation=rig.interpolation)


def growth_rows(quick: bool) -> list[Row]:
    """Return the exponents with which the cost grows with samples, recordings and designs."""
    rig, recording = read_shipped("dead-weight")
    short = recording.slice(recording.time[0], recording.time[0] + 30.0)
    rows = []
    for quantity, kinds in (
        (
            "samples",
            {f"{k} x {len(short)}": (k, [_repeated(short, k)]) for k in ((1, 4) if quick else (1, 2, 4, 8, 16))},
        ),
        (
            "recordings",
            {
                f"{k}": (k, [replace(short, name=f"{i}.csv") for i in range(k)])
                for k in ((1, 4) if quick else (1, 2, 4, 8))
            },
        ),
    ):
        tasks = {}
        for label, (_, recordings) in kinds.items():
            problem = fit_problem(recordings)
            tasks[label] = ready(
                simulate_residual if quick else linearise_residual, problem, jnp.asarray(problem.nominal)
            )
        rows.append(_growth_row(quantity, [size for size, _ in kinds.values()], medians(9 if quick else 15, tasks)))
    problem = fit_problem([short])
    inputs = jax.tree.map(lambda leaf: leaf[0], problem.data.inputs)
    tasks, sizes = {}, (64, 1024) if quick else (64, 128, 256, 512, 1024)
    for size in sizes:
        values = {u.name: jnp.linspace(0.9, 1.1, size) * u.nominal for u in problem.unknowns}
        tasks[str(size)] = ready(simulate.simulate_batch, rig.plant, values, inputs, tuple(rig.fit.observe))
    rows.append(_growth_row("designs", sizes, medians(3 if quick else 7, tasks)))
    return rows


def _growth_row(quantity: str, sizes: Sequence[int], seconds: dict[str, float]) -> Row:
    power = exponent(sizes, list(seconds.values()))
    return Row(
        f"growth of the cost with {quantity}, exponent",
        "<= 1.05",
        f"{power:.2f} ({', '.join(f'{label}: {1e3 * t:.1f} ms' for label, t in seconds.items())})",
        power <= 1.05,
        {"exponent": power, "sizes": list(sizes), "seconds": list(seconds.values())},
    )


def _repeated(recording: Recording, times: int) -> Recording:
    """Return the recording ``times`` times in sequence."""
    length = recording.time[-1] - recording.time[0] + (recording.time[1] - recording.time[0])
    time_ = np.concatenate([recording.time + k * length for k in range(times)])
    return Recording.from_arrays(
        recording.name, time_, {n: np.tile(v, times) for n, v in recording.channels.items()}, recording.units
    )


def command_row(quick: bool) -> Row:
    """Time the whole command in its own process, with an empty compilation cache and with a warm one."""
    rig = ROOT / "data" / "recordings" / "dead-weight" / "rig.toml"
    cold, warm = [], []
    compile_package()
    for _ in range(1 if quick else 5):
        with tempfile.TemporaryDirectory() as folder:
            for times in (cold, warm):
                times.append(_command(rig, Path(folder)))
    numbers = {"cold_seconds": cold, "warm_seconds": warm}
    first = float(np.median(cold))
    second = float(np.median(warm))
    return Row(
        "smajax fit on 6,000 samples, the whole process: cold start, compilation cache warm",
        "<= 15 s, <= 6 s",
        f"{first:.1f} s, {second:.1f} s",
        bool(first <= 15 and second <= 6),
        numbers,
    )


def _command(rig: Path, folder: Path) -> float:
    files = [str(rig), str(rig.with_name("train.csv"))]
    command = [sys.executable, "-m", "smajax", "fit", *files, "--out", str(folder / "out"), "--quiet"]
    environment = os.environ | {"JAX_COMPILATION_CACHE_DIR": str(folder / "cache"), "PYTHONPATH": str(ROOT)}
    start = time.perf_counter()
    result = subprocess.run(command, env=environment, cwd=folder, capture_output=True, text=True)
    seconds = time.perf_counter() - start
    if result.returncode:
        raise RuntimeError(f"smajax fit failed with exit code {result.returncode}: {result.stderr}")
    say(f"smajax fit: {seconds:.1f} s")
    return seconds
