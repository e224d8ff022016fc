"""The effect of noise in a fit's input columns on its parameters.

A material law takes the temperatures, stresses and strains that drive it as exact. Where these scatter from row to row,
a hysteretic law oscillates, and the bias of its parameters may exceed their intervals, which account for the noise of
the fitted channels only. The bias is estimated by adding noise of the same size once more and fitting again from the
end of the fit: the estimates change about as much as they have by the noise of the recording (the first step of
simulation-extrapolation). Noise of currents and voltages is averaged by the wire's heat capacity.

Source: cook1994.
"""

import dataclasses
from collections.abc import Sequence

import numpy as np

from smajax.channels import channel_unit
from smajax.fitting.abstract_problem import residual
from smajax.fitting.multi_start import LAZY_FROM, MultiStartSolver
from smajax.fitting.noise import row_noise
from smajax.fitting.problem import build_problem
from smajax.fitting.result import FitResult
from smajax.fitting.unknowns import Settings
from smajax.plant.heat import PrescribedTemperature
from smajax.plant.plant import Plant
from smajax.recordings.recording import Recording
from smajax.units import as_text

# Random samples of the added noise whose effects are averaged; chosen by trial, tests/unit/fitting/test_input_noise.py
# holds it.
_DRAWS = 3
# Most steps of a fit with added noise, which starts at the end of the first fit; chosen by trial, held by the same
# tests.
_MAX_STEPS = 20
# Least bias that is reported, as a share of the interval's width: a bias of half the width alone puts the true value
# outside the interval.
_REPORTED_SHARE = 0.5


def input_noise_warnings(
    result: FitResult, plant: Plant, recordings: Sequence[Recording], settings: Settings
) -> list[str]:
    """Return a sentence for each input column whose noise biases a parameter by more than half its interval's width.

    Args:
        result: A fit.
        plant: The plant with the start values of the fit.
        recordings: The training recordings of the fit.
        settings: The settings of the fit.

    Returns:
        The sentences; none where the input columns are free of noise.
    """
    temperature = ["temperature"] if isinstance(plant.heat, PrescribedTemperature) else []
    warnings = []
    for channel in [*temperature, *plant.mechanism.prescribed]:
        noise = [row_noise(r.channels[channel]) for r in recordings]
        if not any(noise):
            continue
        changes = [_refit_change(result, plant, recordings, settings, channel, noise, k) for k in range(_DRAWS)]
        biases = _large_biases(result, np.mean(changes, axis=0))
        if biases:
            size = as_text(float(f"{max(noise):.2g}"), channel_unit(channel, difference=True))
            warnings.append(
                f"{channel} scatters by {size} from row to row, and the model takes it as exact. Adding the same "
                f"noise once more changes {', '.join(biases)}: the noise in the recording has biased the estimates "
                "by about as much. Smooth the column, or average rows, before the fit."
            )
    return warnings


def _large_biases(result: FitResult, changes: np.ndarray) -> list[str]:
    """The parameters whose ``changes`` (p,) exceed half the width of their intervals, in words."""
    biases = []
    for estimate, bias in zip(result.estimates, changes, strict=True):
        low, high = estimate.lower95, estimate.upper95
        if low is not None and high is not None and abs(bias) > _REPORTED_SHARE * (high - low):
            unit = "K" if estimate.unit == "degC" else estimate.unit
            change, half_width = (as_text(float(f"{v:.2g}"), unit) for v in (bias, 0.5 * (high - low)))
            biases.append(f"{estimate.name} by {change} (interval +- {half_width})")
    return biases


def _refit_change(
    result: FitResult,
    plant: Plant,
    recordings: Sequence[Recording],
    settings: Settings,
    channel: str,
    noise: Sequence[float],
    seed: int,
) -> np.ndarray:
    """Change of the estimates (p,), internal units, when noise is added to a channel; same program as the fit's."""
    rng = np.random.default_rng(seed)
    noisy = []
    for recording, deviation in zip(recordings, noise, strict=True):
        values = recording.channels[channel]
        scattered = values + deviation * rng.standard_normal(len(values))
        noisy.append(dataclasses.replace(recording, channels={**recording.channels, channel: scattered}))
    problem = build_problem(plant, noisy, settings, interpolation=result.interpolation, step=result.step)
    starts = np.tile(result.vector, (result.starts, 1))
    lazy = len(recordings) >= LAZY_FROM
    solver = MultiStartSolver(residual, problem, starts, *problem.bounds, size=problem.size, lazy_jacobian=lazy)
    point = solver.advance(_MAX_STEPS).result().points[0]
    scales = np.array([u.scale for u in result.problem.unknowns])
    return (point - result.vector) * scales
