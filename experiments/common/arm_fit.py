"""Fits of a soft arm's logs: the plant with every candidate effect, and a prior from data sheets."""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor

from experiments.common.arm_log import Log

import jax
import jax.numpy as jnp
import numpy as np
from equinox import Module, field, filter_jit

from smajax import parameters
from smajax.files.rig_file import parse_rig
from smajax.fitting import levenberg_marquardt as least_squares
from smajax.fitting.multi_start import MultiStartSolver
from smajax.fitting.problem import Problem, build_problem
from smajax.plant.effects import catalogue
from smajax.recordings.recording import Recording

LEVER = 0.003  # m of wire per rad of bend: a nominal scale, which the largest strain makes up for


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
[fit]
free = ["drive.supply", "heat.h0", "environment.ambient", "material.austenite_shift", "material.austenite_finish",
        "material.martensite_start", "material.detwinning_finish_stress", "material.max_transformation_strain",
        "sensor.displacement_offset"]
observe = ["temperature", "displacement"]
noise = { temperature = "1 K", displacement = "0.015 mm" }
starts = 1
[fit.bounds]
"drive.supply" = ["0.1 V", "10 V"]
"heat.h0" = ["3 W/m^2/K", "400 W/m^2/K"]
"environment.ambient" = ["15 degC", "30 degC"]
"material.austenite_shift" = ["-80 K", "100 K"]
"material.austenite_finish" = ["62 degC", "200 degC"]
"material.martensite_start" = ["0 degC", "150 degC"]
"material.detwinning_finish_stress" = ["5 MPa", "400 MPa"]
"material.max_transformation_strain" = ["0.5 %", "10 %"]
"""


SLOTS = 14


# Prior standard deviations around the rig's values (SI, K): data sheets of such wires, a driver and films of air
# known to within a factor.
SPREAD = {
    "drive.supply": 0.5,
    "heat.h0": 30.0,
    "environment.ambient": 2.0,
    "material.austenite_shift": 10.0,
    "material.austenite_finish": 15.0,
    "material.martensite_start": 15.0,
    "material.detwinning_finish_stress": 4e7,
    "material.max_transformation_strain": 5e-3,
    "sensor.displacement_offset": 1e-4,
}


SPREAD_STRENGTH, SPREAD_SHAPE = (
    1.5,
    1.0,
)  # of an effect, in typical strengths around none and in its usual shape's sizes around that


BASE_STARTS = 8  # with three, the base may stay where its wire never transforms, and any effect seems to mend it


DENSE, TAIL = 40.0, 1.1


BLOCK = 2.0


def parts(log: Log) -> dict[str, Recording]:
    """The log as recordings, each from its first row to its last, whose channels are NaN but in their own part.

    ``train`` and ``select`` make up ``fitted``; ``held`` is scored.
    """
    keep = [0]
    for k, now in enumerate(log.time):
        dense = now < log.pulses[0] + DENSE or now >= log.scored
        if k and (dense or (now - log.time[keep[-1]] >= TAIL and np.isfinite(log.temperature[k]))):
            keep.append(k)
    time = log.time[keep]
    channels = {"temperature": log.temperature[keep], "displacement": np.radians(log.bend[keep]) * LEVER}
    units = {"duty": "1", "temperature": "degC", "displacement": "mm"}
    fitted = time < log.until
    chosen = np.floor((time - log.pulses[0]) / BLOCK) % 3 == 2
    rows = {"train": fitted & ~chosen, "select": fitted & chosen, "fitted": fitted, "held": time > log.scored}
    duty = {"duty": log.duty[keep]}
    return {
        role: Recording.from_arrays(
            log.name, time, duty | {c: np.where(own, v, np.nan) for c, v in channels.items()}, units
        )
        for role, own in rows.items()
    }


class Model(Module):
    """A problem whose plant has all candidates.

    ``fixed``, shape ``(n,)``, and ``moved``, shape ``(n, SLOTS)``, say what the slots move.

    ``usual`` and ``spread`` are mean and standard deviation of the prior of the vector and the slots; infinite where
    there is none.
    """

    problem: Problem
    fixed: jax.Array
    moved: jax.Array
    usual: jax.Array
    spread: jax.Array
    names: tuple[str, ...] = field(static=True)

    @property
    def size(self) -> int:
        """Number of residuals."""
        return self.problem.size + len(self.usual)

    def predict(self, vector: jax.Array) -> tuple[jax.Array, jax.Array]:
        """See ``Problem.predict``."""
        return self._at(vector).predict(vector[: len(self.problem.unknowns)])

    def residual(self, vector: jax.Array) -> jax.Array:
        """``Problem.residual``'s, then what the prior says, over its spread."""
        measured = self._at(vector).residual(vector[: len(self.problem.unknowns)])
        return jnp.concatenate([measured, (vector - self.usual) / self.spread])

    def _at(self, vector: jax.Array) -> Problem:
        values = self.fixed + self.moved @ vector[len(self.problem.unknowns) :]
        plant = parameters.replace(self.problem.plant, {n: values[i] for i, n in enumerate(self.names)})
        return dataclasses.replace(self.problem, plant=plant)


def _residual(vector: jax.Array, model: Model) -> jax.Array:
    return model.residual(vector)


@filter_jit
def _predict(model: Model, vector: jax.Array) -> tuple[jax.Array, jax.Array]:
    return model.predict(vector)


@dataclasses.dataclass(frozen=True)
class Fitted:
    """One log's fit.

    The rig's vector, the effects' parameters by name (internal units), the cost and why it stopped.
    """

    base: np.ndarray
    effects: Mapping[str, float]
    cost: float
    stop: least_squares.SolverStatus


class Bench:
    """All logs on one compiled program, in which every candidate stands at strength 0 until a slot moves it."""

    def __init__(self, logs: Sequence[Log], candidates: Sequence[str]):
        rig = parse_rig(RIG, "softlimb.toml")
        traits = rig.plant.capabilities(tuple(rig.fit.observe))
        self.kinds = {k: catalogue()[k] for k in candidates if not catalogue()[k].unavailable_reason(traits)}
        plant = dataclasses.replace(rig.plant, effects=tuple(kind() for kind in self.kinds.values()))
        self.names = tuple(f"effects.{k}.{n}" for k, kind in self.kinds.items() for n in parameters.declarations(kind))
        self.declared = {n: parameters.declaration(plant, n) for n in self.names}
        self.nominal = np.array([float(parameters.get(plant, n)) for n in self.names])
        self.parts = [parts(log) for log in logs]
        self.problems: list[dict[str, Problem]] = []
        first: Problem | None = None
        for own in self.parts:
            built = {role: build_problem(plant, [r], rig.fit, step=2.0, multiple=128) for role, r in own.items()}
            first = first or built["train"]
            self.problems.append({role: dataclasses.replace(first, data=p.data) for role, p in built.items()})
        assert first is not None
        self.first, self.noise = first, rig.fit.noise

    def scale(self, name: str) -> float:
        """What a slot that moves a parameter counts in."""
        key = name.split(".")[1]
        return (
            self.kinds[key].typical if name.endswith(".strength") else abs(float(self.nominal[self.names.index(name)]))
        )

    def model(self, log: int, role: str, effects: Mapping[str, float]) -> tuple[Model, np.ndarray]:
        """The model in which the slots move these effects' parameters, and the slots' values."""
        fixed, moved, slots = self.nominal.copy(), np.zeros((len(self.names), SLOTS)), np.zeros(SLOTS)
        usual, spread = np.zeros(SLOTS), np.full(SLOTS, np.inf)
        for j, (name, value) in enumerate(effects.items()):
            i, strength = self.names.index(name), name.endswith(".strength")
            fixed[i], moved[i, j], slots[j] = 0.0, self.scale(name), value / self.scale(name)
            usual[j], spread[j] = (
                (0.0, SPREAD_STRENGTH) if strength else (self.nominal[i] / self.scale(name), SPREAD_SHAPE)
            )
        usual = np.append(self.first.nominal, usual)
        spread = np.append([SPREAD[u.name] / u.scale for u in self.first.unknowns], spread)
        return Model(self.problems[log][role], *map(jnp.asarray, (fixed, moved, usual, spread)), self.names), slots

    def fit(self, log: int, role: str, effects: Mapping[str, float], base: np.ndarray, steps: int) -> Fitted:
        """Fits one log's part from a start point."""
        model, slots = self.model(log, role, effects)
        lower, upper = self.first.bounds
        ends = np.zeros((2, SLOTS))
        for j, name in enumerate(effects):
            ends[:, j] = self.declared[name].lower / self.scale(name), self.declared[name].upper / self.scale(name)
        start = np.concatenate([base, slots])[None]
        lower, upper = np.concatenate([lower, ends[0]]), np.concatenate([upper, ends[1]])
        search = MultiStartSolver(_residual, model, start, lower, upper, size=model.size, rtol=1e-5)
        solved = search.advance(steps).result()
        point = solved.points[0]
        found = {n: float(point[len(base) + j] * self.scale(n)) for j, n in enumerate(effects)}
        return Fitted(point[: len(base)], found, float(solved.costs[0]), solved.statuses[0])

    def each(self, role: str, before: Sequence[Fitted], added: Mapping[str, float], steps: int) -> list[Fitted]:
        """Fits all logs, each from where it stood, with what is added."""
        with ThreadPoolExecutor(2) as pool:
            return list(
                pool.map(
                    lambda i: self.fit(i, role, {**before[i].effects, **added}, before[i].base, steps),
                    range(len(before)),
                )
            )

    def drawn(
        self, log: int, role: str, effects: Mapping[str, float], times: int, steps: int, seed: int = 0
    ) -> list[Fitted]:
        """Fit one log from the rig's values and from ``times - 1`` points of the search box; the best first."""
        lower, upper = self.first.search_bounds()
        points = np.random.default_rng(seed).uniform(lower, upper, (times - 1, len(lower)))
        with ThreadPoolExecutor(2) as pool:
            fits = list(pool.map(lambda p: self.fit(log, role, effects, p, steps), [self.first.nominal, *points]))
        return sorted(fits, key=lambda f: f.cost if np.isfinite(f.cost) else np.inf)

    def residuals(self, log: int, role: str, fitted: Fitted) -> tuple[np.ndarray, np.ndarray]:
        """Measured minus model of a part, K and deg, NaN where nothing was measured."""
        model, slots = self.model(log, role, fitted.effects)
        predicted, _ = _predict(model, jnp.asarray(np.concatenate([fitted.base, slots])))
        data, count = self.problems[log][role].data, len(self.parts[log][role])
        left = np.where(np.asarray(data.weight[0]) > 0, np.asarray(data.measured[0] - predicted[0]), np.nan)[:, :count]
        return left[0], np.degrees(left[1] / LEVER)

    def score(self, role: str, fits: Sequence[Fitted]) -> float:
        """RMS of a part's residuals over their noise, pooled over logs and channels."""
        noise = self.noise["temperature"], float(np.degrees(self.noise["displacement"] / LEVER))
        left = [self.residuals(i, role, f) for i, f in enumerate(fits)]
        return rms([r[c] / noise[c] for r in left for c in (0, 1)])

    def errors(self, role: str, fits: Sequence[Fitted]) -> tuple[float, float]:
        """Pooled RMSE of a part in K and deg."""
        left = [self.residuals(i, role, f) for i, f in enumerate(fits)]
        return rms([r[0] for r in left]), rms([r[1] for r in left])


def rms(series: Sequence[np.ndarray]) -> float:
    """Root mean square over all samples that are none of them NaN."""
    return float(np.sqrt(np.nanmean(np.concatenate(series) ** 2)))
