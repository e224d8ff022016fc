"""Logs of a soft arm: the driven wire, its thermocouple, the tags that move, and the bend of the arm.

A log is a CSV file with a row of headers (``pwm_duty_...``, ``MCPtemp_...``, ``tagid_x_...``, ``tagid_y_...``; the
first column is a stamp in ms) and rows of numbers below it.
"""

from __future__ import annotations

import csv
from dataclasses import dataclass
from pathlib import Path

from experiments.common.base import refuse

import numpy as np

GAP = 5.0  # s without duty that separate two pulses
MARGIN = 10.0  # s before the second pulse that are not fitted
READING_SHIFTS = np.linspace(-0.16, 0.16, 33)  # s; less than half of the shortest time between two readings
REST = 30.0  # s before the second pulse in which the arm is at rest


@dataclass(frozen=True)
class Log:
    """One log.

    Attributes:
        name: Stem of the file's name.
        time: Time, s.
        duty: Duty of the driven wire.
        temperature: Its thermocouple, degC; NaN where it was not refreshed.
        bend: Bend of the arm, deg; NaN where the tags were not seen.
        pulses: Times at which heating begins, s.
        until: End of the fitted part, s.
        scored: Begin of the scored part, s.
        path: The file.
        duty_name: Column of the driven wire.
        thermocouple: Column of its thermocouple.
        tags: Tags between which the bend is measured.
    """

    name: str
    time: np.ndarray
    duty: np.ndarray
    temperature: np.ndarray
    bend: np.ndarray
    pulses: np.ndarray
    until: float
    scored: float
    path: Path
    duty_name: str
    thermocouple: str
    tags: tuple[int, int]

    @property
    def columns(self) -> str:
        """The columns of the driven wire, in words."""
        return f"{self.duty_name}, {self.thermocouple}, tags {self.tags[0]} to {self.tags[1]}"

    @property
    def start_temperature(self) -> float:
        """Mean of the readings before the first pulse, or the first reading, degC."""
        measured = np.isfinite(self.temperature)
        before = self.temperature[measured & (self.time <= self.pulses[0])]
        return float(np.mean(before) if len(before) else self.temperature[measured][0])


def read_log(path: Path) -> Log:
    """Read a log, and choose the driven wire, its thermocouple and the moving tags from the data."""
    table, time = read_table(path)
    duties = {n: np.abs(c) for n, c in table.items() if n.startswith("pwm_duty_")}
    duty_name = max(duties, key=lambda n: float(np.sum(duties[n])))
    on = time[duties[duty_name] > 0]
    pulses = on[np.append(True, np.diff(on) > GAP)] if len(on) else on
    if len(pulses) < 2 or pulses[1] < MARGIN + REST:
        refuse(
            f"{path}: {len(pulses)} pulses of duty are in it: two are needed, the second at "
            f"{MARGIN + REST:g} s or later"
        )
    thermocouples = {n: c for n, c in table.items() if n.startswith("MCPtemp_")}
    if not thermocouples:
        refuse(f"{path}: no column MCPtemp_... is in it: the temperature of the wire is needed")
    thermocouple = max(thermocouples, key=lambda n: float(np.ptp(thermocouples[n])))
    refreshed = np.append(True, np.any([np.diff(c) != 0 for c in thermocouples.values()], axis=0))
    base, last = moving_tags(path, table)
    bend = chord(table, base, last)
    rest = (time >= pulses[1] - REST) & (time < pulses[1]) & np.isfinite(bend)
    if not np.any(rest):
        refuse(
            f"{path}: the tags {base} and {last} are not seen in the {REST:g} s before the second pulse: the bend "
            "has no zero"
        )
    bend = bend - np.mean(bend[rest])
    heated = (time > pulses[0] + 2.0) & (time < pulses[1]) & np.isfinite(bend)
    bend = bend * np.sign(bend[heated][np.argmax(np.abs(bend[heated]))])
    until = float(np.floor((pulses[1] - MARGIN) / 5.0) * 5.0)
    temperature = np.where(refreshed, thermocouples[thermocouple], np.nan)
    return Log(
        path.stem,
        time,
        duties[duty_name],
        temperature,
        bend,
        pulses,
        until,
        until + 5.0,
        path,
        duty_name,
        thermocouple,
        (base, last),
    )


def read_table(path: Path, least: int = 50) -> tuple[dict[str, np.ndarray], np.ndarray]:
    """Read the columns of a log by header, and its time in s; rows in which time does not advance are left out.

    Args:
        path: The log.
        least: Smallest number of rows.
    """
    with path.open(newline="", encoding="utf-8", errors="replace") as file:
        lines = [row for row in csv.reader(file) if row]
    head = next((k for k, row in enumerate(lines) if any(c.strip().startswith("pwm_duty_") for c in row)), None)
    if head is None:
        refuse(f"{path}: no row of headers has a column pwm_duty_...: this is not a log of an arm")
    names = [c.strip() for c in lines[head]]
    try:
        values = np.array([[float(c) for c in row] for row in lines[head + 1 :] if len(row) == len(names)], float)
    except ValueError as error:
        refuse(f"{path}: a row holds something that is not a number ({error})")
    if len(values) < least:
        refuse(f"{path}: {len(values)} whole rows are in it: {least} are needed")
    stamp = (values[:, 0] - values[0, 0]) / 1e3
    advancing = np.append(True, stamp[1:] > np.maximum.accumulate(stamp)[:-1])
    return {n: values[advancing, i] for i, n in enumerate(names)}, stamp[advancing]


def moving_tags(path: Path, table: dict[str, np.ndarray]) -> tuple[int, int]:
    """Return the tags between which the bend is measured.

    They are the middle one and the last if the first half of the arm does not move, else the first and the last.
    """
    tags = sorted(int(n.rsplit("_", 1)[1]) for n in table if n.startswith("tagid_x_") and n.rsplit("_", 1)[1].isdigit())
    tags = [t for t in tags if f"tagid_y_{t}" in table and np.mean(table[f"tagid_x_{t}"] != 0) > 0.5]
    if len(tags) < 3:
        refuse(f"{path}: {len(tags)} tags are seen in it: three are needed, at the arm's root, middle and tip")
    first = tags[0]
    middle = tags[len(tags) // 2]
    last = tags[-1]
    lower, upper = (
        float(np.nanmax(c) - np.nanmin(c)) for c in (chord(table, first, middle), chord(table, middle, last))
    )
    return (first if lower > 0.25 * upper else middle), last


def chord(table: dict[str, np.ndarray], start: int, end: int) -> np.ndarray:
    """Return the direction of the chord between two tags in deg, NaN where either was not seen.

    Args:
        table: The columns of the log.
        start: Tag at which the chord starts.
        end: Tag at which it ends.
    """
    x, y = (table[f"tagid_{c}_{end}"] - table[f"tagid_{c}_{start}"] for c in "xy")
    visible = np.all([table[f"tagid_{c}_{k}"] != 0 for c in "xy" for k in (start, end)], axis=0)
    angle = np.full(len(x), np.nan)
    angle[visible] = np.degrees(np.unwrap(np.arctan2(y[visible], x[visible])))
    return angle


def read_logs(folder: Path) -> list[Log]:
    """Read all logs of a folder; exit if there is none."""
    if not folder.is_dir():
        refuse(f"{folder} is not a folder: give a folder with logs of an arm, as CSV files, by --data")
    paths = sorted(folder.glob("*.csv"))
    if not paths:
        refuse(f"{folder} holds no CSV file: give a folder with logs of an arm by --data")
    return [read_log(path) for path in paths]


def repeat_first_pulse(log: Log) -> tuple[np.ndarray, np.ndarray]:
    """Return the residuals (K, deg) in the scored part of the naive forecast that the first pulse is repeated."""
    earlier = log.time - (log.pulses[1] - log.pulses[0])
    scored = log.time > log.scored
    residuals = []
    for series in (log.temperature, log.bend):
        measured = np.isfinite(series)
        residuals.append((series - np.interp(earlier, log.time[measured], series[measured]))[scored])
    return residuals[0], residuals[1]


def reading_shift(log: Log) -> np.ndarray:
    """Return for each row how much later than its stamp its temperature was taken, s.

    The thermocouples are read about every 0.5 s and logged every 0.2 s, so that a reading that follows another soon is
    newer than one that follows late, or older. The shift, of opposite sign for the two, is the one with which the
    readings of the first pulse are smoothest: the two around a reading interpolate it best.
    """
    rows = np.flatnonzero(np.isfinite(log.temperature))
    gaps = np.diff(log.time[rows], prepend=log.time[rows[0]])
    signs = np.where(gaps < np.mean(gaps[1:]), 1.0, -1.0)
    fitted = log.time[rows] < min(log.until, log.pulses[0] + REST)
    time, values = log.time[rows][fitted], log.temperature[rows][fitted]

    def roughness(shift: float) -> float:
        t = time + shift * signs[fitted]
        share = (t[1:-1] - t[:-2]) / (t[2:] - t[:-2])
        return float(np.sum((values[1:-1] - (1 - share) * values[:-2] - share * values[2:]) ** 2))

    shift = min(READING_SHIFTS, key=roughness)
    shifts = np.zeros(len(log.time))
    shifts[rows] = shift * signs
    return shifts


def describe_pulses(log: Log) -> str:
    """Return in words at which values the first two pulses begin, which maxima they reach, and how long they last."""
    texts = []
    for start in log.pulses[:2]:
        for series, unit in ((log.temperature, "degC"), (log.bend, "deg")):
            measured = np.isfinite(series) & (log.time < start + REST)
            before = series[measured & (log.time >= start - REST) & (log.time <= start)]
            pulse = series[measured & (log.time > start)]
            texts.append(f"{np.mean(before) if len(before) else pulse[0]:.1f} to {np.max(pulse):.1f} {unit}")
        pulse = (log.time[:-1] >= start) & (log.time[:-1] < start + REST)
        texts.append(f"{np.sum(np.diff(log.time)[pulse] * log.duty[:-1][pulse]):.3f} s of full duty")
    return "{}, {}, {}; then {}, {}, {}".format(*texts)
