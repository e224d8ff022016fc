"""Fit the free parameters of a rig to recordings, and predict others."""

import contextlib
import dataclasses
import math
import sys
from collections.abc import Mapping, Sequence
from functools import partial
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from smajax import parameters
from smajax.api.bench import bench_entries, rig_findings, with_free_offsets
from smajax.api.parameter_set import parameter_set
from smajax.api.run_record import Clock, run_record
from smajax.api.sources import RigSource, as_rig, recording_sources, rig_text, with_start
from smajax.api.split import fit_sources
from smajax.api.study import FileContent, Study, interval_of
from smajax.arguments import MAX_STARTS, as_names, seed_or_default, whole_number
from smajax.errors import Cancelled, InputError, NumericsError
from smajax.files.fit_settings import FitSettings, read_input_noise
from smajax.files.rig_file import Rig
from smajax.files.train_and_holdout import read_train_and_holdout
from smajax.fitting.bench_checks import BenchFinding, residual_findings
from smajax.fitting.fit import MAX_STEPS
from smajax.fitting.fit import fit as fit_plant
from smajax.fitting.fit_quality import unusable_reason
from smajax.fitting.fit_warnings import copied_holdout_warnings, fit_warnings
from smajax.fitting.levenberg_marquardt import SolverStatus
from smajax.fitting.preparation import compile_in_background
from smajax.fitting.profile import profile_labels, profile_likelihood
from smajax.fitting.responses import start_responses
from smajax.fitting.result import FitResult, Response
from smajax.progress import ProgressCallback, Reporter
from smajax.recordings.recording import Recording
from smajax.report.fit_document import failed_document, fit_document
from smajax.report.prediction import Series, modelled_channels, recording_series
from smajax.simulation.status import SimulationStatus


class Parameter(NamedTuple):
    """A parameter after a fit.

    Attributes:
        value: Estimate, in ``unit``.
        interval: Lower and upper end of the 95 % interval; ``None`` at a bound, and where the data do not determine it.
        unit: Unit.
        at_bound: Whether it is at a bound beyond which the cost falls further.
        bounds: Lower and upper bound.
    """

    value: float
    interval: tuple[float, float] | None
    unit: str
    at_bound: bool
    bounds: tuple[float | None, float | None]


@dataclasses.dataclass(frozen=True, eq=False, repr=False, kw_only=True)
class FitStudy(Study):
    """Result of a fit.

    Attributes:
        result: Estimates, covariance and responses as arrays; ``None`` for a loaded study and a fit that failed.
    """

    command = "fit"
    document_name = "fit.json"

    result: FitResult | None = None

    @property
    def parameters(self) -> dict[str, Parameter]:
        """Parameters by name, followed by ``@recording`` where each recording has its own."""
        return {name: _parameter(entry) for name, entry in self.document["parameters"].items()}

    @property
    def rmse(self) -> dict[str, dict[str, Any]]:
        """RMSE by channel: ``train``, ``holdout`` and their ``unit``."""
        return {channel: dict(entry) for channel, entry in self.document["rmse"].items()}

    @property
    def rig(self) -> Rig:
        """The rig with the estimates.

        Raises:
            InputError: If the estimates fail the checks of a rig file, so that there is no such rig.
        """
        return self._rig("rig-fitted.toml")


def fit(
    rig: RigSource,
    train: Any,
    *,
    holdout: Any = None,
    start: str | Path | None = None,
    seed: int | None = None,
    starts: int | None = None,
    input_noise: str | float | None = None,
    max_steps: int = MAX_STEPS,
    profile: Sequence[str] = (),
    solver: Any = None,
    auto: bool = False,
    split: bool = False,
    drop_bad_rows: bool = False,
    progress: ProgressCallback | None = None,
) -> FitStudy:
    """Fit the free parameters of a rig to recordings, with intervals, and predict others.

    Args:
        rig: The rig, its file, or a dictionary with its sections; ``[fit]`` says what is free and observed.
        train: Recordings to fit: one or a list, each a path, a table in memory, or a ``Recording``.
        holdout: Recordings to predict, given likewise; none by default.
        start: Parameter set to start from, such as the fit.toml of an earlier fit.
        seed: Seed of the starting points; that of the rig by default.
        starts: Number of starting points; that of the rig by default.
        input_noise: Noise of the inputs' meter: ``"1 mA"``, ``"none"``, or ``"estimated"``; the rig's by default.
        max_steps: Most steps of the search from each start.
        profile: Parameters whose profile likelihood is computed.
        solver: Any optimistix least-squares solver; by default a bounded Levenberg-Marquardt method.
        auto: Whether an offset that the recordings show is fitted, too.
        split: Whether the last quarter of the only recording is its holdout.
        drop_bad_rows: Whether to omit rows that cannot be read.
        progress: Function that gets a ``ProgressEvent`` at each step; ``StopIteration`` stops the fit.

    Returns:
        The study. Failed numerics, and a fit that explains nothing, do not raise; ``success`` is then false.

    Raises:
        InputError: If a file or an argument is not valid.
        Cancelled: If the callback stopped the fit before its first step had ended.
    """
    clock, reporter = Clock(), Reporter(progress)
    reporter.phase("reading")
    with clock.time("read"):
        rig, options = as_rig(rig), (start, (seed, starts, max_steps, input_noise), profile, drop_bad_rows)
        sources = fit_sources(rig, train, holdout, split, drop_bad_rows)
        inputs = _with_findings(_read_inputs(rig, *sources, *options), auto, reporter, solver)
    inputs, search, failure = _search_with_offsets(inputs, auto, (solver, max_steps, reporter, clock))
    reporter.finish("writing the report")
    document, responses = _evaluate(inputs, search, failure)
    code, reason = _outcome(search, responses, _why_no_minimum(search.result, solver) or failure)
    return FitStudy(
        document=document,
        series=tuple(_to_series(inputs.rig, response) for response in responses),
        run=run_record("fit", inputs.rig.name, clock, inputs.settings.seed, code) | _ending(document),
        files=_files(inputs, search.result),
        reason=reason,
        result=search.result,
    )


def _ending(document: Mapping[str, Any]) -> dict[str, Any]:
    return {key: document["solver"][key] for key in ("code", "text")}


def _outcome(search: "_Search", responses: Sequence[Response], failure: str) -> tuple[int, str]:
    """Exit code, and why the fit did not succeed; ``failure`` says why its end is none."""
    failed = [
        f"{r.recording.name}: {r.status.name}: {r.status.hint}"
        for r in responses
        if r.status is not SimulationStatus.done
    ]
    reason = search.reason or "; ".join(failed) or failure
    if search.interrupted:
        return Cancelled.exit_code, reason or "interrupted with the best point so far"
    return (NumericsError.exit_code if reason or search.result is None else 0), reason


def _why_no_minimum(result: FitResult | None, solver: Any) -> str:
    """Why a result is no minimum, in words; empty if it is one, or the default solver needs more steps."""
    codes = {SolverStatus.diverged, SolverStatus.not_stationary, *((SolverStatus.steps,) if solver else ())}
    return result.status.text if result is not None and result.status in codes else ""


def _options(rig: Rig, seed: Any, starts: Any, max_steps: Any, input_noise: Any) -> dict[str, int | float | None]:
    """Settings of a fit that arguments replace, after a check of them and of the number of steps."""
    whole_number("fit", "max_steps", max_steps, 1, sys.maxsize)
    options: dict[str, int | float | None] = {"seed": seed_or_default("fit", seed, rig.fit.seed)}
    if input_noise is not None:
        options["input_noise"] = read_input_noise(input_noise, rig.plant.drive.control, "fit: input_noise")
    return options if starts is None else options | {"starts": whole_number("fit", "starts", starts, 1, MAX_STARTS)}


class _FitInputs(NamedTuple):
    """Input of a fit: rig, text of its file, settings, recordings with roles, labels to profile, warnings, findings."""

    rig: Rig
    text: str
    settings: FitSettings
    recordings: list[tuple[Recording, str]]
    labels: list[str]
    warnings: list[str]
    findings: Sequence[BenchFinding] = ()
    bench: Sequence[Mapping[str, Any]] = ()

    def with_role(self, role: str) -> list[Recording]:
        """Return the recordings with a role."""
        return [recording for recording, recording_role in self.recordings if recording_role == role]


class _Search(NamedTuple):
    """Outcome of a search: its result, or the reason why there is none; profiles; whether it was interrupted."""

    result: FitResult | None
    reason: str
    profiles: dict[str, Any]
    interrupted: bool


def _read_inputs(
    rig: Rig,
    train: Any,
    holdout: Any,
    start: str | Path | None,
    options: tuple[Any, Any, Any, Any],
    profile: Sequence[str],
    drop_bad_rows: bool,
) -> _FitInputs:
    warnings, text = list(rig.notes), rig_text(rig)
    rig = with_start(rig, start)
    settings: Any = dataclasses.replace(rig.fit, **_options(rig, *options))
    holdout = () if holdout is None else holdout
    if not recording_sources("train", train):
        raise InputError("fit: train has no recording: give at least one")
    recording_sources("holdout", holdout)
    recordings = read_train_and_holdout(rig, train, holdout, drop_bad_rows)
    labels = profile_labels(
        as_names("fit", "profile", profile), settings, [r.name for r, role in recordings if role == "train"]
    )
    return _FitInputs(rig, text, settings, recordings, labels, warnings)


def _with_findings(inputs: _FitInputs, auto: bool, reporter: Reporter, solver: Any) -> _FitInputs:
    """Add what the recordings show about their bench, and with ``auto`` the offsets among it as free parameters.

    Meanwhile the default search is compiled.
    """
    if solver is None:
        settings: Any = inputs.settings  # frozen, and the protocol of ``fit`` has plain attributes
        compile_in_background(inputs.rig.plant, inputs.with_role("train"), settings, inputs.rig.interpolation)
    findings = rig_findings(inputs.rig, [recording for recording, _ in inputs.recordings])
    return _add_findings(inputs, findings, auto, reporter)


def _add_findings(inputs: _FitInputs, findings: Sequence[BenchFinding], auto: bool, reporter: Reporter) -> _FitInputs:
    """Report and add findings, and with ``auto`` the offsets of training recordings as free parameters."""
    train = [recording.name for recording in inputs.with_role("train")]
    bench = bench_entries(findings, train if auto else None)
    for entry in bench:
        reporter.phase(entry["text"])
    rig = with_free_offsets(inputs.rig, findings, train) if auto else inputs.rig
    if rig is not inputs.rig:
        changes = {"free": rig.fit.free, "per_recording": rig.fit.per_recording}
        settings: Any = dataclasses.replace(inputs.settings, **changes)
        inputs = inputs._replace(rig=rig, text=rig.to_toml(), settings=settings)
    return inputs._replace(findings=(*inputs.findings, *findings), bench=(*inputs.bench, *bench))


def _search_with_offsets(
    inputs: _FitInputs, auto: bool, options: tuple[Any, int, Reporter, Clock]
) -> tuple[_FitInputs, _Search, str]:
    """Fit; where only the residual shows an offset, say so, and with ``auto`` fit again with the offset free.

    Returns the inputs, the search, and why the fit is a failure (``_without_meaning``).
    """
    outcome, train = _search(inputs, *options), inputs.with_role("train")
    if (result := outcome.result) is not None and not outcome.interrupted:
        names, remedy = {recording.name for recording in train}, "which fit --auto (auto=True) does"
        known = {f.channel for f in inputs.findings if f.code == "offset" and names & {*f.recordings}}
        offsets = [offset for offset in result.offsets if offset.channel not in known]
        findings = residual_findings(train, offsets, result.noise_floor, remedy)
        inputs = _add_findings(inputs, findings, auto, options[2])
        outcome = _search(inputs, *options) if auto and findings else outcome
    return inputs, *_without_meaning(outcome, inputs, auto)


def _without_meaning(search: _Search, inputs: _FitInputs, auto: bool) -> tuple[_Search, str]:
    """Take the intervals from a fit that explains nothing; return why it is a failure, empty for any other."""
    if search.result is None:
        return search, ""
    train = {recording.name for recording in inputs.with_role("train")}
    open_findings = [f for f in inputs.findings if train & {*f.recordings} and not (auto and f.code == "offset")]
    failure = unusable_reason(search.result, open_findings)
    if not failure:
        return search, ""
    bare = tuple(dataclasses.replace(e, lower95=None, upper95=None) for e in search.result.estimates)
    return search._replace(result=dataclasses.replace(search.result, estimates=bare), profiles={}), failure


def _search(inputs: _FitInputs, solver: Any, max_steps: int, reporter: Reporter, clock: Clock) -> _Search:
    """Fit and profile, until the end or an interruption."""
    train = inputs.with_role("train")
    settings: Any = inputs.settings  # frozen, and the protocol of ``fit`` has plain attributes
    samples = sum(len(r) for r in train) * len(settings.observe)

    def report(step: int, cost: float) -> None:
        residual = f", residual {math.sqrt(cost / samples):.4g} x noise" if math.isfinite(cost) else ""
        reporter.step(f"fitting: step {step}{residual}", step)

    result, profiles, reason = None, {}, ""
    phase = "compiling the model and evaluating the starts (later runs with recordings of similar length reuse it)"
    with clock.time("fit"):
        try:
            reporter.phase(phase, can_stop=True)
            result = fit_plant(
                inputs.rig.plant,
                train,
                settings,
                holdout=inputs.with_role("holdout"),
                interpolation=inputs.rig.interpolation,
                max_steps=max_steps,
                solver=solver,
                progress=report,
            )
        except NumericsError as error:
            reason = str(error)
        except KeyboardInterrupt:
            if not reporter.stopped:
                raise
            raise Cancelled("the fit was cancelled before its first step had ended: there is no estimate") from None
    interrupted = reporter.stopped or (result is not None and result.status is SolverStatus.interrupted)
    with clock.time("profile"):
        if result is not None and not interrupted:
            interrupted = _add_profiles(result, inputs, profiles, reporter)
    return _Search(result, reason, profiles, interrupted)


def _add_profiles(result: FitResult, inputs: _FitInputs, profiles: dict[str, Any], reporter: Reporter) -> bool:
    """Add the profile likelihoods; return whether an interruption ended them."""
    for label in inputs.labels:
        text = f"profile likelihood of {label}"
        try:
            reporter.phase(text, can_stop=True)
            report = partial(_report_step, reporter, text)
            profiles[label] = profile_likelihood(result, label, progress=report)
        except InputError as error:  # the fit is valid without the profile
            inputs.warnings.append(f"{error}.")
        except (Cancelled, KeyboardInterrupt):
            return True
    return False


def _report_step(reporter: Reporter, text: str, step: int, cost: float) -> None:
    reporter.step(f"{text}: step {step}", step)


def _evaluate(inputs: _FitInputs, search: _Search, failure: str) -> tuple[dict[str, Any], list[Response]]:
    """Return the document of a fit and the responses of all recordings, with the start values if the fit failed."""
    rig, result, warnings = inputs.rig, search.result, list(inputs.warnings)
    settings: Any = inputs.settings
    train, holdout = inputs.with_role("train"), inputs.with_role("holdout")
    if result is None:
        warnings += copied_holdout_warnings(train, holdout)
        document = failed_document(
            rig, settings, inputs.recordings, search.reason, bench=inputs.bench, warnings=warnings
        )
        return document, start_responses(
            rig.plant, train, rig.fit.observe, holdout=holdout, interpolation=rig.interpolation
        )
    warnings += fit_warnings(result, rig.plant, train, settings)
    document = fit_document(
        result, rig, settings, profiles=search.profiles, bench=inputs.bench, failure=failure, warnings=warnings
    )
    return document, list(result.responses)


def _to_series(rig: Rig, response: Response) -> Series:
    recording = response.recording
    names = modelled_channels(rig.plant.observable, rig.plant.signals, recording.channels)
    model: dict[str, np.ndarray] = {c: response.model[c] for c in names if c in response.model}
    return recording_series(recording, response.role, model)


def _files(inputs: _FitInputs, result: FitResult | None) -> dict[str, FileContent]:
    """Return rig.toml, fit.toml and rig-fitted.toml; the last one is left out where it fails the checks of a rig."""
    files: dict[str, FileContent] = {"rig.toml": inputs.text.encode()}
    if result is None:
        return files
    files["fit.toml"] = parameter_set(result, inputs.with_role("train")).encode()
    with contextlib.suppress(InputError):
        names = result.problem.shared + result.problem.per_recording
        values = {name: float(parameters.get(result.plant, name)) for name in names}
        finite = {name: value for name, value in values.items() if math.isfinite(value)}
        files["rig-fitted.toml"] = inputs.rig.to_toml(finite).encode()
    return files


def _parameter(entry: Mapping[str, Any]) -> Parameter:
    """The parameter of an entry of fit.json."""
    return Parameter(entry["estimate"], interval_of(entry), entry["unit"], entry["at_bound"], tuple(entry["bounds"]))
