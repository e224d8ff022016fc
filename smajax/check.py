"""``smajax check``: what a rig and its recordings say, and what would be fitted to what; what a machine's file says. Runs nothing."""

import math
from collections.abc import Sequence
from pathlib import Path

import numpy as np

from smajax import parameters
from smajax.diagnose.evidence import evidence
from smajax.dissipation import crossed
from smajax.errors import InputError
from smajax.jobs.fit import read_recordings
from smajax.machines import AbstractMachine, is_machine, kind_of, parse_machine
from smajax.recording import Recording
from smajax.report.summary import table
from smajax.rig import Rig, read_rig
from smajax.rig_schema import as_text, channel_unit
from smajax.simulate import default_step
from smajax.toml_file import read_text


def describe(path: Path, recordings: Sequence[Path], drop_bad_rows: bool = False) -> str:
    """The text of the check. Raises InputError with the first mistake in the rig or in a recording."""
    text = read_text(path, "rig")
    if is_machine(text):
        return _machine(parse_machine(text, str(path)), path, recordings)
    rig = read_rig(path)
    read = [r for r, _ in read_recordings(rig, recordings, (), drop_bad_rows)]
    drive = f", driven by {rig.plant.drive.control} ({rig.interpolation} between samples)" if rig.plant.drive.control else ""
    lines = [f"{rig.name}: {rig.kind}{drive}, material {rig.fit.model}", ""]
    lines += _free(rig) or ["Nothing is free: name the parameters to fit under [fit] free."]
    given = {c: f"{c} (noise {as_text(noise, channel_unit(c, difference=True))})" for c, noise in rig.fit.noise.items()}
    lines += [
        "",
        f"Fitted and scored: {', '.join(given.get(c, c) for c in rig.fit.observe)}; needed in a recording: {', '.join(rig.plant.signals)}.",
    ]
    lines.append(f"A fit begins at {rig.fit.starts} point{'s' * (rig.fit.starts != 1)}, seed {rig.fit.seed}.")
    lines += [f"Note: {note}." for note in rig.notes] + [f"Note: {one}" for one in crossed(rig.plant, [r.channels for r in read])]
    for recording in read:
        lines += ["", *_recording(rig, recording)]
    return "\n".join(line.rstrip() for line in lines)


def _machine(machine: AbstractMachine, path: Path, recordings: Sequence[Path]) -> str:
    if recordings:
        raise InputError(f"{path}: a machine gives its figures without a recording: take {recordings[0]} off the command line")
    rows = []
    for name, known in parameters.declared(machine).items():
        ends = [as_text(end, known.unit) if math.isfinite(end) else "none" for end in (known.lower, known.upper)]
        value = float(parameters.get(machine, name))
        rows.append((name, as_text(value, known.unit) if math.isfinite(value) else "not given", f"{ends[0]} .. {ends[1]}"))
    figures = ", ".join(name if unit == "1" else f"{name} [{unit}]" for name, unit in machine.units.items())
    lines = [f"{path.name}: {kind_of(machine)}, a machine, which gives its figures without a recording", ""]
    lines += [*table([("parameter", "value", "bounds"), *rows]), "", f"Figures: {figures}."]
    lines.append("A sweep varies the parameters and asks for figures.")
    return "\n".join(line.rstrip() for line in lines)


def _free(rig: Rig) -> list[str]:
    known = parameters.declared(rig.plant)
    rows = []
    for name in rig.fit.names:
        value, unit = float(parameters.get(rig.plant, name)), known[name].unit
        bounds = rig.fit.bounds.get(name, (known[name].lower, known[name].upper))
        ends = [as_text(end, unit) if math.isfinite(end) else "none" for end in bounds]
        each = "one per recording" if name in rig.fit.per_recording or name.startswith("initial.") else ""
        nominal = as_text(value, unit) if math.isfinite(value) else "as it starts"
        rows.append((name, nominal, f"{ends[0]} .. {ends[1]}", rig.sources.get(parameters.expand([name])[0], "default"), each))
    return table([("free parameter", "nominal", "bounds", "from", ""), *rows]) if rows else []


def _recording(rig: Rig, recording: Recording) -> list[str]:
    lines = [f"{recording.name}: {len(recording):,} rows"]
    if recording.has_clock:
        gaps = np.diff(recording.time)
        even = "" if np.ptp(gaps) < 1e-3 * np.median(gaps) else f", {gaps.min():.4g} to {gaps.max():.4g} s"
        lines[0] += f", {recording.time[-1] - recording.time[0]:.6g} s, sample time {np.median(gaps):.4g} s{even}"
        step = default_step(rig.plant)
        if step < np.median(gaps) * (1 - 1e-9):
            lines[0] += f" (simulated in steps of at most {step:.3g} s)"
    used = {c: "input" for c in rig.plant.signals} | {c: "observed" for c in rig.fit.observe}
    used |= {c: "evidence for a diagnosis" for c in evidence(rig.plant, rig.fit.observe, [recording])[0]}
    lines.append("  " + ", ".join(f"{c} [{recording.units[c]}] ({used.get(c, 'not used')})" for c in recording.channels))
    return lines + [f"  {note}" for note in recording.notes]
