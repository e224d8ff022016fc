"""Cost of a simulation, a Jacobian, a batch and a whole command: rows of speed/gradient_vs_population.py."""

import os
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace
from typing import Any

from experiments.common.base import ROOT, Row, exponent, medians, read_shipped, say

import jax
import jax.numpy as jnp
import numpy as np

from smajax import parameters
from smajax.files.rig_file import Rig
from smajax.fitting.problem import Problem, build_problem
from smajax.numerics.loop_kernels import jit_with_kernels
from smajax.recordings.recording import Recording
from smajax.simulation import run as simulate
from smajax.simulation.inputs import Inputs

THREADS = 2
DESIGNS = 1024
EXTRA_PARAMETERS = ("material.clausius_clapeyron_austenite", "material.clausius_clapeyron_martensite")


@jit_with_kernels
def _model(problem: Problem, vector: jax.Array) -> jax.Array:
    return problem.residual(vector)


@jit_with_kernels
def _linearised(problem: Problem, vector: jax.Array) -> tuple[jax.Array, jax.Array]:
    def residual_twice(v: jax.Array) -> tuple[jax.Array, jax.Array]:
        residual = problem.residual(v)
        return residual, residual

    return jax.jacfwd(residual_twice, has_aux=True)(vector)


def _ready(function: Callable[..., Any], *args: Any) -> Callable[[], Any]:
    return lambda: jax.block_until_ready(function(*args))


def _problem(recordings: Sequence[Recording], extra: Sequence[str] = ()) -> Problem:
    rig, _ = read_shipped("dead-weight")
    settings = SimpleNamespace(
        free=(*rig.fit.free, *extra), observe=rig.fit.observe, noise={c: 1e-5 for c in rig.fit.observe}
    )
    settings.per_recording, settings.initial, settings.bounds = (), (), {}
    return build_problem(rig.plant, recordings, settings, interpolation=rig.interpolation)


def jacobian_row(quick: bool) -> Row:
    """Time the residual with its Jacobian of 8 parameters over one simulation."""
    _, recording = read_shipped("dead-weight")
    problem = _problem([recording], EXTRA_PARAMETERS)
    vector = jnp.asarray(problem.nominal)
    seconds = medians(
        20 if quick else 60, {"one": _ready(_model, problem, vector), "all": _ready(_linearised, problem, vector)}
    )
    ratio = seconds["all"] / seconds["one"]
    return Row(
        f"residual and Jacobian of {len(vector)} parameters, {len(recording)} samples, over one simulation",
        "<= 2x",
        f"{ratio:.2f}x ({1e3 * seconds['all']:.1f} ms against {1e3 * seconds['one']:.1f} ms)",
        ratio <= 2,
        {"ratio": ratio, "jacobian_seconds": seconds["all"], "simulation_seconds": seconds["one"]},
    )


def _batch_row(fast_loop: Any, rig: Rig, problem: Any, recording: Recording, substeps: int, quick: bool) -> Row:
    """Time a batch of designs, in chunks on one and more threads, against the hand-compiled loop."""
    inputs = jax.tree.map(lambda leaf: leaf[0], problem.data.inputs)
    current = np.asarray(recording.channels["current"])
    factors = 1 + 0.05 * np.random.default_rng(0).standard_normal((DESIGNS, len(problem.unknowns)))
    values = {
        u.name: factors[:, i] * u.nominal + (factors[:, i] - 1) * 40 * (u.unit == "K")
        for i, u in enumerate(problem.unknowns)
    }
    designs = np.array(
        [_design(fast_loop.Design, rig.plant, {n: v[k] for n, v in values.items()}) for k in range(DESIGNS)]
    )

    def loops() -> np.ndarray:
        return fast_loop.dead_weight_batch(designs, recording.time, current, linear=True, substeps=substeps)

    seconds_by_kind = medians(
        3 if quick else 7,
        {"loop": loops}
        | {
            f"{size} on {threads}": _in_chunks(rig.plant, values, inputs, rig.fit.observe, size, threads)
            for size in ((64,) if quick else (8, 16, 32, 64, 128, 256, 512))
            for threads in (1, THREADS)
        },
    )
    ms = {kind: 1e3 * seconds / DESIGNS for kind, seconds in seconds_by_kind.items()}
    say("batch of designs, ms each: " + ", ".join(f"{kind}: {each:.3f}" for kind, each in ms.items()))
    name = min((k for k in seconds_by_kind if k != "loop"), key=lambda k: seconds_by_kind[k])
    ratio = seconds_by_kind[name] / seconds_by_kind["loop"]
    return Row(
        f"a batch of {DESIGNS:,} designs against the hand-compiled loop on {THREADS} threads, each design",
        "<= 1x",
        f"{ratio:.2f}x ({ms[name]:.3f} ms in chunks of {name} threads against {ms['loop']:.3f} ms)",
        ratio <= 1,
        {"ratio": ratio, "milliseconds_per_design": ms, "best": name},
    )


def loop_rows(quick: bool) -> list[Row]:
    """Time one design and a batch against the hand-compiled loop."""
    try:
        import numba

        from tests.reference import fast_loop
    except ImportError as missing:
        return [Row("one simulation against the hand-compiled exact loop", "<= 5x", f"not measured: {missing}", None)]
    numba.set_num_threads(min(THREADS, numba.config.NUMBA_NUM_THREADS))
    rig, recording = read_shipped("dead-weight")
    problem = _problem([recording])
    inputs = jax.tree.map(lambda leaf: leaf[0], problem.data.inputs)
    substeps = (inputs.time.shape[0] - 1) // (len(recording) - 1)
    current = np.asarray(recording.channels["current"])
    design = _design(fast_loop.Design, rig.plant, {})

    def loop() -> np.ndarray:
        return fast_loop.dead_weight(design, recording.time, current, linear=True, substeps=substeps)

    vector = jnp.asarray(problem.nominal)
    seconds = medians(20 if quick else 60, {"loop": loop, "smajax": _ready(_model, problem, vector)})
    ratio = seconds["smajax"] / seconds["loop"]
    difference = float(np.max(np.abs(np.asarray(problem.predict(vector)[0])[0, 0] - loop())))
    rows = [
        Row(
            f"one simulation of {len(recording)} samples against the hand-compiled loop, {substeps} steps a sample",
            "<= 5x",
            f"{ratio:.2f}x ({1e3 * seconds['smajax']:.2f} ms against {1e3 * seconds['loop']:.2f} ms; largest "
            f"difference {1e3 * difference:.2g} mm)",
            ratio <= 5,
            {
                "ratio": ratio,
                "seconds": seconds["smajax"],
                "loop_seconds": seconds["loop"],
                "largest_difference": difference,
            },
        )
    ]
    rows.append(
        _equally_exact_row(
            fast_loop, design, recording, current, np.asarray(problem.predict(vector)[0])[0, 0], seconds["smajax"]
        )
    )
    rows.append(_batch_row(fast_loop, rig, problem, recording, substeps, quick))
    return rows


def _equally_exact_row(
    loop: Any, design: Any, recording: Recording, current: np.ndarray, ours: np.ndarray, seconds: float
) -> Row:
    """Time the loop with as many steps a sample as bring its error below a quarter of the noise."""
    tolerance, substeps = 5e-6, 1
    exact = loop.dead_weight(design, recording.time, current, linear=True, substeps=512)
    while (
        substeps < 512
        and np.max(np.abs(loop.dead_weight(design, recording.time, current, linear=True, substeps=substeps) - exact))
        > tolerance
    ):
        substeps *= 2
    loop_seconds = medians(
        5, {"loop": lambda: loop.dead_weight(design, recording.time, current, linear=True, substeps=substeps)}
    )["loop"]
    error = float(np.max(np.abs(ours - exact)))
    return Row(
        f"the same, the loop at {substeps} steps a sample, where it errs by less than {1e3 * tolerance:g} mm",
        "-",
        f"{seconds / loop_seconds:.2f}x ({1e3 * seconds:.2f} ms against {1e3 * loop_seconds:.2f} ms; ours errs by at "
        f"most {1e3 * error:.2g} mm)",
        None,
        {
            "ratio": seconds / loop_seconds,
            "loop_seconds": loop_seconds,
            "steps_a_sample": substeps,
            "largest_error": error,
        },
    )


def _design(kind: Any, plant: Any, values: dict[str, float]) -> Any:
    plant = parameters.replace(plant, values)
    fields = {name.split(".", 1)[1]: float(parameters.get(plant, name)) for name in parameters.all_declarations(plant)}
    for phase in ("austenite", "martensite"):
        for end in ("start", "finish"):
            fields[f"{phase}_{end}"] += fields[f"{phase}_shift"]
    return kind(**{field: fields.get(field, 0.0) for field in kind._fields})


def _in_chunks(
    plant: Any, values: dict[str, np.ndarray], inputs: Inputs, channels: tuple, size: int, threads: int
) -> Callable[[], Any]:
    chunks = [{n: jnp.asarray(v[k : k + size]) for n, v in values.items()} for k in range(0, DESIGNS, size)]

    def simulate_chunk(chunk: dict[str, jax.Array]) -> np.ndarray:
        return np.asarray(simulate.simulate_batch(plant, chunk, inputs, tuple(channels))[0][channels[0]])

    def run() -> list[np.ndarray]:
        if threads == 1:
            return [simulate_chunk(chunk) for chunk in chunks]
        with ThreadPoolExecutor(threads) as pool:
            return list(pool.map(simulate_chunk, chunks))

    simulate_chunk(chunks[0])
    return run


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
            problem = _problem(recordings)
            tasks[label] = _ready(_model if quick else _linearised, problem, jnp.asarray(problem.nominal))
        rows.append(_growth_row(quantity, [size for size, _ in kinds.values()], medians(9 if quick else 15, tasks)))
    problem = _problem([short])
    inputs = jax.tree.map(lambda leaf: leaf[0], problem.data.inputs)
    tasks, sizes = {}, (64, 1024) if quick else (64, 128, 256, 512, 1024)
    for size in sizes:
        values = {u.name: jnp.linspace(0.9, 1.1, size) * u.nominal for u in problem.unknowns}
        tasks[str(size)] = _ready(simulate.simulate_batch, rig.plant, values, inputs, tuple(rig.fit.observe))
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
