"""Simulation of a sweep in chunks, each written to the disk when it is finished: a killed run loses at most one chunk.

The designs of a chunk, their number of steps and their batches follow from the sweep alone, not from the machine, the
number of workers or an earlier run. So all runs of a sweep on one kind of machine give the same numbers.
"""

import math
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from concurrent.futures import Future, ThreadPoolExecutor
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Float, Int

from smajax.errors import InputError
from smajax.numerics.ensemble import call_groups_on_cores, join_batches, member_batches, share_among_cores
from smajax.sweeps import compilation
from smajax.sweeps.problem import CODES, AbstractSweepProblem
from smajax.sweeps.table import read_table, write_table

# Number of threads that write files; each waits for the disk most of the time. Chosen by trial.
_WRITERS = 8


@dataclass(frozen=True, eq=False)
class Chunk:
    """Designs of a sweep that are simulated and written together.

    Attributes:
        number: Number of the chunk.
        rows: Numbers of the designs, shape ``(designs,)``.
        designs: Values of the designs in internal units, shape ``(designs, axes)``.
        steps: Number of steps with which all of them are simulated.
    """

    number: int
    rows: Int[np.ndarray, " designs"]
    designs: Float[np.ndarray, "designs axes"]
    steps: int

    @property
    def file(self) -> str:
        """Name of the chunk's file."""
        return f"chunk-{self.number:06d}.parquet"


# Chunks that were simulated together, each with its columns by name.
FinishedChunks = Sequence[tuple[Chunk, Mapping[str, np.ndarray]]]
# Simulates chunks and yields them in any order.
Submit = Callable[[Sequence[Chunk]], Iterable[FinishedChunks]]


def split_into_chunks(
    problem: AbstractSweepProblem, designs: Float[np.ndarray, "designs axes"], size: int
) -> list[Chunk]:
    """Divide designs into chunks of similar designs that are simulated with the same number of steps.

    Args:
        problem: Maps a design to its metrics.
        designs: Designs in internal units, shape ``(designs, axes)``.
        size: Largest number of designs in a chunk.

    Returns:
        The chunks, those with the most steps first.
    """
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
    designs: Float[np.ndarray, "designs axes"],
    steps: int,
    *,
    gradients: bool = False,
    workers: int = 1,
    new_program: bool = False,
) -> dict[str, np.ndarray]:
    """Simulate designs in batches.

    Args:
        problem: Maps a design to its metrics.
        designs: Values of the designs in internal units, shape ``(designs, axes)``.
        steps: Number of steps with which each design is simulated.
        gradients: Whether the metrics' derivatives are computed.
        workers: Number of threads that share the batches.
        new_program: Whether the program is not compiled yet; then the first batch runs alone, so that only one thread
            compiles it.

    Returns:
        Columns by name, shape ``(designs,)`` each: metrics in internal units, their derivatives
        (``derivative_column``), and ``code``, the name of the ``SimulationStatus``.
    """
    batches = _batches(problem, designs, steps, gradients)
    parts = share_among_cores(lambda batch: batch(), batches, workers=workers, new_program=new_program)
    return _columns(parts)


def _batches(
    problem: AbstractSweepProblem, designs: Float[np.ndarray, "designs axes"], steps: int, gradients: bool
) -> list[Callable[[], dict[str, np.ndarray]]]:
    """Return functions that simulate a batch of the designs each."""
    size = compilation.batch_size(problem, steps, gradients)
    if compilation.on_accelerator():  # few designs are not padded to the accelerator's large batch
        size = min(size, 2 ** math.ceil(math.log2(max(1, len(designs)))))

    def run_batch(batch: np.ndarray) -> dict[str, Any]:
        """Return the columns of a batch."""
        spread = compilation.spread_over_devices(batch)
        if not gradients:
            metrics, codes = compilation.evaluate_batch(problem, spread, steps)
            return {n: metrics[n] for n in problem.units} | {"code": codes}
        metrics, derivatives, codes = compilation.differentiate_batch(problem, spread, steps)
        columns = {n: metrics[n] for n in problem.units}
        for n in problem.units:
            table = np.asarray(derivatives[n])
            columns |= {derivative_column(n, axis): table[:, k] for k, axis in enumerate(problem.names)}
        return columns | {"code": codes}

    return member_batches(run_batch, designs, size)


def _columns(parts: Sequence[dict[str, np.ndarray]]) -> dict[str, np.ndarray]:
    """Return the columns of all batches, with codes by name."""
    columns = join_batches(parts)
    return columns | {"code": np.asarray(CODES)[columns["code"]]}


def derivative_column(metric: str, axis: str) -> str:
    """Return the name of the column of a derivative.

    Args:
        metric: Name of the metric.
        axis: Name of the axis with respect to which it is differentiated.
    """
    return f"d {metric} / d {axis}"


def chunk_columns(chunk: Chunk, names: Sequence[str], results: Mapping[str, np.ndarray]) -> dict[str, np.ndarray]:
    """Return the columns of a chunk's table.

    Args:
        chunk: The chunk.
        names: Names of the axes.
        results: Columns that ``evaluate_designs`` returned.

    Returns:
        Columns by name, shape ``(designs,)`` each: ``design`` (the number), the axes, and the results.
    """
    return {"design": chunk.rows, **{n: chunk.designs[:, k] for k, n in enumerate(names)}, **results}


def run_chunks(
    chunks: Sequence[Chunk],
    names: Sequence[str],
    folder: Path,
    submit: Submit,
    report: Callable[[int], None],
    stop: Callable[[], bool],
) -> bool:
    """Simulate the chunks that are not in a folder yet, and write each while the next ones are simulated.

    Args:
        chunks: All chunks of the sweep.
        names: Names of the axes.
        folder: Folder of the chunks' files.
        submit: Simulates chunks.
        report: Called with the number of finished chunks.
        stop: Called after each group of chunks; the run ends early if it returns true.

    Returns:
        Whether all chunks are finished.

    Raises:
        InputError: If a file cannot be written; files of finished chunks stay.
    """
    missing = [chunk for chunk in chunks if not (folder / chunk.file).is_file()]
    count = len(chunks) - len(missing)
    report(count)

    def write(finished: tuple[Chunk, Mapping[str, np.ndarray]]) -> None:
        chunk, results = finished
        write_table(folder / chunk.file, chunk_columns(chunk, names, results))

    # Writing a file waits for the disk to confirm it, so several threads write at once.
    with ThreadPoolExecutor(_WRITERS) as pool:
        written: list[Future[None]] = []

        def finish() -> None:
            nonlocal count
            while written:
                written.pop(0).result()
                count += 1
                if not written:
                    report(count)

        try:
            for group in submit(missing):
                finish()
                written += [pool.submit(write, part) for part in group]
                if stop():
                    break
        finally:
            finish()
    return count == len(chunks)


def group_chunks(problem: AbstractSweepProblem, chunks: Sequence[Chunk], gradients: bool) -> list[list[Chunk]]:
    """Group chunks that are simulated together: as many as fit into a batch on an accelerator, else one each.

    Args:
        problem: Maps a design to its metrics.
        chunks: The chunks.
        gradients: Whether derivatives are computed.
    """
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

    The cores share the batches of a chunk, and begin those of the next one; on an accelerator a batch contains as many
    chunks as fit into it.

    Args:
        problem: Maps a design to its metrics.
        gradients: Whether derivatives are computed.
    """

    def submit(chunks: Sequence[Chunk]) -> Iterator[FinishedChunks]:
        groups = group_chunks(problem, chunks, gradients)
        batches = (
            _batches(problem, np.concatenate([chunk.designs for chunk in group]), group[0].steps, gradients)
            for group in groups
        )
        for group, parts in zip(groups, call_groups_on_cores(batches), strict=True):
            results = _columns(parts)
            ends = np.cumsum([len(chunk.rows) for chunk in group])
            yield [
                (chunk, {n: v[end - len(chunk.rows) : end] for n, v in results.items()})
                for chunk, end in zip(group, ends, strict=True)
            ]

    return submit


def read_chunks(chunks: Sequence[Chunk], folder: Path) -> dict[str, np.ndarray]:
    """Read the table of a sweep from the files of its chunks.

    Args:
        chunks: All chunks of the sweep.
        folder: Folder of their files.

    Returns:
        Columns by name, shape ``(designs,)`` each, in the order of the designs.

    Raises:
        InputError: If a file is not readable, or contains other designs than its chunk.
    """
    parts: list[dict[str, Any]] = [read_table(folder / chunk.file) for chunk in chunks]
    for chunk, part in zip(chunks, parts, strict=True):
        if not np.array_equal(part["design"], chunk.rows):
            raise InputError(
                f"{folder / chunk.file}: its designs are not those of this chunk: remove the file, and add --resume"
            )
    columns = {n: np.concatenate([part[n] for part in parts]) for n in parts[0]}
    order = np.argsort(columns["design"], kind="stable")
    return {n: values[order] for n, values in columns.items()}
