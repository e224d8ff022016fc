"""Job of ``smajax fit``: fit the free parameters and predict the holdout recordings."""

import contextlib
import dataclasses
import math
from collections.abc import Sequence
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from smajax import __version__, parameters
from smajax.app.console import INTERRUPTED, stopping
from smajax.app.run_record import Clock, Outcome, read_rig_text, run_record
from smajax.errors import InputError, NumericsError, suggestion
from smajax.files.documents import to_json
from smajax.files.fit_settings import FitSettings
from smajax.files.parameter_sets import Entry, write_parameters
from smajax.files.result_folder import check_output_folder, write_folder
from smajax.files.rig_file import Rig, read_rig
from smajax.files.train_and_holdout import read_train_and_holdout
from smajax.files.warm_start import warm_start_plant
from smajax.fitting.fit import fit
from smajax.fitting.input_noise import input_noise_warnings
from smajax.fitting.profile import profile_likelihood
from smajax.fitting.responses import simulate_responses
from smajax.fitting.result import FitResult, Response
from smajax.plant.materials.dissipation import check_dissipation
from smajax.progress import Progress
from smajax.recordings.recording import Recording
from smajax.report import prediction
from smajax.report.fit_document import failed_document, fit_document
from smajax.report.prediction import Series, modelled_channels, recording_series
from smajax.report.run_pages import fit_page
from smajax.simulation.status import SimulationStatus


class FitJob(NamedTuple):
    """Files and options of a fit.

    Attributes:
        rig: The rig file.
        train: Recordings to fit.
        out: The result folder.
        holdout: Recordings to predict.
        start: Parameter set to start from.
        seed: Seed of the starting points, which replaces that of the rig file.
        starts: Number of starting points, which replaces that of the rig file.
        drop_bad_rows: Whether to omit rows that cannot be read.
        profiles: Parameters to profile.
    """

    rig: Path
    train: Sequence[Path]
    out: Path
    holdout: Sequence[Path] = ()
    start: Path | None = None
    seed: int | None = None
    starts: int | None = None
    drop_bad_rows: bool = False
    profiles: Sequence[str] = ()


class _FitInputs(NamedTuple):
    """Input of a fit: rig, text of its file, settings, recordings with roles, labels to profile, warnings."""

    rig: Rig
    text: str
    settings: FitSettings
    recordings: list[tuple[Recording, str]]
    labels: list[str]
    warnings: list[str]

    def with_role(self, role: str) -> list[Recording]:
        """Return the recordings with a role."""
        return [recording for recording, recording_role in self.recordings if recording_role == role]


class _Search(NamedTuple):
    """Outcome of a search: its result, or the reason why there is none; profiles; whether it was interrupted."""

    result: FitResult | None
    reason: str
    profiles: dict[str, Any]
    interrupted: bool


def run_fit(job: FitJob, progress: Progress, argv: Sequence[str]) -> Outcome:
    """Fit, predict the holdout, and write the result folder.

    Args:
        job: Files and options.
        progress: Display of the phases and steps.
        argv: The command line, for the record of the run.

    Returns:
        The outcome; a failure of the numerics does not raise, but has an exit code.

    Raises:
        InputError: If a file, an option or the folder is not valid.
    """
    out, clock = check_output_folder(job.out), Clock()
    progress.phase("reading")
    with clock.time("read"):
        inputs = _read_inputs(job)
    search = _search(inputs, progress, clock)
    progress.phase("writing the report")
    document, responses = _evaluate(inputs, search)
    failed = [
        f"{r.recording.name}: {r.status.name}: {r.status.hint}"
        for r in responses
        if r.status is not SimulationStatus.done
    ]
    failure = NumericsError.exit_code if failed or search.result is None else 0
    code = INTERRUPTED if search.interrupted else failure
    reason = search.reason or "; ".join(failed) or "interrupted with the best point so far"
    solver = {key: document["solver"][key] for key in ("code", "text")}
    run = run_record("fit", inputs.rig, argv, clock, inputs.settings.seed, code) | solver
    series = [_to_series(inputs.rig, response) for response in responses]

    def fill(folder: Path) -> None:
        (folder / "rig.toml").write_text(inputs.text, "utf-8", newline="")
        (folder / "fit.json").write_text(to_json(document), "utf-8")
        prediction.write_predictions(folder / "prediction.csv", series)
        if search.result is not None:
            _write_parameters(folder / "fit.toml", search.result, inputs.with_role("train"))
            _write_fitted_rig(folder / "rig-fitted.toml", inputs.rig, search.result)
        # The table is read back, so that `smajax report` makes the same page.
        page = fit_page(document, prediction.read_predictions(folder / "prediction.csv"), run, inputs.text)
        (folder / "report.html").write_text(page, "utf-8")

    write_folder(out, run, fill)
    return Outcome(out, document, code, reason if code else "")


def _read_inputs(job: FitJob) -> _FitInputs:
    rig = read_rig(job.rig)
    warnings = list(rig.notes)
    if job.start is not None:
        rig = dataclasses.replace(rig, plant=warm_start_plant(rig, job.start))
    options = {key: value for key, value in (("seed", job.seed), ("starts", job.starts)) if value is not None}
    settings = dataclasses.replace(rig.fit, **options)
    recordings = read_train_and_holdout(rig, job.train, job.holdout, job.drop_bad_rows)
    labels = _profile_labels(job.profiles, settings, [r.name for r, role in recordings if role == "train"])
    train_names = {r.sha256: r.name for r, role in recordings if role == "train"}
    warnings += [
        f"{r.name} has the same content as {train_names[r.sha256]}: it is not an independent test."
        for r, role in recordings
        if role == "holdout" and r.sha256 in train_names
    ]
    return _FitInputs(rig, read_rig_text(job.rig), settings, recordings, labels, warnings)


def _profile_labels(names: Sequence[str], settings: FitSettings, train_names: Sequence[str]) -> list[str]:
    """Return the labels to profile; a parameter per recording has one for each recording."""
    per_recording = {*settings.per_recording, *(f"initial.{state}" for state in settings.initial)}
    labels_of = {
        name: [f"{name}@{r}" for r in train_names] if name in per_recording else [name] for name in settings.names
    }
    labels_of |= {label: [label] for labels in list(labels_of.values()) for label in labels}
    for name in names:
        if name not in labels_of:
            free = ", ".join(settings.names)
            hint = suggestion(name, settings.names)
            raise InputError(f"--profile {name}: this parameter is not free{hint}: the free ones are {free}")
    return [label for name in names for label in labels_of[name]]


def _search(inputs: _FitInputs, progress: Progress, clock: Clock) -> _Search:
    """Fit and profile, until the end or an interruption."""
    train = inputs.with_role("train")
    settings: Any = inputs.settings  # frozen, and the protocol of ``fit`` has plain attributes
    samples = sum(len(r) for r in train) * len(settings.observe)

    def report(step: int, cost: float) -> None:
        residual = f", residual {math.sqrt(cost / samples):.4g} x noise" if math.isfinite(cost) else ""
        progress.step(f"fitting: step {step}{residual}")
        if stop.requested:
            raise KeyboardInterrupt

    result, profiles, reason = None, {}, ""
    progress.phase("compiling the model and evaluating the starts (later runs with recordings of this size reuse it)")
    with clock.time("fit"), stopping(progress) as stop:
        try:
            result = fit(
                inputs.rig.plant,
                train,
                settings,
                holdout=inputs.with_role("holdout"),
                interpolation=inputs.rig.interpolation,
                progress=report,
            )
        except NumericsError as error:
            reason = str(error)
        if result is not None and not math.isfinite(result.cost):
            raise KeyboardInterrupt
    with clock.time("profile"), stopping(progress) as stop_profiles:
        for label in inputs.labels:
            if result is not None and not stop.requested and not stop_profiles.requested:
                progress.phase(f"profile likelihood of {label}")
                try:
                    profiles[label] = profile_likelihood(result, label)
                except InputError as error:  # the fit is valid without the profile
                    inputs.warnings.append(f"{error}.")
    return _Search(result, reason, profiles, stop.requested or stop_profiles.requested)


def _evaluate(inputs: _FitInputs, search: _Search) -> tuple[dict[str, Any], list[Response]]:
    """Return the document of a fit and the responses of all recordings, with the start values if the fit failed."""
    rig, result, warnings = inputs.rig, search.result, list(inputs.warnings)
    settings: Any = inputs.settings
    if result is None:
        document = failed_document(rig, settings, inputs.recordings, search.reason, warnings=warnings)
        responses, _ = simulate_responses(
            [rig.plant] * len(inputs.recordings),
            [recording for recording, _ in inputs.recordings],
            [role for _, role in inputs.recordings],
            rig.fit.observe,
            rig.interpolation,
            None,
        )
        return document, responses
    warnings += input_noise_warnings(result, rig.plant, inputs.with_role("train"), settings)
    warnings += check_dissipation(result.plant, [{**r.recording.channels, **r.model} for r in result.responses])
    document = fit_document(result, rig, settings, profiles=search.profiles, warnings=warnings)
    return document, list(result.responses)


def _to_series(rig: Rig, response: Response) -> Series:
    recording = response.recording
    names = modelled_channels(rig.plant.observable, rig.plant.signals, recording.channels)
    model: dict[str, np.ndarray] = {c: response.model[c] for c in names if c in response.model}
    return recording_series(recording, response.role, model)


def _write_parameters(path: Path, result: FitResult, train: Sequence[Recording]) -> None:
    """Write fit.toml: the estimates with intervals, bounds and source."""
    source = "fit to " + ", ".join(f"{r.name} (sha256 {r.sha256})" for r in train)
    entries = {}
    for estimate in result.estimates:
        low, high = estimate.bounds
        lower95, upper95 = estimate.lower95, estimate.upper95
        entries[estimate.name] = Entry(
            value=min(max(estimate.estimate, low), high),
            unit=estimate.unit,
            lower=low,
            upper=high,
            source=source,
            interval95=(lower95, upper95) if lower95 is not None and upper95 is not None else None,
            free=True,
            at_bound=estimate.at_bound,
        )
    fit_table = {
        "smajax": __version__,
        "result": result.status.name,
        "seed": result.seed,
        "recordings": [r.name for r in train],
    }
    write_parameters(path, entries, {"title": "parameters estimated by smajax fit", "fit": fit_table})


def _write_fitted_rig(path: Path, rig: Rig, result: FitResult) -> None:
    """Write the rig with the estimates, unless these fail the checks of a rig file; fit.toml has them in any case."""
    with contextlib.suppress(InputError):
        names = result.problem.shared + result.problem.per_recording
        values = {name: float(parameters.get(result.plant, name)) for name in names}
        rig.write(path, {name: value for name, value in values.items() if math.isfinite(value)})
