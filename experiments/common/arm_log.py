"""Logs of a soft arm: which wire is driven, which thermocouple answers, which tags move, and how far the arm bends.
 A log is a CSV file: a row of headers (``pwm_duty_...``, ``MCPtemp_...``, ``tagid_x_...``, ``tagid_y_...``, the first
column a stamp in ms), numbers below.
"""

from __future__ import annotations

import csv
from dataclasses import dataclass
from pathlib import Path

from experiments.common.base import refuse

import numpy as np

GAP, BEFORE, REST = (
    5.0,
    10.0,
    30.0,
)  # s: without duty between pulses, not fitted before the second one, at rest before it


@dataclass(frozen=True)
class Log:
    """One log.
     Time (s), duty of the wire that is driven, its thermocouple (degC) at refreshes, its bend (deg) where the tags are
    seen.

        Both are NaN elsewhere. ``pulses`` are the times at which heating begins; ``until`` (s) ends the fitted part;
        from ``scored`` (s) on the rest is scored. ``found`` says which columns these are.
    """

    name: str
    time: np.ndarray
    duty: np.ndarray
    temperature: np.ndarray
    bend: np.ndarray
    pulses: np.ndarray
    until: float
    scored: float
    found: str


def read_log(path: Path) -> Log:
    """Reads a log.
    The driven duty, the thermocouple that answers and the tags that move are read off it. Refuses an unusable one.
    """
    table, time = read_table(path)
    duties = {n: np.abs(c) for n, c in table.items() if n.startswith("pwm_duty_")}
    driven = max(duties, key=lambda n: float(np.sum(duties[n])))
    on = time[duties[driven] > 0]
    pulses = on[np.append(True, np.diff(on) > GAP)] if len(on) else on
    if len(pulses) < 2 or pulses[1] < BEFORE + REST:
        refuse(
            f"{path}: {len(pulses)} pulses of duty are in it: one to fit and, at least {BEFORE + REST:g} s on, "
            "one to score are needed"
        )
    thermocouples = {n: c for n, c in table.items() if n.startswith("MCPtemp_")}
    if not thermocouples:
        refuse(f"{path}: no column MCPtemp_... is in it: the temperature of the wire is needed")
    answering = max(thermocouples, key=lambda n: float(np.ptp(thermocouples[n])))
    fresh = np.append(True, np.any([np.diff(c) != 0 for c in thermocouples.values()], axis=0))
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
    until = float(np.floor((pulses[1] - BEFORE) / 5.0) * 5.0)
    temperature = np.where(fresh, thermocouples[answering], np.nan)
    found = f"{driven}, {answering}, tags {base} to {last}"
    return Log(path.stem, time, duties[driven], temperature, bend, pulses, until, until + 5.0, found)


def read_table(path: Path) -> tuple[dict[str, np.ndarray], np.ndarray]:
    """The columns of a log by header, and its time from the stamp in s.

    Rows at which time stands still are left out.
    """
    with path.open(newline="", encoding="utf-8", errors="replace") as file:
        lines = [row for row in csv.reader(file) if row]
    head = next((k for k, row in enumerate(lines) if any(c.strip().startswith("pwm_duty_") for c in row)), None)
    if head is None:
        refuse(f"{path}: no row of headers has a column pwm_duty_...: this is no log of an arm")
    names = [c.strip() for c in lines[head]]
    try:
        values = np.array([[float(c) for c in row] for row in lines[head + 1 :] if len(row) == len(names)], float)
    except ValueError as error:
        refuse(f"{path}: a row holds something that is not a number ({error})")
    if len(values) < 50:
        refuse(f"{path}: {len(values)} whole rows are in it: two pulses need more")
    stamp = (values[:, 0] - values[0, 0]) / 1e3
    runs = np.append(True, stamp[1:] > np.maximum.accumulate(stamp)[:-1])
    return {n: values[runs, i] for i, n in enumerate(names)}, stamp[runs]


def moving_tags(path: Path, table: dict[str, np.ndarray]) -> tuple[int, int]:
    """The tags between which the bend is measured.

    From the middle one if the first half of the arm stays, else from the first.
    """
    tags = sorted(int(n.rsplit("_", 1)[1]) for n in table if n.startswith("tagid_x_") and n.rsplit("_", 1)[1].isdigit())
    tags = [t for t in tags if f"tagid_y_{t}" in table and np.mean(table[f"tagid_x_{t}"] != 0) > 0.5]
    if len(tags) < 3:
        refuse(f"{path}: {len(tags)} tags are seen in it: three are needed, at the arm's root, middle and tip")
    first, middle, last = tags[0], tags[len(tags) // 2], tags[-1]
    lower, upper = (
        float(np.nanmax(c) - np.nanmin(c)) for c in (chord(table, first, middle), chord(table, middle, last))
    )
    return (first if lower > 0.25 * upper else middle), last


def chord(table: dict[str, np.ndarray], start: int, end: int) -> np.ndarray:
    """Direction of the chord from one tag to another in deg, NaN where either was not seen."""
    x, y = (table[f"tagid_{c}_{end}"] - table[f"tagid_{c}_{start}"] for c in "xy")
    seen = np.all([table[f"tagid_{c}_{k}"] != 0 for c in "xy" for k in (start, end)], axis=0)
    angle = np.full(len(x), np.nan)
    angle[seen] = np.degrees(np.unwrap(np.arctan2(y[seen], x[seen])))
    return angle


def read_logs(folder: Path) -> list[Log]:
    """All logs of a folder. Refuses a folder without any."""
    if not folder.is_dir():
        refuse(f"{folder} is no folder: give one with logs of an arm, as CSV files, by --data")
    paths = sorted(folder.glob("*.csv"))
    if not paths:
        refuse(f"{folder} holds no CSV file: give a folder with logs of an arm by --data")
    return [read_log(path) for path in paths]


def naive(log: Log) -> tuple[np.ndarray, np.ndarray]:
    """Residuals (K, deg) in the scored part of the forecast that the first pulse repeats itself."""
    then = log.time - (log.pulses[1] - log.pulses[0])
    scored = log.time > log.scored
    residuals = []
    for series in (log.temperature, log.bend):
        known = np.isfinite(series)
        residuals.append((series - np.interp(then, log.time[known], series[known]))[scored])
    return residuals[0], residuals[1]


def begun(log: Log) -> str:
    """Where the first two pulses, of the same duty, begin and how far they go.

    What the first one does not tell of the second.
    """
    words = []
    for first in log.pulses[:2]:
        for series, unit in ((log.temperature, "degC"), (log.bend, "deg")):
            known = np.isfinite(series) & (log.time < first + REST)
            before = series[known & (log.time >= first - REST) & (log.time <= first)]
            pulse = series[known & (log.time > first)]
            words.append(f"{np.mean(before) if len(before) else pulse[0]:.1f} to {np.max(pulse):.1f} {unit}")
    return "{}, {}; then {}, {}".format(*words)
