"""Job of ``smajax tune``: tune the gains of a controller for a rig, compare them with the start, and export them."""

import math
from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any, NamedTuple

import equinox as eqx
import numpy as np

from smajax import __version__, parameters
from smajax.app.run_record import Clock, Outcome, read_rig_text, run_record
from smajax.channels import CHANNELS
from smajax.control.analysis.closed_loop_checks import GainEvaluation, check_draws, evaluate_gains, wire_channels
from smajax.control.analysis.reachable_range import clip_reference, falls_when_heated, reachable_range
from smajax.control.controller_file.read import ControllerFile, read_controller
from smajax.control.export.c_header import c_header
from smajax.control.export.fmu.controller_model import controller_model
from smajax.control.export.fmu.pack import pack_fmu
from smajax.control.export.fmu.plant_model import plant_model
from smajax.control.export.json_document import controller_document
from smajax.control.loop.gains import gain
from smajax.control.tuning.feedforward_identification import IdentifiedFeedforward, identify_feedforward, with_inverse
from smajax.control.tuning.plant_draws import draw_from_fit, draw_from_ranges
from smajax.control.tuning.problem import GAIN_SPREAD, NOISE_DRAWS, TuningProblem, noise_draws
from smajax.control.tuning.retuning import retune_on_failing_draws, search_gains
from smajax.errors import InputError, NumericsError
from smajax.files.documents import finite_or_none, to_json
from smajax.files.result_folder import check_output_folder
from smajax.files.rig_file import Rig, read_rig
from smajax.progress import Progress
from smajax.report import prediction
from smajax.report.documents import ControllerDocument, TuneDocument, read_fit, write_result
from smajax.report.tune_document import TunedLoop, feedforward_entry, tune_document, unreachable_reference
from smajax.report.tuning import tuning_page, tuning_summary

# Key of the random stream of the draws, which makes it independent of other streams with the same seed.
_DRAWS_STREAM = 7


class TuneJob(NamedTuple):
    """Files and options of a tuning.

    Attributes:
        rig: The rig file.
        controller: The controller file.
        out: The result folder.
        seed: Seed of the random numbers, which replaces that of the controller file.
    """

    rig: Path
    controller: Path
    out: Path
    seed: int | None = None


class _Inputs(NamedTuple):
    """Input of a tuning: rig and controller file with their texts, the seed, and draws of parameters."""

    rig: Rig
    rig_text: str
    settings: ControllerFile
    controller_text: str
    seed: int
    draws: Mapping[str, np.ndarray]


def run_tune(job: TuneJob, progress: Progress, argv: Sequence[str]) -> Outcome:
    """Tune and check the gains, export the controller, and write the result folder.

    Args:
        job: Files and options.
        progress: Display of the phases and steps.
        argv: The command line, for the record of the run.

    Returns:
        The outcome. Its exit code is 3 if the start or tuned gains are unstable, the rig cannot follow the reference, a
        limit is not met, or draws fail; the folder then has the best gains.

    Raises:
        InputError: If a file is not valid, or the folder cannot be written.
        NumericsError: If no gains have a finite cost.
    """
    out, clock = check_output_folder(job.out), Clock()
    progress.phase("reading")
    with clock.time("read"):
        inputs = _read(job)
    settings, seed = inputs.settings, inputs.seed
    identified = None
    if settings.feedforward is not None:
        progress.phase("fitting the feedforward to a slow loop")
        with clock.time("feedforward"):
            max_temperature = settings.limits.get("temperature", math.inf)
            identified = identify_feedforward(settings.system, settings.loop, settings.feedforward, max_temperature)
            controller = with_inverse(settings.loop.controller, identified.inverse)
            loop = eqx.tree_at(lambda closed_loop: closed_loop.controller, settings.loop, controller)
            settings = replace(settings, loop=loop)
    file_weights = settings.weights
    settings, tuned_loop = _tune(settings, inputs, job, progress, clock)
    progress.phase("exporting")
    with clock.time("export"):
        exports, left_out = _exports(settings, inputs.rig, tuned_loop.tuned)
    document: dict[str, Any] = tune_document(settings, inputs.rig.name, tuned_loop, seed) | {"left_out": left_out}
    document |= _optional_entries(settings, tuned_loop.tuned, identified)
    if tuned_loop.other_weights:
        document["objective"]["asked"] = dict(file_weights)
    document["summary"] = tuning_summary(document)
    TuneDocument.check(document)
    reason = "; ".join(document["problems"])
    code = NumericsError.exit_code if reason else 0
    run = run_record("tune", inputs.rig, argv, clock, seed, code) | {"controller": settings.name}
    progress.phase("writing the report")
    write_result(out, run, lambda folder: _write_results(folder, inputs, settings, tuned_loop, exports, document, run))
    return Outcome(out, document, code, reason)


def _read(job: TuneJob) -> _Inputs:
    rig, text = read_rig(job.rig), read_rig_text(job.rig)
    settings = read_controller(job.controller, rig)
    controller_text = job.controller.read_text("utf-8-sig")
    seed = settings.seed if job.seed is None else job.seed
    try:
        draws = _draw_parameters(settings, rig, seed)
    except InputError as error:
        raise InputError(f"{job.controller}: robust.fit: {error}") from None
    return _Inputs(rig, text, settings, controller_text, seed, draws)


def _draw_parameters(settings: ControllerFile, rig: Rig, seed: int) -> dict[str, np.ndarray]:
    """Draw the uncertain parameters; the number is the larger of ``robust.draws`` and ``robust.check``."""
    if settings.robust is None:
        return {}
    count = max(settings.robust.draws, settings.robust.check)
    rng = np.random.default_rng([seed, _DRAWS_STREAM])
    draws: dict[str, np.ndarray] = {}
    if settings.robust.fit is not None:
        names = list(parameters.all_declarations(rig.plant))
        draws = draw_from_fit(read_fit(settings.robust.fit).to_dict(), names, count, rng)
    return draws | draw_from_ranges(settings.robust.vary, count, rng)


def _tune(
    settings: ControllerFile, inputs: _Inputs, job: TuneJob, progress: Progress, clock: Clock
) -> tuple[ControllerFile, TunedLoop]:
    """Tune the gains; return the settings of the tuning (reference and weights may differ) and the result."""
    draws, seed, robust = inputs.draws, inputs.seed, settings.robust
    progress.phase("evaluating the start gains")
    with clock.time("start"):
        reachable = reachable_range(settings.system, settings.loop, settings.scenario, settings.limits)
        _check_channel(settings, inputs.rig, job)
        unreachable = unreachable_reference(settings, reachable)
        if unreachable:
            settings = replace(settings, scenario=clip_reference(settings.scenario, reachable))
        start_gains = {n: float(gain(settings.loop, n)) for n in settings.bounds}
        start = evaluate_gains(settings, start_gains)
    progress.phase("tuning")
    with clock.time("tune"):
        members = {n: v[: robust.draws] for n, v in draws.items()} if robust else {}
        noise = noise_draws(settings.loop, settings.scenario, robust.draws if robust else NOISE_DRAWS, seed)
        # Gains that are limited, or tuned for several plants, are evaluated as they are.
        spread = 0.0 if settings.limits or settings.settle or robust else GAIN_SPREAD
        problem = TuningProblem.of(
            settings.system, settings.loop, settings.scenario, settings.bounds, members, noise, spread
        )
        result, tuned, weights = search_gains(settings, problem, reachable, seed, progress)
        other_weights, settings = weights is not settings.weights, replace(settings, weights=weights)
    progress.phase("checking")
    with clock.time("check"):
        gain_sets = {"start": start_gains, "tuned": result.gains} if draws else {}
        checks = {stage: check_draws(settings, gains, draws) for stage, gains in gain_sets.items()}
    if checks and checks["tuned"].failing:
        with clock.time("tune"):
            result, checks["tuned"] = retune_on_failing_draws(settings, problem, result, checks, draws, seed, progress)
    # Gains that were tuned for some draws may be worse on the others.
    if checks and len(checks["start"].failing) < len(checks["tuned"].failing):
        result, checks["tuned"], other_weights = result._replace(gains=start_gains), checks["start"], False
    if checks:
        tuned = evaluate_gains(settings, result.gains)
    documents = {stage: check.document for stage, check in checks.items()}
    tuned_loop = TunedLoop(start, tuned, result.rollouts, documents, unreachable, reachable, other_weights)
    return settings, tuned_loop


def _check_channel(settings: ControllerFile, rig: Rig, job: TuneJob) -> None:
    """Refuse a channel that decreases while the wire is heated."""
    channel, coordinate = settings.loop.channel, rig.plant.mechanism.coordinate
    if channel != coordinate and falls_when_heated(settings.system, settings.loop):
        raise InputError(
            f"{job.controller}: controller.channel: {channel} falls while the wire is heated, and no gain is negative: "
            f"control {coordinate}"
        )


def _exports(settings: ControllerFile, rig: Rig, evaluation: GainEvaluation) -> tuple[dict[str, bytes], dict[str, str]]:
    """Return C header and FMUs of plant and controller by file name, and the reasons for those that are missing."""
    loop = evaluation.loop
    units = (CHANNELS[settings.system.plant.drive.control].unit, CHANNELS[settings.loop.channel].unit)
    exports: dict[str, bytes] = {}
    left_out: dict[str, str] = {}
    for name, content in (
        ("controller.h", lambda: c_header(loop, units, __version__).encode()),
        ("plant.fmu", lambda: pack_fmu(plant_model(settings.system.plant, rig.name))),
        ("controller.fmu", lambda: pack_fmu(controller_model(loop, units, settings.units, settings.name))),
    ):
        try:
            exports[name] = content()
        except InputError as error:
            left_out[name] = str(error)
    return exports, left_out


def _optional_entries(
    settings: ControllerFile, tuned: GainEvaluation, identified: IdentifiedFeedforward | None
) -> dict[str, Any]:
    """Return entries of tune.json that only some controllers have: feedforward, pulses, instruments of the filter."""
    entries: dict[str, Any] = {}
    if identified is not None:
        entries["feedforward"] = feedforward_entry(settings, identified)
    if settings.system.carrier is not None:
        gains = {name: float(gain(tuned.loop, name)) for name in settings.bounds}
        mean = evaluate_gains(replace(settings, system=settings.system.without_carrier()), gains)
        rmse = finite_or_none(mean.metrics["rmse"])
        entries["pulses"] = {"carrier": settings.system.carrier, "rmse_of_mean": rmse}
    if tuned.loop.use_estimate and tuned.loop.instruments is not None:
        entries["believes"] = sorted(tuned.loop.instruments.sensors)
    return entries


def _write_results(
    folder: Path,
    inputs: _Inputs,
    settings: ControllerFile,
    tuned_loop: TunedLoop,
    exports: Mapping[str, bytes],
    document: Mapping[str, Any],
    run: Mapping[str, Any],
) -> None:
    """Write the files of the result folder."""
    (folder / "rig.toml").write_text(inputs.rig_text, "utf-8", newline="")
    (folder / "controller.toml").write_text(inputs.controller_text, "utf-8", newline="")
    (folder / "tune.json").write_text(to_json(document), "utf-8")
    controller = ControllerDocument.check(controller_document(tuned_loop.tuned.loop, dict(settings.units)))
    (folder / "controller.json").write_text(to_json(controller), "utf-8")
    for name, content in exports.items():
        (folder / name).write_bytes(content)
    evaluations = (("start gains", tuned_loop.start), ("tuned gains", tuned_loop.tuned))
    series = [_series(settings, evaluation, name) for name, evaluation in evaluations]
    prediction.write_predictions(folder / "prediction.csv", series)
    page = tuning_page(document, prediction.read_predictions(folder / "prediction.csv"), run, inputs.rig_text)
    (folder / "report.html").write_text(page, "utf-8")


def _series(settings: ControllerFile, evaluation: GainEvaluation, name: str) -> prediction.Series:
    control, channel = settings.system.plant.drive.control, settings.loop.channel
    reference = np.asarray(settings.scenario.reference)
    time = settings.system.period * np.arange(len(reference), dtype=np.float64)
    names = [channel, *wire_channels(settings, "temperature"), *wire_channels(settings, "stress")]
    model = {c: evaluation.channels[c] for c in dict.fromkeys(names)}
    model |= {c: evaluation.command[:, i] for i, c in enumerate(wire_channels(settings, control))}
    return prediction.make_series(name, name.split()[0], time, {channel: reference}, model, {}, has_clock=True)
