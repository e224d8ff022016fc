"""A sweep in chunks, each written to the disk before the next one counts: what is killed loses at most what it was at.

Which design lies in which chunk, how finely it is resolved and with which others it shares a batch follows from the sweep alone, not from
the machine, the number of workers or what was done before; so a sweep gives the same numbers however it is run on one kind of machine.
"""

import math
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from smajax.console import cores
from smajax.errors import InputError
from smajax.recording import Floats
from smajax.sweep.study import CODES, AbstractStudy, differentiate_batch, evaluate_batch
from smajax.sweep.table import read_table, write_table

# Designs in a batch on an accelerator: with fewer it waits for the next step, with more its caches do not hold them.
WIDE_BATCH = 16384
# Bytes for the arrays of a batch on each core, and on an accelerator.
MEMORY, WIDE_MEMORY = 2**28, 2**33
# Bytes that one design may take.
_MOST = 2**31
_STATES = 4
_WRITERS = 8
CHUNK = 1024


@dataclass(frozen=True, eq=False)
class Chunk:
    """Designs that are simulated and written together: ``rows`` are their numbers, ``designs`` their values, ``(m, axes)``."""

    number: int
    rows: np.ndarray
    designs: Floats
    steps: int

    @property
    def file(self) -> str:
        """The name of its file."""
        return f"chunk-{self.number:06d}.parquet"


Done = Sequence[tuple[Chunk, Mapping[str, np.ndarray]]]  # chunks that were worked on at once, each with its columns
Submit = Callable[[Sequence[Chunk]], Iterable[Done]]


def split(study: AbstractStudy, designs: Floats, size: int) -> list[Chunk]:
    """The chunks of a sweep, each of at most ``size`` designs that are resolved equally finely and do alike."""
    steps, order = study.programs(designs), np.argsort(study.alike(designs), kind="stable")
    chunks: list[Chunk] = []
    for level in np.unique(steps)[::-1]:
        rows = order[steps[order] == level]
        for first in range(0, len(rows), size):
            part = rows[first : first + size]
            chunks.append(Chunk(len(chunks), part, designs[part], int(level)))
    return chunks


def batch_size(study: AbstractStudy, steps: int, gradients: bool) -> int:
    """Designs in one call of the compiled program, a power of two: as many as are fast, or as the memory for a batch holds."""
    fast, room = (WIDE_BATCH * jax.device_count(), WIDE_MEMORY * jax.device_count()) if wide() else (study.batch, MEMORY)
    return max(1, min(fast, 2 ** int(math.log2(max(1.0, room / _bytes(study, steps, gradients))))))


def check_room(study: AbstractStudy, chunks: Sequence[Chunk], gradients: bool) -> None:
    """InputError, with the cure, if one design alone takes more memory than any may."""
    steps = max(chunk.steps for chunk in chunks)
    if (each := _bytes(study, steps, gradients)) > _MOST:
        raise InputError(f"{study.longest(steps)}, {each / 2**30:.1f} GB a design, of {_MOST / 2**30:.0f} GB allowed: {study.shorter}")


def _bytes(study: AbstractStudy, steps: int, gradients: bool) -> int:
    """What one design takes; derivatives keep all states beside the channels, and a tangent for each axis."""
    return 8 * study.numbers(steps) * ((1 + len(study.names)) * _STATES if gradients else 1)


def threads() -> int:
    """Batches that are worked on at once: one on each core, one in all where an accelerator does the work."""
    return 1 if wide() else cores()


def wide() -> bool:
    """Whether an accelerator does the work, whose batches may hold several chunks."""
    return jax.default_backend() != "cpu"


def evaluate(
    study: AbstractStudy, designs: Floats, steps: int, *, gradients: bool = False, workers: int = 1, new: bool = False
) -> dict[str, np.ndarray]:
    """The columns that a sweep adds to designs ``(m, axes)``: metrics, derivatives where ``gradients``, and the code's name.

    Of a ``new`` program the first batch runs alone, so that it is compiled once.
    """
    size = batch_size(study, steps, gradients)
    if wide():  # a large batch is not filled up to four times what there is
        size = min(size, 2 ** math.ceil(math.log2(max(1, len(designs)))))
    starts = range(0, len(designs), size)

    def one(first: int) -> dict[str, np.ndarray]:
        # The last batch is filled up with its last design, so that one program serves all.
        rows = np.minimum(np.arange(first, first + size), len(designs) - 1)
        slopes: dict[str, jax.Array] = {}
        if gradients:
            found, slopes, codes = differentiate_batch(study, _spread(designs[rows]), steps)
        else:
            found, codes = evaluate_batch(study, _spread(designs[rows]), steps)
        kept = min(size, len(designs) - first)
        columns = {n: np.asarray(found[n])[:kept] for n in study.units}
        for n in study.units if gradients else ():
            columns |= {slope_name(n, axis): np.asarray(slopes[n])[:kept, k] for k, axis in enumerate(study.names)}
        return columns | {"code": np.asarray(codes)[:kept]}

    if workers > 1 and len(starts) > 1:
        parts = [one(0)] if new else []
        with ThreadPoolExecutor(workers) as pool:
            parts += pool.map(one, starts[len(parts) :])
    else:
        parts = [one(first) for first in starts]
    columns = {n: np.concatenate([part[n] for part in parts]) for n in parts[0]}
    return columns | {"code": np.asarray(CODES)[columns["code"]]}


def slope_name(metric: str, axis: str) -> str:
    """The column of a metric's derivative in an axis."""
    return f"d {metric} / d {axis}"


def _spread(designs: Floats) -> jax.Array:
    """Designs on the device, shared among several where there are several."""
    if jax.device_count() == 1 or len(designs) % jax.device_count():
        return jnp.asarray(designs)
    mesh = jax.make_mesh((jax.device_count(),), ("designs",), axis_types=(jax.sharding.AxisType.Auto,))
    return jax.device_put(designs, jax.sharding.NamedSharding(mesh, jax.sharding.PartitionSpec("designs")))


def columns_of(chunk: Chunk, names: Sequence[str], found: Mapping[str, np.ndarray]) -> dict[str, np.ndarray]:
    """A chunk's table: the designs' numbers, their values, and what was found."""
    return {"design": chunk.rows, **{n: chunk.designs[:, k] for k, n in enumerate(names)}, **found}


def run_chunks(
    chunks: Sequence[Chunk],
    names: Sequence[str],
    folder: Path,
    submit: Submit,
    done: Callable[[int], None],
    stop: Callable[[], bool],
) -> bool:
    """Has the chunks that are not in the folder yet worked on, and writes each as it comes; says whether all are there now.

    ``submit`` takes chunks and gives them back with their columns in any order, those that were worked on at once together; ``done`` is
    told how many are there; ``stop`` is asked after each time. Raises InputError if the disk does not take a file; what is there by then
    stays.
    """
    missing = [chunk for chunk in chunks if not (folder / chunk.file).is_file()]
    count = len(chunks) - len(missing)
    done(count)

    def write(one: tuple[Chunk, Mapping[str, np.ndarray]]) -> None:
        chunk, found = one
        write_table(folder / chunk.file, columns_of(chunk, names, found))

    # A file is there when the disk says so: several wait for that at once.
    with ThreadPoolExecutor(_WRITERS) as pool:
        for group in submit(missing):
            list(pool.map(write, group))
            count += len(group)
            done(count)
            if stop():
                break
    return count == len(chunks)


def batches(study: AbstractStudy, chunks: Sequence[Chunk], gradients: bool) -> list[list[Chunk]]:
    """Chunks that are worked on at once: each alone, on an accelerator as many of equal steps as one batch holds."""
    groups: list[list[Chunk]] = []
    for chunk in chunks:
        last = groups[-1] if groups else []
        room = batch_size(study, chunk.steps, gradients) - sum(len(one.rows) for one in last)
        if wide() and last and last[0].steps == chunk.steps and len(chunk.rows) <= room:
            last.append(chunk)
        else:
            groups.append([chunk])
    return groups


def here(study: AbstractStudy, gradients: bool) -> Submit:
    """Works on chunks in this process: its cores share the batches of a chunk, or an accelerator takes as many chunks as a batch holds."""

    def submit(chunks: Sequence[Chunk]) -> Iterator[Done]:
        compiled: set[int] = set()
        for group in batches(study, chunks, gradients):
            steps = group[0].steps
            designs = np.concatenate([chunk.designs for chunk in group])
            found = evaluate(study, designs, steps, gradients=gradients, workers=threads(), new=steps not in compiled)
            compiled.add(steps)
            ends = np.cumsum([len(chunk.rows) for chunk in group])
            yield [(c, {n: v[end - len(c.rows) : end] for n, v in found.items()}) for c, end in zip(group, ends, strict=True)]

    return submit


def gather(chunks: Sequence[Chunk], folder: Path) -> dict[str, np.ndarray]:
    """The whole table of a sweep whose chunks are all there, in the designs' order. InputError if one holds others than it should."""
    parts: list[dict[str, Any]] = [read_table(folder / chunk.file) for chunk in chunks]
    for chunk, part in zip(chunks, parts, strict=True):
        if not np.array_equal(part["design"], chunk.rows):
            raise InputError(f"{folder / chunk.file}: its designs are not those that belong there: remove the file, and add --resume")
    columns = {n: np.concatenate([part[n] for part in parts]) for n in parts[0]}
    order = np.argsort(columns["design"], kind="stable")
    return {n: values[order] for n, values in columns.items()}
