"""The job of ``smajax simulate``."""

from collections.abc import Sequence
from pathlib import Path

import numpy as np

from smajax import simulate
from smajax.console import Progress
from smajax.dissipation import crossed
from smajax.errors import NumericsError
from smajax.jobs.record import Clock, Outcome, rig_text, run_record
from smajax.recording import Recording
from smajax.report import html, prediction
from smajax.report.document import number, recording_entry
from smajax.results import check_out, write_folder
from smajax.rig import read_rig
from smajax.simulate import Code


def run_simulation(rig_path: Path, path: Path, out: Path, *, drop_bad_rows: bool, progress: Progress, argv: Sequence[str]) -> Outcome:
    """Simulates a rig under a recording's inputs and writes the folder; of a simulation that failed, the rows before the failure.

    simulation.csv is a recording itself: time, inputs, and all channels that the plant gives, in the units of the input file where it has
    the channel. Raises InputError; a failure of the numbers is an outcome.
    """
    out, clock = check_out(out), Clock()
    progress.phase("reading")
    with clock.time("read"):
        rig, text = read_rig(rig_path), rig_text(rig_path)
        recording = rig.read(path, drop_bad_rows=drop_bad_rows, observed=False)
    progress.phase("compiling and simulating")
    with clock.time("simulate"):
        result = simulate.simulate(rig.plant, recording, interpolation=rig.interpolation, throw=False)
        channels = {c: np.asarray(v) for c, v in result.channels.items()}
        code = Code(int(result.code))
    progress.phase("writing the report")
    good = int(np.argmin(np.append(np.all([np.isfinite(v) for v in channels.values()], axis=0), False)))
    told = "" if code is Code.done else f"{recording.name}: {code.name}: {code.cure} ({good} of {len(recording)} rows could be simulated)"
    warnings = crossed(rig.plant, [channels])
    driving = {c: recording.channels[c] for c in rig.plant.signals}
    given = driving | {c: v for c, v in channels.items() if c not in driving}
    units = {c: recording.units.get(c) or prediction.usual_unit(c) for c in ("time", *given)}
    series = prediction.to_series(
        recording.name, "simulation", recording.time, recording.channels, channels, recording.units, clock=recording.has_clock
    )
    exit_code = NumericsError.exit_code if told else 0
    run = run_record("simulate", rig, argv, clock, None, exit_code) | {
        "code": code.name,
        "text": told or code.cure,
        "inputs": list(rig.plant.signals),
        "observed": list(rig.fit.observe),
        "channels": {c: _range(v, series.units[c]) for c, v in series.model.items()},
        "recordings": [recording_entry(recording, "simulation")],
        "warnings": warnings,
    }

    def fill(folder: Path) -> None:
        (folder / "rig.toml").write_text(text, "utf-8", newline="")
        prediction.write(folder / "prediction.csv", [series])
        if good > 1:
            time = recording.time[:good] if recording.has_clock else None
            made = Recording.from_arrays("simulation.csv", time, {c: v[:good] for c, v in given.items()}, units)
            made.write(folder / "simulation.csv")
        page = html.simulation_page(prediction.read(folder / "prediction.csv")[0], run, text)
        (folder / "report.html").write_text(page, "utf-8")

    write_folder(out, run, fill)
    return Outcome(out, run, exit_code, told)


def _range(values: np.ndarray, unit: str) -> dict:
    good = values[np.isfinite(values)]
    low, high = (number(good.min()), number(good.max())) if len(good) else (None, None)
    return {"lowest": low, "highest": high, "unit": unit}
