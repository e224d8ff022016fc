"""Tune the gains of a controller for a rig, check them, and export the controller."""

import dataclasses
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np

from smajax.api.run_record import Clock, run_record
from smajax.api.sources import RigSource, as_rig, rig_text
from smajax.api.study import FileContent, Study
from smajax.arguments import as_path, seed_or_default
from smajax.control.analysis.closed_loop_checks import GainEvaluation, wire_channels
from smajax.control.controller_file.read import ControllerFile, read_controller
from smajax.control.export.files import export_files
from smajax.control.tuning.tuning_study import ControllerTuning, tune_controller
from smajax.errors import Cancelled, NumericsError
from smajax.files.toml import read_text
from smajax.progress import ProgressCallback, Reporter
from smajax.report.documents import TuneDocument
from smajax.report.prediction import Series, make_series
from smajax.report.tune_document import tune_document
from smajax.report.tuning import tuning_summary


@dataclasses.dataclass(frozen=True, eq=False, repr=False, kw_only=True)
class TuningStudy(Study):
    """Tuned gains with their checks; the saved folder has the controller as C header, JSON document and FMU.

    Attributes:
        result: Loops, rollouts and checks as arrays; ``None`` for a loaded study.
    """

    command = "tune"
    document_name = "tune.json"

    result: ControllerTuning | None = None

    @property
    def gains(self) -> dict[str, float]:
        """Tuned gains by name, in the internal units of ``document["gains"]``."""
        return {name: entry["tuned"] for name, entry in self.document["gains"].items()}

    @property
    def metrics(self) -> Mapping[str, float | None]:
        """Metrics with the tuned gains, in internal units; those of the start are in ``document["metrics"]``."""
        return self.document["metrics"]["tuned"]

    @property
    def margins(self) -> Mapping[str, float | None]:
        """Gain margin, phase margin in degrees, and peak of the sensitivity with the tuned gains."""
        return self.document["margins"]["tuned"]


def tune(
    rig: RigSource,
    controller: str | Path,
    *,
    seed: int | None = None,
    progress: ProgressCallback | None = None,
) -> TuningStudy:
    """Tune a controller's gains in its closed loop with the rig, check them, and export the controller.

    Args:
        rig: The rig, its file, or a dictionary with the sections of one.
        controller: The controller file: controller, reference and limits.
        seed: Seed of the random numbers; that of the controller file by default.
        progress: Function that gets a ``ProgressEvent`` for each phase and step.

    Returns:
        The study. ``success`` is false if the start or tuned gains are unstable, the rig cannot follow the reference, a
        limit is not met, draws fail, or the tuning was stopped; the study then has the best gains so far.

    Raises:
        InputError: If a file is not valid.
        NumericsError: If no gains have a finite cost.
        Cancelled: If the callback stopped the tuning before there were gains.
    """
    clock, reporter = Clock(), Reporter(progress)
    reporter.phase("reading")
    with clock.time("read"):
        path = as_path("tune", "controller", controller, "the path of a controller file")
        rig = as_rig(rig)
        settings = read_controller(path, rig)
        seed = seed_or_default("tune", seed, settings.seed)
        files: dict[str, FileContent] = {
            "rig.toml": rig_text(rig).encode(),
            "controller.toml": read_text(path, "controller").encode(),
        }
    try:
        result = tune_controller(rig, settings, seed=seed, progress=reporter)
    except KeyboardInterrupt:
        if not reporter.stopped:
            raise
        raise Cancelled("the tuning was cancelled before its first step had ended: there are no gains") from None
    clock.timings |= {name: seconds + clock.timings.get(name, 0.0) for name, seconds in result.timings.items()}
    reporter.finish("exporting")
    with clock.time("export"):
        exports = export_files(result)
    document: dict[str, Any] = tune_document(result) | {"left_out": exports.missing}
    document["summary"] = tuning_summary(document)
    reason = "; ".join(document["problems"])
    code = Cancelled.exit_code if result.interrupted else NumericsError.exit_code
    run = run_record("tune", rig.name, clock, result.seed, code if reason else 0)
    reporter.finish("writing the report")
    evaluations = (("start gains", result.start), ("tuned gains", result.tuned))
    return TuningStudy(
        document=TuneDocument.check(document),
        series=tuple(_series(result.settings, evaluation, name) for name, evaluation in evaluations),
        run=run | {"controller": settings.name},
        files=files | exports.contents,
        reason=reason,
        result=result,
    )


def _series(settings: ControllerFile, evaluation: GainEvaluation, name: str) -> Series:
    control, channel = settings.system.plant.drive.control, settings.loop.channel
    reference = np.asarray(settings.scenario.reference)
    time = settings.system.period * np.arange(len(reference), dtype=np.float64)
    names = [channel, *wire_channels(settings, "temperature"), *wire_channels(settings, "stress")]
    model = {c: evaluation.channels[c] for c in dict.fromkeys(names)}
    model |= {c: evaluation.command[:, i] for i, c in enumerate(wire_channels(settings, control))}
    return make_series(name, name.split()[0], time, {channel: reference}, model, {}, has_clock=True)
