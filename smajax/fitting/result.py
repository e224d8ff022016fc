"""The result of a fit: estimates with intervals, responses, and how the search ended."""

import dataclasses
import math

import numpy as np

from smajax.fitting.collinearity import CollinearGroup
from smajax.fitting.electrical_noise import InputNoise
from smajax.fitting.levenberg_marquardt import SolverStatus
from smajax.fitting.problem import Problem
from smajax.fitting.residual_offsets import ResidualOffset
from smajax.fitting.transformation_check import TransformationGap
from smajax.plant.plant import Plant
from smajax.recordings.recording import Recording
from smajax.simulation.status import SimulationStatus


@dataclasses.dataclass(frozen=True)
class Estimate:
    """One parameter after a fit, in its internal unit.

    Attributes:
        name: ``section.key``, followed by ``@recording`` where each recording has its own.
        estimate: Its value.
        lower95: Lower end of the 95 % interval; ``None`` at a bound and where the data do not determine the parameter.
        upper95: Upper end of the interval.
        unit: Internal unit.
        at_bound: Whether it is at a bound beyond which the cost falls further.
        bounds: Lower and upper bound.
    """

    name: str
    estimate: float
    lower95: float | None
    upper95: float | None
    unit: str
    at_bound: bool
    bounds: tuple[float, float]


@dataclasses.dataclass(frozen=True)
class Response:
    """A plant's response to one recording.

    Attributes:
        recording: The recording with the measured channels.
        role: ``train`` or ``holdout``.
        model: Modelled channels by name (n,), SI and degC.
        status: Status of the simulation.
    """

    recording: Recording
    role: str
    model: dict[str, np.ndarray]
    status: SimulationStatus

    def residual(self, channel: str) -> np.ndarray:
        """Return measurement minus model of a channel, shape ``(n,)``, SI; NaN where it was not measured."""
        return self.recording.channels[channel] - self.model[channel]

    def rmse(self, channel: str) -> float:
        """Return the root mean square of a channel's residual, SI; NaN if nothing was measured, or it failed."""
        if self.status is not SimulationStatus.done:
            return math.nan
        residual = self.residual(channel)
        measured = residual[np.isfinite(residual)]
        return float(np.sqrt(np.mean(measured**2))) if len(measured) else math.nan


@dataclasses.dataclass(frozen=True)
class FitResult:
    """The result of a fit.

    Attributes:
        problem: The fit problem.
        plant: The fitted plant for any other recording.
        plants: The fitted plant of each training recording.
        estimates: Estimates of the unknowns, in the problem's order.
        covariance: Covariance of the estimates (p, p), internal units; NaN for those at a bound.
        collinear_groups: Parameters whose effects the data cannot distinguish.
        responses: Responses to the training and then the holdout recordings.
        noise_floor: Noise of the residual by channel, SI: from its second differences, at least the channel's rounding.
        cost: Sum of squares of the weighted residual.
        starts_at_best: Number of starts that ended within a thousandth of the best cost.
        starts: Number of starts.
        status: Why the best search ended.
        steps: Steps of the search.
        simulations: Number of simulations of one recording; each column of a Jacobian counts as one.
        wall_time: Time of the search, s.
        compile_time: Time of compiling, s.
        history: After each step: simulations, wall time in s, best cost.
        seed: Seed of the random starts.
        vector: The problem's vector (p,).
        interpolation: Electrical inputs between samples.
        step: Longest time step in s; ``None`` for the plant's default.
        discretisation_errors: Error of the time steps by channel (RMS), SI.
        start_gap: How far the wire is from transforming at the start values; ``None`` where it transforms, or where no
            parameter of the transformations is free.
        end_gap: The same at the estimates.
        input_noise: Noise of each electrical input, whose effect the estimates and the intervals contain.
        offsets: Offsets of sensors that would explain a part of the residual.
    """

    problem: Problem
    plant: Plant
    plants: tuple[Plant, ...]
    estimates: tuple[Estimate, ...]
    covariance: np.ndarray
    collinear_groups: tuple[CollinearGroup, ...]
    responses: tuple[Response, ...]
    noise_floor: dict[str, float]
    cost: float
    starts_at_best: int
    starts: int
    status: SolverStatus
    steps: int
    simulations: int
    wall_time: float
    compile_time: float
    history: tuple[tuple[int, float, float], ...]
    seed: int
    vector: np.ndarray
    interpolation: str
    step: float | None
    discretisation_errors: dict[str, float]
    start_gap: TransformationGap | None = None
    end_gap: TransformationGap | None = None
    input_noise: tuple[InputNoise, ...] = ()
    offsets: tuple[ResidualOffset, ...] = ()

    @property
    def correlation(self) -> np.ndarray:
        """Correlations of the estimates, shape ``(p, p)``; NaN where a variance is not finite."""
        deviation = np.sqrt(np.diag(self.covariance))
        with np.errstate(invalid="ignore", divide="ignore"):
            return self.covariance / np.outer(deviation, deviation)

    def rmse(self, channel: str, role: str = "train") -> float | None:
        """Return the pooled RMSE of a channel over the recordings of one role.

        Args:
            channel: Name of the channel.
            role: ``train`` or ``holdout``.

        Returns:
            The RMSE, SI; ``None`` where nothing was measured, or where a simulation failed.
        """
        if any(r.role == role and r.status is not SimulationStatus.done for r in self.responses):
            return None
        residuals = [r.residual(channel) for r in self.responses if r.role == role]
        measured = np.concatenate([r[np.isfinite(r)] for r in residuals]) if residuals else np.zeros(0)
        return float(np.sqrt(np.mean(measured**2))) if len(measured) else None
