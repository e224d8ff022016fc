"""Fits of a soft arm's logs together: wires that are alike, a prior from data sheets, and one compiled program."""

from __future__ import annotations

import dataclasses
from collections.abc import Collection, Sequence
from concurrent.futures import ThreadPoolExecutor

from experiments.common.arm_effects import ARM_EFFECTS
from experiments.common.arm_log import Log
from experiments.common.arm_model import LEVER, RIG, Model, linearise, rms, split_log
from experiments.common.arm_priors import CONSTANT, PRIORS, SPREAD
from experiments.common.base import say
from experiments.common.effect_fit import predict

import jax.numpy as jnp
import numpy as np

from smajax import parameters
from smajax.files.rig_file import parse_rig
from smajax.fitting.problem import Problem, build_problem
from smajax.plant.effects import catalogue
from smajax.recordings.recording import Recording

STEP = 2.0  # s; longest step of a simulation, in the tail of a pulse
START_DEVIATION = 0.8  # standard deviation of drawn start points, in those of the prior
HOP_DEVIATIONS = 0.1, 0.3  # the same of points around the best fit, in turn
CONTINUED_SHARE = 4  # of so many fits with wide priors one is continued
FIRST_DAMPING, LAST_DAMPING = 1e-2, 1e6  # at which a fit begins, and at which it ends where no step gains
RELATIVE_TOLERANCE = 1e-5  # of the cost, which a step has to gain
FAILED = 1e3  # residual that stands for one that is not finite


@dataclasses.dataclass(frozen=True)
class ArmFit:
    """A fit of all logs.

    Attributes:
        values: The parameters of each log, shape ``(logs, p)``, in internal units.
        cost: Half the sum of squares at the end, prior included.
        message: Why the solver stopped.
    """

    values: np.ndarray
    cost: float
    message: str


class ArmFitter:
    """Fits of all logs together.

    Attributes:
        names: Names of all parameters, those of the rig first.
        parts: Recordings of each log by role.
    """

    def __init__(self, logs: Sequence[Log], effects: Sequence[str]):
        rig = parse_rig(RIG, "softlimb.toml")
        kinds = {**catalogue(), **ARM_EFFECTS}
        self.logs, self.effects = logs, tuple(effects)
        self.plant = dataclasses.replace(rig.plant, effects=tuple(kinds[key]() for key in effects))
        self.settings, self.noise = rig.fit, rig.fit.noise
        own = tuple(f"effects.{key}.{n}" for key in effects for n in parameters.declarations(kinds[key]))
        self.parts = [split_log(log) for log in logs]
        first: Problem | None = None
        self.models: list[dict[str, Model]] = []
        for recordings in self.parts:
            built = {role: self._build(recording) for role, recording in recordings.items()}
            first = first or built["train"]
            problems = {role: dataclasses.replace(first, data=p.data) for role, p in built.items()}
            self.models.append({role: Model(problem, own) for role, problem in problems.items()})
        assert first is not None
        self.names = tuple(u.name for u in first.unknowns) + own
        declared = [parameters.declaration(self.plant, n) for n in own]
        self.units = [u.unit for u in first.unknowns] + [d.unit for d in declared]
        limits = [(u.lower, u.upper) for u in first.unknowns] + [(d.lower, d.upper) for d in declared]
        self.limits = np.array(limits).T

    def _build(self, recording: Recording) -> Problem:
        return build_problem(self.plant, [recording], self.settings, step=STEP)

    def fit(
        self,
        role: str,
        without: Collection[str] = (),
        starts: int = 1,
        hops: int = 0,
        steps: int = 80,
        before: ArmFit | None = None,
    ) -> list[ArmFit]:
        """Fit a part of all logs from several points, and again from points around the best one.

        Where a prior has a wide first stage, all start points are fitted with that, and the best of these fits are
        start points of the problem that counts.

        Args:
            role: Role of the recordings, a key of ``split_log``.
            without: Keys of effects that are left out.
            starts: Number of start points: the mean of the prior, and draws from it.
            hops: Number of restarts from points drawn around the best fit so far.
            steps: Largest number of solver steps of each.
            before: A fit at which the only start point lies instead.

        Returns:
            The fits of the problem that counts, the best first.
        """
        joint, random = JointProblem(self, role, without), np.random.default_rng(1)
        if before is not None:
            points = [joint.point(before.values)]
        elif joint.has_first_stage:
            points = self._first_stage(role, without, starts, steps, joint)
        else:
            points = joint.draw_starts(starts)
        fits = [joint.solve(point, steps) for point in points]
        best = min(fits, key=lambda f: f.cost)
        say(f"{role}: cost {best.cost:.1f} is the lowest of {len(fits)}")
        for k in range(hops):
            deviation = HOP_DEVIATIONS[k % len(HOP_DEVIATIONS)]
            fits.append(joint.solve(joint.point(best.values) + deviation * random.standard_normal(joint.size), steps))
            best = min(best, fits[-1], key=lambda f: f.cost)
        if hops:
            again = joint.solve(joint.point(best.values), steps)  # with little damping: a corner may have stopped it
            fits = [again if f is best and again.cost < best.cost else f for f in fits]
            best = min(fits, key=lambda f: f.cost)
            say(f"{role}: cost {best.cost:.1f} is the lowest of {len(fits)}")
        return sorted(fits, key=lambda f: f.cost)

    def _first_stage(
        self, role: str, without: Collection[str], starts: int, steps: int, joint: JointProblem
    ) -> list[np.ndarray]:
        """Return start points of a problem: the best fits of the same one with wide priors."""
        wide = JointProblem(self, role, without, is_first_stage=True)
        fits = sorted((wide.solve(point, steps) for point in wide.draw_starts(starts)), key=lambda f: f.cost)
        say(f"{role}, wide priors: cost {fits[0].cost:.1f} is the lowest of {len(fits)}")
        return [joint.point(fit.values) for fit in fits[: max(1, starts // CONTINUED_SHARE)]]

    def residuals(self, log: int, role: str, fitted: ArmFit) -> tuple[np.ndarray, np.ndarray]:
        """Return measured minus modelled temperature (K) and bend (deg) of a part, NaN where nothing was measured.

        Args:
            log: Index of the log.
            role: Role of the recording.
            fitted: The fit.
        """
        model = self.models[log][role]
        predicted, _ = predict(model, jnp.asarray(fitted.values[log]))
        data, count = model.problem.data, len(self.parts[log][role])
        difference = np.asarray(data.measured[0] - predicted[0])
        residual = np.where(np.asarray(data.weight[0]) > 0, difference, np.nan)[:, :count]
        return residual[0], np.degrees(residual[1] / LEVER)

    def predict(self, log: int, fitted: ArmFit, recording: Recording) -> tuple[np.ndarray, np.ndarray]:
        """Predict the temperature (degC) and the displacement (m) of a wire at the rows of another recording.

        The wire starts at the recording's first temperature, and the arm at its rest.

        Args:
            log: Index of the log of the wire.
            fitted: The fit.
            recording: Duty, temperature and displacement; only the duty and the first temperature are used.
        """
        values = dict(zip(self.names, fitted.values[log], strict=True))
        start = recording.channels["temperature"][0]
        values |= {"initial.temperature": start}
        if "effects.rest-offset.strength" in values:
            values["effects.rest-offset.strength"] = 0.0
        if not np.any(recording.channels["duty"]):  # the fitted ambient is that after a pulse, which warms the body
            values["environment.ambient"] = min(values["environment.ambient"], start)
        model = dataclasses.replace(
            self.models[log]["fitted"],
            problem=dataclasses.replace(self.models[log]["fitted"].problem, data=self._build(recording).data),
        )
        predicted, _ = predict(model, jnp.asarray([values[n] for n in self.names]))
        temperature, displacement = np.asarray(predicted[0])[:, : len(recording)]
        return temperature, displacement

    def score(self, role: str, fitted: ArmFit) -> float:
        """Return the RMS of a part's residuals over their noise, pooled over logs and channels."""
        noise = self.noise["temperature"], float(np.degrees(self.noise["displacement"] / LEVER))
        residuals = [self.residuals(i, role, fitted) for i in range(len(self.logs))]
        return rms([r[c] / noise[c] for r in residuals for c in (0, 1)])

    def errors(self, role: str, fitted: ArmFit) -> tuple[float, float]:
        """Return the pooled RMSE of a part in K and deg."""
        residuals = [self.residuals(i, role, fitted) for i in range(len(self.logs))]
        return rms([r[0] for r in residuals]), rms([r[1] for r in residuals])


class JointProblem:
    """The joint fit of all logs as a least-squares problem in units of the prior's standard deviations.

    The vector has the shared parameters first, and then log by log its own parameters and the deviations of its wire
    from the shared ones.

    Attributes:
        fitter: The fits.
        role: Role of the recordings.
        shared: Indices of the shared parameters.
        own: Indices of the parameters of each log.
        has_first_stage: Whether a prior of it has a first stage.
        limits: Bounds of all parameters, shape ``(2, p)``.
    """

    def __init__(self, fitter: ArmFitter, role: str, without: Collection[str], is_first_stage: bool = False):
        self.fitter, self.role = fitter, role
        left_out = [name.startswith("effects.") and name.split(".")[1] in without for name in fitter.names]
        priors = [None if out else PRIORS.get(n) for n, out in zip(fitter.names, left_out, strict=True)]
        self.shared = np.array([i for i, p in enumerate(priors) if p is not None and not p.is_own])
        self.own = np.array([i for i, p in enumerate(priors) if p is not None and p.is_own])
        self.has_first_stage = any(p is not None and p.first_deviation > 0.0 for p in priors)
        self.deviation = np.array([p.stage_deviation(is_first_stage) if p else 1.0 for p in priors])
        self.limits = fitter.limits.copy()
        for i, prior in enumerate(priors):
            if prior is not None and prior.limits is not None and not is_first_stage:
                self.limits[:, i] = prior.limits
        constant = {n: 0.0 if out else CONSTANT.get(n, 0.0) for n, out in zip(fitter.names, left_out, strict=True)}
        middle = [
            p.mean if p else constant[n] if n.endswith(".strength") else float(parameters.get(fitter.plant, n))
            for n, p in zip(fitter.names, priors, strict=True)
        ]
        self.mean = np.tile(middle, (len(fitter.logs), 1))
        for name in ("initial.temperature", "environment.ambient"):
            self.mean[:, fitter.names.index(name)] = [log.start_temperature for log in fitter.logs]
        self.weighted = [
            np.flatnonzero(np.asarray(models[role].problem.data.weight).ravel() > 0) for models in fitter.models
        ]

    @property
    def size(self) -> int:
        """Length of the vector."""
        return len(self.shared) + len(self.fitter.logs) * (len(self.own) + len(self.shared))

    def _slices(self, log: int) -> tuple[slice, slice, slice]:
        """Places of the shared parameters, those of a log and its deviations in the vector."""
        shared, own = len(self.shared), len(self.own)
        begin = shared + log * (own + shared)
        return slice(0, shared), slice(begin, begin + own), slice(begin + own, begin + own + shared)

    def values(self, point: np.ndarray) -> np.ndarray:
        """Return the parameters of each log at a point, within their bounds, shape ``(logs, p)``."""
        values = self.mean.copy()
        for log in range(len(values)):
            common, own, deviation = self._slices(log)
            values[log, self.shared] += self.deviation[self.shared] * (point[common] + SPREAD * point[deviation])
            values[log, self.own] += self.deviation[self.own] * point[own]
        return np.clip(values, *self.limits)

    def point(self, values: np.ndarray) -> np.ndarray:
        """Return the point of given parameters of each log, with the means over the logs as shared ones.

        Args:
            values: The parameters, shape ``(logs, p)``.
        """
        point = np.zeros(self.size)
        distance = (values - self.mean) / self.deviation
        middle = np.mean(distance[:, self.shared], axis=0)
        for log in range(len(values)):
            common, own, deviation = self._slices(log)
            point[common], point[own] = middle, distance[log, self.own]
            point[deviation] = (distance[log, self.shared] - middle) / SPREAD
        return point

    def bounds(self) -> tuple[np.ndarray, np.ndarray]:
        """Return the bounds of the vector."""
        bounds = np.array([np.full(self.size, -np.inf), np.full(self.size, np.inf)])
        for log in range(len(self.mean)):
            common, own, _ = self._slices(log)
            for place, index in ((common, self.shared), (own, self.own)):
                bounds[:, place] = (self.limits[:, index] - self.mean[log, index]) / self.deviation[index]
        return bounds[0], bounds[1]

    def draw_starts(self, count: int, seed: int = 0) -> list[np.ndarray]:
        """Return start points: the mean of the prior and draws, with the first bend as offset from rest."""
        random = np.random.default_rng(seed)
        points = [START_DEVIATION * (k > 0) * random.standard_normal(self.size) for k in range(count)]
        names = [self.fitter.names[i] for i in self.own]
        for point in points:
            for log, data in enumerate(self.fitter.logs):
                _, own, deviation = self._slices(log)
                point[own], point[deviation] = 0.0, 0.0
                if "effects.rest-offset.strength" in names:
                    first = float(data.bend[np.isfinite(data.bend)][1])  # the first one is filtered by the tracker
                    offset = np.radians(first) * LEVER / PRIORS["effects.rest-offset.strength"].deviation
                    point[own.start + names.index("effects.rest-offset.strength")] = offset
        return points

    def _linearise(self, point: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Return the residuals and their Jacobian, those of the prior last."""
        values = self.values(point)
        with ThreadPoolExecutor(2) as pool:
            models = [models[self.role] for models in self.fitter.models]
            parts = list(pool.map(lambda log: linearise(models[log], jnp.asarray(values[log])), range(len(models))))
        residuals, jacobians = [], []
        for log, (residual, jacobian) in enumerate(parts):
            rows = self.weighted[log]
            residual = np.nan_to_num(np.asarray(residual)[rows], nan=FAILED, posinf=FAILED, neginf=-FAILED)
            jacobian = np.nan_to_num(np.asarray(jacobian)[rows]) * self.deviation
            common, own, deviation = self._slices(log)
            columns = np.zeros((len(rows), self.size))
            columns[:, common] = jacobian[:, self.shared]
            columns[:, deviation] = SPREAD * jacobian[:, self.shared]
            columns[:, own] = jacobian[:, self.own]
            residuals.append(residual)
            jacobians.append(columns)
        return np.concatenate([*residuals, point]), np.concatenate([*jacobians, np.eye(self.size)])

    def solve(self, point: np.ndarray, steps: int) -> ArmFit:
        """Fit from a start point, by Levenberg and Marquardt's method; steps end at the bounds.

        It ends after three steps in a row that gain little: one such step may only be one that a corner of the model
        has cut short.

        Args:
            point: The start point.
            steps: Largest number of evaluations.
        """
        lower, upper = self.bounds()
        point = np.clip(point, lower, upper)
        residual, jacobian = self._linearise(point)
        cost, damping, small_steps = 0.5 * float(residual @ residual), FIRST_DAMPING, 0
        for _ in range(steps):
            gradient, curvature = jacobian.T @ residual, jacobian.T @ jacobian
            free = ~((point <= lower) & (gradient > 0) | (point >= upper) & (gradient < 0))
            damped = curvature + damping * np.diag(np.diag(curvature))
            step = np.zeros(len(point))
            step[free] = -np.linalg.solve(damped[np.ix_(free, free)], gradient[free])
            trial = np.clip(point + step, lower, upper)
            trial_residual, trial_jacobian = self._linearise(trial)
            gain = cost - 0.5 * float(trial_residual @ trial_residual)
            small_steps = small_steps + 1 if gain < RELATIVE_TOLERANCE * cost else 0
            if gain > 0:
                point, residual, jacobian, cost = trial, trial_residual, trial_jacobian, cost - gain
            damping = damping / 4 if gain > 0 else damping * 3
            if damping > LAST_DAMPING or (small_steps >= 3 and gain > 0):
                return ArmFit(self.values(point), cost, "the cost falls by less than its tolerance")
        return ArmFit(self.values(point), cost, "the steps are used up")
