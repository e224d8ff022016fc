"""Forecasts of a held-out part at several horizons: a model corrected by its latest error, and naive ones."""

from __future__ import annotations

import dataclasses
import itertools
from collections.abc import Sequence

from experiments.common.base import Row

import numpy as np

SMOOTHING = (1.0, 0.7, 0.5, 0.3, 0.15)  # weights of the latest error in the mean of the errors that corrects the model
MEMORY = (3.0, 10.0, 30.0, 60.0, 120.0, 300.0, 1000.0, np.inf)  # s in which a correction decays
PULSE = 0.01  # smallest duty of a heating, as a mean of a block; single pulses of a corrupt packet are below it
PAUSE = 30.0  # s without heating that separate two cycles


@dataclasses.dataclass(frozen=True)
class Correction:
    """How the latest errors of a model correct its forecasts: error e_k, mean s_k = s_(k-1) + weight (e_k - s_(k-1)).

    Attributes:
        weight: Weight of the latest error.
        memory: Time constant with which the correction decays, s.
    """

    weight: float
    memory: float

    def mean_errors(self, errors: np.ndarray) -> np.ndarray:
        """Return the means s_k of the errors up to each row.

        Args:
            errors: Measured minus modelled values, shape ``(rows,)``.
        """
        means, mean = np.empty(len(errors)), float(errors[0])
        for k, error in enumerate(errors):
            mean += self.weight * (error - mean) if np.isfinite(error) else 0.0
            means[k] = mean
        return means

    def forecast(self, measured: np.ndarray, modelled: np.ndarray, rows: int, period: float) -> np.ndarray:
        """Return the forecast of each row from the readings up to some rows before; NaN where there are none.

        Args:
            measured: Measured values.
            modelled: Modelled values, from the recorded input.
            rows: Horizon, in rows.
            period: Time between rows, s.
        """
        result = np.full(len(measured), np.nan)
        decay = np.exp(-rows * period / self.memory)
        result[rows:] = modelled[rows:] + decay * self.mean_errors(measured - modelled)[: len(measured) - rows]
        return result


def choose_correction(
    parts: Sequence[tuple[np.ndarray, np.ndarray]], horizons: Sequence[int], period: float
) -> Correction:
    """Return the correction with the lowest error over that of persistence, on average over parts and horizons.

    Args:
        parts: Measured and modelled values of each part.
        horizons: Horizons, in rows.
        period: Time between rows, s.
    """

    def score(correction: Correction) -> float:
        ratios = []
        for (measured, modelled), rows in itertools.product(parts, horizons):
            error = rms(measured - correction.forecast(measured, modelled, rows, period))
            ratios.append(error / rms(measured[rows:] - measured[:-rows]))
        return float(np.mean(ratios))

    return min((Correction(w, m) for w, m in itertools.product(SMOOTHING, MEMORY)), key=score)


def rms(residual: np.ndarray) -> float:
    """Return the root of the mean square of the finite entries."""
    return float(np.sqrt(np.nanmean(residual**2)))


def cycle_starts(time: np.ndarray, duty: np.ndarray) -> np.ndarray:
    """Return the times at which cycles begin: heating after a pause.

    Args:
        time: Times, s.
        duty: Duty of the rows.
    """
    on = time[duty > PULSE]
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


def compare(what: str, values: np.ndarray, forecast: np.ndarray, naive: dict[str, np.ndarray], unit: str) -> Row:
    """Return a row with the errors of a forecast and of naive ones, and whether it is below all of them.

    The mean of the compared values themselves, which nobody knows beforehand, is one of the naive forecasts.

    Args:
        what: Name of the row.
        values: Measured values.
        forecast: The forecast.
        naive: Naive forecasts by name.
        unit: Unit of the values.
    """
    errors = {"mean of the held-out part": float(np.std(values))}
    errors |= {name: rms(values - series) for name, series in naive.items()}
    error = rms(values - forecast)
    text = f"{error:.3g} {unit}; " + ", ".join(f"{name} {value:.3g}" for name, value in errors.items())
    return Row(what, "below all of these", text, error < min(errors.values()), {"model": error, **errors})
