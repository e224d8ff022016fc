"""A sweep of 100,000 antagonistic rotary actuators, ten seconds of motion each: throughput, memory, refinement.

    python experiments/speed/sweep_throughput.py [--quick] [--json FILE] [--out DIR]

The same designs go through the sweep as the command runs it (chunks, tables on disk) and through a loop compiled by
numba that shares designs among the same cores. They are run in turn, several chunks each, so that other load on the
machine affects both. The loop takes as many substeps as it needs to be as exact as the sweep; its own limit with 64
substeps is the truth. Next to them are the same loop in plain Python, and one simulation after the other. Further rows
are memory and cost against the number of designs, and the best of all samples against a refined one. On an accelerator
the sweep also runs on the processor alone, and its numbers are compared.
"""

import os
import resource
import subprocess
import sys
import tempfile
import time
from dataclasses import replace
from pathlib import Path
from typing import Any

sys.path.insert(0, str(Path(__file__).resolve().parents[2]))  # the checkout: smajax, tests/reference, experiments

from experiments.common.base import ROOT, Row, arguments, exponent, finish, say
from experiments.common.compiled_loop import SAMPLE, Loop, time_interpreted

import jax
import jax.numpy as jnp
import numba
import numpy as np

from smajax.numerics.ensemble import parallel_batches
from smajax.numerics.loop_kernels import jit_with_kernels
from smajax.numerics.process import count_cores
from smajax.sweeps import chunks, compilation
from smajax.sweeps.refinement import refine, separated_starts
from smajax.sweeps.sweep_file import read_sweep
from smajax.sweeps.table import read_table

SWEEP = """
[sweep]
rig = "{rig}"
designs = {count}
metrics = ["stroke", "peak_temperature"]
sensitivity = false
[parameters]
wire.diameter = ["0.15 mm", "0.3 mm"]
wire.length = ["300 mm", "600 mm"]
wire.prestrain = ["1 %", "3 %"]
pulley.radius = ["10 mm", "30 mm"]
input.amplitude = {{ from = "0.5 A", to = "2 A", scale = "log" }}
[input]
wave = "square"
amplitude = "1 A"
frequency = "1 Hz"
cycles = 10
[objectives]
stroke = "max"
[constraints]
peak_temperature = {{ at_most = "110 degC" }}
"""
CHECKED = 256
# Number of times that the sweep and the loop run in turn.
TURNS = 7
# Evaluates some of a sweep's chunks on the processor alone, and prints the seconds without compilation; the tables go
# to a folder next to the sweep.
PROCESSOR = """
import sys, time
from pathlib import Path
sys.path.insert(0, sys.argv[1])
import sweep_throughput as own
sweep = own.read_sweep(Path(sys.argv[2]) / "sweep.toml")
problem, folder = sweep.problem(), Path(sys.argv[2]) / "processor"
folder.mkdir()
parts = own.chunks.split_into_chunks(problem, sweep.designs(), sweep.chunk)[:: int(sys.argv[3])]
own.warm(problem, [[part] for part in parts])
began = time.perf_counter()
submit = own.chunks.submit_locally(problem, False)
own.chunks.run_chunks(parts, problem.names, folder, submit, lambda count: None, lambda: False)
print(time.perf_counter() - began)
"""
MAX_TEMPERATURE = 110.0  # degC, largest peak temperature of a feasible design


def main() -> None:
    """Print the table."""
    args = arguments(__doc__ or "")
    numba.set_num_threads(min(count_cores(), numba.config.NUMBA_NUM_THREADS))
    count = 2_048 if args.quick else 100_000
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        (folder / "sweep.toml").write_text(
            SWEEP.format(rig=ROOT / "data" / "recordings" / "rotary" / "rig.toml", count=count), "utf-8"
        )
        sweep = read_sweep(folder / "sweep.toml")
        rows = sweep_rows(sweep, folder, count, args.quick)
    finish(rows, args, designs=count)


def scaling_rows(
    sweep, problem, designs: np.ndarray, count: int, seconds: float, memory: list[float], first: int
) -> list[Row]:
    """Growth of cost with the number of designs, and the memory of the process.

    Args:
        sweep: The sweep file.
        problem: The sweep problem.
        designs: All designs, shape ``(designs, axes)``.
        count: Their number.
        seconds: What all of them took.
        memory: Peak memory in MB after each lot of chunks.
        first: Number of designs in the first lot.
    """
    rows = []
    # In the order of the sequence, since the designs of a chunk are similar, and some chunks cost more than others.
    sizes = [count // 16, count // 4, count]
    slope = exponent(sizes, [time_sweep(problem, designs[:n], sweep.chunk) for n in sizes[:2]] + [seconds])
    rows.append(
        Row(
            "growth of cost with the number of designs",
            "exponent <= 1.05",
            f"{slope:.3f}",
            slope <= 1.05,
            {"exponent": slope},
        )
    )
    grown = memory[-1] - memory[0]
    text = f"{memory[-1]:,.0f} MB at most, {grown:,.0f} MB of it after the first {first:,} designs"
    rows.append(
        Row(
            "memory of the process, numba's loop included",
            "bounded",
            text,
            grown < 300.0,
            {"peak_mb": memory[-1], "grown_mb": grown},
        )
    )
    return rows


def match_exactness(loop: Any, designs: np.ndarray, truth: np.ndarray, error: float) -> list[tuple[int, float]]:
    """Return the substeps of the loop and its RMS error of the stroke, until it is as exact as the sweep.

    Args:
        loop: The compiled loop.
        designs: Designs that are checked, shape ``(n, axes)``.
        truth: Their strokes, shape ``(n,)``.
        error: RMS error of the sweep, in the stroke's unit.
    """
    errors: list[tuple[int, float]] = []
    for n in (1, 2, 3, 4, 8, 16, 32, 48):
        errors.append((n, float(np.sqrt(np.mean((loop.strokes(designs, n) - truth) ** 2)))))
        if errors[-1][1] <= error:
            break
    return errors


def throughput_rows(count: int, seconds: dict[str, float], exactness: tuple, compiling: float) -> list[Row]:
    """Return designs a second next to the compiled loop, how exact both are, and the time to compile.

    Args:
        count: Number of designs.
        seconds: Wall time of the sweep ("ours") and of the loop.
        exactness: RMS errors of the stroke: the sweep's, and the loop's by its substeps.
        compiling: Seconds of compilation.
    """
    error, loop_errors = exactness
    milliseconds = {n: 1e3 * s / count for n, s in seconds.items()}
    place, theirs = f"{count_cores()} cores", "the same cores"
    if compilation.on_accelerator():
        place = jax.devices()[0].device_kind
        theirs = f"{count_cores()} cores of that machine"
    ratio = seconds["loop"] / seconds["ours"]
    ours, theirs_ms = milliseconds["ours"], milliseconds["loop"]
    text = f"{ratio:.2f}x ({ours:.3f} ms a design, {1e3 / ours:,.0f} a second, against {theirs_ms:.3f} ms)"
    return [
        Row("designs simulated, ten seconds of motion each", "-", f"{count:,} on {place}", None),
        Row(
            f"throughput against a compiled loop at least as exact, {theirs}", ">= 1x", text, ratio >= 1.0, milliseconds
        ),
        Row(
            "how exact: RMS error of the stroke",
            "-",
            exactness_text(error, loop_errors),
            None,
            {"sweep_rad": error, "loop_rad": loop_errors},
        ),
        Row("compiling, once", "-", f"{compiling:.1f} s", None, {"seconds": compiling}),
    ]


def sweep_rows(sweep, folder: Path, count: int, quick: bool) -> list[Row]:
    """Run the sweep and the compiled loop in turn, and return the rows.

    Args:
        sweep: The sweep file.
        folder: Where the sweep works.
        count: Number of designs.
        quick: Whether the sweep is small.
    """
    problem = sweep.problem()
    designs = sweep.designs()
    parts = chunks.split_into_chunks(problem, designs, sweep.chunk)
    groups = chunks.group_chunks(problem, parts, False)
    loop = Loop(sweep)
    say("compiling")
    checked = designs[:CHECKED]
    start = time.perf_counter()
    metrics = chunks.evaluate_designs(problem, checked, parts[0].steps, workers=parallel_batches(), new_program=True)
    compiling = time.perf_counter() - start
    warm(problem, groups)
    truth = loop.strokes(checked, 64)
    error = np.sqrt(np.mean((metrics["stroke"] - truth) ** 2))
    loop_errors = match_exactness(loop, checked, truth, error)
    substeps = loop_errors[-1][0]
    seconds, memory = {"ours": 0.0, "loop": 0.0}, list[float]()

    def submit(missing):
        """Chunks as the sweep has them worked on and written; after some of them the loop has its turn."""
        for turn in in_turns(chunks.group_chunks(problem, missing, False)):
            start = time.perf_counter()
            yield from chunks.submit_locally(problem, False)(turn)
            middle = time.perf_counter()
            for part in turn:
                loop.strokes(part.designs, substeps)
            memory.append(resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024)
            seconds["ours"] += middle - start
            seconds["loop"] += time.perf_counter() - middle

    chunks.run_chunks(parts, problem.names, folder, submit, lambda k: say(f"{k} of {len(parts)} chunks"), lambda: False)
    columns = chunks.read_chunks(parts, folder)
    feasible = np.flatnonzero(columns["peak_temperature"] <= MAX_TEMPERATURE)
    best_row = feasible[np.argmax(columns["stroke"][feasible])]
    best = columns["stroke"][best_row], designs[best_row]
    rows = throughput_rows(count, seconds, (error, loop_errors), compiling)
    rows += interpreted_rows(loop, sweep, 1e3 * seconds["ours"] / count, substeps, quick)
    if compilation.on_accelerator():
        rows.append(processor_row(folder, problem, parts, 1e3 * seconds["ours"] / count))
    first = sum(len(part.rows) for part in in_turns(groups)[0])
    rows += scaling_rows(sweep, problem, designs, count, seconds["ours"], memory, first)
    return [*rows, refinement_row(sweep, parts, best, count)]


def in_turns(groups: list[list[chunks.Chunk]]) -> list[list[chunks.Chunk]]:
    """Return the chunks of each turn: a sweep begins the next chunks early, so that a turn has several of them.

    Args:
        groups: Chunks that are simulated together.
    """
    size = -(-len(groups) // TURNS)
    return [[part for group in groups[i : i + size] for part in group] for i in range(0, len(groups), size)]


def exactness_text(error: float, loop_errors: list[tuple[int, float]]) -> str:
    """Return the sweep's error, and those of the loop with more and more substeps, in words."""
    theirs = ", ".join(f"{np.degrees(e):.4f} deg with {n}" for n, e in loop_errors)
    return f"{np.degrees(error):.4f} deg; the loop's with parts of {1e3 * SAMPLE:.0f} ms: {theirs}"


def time_sweep(problem, designs: np.ndarray, size: int) -> float:
    """Return the seconds of a sweep of some designs, without compilation.

    Args:
        problem: The sweep problem.
        designs: The designs.
        size: Number of designs of a chunk.
    """
    parts = chunks.split_into_chunks(problem, designs, size)
    warm(problem, chunks.group_chunks(problem, parts, False))
    start = time.perf_counter()
    list(chunks.submit_locally(problem, False)(parts))
    return time.perf_counter() - start


def warm(problem, groups) -> None:
    """Compile what the groups of chunks need.

    It is one program for each number of steps, and on an accelerator for each size of batch as well.
    """
    compiled, wide = set(), compilation.on_accelerator()
    for group in groups:
        kind = (group[0].steps, sum(len(part.rows) for part in group) if wide else 0)
        if kind not in compiled:
            few = group if wide else [replace(group[0], designs=group[0].designs[:1])]
            list(chunks.submit_locally(problem, False)(few))
        compiled.add(kind)


def processor_row(folder: Path, problem, parts, ours: float) -> Row:
    """Compare some of the chunks on this machine's processor, in a process that does not see the accelerator.

    Args:
        folder: Where the sweep works.
        problem: The sweep problem.
        parts: All chunks.
        ours: Milliseconds a design of the sweep.
    """
    stride = -(-len(parts) // 8)
    subset = parts[::stride]
    command = [sys.executable, "-c", PROCESSOR, str(Path(__file__).parent), str(folder), str(stride)]
    result = subprocess.run(
        command, capture_output=True, text=True, check=True, env={**os.environ, "JAX_PLATFORMS": "cpu"}
    )
    each = 1e3 * float(result.stdout) / sum(len(part.rows) for part in subset)
    here, there = ([read_table(place / part.file) for part in subset] for place in (folder, folder / "processor"))
    here, there = ({n: np.concatenate([table[n] for table in tables]) for n in tables[0]} for tables in (here, there))
    differences = {n: float(np.nanmax(np.abs(here[n] - there[n])) / np.nanmax(np.abs(there[n]))) for n in problem.units}
    text = f"{each / ours:.1f}x ({each:.3f} ms a design); apart by " + ", ".join(
        f"{v:.1e} of the largest {n}" for n, v in differences.items()
    )
    text += f"; {np.sum(here['code'] != there['code'])} of {len(here['code']):,} end otherwise"
    return Row(
        f"against the same on the {count_cores()} cores of that machine",
        "-",
        text,
        None,
        {"ms": each, "apart": differences},
    )


def interpreted_rows(loop: Loop, sweep, ours: float, substeps: int, quick: bool) -> list[Row]:
    """Compare with the same loop interpreted, and with one simulation after the other by the sweep's program.

    Args:
        loop: The compiled loop.
        sweep: The sweep file.
        ours: Milliseconds a design of the sweep.
        substeps: Substeps of the loop.
        quick: Whether the loop runs one design only.
    """
    designs = sweep.designs()[: 1 if quick else 4]
    each = 1e3 * time_interpreted(loop, designs, substeps)
    problem = sweep.problem()
    steps = int(problem.steps(designs).max())
    stroke = jit_with_kernels(lambda design: problem.evaluate(design, steps)[0]["stroke"])
    stroke(jnp.asarray(designs[0])).block_until_ready()
    start = time.perf_counter()
    for k in range(16):
        stroke(jnp.asarray(designs[k % len(designs)])).block_until_ready()
    alone = 1e3 * (time.perf_counter() - start) / 16
    return [
        Row(
            "against that loop in plain Python",
            "-",
            f"{each / ours:,.0f}x ({each:,.0f} ms a design)",
            None,
            {"ms": each},
        ),
        Row(
            "against one simulation after the other",
            "-",
            f"{alone / ours:.1f}x ({alone:.2f} ms a design)",
            None,
            {"ms": alone},
        ),
    ]


def refinement_row(sweep, parts, best, count: int) -> Row:
    """Refine the best few of the first 256 designs by gradients, and compare with the best of all.

    Args:
        sweep: The sweep file.
        parts: All chunks.
        best: Stroke and design of the best sample.
        count: Number of samples.
    """
    problem = sweep.problem()
    designs = sweep.designs()[:CHECKED]
    steps = int(max(part.steps for part in parts))
    metrics = chunks.evaluate_designs(problem, designs, steps, workers=parallel_batches())
    feasible = np.flatnonzero(metrics["peak_temperature"] <= MAX_TEMPERATURE)
    shares = np.column_stack([axis.share(designs[:, k]) for k, axis in enumerate(sweep.axes)])
    order = feasible[np.argsort(-metrics["stroke"][feasible])]
    refined = []
    for row in separated_starts(shares, order, 3):
        say(f"refining design {row}")
        refined.append(
            refine(
                problem, sweep.axes, designs[row], {"stroke": "max"}, {"peak_temperature": (-np.inf, MAX_TEMPERATURE)}
            )
        )
    top = max(refined, key=lambda result: result.metrics["stroke"])
    simulations = CHECKED + sum(result.simulations for result in refined)
    text = f"{np.degrees(top.metrics['stroke']):.2f} deg in {simulations:,} simulations, "
    text += f"the best of {count:,} samples {np.degrees(best[0]):.2f} deg; "
    text += ", ".join(f"{axis.name} {value:.4g}" for axis, value in zip(sweep.axes, top.design, strict=True))
    return Row(
        "largest stroke below 110 degC: refined from 256 designs",
        f"better than the best of {count:,}",
        text,
        bool(top.metrics["stroke"] > best[0]),
        {"refined_rad": top.metrics["stroke"], "best_rad": float(best[0]), "simulations": simulations},
    )


if __name__ == "__main__":
    main()
