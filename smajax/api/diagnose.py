"""Find the effects that a rig has and its model lacks."""

import dataclasses
import time
from collections.abc import Mapping, Sequence
from functools import partial
from pathlib import Path
from typing import Any

from smajax import parameters
from smajax.api.bench import bench_entries, report_findings
from smajax.api.run_record import Clock, run_record
from smajax.api.sources import RigSource, as_rig, one_source, rig_text, with_start
from smajax.api.split import refuse_others, split_recording
from smajax.api.study import FileContent, Study
from smajax.arguments import seed_or_default
from smajax.comparison.material_models import with_material_law
from smajax.diagnosis.data_split import SPLIT_NAMES
from smajax.diagnosis.outcome import diagnose as diagnose_problem
from smajax.diagnosis.result import Diagnosis
from smajax.diagnosis.setup import DiagnosisSetup, diagnosed_rig, set_up_diagnosis
from smajax.errors import Cancelled, NumericsError
from smajax.files.rig_file import Rig
from smajax.files.train_and_holdout import read_train_and_holdout
from smajax.fitting.bench_checks import residual_findings
from smajax.progress import ProgressCallback, Reporter
from smajax.recordings.recording import Recording
from smajax.report.diagnosis import NEXT_INPUT, RIG_WITH_LAW, diagnosis_document
from smajax.report.diagnosis_series import prediction_series


@dataclasses.dataclass(frozen=True, eq=False, repr=False, kw_only=True)
class DiagnosisStudy(Study):
    """Result of a diagnosis.

    Attributes:
        result: Errors, intervals and residuals as arrays; ``None`` for a loaded study.
    """

    command = "diagnose"
    document_name = "diagnosis.json"

    result: Diagnosis | None = None

    @property
    def verdict(self) -> str:
        """The verdict: "named", "named-up-to-class", "partial", "unresolved" or "nothing-missing"."""
        return self.document["verdict"]

    @property
    def effects(self) -> tuple[str, ...]:
        """Keys of the effects that were added."""
        return tuple(self.document["effects"])

    @property
    def equivalent(self) -> dict[str, tuple[str, ...]]:
        """For each added effect, those that explain the recordings as well."""
        return {key: tuple(others) for key, others in self.document["equivalent"].items()}

    @property
    def next_experiment(self) -> Mapping[str, Any] | None:
        """The input that distinguishes equivalent effects; ``None`` where none is needed."""
        return self.document["next_experiment"]

    @property
    def rmse(self) -> dict[str, dict[str, Any]]:
        """RMSE by channel, before and after the effects were added, on each recording."""
        return {channel: dict(entry) for channel, entry in self.document["rmse"].items()}

    @property
    def structure(self) -> str:
        """What the wire needs: "neither", "cells", "grains" or "both"; "neither" where it was not fitted."""
        entry = self.document.get("structure")  # absent in documents of earlier versions
        return entry["variant"] if entry else "neither"

    @property
    def candidates(self) -> tuple[str, ...]:
        """Keys of the effects that explain a part only: the rig may have them, and its diagnosed file does not."""
        return tuple(entry["key"] for entry in self.document.get("candidates", ()))

    @property
    def law(self) -> Mapping[str, Any] | None:
        """Comparison of the rig's material law with the others; ``None`` where it was not asked for."""
        return self.document.get("law")

    @property
    def error_budget(self) -> dict[str, dict[str, dict[str, Any]]]:
        """Errors by what was added to the model, then by channel, from a naive forecast to all effects."""
        return {entry["added"]: dict(entry["channels"]) for entry in self.document.get("error_budget", ())}

    @property
    def rig(self) -> Rig:
        """The rig with its effects and estimates."""
        return self._rig("rig-diagnosed.toml")


def diagnose(
    rig: RigSource,
    train: Any,
    *,
    select: Any = None,
    holdout: Any = None,
    start: str | Path | None = None,
    seed: int | None = None,
    laws: bool = False,
    split: bool = False,
    drop_bad_rows: bool = False,
    progress: ProgressCallback | None = None,
) -> DiagnosisStudy:
    """Find the effects that a rig has and its model lacks: trace the residual to an effect, add it, compare.

    Args:
        rig: The rig, its file, or a dictionary with its sections; ``[fit]`` says what is free and observed.
        train: The recording to fit: a path, a table in memory, or a ``Recording``.
        select: A recording of another input; an effect is added if it lowers the error here.
        holdout: A recording of a third input, which is predicted at the end.
        start: Parameter set to start from, such as the fit.toml of an earlier fit.
        seed: Seed of the random numbers; that of the rig by default.
        laws: Whether to compare other material laws although effects explain the residual.
        split: Whether the only recording is cut into all three, where the wire is at rest.
        drop_bad_rows: Whether to omit rows that cannot be read.
        progress: Function that gets a ``ProgressEvent`` for each phase.

    Raises:
        InputError: If a file or a recording cannot be used.
        NumericsError: If the simulation fails, or the base fit does not converge and no effect explains it (``rig``).
        Cancelled: If the callback stopped the diagnosis.
    """
    clock, began, reporter = Clock(), time.perf_counter(), Reporter(progress)
    with clock.time("read"):
        reporter.phase("reading")
        rig, text, seed = _read_rig(rig, start, seed)
        recordings = _read(rig, (train, select, holdout), split, drop_bad_rows)
        bench = report_findings(rig, recordings, reporter)
    with clock.time("diagnose"):
        setup = set_up_diagnosis(rig, recordings)
        result = _diagnose(rig, setup, (seed, laws), reporter, clock)
    reporter.finish("writing the report")
    bench += _offset_entries(result, recordings, bench)
    document = _document(result, recordings, setup, rig, (began, seed), bench)
    code, reason = _outcome(result, document)
    return DiagnosisStudy(
        document=document,
        series=tuple(prediction_series(recordings, result)),
        run=run_record("diagnose", rig.name, clock, seed, code) | {"inputs": _inputs(rig, recordings)},
        files=_files(rig, text, setup, result),
        reason=reason,
        result=result,
    )


def _read_rig(rig: RigSource, start: str | Path | None, seed: int | None) -> tuple[Rig, str, int]:
    """The rig with its start values, the text of its file, and the seed."""
    rig = as_rig(rig, drop_misplaced=True)
    seed = seed_or_default("diagnose", seed, rig.fit.seed)
    return with_start(rig, start), rig_text(rig), seed


def _read(rig: Rig, sources: Sequence[Any], split: bool, drop_bad_rows: bool) -> list[Recording]:
    """The recordings for training, selection and holdout."""
    refuse_others("diagnose", split, select=sources[1], holdout=sources[2])
    sources = split_recording(rig, sources[0], drop_bad_rows) if split else sources
    train, *others = ([one_source(s, name)] for s, name in zip(sources, SPLIT_NAMES, strict=True))
    pairs = read_train_and_holdout(rig, train, [source for other in others for source in other], drop_bad_rows)
    return [recording for recording, _ in pairs]


def _document(
    result: Diagnosis,
    recordings: Sequence[Recording],
    setup: DiagnosisSetup,
    rig: Rig,
    options: tuple[float, int],
    bench: Sequence[Mapping[str, Any]],
) -> dict[str, Any]:
    """The document of a diagnosis; ``options`` are the time at which it began, s, and the seed."""
    began, seed = options
    return diagnosis_document(
        result,
        recordings,
        evidence=setup.auxiliary,
        left_out=setup.left_out,
        misplaced=rig.misplaced,
        simulations=setup.problem.simulations,
        wall_time=time.perf_counter() - began,
        seed=seed,
        bench=bench,
    )


def _offset_entries(
    result: Diagnosis, recordings: Sequence[Recording], bench: Sequence[Mapping[str, Any]]
) -> list[dict[str, Any]]:
    """Entries of offsets that explain the residual without any effect and that the recordings alone do not show."""
    known = {entry["channel"] for entry in bench if entry["code"] == "offset"}
    offsets = [offset for offset in result.offsets if offset.channel not in known]
    floor = {channel: value for channel, (value, _) in result.noise.items()}
    return bench_entries(residual_findings(recordings[:1], offsets, floor, "and diagnose again"))


def _outcome(result: Diagnosis, document: Mapping[str, Any]) -> tuple[int, str]:
    """Exit code, and why the study did not succeed: an interruption, or a prediction with the effects that failed."""
    if result.interrupted:
        return Cancelled.exit_code, "interrupted with the effects so far"
    failed = [f"{f['recording']}: {f['code']}: {f['text']}" for f in document["failures"] if f["when"] == "after"]
    return (NumericsError.exit_code if failed else 0), "; ".join(failed)


def _inputs(rig: Rig, recordings: Sequence[Recording]) -> list[str]:
    return list(rig.plant.driving_channels(*(recording.channels for recording in recordings)))


def _diagnose(
    rig: Rig, setup: DiagnosisSetup, options: tuple[int, bool], reporter: Reporter, clock: Clock
) -> Diagnosis:
    """Diagnose; an error of the numerics has the record of the run and a rig file with the last parameter values."""
    (seed, laws), report = options, partial(reporter.phase, can_stop=True)
    try:
        return diagnose_problem(setup.problem, seed=seed, laws=laws, known_noise=rig.fit.noise, report_progress=report)
    except NumericsError as error:
        error.run = run_record("diagnose", rig.name, clock, seed, error.exit_code)
        if error.state:
            last = parameters.replace(setup.problem.base_problem.plant, error.state)
            error.rig = dataclasses.replace(rig, plant=last).to_toml()
        raise


def _files(rig: Rig, text: str, setup: DiagnosisSetup, result: Diagnosis) -> dict[str, FileContent]:
    """Return the files of the result folder in addition to document, predictions and page."""
    assert result.plant is not None
    diagnosed = diagnosed_rig(rig, result.plant, setup.auxiliary)
    files: dict[str, FileContent] = {"rig.toml": text.encode(), "rig-diagnosed.toml": diagnosed.to_toml().encode()}
    if result.law is not None and result.law.plant is not None and result.law.better is not None:
        other = with_material_law(rig, result.law.better)
        files[RIG_WITH_LAW] = dataclasses.replace(other, plant=result.law.plant).to_toml().encode()
    if result.next_experiment and result.next_experiment.recording:
        files[NEXT_INPUT] = result.next_experiment.recording.write
    return files
