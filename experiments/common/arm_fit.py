"""Fits of a soft arm's logs: a plant with all candidate effects, and a prior from data sheets."""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor

from experiments.common.arm_effects import ARM_EFFECTS
from experiments.common.arm_log import Log, reading_shift
from experiments.common.effect_fit import predict, residual_of

import jax
import jax.numpy as jnp
import numpy as np
from equinox import Module, field

from smajax import parameters
from smajax.files.rig_file import parse_rig
from smajax.fitting import levenberg_marquardt as least_squares
from smajax.fitting.multi_start import MultiStartSolver
from smajax.fitting.problem import Problem, build_problem
from smajax.plant.effects import catalogue
from smajax.recordings.recording import Recording

LEVER = 0.003  # m of wire per rad of bend; nominal, since max_transformation_strain scales with it


RIG = """
schema = 1
[rig]
kind = "bias-spring"
control = "duty"
[drive]
supply = "2.5 V"
[material]
martensite_start = "60 degC"
martensite_finish = "-190 degC"
austenite_start = "60 degC"
austenite_finish = "100 degC"
clausius_clapeyron_austenite = "7 MPa/K"
clausius_clapeyron_martensite = "7 MPa/K"
modulus_austenite = "40 GPa"
modulus_martensite = "40 GPa"
detwinning_start_stress = "0 MPa"
detwinning_finish_stress = "100 MPa"
max_transformation_strain = "1.5 %"
[heat]
h0 = "60 W/m^2/K"
capacity = "3 MJ/m^3/K"
[wire]
diameter = "0.25 mm"
length = "100 mm"
[spring]
preload = "5 N"
stiffness = "6.7 N/mm"
[environment]
ambient = "22 degC"
[initial]
temperature = "22 degC"
[fit]
free = ["drive.supply", "heat.h0", "environment.ambient", "initial.temperature",
        "material.austenite_shift", "material.austenite_finish",
        "material.martensite_start", "material.detwinning_finish_stress", "material.max_transformation_strain",
        "sensor.displacement_offset"]
observe = ["temperature", "displacement"]
noise = { temperature = "1 K", displacement = "0.015 mm" }
starts = 1
[fit.bounds]
"drive.supply" = ["0.1 V", "10 V"]
"heat.h0" = ["3 W/m^2/K", "400 W/m^2/K"]
"environment.ambient" = ["15 degC", "30 degC"]
"initial.temperature" = ["15 degC", "60 degC"]
"material.austenite_shift" = ["-80 K", "100 K"]
"material.austenite_finish" = ["62 degC", "200 degC"]
"material.martensite_start" = ["0 degC", "150 degC"]
"material.detwinning_finish_stress" = ["5 MPa", "400 MPa"]
"material.max_transformation_strain" = ["0.5 %", "10 %"]
"""

SLOTS = 14  # most effects' parameters that a fit moves
# Prior standard deviations about the rig's values (SI, K), from data sheets of such wires; drive and convection are
# known to within a factor only.
PRIOR_DEVIATION = {
    "drive.supply": 0.5,
    "heat.h0": 30.0,
    "environment.ambient": 2.0,
    "initial.temperature": 0.3,  # about the first reading of the log; the body and its thermocouple are at rest then
    "material.austenite_shift": 10.0,
    "material.austenite_finish": 15.0,
    "material.martensite_start": 15.0,
    "material.detwinning_finish_stress": 4e7,
    "material.max_transformation_strain": 5e-3,
    "sensor.displacement_offset": 1e-4,
}
STRENGTH_DEVIATION = 1.5  # prior of an effect's strength about 0, in typical strengths
SHAPE_DEVIATION = 1.0  # prior of an effect's shape about its nominal value, in units of that value
BASE_STARTS = 8  # with 3 the base fit may stay where the wire never transforms, so that any effect improves it
DENSE_SECONDS = 40.0  # s after the first pulse in which all rows are kept
TAIL_SECONDS = 1.1  # s between rows after that
BLOCK_SECONDS = 2.0  # s; every third block is the selection part


def split_log(log: Log) -> dict[str, Recording]:
    """Split a log into recordings.

    Each covers the whole log; its channels are NaN outside the rows of its role, and a temperature stands in a
    separate row, at the time when it was taken. Before the scored part, the slow tail of a pulse is thinned.

    Returns:
        Recordings by role: ``train`` and ``select`` together make ``fitted``, ``held`` is scored; ``whole`` has all.
    """
    kept_rows = [0]
    for k, now in enumerate(log.time):
        dense = now < log.pulses[0] + DENSE_SECONDS or now >= log.scored
        if k and (dense or (now - log.time[kept_rows[-1]] >= TAIL_SECONDS and np.isfinite(log.temperature[k]))):
            kept_rows.append(k)
    rows_of_readings = [k for k in kept_rows if np.isfinite(log.temperature[k])]
    readings = log.time[rows_of_readings] + reading_shift(log)[rows_of_readings]
    time, position = np.unique(np.concatenate([log.time[kept_rows], readings]), return_inverse=True)
    temperature, bend = np.full((2, len(time)), np.nan)
    temperature[position[len(kept_rows) :]] = log.temperature[rows_of_readings]
    bend[position[: len(kept_rows)]] = log.bend[kept_rows]
    channels = {"temperature": temperature, "displacement": np.radians(bend) * LEVER}
    units = {"duty": "1", "temperature": "degC", "displacement": "mm"}
    fitted = time < log.until
    chosen = np.floor((time - log.pulses[0]) / BLOCK_SECONDS) % 3 == 2
    rows = {"train": fitted & ~chosen, "select": fitted & chosen, "fitted": fitted, "held": time > log.scored}
    rows["whole"] = np.full(len(time), True)
    duty = {"duty": log.duty[np.clip(np.searchsorted(log.time, time, side="right") - 1, 0, None)]}
    return {
        role: Recording.from_arrays(
            log.name, time, duty | {c: np.where(own, v, np.nan) for c, v in channels.items()}, units
        )
        for role, own in rows.items()
    }


class Model(Module):
    """A fit problem whose plant has all candidate effects, with a Gaussian prior.

    Attributes:
        problem: The fit problem.
        fixed_values: Values of the effects' parameters that no slot moves, shape ``(n,)``.
        slot_matrix: What one unit of a slot adds to each parameter, shape ``(n, SLOTS)``.
        prior_mean: Mean of the prior of the vector and the slots.
        prior_deviation: Its standard deviation; infinite where there is no prior.
        names: Names of the effects' parameters.
    """

    problem: Problem
    fixed_values: jax.Array
    slot_matrix: jax.Array
    prior_mean: jax.Array
    prior_deviation: jax.Array
    names: tuple[str, ...] = field(static=True)

    @property
    def size(self) -> int:
        """Number of residuals."""
        return self.problem.size + len(self.prior_mean)

    def predict(self, vector: jax.Array) -> tuple[jax.Array, jax.Array]:
        """Predict the channels, and the error code, as ``Problem.predict``."""
        return self._at(vector).predict(vector[: len(self.problem.unknowns)])

    def residual(self, vector: jax.Array) -> jax.Array:
        """Return the residuals of the problem, followed by those of the prior over its standard deviation."""
        measured = self._at(vector).residual(vector[: len(self.problem.unknowns)])
        return jnp.concatenate([measured, (vector - self.prior_mean) / self.prior_deviation])

    def _at(self, vector: jax.Array) -> Problem:
        values = self.fixed_values + self.slot_matrix @ vector[len(self.problem.unknowns) :]
        plant = parameters.replace(self.problem.plant, {n: values[i] for i, n in enumerate(self.names)})
        return dataclasses.replace(self.problem, plant=plant)


@dataclasses.dataclass(frozen=True)
class LogFit:
    """The fit of one log.

    Attributes:
        base: The rig's vector.
        effects: The effects' parameters by name, in internal units.
        cost: The cost at the end.
        status: Why the solver stopped.
    """

    base: np.ndarray
    effects: Mapping[str, float]
    cost: float
    status: least_squares.SolverStatus


class LogFitter:
    """Fits of all logs with one compiled program, in which every candidate has strength 0 until a slot moves it."""

    def __init__(self, logs: Sequence[Log], candidates: Sequence[str]):
        rig = parse_rig(RIG, "softlimb.toml")
        capabilities = rig.plant.capabilities(tuple(rig.fit.observe))
        known_effects = {**catalogue(), **ARM_EFFECTS}
        self.kinds = {k: known_effects[k] for k in candidates if not known_effects[k].unavailable_reason(capabilities)}
        plant = dataclasses.replace(rig.plant, effects=tuple(kind() for kind in self.kinds.values()))
        self.plant, self.settings = plant, rig.fit
        self.names = tuple(f"effects.{k}.{n}" for k, kind in self.kinds.items() for n in parameters.declarations(kind))
        self.declared = {n: parameters.declaration(plant, n) for n in self.names}
        self.nominal = np.array([float(parameters.get(plant, n)) for n in self.names])
        self.parts = [split_log(log) for log in logs]
        self.problems: list[dict[str, Problem]] = []
        first: Problem | None = None
        for recordings in self.parts:
            built = {role: build_problem(plant, [r], rig.fit, step=2.0, multiple=128) for role, r in recordings.items()}
            first = first or built["train"]
            self.problems.append({role: dataclasses.replace(first, data=p.data) for role, p in built.items()})
        assert first is not None
        self.first, self.noise = first, rig.fit.noise
        self.prior_means = [self._prior_mean(log) for log in logs]

    def _prior_mean(self, log: Log) -> np.ndarray:
        """Mean of the prior of the rig's vector: the rig's values, and the first reading as initial temperature."""
        mean = np.array(self.first.nominal)
        i = [unknown.name for unknown in self.first.unknowns].index("initial.temperature")
        mean[i] = log.start_temperature / self.first.unknowns[i].scale
        return mean

    def scale(self, name: str) -> float:
        """Return the unit of a slot that moves a parameter: its typical strength, or the size of its nominal value."""
        key = name.split(".")[1]
        return (
            self.kinds[key].typical if name.endswith(".strength") else abs(float(self.nominal[self.names.index(name)]))
        )

    def model(self, log: int, role: str, effects: Mapping[str, float]) -> tuple[Model, np.ndarray]:
        """Build the model in which the slots move the parameters of some effects.

        Args:
            log: Index of the log.
            role: Role of the recording, a key of ``split_log``.
            effects: Values of the effects' parameters, by name.

        Returns:
            The model, and the values of the slots, shape ``(SLOTS,)``.
        """
        fixed_values = self.nominal.copy()
        slot_matrix = np.zeros((len(self.names), SLOTS))
        slots = np.zeros(SLOTS)
        prior_mean = np.zeros(SLOTS)
        prior_deviation = np.full(SLOTS, np.inf)
        for j, (name, value) in enumerate(effects.items()):
            i = self.names.index(name)
            strength = name.endswith(".strength")
            fixed_values[i] = 0.0
            slot_matrix[i, j] = self.scale(name)
            slots[j] = value / self.scale(name)
            prior_mean[j], prior_deviation[j] = (
                (0.0, STRENGTH_DEVIATION) if strength else (self.nominal[i] / self.scale(name), SHAPE_DEVIATION)
            )
        prior_mean = np.append(self.prior_means[log], prior_mean)
        prior_deviation = np.append([PRIOR_DEVIATION[u.name] / u.scale for u in self.first.unknowns], prior_deviation)
        return Model(
            self.problems[log][role],
            *map(jnp.asarray, (fixed_values, slot_matrix, prior_mean, prior_deviation)),
            self.names,
        ), slots

    def fit(self, log: int, role: str, effects: Mapping[str, float], base: np.ndarray, steps: int) -> LogFit:
        """Fit a part of one log from a start point.

        Args:
            log: Index of the log.
            role: Role of the recording.
            effects: Start values of the effects' parameters, by name.
            base: Start values of the rig's vector.
            steps: Largest number of solver steps.
        """
        model, slots = self.model(log, role, effects)
        lower, upper = self.first.bounds
        slot_bounds = np.zeros((2, SLOTS))
        for j, name in enumerate(effects):
            slot_bounds[:, j] = (
                self.declared[name].lower / self.scale(name),
                self.declared[name].upper / self.scale(name),
            )
        start = np.concatenate([base, slots])[None]
        lower = np.concatenate([lower, slot_bounds[0]])
        upper = np.concatenate([upper, slot_bounds[1]])
        search = MultiStartSolver(residual_of, model, start, lower, upper, size=model.size, rtol=1e-5)
        result = search.advance(steps).result()
        point = result.points[0]
        values = {n: float(point[len(base) + j] * self.scale(n)) for j, n in enumerate(effects)}
        return LogFit(point[: len(base)], values, float(result.costs[0]), result.statuses[0])

    def fit_all(self, role: str, before: Sequence[LogFit], added: Mapping[str, float], steps: int) -> list[LogFit]:
        """Fit a part of all logs, each from its earlier fit.

        Args:
            role: Role of the recordings.
            before: The earlier fits, one a log.
            added: Start values of further effects' parameters.
            steps: Largest number of solver steps.
        """
        with ThreadPoolExecutor(2) as pool:
            return list(
                pool.map(
                    lambda i: self.fit(i, role, {**before[i].effects, **added}, before[i].base, steps),
                    range(len(before)),
                )
            )

    def fit_from_draws(
        self, log: int, role: str, effects: Mapping[str, float], times: int, steps: int, seed: int = 0
    ) -> list[LogFit]:
        """Fit one log from the rig's values and from points drawn over the search box.

        Args:
            log: Index of the log.
            role: Role of the recording.
            effects: Start values of the effects' parameters.
            times: Number of start points, the rig's values included.
            steps: Largest number of solver steps.
            seed: Seed of the draws.

        Returns:
            The fits, the best first.
        """
        lower, upper = self.first.search_bounds()
        points = np.random.default_rng(seed).uniform(lower, upper, (times - 1, len(lower)))
        with ThreadPoolExecutor(2) as pool:
            fits = list(pool.map(lambda p: self.fit(log, role, effects, p, steps), [self.first.nominal, *points]))
        return sorted(fits, key=lambda f: f.cost if np.isfinite(f.cost) else np.inf)

    def residuals(self, log: int, role: str, fitted: LogFit) -> tuple[np.ndarray, np.ndarray]:
        """Return measured minus modelled temperature (K) and bend (deg) of a part, NaN where nothing was measured.

        Args:
            log: Index of the log.
            role: Role of the recording.
            fitted: The fit of the log.
        """
        model, slots = self.model(log, role, fitted.effects)
        predicted, _ = predict(model, jnp.asarray(np.concatenate([fitted.base, slots])))
        data, count = self.problems[log][role].data, len(self.parts[log][role])
        residual = np.where(np.asarray(data.weight[0]) > 0, np.asarray(data.measured[0] - predicted[0]), np.nan)[
            :, :count
        ]
        return residual[0], np.degrees(residual[1] / LEVER)

    def predict(self, log: int, fitted: LogFit, recording: Recording) -> tuple[np.ndarray, np.ndarray]:
        """Predict the temperature (degC) and the displacement (m) of a wire at the rows of another recording.

        The wire starts at the recording's first temperature, and the arm at its rest.

        Args:
            log: Index of the log to which the wire was fitted.
            fitted: The fit of the log.
            recording: Duty, temperature and displacement; only the duty and the first temperature are used.
        """
        effects = {
            n: 0.0 if n in ("effects.initial-offset.strength", "effects.initial-set.strength") else v
            for n, v in fitted.effects.items()
        }
        model, slots = self.model(log, "fitted", effects)
        problem = build_problem(self.plant, [recording], self.settings, step=2.0, multiple=128)
        base = np.array(fitted.base)
        names, scales = zip(*((unknown.name, unknown.scale) for unknown in self.first.unknowns), strict=True)
        start, ambient = names.index("initial.temperature"), names.index("environment.ambient")
        base[start] = recording.channels["temperature"][0] / scales[start]
        if not np.any(recording.channels["duty"]):  # the fitted ambient is that after a pulse, which warms the body
            base[ambient] = min(base[ambient], base[start] * scales[start] / scales[ambient])
        model = dataclasses.replace(model, problem=problem)
        predicted, _ = predict(model, jnp.asarray(np.concatenate([base, slots])))
        temperature, displacement = np.asarray(predicted[0])[:, : len(recording)]
        return temperature, displacement

    def score(self, role: str, fits: Sequence[LogFit]) -> float:
        """Return the RMS of a part's residuals over their noise, pooled over logs and channels."""
        noise = self.noise["temperature"], float(np.degrees(self.noise["displacement"] / LEVER))
        residuals = [self.residuals(i, role, f) for i, f in enumerate(fits)]
        return rms([r[c] / noise[c] for r in residuals for c in (0, 1)])

    def errors(self, role: str, fits: Sequence[LogFit]) -> tuple[float, float]:
        """Return the pooled RMSE of a part in K and deg."""
        residuals = [self.residuals(i, role, f) for i, f in enumerate(fits)]
        return rms([r[0] for r in residuals]), rms([r[1] for r in residuals])


def rms(series: Sequence[np.ndarray]) -> float:
    """Return the root mean square over all samples that are not NaN."""
    return float(np.sqrt(np.nanmean(np.concatenate(series) ** 2)))
