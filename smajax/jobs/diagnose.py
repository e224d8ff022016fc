"""The job of ``smajax diagnose``."""

import dataclasses
import time
from collections.abc import Sequence
from pathlib import Path
from typing import NamedTuple

import numpy as np

from smajax import parameters
from smajax.console import Progress
from smajax.diagnose.bench import Bench
from smajax.diagnose.evidence import clipped, evidence, with_evidence, without
from smajax.diagnose.verdict import PARTS, Diagnosis, diagnose
from smajax.errors import InputError, NumericsError
from smajax.jobs.fit import read_recordings, refuse_copies, started
from smajax.jobs.record import Clock, Outcome, rig_text, run_record
from smajax.plant.plant import Plant
from smajax.recording import Recording
from smajax.report import prediction
from smajax.report.diagnosis import NEXT_INPUT, diagnosis_document, diagnosis_page
from smajax.report.document import to_json
from smajax.report.prediction import Series, to_series
from smajax.results import check_out, write_folder
from smajax.rig import Rig, read_rig

_FEWEST = 200


class DiagnoseJob(NamedTuple):
    """What a diagnosis is asked to do; ``seed`` replaces the rig's where it is given."""

    rig: Path
    train: Path
    select: Path
    holdout: Path
    out: Path
    seed: int | None = None
    drop_bad_rows: bool = False
    start: Path | None = None


def run_diagnose(job: DiagnoseJob, progress: Progress, argv: Sequence[str]) -> Outcome:
    """Reads, diagnoses and writes the folder. Raises InputError and NumericsError."""
    out, clock, began = check_out(job.out), Clock(), time.perf_counter()
    progress.phase("reading")
    with clock.time("read"):
        rig, text = read_rig(job.rig, drop_misplaced=True), rig_text(job.rig)
        if job.start is not None:
            rig = dataclasses.replace(rig, plant=started(rig, job.start))
        if rig.fit.per_recording:
            raise InputError(f"{job.rig}: a diagnosis takes one set of parameters for all recordings: move fit.per_recording to fit.free")
        recordings = _read(rig, job)
    seed = rig.fit.seed if job.seed is None else job.seed
    with clock.time("diagnose"):
        saturated = _saturated(rig, recordings)
        more, left_out = evidence(rig.plant, rig.fit.observe, recordings)
        plant, settings = with_evidence(rig.plant, without(rig.fit, list(saturated)), more)
        bench = Bench(plant, recordings, settings, interpolation=rig.interpolation)
        try:
            found = diagnose(bench, seed=seed, given=rig.fit.noise, say=progress.phase)
        except NumericsError as error:
            if not error.state:
                raise
            last = parameters.replace(plant, error.state)
            run = run_record("diagnose", rig, argv, clock, seed, error.exit_code)
            write_folder(out, run, lambda folder: dataclasses.replace(rig, plant=last).write(folder / "rig-last.toml"))
            raise NumericsError(f"{error}; where it ended is kept in {out / 'rig-last.toml'}", error.state) from None
    document = diagnosis_document(
        found, recordings, evidence=more, left_out=saturated | left_out, misplaced=rig.misplaced, simulations=bench.simulations,
        wall=time.perf_counter() - began, seed=seed,
    )  # fmt: skip
    run = run_record("diagnose", rig, argv, clock, seed, 0) | {"inputs": list(rig.plant.signals)}
    series = _series(rig, recordings, found)
    progress.phase("writing the report")

    def fill(folder: Path) -> None:
        (folder / "rig.toml").write_text(text, "utf-8", newline="")
        (folder / "diagnosis.json").write_text(to_json(document), "utf-8")
        prediction.write(folder / "prediction.csv", series)
        _diagnosed(rig, bench.fitted(found.after), more).write(folder / "rig-diagnosed.toml")
        if found.next and found.next.recording:
            found.next.recording.write(folder / NEXT_INPUT)
        page = diagnosis_page(document, prediction.read(folder / "prediction.csv"), run["inputs"], run, text)
        (folder / "report.html").write_text(page, "utf-8")

    write_folder(out, run, fill)
    return Outcome(out, document, 0)


def _diagnosed(rig: Rig, plant: Plant, more: Sequence[str]) -> Rig:
    """The rig with this plant; it observes those of the channels ``more``, too, whose sensors have one of its effects."""
    needed = [c for c in more if any(f"{c} observed" in effect.needs for effect in plant.effects)]
    return dataclasses.replace(rig, plant=plant, fit=dataclasses.replace(rig.fit, observe=(*rig.fit.observe, *needed)))


def _read(rig: Rig, job: DiagnoseJob) -> list[Recording]:
    read = [r for r, _ in read_recordings(rig, [job.train], [job.select, job.holdout], job.drop_bad_rows)]
    for one in read:
        if len(one) < _FEWEST:
            raise InputError(f"{one.name}: {len(one)} rows are too few for a diagnosis: at least {_FEWEST} are needed")
    refuse_copies(read)
    signals = rig.plant.signals
    if signals and all(np.ptp(read[0].channels[name]) == 0.0 for name in signals):
        raise InputError(f"{read[0].name}: {' and '.join(signals)} never change{'s' * (len(signals) == 1)}, so that nothing shows: vary it")
    return read


def _saturated(rig: Rig, recordings: Sequence[Recording]) -> dict[str, str]:
    """Observed channels that the diagnosis does without, and why. InputError if none is left."""
    found = {c: why for c in rig.fit.observe if (why := clipped(c, recordings))}
    if len(found) == len(rig.fit.observe):
        told = next(iter(found.values()))
        raise InputError(f"{told}, as a saturated or clipped sensor does: cut these rows out, or record with a wider range")
    return found


def _series(rig: Rig, recordings: Sequence[Recording], found: Diagnosis) -> list[Series]:
    series = []
    for k, (recording, role) in enumerate(zip(recordings, PARTS, strict=True)):
        for when, residuals in found.predictions.items():
            model = {c: recording.channels[c] + v for c, v in residuals[k].items()}
            name = f"{recording.name} ({when})"
            series.append(to_series(name, role, recording.time, recording.channels, model, recording.units, clock=recording.has_clock))
    return series
