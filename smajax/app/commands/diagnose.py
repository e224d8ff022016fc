"""Job of ``smajax diagnose``: find the effects that a rig has and its model lacks."""

import dataclasses
import time
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import NamedTuple

import numpy as np

from smajax import parameters
from smajax.app.run_record import Clock, Outcome, read_rig_text, run_record
from smajax.diagnosis.auxiliary_channels import (
    auxiliary_channels,
    saturation_reason,
    with_auxiliary_channels,
    without_channels,
)
from smajax.diagnosis.data_split import SPLIT_NAMES, TRAIN
from smajax.diagnosis.outcome import diagnose
from smajax.diagnosis.problem import DiagnosisProblem
from smajax.diagnosis.result import Diagnosis
from smajax.errors import InputError, NumericsError
from smajax.files.documents import to_json
from smajax.files.result_folder import check_output_folder, write_folder
from smajax.files.rig_file import Rig, read_rig
from smajax.files.train_and_holdout import read_train_and_holdout
from smajax.files.warm_start import warm_start_plant
from smajax.plant.plant import Plant
from smajax.progress import Progress
from smajax.recordings.recording import Recording
from smajax.recordings.shared_rows import refuse_copies
from smajax.report.diagnosis import NEXT_INPUT, diagnosis_document
from smajax.report.diagnosis_page import diagnosis_page
from smajax.report.prediction import Series, make_series, read_predictions, write_predictions

# Smallest number of rows of each recording: with fewer, intervals, noise and classes of effects are not reliable.
# Chosen by trial.
_MIN_ROWS = 200


class DiagnoseJob(NamedTuple):
    """Files and options of a diagnosis.

    Attributes:
        rig: The rig file.
        train: The recording to fit.
        select: The recording that decides whether an effect is added.
        holdout: The recording to predict at the end.
        out: The result folder.
        seed: Seed of the random numbers, which replaces that of the rig file.
        drop_bad_rows: Whether to omit rows that cannot be read.
        start: Parameter set to start from.
    """

    rig: Path
    train: Path
    select: Path
    holdout: Path
    out: Path
    seed: int | None = None
    drop_bad_rows: bool = False
    start: Path | None = None


class DiagnosisSetup(NamedTuple):
    """Input of a diagnosis.

    Attributes:
        problem: The problem.
        auxiliary: Auxiliary channels.
        left_out: Reasons by channel for the channels that are not used.
    """

    problem: DiagnosisProblem
    auxiliary: tuple[str, ...]
    left_out: Mapping[str, str]


def run_diagnose(job: DiagnoseJob, progress: Progress, argv: Sequence[str]) -> Outcome:
    """Read the files, diagnose, and write the result folder.

    Args:
        job: Files and options.
        progress: Display of the phases.
        argv: The command line, for the record of the run.

    Raises:
        InputError: If a file or a recording cannot be used.
        NumericsError: If the simulation fails, or the base fit does not converge and no effect explains it; the
            folder then has ``rig-last.toml``.
    """
    out, clock, began = check_output_folder(job.out), Clock(), time.perf_counter()
    progress.phase("reading")
    with clock.time("read"):
        rig, text = _read_rig(job), read_rig_text(job.rig)
        recordings = _read_recordings(rig, job)
    seed = rig.fit.seed if job.seed is None else job.seed
    with clock.time("diagnose"):
        setup = set_up_diagnosis(rig, recordings)
        try:
            diagnosis = diagnose(setup.problem, seed=seed, known_noise=rig.fit.noise, report_progress=progress.phase)
        except NumericsError as error:
            if not error.state:
                raise
            last = dataclasses.replace(rig, plant=parameters.replace(setup.problem.base_problem.plant, error.state))
            run = run_record("diagnose", rig, argv, clock, seed, error.exit_code)
            write_folder(out, run, lambda folder: last.write(folder / "rig-last.toml"))
            raise NumericsError(
                f"{error}; the last parameter values are saved in {out / 'rig-last.toml'}", error.state
            ) from None
    document = diagnosis_document(
        diagnosis,
        recordings,
        evidence=setup.auxiliary,
        left_out=setup.left_out,
        misplaced=rig.misplaced,
        simulations=setup.problem.simulations,
        wall_time=time.perf_counter() - began,
        seed=seed,
    )
    run = run_record("diagnose", rig, argv, clock, seed, 0) | {"inputs": list(rig.plant.signals)}
    progress.phase("writing the report")

    def fill(folder: Path) -> None:
        (folder / "rig.toml").write_text(text, "utf-8", newline="")
        (folder / "diagnosis.json").write_text(to_json(document), "utf-8")
        write_predictions(folder / "prediction.csv", prediction_series(recordings, diagnosis))
        diagnosed_rig(rig, setup.problem.fitted_plant(diagnosis.after), setup.auxiliary).write(
            folder / "rig-diagnosed.toml"
        )
        if diagnosis.next_experiment and diagnosis.next_experiment.recording:
            diagnosis.next_experiment.recording.write(folder / NEXT_INPUT)
        series = read_predictions(folder / "prediction.csv")
        (folder / "report.html").write_text(diagnosis_page(document, series, run["inputs"], run, text), "utf-8")

    write_folder(out, run, fill)
    return Outcome(out, document, 0)


def set_up_diagnosis(rig: Rig, recordings: Sequence[Recording]) -> DiagnosisSetup:
    """Build the problem of a diagnosis, without saturated channels and with every auxiliary channel.

    Args:
        rig: The rig.
        recordings: Recordings for training, selection and holdout.

    Raises:
        InputError: If every observed channel is saturated.
    """
    saturated = _saturated_channels(rig, recordings)
    auxiliary, unusable = auxiliary_channels(rig.plant, rig.fit.observe, recordings)
    plant, settings = with_auxiliary_channels(rig.plant, without_channels(rig.fit, list(saturated)), auxiliary)
    problem = DiagnosisProblem(plant, recordings, settings, interpolation=rig.interpolation)
    return DiagnosisSetup(problem, auxiliary, saturated | unusable)


def diagnosed_rig(rig: Rig, plant: Plant, auxiliary: Sequence[str]) -> Rig:
    """Return the rig with a diagnosed plant.

    Args:
        rig: The rig.
        plant: The plant with the effects.
        auxiliary: Auxiliary channels; those that one of the effects needs are added to the observed channels.
    """
    needed = [c for c in auxiliary if any(f"{c} observed" in effect.needs for effect in plant.effects)]
    return dataclasses.replace(rig, plant=plant, fit=dataclasses.replace(rig.fit, observe=(*rig.fit.observe, *needed)))


def prediction_series(recordings: Sequence[Recording], diagnosis: Diagnosis) -> list[Series]:
    """Return measured and modelled channels of each recording, before and after the effects were added.

    Args:
        recordings: Recordings for training, selection and holdout.
        diagnosis: The result.
    """
    series = []
    for k, (recording, role) in enumerate(zip(recordings, SPLIT_NAMES, strict=True)):
        for stage, residuals in diagnosis.predictions.items():
            model = {c: recording.channels[c] + v for c, v in residuals[k].items()}
            name = f"{recording.name} ({stage})"
            columns = (recording.time, recording.channels, model, recording.units)
            series.append(make_series(name, role, *columns, has_clock=recording.has_clock))
    return series


def _read_rig(job: DiagnoseJob) -> Rig:
    rig = read_rig(job.rig, drop_misplaced=True)
    if job.start is not None:
        rig = dataclasses.replace(rig, plant=warm_start_plant(rig, job.start))
    if rig.fit.per_recording:
        raise InputError(
            f"{job.rig}: a diagnosis takes one set of parameters for all recordings: move fit.per_recording to fit.free"
        )
    return rig


def _read_recordings(rig: Rig, job: DiagnoseJob) -> list[Recording]:
    """Read the three recordings; refuse short ones, copies, and training inputs that never change."""
    pairs = read_train_and_holdout(rig, [job.train], [job.select, job.holdout], job.drop_bad_rows)
    recordings = [recording for recording, _ in pairs]
    for recording in recordings:
        if len(recording) < _MIN_ROWS:
            raise InputError(
                f"{recording.name}: {len(recording)} rows are too few for a diagnosis: at least {_MIN_ROWS} are needed"
            )
    refuse_copies(recordings)
    signals, train = rig.plant.signals, recordings[TRAIN]
    if signals and all(np.ptp(train.channels[name]) == 0.0 for name in signals):
        raise InputError(
            f"{train.name}: {' and '.join(signals)} never change{'s' * (len(signals) == 1)}, "
            "so that no effect can be detected: vary the input"
        )
    return recordings


def _saturated_channels(rig: Rig, recordings: Sequence[Recording]) -> dict[str, str]:
    """Return the reasons by observed channel why it is saturated; refuse a rig of which all are."""
    reasons = {c: reason for c in rig.fit.observe if (reason := saturation_reason(c, recordings))}
    if len(reasons) == len(rig.fit.observe):
        raise InputError(
            f"{next(iter(reasons.values()))}, as a saturated or clipped sensor does: remove these rows, "
            "or record with a wider range"
        )
    return reasons
