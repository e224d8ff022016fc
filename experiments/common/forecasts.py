"""Forecasts of a held-out part at several horizons: a model corrected by its latest error, and naive ones."""

from __future__ import annotations

import dataclasses
import itertools
from collections.abc import Sequence

from experiments.common.base import Row

import numpy as np
from scipy.signal import lfilter

WEIGHTS = (1.0, 0.85, 0.7, 0.5, 0.3, 0.15)  # of the latest error in the mean of the errors that corrects the model
OFFSETS = (0.0, 30.0, 100.0, 300.0)  # s over which an offset is averaged; 0 for none
MEMORIES = (3.0, 10.0, 30.0, 60.0, 120.0, 300.0, 1000.0, np.inf)  # s in which a correction decays to the offset
PULSE = 0.02  # smallest duty of a heating, as a mean over ``PULSE_SECONDS``; single corrupt packets are below it
PULSE_SECONDS = 10.0
PAUSE = 30.0  # s without heating that separate two cycles


@dataclasses.dataclass(frozen=True)
class Correction:
    """How the latest errors e of a model correct its forecast by a horizon h.

    The forecast is that of the model, plus o + exp(-h / memory) (s - o), with the mean error s, in which the latest one
    has the weight ``weight``, and an offset o, which is the mean over a longer time.

    Attributes:
        weight: Weight of the latest error in s.
        offset: Time over which o is averaged, s; 0 for o = 0.
        memory: Time constant with which the correction decays to o, s.
    """

    weight: float
    offset: float
    memory: float

    def at(self, errors: np.ndarray, horizon: np.ndarray | float, period: float) -> np.ndarray:
        """Return the correction after each row.

        Args:
            errors: Measured minus modelled values, shape ``(rows,)``.
            horizon: Horizon, s.
            period: Time between rows, s.
        """
        offset = np.zeros(len(errors))
        if self.offset:
            offset = running_mean(errors, 1.0 - np.exp(-period / self.offset))
        return offset + np.exp(-horizon / self.memory) * (running_mean(errors, self.weight) - offset)

    def forecast(self, measured: np.ndarray, modelled: np.ndarray, rows: int, period: float) -> np.ndarray:
        """Return the forecast of each row from the readings up to some rows before; NaN where there are none.

        Args:
            measured: Measured values.
            modelled: Modelled values, from the recorded input.
            rows: Horizon, in rows.
            period: Time between rows, s.
        """
        result = np.full(len(measured), np.nan)
        result[rows:] = modelled[rows:] + self.at(measured - modelled, rows * period, period)[:-rows]
        return result

    def __str__(self) -> str:
        offset = f"offset over {self.offset:g} s" if self.offset else "no offset"
        return f"weight {self.weight:g}, {offset}, memory {self.memory:g} s"


def running_mean(values: np.ndarray, weight: float) -> np.ndarray:
    """Return the means m_k = m_(k-1) + weight (v_k - m_(k-1)), from the first value on.

    Args:
        values: Values, shape ``(rows,)``.
        weight: Weight of the latest value.
    """
    return lfilter([weight], [1.0, weight - 1.0], values, zi=[(1.0 - weight) * values[0]])[0]


def choose_correction(
    parts: Sequence[tuple[np.ndarray, np.ndarray, slice]], rows: int, period: float, keeps: bool = False
) -> Correction:
    """Return the correction with the lowest error at a horizon over that of persistence, on average over parts.

    Args:
        parts: Measured and modelled values, and the rows that count, of each part.
        rows: Horizon, in rows.
        period: Time between rows, s.
        keeps: Whether a correction does not decay, as for a sensor whose zero differs from log to log.
    """

    def score(correction: Correction) -> float:
        ratios = []
        for measured, modelled, counted in parts:
            persistence = np.append(np.full(rows, np.nan), measured[:-rows])
            error = rms((measured - correction.forecast(measured, modelled, rows, period))[counted])
            ratios.append(error / rms((measured - persistence)[counted]))
        return float(np.mean(ratios))

    shapes = itertools.product(WEIGHTS, (0.0,), (np.inf,)) if keeps else itertools.product(WEIGHTS, OFFSETS, MEMORIES)
    return min((Correction(*shape) for shape in shapes), key=score)


def rms(residual: np.ndarray) -> float:
    """Return the root of the mean square of the finite entries."""
    return float(np.sqrt(np.nanmean(residual**2)))


def cycle_starts(time: np.ndarray, duty: np.ndarray) -> np.ndarray:
    """Return the times at which cycles begin: heating after a pause.

    Args:
        time: Times, s.
        duty: Duty of the rows.
    """
    rows = max(round(PULSE_SECONDS / float(np.median(np.diff(time)))), 1)
    on = time[np.convolve(duty, np.full(rows, 1.0 / rows), mode="same") > PULSE]
    return on[np.append(True, np.diff(on) > PAUSE)] if len(on) else on


def last_cycle(
    time: np.ndarray, duty: np.ndarray, values: np.ndarray, earlier: tuple[np.ndarray, np.ndarray, np.ndarray]
) -> np.ndarray:
    """Return the naive forecast that the last cycle is repeated, from the start of each heating on.

    The last cycle is the one before in the same recording, or the last one of an earlier recording.

    Args:
        time: Times, s.
        duty: Duty.
        values: Measured values.
        earlier: The same of the earlier recording.
    """
    starts, before = cycle_starts(time, duty), cycle_starts(earlier[0], earlier[1])
    first = starts[0] if len(starts) else time[0]
    begin = before[-1] if len(before) else earlier[0][0]
    repeated = np.interp(time - first + begin, earlier[0], earlier[2])
    for previous, start in itertools.pairwise(starts):
        later = time >= start
        repeated[later] = np.interp(time[later] - start + previous, time, values)
    return repeated


def naive_forecasts(values: np.ndarray, repeated: np.ndarray, rows: int) -> dict[str, np.ndarray]:
    """Return the naive forecasts of each row from the readings up to some rows before.

    Args:
        values: Measured values.
        repeated: The last cycle.
        rows: Horizon, in rows.
    """
    means = np.cumsum(values) / np.arange(1, len(values) + 1)
    late = np.full(rows, np.nan)
    return {
        "mean so far": np.append(late, means[:-rows]),
        "persistence": np.append(late, values[:-rows]),
        "last cycle": repeated,
    }


def compare(
    what: str,
    values: np.ndarray,
    forecast: np.ndarray,
    naive: dict[str, np.ndarray],
    unit: str,
) -> Row:
    """Return a row with the errors of a forecast and of naive ones, and whether it is below all of them.

    The mean of the compared values themselves, which nobody knows beforehand, is one of the naive forecasts.

    Args:
        what: Name of the row.
        values: Measured values.
        forecast: The forecast.
        naive: Naive forecasts by name.
        unit: Unit of the values.
    """
    errors = {"the part's own mean": float(np.std(values))}
    errors |= {name: rms(values - series) for name, series in naive.items()}
    error = rms(values - forecast)
    text = f"{error:.3g} {unit}; " + ", ".join(f"{name} {value:.3g}" for name, value in errors.items())
    lowest = min(errors, key=lambda name: errors[name])
    is_below = error < errors[lowest]
    if not is_below:
        text += f": {lowest} is as good or better"
    return Row(what, "below all", text, is_below, {"model": error, **errors})
