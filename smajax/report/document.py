"""``fit.json``: a fit as a plain document, schema ``smajax.fit/1`` (``fit.schema.json`` beside this file).

Parameters stand in their declared units (SI, temperatures degC), RMSE and noise in the unit of the recording's column. A number that does
not exist is ``null``; nothing is NaN. What belongs to one recording only is named ``section.key@recording``.
"""

import json
import math
from collections.abc import Iterable, Mapping, Sequence
from typing import Any

import numpy as np

from smajax import __version__, parameters
from smajax.fit.fit import Estimate, Fit
from smajax.fit.least_squares import Stop
from smajax.fit_settings import FitSettings
from smajax.recording import Recording, canonical_of
from smajax.rig import Rig
from smajax.simulate import Code
from smajax.units import conversion

SCHEMA = "smajax.fit/1"


def estimate_entry(e: Estimate) -> dict[str, Any]:
    """What a document says of a free parameter."""
    return {
        "estimate": number(e.estimate),
        "lower95": number(e.lower95),
        "upper95": number(e.upper95),
        "unit": e.unit,
        "free": True,
        "at_bound": e.at_bound,
        "bounds": [number(end) for end in e.bounds],
    }


def fit_document(
    result: Fit, rig: Rig, settings: FitSettings, *, profiles: Mapping[str, Mapping[str, Any]] | None = None, warnings: Sequence[str] = ()
) -> dict[str, Any]:
    """The document of a fit; ``profiles`` are those of ``smajax.fit.fit.profile`` by parameter, ``warnings`` sentences to hand on."""
    trained = [r for r in result.responses if r.role == "train"]
    sample = trained[0].recording
    scales = {c: difference_unit(sample, c) for c in settings.observe}
    free = {e.name: estimate_entry(e) for e in result.estimates}
    rmse, floor, discretisation = {}, {}, {}
    for channel, (unit, factor) in scales.items():
        in_unit = {role: result.rmse(channel, role) for role in ("train", "holdout")}
        rmse[channel] = {role: number(value, factor) for role, value in in_unit.items()} | {"unit": unit}
        floor[channel] = {"value": number(result.noise_floor[channel], factor), "unit": unit, "from": "residual differences"}
        discretisation[channel] = {"value": number(result.discretisation[channel], factor), "unit": unit}
    failed = [f"{r.recording.name}: {r.code.name}: {r.code.cure}" for r in result.responses if r.code is not Code.done]
    return _head(rig) | {
        "parameters": free,
        "fixed": _fixed(rig, result.plant, result.problem.shared + result.problem.own),
        "rmse": rmse,
        "noise_floor": floor,
        "indistinct": [
            {"parameters": list(g.parameters), "direction": [number(d) for d in g.direction], "shrink": number(g.shrink)}
            for g in result.indistinct
        ],
        "correlations": {
            "parameters": [e.name for e in result.estimates],
            "matrix": [[number(value) for value in row] for row in result.correlation],
        },
        "discretisation": discretisation,
        "profiles": {name: _profile(found) for name, found in (profiles or {}).items()},
        "solver": {
            "code": result.stop.name,
            "text": result.stop.text,
            "steps": result.steps,
            "simulations": result.simulations,
            "wall_s": number(result.wall),
            "compile_s": number(result.compile),
            "starts": result.starts,
            "starts_at_best": result.starts_at_best,
        },
        "recordings": [recording_entry(r.recording, r.role) for r in result.responses],
        "warnings": [*failed, *warnings],
        "seed": result.seed,
        "smajax": __version__,
    }


def failed_document(
    rig: Rig, settings: FitSettings, recordings: Sequence[tuple[Recording, str]], reason: str, *, warnings: Sequence[str] = ()
) -> dict[str, Any]:
    """The document of a fit that could not begin: the start values, and why the simulation failed there."""
    table = parameters.declared(rig.plant)
    names = [*settings.free, *settings.per_recording, *(f"initial.{state}" for state in settings.initial)]
    free = {}
    for name in dict.fromkeys(names):
        bounds = settings.bounds.get(name, (table[name].lower, table[name].upper))
        free[name] = {
            "estimate": number(float(parameters.get(rig.plant, name))),
            "lower95": None,
            "upper95": None,
            "unit": table[name].unit,
            "free": True,
            "at_bound": False,
            "bounds": [number(end) for end in bounds],
        }
    units = {c: difference_unit(recordings[0][0], c)[0] for c in settings.observe}
    return _head(rig) | {
        "parameters": free,
        "fixed": _fixed(rig, rig.plant, tuple(free)),
        "rmse": {c: {"train": None, "holdout": None, "unit": unit} for c, unit in units.items()},
        "noise_floor": {c: {"value": None, "unit": unit, "from": "residual differences"} for c, unit in units.items()},
        "indistinct": [],
        "correlations": {"parameters": [], "matrix": []},
        "discretisation": {c: {"value": None, "unit": unit} for c, unit in units.items()},
        "profiles": {},
        "solver": {
            "code": Stop.failed.name,
            "text": reason,
            "steps": 0,
            "simulations": 0,
            "wall_s": None,
            "compile_s": None,
            "starts": settings.starts,
            "starts_at_best": 0,
        },
        "recordings": [recording_entry(recording, role) for recording, role in recordings],
        "warnings": list(warnings),
        "seed": settings.seed,
        "smajax": __version__,
    }


def to_json(document: Mapping[str, Any]) -> str:
    """A document as JSON text, one that any reader takes: no NaN, no infinity."""
    return json.dumps(document, indent=2, ensure_ascii=False, allow_nan=False) + "\n"


def number(value: Any, factor: float = 1.0) -> float | None:
    """A float for a JSON document, times ``factor``; ``None`` for what is not a finite number."""
    return None if value is None or not math.isfinite(value) else float(value) * factor


def difference_unit(recording: Recording, channel: str) -> tuple[str, float]:
    """The unit of differences of a channel, as in the recording's column, and the factor that takes SI to it; K for temperatures."""
    canonical = canonical_of(channel)
    if canonical == "degC":
        return "K", 1.0
    unit = recording.units[channel]
    return unit, float(1 / conversion(unit, canonical)[0])


def recording_entry(recording: Recording, role: str) -> dict[str, Any]:
    """What a result says of a recording that it used."""
    return {
        "name": recording.name,
        "sha256": recording.sha256,
        "rows": len(recording),
        "role": role,
        "notes": list(recording.notes),
    }


def _head(rig: Rig) -> dict[str, Any]:
    return {
        "schema": SCHEMA,
        "rig": rig.name,
        "model": rig.fit.model,
        "kind": rig.kind,
        "inputs": list(rig.plant.signals),
        "observed": list(rig.fit.observe),
    }


def _fixed(rig: Rig, plant: Any, free: Iterable[str]) -> dict[str, dict[str, Any]]:
    """The parameters that were not fitted and that the rig or its parameter set give; the rest stand at their defaults."""
    moved = set(parameters.expand(free))
    found = {}
    for name, declaration in parameters.declared(plant).items():
        if name in moved or name in parameters.TIES or rig.sources.get(name, "default") == "default":
            continue
        found[name] = {
            "value": number(float(parameters.get(plant, name))),
            "unit": declaration.unit,
            "source": rig.sources[name],
        }
    return found


def _profile(found: Mapping[str, Any]) -> dict[str, Any]:
    return {
        "values": [number(v) for v in np.asarray(found["values"])],
        "rise": [number(v) for v in np.asarray(found["rise"])],
        "lower95": number(found["lower95"]),
        "upper95": number(found["upper95"]),
    }
