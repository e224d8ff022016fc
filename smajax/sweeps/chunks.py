"""A sweep in chunks, each written to the disk when it is finished: a killed run loses at most one chunk.

Which designs form a chunk, how many steps they take and which share a batch follows from the sweep alone, not from the
machine, the number of workers or what was done before; so a sweep gives the same numbers however it is run on one kind
of machine.
"""

import math
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import jax
import numpy as np

from smajax.errors import InputError
from smajax.recordings.recording import Floats
from smajax.sweeps import compilation
from smajax.sweeps.problem import CODES, AbstractSweepProblem
from smajax.sweeps.table import read_table, write_table

# Threads that wait for the disk to confirm a file.
_WRITERS = 8
# Designs of a chunk where the file names no number.
DEFAULT_CHUNK = 1024


@dataclass(frozen=True, eq=False)
class Chunk:
    """Designs that are simulated and written together.

    Args:
        number: Number of the chunk.
        rows: Numbers of the designs, shape ``(m,)``.
        designs: Values of the designs, shape ``(m, axes)``.
        steps: Steps with which all of them are simulated.
    """

    number: int
    rows: np.ndarray
    designs: Floats
    steps: int

    @property
    def file(self) -> str:
        """Name of the chunk's file."""
        return f"chunk-{self.number:06d}.parquet"


# Chunks that were simulated together, each with its columns.
FinishedChunks = Sequence[tuple[Chunk, Mapping[str, np.ndarray]]]
# Simulates chunks and yields them in any order.
Submit = Callable[[Sequence[Chunk]], Iterable[FinishedChunks]]


def split_into_chunks(problem: AbstractSweepProblem, designs: Floats, size: int) -> list[Chunk]:
    """Return the chunks of a sweep, each of at most ``size`` similar designs that are simulated with the same steps."""
    steps, order = problem.grouped_steps(designs), np.argsort(problem.batch_order(designs), kind="stable")
    chunks: list[Chunk] = []
    for level in np.unique(steps)[::-1]:
        rows = order[steps[order] == level]
        for first in range(0, len(rows), size):
            part = rows[first : first + size]
            chunks.append(Chunk(len(chunks), part, designs[part], int(level)))
    return chunks


def evaluate_designs(
    problem: AbstractSweepProblem,
    designs: Floats,
    steps: int,
    *,
    gradients: bool = False,
    workers: int = 1,
    new_program: bool = False,
) -> dict[str, np.ndarray]:
    """Simulate designs in batches.

    Args:
        problem: Maps a design to its metrics.
        designs: Values of the designs, shape ``(m, axes)``.
        steps: Steps with which each design is simulated.
        gradients: Whether the metrics' derivatives are computed.
        workers: Threads that share the batches.
        new_program: Whether the program is not compiled yet; then the first batch runs alone, so that it is compiled
            once.

    Returns:
        Columns, shape ``(m,)`` each: metrics, their derivatives (``derivative_column``), and the name of the result
        ``code``.
    """
    size = compilation.batch_size(problem, steps, gradients)
    if compilation.on_accelerator():  # a small number of designs is not filled up to the accelerator's large batch
        size = min(size, 2 ** math.ceil(math.log2(max(1, len(designs)))))
    starts = range(0, len(designs), size)

    def run_batch(first: int) -> dict[str, np.ndarray]:
        # The last batch is filled up with its last design, so that one program serves all.
        rows = np.minimum(np.arange(first, first + size), len(designs) - 1)
        batch = compilation.spread_over_devices(designs[rows])
        derivatives: dict[str, jax.Array] = {}
        if gradients:
            metrics, derivatives, codes = compilation.differentiate_batch(problem, batch, steps)
        else:
            metrics, codes = compilation.evaluate_batch(problem, batch, steps)
        count = min(size, len(designs) - first)
        columns = {n: np.asarray(metrics[n])[:count] for n in problem.units}
        for n in problem.units if gradients else ():
            table = np.asarray(derivatives[n])[:count]
            columns |= {derivative_column(n, axis): table[:, k] for k, axis in enumerate(problem.names)}
        return columns | {"code": np.asarray(codes)[:count]}

    if workers > 1 and len(starts) > 1:
        parts = [run_batch(0)] if new_program else []
        with ThreadPoolExecutor(workers) as pool:
            parts += pool.map(run_batch, starts[len(parts) :])
    else:
        parts = [run_batch(first) for first in starts]
    columns = {n: np.concatenate([part[n] for part in parts]) for n in parts[0]}
    return columns | {"code": np.asarray(CODES)[columns["code"]]}


def derivative_column(metric: str, axis: str) -> str:
    """Return the name of the column of a metric's derivative with respect to an axis."""
    return f"d {metric} / d {axis}"


def chunk_columns(chunk: Chunk, names: Sequence[str], results: Mapping[str, np.ndarray]) -> dict[str, np.ndarray]:
    """Return a chunk's table: the designs' numbers, their values by axis, and the results."""
    return {"design": chunk.rows, **{n: chunk.designs[:, k] for k, n in enumerate(names)}, **results}


def run_chunks(
    chunks: Sequence[Chunk],
    names: Sequence[str],
    folder: Path,
    submit: Submit,
    report: Callable[[int], None],
    stop: Callable[[], bool],
) -> bool:
    """Simulate the chunks that are not in a folder yet, and write each as it is finished.

    Args:
        chunks: All chunks of the sweep.
        names: Names of the axes.
        folder: Folder of the chunks' files.
        submit: Simulates chunks.
        report: Called with the number of chunks that are there.
        stop: Asked after each group of chunks whether to end early.

    Returns:
        Whether all chunks are there now.

    Raises:
        InputError: if the disk does not take a file; what is there by then stays.
    """
    missing = [chunk for chunk in chunks if not (folder / chunk.file).is_file()]
    count = len(chunks) - len(missing)
    report(count)

    def write(finished: tuple[Chunk, Mapping[str, np.ndarray]]) -> None:
        chunk, results = finished
        write_table(folder / chunk.file, chunk_columns(chunk, names, results))

    # A file is there once the disk has confirmed it: several threads wait for that at once.
    with ThreadPoolExecutor(_WRITERS) as pool:
        for group in submit(missing):
            list(pool.map(write, group))
            count += len(group)
            report(count)
            if stop():
                break
    return count == len(chunks)


def group_chunks(problem: AbstractSweepProblem, chunks: Sequence[Chunk], gradients: bool) -> list[list[Chunk]]:
    """Return groups of chunks that are simulated together: on an accelerator as many as one batch holds, else one."""
    groups: list[list[Chunk]] = []
    for chunk in chunks:
        last = groups[-1] if groups else []
        free = compilation.batch_size(problem, chunk.steps, gradients) - sum(len(other.rows) for other in last)
        fits = bool(last) and last[0].steps == chunk.steps and len(chunk.rows) <= free
        if compilation.on_accelerator() and fits:
            last.append(chunk)
        else:
            groups.append([chunk])
    return groups


def submit_locally(problem: AbstractSweepProblem, gradients: bool) -> Submit:
    """Return a function that simulates chunks in this process.

    The cores share the batches of a chunk; an accelerator takes as many chunks as a batch holds.
    """

    def submit(chunks: Sequence[Chunk]) -> Iterator[FinishedChunks]:
        compiled: set[int] = set()
        for group in group_chunks(problem, chunks, gradients):
            steps = group[0].steps
            results = evaluate_designs(
                problem,
                np.concatenate([chunk.designs for chunk in group]),
                steps,
                gradients=gradients,
                workers=compilation.parallel_batches(),
                new_program=steps not in compiled,
            )
            compiled.add(steps)
            ends = np.cumsum([len(chunk.rows) for chunk in group])
            yield [
                (chunk, {n: v[end - len(chunk.rows) : end] for n, v in results.items()})
                for chunk, end in zip(group, ends, strict=True)
            ]

    return submit


def read_chunks(chunks: Sequence[Chunk], folder: Path) -> dict[str, np.ndarray]:
    """Return the whole table of a sweep whose chunks are all there, in the designs' order.

    Raises:
        InputError: if a file is not readable, or holds other designs than its chunk.
    """
    parts: list[dict[str, Any]] = [read_table(folder / chunk.file) for chunk in chunks]
    for chunk, part in zip(chunks, parts, strict=True):
        if not np.array_equal(part["design"], chunk.rows):
            raise InputError(
                f"{folder / chunk.file}: its designs are not those that belong there: remove the file, and add --resume"
            )
    columns = {n: np.concatenate([part[n] for part in parts]) for n in parts[0]}
    order = np.argsort(columns["design"], kind="stable")
    return {n: values[order] for n, values in columns.items()}
