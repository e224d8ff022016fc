"""Job of ``smajax check``: describe a rig and its recordings, or an actuator, without a fit."""

import math
from collections.abc import Mapping, Sequence
from pathlib import Path
from textwrap import wrap
from types import MappingProxyType
from typing import Any

import numpy as np

from smajax import parameters
from smajax.actuators.base import AbstractActuator
from smajax.api.bench import bench_entries, rig_findings, with_free_offsets
from smajax.channels import channel_unit
from smajax.diagnosis.auxiliary_channels import auxiliary_channels
from smajax.errors import InputError
from smajax.files.actuator_file import kind_of, parse_actuator
from smajax.files.file_kinds import kind_of_file
from smajax.files.file_units import file_units
from smajax.files.latent_heat_note import latent_heat_note
from smajax.files.rig_file import Rig, read_rig
from smajax.files.toml import read_text
from smajax.files.train_and_holdout import read_train_and_holdout
from smajax.fitting.memory import fit_memory, free_memory
from smajax.fitting.transformation_check import needs_transformation, transformation_gap
from smajax.parameters import declarations
from smajax.plant.effects import catalogue
from smajax.plant.materials.dissipation import check_dissipation
from smajax.plant.stages import SURROUNDINGS
from smajax.recordings.recording import Recording
from smajax.report.shown_values import format_in_unit
from smajax.report.summary import table
from smajax.report.topics import bench_topics, explained
from smajax.simulation.step_size import default_step
from smajax.units import as_text

# Relative range of the sample times up to which the text calls them equal. Chosen by trial.
_EVEN = 1e-3
# Width of the text in columns of a terminal.
_WIDTH = 110
# Significant digits of a value in the unit of the rig file: those that a person writes.
_DIGITS = 6
# Relative difference between a step and the sample time that counts as rounding.
_ROUNDING = 1e-9


def describe(
    path: Path,
    recordings: Sequence[Path],
    reading: Mapping[str, Any] = MappingProxyType({}),
    auto: bool = False,
) -> str:
    """Describe a rig, actuator or sweep file, and recordings and controllers of the rig.

    Args:
        path: The rig, actuator or sweep file.
        recordings: Recordings of the rig, and its controller and sweep files.
        reading: Options of ``ReadOptions`` by name, in place of those of the rig.
        auto: Whether the rig is described as a fit with ``--auto`` would take it.

    Returns:
        The text that the command prints.

    Raises:
        InputError: For the first mistake in a file, or for recordings of an actuator.
    """
    text = read_text(path, "rig")
    kind = kind_of_file(text, str(path))
    if kind == "sweep":
        from smajax.app.commands.check_files import describe_sweep  # all of smajax.sweeps

        lines = describe_sweep(path)
        if recordings:
            raise InputError(f"{path}: a sweep needs no recording: remove {recordings[0]} from the command line")
    elif kind == "controller":
        raise InputError(f"{path}: a controller is checked for its rig: write smajax check RIG {path}")
    elif kind == "actuator":
        lines = _describe_actuator(parse_actuator(text, str(path)), path, recordings)
    else:
        rig = read_rig(path).with_read_options(**reading)
        files = [file for file in recordings if file.suffix == ".toml"]
        others = {file: kind_of_file(read_text(file, "rig"), str(file)) for file in files}
        data = [file for file in recordings if file not in others]
        lines = _describe_rig(rig, [r for r, _ in read_train_and_holdout(rig, data)], auto)
        for file, kind in others.items():
            lines += ["", *_describe_other(file, kind, rig)]
    return "\n".join(line.rstrip() for line in lines)


def _describe_other(file: Path, kind: str, rig: Rig) -> list[str]:
    """Describe a file next to a rig that is no recording."""
    if kind in ("rig", "actuator"):
        raise InputError(f"{file}: this is a rig, and one is checked at a time: write smajax check {file}")
    from smajax.app.commands.check_files import describe_controller, describe_sweep  # control and sweeps

    return describe_controller(file, rig) if kind == "controller" else describe_sweep(file)


def _describe_rig(rig: Rig, recordings: Sequence[Recording], auto: bool) -> list[str]:
    findings = rig_findings(rig, recordings)
    fitted = [recording.name for recording in recordings] if auto else None
    rig = with_free_offsets(rig, findings, fitted) if fitted is not None else rig
    control = rig.plant.drive.control
    heated = ", heated as its temperature is recorded" if rig.kind != "path" else ""
    drive = f", driven by {control} ({rig.interpolation} between samples)" if control else heated
    entries = bench_entries(findings, fitted)
    lines = [line for entry in entries for line in (entry["text"], "")]
    lines += [*explained(bench_topics(entries))[1:], ""] if bench_topics(entries) else []
    lines += [f"{rig.name}: {rig.kind}{drive}, material {rig.fit.model}", ""]
    lines += _free_parameters(rig) or ["No parameter is free: name the parameters to fit under [fit] free."]
    noises = {c: as_text(noise, channel_unit(c, difference=True)) for c, noise in rig.fit.noise.items()}
    observed = ", ".join(f"{c} (noise {noises[c]})" if c in noises else c for c in rig.fit.observe)
    lines += ["", f"Fitted and scored: {observed}; needed in a recording: {', '.join(rig.plant.signals)}."]
    lines += _effects(rig)
    lines.append(f"A fit begins at {rig.fit.starts} point{'s' * (rig.fit.starts != 1)}, seed {rig.fit.seed}.")
    lines += [f"Note: {note}." for note in (*rig.notes, latent_heat_note(rig.plant, rig.fit)) if note]
    lines += [f"Note: {note}" for note in check_dissipation(rig.plant, [r.channels for r in recordings])]
    for recording in recordings:
        lines += ["", *_describe_recording(rig, recording)]
    if recordings and rig.fit.names:
        is_scaled = not any(finding.code in ("clock", "input") for finding in findings)
        lines += ["", *_describe_fit(rig, recordings, is_scaled)]
    return lines


def _describe_fit(rig: Rig, recordings: Sequence[Recording], is_scaled: bool) -> list[str]:
    """Return the steps and the memory of a fit, and a notice where the rig's own values transform nothing.

    The notice is left out where the scale of the input or the clock is in doubt.
    """
    settings: Any = rig.fit  # frozen, and the protocol of ``fit_memory`` has plain attributes
    memory = fit_memory(rig.plant, recordings, settings, interpolation=rig.interpolation)
    lines = [memory.sentence()]
    if is_scaled and needs_transformation(rig.fit.names) and memory.others < free_memory():
        plants = [rig.plant] * len(recordings)
        gap = transformation_gap(plants, recordings, interpolation=rig.interpolation)
        lines += [] if gap is None else [f"Note: {gap.sentence(recordings, 'the values of this rig')}"]
    return lines


def _describe_actuator(actuator: AbstractActuator, path: Path, recordings: Sequence[Path]) -> list[str]:
    if recordings:
        raise InputError(
            f"{path}: the metrics of an actuator need no recording: remove {recordings[0]} from the command line"
        )
    rows = []
    for name, declaration in parameters.all_declarations(actuator).items():
        value = float(parameters.get(actuator, name))
        shown = as_text(value, declaration.unit) if math.isfinite(value) else "not given"
        rows.append((name, shown, _bounds_text((declaration.lower, declaration.upper), declaration.unit)))
    metrics = ", ".join(name if unit == "1" else f"{name} [{unit}]" for name, unit in actuator.units.items())
    lines = [f"{path.name}: {kind_of(actuator)}, an actuator, whose metrics need no recording", ""]
    lines += [*table([("parameter", "value", "bounds"), *rows]), "", f"Metrics: {metrics}."]
    return [*lines, "A sweep varies the parameters and computes the metrics."]


def _effects(rig: Rig) -> list[str]:
    """Return lines on the effects of a rig, and on those that it could have."""
    own = [f"{e.key} ({as_text(float(e.strength), declarations(type(e))['strength'].unit)})" for e in rig.plant.effects]
    capabilities = rig.plant.capabilities((*rig.fit.observe, *SURROUNDINGS))
    present = {effect.key for effect in rig.plant.effects}
    others = [k for k, e in catalogue().items() if k not in present and not e.unavailable_reason(capabilities)]
    lines = [f"Effects in the model: {', '.join(own) or 'none'}."]
    sentence = f"Effects that it could have, described by 'smajax effects KEY': {', '.join(others)}."
    return [*lines, *(wrap(sentence, _WIDTH, subsequent_indent="  ", break_on_hyphens=False) if others else ())]


def _free_parameters(rig: Rig) -> list[str]:
    """Return a table of the free parameters; empty if there are none."""
    declarations = parameters.all_declarations(rig.plant)
    written = file_units(rig, {name: declaration.unit for name, declaration in declarations.items()})
    rows = []
    for name in rig.fit.names:
        value, unit = float(parameters.get(rig.plant, name)), declarations[name].unit
        bounds = rig.fit.bounds.get(name, (declarations[name].lower, declarations[name].upper))
        per_recording = name in rig.fit.per_recording or name.startswith("initial.")
        rows.append(
            (
                name,
                _in_unit(value, unit, written.get(name)) if math.isfinite(value) else "derived",
                _bounds_text(bounds, unit, written.get(name)),
                rig.sources.get(parameters.expand([name])[0], "default"),
                "one per recording" if per_recording else "",
            )
        )
    return table([("free parameter", "nominal", "bounds", "from", ""), *rows]) if rows else []


def _bounds_text(bounds: tuple[float, float], unit: str, written: str | None = None) -> str:
    return " .. ".join(_in_unit(end, unit, written) if math.isfinite(end) else "none" for end in bounds)


def _in_unit(value: float, unit: str, written: str | None) -> str:
    """A value in the unit of the rig file, else in the usual one."""
    return format_in_unit(value, unit, written, _DIGITS) if written else as_text(value, unit)


def _describe_recording(rig: Rig, recording: Recording) -> list[str]:
    head = f"{recording.name}: {len(recording):,} rows"
    if recording.has_clock:
        steps = np.diff(recording.time)
        median = np.median(steps)
        uneven = "" if np.ptp(steps) < _EVEN * median else f", {steps.min():.4g} to {steps.max():.4g} s"
        head += f", {recording.time[-1] - recording.time[0]:.6g} s, sample time {median:.4g} s{uneven}"
        step = default_step(rig.plant)
        if step < median * (1 - _ROUNDING):
            head += f" (simulated in steps of at most {step:.3g} s)"
    auxiliary = auxiliary_channels(rig.plant, rig.fit.observe, [recording])[0]
    roles = {c: "input" for c in rig.plant.driving_channels(recording.channels)} | {
        c: "observed" for c in rig.fit.observe
    }
    roles |= {c: "auxiliary in a diagnosis" for c in auxiliary}
    channels = ", ".join(f"{c} [{recording.units[c]}] ({roles.get(c, 'not used')})" for c in recording.channels)
    return [head, f"  {channels}", *(f"  {note}" for note in recording.notes)]
