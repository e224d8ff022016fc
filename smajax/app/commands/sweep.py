"""Job of ``smajax sweep``: simulate many designs of a rig in chunks, refine the best ones, and write the report.

During the run, the chunks are in ``DIR.partial`` next to the result folder. A run that ends early leaves them there,
and ``--resume`` continues with them; it does not change a finished sweep. ``sweep.json`` in the partial folder
identifies the sweep.
"""

import contextlib
import shutil
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from smajax.app.commands.sweep_document import sweep_document
from smajax.app.console import INTERRUPTED, stopping
from smajax.app.run_record import Clock, Outcome, run_record
from smajax.errors import InputError, NumericsError
from smajax.files.documents import to_json
from smajax.files.result_folder import check_output_folder, read_json, write_folder
from smajax.progress import Progress
from smajax.recordings.readers.parquet import pyarrow_parquet
from smajax.report.sweep import sweep_page
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
from smajax.sweeps.problem import INPUT, AbstractSweepProblem
from smajax.sweeps.refinement import RefinedDesign
from smajax.sweeps.space import pick_and_freeze
from smajax.sweeps.sweep_file import SweepFile, read_sweep
from smajax.sweeps.table import write_table


class SweepJob(NamedTuple):
    """Files and options of a sweep.

    Attributes:
        sweep: A sweep file, or the table of an earlier sweep.
        out: The result folder.
        scheduler: Address of a Dask scheduler, ``local`` to start one, or ``None`` to simulate in this process.
        resume: Whether to continue with the chunks of an earlier run.
    """

    sweep: Path
    out: Path
    scheduler: str | None = None
    resume: bool = False


class _Study(NamedTuple):
    """A sweep with its chunks.

    Attributes:
        sweep: The sweep file.
        problem: Problem that maps a design to its metrics.
        header: Header that identifies the sweep.
        chunks: Chunks of all designs.
        count: Number of designs of the sweep; the designs of the Sobol indices follow them.
    """

    sweep: SweepFile
    problem: AbstractSweepProblem
    header: Mapping[str, Any]
    chunks: Sequence[Chunk]
    count: int


class _Tables(NamedTuple):
    """Columns of the designs of the sweep, and of the designs of the Sobol indices."""

    designs: Mapping[str, np.ndarray]
    sobol: Mapping[str, np.ndarray]


def run_sweep(job: SweepJob, progress: Progress, argv: Sequence[str]) -> Outcome:
    """Simulate the designs chunk by chunk, refine the best ones, and write the result folder.

    Args:
        job: Files and options.
        progress: Display of the phases and steps.
        argv: The command line, for the record of the run.

    Returns:
        The outcome. Its exit code is 3 if every simulation failed, or no sampled or refined design satisfies the
        constraints, and 130 if the run was interrupted; finished chunks are kept.

    Raises:
        InputError: If a file is not valid, the folder cannot be written, or the scheduler cannot be reached.
    """
    out, clock = check_output_folder(job.out), Clock()
    pyarrow_parquet(out, instead="")  # before any computation
    progress.phase("reading")
    with clock.time("read"):
        sweep = read_sweep(job.sweep)
        header = sweep.header()
    note = ""
    if job.resume and not has_checkpoint(out):
        if (finished := _finished_outcome(out, header)) is not None:
            return finished
        note = "there was nothing to resume, so all designs were simulated from the start"
        if (out / "run.json").is_file():
            note += ", and the earlier result, of another sweep or incomplete, was replaced"
    progress.phase("drawing designs")
    with clock.time("draw"):
        study = _draw(sweep, header, job.sweep)
    # Workers are requested before any folder is created, and released before the best designs are refined here.
    with contextlib.ExitStack() as workers:
        if job.scheduler is not None:
            progress.phase("looking for workers")
        submit = workers.enter_context(_workers(study, job.scheduler))
        with checkpoint_folder(out, header, resume=job.resume) as folder:
            complete = _simulate(study, folder, submit, progress, clock)
            workers.close()
            if not complete:
                count = sum((folder / chunk.file).is_file() for chunk in study.chunks)
                reason = f"stopped after {count} of {_counted(study.chunks)}; run it again with --resume to continue"
                return Outcome(folder, {"chunks": count}, INTERRUPTED, reason)
            document, code, reason = _finish(study, folder, out, progress, clock, argv)
            shutil.rmtree(folder, ignore_errors=True)
            return Outcome(out, document, code, reason, note)


def _draw(sweep: SweepFile, header: Mapping[str, Any], path: Path) -> _Study:
    """Draw the designs of the sweep and of the Sobol indices, and split them into chunks."""
    problem = sweep.problem()
    designs, base = sweep.designs(), sweep.sobol_base()
    sobol_designs = pick_and_freeze(sweep.axes, base, sweep.seed) if base else np.zeros((0, len(sweep.axes)))
    chunks = split_into_chunks(problem, np.concatenate([designs, sobol_designs]), sweep.chunk)
    try:
        check_memory(problem, max(chunk.steps for chunk in chunks), sweep.gradients)
    except InputError as error:
        raise InputError(f"{path}: {error}") from None
    return _Study(sweep, problem, header, chunks, len(designs))


def _simulate(study: _Study, folder: Path, submit: Submit, progress: Progress, clock: Clock) -> bool:
    """Simulate the missing chunks, and return whether all are finished."""
    total = sum(len(chunk.rows) for chunk in study.chunks)
    progress.phase(f"compiling, then {total:,} designs in {_counted(study.chunks)}")
    with clock.time("simulate"), stopping(progress) as request:
        return run_chunks(
            study.chunks,
            study.problem.names,
            folder,
            submit,
            lambda count: progress.step(f"{count} of {_counted(study.chunks)}"),
            lambda: request.requested,
        )


def _finish(
    study: _Study, folder: Path, out: Path, progress: Progress, clock: Clock, argv: Sequence[str]
) -> tuple[dict[str, Any], int, str]:
    """Refine the best designs and write the result folder; return the document, the exit code and its reason."""
    sweep, problem = study.sweep, study.problem
    progress.phase("refining the best designs")
    tables = _split_table(read_chunks(study.chunks, folder), study.count)
    with clock.time("refine"):
        best = find_best_designs(sweep, tables.designs)
        refined = refine_best_designs(sweep, problem, tables.designs, best, progress.phase)
        document = sweep_document(sweep, problem, tables.designs, tables.sobol, best, refined)
    reason = "; ".join(document["problems"])
    code = NumericsError.exit_code if reason else 0
    run = run_record("sweep", sweep.subject, argv, clock, sweep.seed, code)
    run |= {"sweep": sweep.name, "header": digest(study.header)}
    progress.phase("writing the report")
    write_folder(out, run, lambda part: _write_results(part, study, tables, document, refined, run))
    return document, code, reason


def _split_table(columns: Mapping[str, np.ndarray], count: int) -> _Tables:
    """Split a table after ``count`` rows; the designs of both parts are numbered from 0."""
    parts = [{n: v[rows] for n, v in columns.items()} for rows in (slice(0, count), slice(count, None))]
    return _Tables(*({**c, "design": c["design"] - c["design"][0]} if len(c["design"]) else c for c in parts))


def _write_results(
    folder: Path,
    study: _Study,
    tables: _Tables,
    document: Mapping[str, Any],
    refined: Sequence[RefinedDesign],
    run: Mapping[str, Any],
) -> None:
    """Write the files of the result folder."""
    sweep, problem = study.sweep, study.problem
    units = {axis.name: axis.unit for axis in sweep.axes} | problem.units
    units |= {
        derivative_column(n, axis.name): f"{unit}/({axis.unit})"
        for n, unit in problem.units.items()
        for axis in sweep.axes
    }
    (folder / "sweep.toml").write_text(sweep.text, "utf-8", newline="")
    (folder / "rig.toml").write_text(sweep.subject.to_toml(), "utf-8")
    for name, columns in (("sweep.parquet", tables.designs), ("sensitivity.parquet", tables.sobol)):
        if name == "sweep.parquet" or len(columns["design"]):
            write_table(folder / name, columns, study.header, {n: u for n, u in units.items() if n in columns})
    for k, entry in enumerate(refined):
        if entry.better:
            values = {
                axis.name: float(v)
                for axis, v in zip(sweep.axes, entry.design, strict=True)
                if not axis.name.startswith(INPUT)
            }
            (folder / f"rig-refined-{k + 1}.toml").write_text(sweep.subject.to_toml(values), "utf-8")
    (folder / "sweep.json").write_text(to_json(document), "utf-8")
    page = sweep_page(document, tables.designs, run, sweep.subject.to_toml())
    (folder / "report.html").write_text(page, "utf-8")


def _counted(chunks: Sequence[Chunk]) -> str:
    """Return the number of chunks in words."""
    return f"{len(chunks):,} chunk{'' if len(chunks) == 1 else 's'}"


@contextlib.contextmanager
def _workers(study: _Study, scheduler: str | None) -> Iterator[Submit]:
    """Yield the function that submits chunks to this process or to a cluster."""
    if scheduler is None:
        yield submit_locally(study.problem, study.sweep.gradients)
        return
    with cluster.connected(scheduler) as client:
        yield cluster.submit_to_cluster(client, study.header, study.sweep.gradients)


def _finished_outcome(out: Path, header: Mapping[str, Any]) -> Outcome | None:
    """Return the result of a finished run of the sweep with this header; ``None`` if there is no complete one."""
    try:
        run, document = read_json(out, "run.json"), read_json(out, "sweep.json")
    except InputError:
        return None
    if run.get("header") != digest(header) or not all((out / str(name)).is_file() for name in run.get("files", [])):
        return None
    note = "there was nothing to resume, since this sweep was finished: its result is unchanged"
    return Outcome(out, document, int(run["exit_code"]), "; ".join(document["problems"]), note)
