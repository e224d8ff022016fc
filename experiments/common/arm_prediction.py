"""Prediction of a log of any course by the models of the single wires: temperatures and bends are added up."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

from experiments.common.arm_fit import ArmFit, ArmFitter
from experiments.common.arm_log import Log, chord, read_table
from experiments.common.arm_model import LEVER
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


def error_row(what: str, pairs: Sequence[tuple[np.ndarray, np.ndarray]], unit: str) -> Row:
    """Compare predictions with the mean of each series and with its first row.

    Args:
        what: Name of the row.
        pairs: Measured series, NaN where nothing was measured, each with its prediction.
        unit: Unit of all.
    """
    residuals: dict[str, list[np.ndarray]] = {"rmse": [], "rmse_of_the_mean": [], "rmse_of_the_first_row": []}
    for measured, predicted in pairs:
        rows = np.flatnonzero(np.isfinite(measured))
        series = measured[rows]
        residuals["rmse"].append(series - predicted[rows])
        residuals["rmse_of_the_mean"].append(series - np.mean(series))
        residuals["rmse_of_the_first_row"].append(series - series[0])
    numbers = {name: float(np.sqrt(np.mean(np.concatenate(r) ** 2))) for name, r in residuals.items()}
    model, mean, first = numbers.values()
    count = sum(len(r) for r in residuals["rmse"])
    text = f"{model:.2f} {unit}; the mean of the log {mean:.2f}, its first row {first:.2f}, in {count} rows"
    return Row(what, "below both", text, model < min(mean, first), numbers)


def rest_shift(fitter: ArmFitter, logs: Sequence[Log], fit: ArmFit, log: int, course: Course) -> float:
    """Return how far the rest of the arm moves as a wire is first driven in a course, m at the wire.

    An arm rests nearer to the wire of a limb that was driven last, and a wire that the other one has stretched recovers
    that as it shortens. The size is the offset with which a log began whose wire was stretched, of this wire or the
    other one; it is 0 if the other one was not driven before.

    Args:
        fitter: The fits of the logs.
        logs: One log for each wire.
        fit: Their fit.
        log: Index of the wire.
        course: The log that is predicted.
    """
    offsets = -fit.values[:, fitter.names.index("effects.rest-offset.strength")]
    limb = [other.duty_name.rsplit("_", 1)[0] for other in logs]
    onsets = [np.flatnonzero(course.duty(other) > 0) for other in logs]
    if not len(onsets[log]):
        return 0.0
    pairs = [i for i in range(len(logs)) if i != log and limb[i] == limb[log]]
    stretched = any(len(onsets[i]) and onsets[i][0] < onsets[log][0] for i in pairs)
    return max(0.0, *(float(offsets[i]) for i in (log, *pairs))) if stretched else 0.0


def bend_pair(
    fitter: ArmFitter,
    logs: Sequence[Log],
    fit: ArmFit,
    course: Course,
    tags: tuple[int, int],
    displacements: Sequence[np.ndarray],
) -> tuple[np.ndarray, np.ndarray] | None:
    """Return a measured chord and its prediction in deg; ``None`` if its tags are never seen.

    Args:
        fitter: The fits of the logs.
        logs: One log for each wire.
        fit: Their fit.
        course: The log that is predicted.
        tags: Tags between which the chord runs.
        displacements: Displacement of each wire, m.
    """
    measured = course.bend(tags)
    if measured is None:
        return None
    first = np.flatnonzero(np.isfinite(measured))[0]
    predicted = np.zeros(len(course.time))
    for i, (log, displacement) in enumerate(zip(logs, displacements, strict=True)):
        way = np.maximum.accumulate(displacement - displacement[0])
        shift = rest_shift(fitter, logs, fit, i, course) * way / max(float(way[-1]), 1e-9)
        turn = displacement + shift
        gain = chord_gain(read_table(log.path)[0], log, tags)
        predicted += gain * np.degrees((turn - turn[first]) / LEVER)
    return measured, predicted


def predict_course(fitter: ArmFitter, logs: Sequence[Log], fit: ArmFit, course: Course) -> list[Row]:
    """Predict the thermocouples and the bends of a course from the fit of the single wires.

    Each wire starts at its thermocouple's first reading, which for an idle wire is also its forecast as far as the
    wire is at ambient temperature; heat of the other wires is left out. The bend is the sum of what each wire alone
    turns each chord by since the tags were first seen. No offset from rest at the first row is assumed; a wire that is
    driven after the other one of its limb moves the rest (``rest_shift``).

    Args:
        fitter: The fits of the logs.
        logs: One log for each wire.
        fit: Their fit.
        course: The log that is predicted.
    """
    predictions = [fitter.predict(i, fit, course.recording(log)) for i, log in enumerate(logs)]
    rows, pairs = [], []
    for log, (temperature, _) in zip(logs, predictions, strict=True):
        measured = np.where(course.refreshed, course.table[log.thermocouple], np.nan)
        on = float(np.sum(np.diff(course.time) * course.duty(log)[:-1]))
        driven = f"driven for {on:.2f} s of full duty" if log.duty_name in course.table else "not in this log"
        what = f"{log.thermocouple}, {log.duty_name} {driven}"
        pairs.append((measured, temperature))
        rows.append(error_row(what, pairs[-1:], "K"))
    rows.append(error_row("all thermocouples", pairs, "K"))
    bends = []
    for tags in sorted({log.tags for log in logs}):
        pair = bend_pair(fitter, logs, fit, course, tags, [d for _, d in predictions])
        what = f"bend, tags {tags[0]} to {tags[1]}"
        if pair is None:
            rows.append(Row(what, "-", "these tags are never seen in this log", None))
            continue
        bends.append(pair)
        rows.append(error_row(what, [pair], "deg"))
    return [*rows, error_row("all bends", bends, "deg")] if bends else rows
