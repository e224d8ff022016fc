"""Simulate many designs of a rig or an actuator in chunks, and refine the best ones.

During the run, the chunks are in ``DIR.partial`` next to the result folder. A run that ends early leaves them there,
and ``resume`` continues with them; it does not change a finished sweep. ``sweep.json`` in the partial folder
identifies the sweep.
"""

import contextlib
import dataclasses
import shutil
import tempfile
from collections.abc import Iterator, Mapping, Sequence
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from smajax.api.run_record import Clock, run_record
from smajax.api.saved_files import saved_files
from smajax.api.study import FileContent, Study
from smajax.arguments import as_path, check_type
from smajax.errors import Cancelled, InputError, NumericsError
from smajax.files.result_folder import check_output_folder
from smajax.progress import ProgressCallback, Reporter
from smajax.recordings.recording import Recording
from smajax.report.documents import read_document, read_run
from smajax.report.sweep_document import sweep_document
from smajax.sweeps import dask as cluster
from smajax.sweeps.best_designs import find_best_designs, refine_best_designs
from smajax.sweeps.checkpoint import checkpoint_folder, digest, has_checkpoint
from smajax.sweeps.chunks import (
    Chunk,
    Submit,
    derivative_column,
    read_chunks,
    run_chunks,
    split_into_chunks,
    submit_locally,
)
from smajax.sweeps.compilation import check_memory
from smajax.sweeps.design_input import design_input, refined_files
from smajax.sweeps.problem import AbstractSweepProblem
from smajax.sweeps.refinement import RefinedDesign
from smajax.sweeps.size import SweepSize, require_size, sweep_size
from smajax.sweeps.space import pick_and_freeze
from smajax.sweeps.sweep_file import SweepFile, read_sweep
from smajax.sweeps.table import read_table, read_units, write_table

if TYPE_CHECKING:
    import pandas

TABLE = "sweep.parquet"
SOBOL_TABLE = "sensitivity.parquet"


@dataclasses.dataclass(frozen=True, eq=False, repr=False, kw_only=True)
class SweepStudy(Study):
    """Designs of a sweep with their metrics, the best ones, and what matters.

    Attributes:
        designs: Columns of the table of the designs by name, shape ``(designs,)`` each.
        units: Units by column.
    """

    command = "sweep"
    document_name = "sweep.json"

    designs: Mapping[str, np.ndarray]
    units: Mapping[str, str] = dataclasses.field(default_factory=dict)

    @property
    def data(self) -> Mapping[str, np.ndarray]:
        """Data of figure and page: the table of the designs."""
        return self.designs

    @property
    def pareto(self) -> tuple[Mapping[str, Any], ...]:
        """Designs of the Pareto front, each with its parameters and metrics; thinned out where there are many."""
        return tuple(self.document["front"])

    @property
    def refined(self) -> tuple[Mapping[str, Any], ...]:
        """Designs that were refined by gradients, each with its metrics before and after."""
        return tuple(self.document["refined"])

    @property
    def sensitivity(self) -> Mapping[str, Any]:
        """Sobol indices by metric and parameter; empty where the sweep asks for none."""
        return self.document["sensitivity"]

    def to_pandas(self) -> "pandas.DataFrame":
        """Return the table of the designs, one row each; its columns have their units in brackets."""
        import pandas

        return pandas.DataFrame(
            {f"{n} [{self.units[n]}]" if n in self.units else n: v for n, v in self.designs.items()}
        )


def sweep(
    file: str | Path,
    *,
    folder: str | Path | None = None,
    scheduler: str | None = None,
    resume: bool = False,
    progress: ProgressCallback | None = None,
    argv: Sequence[str] = (),
) -> SweepStudy:
    """Simulate the designs of a sweep chunk by chunk, refine the best ones, and rank them.

    Args:
        file: A sweep file, or the table sweep.parquet of an earlier sweep.
        folder: Result folder, which is written at the end; chunks are kept next to it until then. Without it they are
            in a temporary folder, and ``save`` writes the result.
        scheduler: Address of a Dask scheduler, ``local`` to start one, or ``None`` to simulate in this process.
        resume: Whether to continue with the chunks of an earlier run into this folder.
        progress: Function that gets a ``ProgressEvent`` for each phase and chunk; one that raises ``StopIteration``
            stops the sweep, and finished chunks are kept.
        argv: Command line for the record of the run.

    Returns:
        The study. ``success`` is false if every simulation failed, or no sampled or refined design satisfies the
        constraints.

    Raises:
        InputError: If a file is not valid, the folder cannot be written, or the scheduler cannot be reached.
        Cancelled: If the callback stopped the sweep.
    """
    path = as_path("sweep", "file", file, "the path of a sweep file, or of the table sweep.parquet of a sweep")
    if scheduler is not None:
        check_type("sweep", "scheduler", scheduler, str, "the address of a Dask scheduler, or 'local'")
    if resume and folder is None:
        raise InputError("resume: the chunks are next to a result folder: give the one of the earlier run as folder")
    reporter = Reporter(progress)
    with contextlib.ExitStack() as stack:
        if folder is None:
            out = Path(stack.enter_context(tempfile.TemporaryDirectory(prefix="smajax-"))) / "sweep"
        else:
            out = check_output_folder(as_path("sweep", "folder", folder, "the path of the result folder"))
        return _sweep(path, out, folder is not None, scheduler, resume, reporter, argv)


class _Designs(NamedTuple):
    """A sweep with its chunks.

    Attributes:
        sweep: The sweep file.
        problem: Problem that maps a design to its metrics.
        header: Header that identifies the sweep.
        chunks: Chunks of all designs.
        count: Number of designs of the sweep; the designs of the Sobol indices follow them.
        size: Estimated size of the sweep.
    """

    sweep: SweepFile
    problem: AbstractSweepProblem
    header: Mapping[str, Any]
    chunks: Sequence[Chunk]
    count: int
    size: SweepSize


def _recording_note(sweep: SweepFile) -> str:
    """Return what is to be said of the recording whose inputs drive the designs; empty without one."""
    source = getattr(sweep.subject, "source", None)
    return "; ".join(f"{source.name}: {note}" for note in source.notes) if isinstance(source, Recording) else ""


def _sweep(
    file: Path, out: Path, save: bool, scheduler: str | None, resume: bool, reporter: Reporter, argv: Sequence[str]
) -> SweepStudy:
    """Run a sweep with its chunks next to ``out``, and write that folder if it is to be saved."""
    clock = Clock()
    reporter.phase("reading")
    with clock.time("read"):
        sweep = read_sweep(file)
        header = sweep.header()
    note = _recording_note(sweep)
    if resume and not has_checkpoint(out):
        if (finished := _finished_study(out, header)) is not None:
            return finished
        note += "; " * bool(note) + "there was nothing to resume, so all designs were simulated from the start"
        if (out / "run.json").is_file():
            note += ", and the earlier result, of another sweep or incomplete, was replaced"
    reporter.phase("drawing designs")
    with clock.time("draw"):
        designs = _draw(sweep, header, file)
    # Workers are requested before any folder is created, and released before the best designs are refined here.
    with contextlib.ExitStack() as workers:
        if scheduler is not None:
            reporter.phase("looking for workers")
        submit = workers.enter_context(_workers(designs, scheduler))
        with checkpoint_folder(out, header, resume=resume) as folder:
            complete = _simulate(designs, folder, submit, reporter, clock)
            workers.close()
            advice = "run it again with --resume (resume=True in Python) to continue"
            saved = f"{advice}; the results so far are saved in {folder}"
            kept = saved if save else "nothing is kept, since no folder was given"
            if not complete or reporter.stopped:  # a request during the last chunks ends the sweep before refinement
                count = sum((folder / chunk.file).is_file() for chunk in designs.chunks)
                raise Cancelled(f"stopped after {count} of {_counted(designs.chunks)}; {kept}")
            try:
                study = dataclasses.replace(_finish(designs, folder, reporter, clock), note=note)
            except Cancelled as error:
                raise Cancelled(f"{error}; {kept}") from None
            if save:
                study.save(out, argv=argv)
            shutil.rmtree(folder, ignore_errors=True)
            return study


def _draw(sweep: SweepFile, header: Mapping[str, Any], path: Path) -> _Designs:
    """Draw the designs of the sweep and of the Sobol indices, and split them into chunks."""
    problem, base = sweep.problem(), sweep.sobol_base()
    size = sweep_size(problem, sweep.axes, sweep.count + base * (len(sweep.axes) + 2), sweep.gradients)
    try:
        require_size(size)
    except InputError as error:
        raise InputError(f"{path}: {error}") from None
    designs = sweep.designs()
    sobol_designs = pick_and_freeze(sweep.axes, base, sweep.seed) if base else np.zeros((0, len(sweep.axes)))
    chunks = split_into_chunks(problem, np.concatenate([designs, sobol_designs]), sweep.chunk)
    try:
        check_memory(problem, max(chunk.steps for chunk in chunks), sweep.gradients)
    except InputError as error:
        raise InputError(f"{path}: {error}") from None
    return _Designs(sweep, problem, header, chunks, len(designs), size)


def _simulate(designs: _Designs, folder: Path, submit: Submit, reporter: Reporter, clock: Clock) -> bool:
    """Simulate the missing chunks, and return whether all are finished."""
    total = sum(len(chunk.rows) for chunk in designs.chunks)
    chunks, time = len(designs.chunks), designs.size.time_text

    def report(count: int) -> None:
        with contextlib.suppress(KeyboardInterrupt):  # the run ends after this group of chunks
            reporter.step(f"{count} of {_counted(designs.chunks)}", count, chunks)

    with clock.time("simulate"):
        with contextlib.suppress(KeyboardInterrupt):
            reporter.phase(f"compiling, then {total:,} designs in {_counted(designs.chunks)}{time}", can_stop=True)
        if reporter.stopped:
            return False
        return run_chunks(designs.chunks, designs.problem.names, folder, submit, report, lambda: reporter.stopped)


def _finish(designs: _Designs, folder: Path, reporter: Reporter, clock: Clock) -> SweepStudy:
    """Refine the best designs, and build the study."""
    sweep, problem = designs.sweep, designs.problem
    reporter.phase("refining the best designs")
    columns, sobol_columns = _split_table(read_chunks(designs.chunks, folder), designs.count)
    with clock.time("refine"):
        best = find_best_designs(sweep, columns)
        refined = refine_best_designs(sweep, problem, columns, best, reporter.phase)
        document = sweep_document(sweep, problem, columns, sobol_columns, best, refined)
    reason = "; ".join(document["problems"])
    run = run_record("sweep", sweep.subject.name, clock, sweep.seed, NumericsError.exit_code if reason else 0)
    reporter.finish("writing the report")
    units = {axis.name: axis.unit for axis in sweep.axes} | problem.units
    units |= {
        derivative_column(n, axis.name): f"{unit}/({axis.unit})"
        for n, unit in problem.units.items()
        for axis in sweep.axes
    }
    return SweepStudy(
        document=document,
        run=run | {"sweep": sweep.name, "header": digest(designs.header)},
        files=_files(designs, columns, sobol_columns, units, refined),
        reason=reason,
        designs=columns,
        units={n: u for n, u in units.items() if n in columns},
    )


def _split_table(
    columns: Mapping[str, np.ndarray], count: int
) -> tuple[Mapping[str, np.ndarray], Mapping[str, np.ndarray]]:
    """Split a table after ``count`` rows, into the sweep's designs and those of the Sobol indices, numbered from 0."""
    first, second = ({n: v[rows] for n, v in columns.items()} for rows in (slice(0, count), slice(count, None)))
    if len(second["design"]):
        second["design"] = second["design"] - second["design"][0]
    return first, second


def _files(
    designs: _Designs,
    columns: Mapping[str, np.ndarray],
    sobol_columns: Mapping[str, np.ndarray],
    units: Mapping[str, str],
    refined: Sequence[RefinedDesign],
) -> dict[str, FileContent]:
    """Return the files of the result folder in addition to document and page."""
    sweep = designs.sweep
    files: dict[str, FileContent] = {
        "sweep.toml": sweep.text.encode(),
        "rig.toml": sweep.subject.to_toml().encode(),
    }
    for name, table in ((TABLE, columns), (SOBOL_TABLE, sobol_columns)):
        if name == TABLE or len(table["design"]):
            of_columns = {n: u for n, u in units.items() if n in table}
            files[name] = partial(write_table, columns=table, header=designs.header, units=of_columns)
    for k, entry in enumerate(refined, 1):
        if entry.better:
            rig_name, input_name = refined_files(k)
            content = design_input(sweep.subject, designs.problem, sweep.axes, entry.design)
            files[rig_name] = content.rig.encode()
            if content.recording is not None:
                files[input_name] = content.recording.write
    return files


def _counted(chunks: Sequence[Chunk]) -> str:
    """Return the number of chunks in words."""
    return f"{len(chunks):,} chunk{'' if len(chunks) == 1 else 's'}"


@contextlib.contextmanager
def _workers(designs: _Designs, scheduler: str | None) -> Iterator[Submit]:
    """Yield the function that submits chunks to this process or to a cluster."""
    if scheduler is None:
        yield submit_locally(designs.problem, designs.sweep.gradients)
        return
    with cluster.connected(scheduler) as client:
        yield cluster.submit_to_cluster(client, designs.header, designs.sweep.gradients)


def _finished_study(out: Path, header: Mapping[str, Any]) -> SweepStudy | None:
    """Return the result of a finished run of the sweep with this header; ``None`` if there is no complete one."""
    try:
        run = read_run(out)
        if run.header != digest(header) or not all((out / name).is_file() for name in run.files):
            return None
        document = read_document(out)
    except InputError:
        return None
    note = "there was nothing to resume, since this sweep was finished: its result is unchanged"
    return load_sweep(out, run.to_dict(), document.to_dict(), note)


def load_sweep(folder: Path, run: Mapping[str, Any], document: Mapping[str, Any], note: str = "") -> SweepStudy:
    """Return the study of a result folder.

    Args:
        folder: The folder.
        run: The document run.json.
        document: The document sweep.json.
        note: Sentence for the user.
    """
    return SweepStudy(
        document=document,
        run=run,
        files=saved_files(folder, run, "sweep.json"),
        reason="; ".join(document["problems"]),
        note=note,
        designs=read_table(folder / TABLE),
        units=read_units(folder / TABLE),
    )
