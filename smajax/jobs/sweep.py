"""The job of ``smajax sweep``: many designs of a rig simulated in chunks, the best of them, what matters, and the best refined.

While it runs, its chunks lie in ``DIR.partial`` beside the result folder: a run that ends early, for whatever reason, leaves them there,
and ``--resume`` goes on from them; a sweep that has ended it leaves as it is. What a partial folder belongs to is written in its
``sweep.json``.
"""

import contextlib
import shutil
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from smajax import __version__
from smajax.console import INTERRUPTED, Progress, stopping
from smajax.errors import InputError
from smajax.jobs.record import Clock, Outcome, run_record
from smajax.recording import Floats
from smajax.report.document import number, to_json
from smajax.report.sweep import SCHEMA, figure, in_unit, sentences, shown, sweep_page
from smajax.results import check_out, read_json, write_folder
from smajax.sweep import cluster
from smajax.sweep.chunks import Chunk, Submit, check_room, gather, here, run_chunks, slope_name, split
from smajax.sweep.front import beyond, cheapest, feasible, pareto, thinned
from smajax.sweep.metrics import SETTLED
from smajax.sweep.partial import begun, digest, partial_folder
from smajax.sweep.refine import Refined, refine, rescue, starts
from smajax.sweep.sensitivity import indices, whole_rows, why_not
from smajax.sweep.space import pick_and_freeze
from smajax.sweep.study import INPUT, AbstractStudy
from smajax.sweep.table import write_table
from smajax.sweep_file import SweepFile, read_sweep
from smajax.tables.parquet import pyarrow_parquet

_FRONT_SHOWN = 200
# A metric so near to an end of its constraint, in sizes of that, is at it.
_AT = 1e-3


class SweepJob(NamedTuple):
    """What to sweep; ``scheduler`` is a Dask scheduler's address, ``local`` for one of this machine, ``None`` for this process alone."""

    sweep: Path
    out: Path
    scheduler: str | None = None
    resume: bool = False


def run_sweep(job: SweepJob, progress: Progress, argv: Sequence[str]) -> Outcome:
    """Reads, simulates chunk by chunk, and writes the folder. Raises InputError for what cannot be read, written or reached.

    Exit code 3 if every simulation failed or no design keeps the constraints, drawn or refined (with the nearest), 130 if interrupted;
    both keep what is there.
    """
    out, clock = check_out(job.out), Clock()
    pyarrow_parquet(out, instead="")  # before anything is computed
    progress.phase("reading")
    with clock.time("read"):
        given = read_sweep(job.sweep)
        header = given.header()
    note = ""
    if job.resume and not begun(out):
        if (finished := _finished(out, header)) is not None:
            return finished
        note = "there was nothing to resume, so all designs were simulated from the start"
        if (out / "run.json").is_file():
            note += ", and the result that was there, of another sweep or not whole, was replaced"
    study = given.study()
    progress.phase("drawing designs")
    with clock.time("draw"):
        designs = given.designs()
        base = given.base()
        beside = pick_and_freeze(given.axes, base, given.seed) if base else np.zeros((0, len(given.axes)))
        chunks = split(study, np.concatenate([designs, beside]), given.chunk)
        try:
            check_room(study, chunks, given.gradients)
        except InputError as error:
            raise InputError(f"{job.sweep}: {error}") from None
    # Workers are asked for before anything is made, and let go before the best designs are refined here.
    with contextlib.ExitStack() as workers:
        if job.scheduler is not None:
            progress.phase("looking for workers")
        submit = workers.enter_context(_workers(given, study, header, job.scheduler))
        with partial_folder(out, header, resume=job.resume) as partial:
            progress.phase(f"compiling, then {len(designs) + len(beside):,} designs in {_counted(chunks)}")
            with clock.time("simulate"), stopping(progress) as asked:

                def done(count: int) -> None:
                    progress.step(f"{count} of {_counted(chunks)}")

                complete = run_chunks(chunks, study.names, partial, submit, done, lambda: asked.requested)
            workers.close()
            if not complete:
                have = sum((partial / chunk.file).is_file() for chunk in chunks)
                told = f"stopped after {have} of {_counted(chunks)}; run it again with --resume to go on"
                return Outcome(partial, {"chunks": have}, INTERRUPTED, told)
            progress.phase("looking for the best")
            columns = gather(chunks, partial)
            both = [{n: v[rows] for n, v in columns.items()} for rows in (slice(0, len(designs)), slice(len(designs), None))]
            main, apart = ({**c, "design": c["design"] - c["design"][0]} if len(c["design"]) else c for c in both)
            with clock.time("refine"):
                document, refined = _document(given, study, main, apart, progress)
            reason = "; ".join(document["problems"])
            code = 3 if reason else 0
            run = run_record("sweep", given.subject, argv, clock, given.seed, code) | {"sweep": given.name, "header": digest(header)}
            progress.phase("writing the report")
            write_folder(out, run, lambda folder: _fill(folder, given, study, header, main, apart, document, refined, run))
            shutil.rmtree(partial, ignore_errors=True)
            return Outcome(out, document, code, reason, note)


def _fill(
    folder: Path, given: SweepFile, study: AbstractStudy, header: Mapping[str, Any], main: Mapping[str, np.ndarray],
    apart: Mapping[str, np.ndarray], document: Mapping[str, Any], refined: Sequence[Refined], run: Mapping[str, Any],
) -> None:  # fmt: skip
    """Writes what a sweep found into its result folder."""
    units = {axis.name: axis.unit for axis in given.axes} | study.units
    units |= {slope_name(n, axis.name): f"{study.units[n]}/({axis.unit})" for n in study.units for axis in given.axes}
    (folder / "sweep.toml").write_text(given.text, "utf-8", newline="")
    (folder / "rig.toml").write_text(given.subject.to_toml(), "utf-8")
    write_table(folder / "sweep.parquet", main, header, {n: u for n, u in units.items() if n in main})
    if len(apart["design"]):
        write_table(folder / "sensitivity.parquet", apart, header, {n: u for n, u in units.items() if n in apart})
    for k, one in enumerate(refined):
        if one.better:
            values = {a.name: float(v) for a, v in zip(given.axes, one.design, strict=True) if not a.name.startswith(INPUT)}
            (folder / f"rig-refined-{k + 1}.toml").write_text(given.subject.to_toml(values), "utf-8")
    (folder / "sweep.json").write_text(to_json(document), "utf-8")
    (folder / "report.html").write_text(sweep_page(document, main, run, given.subject.to_toml()), "utf-8")


def _counted(chunks: Sequence[Chunk]) -> str:
    """How many there are, in words."""
    return f"{len(chunks):,} chunk{'' if len(chunks) == 1 else 's'}"


@contextlib.contextmanager
def _workers(given: SweepFile, study: AbstractStudy, header: Mapping[str, Any], scheduler: str | None) -> Iterator[Submit]:
    """What works on chunks: this process, or a cluster. InputError if there is no such cluster."""
    if scheduler is None:
        yield here(study, given.gradients)
        return
    with cluster.connected(scheduler) as client:
        yield cluster.across(client, header, given.gradients)


def _finished(out: Path, header: Mapping[str, Any]) -> Outcome | None:
    """What an earlier run of the sweep with this ``header`` left at ``out``; ``None`` if it is not there, or not whole."""
    try:
        run, document = read_json(out, "run.json"), read_json(out, "sweep.json")
    except InputError:
        return None
    if run.get("header") != digest(header) or not all((out / str(name)).is_file() for name in run.get("files", [])):
        return None
    note = "there was nothing to resume, since this sweep had ended: its result was left as it is"
    return Outcome(out, document, int(run["exit_code"]), "; ".join(document["problems"]), note)


def _document(
    given: SweepFile, study: AbstractStudy, main: Mapping[str, np.ndarray], apart: Mapping[str, np.ndarray], progress: Progress
) -> tuple[dict[str, Any], list[Refined]]:
    codes, counts = np.unique(main["code"], return_counts=True)
    kept = feasible(main, given.constraints)
    costs = cheapest(main, given.objectives) if given.objectives else np.zeros((len(kept), 0))
    front = np.flatnonzero(kept)[pareto(costs[kept])] if given.objectives and kept.any() else np.zeros(0, int)
    refined = _refined(given, study, main, kept, costs, front, progress)
    sensitivity, notes = _sensitivity(given, study, apart)
    problems = []
    if not np.any(main["code"] == "done"):
        problems.append(f"none of the {len(kept):,} designs could be simulated: {', '.join(codes)}")
    elif given.constraints and not kept.any() and not any(one.better for one in refined):
        problems.append(_nearest(given, main, refined))
    document: dict[str, Any] = {
        "schema": SCHEMA,
        "sweep": given.name,
        "rig": given.subject.name,
        "sampling": given.sampling,
        "designs": len(kept),
        "codes": {str(c): int(n) for c, n in zip(codes, counts, strict=True)},
        "feasible": int(kept.sum()),
        "parameters": {
            a.name: {"unit": a.unit, "from": a.lower, "to": a.upper, "scale": "log" if a.log else "even", "values": list(a.values)}
            for a in given.axes
        },
        "metrics": {n: {"unit": unit, **_span(main[n])} for n, unit in study.units.items()},
        "objectives": dict(given.objectives),
        "constraints": {n: {"at_least": number(low), "at_most": number(high)} for n, (low, high) in given.constraints.items()},
        "front": [_row(given, study, main, k) for k in front[thinned(costs[front], _FRONT_SHOWN)]],
        "on_front": len(front),
        "settling": _settling(main, front, refined),
        "sensitivity": sensitivity,
        "sensitivity_notes": notes,
        "refined": [_refined_entry(given, one) for one in refined],
        "problems": problems,
        "seed": given.seed,
        "smajax": __version__,
    }
    return document | {"summary": sentences(document)}, refined


def _span(values: np.ndarray) -> dict[str, Any]:
    good = values[~np.isnan(values)]
    return {"lowest": figure(good.min()), "highest": figure(good.max())} if len(good) else {"lowest": None, "highest": None}


def _row(given: SweepFile, study: AbstractStudy, main: Mapping[str, np.ndarray], k: int) -> dict[str, Any]:
    values = {a.name: float(main[a.name][k]) for a in given.axes}
    return {"design": int(main["design"][k]), "parameters": values, "metrics": {n: figure(main[n][k]) for n in study.units}}


def _nearest(given: SweepFile, main: Mapping[str, np.ndarray], refined: Sequence[Refined]) -> str:
    """What to say if no design keeps the constraints: the nearest that could be simulated, where refining led, and what is beyond."""
    far = np.where(main["code"] == "done", beyond(main, given.constraints), np.inf)
    k = int(np.argmin(far))
    drawn = {n: float(main[n][k]) for n in given.constraints}
    told = f"none of the {len(far):,} designs keeps the constraints: the nearest, design {int(main['design'][k])}, has "
    told += ", ".join(_broken(given, drawn))
    if not refined:
        return told
    last = min(refined, key=lambda one: float(beyond(one.metrics, given.constraints)))
    where = ", ".join(f"{a.name} {shown(float(v), a.unit)}" for a, v in zip(given.axes, last.design, strict=True))
    told += f"; refining from the nearest kept none either, and came to {', '.join(_broken(given, last.metrics))}"
    ends = [(n, end) for n, both in given.constraints.items() for end in both if np.isfinite(end)]
    if binding := [n for n, end in ends if abs(last.metrics[n] - end) <= _AT * abs(end)]:
        told += f" with {' and '.join(binding)} at the limit,"
    return f"{told} at {where}"


def _broken(given: SweepFile, values: Mapping[str, float]) -> list[str]:
    """The constraints that metrics do not keep, each with its figure and what is allowed, in the unit of the sweep file."""
    found = []
    for name, (low, high) in given.constraints.items():
        if not low <= values[name] <= high:
            unit = given.subject.units[name]
            written = given.units_of[name]
            ends = [(word, end) for word, end in (("at least", low), ("at most", high)) if np.isfinite(end)]
            allowed = " and ".join(f"{word} {in_unit(end, unit, written)}" for word, end in ends)
            found.append(f"{name} {in_unit(values[name], unit, written)} (allowed: {allowed})")
    return found


def _settling(main: Mapping[str, np.ndarray], front: np.ndarray, refined: Sequence[Refined]) -> dict[str, Any]:
    """How many designs, of the best and of the refined, end their last cycle elsewhere than they began it; of a machine, nothing."""
    if "settling" not in main:
        return {}
    moving = (main["code"] == "done") & ~(main["settling"] <= SETTLED)
    after = sum(one.better and not one.metrics["settling"] <= SETTLED for one in refined)
    drawn = {"unsettled": int(moving.sum()), "unsettled_on_front": int(moving[front].sum())}
    return {"limit": SETTLED, **drawn, "unsettled_refined": int(after)}


def _sensitivity(given: SweepFile, study: AbstractStudy, apart: Mapping[str, np.ndarray]) -> tuple[dict[str, Any], list[str]]:
    """Sobol indices by metric, and in sentences what they leave out and why some are missing."""
    if not len(apart["design"]):
        return {}, [text for text in [given.no_indices()] if text]
    done, axes = apart["code"] == "done", len(study.names)
    found, notes = {}, []
    failed = ~whole_rows(np.where(done, 0.0, np.nan), axes)
    if failed.any():
        notes.append(f"Sobol indices leave out {failed.sum():,} of {len(failed):,} rows of designs, in which a simulation failed.")
    for name in study.units:
        values = np.where(done, apart[name], np.nan)
        told = indices(values, study.names, given.seed)
        if reason := why_not(values, axes):
            notes.append(f"No Sobol indices of {name}: {reason}.")
        elif more := int(np.sum(~whole_rows(values, axes)) - failed.sum()):
            notes.append(f"Those of {name} leave out {more:,} more, in which it has no value.")
        found[name] = {axis: {key: _plain(value) for key, value in index._asdict().items()} for axis, index in told.items()}
    return found, notes


def _plain(value: float | tuple[float, float]) -> Any:
    return [number(v) for v in value] if isinstance(value, tuple) else number(value)


def _refined(
    given: SweepFile,
    study: AbstractStudy,
    main: Mapping[str, np.ndarray],
    kept: np.ndarray,
    costs: Floats,
    front: np.ndarray,
    progress: Progress,
) -> list[Refined]:
    """The best designs, refined: in the first objective, no other objective getting worse than it is there.

    Where no design keeps the constraints, those that come nearest are moved to where they hold.
    """
    if not given.refined or not np.any(main["code"] == "done") or all(axis.values for axis in given.axes):
        return []
    designs = np.column_stack([main[a.name] for a in given.axes])
    moving = [k for k, a in enumerate(given.axes) if not a.values]
    shares = np.column_stack([given.axes[k].share(designs[:, k]) for k in moving])
    if kept.any():
        pool = front if len(given.objectives) > 1 else np.flatnonzero(kept)
        pool = pool[~np.isnan(costs[pool, 0])]
        order, better = pool[np.argsort(costs[pool, 0], kind="stable")], refine
    else:
        pool = np.flatnonzero(main["code"] == "done")
        order, better = pool[np.argsort(beyond(main, given.constraints)[pool], kind="stable")], rescue
    found = []
    for k, row in enumerate(starts(shares, order, given.refined)):
        progress.phase(f"refining design {int(main['design'][row])} ({k + 1})")
        found.append(better(study, given.axes, designs[row], given.objectives, given.constraints))
    return found


def _refined_entry(given: SweepFile, one: Refined) -> dict[str, Any]:
    return {
        "parameters": {a.name: float(v) for a, v in zip(given.axes, one.design, strict=True)},
        "before": {n: figure(v) for n, v in one.before.items()},
        "metrics": {n: figure(v) for n, v in one.metrics.items()},
        "simulations": one.simulations,
        "better": one.better,
        "rescued": one.rescued,
    }
