"""Prediction of a log of any course by the models of the single wires: temperatures and bends are added up."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

from experiments.common.arm_fit import LEVER, LogFit, LogFitter
from experiments.common.arm_log import Log, chord, read_table
from experiments.common.base import Row, refuse

import numpy as np

from smajax.recordings.recording import Recording


class Course:
    """A log in which any wire is driven in any course.

    Attributes:
        path: Its file.
        table: Its columns by header.
        time: Time, s.
        refreshed: Whether any thermocouple was refreshed, by row.
    """

    def __init__(self, path: Path):
        if not path.is_file():
            refuse(f"{path} is not a file: give a log of the arm, as a CSV file, by --predict")
        self.path = path
        self.table, self.time = read_table(path, least=2)
        thermocouples = [c for n, c in self.table.items() if n.startswith("MCPtemp_")]
        if not thermocouples:
            refuse(f"{path}: no column MCPtemp_... is in it: the first reading of each wire is needed")
        self.refreshed = np.append(True, np.any([np.diff(c) != 0 for c in thermocouples], axis=0))

    def duty(self, log: Log) -> np.ndarray:
        """Return the duty of the wire of a log; 0 where the course has no such column."""
        return np.abs(self.table.get(log.duty_name, np.zeros(len(self.time))))

    def recording(self, log: Log) -> Recording:
        """Return the wire's duty and thermocouple as a recording; the bend, which several wires share, is 0."""
        temperature = self.table.get(log.thermocouple)
        if temperature is None:
            refuse(f"{self.path}: the column {log.thermocouple} is not in it: the wire of {log.name} has no start")
        zero = np.zeros(len(self.time))
        channels = {"duty": self.duty(log), "temperature": temperature, "displacement": zero}
        units = {"duty": "1", "temperature": "degC", "displacement": "mm"}
        return Recording.from_arrays(self.path.stem, self.time, channels, units)

    def bend(self, tags: tuple[int, int]) -> np.ndarray | None:
        """Return the direction of a chord in deg since the tags were first seen; ``None`` if they never were."""
        if any(f"tagid_{c}_{k}" not in self.table for c in "xy" for k in tags):
            return None
        angle = chord(self.table, *tags)
        visible = np.isfinite(angle)
        return angle - angle[visible][0] if np.any(visible) else None


def chord_gain(table: dict[str, np.ndarray], log: Log, tags: tuple[int, int]) -> float:
    """Return how far a chord turns per degree of a log's bend, by least squares over the log.

    Args:
        table: The columns of the log.
        log: The log.
        tags: Tags between which the chord runs.
    """
    angle = chord(table, *tags)
    rows = np.isfinite(angle) & np.isfinite(log.bend)
    return float(np.polyfit(log.bend[rows], angle[rows], 1)[0])


def error_row(what: str, measured: np.ndarray, predicted: np.ndarray, unit: str) -> Row:
    """Compare a prediction with the mean of the log and with its first row.

    Args:
        what: Name of the row.
        measured: Measured series, NaN where nothing was measured.
        predicted: Its prediction.
        unit: Unit of both.
    """
    rows = np.flatnonzero(np.isfinite(measured))
    series = measured[rows]
    errors = {
        "rmse": series - predicted[rows],
        "rmse_of_the_mean": series - np.mean(series),
        "rmse_of_the_first_row": series - series[0],
    }
    numbers = {name: float(np.sqrt(np.mean(residual**2))) for name, residual in errors.items()}
    model, mean, first = numbers.values()
    text = f"{model:.2f} {unit}; the mean of the log {mean:.2f}, its first row {first:.2f}, in {len(rows)} rows"
    return Row(what, "below both", text, model < min(mean, first), numbers)


def predict_course(fitter: LogFitter, logs: Sequence[Log], fits: Sequence[LogFit], course: Course) -> list[Row]:
    """Predict the thermocouples and the bends of a course from the fits of the single wires.

    Each wire starts at its thermocouple's first reading, which for an idle wire is also its forecast as far as the
    wire is at ambient temperature; heat of the other wires is left out. The bend is the sum of what each wire alone
    turns each chord by since the tags were first seen. No offset from rest at the first row is assumed.

    Args:
        fitter: The fits of the logs.
        logs: One log for each wire.
        fits: Their fits.
        course: The log that is predicted.
    """
    predictions = [
        fitter.predict(i, fit, course.recording(log)) for i, (log, fit) in enumerate(zip(logs, fits, strict=True))
    ]
    rows = []
    for log, (temperature, _) in zip(logs, predictions, strict=True):
        measured = np.where(course.refreshed, course.table[log.thermocouple], np.nan)
        on = float(np.sum(np.diff(course.time) * course.duty(log)[:-1]))
        what = f"{log.thermocouple}, {log.duty_name} driven for {on:.2f} s of full duty"
        rows.append(error_row(what, measured, temperature, "K"))
    tables = [read_table(log.path)[0] for log in logs]
    for tags in sorted({log.tags for log in logs}):
        measured = course.bend(tags)
        if measured is None:
            rows.append(Row(f"bend, tags {tags[0]} to {tags[1]}", "-", "these tags are never seen in this log", None))
            continue
        first = np.flatnonzero(np.isfinite(measured))[0]
        predicted = np.zeros(len(course.time))
        for log, table, (_, displacement) in zip(logs, tables, predictions, strict=True):
            turn = np.degrees((displacement - displacement[first]) / LEVER)
            predicted += chord_gain(table, log, tags) * turn
        rows.append(error_row(f"bend, tags {tags[0]} to {tags[1]}", measured, predicted, "deg"))
    return rows
