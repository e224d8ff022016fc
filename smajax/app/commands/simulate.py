"""Job of ``smajax simulate``: simulate a rig under the inputs of a recording."""

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from smajax.app.run_record import Clock, Outcome, read_rig_text, run_record
from smajax.errors import NumericsError
from smajax.files.documents import finite_or_none
from smajax.files.result_folder import check_output_folder, write_folder
from smajax.files.rig_file import Rig, read_rig
from smajax.plant.materials.dissipation import check_dissipation
from smajax.progress import Progress
from smajax.recordings.recording import Recording
from smajax.report import prediction
from smajax.report.document_entries import recording_entry
from smajax.report.run_pages import simulation_page
from smajax.simulation.run import simulate
from smajax.simulation.status import SimulationStatus


def run_simulation(
    rig_path: Path, path: Path, out: Path, *, drop_bad_rows: bool, progress: Progress, argv: Sequence[str]
) -> Outcome:
    """Simulate a rig under the inputs of a recording and write the result folder.

    simulation.csv is a recording with time, inputs and all channels of the plant, in the units of the input file for
    channels that it has. If the simulation fails, it has the rows before the failure.

    Args:
        rig_path: The rig file.
        path: The recording.
        out: The result folder.
        drop_bad_rows: Whether to omit rows that cannot be read.
        progress: Display of the phases.
        argv: The command line, for the record of the run.

    Returns:
        The outcome; a failure of the numerics does not raise, but has an exit code.

    Raises:
        InputError: If a file or the folder is not valid.
    """
    out, clock = check_output_folder(out), Clock()
    progress.phase("reading")
    with clock.time("read"):
        rig, text = read_rig(rig_path), read_rig_text(rig_path)
        recording = rig.read(path, drop_bad_rows=drop_bad_rows, observed=False)
    progress.phase("compiling and simulating")
    with clock.time("simulate"):
        result = simulate(rig.plant, recording, interpolation=rig.interpolation, throw=False)
        channels = {c: np.asarray(v) for c, v in result.channels.items()}
        status = SimulationStatus(int(result.status))
    progress.phase("writing the report")
    rows = _rows_before_failure(channels)
    failure = ""
    if status is not SimulationStatus.done:
        failure = f"{recording.name}: {status.name}: {status.hint} ({rows} of {len(recording)} rows could be simulated)"
    series = prediction.recording_series(recording, "simulation", channels)
    exit_code = NumericsError.exit_code if failure else 0
    run = run_record("simulate", rig, argv, clock, None, exit_code) | {
        "code": status.name,
        "text": failure or status.hint,
        "inputs": list(rig.plant.signals),
        "observed": list(rig.fit.observe),
        "channels": {c: _range_entry(v, series.units[c]) for c, v in series.model.items()},
        "recordings": [recording_entry(recording, "simulation")],
        "warnings": check_dissipation(rig.plant, [channels]),
    }

    def fill(folder: Path) -> None:
        (folder / "rig.toml").write_text(text, "utf-8", newline="")
        prediction.write_predictions(folder / "prediction.csv", [series])
        if rows > 1:
            _simulated_recording(rig, recording, channels, rows).write(folder / "simulation.csv")
        page = simulation_page(prediction.read_predictions(folder / "prediction.csv")[0], run, text)
        (folder / "report.html").write_text(page, "utf-8")

    write_folder(out, run, fill)
    return Outcome(out, run, exit_code, failure)


def _rows_before_failure(channels: Mapping[str, np.ndarray]) -> int:
    """Return the number of rows before the first one with a value that is not finite."""
    finite = np.all([np.isfinite(v) for v in channels.values()], axis=0)
    return int(np.argmin(np.append(finite, False)))


def _simulated_recording(rig: Rig, recording: Recording, channels: Mapping[str, np.ndarray], rows: int) -> Recording:
    """Return the first rows of the inputs and of the simulated channels as a recording."""
    inputs = {c: recording.channels[c] for c in rig.plant.signals}
    columns = inputs | {c: v for c, v in channels.items() if c not in inputs}
    units = {c: recording.units.get(c) or prediction.usual_unit(c) for c in ("time", *columns)}
    time = recording.time[:rows] if recording.has_clock else None
    return Recording.from_arrays("simulation.csv", time, {c: v[:rows] for c, v in columns.items()}, units)


def _range_entry(values: np.ndarray, unit: str) -> dict[str, Any]:
    finite = values[np.isfinite(values)]
    low, high = (finite_or_none(finite.min()), finite_or_none(finite.max())) if len(finite) else (None, None)
    return {"lowest": low, "highest": high, "unit": unit}
