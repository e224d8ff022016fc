"""Fits of a rig and its effects to rows of a recording, with a Gaussian prior; one compiled program for all effects."""

from __future__ import annotations

import dataclasses
from collections.abc import Collection, Mapping, Sequence
from typing import Any

from experiments.common.base import say

import jax
import jax.numpy as jnp
import numpy as np
from equinox import Module

from smajax import parameters
from smajax.files.rig_file import Rig
from smajax.fitting import levenberg_marquardt as least_squares
from smajax.fitting.multi_start import MultiStartSolver
from smajax.fitting.problem import Problem, build_problem
from smajax.numerics.loop_kernels import jit_with_kernels
from smajax.plant.effects.base import AbstractEffect
from smajax.recordings.recording import Recording

# Section of a rig file: usual values of an actuator wire, where a log states none; fits start there.
NOMINAL_ALLOY = """[material]
martensite_start = "52 degC"
martensite_finish = "42 degC"
austenite_start = "68 degC"
austenite_finish = "78 degC"
clausius_clapeyron_austenite = "7 MPa/K"
clausius_clapeyron_martensite = "7 MPa/K"
modulus_austenite = "40 GPa"
modulus_martensite = "40 GPa"
detwinning_start_stress = "0 MPa"
max_transformation_strain = "4 %"
"""

STRENGTH_DEVIATION = 1.5  # prior of an effect's strength about 0, in typical strengths
SHAPE_DEVIATION = 1.0  # prior of an effect's shape about its nominal value, in units of that value or of 0.3
REFINED = (1, 8)  # numbers by which the time step of a simulation is divided in turn, until all steps are solved
DRAWN_STRENGTHS = (0.3, 2.0)  # range of the drawn strengths, in typical strengths
DRAWN_SHAPE = 0.3  # size of a drawn shape whose nominal value is 0
DRAWN_MARGIN = 0.01  # distance of drawn values from their bounds, as a share of the range


class PriorModel(Module):
    """A fit problem in which some parameters are fixed, with a Gaussian prior of the others.

    Attributes:
        problem: The fit problem, in which all parameters are free.
        is_free: Whether a parameter is free, shape ``(p,)``.
        prior_mean: Mean of the prior, and the value of a fixed parameter, shape ``(p,)``.
        prior_deviation: Standard deviation of the prior, shape ``(p,)``.
    """

    problem: Problem
    is_free: jax.Array
    prior_mean: jax.Array
    prior_deviation: jax.Array

    @property
    def size(self) -> int:
        """Number of residuals."""
        return self.problem.size + len(self.prior_mean)

    def residual(self, vector: jax.Array) -> jax.Array:
        """Return the residuals of the problem, followed by those of the prior over its standard deviation."""
        full = jnp.where(self.is_free, vector, self.prior_mean)
        prior = (vector - self.prior_mean) / self.prior_deviation
        return jnp.concatenate([self.problem.residual(full), prior])


def residual_of(vector: jax.Array, model: Any) -> jax.Array:
    """Return ``model.residual(vector)``, with the signature that the solver needs."""
    return model.residual(vector)


@jit_with_kernels
def predict(model: Any, vector: jax.Array) -> tuple[jax.Array, jax.Array]:
    """Return ``model.predict(vector)``, compiled."""
    return model.predict(vector)


@dataclasses.dataclass(frozen=True)
class EffectFit:
    """The end of a fit.

    Attributes:
        values: Values of all parameters in internal units, by name.
        effects: Keys of the effects.
        cost: The cost at the end, prior included.
        status: Why the solver stopped.
    """

    values: Mapping[str, float]
    effects: tuple[str, ...]
    cost: float
    status: least_squares.SolverStatus


class EffectFitter:
    """Fits of a rig with any of the candidate effects, of which those without a place in the fit have strength 0.

    Attributes:
        rig: The rig; its free parameters are those of the base model.
        kinds: The candidate effects by key.
        prior_deviation: Standard deviations of the rig's parameters, in internal units by name.
        step: Longest time step, s.
    """

    def __init__(
        self,
        rig: Rig,
        kinds: Mapping[str, type[AbstractEffect]],
        prior_deviation: Mapping[str, float],
        recordings: Sequence[Recording],
        step: float,
    ):
        self.rig, self.kinds, self.prior_deviation, self.step = rig, kinds, prior_deviation, step
        plant = dataclasses.replace(rig.plant, effects=tuple(kind() for kind in kinds.values()))
        self.plant = plant
        names = [f"effects.{key}.{name}" for key, kind in kinds.items() for name in parameters.declarations(kind)]
        self.settings = dataclasses.replace(rig.fit, free=(*rig.fit.free, *names))
        self.recordings = {recording.name: recording for recording in recordings}
        self.first = self._scaled(self._build(recordings[0]))
        self.names = [unknown.name for unknown in self.first.unknowns]

    def _build(self, recording: Recording, refined: int = 1) -> Problem:
        step = self.step / refined
        return build_problem(self.plant, [recording], self.settings, step=step)

    def _scaled(self, problem: Problem) -> Problem:
        """Return the problem with an effect's typical strength as the scale of its strength."""
        scales = []
        for unknown in problem.unknowns:
            is_strength = unknown.name.startswith("effects.") and unknown.name.endswith(".strength")
            scales.append(abs(self.kinds[unknown.name.split(".")[1]].typical) if is_strength else unknown.scale)
        unknowns = tuple(dataclasses.replace(u, scale=s) for u, s in zip(problem.unknowns, scales, strict=True))
        return dataclasses.replace(problem, unknowns=unknowns, scales=jnp.asarray(scales))

    def problem(self, recording: Recording, refined: int = 1) -> Problem:
        """Return the problem of a recording, with the unknowns and scales of the first one.

        Args:
            recording: The recording.
            refined: Number by which the longest time step is divided.
        """
        return dataclasses.replace(self.first, data=self._build(recording, refined).data)

    def model(self, recording: Recording, effects: Collection[str]) -> PriorModel:
        """Build the model in which the rig's parameters and those of some effects are free.

        Args:
            recording: The recording; rows in which a channel is NaN do not count.
            effects: Keys of the effects.
        """
        mean, deviation, free = np.array(self.first.nominal), np.ones(len(self.names)), np.ones(len(self.names), bool)
        for i, unknown in enumerate(self.first.unknowns):
            if not unknown.name.startswith("effects."):
                deviation[i] = self.prior_deviation[unknown.name] / unknown.scale
                continue
            key = unknown.name.split(".")[1]
            free[i] = key in effects
            if unknown.name.endswith(".strength"):
                mean[i], deviation[i] = 0.0, STRENGTH_DEVIATION
            else:
                deviation[i] = SHAPE_DEVIATION * max(abs(mean[i]), 0.3 / unknown.scale)
        return PriorModel(self.problem(recording), *map(jnp.asarray, (free, mean, deviation)))

    def start(self, values: Mapping[str, float]) -> np.ndarray:
        """Return the vector of the rig's values, with some values in internal units by name."""
        vector = np.array(self.first.nominal)
        for i, unknown in enumerate(self.first.unknowns):
            if unknown.name in values:
                vector[i] = values[unknown.name] / unknown.scale
            elif unknown.name.startswith("effects.") and unknown.name.endswith(".strength"):
                vector[i] = 0.0
        return vector

    def draw_starts(self, effects: Collection[str], times: int, seed: int) -> list[dict[str, float]]:
        """Draw start points: the rig's parameters from their prior, those of effects around their usual size.

        Args:
            effects: Keys of the effects.
            times: Number of start points.
            seed: Seed of the draws.
        """
        random, starts = np.random.default_rng(seed), []
        for _ in range(times):
            start = {}
            for unknown in self.first.unknowns:
                name, (lower, upper) = unknown.name, (unknown.lower, unknown.upper)
                if not name.startswith("effects."):
                    value = unknown.nominal + self.prior_deviation[name] * random.standard_normal()
                elif name.split(".")[1] not in effects:
                    continue
                elif name.endswith(".strength"):
                    value = self.kinds[name.split(".")[1]].typical * random.uniform(*DRAWN_STRENGTHS)
                else:
                    value = max(abs(unknown.nominal), DRAWN_SHAPE) * np.exp(random.standard_normal())
                inside = DRAWN_MARGIN * (upper - lower) if np.isfinite(upper - lower) else 0.0
                start[name] = float(np.clip(value, lower + inside, upper - inside))
            starts.append(start)
        return starts

    def fit(
        self, recording: Recording, effects: Collection[str], starts: Sequence[Mapping[str, float]], steps: int
    ) -> list[EffectFit]:
        """Fit a recording from several start points.

        Args:
            recording: The recording.
            effects: Keys of the effects.
            starts: Start points: values in internal units by name; those of the rig for the others.
            steps: Largest number of solver steps.

        Returns:
            The fits, the best first.
        """
        model = self.model(recording, effects)
        lower, upper = self.first.bounds
        fits = []
        for start in starts:
            vector = np.where(model.is_free, self.start(start), model.prior_mean)
            vector = np.clip(vector, lower, upper)
            search = MultiStartSolver(residual_of, model, vector[None], lower, upper, size=model.size, rtol=1e-4)
            result = search.advance(steps).result()
            full = np.where(model.is_free, result.points[0], model.prior_mean)
            values = {u.name: float(v * u.scale) for u, v in zip(self.first.unknowns, full, strict=True)}
            fits.append(EffectFit(values, tuple(effects), float(result.costs[0]), result.statuses[0]))
        return sorted(fits, key=lambda f: f.cost if np.isfinite(f.cost) else np.inf)

    def predict(self, recording: Recording, fitted: EffectFit) -> dict[str, np.ndarray]:
        """Simulate a recording with the values of a fit; with shorter steps if one cannot be solved.

        Args:
            recording: The recording.
            fitted: The fit.

        Returns:
            The modelled channels, shape ``(rows,)``, by name; infinite if the simulation failed, so that no error is
            hidden.
        """
        vector = jnp.asarray([fitted.values[u.name] / u.scale for u in self.first.unknowns])
        for refined in REFINED:
            modelled, status = predict(self.problem(recording, refined), vector)
            series = np.asarray(modelled)[0, :, : len(recording)]
            if not int(status[0]):
                break
            say(f"{recording.name}: a step of {self.step / refined:g} s could not be solved")
            series = np.full_like(series, np.inf)
        return dict(zip(self.first.channels, series, strict=True))
