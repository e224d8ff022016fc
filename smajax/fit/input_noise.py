"""What noise in a fit's input columns does to its parameters.

A law takes the temperatures, stresses and strains that drive it as true. Where these go up and down from row to row, a hysteretic law goes
to and fro, and its parameters are off by more than intervals tell, which count the noise of what is fitted only. How far is found by adding
as much noise once more and fitting again from where the fit ended: what it moves the second time it has moved about as far the first
(Cook and Stefanski 1994, the first step of simulation-extrapolation). Currents and voltages act through the wire's heat, which averages.
"""

import dataclasses
from collections.abc import Sequence

import numpy as np

from smajax.fit import least_squares
from smajax.fit.fit import WIDE, Fit
from smajax.fit.problem import Settings, build
from smajax.fit.searchable import residual
from smajax.plant.heat import PrescribedTemperature
from smajax.plant.plant import Plant
from smajax.recording import Recording
from smajax.rig_schema import as_text, channel_unit

_DRAWS = 3
_STEPS = 20
_LEAST, _MOST = 1e-4, 0.05  # of the column's range: less does nothing, more is no noise
_FOURTH = 70.0**0.5  # what a fourth difference makes of noise


def noise_of(values: np.ndarray) -> float:
    """Standard deviation of what a column (n,) goes up and down by from row to row, by its fourth differences; 0 where it does not."""
    fourth = np.diff(values, 4)
    fourth = fourth[np.isfinite(fourth)]
    found = 1.4826 * float(np.median(np.abs(fourth))) / _FOURTH if len(fourth) else 0.0
    span = float(np.nanmax(values) - np.nanmin(values))
    return found if _LEAST * span < found < _MOST * span else 0.0


def moved(result: Fit, plant: Plant, recordings: Sequence[Recording], settings: Settings) -> list[str]:
    """A sentence for each input column whose noise moves a parameter by more than half the width of its interval.

    ``plant`` and ``settings`` are those of the fit, ``recordings`` those that it was fitted to.
    """
    direct = [*(["temperature"] if isinstance(plant.heat, PrescribedTemperature) else []), *plant.mechanism.prescribed]
    told = []
    for channel in direct:
        noise = [noise_of(r.channels[channel]) for r in recordings]
        if not any(noise):
            continue
        away = np.mean([_refitted(result, plant, recordings, settings, channel, noise, k) for k in range(_DRAWS)], axis=0)
        far = []
        for estimate, moved_by in zip(result.estimates, away, strict=True):
            low, high = estimate.lower95, estimate.upper95
            if low is not None and high is not None and abs(moved_by) > 0.5 * (high - low):
                unit = "K" if estimate.unit == "degC" else estimate.unit
                sizes = [as_text(float(f"{v:.2g}"), unit) for v in (moved_by, 0.5 * (high - low))]
                far.append(f"{estimate.name} by {sizes[0]} (interval +- {sizes[1]})")
        if far:
            size = as_text(float(f"{max(noise):.2g}"), channel_unit(channel, difference=True))
            told.append(
                f"{channel} goes up and down by {size} from row to row, which the model takes as true. As much again moves "
                f"{', '.join(far)}: what is there has moved as far already, about. Smooth the column, or average rows, before the fit."
            )
    return told


def _refitted(
    result: Fit, plant: Plant, recordings: Sequence[Recording], settings: Settings, channel: str, noise: Sequence[float], seed: int
) -> np.ndarray:
    """How far the estimates (p,) go with the noise added once more; in the program of the fit."""
    rng = np.random.default_rng(seed)
    noisy = []
    for recording, size in zip(recordings, noise, strict=True):
        values = recording.channels[channel]
        shaken = values + size * rng.standard_normal(len(values))
        noisy.append(dataclasses.replace(recording, channels={**recording.channels, channel: shaken}))
    problem = build(plant, noisy, settings, interpolation=result.interpolation, step=result.step)
    starts = np.tile(result.vector, (result.starts, 1))
    search = least_squares.Search(residual, problem, starts, *problem.box, size=problem.size, apart=len(recordings) >= WIDE)
    solved = search.advance(_STEPS).result()
    scales = np.array([u.scale for u in result.problem.unknowns])
    return (solved.points[0] - result.vector) * scales
