"""The job of ``smajax fit``."""

import contextlib
import dataclasses
import math
from collections.abc import Sequence
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from smajax import __version__, parameters
from smajax.console import INTERRUPTED, Progress, stopping
from smajax.dissipation import crossed
from smajax.errors import InputError, NumericsError, nearest
from smajax.fit.fit import Fit, fit, profile, respond
from smajax.fit.input_noise import moved
from smajax.fit_settings import FitSettings
from smajax.jobs.record import Clock, Outcome, rig_text, run_record
from smajax.parameter_file import Entry, read_parameters, write_parameters
from smajax.recording import Recording
from smajax.report import html, prediction
from smajax.report.document import failed_document, fit_document, to_json
from smajax.report.prediction import Series, modelled_channels, to_series
from smajax.results import check_out, write_folder
from smajax.rig import Rig, read_rig
from smajax.rig_schema import as_text
from smajax.simulate import Code


class FitJob(NamedTuple):
    """What a fit is asked to do; ``seed`` and ``starts`` replace the rig's where they are given."""

    rig: Path
    train: Sequence[Path]
    out: Path
    holdout: Sequence[Path] = ()
    start: Path | None = None
    seed: int | None = None
    starts: int | None = None
    drop_bad_rows: bool = False
    profiles: Sequence[str] = ()


def run_fit(job: FitJob, progress: Progress, argv: Sequence[str]) -> Outcome:
    """Reads, fits, predicts the holdout, and writes the folder. Raises InputError; a failure of the numbers is an outcome."""
    out, clock = check_out(job.out), Clock()
    progress.phase("reading")
    with clock.time("read"):
        rig, text, settings, recordings, labels, warnings = _read_for_fit(job)
    trained = [r for r, role in recordings if role == "train"]
    held = [r for r, role in recordings if role == "holdout"]
    samples = sum(len(r) for r in trained) * len(settings.observe)

    def report(step: int, cost: float) -> None:
        reached = f", residual {math.sqrt(cost / samples):.4g} x noise" if math.isfinite(cost) else ""
        progress.step(f"fitting: step {step}{reached}")
        if stop.requested:
            raise KeyboardInterrupt

    result, profiles, reason = None, {}, ""
    progress.phase("compiling the model and trying the starts (a later run on recordings of this size finds it compiled)")
    with clock.time("fit"), stopping(progress) as stop:
        try:
            given: Any = settings
            result = fit(rig.plant, trained, given, holdout=held, interpolation=rig.interpolation, progress=report)
        except NumericsError as error:
            reason = str(error)
        if result is not None and not math.isfinite(result.cost):
            raise KeyboardInterrupt
    with clock.time("profile"), stopping(progress) as stop_profiles:
        for label in labels:
            if result is not None and not stop.requested and not stop_profiles.requested:
                progress.phase(f"profile likelihood of {label}")
                _profile(result, label, profiles, warnings)
    stopped = stop.requested or stop_profiles.requested
    progress.phase("writing the report")
    if result is None:
        document = failed_document(rig, settings, recordings, reason, warnings=warnings)
        responses, _ = respond(
            [rig.plant] * len(recordings),
            [r for r, _ in recordings],
            [role for _, role in recordings],
            rig.fit.observe,
            rig.interpolation,
            None,
        )
    else:
        warnings += moved(result, rig.plant, trained, given)
        warnings += crossed(result.plant, [{**r.recording.channels, **r.model} for r in result.responses])
        document = fit_document(result, rig, settings, profiles=profiles, warnings=warnings)
        responses = list(result.responses)
    failed = [f"{r.recording.name}: {r.code.name}: {r.code.cure}" for r in responses if r.code is not Code.done]
    series = [_series(rig, r.recording, r.role, r.model) for r in responses]
    code = INTERRUPTED if stopped else NumericsError.exit_code if failed or result is None else 0
    ended = {key: document["solver"][key] for key in ("code", "text")}
    run = run_record("fit", rig, argv, clock, settings.seed, code) | ended

    def fill(folder: Path) -> None:
        (folder / "rig.toml").write_text(text, "utf-8", newline="")
        (folder / "fit.json").write_text(to_json(document), "utf-8")
        prediction.write(folder / "prediction.csv", series)
        if result is not None:
            _write_parameters(folder / "fit.toml", result, trained)
            with contextlib.suppress(InputError):  # values that make no rig, such as a band that has closed, are in fit.toml all the same
                names = result.problem.shared + result.problem.own
                rig.write(folder / "rig-fitted.toml", {n: float(parameters.get(result.plant, n)) for n in names if _known(result.plant, n)})
        # From the table as it was written, so that `smajax report` makes the same page of it.
        page = html.fit_page(document, prediction.read(folder / "prediction.csv"), run, text)
        (folder / "report.html").write_text(page, "utf-8")

    write_folder(out, run, fill)
    return Outcome(out, document, code, "" if not code else reason or "; ".join(failed) or "interrupted; the best point so far is kept")


class _Read(NamedTuple):
    """What a fit works on: the rig with its text, the settings, recordings with roles, labels to profile, and what to warn of."""

    rig: Rig
    text: str
    settings: FitSettings
    recordings: list[tuple[Recording, str]]
    labels: list[str]
    warnings: list[str]


def _read_for_fit(job: FitJob) -> _Read:
    rig = read_rig(job.rig)
    warnings = list(rig.notes)
    if job.start is not None:
        rig = dataclasses.replace(rig, plant=started(rig, job.start))
    replaced = {key: value for key, value in (("seed", job.seed), ("starts", job.starts)) if value is not None}
    settings = dataclasses.replace(rig.fit, **replaced)
    recordings = read_recordings(rig, job.train, job.holdout, job.drop_bad_rows)
    labels = _labels(job.profiles, settings, [r.name for r, role in recordings if role == "train"])
    fitted = {r.sha256: r.name for r, role in recordings if role == "train"}
    tested = [r for r, role in recordings if role == "holdout"]
    warnings += [f"{r.name} has the same content as {fitted[r.sha256]}: it tests nothing." for r in tested if r.sha256 in fitted]
    return _Read(rig, rig_text(job.rig), settings, recordings, labels, warnings)


def _labels(names: Sequence[str], settings: FitSettings, trained: Sequence[str]) -> list[str]:
    """The labels of the parameters to profile; the bare name of one that each recording has for itself stands for all of these."""
    own = {*settings.per_recording, *(f"initial.{state}" for state in settings.initial)}
    found = {name: [f"{name}@{r}" for r in trained] if name in own else [name] for name in settings.names}
    found |= {label: [label] for labels in list(found.values()) for label in labels}
    for name in names:
        if name not in found:
            free = ", ".join(settings.names)
            raise InputError(f"--profile {name}: this parameter is not free{nearest(name, settings.names)}: free are {free}")
    return [label for name in names for label in found[name]]


def _profile(result: Fit, label: str, profiles: dict[str, Any], warnings: list[str]) -> None:
    """Adds a profile; one that cannot be drawn is no reason to lose the fit."""
    try:
        profiles[label] = profile(result, label)
    except InputError as error:
        warnings.append(f"{error}.")


def read_recordings(rig: Rig, train: Sequence[Path], holdout: Sequence[Path], drop_bad_rows: bool) -> list[tuple[Recording, str]]:
    """The recordings with their roles, under names that tell them apart. InputError if one is given twice."""
    paths = [*train, *holdout]
    places = [path.resolve() for path in paths]
    for k, place in enumerate(places):
        if place in places[:k]:
            raise InputError(f"{paths[k]}: this recording is given twice: name each one once")
    read = [rig.read(path, drop_bad_rows=drop_bad_rows) for path in paths]
    clocks = {r.has_clock for r in read}
    if len(clocks) > 1:
        odd = next(r.name for r in read if not r.has_clock)
        raise InputError(f"{odd}: this recording has no time and the others do: give it a time column, or fit it on its own")
    named = [dataclasses.replace(r, name=name) for r, name in zip(read, _telling(places), strict=True)]
    return [(r, "train" if k < len(train) else "holdout") for k, r in enumerate(named)]


def _telling(places: Sequence[Path]) -> list[str]:
    """File names, with as many folders before them as it takes to tell them apart."""
    depth = 1
    while depth < 64:
        names = ["/".join(place.parts[-depth:]) for place in places]
        if len(set(names)) == len(names):
            return names
        depth += 1
    return [str(place) for place in places]


_STRETCH, _COPIED = 20, 0.5  # rows that are compared together, and the share of them that makes a copy


def refuse_copies(recordings: Sequence[Recording]) -> None:
    """InputError if a recording has the content, or most of the rows, of one before it: then it tests nothing."""
    for k, one in enumerate(recordings):
        for other in recordings[:k]:
            what = "has the same content as" if one.sha256 == other.sha256 else "has rows of" if _shared_rows(one, other) > _COPIED else ""
            if what:
                raise InputError(f"{one.name} {what} {other.name}: it tests nothing; give another recording, of another input")


def _shared_rows(one: Recording, other: Recording) -> float:
    """The share of a recording's stretches, those in which nothing changes left aside, that are in another one, too, value by value."""
    names = [c for c in one.channels if c in other.channels]
    mine, theirs = (np.column_stack([r.channels[c] for c in names]) for r in (one, other))
    known = {theirs[k : k + _STRETCH].tobytes() for k in range(len(theirs) - _STRETCH + 1)}
    stretches = [mine[k : k + _STRETCH] for k in range(0, len(mine) - _STRETCH + 1, _STRETCH)]
    moving = [s.tobytes() in known for s in stretches if np.ptp(s, axis=0).any()]
    return float(np.mean(moving)) if moving else 0.0


def started(rig: Rig, path: Path) -> Any:
    """The rig's plant with the values of a parameter file that it has a place for; of values per recording, their mean."""
    known = parameters.declared(rig.plant)
    values: dict[str, list[float]] = {}
    for label, entry in read_parameters(path).items():
        name = label.partition("@")[0]
        if name in known and known[name].unit == entry.unit:
            values.setdefault(name, []).append(entry.value)
    if not values:
        raise InputError(f"{path}: none of its parameters belongs to this rig: name the fit.toml of a fit of the same kind")
    start = {name: float(np.mean(found)) for name, found in values.items()}
    for name, value in start.items():
        low, high = rig.fit.bounds.get(name, (known[name].lower, known[name].upper))
        if not low <= value <= high:
            shown = as_text(value, known[name].unit)
            raise InputError(f"{path}: {name} = {shown} is outside of its bounds in {rig.name}: widen these under [fit] bounds")
    return parameters.replace(rig.plant, start)


def _series(rig: Rig, recording: Recording, role: str, model: dict[str, np.ndarray]) -> Series:
    chosen = modelled_channels(rig.plant.observable, rig.plant.signals, recording.channels)
    shown = {c: model[c] for c in chosen if c in model}
    return to_series(recording.name, role, recording.time, recording.channels, shown, recording.units, clock=recording.has_clock)


def _write_parameters(path: Path, result: Fit, trained: Sequence[Recording]) -> None:
    source = "fit to " + ", ".join(f"{r.name} (sha256 {r.sha256})" for r in trained)
    entries = {}
    for e in result.estimates:
        low, high = e.bounds
        known = e.lower95 is not None and e.upper95 is not None
        entries[e.name] = Entry(
            value=min(max(e.estimate, low), high),
            unit=e.unit,
            lower=low,
            upper=high,
            source=source,
            interval95=(e.lower95, e.upper95) if known else None,  # pyright: ignore[reportArgumentType]
            free=True,
            at_bound=e.at_bound,
        )
    about = {"smajax": __version__, "result": result.stop.name, "seed": result.seed, "recordings": [r.name for r in trained]}
    write_parameters(path, entries, {"title": "parameters estimated by smajax fit", "fit": about})


def _known(plant: Any, name: str) -> bool:
    return math.isfinite(float(parameters.get(plant, name)))
