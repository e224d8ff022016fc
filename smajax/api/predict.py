"""Predict the response of a rig to the inputs of a recording."""

import dataclasses
from collections.abc import Mapping
from typing import Any

import jax.numpy as jnp
import numpy as np

from smajax.api.run_record import Clock, run_record
from smajax.api.sources import RigSource, as_rig, one_source, rig_text
from smajax.api.study import FileContent, Study
from smajax.arguments import whole_number
from smajax.errors import InputError, NumericsError
from smajax.files.documents import finite_or_none
from smajax.files.rig_file import Rig
from smajax.plant.materials.dissipation import check_dissipation
from smajax.progress import ProgressCallback, Reporter
from smajax.recordings.recording import Recording
from smajax.report import prediction
from smajax.report.document_entries import recording_entry
from smajax.simulation.physical_limits import without_impossible_rows
from smajax.simulation.run import simulate
from smajax.simulation.status import SimulationStatus
from smajax.sweeps.metrics import metrics_of_cycles

# Largest number of cycles of a recording, far above any that is recorded.
_MAX_CYCLES = 1_000_000


@dataclasses.dataclass(frozen=True, eq=False, repr=False, kw_only=True)
class PredictionStudy(Study):
    """Response of a rig to the inputs of a recording.

    ``document`` is the record of the run, with the range of each channel.

    Attributes:
        channels: Channels by name, SI and degC, shape ``(rows,)`` each; empty for a loaded study.
    """

    command = "simulate"
    document_name = "run.json"

    channels: Mapping[str, np.ndarray] = dataclasses.field(default_factory=dict)


def predict(
    rig: RigSource,
    recording: Any,
    *,
    cycles: int | None = None,
    drop_bad_rows: bool = False,
    progress: ProgressCallback | None = None,
) -> PredictionStudy:
    """Predict the response of a rig to the inputs of a recording, as ``smajax simulate`` does.

    Among the saved files, simulation.csv is a recording with time, inputs and all channels of the plant, in the units
    of the recording for channels that it has. If the simulation fails, it has the rows before the failure; a state that
    no wire has, such as one beyond melting, is a failure.

    Args:
        rig: The rig, its file, or a dictionary with the sections of one.
        recording: The recording: a path, a table in memory, or a ``Recording``.
        cycles: Number of equal cycles of the recording, for the metrics of a sweep over the last of them.
        drop_bad_rows: Whether to omit rows that cannot be read.
        progress: Function that gets a ``ProgressEvent`` for each phase.

    Returns:
        The study. A failed simulation does not raise; ``success`` is then false, and ``reason`` says why.

    Raises:
        InputError: If a file is not valid.
    """
    clock, reporter = Clock(), Reporter(progress)
    reporter.phase("reading")
    with clock.time("read"):
        rig = as_rig(rig)
        text = rig_text(rig)
        read = rig.read(one_source(recording, "recording"), drop_bad_rows=drop_bad_rows, observed=False)
        _check_cycles(cycles, read)
    reporter.phase("compiling and simulating")
    with clock.time("simulate"):
        result = simulate(rig.plant, read, interpolation=rig.interpolation, throw=False)
        channels = {c: np.asarray(v) for c, v in result.channels.items()}
        channels = without_impossible_rows(channels, np.asarray(result.possible))
        status = SimulationStatus(int(result.status))
    reporter.finish("writing the report")
    rows = _rows_before_failure(channels)
    failure = ""
    if status is not SimulationStatus.done:
        failure = f"{read.name}: {status.name}: {status.hint} ({rows} of {len(read)} rows could be simulated)"
    series = prediction.recording_series(read, "simulation", channels)
    files: dict[str, FileContent] = {"rig.toml": text.encode()}
    if rows > 1:
        files["simulation.csv"] = _simulated_recording(rig, read, channels, rows).write
    run = run_record("simulate", rig.name, clock, None, NumericsError.exit_code if failure else 0) | {
        "code": status.name,
        "text": failure or status.hint,
        "inputs": list(rig.plant.driving_channels(read.channels)),
        "observed": list(rig.fit.observe),
        "channels": {c: _range_entry(v, series.units[c]) for c, v in series.model.items()},
        "recordings": [recording_entry(read, "simulation")],
        "warnings": check_dissipation(rig.plant, [channels]),
    }
    run |= {"metrics": _metric_entries(rig, read, channels, cycles)} if cycles and not failure else {}
    return PredictionStudy(document=run, series=(series,), run=run, files=files, reason=failure, channels=channels)


def _metric_entries(
    rig: Rig, recording: Recording, channels: Mapping[str, np.ndarray], cycles: int
) -> dict[str, dict[str, Any]]:
    """Return the metrics of the last cycle by name."""
    metrics = metrics_of_cycles(
        rig.plant, jnp.asarray(recording.time), {c: jnp.asarray(v) for c, v in channels.items()}, cycles
    )
    return {n: {"value": finite_or_none(value), "unit": unit} for n, (value, unit) in metrics.items()}


def _check_cycles(cycles: int | None, recording: Recording) -> None:
    """Raises InputError if a recording does not consist of so many cycles, if a number is given."""
    if cycles is None:
        return
    whole_number("predict", "cycles", cycles, 1, _MAX_CYCLES)
    if not recording.has_clock:
        raise InputError(f"cycles: {recording.name} has no time, and so no cycles: leave cycles out")
    if len(recording) <= 2 * cycles:
        rows = f"{recording.name} has {len(recording)} rows"
        raise InputError(f"cycles = {cycles}: {rows}, too few for so many: give the number of its cycles")


def _rows_before_failure(channels: Mapping[str, np.ndarray]) -> int:
    """Return the number of rows before the first one with a value that is not finite."""
    finite = np.all([np.isfinite(v) for v in channels.values()], axis=0)
    return int(np.argmin(np.append(finite, False)))


def _simulated_recording(rig: Rig, recording: Recording, channels: Mapping[str, np.ndarray], rows: int) -> Recording:
    """Return the first rows of the inputs and of the simulated channels as a recording."""
    inputs = {c: recording.channels[c] for c in rig.plant.driving_channels(recording.channels)}
    columns = inputs | {c: v for c, v in channels.items() if c not in inputs}
    units = {c: recording.units.get(c) or prediction.usual_unit(c) for c in ("time", *columns)}
    time = recording.time[:rows] if recording.has_clock else None
    return Recording.from_arrays("simulation.csv", time, {c: v[:rows] for c, v in columns.items()}, units)


def _range_entry(values: np.ndarray, unit: str) -> dict[str, Any]:
    finite = values[np.isfinite(values)]
    low, high = (finite_or_none(finite.min()), finite_or_none(finite.max())) if len(finite) else (None, None)
    return {"lowest": low, "highest": high, "unit": unit}
