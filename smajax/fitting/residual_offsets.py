"""Whether an offset of a sensor explains what a fit leaves: one that is too small to be seen in the first rows."""

from typing import NamedTuple

import numpy as np

from smajax.channels import channel_of
from smajax.fitting.problem import Problem

# Channels whose value is 0 as installed, by definition of the rig's coordinate.
ZERO_AS_INSTALLED = ("displacement", "angle")
# Least share of the excess over the noise that offsets explain. Chosen by trial between recordings with an offset and
# those of hidden effects; tests/unit/fitting/test_residual_offsets.py has examples of both.
_MIN_SHARE = 0.9
# Least size of an offset in standard errors for white noise: none by chance, also where the noise is slower.
_MIN_ERRORS = 5.0


class ResidualOffset(NamedTuple):
    """An offset of a channel that explains the residual above its noise.

    Attributes:
        channel: The channel.
        values: Offset in each training recording, internal unit.
        share: Share of the excess over the noise that the offsets explain, with the free parameters moved along.
    """

    channel: str
    values: tuple[float, ...]
    share: float


def residual_offsets(
    problem: Problem, residual: np.ndarray, jacobian: np.ndarray, floor: dict[str, float]
) -> tuple[ResidualOffset, ...]:
    """Fit an offset of each recording to the residual of a fit, to first order, in channels that are 0 as installed.

    With c a column of the weights in the rows of a recording, and J the Jacobian, min |r - C o - J d|^2.

    Args:
        problem: The problem.
        residual: The residual r at the end of the fit.
        jacobian: Its Jacobian J (m, p), of the parameters that are not at a bound.
        floor: Noise of the residual by channel, SI.

    Returns:
        The offset of each channel where it explains most of the residual above the noise and is not free.
    """
    weight = np.asarray(problem.data.weight)
    found: list[ResidualOffset] = []
    noise = [float(np.sum((weight[:, j] * floor[channel]) ** 2)) for j, channel in enumerate(problem.channels)]
    excess = float(np.sum(residual**2)) - sum(noise)
    if excess <= 0.0:
        return ()
    basis = np.linalg.qr(jacobian)[0]
    errors, rows = residual.reshape(weight.shape), basis.reshape(*weight.shape, basis.shape[1])
    along = basis.T @ residual
    for j, channel in enumerate(problem.channels):
        name = f"sensor.{channel}_offset"
        if channel_of(channel) not in ZERO_AS_INSTALLED or name in (*problem.shared, *problem.per_recording):
            continue
        # Normal equations of the columns c, orthogonal to J: c itself has the rows of one recording only.
        moved = np.einsum("kt,ktp->kp", weight[:, j], rows[:, j])
        normal = np.diag(np.sum(weight[:, j] ** 2, axis=1)) - moved @ moved.T
        slope = np.sum(weight[:, j] * errors[:, j], axis=1) - moved @ along
        values = np.linalg.lstsq(normal, slope, rcond=None)[0]
        explained = float(slope @ values)
        least = len(values) * (_MIN_ERRORS * float(np.max(weight[:, j])) * floor[channel]) ** 2
        if explained >= max(least, _MIN_SHARE * excess):
            found.append(ResidualOffset(channel, tuple(map(float, values)), min(explained / excess, 1.0)))
    return tuple(found)
