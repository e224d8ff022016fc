"""``fit.json``: the result of a fit as a JSON document; its model is ``documents.fit.FitDocument``."""

from collections.abc import Iterable, Mapping, Sequence
from typing import Any

import numpy as np

from smajax import __version__, parameters
from smajax.files.documents import finite_or_none
from smajax.files.file_units import file_units
from smajax.files.fit_settings import FitSettings
from smajax.files.plausible_ranges import implausible_values, plausible_range
from smajax.files.rig_file import Rig
from smajax.fitting.electrical_noise import InputNoise
from smajax.fitting.fit_warnings import transformation_notices
from smajax.fitting.levenberg_marquardt import SolverStatus
from smajax.fitting.noise import quantisation_noise
from smajax.fitting.result import Estimate, FitResult
from smajax.fitting.transformation_check import needs_transformation
from smajax.recordings.recording import Recording
from smajax.report.document_entries import difference_unit, implausible_entry, recording_entry
from smajax.report.documents.fit import FitDocument
from smajax.simulation.status import SimulationStatus

_NOISE_SOURCE = "residual differences"
_ROUNDING_SOURCE = "rounding"


def fit_document(
    result: FitResult,
    rig: Rig,
    settings: FitSettings,
    *,
    profiles: Mapping[str, Mapping[str, Any]] | None = None,
    bench: Sequence[Mapping[str, Any]] = (),
    failure: str = "",
    warnings: Sequence[str] = (),
) -> dict[str, Any]:
    """Build the document of a fit.

    Args:
        result: The fit.
        rig: The rig that was fitted.
        settings: The settings of the fit.
        profiles: Profile likelihoods by parameter, as ``smajax.fitting.profile.profile_likelihood`` returns them.
        bench: Entries of what the recordings show about their bench.
        failure: Why the fit is a failure although its search ended.
        warnings: Warnings as sentences.
    """
    failed = [
        f"{r.recording.name}: {r.status.name}: {r.status.hint}"
        for r in result.responses
        if r.status is not SimulationStatus.done
    ]
    implausible = implausible_values(result.plant, [*result.problem.shared, *result.problem.per_recording])
    document = _head(rig, [r.recording for r in result.responses]) | {
        "parameters": _estimate_entries(result.estimates, rig),
        "fixed": _fixed_entries(rig, result.plant, result.problem.shared + result.problem.per_recording),
        **_channel_entries(result, settings),
        "indistinct": [
            {
                "parameters": list(group.parameters),
                "direction": [finite_or_none(d) for d in group.direction],
                "shrink": finite_or_none(group.shrink),
            }
            for group in result.collinear_groups
        ],
        "correlations": {
            "parameters": [e.name for e in result.estimates],
            "matrix": [[finite_or_none(value) for value in row] for row in result.correlation],
        },
        "discretisation": _discretisation_entries(result, settings),
        "transformation_temperatures": _transformation_temperatures(result),
        "profiles": {name: _profile_entry(profile) for name, profile in (profiles or {}).items()},
        "solver": _solver_entry(result),
        "recordings": [recording_entry(r.recording, r.role) for r in result.responses],
        "bench": list(bench),
        "failure": failure,
        # Where a clock or an input is in doubt, so is what the wire does at it.
        "notices": [] if _has_doubtful_scale(bench) else transformation_notices(result),
        "warnings": [*failed, *warnings, *(value.sentence for value in implausible)],
        "implausible": [implausible_entry(value) for value in implausible],
        "input_noise": [_input_noise_entry(noise, result) for noise in result.input_noise],
        "seed": result.seed,
        "smajax": __version__,
    }
    return FitDocument.check(document)


def failed_document(
    rig: Rig,
    settings: FitSettings,
    recordings: Sequence[tuple[Recording, str]],
    reason: str,
    *,
    bench: Sequence[Mapping[str, Any]] = (),
    warnings: Sequence[str] = (),
) -> dict[str, Any]:
    """Build the document of a fit whose simulation failed at the start values.

    Args:
        rig: The rig.
        settings: The settings of the fit.
        recordings: The recordings with their roles.
        reason: Reason of the failure.
        bench: Entries of what the recordings show about their bench.
        warnings: Warnings as sentences.
    """
    free = _start_entries(rig, settings)
    units = {c: difference_unit(recordings[0][0], c)[0] for c in settings.observe}
    document = _head(rig, [recording for recording, _ in recordings]) | {
        "parameters": free,
        "fixed": _fixed_entries(rig, rig.plant, tuple(free)),
        "rmse": {c: {"train": None, "holdout": None, "unit": unit} for c, unit in units.items()},
        "noise_floor": {c: {"value": None, "unit": unit, "from": _NOISE_SOURCE} for c, unit in units.items()},
        "indistinct": [],
        "correlations": {"parameters": [], "matrix": []},
        "discretisation": {c: {"value": None, "unit": unit} for c, unit in units.items()},
        "profiles": {},
        "solver": {
            "code": SolverStatus.failed.name,
            "text": reason,
            "steps": 0,
            "simulations": 0,
            "wall_s": None,
            "compile_s": None,
            "starts": settings.starts,
            "starts_at_best": 0,
        },
        "recordings": [recording_entry(recording, role) for recording, role in recordings],
        "bench": list(bench),
        "notices": [],
        "warnings": list(warnings),
        "seed": settings.seed,
        "smajax": __version__,
    }
    return FitDocument.check(document)


def _solver_entry(result: FitResult) -> dict[str, Any]:
    """How the search ended, and its effort."""
    return {
        "code": result.status.name,
        "text": result.status.text,
        "steps": result.steps,
        "simulations": result.simulations,
        "wall_s": finite_or_none(result.wall_time),
        "compile_s": finite_or_none(result.compile_time),
        "starts": result.starts,
        "starts_at_best": result.starts_at_best,
    }


def _input_noise_entry(noise: InputNoise, result: FitResult) -> dict[str, Any]:
    unit, factor = difference_unit(result.responses[0].recording, noise.channel)
    return {
        "channel": noise.channel,
        "value": finite_or_none(noise.deviation, factor),
        "unit": unit,
        "from": "given" if noise.given else "estimated",
        "kind": noise.kind.value,
        "share": finite_or_none(noise.share),
        "plateaus": noise.count,
        "text": noise.sentence(unit),
    }


def _has_doubtful_scale(bench: Sequence[Mapping[str, Any]]) -> bool:
    return any(entry["code"] in ("clock", "input") for entry in bench)


def _transformation_temperatures(result: FitResult) -> dict[str, float | None]:
    """Temperatures of the fitted law at zero stress, degC, if one of them or a shift of them is free."""
    if not needs_transformation([*result.problem.shared, *result.problem.per_recording]):
        return {}
    law = result.plant.material
    ends = {f"{phase}_{end}": phase for phase in ("martensite", "austenite") for end in ("start", "finish")}
    return {
        f"material.{name}": finite_or_none(float(getattr(law, name) + getattr(law, f"{phase}_shift")))
        for name, phase in ends.items()
    }


def _estimate_entries(estimates: Iterable[Estimate], rig: Rig) -> dict[str, dict[str, Any]]:
    """Entries of the free parameters by label, with the value and the unit of the rig file."""
    declared = parameters.all_declarations(rig.plant)
    units = file_units(rig, {name: declaration.unit for name, declaration in declared.items()})
    entries = {}
    for estimate in estimates:
        name = estimate.name.partition("@")[0]
        nominal = float(parameters.get(rig.plant, name))
        entries[estimate.name] = estimate_entry(estimate) | {
            "nominal": finite_or_none(nominal),
            "file_unit": units.get(name),
        }
    return entries


def estimate_entry(estimate: Estimate) -> dict[str, Any]:
    """Return the entry of a free parameter."""
    allowed = plausible_range(estimate.name, estimate.unit)
    return {
        "estimate": finite_or_none(estimate.estimate),
        "lower95": finite_or_none(estimate.lower95),
        "upper95": finite_or_none(estimate.upper95),
        "unit": estimate.unit,
        "free": True,
        "at_bound": estimate.at_bound,
        "bounds": [finite_or_none(end) for end in estimate.bounds],
        "plausible": None if allowed is None else [allowed.lower, allowed.upper],
    }


def _head(rig: Rig, recordings: Iterable[Recording]) -> dict[str, Any]:
    return {
        "schema": FitDocument.SCHEMA,
        "rig": rig.name,
        "model": rig.fit.model,
        "kind": rig.kind,
        "inputs": list(rig.plant.driving_channels(*(recording.channels for recording in recordings))),
        "observed": list(rig.fit.observe),
    }


def _channel_units(result: FitResult, settings: FitSettings) -> dict[str, tuple[str, float]]:
    """Unit and factor of each observed channel, as in the first training recording."""
    sample = next(r.recording for r in result.responses if r.role == "train")
    return {channel: difference_unit(sample, channel) for channel in settings.observe}


def _channel_entries(result: FitResult, settings: FitSettings) -> dict[str, Any]:
    """RMSE and noise floor by channel."""
    rmse, floor = {}, {}
    for channel, (unit, factor) in _channel_units(result, settings).items():
        errors = {role: result.rmse(channel, role) for role in ("train", "holdout")}
        rmse[channel] = {role: finite_or_none(value, factor) for role, value in errors.items()} | {"unit": unit}
        noise = result.noise_floor[channel]
        measured = [r.recording.channels[channel] for r in result.responses if r.role == "train"]
        source = _ROUNDING_SOURCE if noise == max(map(quantisation_noise, measured)) else _NOISE_SOURCE
        floor[channel] = {"value": finite_or_none(noise, factor), "unit": unit, "from": source}
    return {"rmse": rmse, "noise_floor": floor}


def _discretisation_entries(result: FitResult, settings: FitSettings) -> dict[str, Any]:
    return {
        channel: {"value": finite_or_none(result.discretisation_errors[channel], factor), "unit": unit}
        for channel, (unit, factor) in _channel_units(result, settings).items()
    }


def _start_entries(rig: Rig, settings: FitSettings) -> dict[str, Any]:
    """Start values of the free parameters."""
    declared = parameters.all_declarations(rig.plant)
    names = [*settings.free, *settings.per_recording, *(f"initial.{state}" for state in settings.initial)]
    entries = {}
    for name in dict.fromkeys(names):
        bounds = settings.bounds.get(name, (declared[name].lower, declared[name].upper))
        entries[name] = {
            "estimate": finite_or_none(float(parameters.get(rig.plant, name))),
            "lower95": None,
            "upper95": None,
            "unit": declared[name].unit,
            "free": True,
            "at_bound": False,
            "bounds": [finite_or_none(end) for end in bounds],
        }
    return entries


def _fixed_entries(rig: Rig, plant: Any, free: Iterable[str]) -> dict[str, dict[str, Any]]:
    """Parameters that were not fitted and whose values the rig file or its parameter set gives; no defaults."""
    fitted = set(parameters.expand(free))
    entries = {}
    for name, declaration in parameters.all_declarations(plant).items():
        if name in fitted or name in parameters.TIES or rig.sources.get(name, "default") == "default":
            continue
        entries[name] = {
            "value": finite_or_none(float(parameters.get(plant, name))),
            "unit": declaration.unit,
            "source": rig.sources[name],
        }
    return entries


def _profile_entry(profile: Mapping[str, Any]) -> dict[str, Any]:
    return {
        "values": [finite_or_none(v) for v in np.asarray(profile["values"])],
        "rise": [finite_or_none(v) for v in np.asarray(profile["rise"])],
        "lower95": finite_or_none(profile["lower95"]),
        "upper95": finite_or_none(profile["upper95"]),
    }
