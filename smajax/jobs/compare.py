"""The job of ``smajax compare``: several models fitted to one recording, and what each predicts of another.

Material laws are fitted as the rig says, with the rig's law replaced: what both laws call the same keeps its value and stays free if it
was, and what only the new one has starts where ``_OWN`` says. Input-output laws see one input channel and the first observed channel; those
that go row by row see both recordings at the training recording's median step, and are scored at the rows that were recorded.
"""

import dataclasses
import math
import time
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any, NamedTuple, cast

import equinox as eqx
import numpy as np

from smajax import __version__, parameters
from smajax.console import Progress
from smajax.errors import InputError, NumericsError, nearest
from smajax.fit.families import FAMILIES
from smajax.fit.fit import fit
from smajax.fit.operator_problem import Family, Series, check_rows, evenly
from smajax.fit.operators import fit_operator
from smajax.jobs.fit import read_recordings, refuse_copies
from smajax.jobs.record import Clock, Outcome, rig_text, run_record
from smajax.parameters import declarations
from smajax.recording import Recording
from smajax.report import prediction
from smajax.report.comparison import SCHEMA, comparison_page, summary
from smajax.report.document import difference_unit, estimate_entry, number, recording_entry, to_json
from smajax.report.summary import undetermined
from smajax.results import check_out, write_folder
from smajax.rig import Rig, read_rig
from smajax.rig_schema import MATERIALS, as_text, channel_unit
from smajax.simulate import Code
from smajax.units import numbered

TRANSFER = tuple(name for name in FAMILIES if name.startswith("transfer-function-"))
MODELS = (*MATERIALS, *FAMILIES)
# Start values of what one law has and another may not; those of the first set are fitted, too.
_OWN = {
    "lagoudas": ({"n1": 0.5, "n2": 0.5, "n3": 0.5, "n4": 0.5}, {}),
    "brinson": ({}, {"detwinning_start_stress": 0.0, "detwinning_finish_stress": 1e8}),
}
_STARTS, _STARTS_OF_NETWORKS = 16, 4
_ABOUT_A_LEVEL, _BESIDE = 0.05, 0.01  # of an input's level, and of the range of another of its kind: what moves by less is held still
_TOGETHER = 0.02  # share of the rows at which wires that pull by turns may both be on
_HUGE = 1e100  # its square would be no number
_FURTHER = 0.05  # of the input's range: what a holdout goes beyond it


class CompareJob(NamedTuple):
    """What a comparison is asked to do; ``seed`` replaces the rig's where it is given."""

    rig: Path
    train: Path
    holdout: Path
    models: Sequence[str]
    out: Path
    seed: int | None = None
    drop_bad_rows: bool = False


@dataclasses.dataclass(frozen=True)
class Compared:
    """One model's answer: number of free parameters, predictions of both recordings (SI), s of wall; or why there is none.

    ``asks_too_much`` tells whether that is for what it was given. ``note`` says what was done to the recordings for it, ``at_bound`` which
    parameters ended at a bound, and where, ``undetermined`` which ones the training recording does not tell.
    """

    name: str
    kind: str
    parameters: int = 0
    predictions: tuple[np.ndarray, ...] = ()
    wall: float = 0.0
    why: str = ""
    note: str = ""
    asks_too_much: bool = False
    at_bound: tuple[str, ...] = ()
    undetermined: tuple[str, ...] = ()
    fitted: Mapping[str, Mapping[str, Any]] = dataclasses.field(default_factory=dict)


def run_compare(job: CompareJob, progress: Progress, argv: Sequence[str]) -> Outcome:
    """Reads, fits each model, predicts the holdout and writes the folder. Raises InputError; NumericsError if none can be fitted."""
    out, clock = check_out(job.out), Clock()
    names = _names(job.models)
    progress.phase("reading")
    with clock.time("read"):
        rig, text = read_rig(job.rig), rig_text(job.rig)
        recordings = [r for r, _ in read_recordings(rig, [job.train], [job.holdout], job.drop_bad_rows)]
        refuse_copies(recordings)
    seed = rig.fit.seed if job.seed is None else job.seed
    channel, found = rig.fit.observe[0], []
    with clock.time("fit"):
        for name in names:
            progress.phase(f"fitting {name}")
            found.append(_compared(rig, name, recordings, channel, seed))
    if all(one.why for one in found):
        failed = InputError if all(one.asks_too_much for one in found) else NumericsError
        raise failed("no model could be fitted: " + _reasons(found))
    document = _document(rig, found, recordings, channel, seed)
    run = run_record("compare", rig, argv, clock, seed, 0) | {"inputs": list(rig.plant.signals)}
    series = [
        prediction.to_series(
            f"{r.name} ({one.name})", role, r.time, {channel: r.channels[channel]}, {channel: values}, r.units, clock=r.has_clock
        )
        for one in found if not one.why
        for r, role, values in zip(recordings, ("train", "holdout"), one.predictions, strict=True)
    ]  # fmt: skip
    progress.phase("writing the report")

    def fill(folder: Path) -> None:
        (folder / "rig.toml").write_text(text, "utf-8", newline="")
        (folder / "compare.json").write_text(to_json(document), "utf-8")
        prediction.write(folder / "prediction.csv", series)
        page = comparison_page(document, prediction.read(folder / "prediction.csv"), run, text)
        (folder / "report.html").write_text(page, "utf-8")

    write_folder(out, run, fill)
    return Outcome(out, document, 0)


def _reasons(found: Sequence[Compared]) -> str:
    """Why there is no model; one reason of several is said once."""
    reasons: dict[str, list[str]] = {}
    for one in found:
        reasons.setdefault(one.why.removeprefix(f"{one.name} "), []).append(one.name)
    return "; ".join(f"{', '.join(names)}: {why}" for why, names in reasons.items())


def _names(models: Sequence[str]) -> list[str]:
    """The models asked for, each once; 'transfer-function' stands for its four structures."""
    found: list[str] = []
    for name in models:
        if name == "transfer-function":
            found += TRANSFER
        elif name not in MODELS:
            known = (*MODELS, "transfer-function")
            raise InputError(f"--models: '{name}' is not known{nearest(name, known)}: the models are {', '.join(known)}")
        else:
            found.append(name)
    if not found:
        raise InputError(f"--models names no model: give some of {', '.join(MODELS)}, with commas between")
    return list(dict.fromkeys(found))


def _compared(rig: Rig, name: str, recordings: Sequence[Recording], channel: str, seed: int) -> Compared:
    """One model; what it cannot do is an answer, too, so that the others are still compared."""
    began, fitted = time.perf_counter(), _law if name in MATERIALS else _operator
    try:
        found = fitted(rig, name, recordings, channel, seed)
        for recording, values in zip(recordings, found.predictions, strict=True):
            _numbers(recording, channel, values)
    except (InputError, NumericsError) as error:
        kind = "law" if name in MATERIALS else "input-output"
        return Compared(name, kind, why=str(error), asks_too_much=isinstance(error, InputError))
    return dataclasses.replace(found, wall=time.perf_counter() - began)


def _numbers(recording: Recording, channel: str, values: np.ndarray) -> None:
    """Raises ``NumericsError`` where a prediction is no number though there is a measurement: on fewer rows it could not be ranked."""
    bad = np.isfinite(recording.channels[channel]) & ~(np.abs(values) < _HUGE)
    if np.any(bad):
        row = int(np.argmax(bad))
        raise NumericsError(
            f"{recording.name}: its prediction of {channel} is no number at {np.sum(bad)} of {len(values)} rows, first at row {row + 1}, "
            f"{recording.time[row]:.6g} s"
        )


def _law(rig: Rig, name: str, recordings: Sequence[Recording], channel: str, seed: int) -> Compared:
    changed = with_law(rig, name)
    settings = cast(Any, dataclasses.replace(changed.fit, seed=seed))
    rows = sum(int(np.sum(np.isfinite(recordings[0].channels[c]))) for c in settings.observe)
    check_rows(recordings[0].name, rows, len(settings.names), name)
    result = fit(changed.plant, recordings[:1], settings, holdout=recordings[1:], interpolation=rig.interpolation)
    failed = [r for r in result.responses if r.code is not Code.done]
    if failed:
        ends = ", ".join(f"{e.name} = {as_text(e.estimate, e.unit)}" for e in result.estimates)
        raise NumericsError(
            f"{failed[0].recording.name}: {failed[0].code.name} where its fit ended, at {ends}: bound these (fit.bounds), free fewer, or "
            "give a training recording that goes as far"
        )
    held = tuple(f"{e.name} ({as_text(float(f'{e.estimate:.5g}'), e.unit)})" for e in result.estimates if e.at_bound)
    open_ = tuple(e.name for e in result.estimates if undetermined(estimate_entry(e)))
    predictions = tuple(r.model[channel] for r in result.responses)
    fitted = {
        e.name: {"value": number(e.estimate), "lower95": number(e.lower95), "upper95": number(e.upper95), "free": True, "unit": e.unit}
        for e in result.estimates
    }
    return Compared(name, "law", len(result.problem.unknowns), predictions, at_bound=held, undetermined=open_, fitted=fitted)


def with_law(rig: Rig, name: str) -> Rig:
    """The rig with another material law."""
    kind, old = MATERIALS[name], rig.plant.material
    if type(old) is kind:
        return rig
    free, given = _OWN.get(name, ({}, {}))
    known = {key: float(getattr(old, key)) for key in declarations(kind) if key in declarations(old)}
    plant = eqx.tree_at(lambda p: p.material, rig.plant, kind(**(given | free | known)))
    there = parameters.declared(plant)
    wanted = tuple(n for n in rig.fit.free if n in there) + tuple(f"material.{key}" for key in free)
    bounds = {n: ends for n, ends in rig.fit.bounds.items() if n in there}
    settings = dataclasses.replace(
        rig.fit, model=name, free=wanted, bounds=bounds, per_recording=tuple(n for n in rig.fit.per_recording if n in there)
    )
    return dataclasses.replace(rig, plant=plant, fit=settings)


def _operator(rig: Rig, name: str, recordings: Sequence[Recording], channel: str, seed: int) -> Compared:
    driving = _driving(rig, name, recordings)
    if not any(np.any(recordings[0].channels[c]) for c in driving):
        raise InputError(f"{driving[0]} is 0 in all rows of {recordings[0].name}, which does not tell its effect: give one that is driven")
    if name == "heating-cooling" and len(driving) > 1:
        raise InputError(
            f"{name} takes one wire, which heats or cools, and here {' and '.join(driving)} take turns: compare the other laws"
        )
    family = FAMILIES[name]([_series(r, driving, channel) for r in recordings[:1]])
    laid, note = _laid(family, recordings, driving if rig.interpolation == "hold" else ())
    notes = [note, f"its input is {' less '.join(driving)}" if len(driving) > 1 else ""]
    series = [_series(r, driving, channel) for r in laid]
    starts = _STARTS if family.weights is None else _STARTS_OF_NETWORKS
    result = fit_operator(family, series[:1], starts=starts, seed=seed)
    found = [result.respond(s) for s in series]
    notes.append(_beyond(series))
    if result.ridge:
        notes.append(f"a ridge of {result.ridge:g}, chosen by quarters of {recordings[0].name} that its fits do not see, holds its weights")
    if result.away:
        told = f"with the pieces of its input in other orders it leaves the output's range far behind {100 * result.away:.0f} times of 100"
        notes.append(f"{told}: do not trust it with another input before it has seen more")
    at_rows = (y if there is r else np.interp(r.time, there.time, y) for r, there, y in zip(recordings, laid, found, strict=True))
    told = "; ".join(one for one in notes if one)
    return Compared(
        name, "input-output", result.family.size, tuple(at_rows), note=told, at_bound=result.at_bound, undetermined=result.undetermined,
        fitted=result.values,
    )  # fmt: skip


def _beyond(series: Sequence[Series]) -> str:
    """What is said where the holdout's input goes further than the one that a law was fitted to."""
    low, high = float(np.min(series[0].input)), float(np.max(series[0].input))
    room = _FURTHER * (high - low)
    ends = [float(np.min(series[1].input)), float(np.max(series[1].input))]
    if low - room <= ends[0] and ends[1] <= high + room:
        return ""
    told = (
        f"the input of {series[1].name} goes from {ends[0]:.3g} to {ends[1]:.3g}, beyond the {low:.3g} to {high:.3g} that it was fitted to"
    )
    return f"{told} (SI units), where it has nothing to go by"


def _series(recording: Recording, driving: Sequence[str], channel: str) -> Series:
    """A recording as a law sees it: of two wires that pull by turns, the one's command less the other's is its input."""
    first, *second = (recording.channels[c] for c in driving)
    return Series(recording.name, recording.time, first - sum(second), recording.channels[channel])


def _driving(rig: Rig, name: str, recordings: Sequence[Recording]) -> list[str]:
    """The input that changes, or those of two wires that pull by turns. Raises ``InputError`` where it is none, or where they are more."""
    control, driving = rig.plant.drive.control, _changing(rig.plant.signals, recordings)
    if not driving:  # one that is on all the time is a step from rest, where it is the only one
        driving = [c for c in rig.plant.signals if control and c.startswith(control) and np.any(recordings[0].channels[c])]
    if len(driving) == 1:
        return driving
    told = (
        f"{name} takes one input that changes, and here {' and '.join(driving) if driving else 'no input'} change{'' if driving else 's'}"
    )
    if len(driving) == 2 and rig.plant.mechanism.wires == 2 and control and driving == list(numbered(control, 2)):
        shares = [_together(r, driving) for r in recordings]
        if max(shares) <= _TOGETHER:
            return driving
        worst = recordings[int(np.argmax(shares))]
        raise InputError(
            f"{told}: both are on at {100 * max(shares):.0f} % of the rows of {worst.name}: let the wires pull by turns, so that the one's "
            "command less the other's is one input, or compare the material laws, which take both"
        )
    cure = "hold the others still, or compare the material laws, which take all of them" if driving else "vary one"
    raise InputError(f"{told}: {cure}")


def _together(recording: Recording, driving: Sequence[str]) -> float:
    """Share of the rows at which all these inputs are on."""
    on = [np.abs(recording.channels[c]) > _BESIDE * max(float(np.max(np.abs(recording.channels[c]))), 1e-300) for c in driving]
    return float(np.mean(np.all(on, axis=0)))


def _changing(signals: Sequence[str], recordings: Sequence[Recording]) -> list[str]:
    """The inputs that change; of several, those that do more than scatter about a level, or than noise beside another of their kind."""
    reach = {c: max(float(np.ptp(r.channels[c])) for r in recordings) for c in signals}
    found = [c for c in signals if reach[c] > 1e-9]
    level = {c: abs(float(np.median(np.concatenate([r.channels[c] for r in recordings])))) for c in found}
    kind = {c: max(reach[other] for other in found if channel_unit(other) == channel_unit(c)) for c in found}
    moved = [c for c in found if reach[c] > _ABOUT_A_LEVEL * level[c] and reach[c] > _BESIDE * kind[c]]
    return moved if len(found) > 1 and moved else found


def _laid(family: Family, recordings: Sequence[Recording], held: Sequence[str]) -> tuple[list[Recording], str]:
    """The recordings at the step that a law which goes row by row needs, and what was done to them; ``held`` names held inputs."""
    step = float(np.median(np.diff(recordings[0].time)))
    if not family.even or all(evenly(r.time, step) for r in recordings):
        return list(recordings), ""
    laid = [r if evenly(r.time, step) else r.resample(step, held) for r in recordings]
    names = " and ".join(r.name for r, there in zip(recordings, laid, strict=True) if there is not r)
    return laid, f"it needs rows every {step:.4g} s: {names} resampled for it, and scored at the rows recorded"


def _document(rig: Rig, found: Sequence[Compared], recordings: Sequence[Recording], channel: str, seed: int) -> dict[str, Any]:
    unit, scale = difference_unit(recordings[0], channel)
    models = []
    for one in found:
        entry: dict[str, Any] = {"name": one.name, "kind": one.kind, "why": one.why, "note": one.note}
        entry |= {"at_bound": list(one.at_bound), "undetermined": list(one.undetermined)}
        rmse, percent, bic = [None, None], [None, None], None
        if not one.why:
            pairs = [(r.channels[channel], p) for r, p in zip(recordings, one.predictions, strict=True)]
            errors = [np.sqrt(np.mean((m - p)[np.isfinite(m)] ** 2)) for m, p in pairs]
            rmse, percent = [number(e, scale) for e in errors], [number(fit_percent(m, p)) for m, p in pairs]
            samples = int(np.sum(np.isfinite(pairs[0][0])))
            bic = number(samples * math.log(max(float(errors[0]), 1e-300) ** 2) + one.parameters * math.log(samples))
        entry |= {"parameters": one.parameters, "rmse_train": rmse[0], "rmse_holdout": rmse[1], "bic": bic}
        entry |= {"fitted": dict(one.fitted)}
        entry |= {"fit_percent_train": percent[0], "fit_percent_holdout": percent[1], "wall_s": round(one.wall, 2)}
        models.append(entry)
    models.sort(key=lambda m: (m["rmse_holdout"] is None, m["rmse_holdout"]))
    document = {
        "schema": SCHEMA, "rig": rig.name, "channel": channel, "not_compared": list(rig.fit.observe[1:]), "unit": unit, "summary": "",
        "models": models,
        "recordings": [recording_entry(r, role) for r, role in zip(recordings, ("train", "holdout"), strict=True)],
        "seed": seed, "smajax": __version__,
    }  # fmt: skip
    return document | {"summary": summary(document)}


def fit_percent(measured: np.ndarray, model: np.ndarray) -> float:
    """100 (1 - |y - model| / |y - mean(y)|), as MATLAB's ``compare`` gives it (NRMSE): 100 is perfect, 0 as good as the mean."""
    seen = np.isfinite(measured)
    away = float(np.linalg.norm(measured[seen] - np.mean(measured[seen])))
    return 100.0 * (1.0 - float(np.linalg.norm(measured[seen] - model[seen])) / away) if away > 0.0 else math.nan
