"""Values of a rig that recordings give: those at rest, and start values by a linear regression of the heat balance."""

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.integrate import cumulative_trapezoid

from smajax.parameters import declarations
from smajax.plant.wire import Environment
from smajax.recordings.recording import Recording
from smajax.units import as_text

# Digits of values, and decimals of a temperature in degC, more than which no start value needs.
_DIGITS, _DECIMALS = 3, 2


@dataclass(frozen=True)
class ThermalStart:
    """Coefficients of dT/dt = heating u - loss (T - T_ambient).

    Attributes:
        heating: Rate of the temperature at an input of 1, in K/s.
        loss: Rate of the decay of the temperature, in 1/s.
    """

    heating: float
    loss: float


def values_in(recordings: Sequence[Recording]) -> dict[str, tuple[str, str]]:
    """Return the values of a rig that recordings give, as text with a unit and where each is from, by name.

    The first temperature and the first force are those of the rig at rest.

    Args:
        recordings: The recordings.
    """
    values = {}
    first, whole = recordings[0].channels, {}
    for name in ("force", "stress"):
        if all(name in r.channels for r in recordings):
            whole[name] = np.concatenate([r.channels[name] for r in recordings])
    if "temperature" in first and np.isfinite(first["temperature"][0]):
        value = as_text(round(float(first["temperature"][0]), _DECIMALS), "degC")
        values["environment.ambient"] = (value, "the first temperature of the recording")
    if "force" in whole and first["force"][0] > 0:
        mean = float(np.nanmean(whole["force"]))
        values["spring.preload"] = (f"{first['force'][0]:.{_DIGITS}g} N", "the first force of the recording")
        values["load.mass"] = (f"{mean / _gravity():.{_DIGITS}g} kg", "the mean force of the recording")
    if len(whole) == 2 and np.any(whole["stress"]):
        area = float(whole["force"] @ whole["stress"] / (whole["stress"] @ whole["stress"]))
        if area > 0:
            diameter = 1e3 * math.sqrt(4 * area / math.pi)
            values["wire.diameter"] = (f"{diameter:.{_DIGITS}g} mm", "recorded force over stress")
    return values


def thermal_start(recordings: Sequence[Recording], control: str, ambient: float) -> ThermalStart | None:
    """Return the coefficients of a wire without transformation by least squares; ``None`` where they are not positive.

    The balance is integrated over time, so that the noise of the temperature is not differentiated:
    T - T_0 = heating ∫ u dt - loss ∫ (T - T_ambient) dt.

    Args:
        recordings: Recordings with a temperature and the input.
        control: The input.
        ambient: Temperature of the surroundings in degC, where it is not recorded.
    """
    rows, rises = [], []
    for recording in recordings:
        temperature, duration = recording.channels["temperature"], np.diff(recording.time)
        surroundings = recording.channels.get("ambient", np.full(len(recording), ambient))
        heated = np.concatenate([[0.0], np.cumsum(recording.channels[control][:-1] * duration)])
        lost = cumulative_trapezoid(temperature - surroundings, recording.time, initial=0.0)
        rows.append(np.stack([heated, -lost], axis=1))
        rises.append(temperature - temperature[0])
    equations, rise = np.concatenate(rows), np.concatenate(rises)
    finite = np.isfinite(equations).all(axis=1) & np.isfinite(rise)
    if not finite.any():
        return None
    heating, loss = np.linalg.lstsq(equations[finite], rise[finite], rcond=None)[0]
    return ThermalStart(float(heating), float(loss)) if heating > 0 and loss > 0 else None


def _gravity() -> float:
    """Gravitational acceleration of a rig that gives none, m/s^2."""
    gravity = declarations(Environment)["gravity"].default
    assert gravity is not None
    return gravity
