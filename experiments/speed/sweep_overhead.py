"""How much of the time of a sweep its compiled programs take.

    python experiments/speed/sweep_overhead.py [--quick] [--json FILE]

The whole sweep, from its file to the ranked designs, with tables written while the next designs are simulated, runs in
turn with its compiled programs alone: the same batches in as many threads, without tables. Once without and once with
the derivatives of the metrics in four parameters. Compilation is left out.
"""

import sys
import tempfile
from collections.abc import Callable
from functools import partial
from pathlib import Path
from typing import Any

sys.path.insert(0, str(Path(__file__).resolve().parents[2]))  # the checkout: smajax, tests/reference, experiments

from experiments.common.base import ROOT, Row, arguments, finish, medians

import jax
import jax.numpy as jnp
import numpy as np

from smajax.api.sweep import sweep
from smajax.numerics.ensemble import share_among_cores
from smajax.sweeps import compilation
from smajax.sweeps.chunks import split_into_chunks
from smajax.sweeps.sweep_file import read_sweep

SWEEP = """
[sweep]
rig = "{rig}"
designs = {count}
sensitivity = false
gradients = {gradients}
[parameters]
wire.diameter = ["0.1 mm", "0.3 mm"]
wire.length = ["100 mm", "400 mm"]
load.mass = {{ from = "50 g", to = "1 kg", scale = "log" }}
input.amplitude = {{ from = "0.15 A", to = "1.5 A", scale = "log" }}
[input]
wave = "square"
amplitude = "0.3 A"
frequency = "0.1 Hz"
cycles = 3
[objectives]
stroke = "max"
energy_per_cycle = "min"
"""
DESIGNS, DESIGNS_WITH_DERIVATIVES = 65_536, 16_384
# Smallest share of the programs in the time of the sweep that counts as good, and largest ratio of the programs' times
# with and without derivatives.
SHARE, DERIVATIVES = 0.8, 4.0


def main() -> None:
    """Print the table."""
    args = arguments(__doc__ or "")
    rows, milliseconds = [], []
    for gradients, count in ((False, DESIGNS), (True, DESIGNS_WITH_DERIVATIVES)):
        row, each = sweep_row(count // 16 if args.quick else count, gradients, 2 if args.quick else 5)
        rows.append(row)
        milliseconds.append(each)
    ratio = milliseconds[1] / milliseconds[0]
    rows.append(
        Row(
            "programs with derivatives in four parameters over those without",
            f"<= {DERIVATIVES:g}x",
            f"{ratio:.2f}x",
            ratio <= DERIVATIVES,
            {"ratio": ratio},
        )
    )
    finish(rows, args)


def sweep_row(count: int, gradients: bool, repeats: int) -> tuple[Row, float]:
    """Time a sweep and its programs alone in turn.

    Args:
        count: Number of designs.
        gradients: Whether derivatives are computed.
        repeats: Number of runs of each.

    Returns:
        The row, and the milliseconds a design of the programs.
    """
    with tempfile.TemporaryDirectory() as name:
        rig, file = ROOT / "data" / "recordings" / "dead-weight" / "rig.toml", Path(name) / "sweep.toml"
        file.write_text(SWEEP.format(rig=rig, count=count, gradients=str(gradients).lower()), "utf-8")
        functions = {"sweep": partial(sweep, file), "programs": partial(share_among_cores, *programs(file, gradients))}
        seconds = medians(repeats, functions)
    share, each = seconds["programs"] / seconds["sweep"], 1e3 * seconds["programs"] / count
    rates = f"{count / seconds['sweep']:,.0f} designs a second of {count / seconds['programs']:,.0f}"
    what = f"{count:,} designs{' with derivatives in four parameters' if gradients else ''}: share of the programs"
    return Row(what, f">= {100 * SHARE:g} %", f"{100 * share:.0f} % ({rates})", share >= SHARE, seconds), each


def programs(file: Path, gradients: bool) -> tuple[Callable[[tuple[jax.Array, int]], Any], list[tuple[jax.Array, int]]]:
    """Return a function that runs the compiled program of a sweep on a batch of designs, and all batches.

    Args:
        file: The sweep file.
        gradients: Whether derivatives are computed.
    """
    read = read_sweep(file)
    problem, batches = read.problem(), []
    program = compilation.differentiate_batch if gradients else compilation.evaluate_batch
    for chunk in split_into_chunks(problem, read.designs(), read.chunk):
        size = compilation.batch_size(problem, chunk.steps, gradients)
        for first in range(0, len(chunk.designs), size):
            rows = np.minimum(np.arange(first, first + size), len(chunk.designs) - 1)
            batches.append((jnp.asarray(chunk.designs[rows]), chunk.steps))
    return (lambda batch: jax.block_until_ready(program(problem, *batch))), batches


if __name__ == "__main__":
    main()
