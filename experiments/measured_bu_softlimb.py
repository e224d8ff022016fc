"""A soft arm bent by one wire at a time, measured by others: fit a first heating pulse and its cooling, predict the second pulse.

    python experiments/measured_bu_softlimb.py [--data DIR] [--quick] [--json FILE] [--out DIR]

DIR holds one CSV file a log: a row of headers (``pwm_duty_...``, ``MCPtemp_...``, ``tagid_x_...``, ``tagid_y_...``, the first column a
stamp in ms), numbers below. Which duty is driven, which thermocouple answers and which tags move is found in the data. The bend is the
direction of the chord from the first tag, or from the middle one where the first half of the arm stays, to the last, relative to its mean
in the last 30 s before the second pulse, positive as the wire shortens. The temperature is compared where any thermocouple was refreshed.

The plant is one wire against an elastic arm: the arm is a bias spring, its bend the wire's displacement over a lever of nominal length.
These data decide no stress, so preload, stiffness, the Clausius-Clapeyron coefficients and the moduli (as equal) are held. The wire is
always under tension: the twinned branch is held out of the way, and slack is no candidate. Nor is ratcheting, which one pulse cannot tell
from a set that is there from before (initial-set), although the two forecast different second pulses. The wire starts detwinned: a free
start fraction would be that set a second time. Of supply, resistance and heat capacity, which scale the same heat, the supply is fitted.
Each log has its own parameters, all have the same effects. One pulse leaves many a direction open, and what is absurd along it forecasts
absurdly: what is known of such wires beforehand stands as a prior in every fit (``SPREAD``).

One pulse is fitted, and all that tells of most effects happens in its first 40 s. A selection part that is the last third in time would
see a wire at rest. So it is every third of the blocks of 2 s. An effect is accepted if it lowers the error there, pooled over the logs and
both channels over their noise, by more than 5 %. Then all is fitted once more to the whole of the first part. In the fitted part the slow
tail is thinned to a row a second or so; the scored part keeps all rows.
"""

from __future__ import annotations

import dataclasses
import itertools
from collections.abc import Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import jax
import jax.numpy as jnp
import numpy as np
from _arm_log import Log, begun, naive, read_logs
from _common import Row, arguments, finish, say
from _figures import Chart, Curve, draw
from equinox import Module, field, filter_jit

from smajax import parameters
from smajax.diagnose.effects import catalogue
from smajax.fit import least_squares
from smajax.fit.problem import Problem, build
from smajax.recording import Recording
from smajax.rig import parse_rig

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
max_strain = "1.5 %"
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
        "material.martensite_start", "material.detwinning_finish_stress", "material.max_strain", "sensor.displacement_offset"]
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
"material.max_strain" = ["0.5 %", "10 %"]
"""
BASE_K, BASE_DEG = 7.3, 0.80  # small model fitted by plain least squares
REACH_K, REACH_DEG = 1.6, 0.37  # the same with effects added
CANDIDATES = (
    "thermocouple-embedding", "coating", "creep", "thermocouple-lag", "end-conduction", "latent-heat", "convection-temperature",
    "heat-capacity", "initial-set", "transformation-shift", "temperature-distribution", "minor-loop-shape", "sensor-lag",
)  # fmt: skip
CUT = 0.05
SLOTS = 14
# Prior standard deviations around the rig's values (SI, K): data sheets of such wires, a driver and films of air known to within a factor.
SPREAD = {
    "drive.supply": 0.5, "heat.h0": 30.0, "environment.ambient": 2.0, "material.austenite_shift": 10.0, "material.austenite_finish": 15.0,
    "material.martensite_start": 15.0, "material.detwinning_finish_stress": 4e7, "material.max_strain": 5e-3,
    "sensor.displacement_offset": 1e-4,
}  # fmt: skip
SPREAD_STRENGTH, SPREAD_SHAPE = 1.5, 1.0  # of an effect, in typical strengths around none and in its usual shape's sizes around that
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
        role: Recording.from_arrays(log.name, time, duty | {c: np.where(own, v, np.nan) for c, v in channels.items()}, units)
        for role, own in rows.items()
    }


class Model(Module):
    """A problem whose plant has all candidates: ``fixed``, shape ``(n,)``, and ``moved``, shape ``(n, SLOTS)``, say what the slots move.

    ``usual`` and ``spread`` are mean and standard deviation of the prior of the vector and the slots; infinite where there is none.
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
    """One log's fit: the rig's vector, the effects' parameters by name (internal units), the cost and why it stopped."""

    base: np.ndarray
    effects: Mapping[str, float]
    cost: float
    stop: least_squares.Stop


class Bench:
    """All logs on one compiled program, in which every candidate stands at strength 0 until a slot moves it."""

    def __init__(self, logs: Sequence[Log], candidates: Sequence[str]):
        rig = parse_rig(RIG, "softlimb.toml")
        traits = rig.plant.traits(tuple(rig.fit.observe))
        self.kinds = {k: catalogue()[k] for k in candidates if not catalogue()[k].obstacle(traits)}
        plant = dataclasses.replace(rig.plant, effects=tuple(kind() for kind in self.kinds.values()))
        self.names = tuple(f"effects.{k}.{n}" for k, kind in self.kinds.items() for n in parameters.declarations(kind))
        self.declared = {n: parameters.declaration(plant, n) for n in self.names}
        self.nominal = np.array([float(parameters.get(plant, n)) for n in self.names])
        self.parts = [parts(log) for log in logs]
        self.problems: list[dict[str, Problem]] = []
        first: Problem | None = None
        for own in self.parts:
            built = {role: build(plant, [r], rig.fit, step=2.0, multiple=128) for role, r in own.items()}
            first = first or built["train"]
            self.problems.append({role: dataclasses.replace(first, data=p.data) for role, p in built.items()})
        assert first is not None
        self.first, self.noise = first, rig.fit.noise

    def scale(self, name: str) -> float:
        """What a slot that moves a parameter counts in."""
        key = name.split(".")[1]
        return self.kinds[key].typical if name.endswith(".strength") else abs(float(self.nominal[self.names.index(name)]))

    def model(self, log: int, role: str, effects: Mapping[str, float]) -> tuple[Model, np.ndarray]:
        """The model in which the slots move these effects' parameters, and the slots' values."""
        fixed, moved, slots = self.nominal.copy(), np.zeros((len(self.names), SLOTS)), np.zeros(SLOTS)
        usual, spread = np.zeros(SLOTS), np.full(SLOTS, np.inf)
        for j, (name, value) in enumerate(effects.items()):
            i, strength = self.names.index(name), name.endswith(".strength")
            fixed[i], moved[i, j], slots[j] = 0.0, self.scale(name), value / self.scale(name)
            usual[j], spread[j] = (0.0, SPREAD_STRENGTH) if strength else (self.nominal[i] / self.scale(name), SPREAD_SHAPE)
        usual = np.append(self.first.nominal, usual)
        spread = np.append([SPREAD[u.name] / u.scale for u in self.first.unknowns], spread)
        return Model(self.problems[log][role], *map(jnp.asarray, (fixed, moved, usual, spread)), self.names), slots

    def fit(self, log: int, role: str, effects: Mapping[str, float], base: np.ndarray, steps: int) -> Fitted:
        """Fits one log's part from a start point."""
        model, slots = self.model(log, role, effects)
        lower, upper = self.first.box
        ends = np.zeros((2, SLOTS))
        for j, name in enumerate(effects):
            ends[:, j] = self.declared[name].lower / self.scale(name), self.declared[name].upper / self.scale(name)
        start = np.concatenate([base, slots])[None]
        lower, upper = np.concatenate([lower, ends[0]]), np.concatenate([upper, ends[1]])
        search = least_squares.Search(_residual, model, start, lower, upper, size=model.size, rtol=1e-5)
        solved = search.advance(steps).result()
        point = solved.points[0]
        found = {n: float(point[len(base) + j] * self.scale(n)) for j, n in enumerate(effects)}
        return Fitted(point[: len(base)], found, float(solved.costs[0]), solved.stops[0])

    def each(self, role: str, before: Sequence[Fitted], added: Mapping[str, float], steps: int) -> list[Fitted]:
        """Fits all logs, each from where it stood, with what is added."""
        with ThreadPoolExecutor(2) as pool:
            return list(pool.map(lambda i: self.fit(i, role, {**before[i].effects, **added}, before[i].base, steps), range(len(before))))

    def drawn(self, log: int, role: str, effects: Mapping[str, float], times: int, steps: int, seed: int = 0) -> list[Fitted]:
        """Fits one log from the rig's own values and from ``times - 1`` points drawn over the search box, the best first."""
        lower, upper = self.first.search_box()
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


def with_effect(bench: Bench, key: str) -> list[dict[str, float]]:
    """Start values of an effect's parameters: a part of its typical strength, at each of the shapes that it is tried at."""
    kind = bench.kinds[key]
    start = {n: float(v) for n, v in zip(bench.names, bench.nominal, strict=True) if n.startswith(f"effects.{key}.")}
    start[f"effects.{key}.strength"] = 0.3 * kind.typical
    grids = [[(f"effects.{key}.{name}", value) for value in values] for name, values in kind.shapes]
    return [start | dict(chosen) for chosen in itertools.product(*grids)]


@dataclasses.dataclass(frozen=True)
class Round:
    """One round of the search: its scores on the selection part by effect, which one was accepted (or none), and which did as well."""

    before: float
    scores: Mapping[str, float]
    accepted: str
    equivalent: tuple[str, ...]
    fits: list[Fitted]


def search(bench: Bench, first: list[Fitted], rounds: int, finalists: int) -> list[Round]:
    """Adds effects one by one, as long as one lowers the error on the selection part by more than ``CUT``."""
    history, fits, score = [], first, bench.score("select", first)
    while len(history) < rounds:
        tried: dict[str, list[Fitted]] = {}
        for key in bench.kinds:
            starts = with_effect(bench, key)
            if f"effects.{key}.strength" in fits[0].effects or len(fits[0].effects) + len(starts[0]) > SLOTS:
                continue
            # From where the smaller model stands, whose parameters made up for the effect, and from the rig's own values.
            anew = [dataclasses.replace(f, base=bench.first.nominal) for f in fits]
            trials = [bench.each("train", before, start, 25) for start in starts for before in (fits, anew)]
            tried[key] = [min(own, key=lambda f: f.cost) for own in zip(*trials, strict=True)]
        scores = {key: bench.score("select", trial) for key, trial in tried.items()}
        for key in sorted(scores, key=lambda k: scores[k])[:finalists]:
            tried[key] = bench.each("train", tried[key], {}, 80)
            scores[key] = bench.score("select", tried[key])
        scores = dict(sorted(scores.items(), key=lambda kv: kv[1]))
        best = next(iter(scores), "")
        good = bool(best) and scores[best] < (1 - CUT) * score
        alike = tuple(k for k, v in scores.items() if k != best and v < (1 - CUT) * score and v <= (1 + CUT) * scores[best])
        history.append(Round(score, scores, best if good else "", alike if good else (), tried[best] if good else fits))
        what = "accepted" if good else "not accepted"
        say(f"round {len(history)}: {best or 'nothing'} {what}, selection part from {score:.3f} to {scores.get(best, score):.3f}")
        if not good:
            break
        fits, score = tried[best], scores[best]
    return history


def compared(what: str, errors: tuple[float, float], targets: tuple[float, float] | None, **numbers: float) -> Row:
    """One row of errors in K and deg."""
    goal = f"<= {targets[0]:g} K, <= {targets[1]:g} deg" if targets else "-"
    met = errors[0] <= targets[0] and errors[1] <= targets[1] if targets else None
    return Row(what, goal, f"{errors[0]:.2f} K, {errors[1]:.2f} deg", met, {"rmse_K": errors[0], "rmse_deg": errors[1], **numbers})


def report(bench: Bench, logs: Sequence[Log], base: list[Fitted], history: list[Round], final: list[Fitted], known: bool) -> list[Row]:
    """The table but for the agreement of start points."""
    rows = [Row(f"{log.name}: found", "-", f"{log.found}; fitted to {log.until:g} s, scored from {log.scored:g} s", None) for log in logs]
    rows += [Row(f"{log.name}: the fitted and the held-out pulse go from and to", "-", begun(log), None) for log in logs]
    guess = [naive(log) for log in logs]
    repeated = rms([g[0] for g in guess]), rms([g[1] for g in guess])
    whole = bench.each("fitted", base, {}, 80)
    for part in ("train", "select"):
        last = history[-1].fits if history else base
        rows.append(compared(f"{part} part, before", bench.errors(part, base), None))
        rows.append(compared(f"{part} part, with effects", bench.errors(part, last), None))
    for k, one in enumerate(history):
        best = [f"{key} {value:.3f}" for key, value in one.scores.items()]
        text = f"{one.before:.3f} before; with {', '.join(best)}"
        rows.append(Row(f"round {k + 1}: error over noise on the selection part", "-", text, None, dict(one.scores)))
        verdict = f"{one.accepted} accepted" if one.accepted else f"none cuts it by more than {100 * CUT:.0f} %"
        verdict += f"; as good within {100 * CUT:.0f} %: {', '.join(one.equivalent)}" if one.equivalent else ""
        rows.append(Row(f"round {k + 1}: verdict", "-", verdict, None))
    rows.append(compared("held out: repeating pulse 1 (naive)", repeated, None))
    rows.append(compared("held out: base model", bench.errors("held", whole), (BASE_K, BASE_DEG) if known else None))
    rows.append(compared("held out: with effects", bench.errors("held", final), (REACH_K, REACH_DEG) if known else None))
    for i, (log, fitted) in enumerate(zip(logs, final, strict=True)):
        rows.append(compared(f"held out: {log.name}", tuple(rms([r]) for r in bench.residuals(i, "held", fitted)), None))  # pyright: ignore[reportArgumentType]
    ours = bench.errors("held", final)
    text = f"{ours[0]:.2f} K, {ours[1]:.2f} deg against {repeated[0]:.2f} K, {repeated[1]:.2f} deg"
    named = ", ".join(one.accepted for one in history if one.accepted) or "no effect"
    rows.append(
        Row(f"held out: with {named}, against the naive forecast", "below it", text, ours[0] < repeated[0] and ours[1] < repeated[1])
    )
    for i, unknown in enumerate(bench.first.unknowns):
        values = [float(f.base[i] * unknown.scale) for f in final]
        rows.append(Row(unknown.name, "-", f"{', '.join(f'{v:.4g}' for v in values)} {unknown.unit}", None))
    for name in final[0].effects:
        values = [f.effects[name] for f in final]
        rows.append(Row(name, "-", f"{', '.join(f'{v:.4g}' for v in values)} {bench.declared[name].unit}", None))
    return rows


def agreement(bench: Bench, final: list[Fitted], times: int) -> tuple[list[Row], list[Fitted]]:
    """How many start points end at each log's lowest cost, and the best fit of each."""
    rows, best = [], []
    for i, fitted in enumerate(final):
        fits = [fitted, *bench.drawn(i, "fitted", fitted.effects, times, 150, seed=1 + i)]
        lowest = min(fits, key=lambda f: f.cost)
        same = sum(f.cost <= 1.001 * lowest.cost for f in fits)
        near = sum(f.cost <= 1.05 * lowest.cost for f in fits)
        text = f"{same} of {len(fits)} end within 0.1 %, {near} within 5 % of the lowest cost, {lowest.cost:.1f}; {lowest.stop.text}"
        name = bench.parts[i]["fitted"].name
        rows.append(Row(f"{name}: is it the best that this model can do?", "one optimum", text, same == len(fits), {"cost": lowest.cost}))
        best.append(lowest)
    return rows, best


def pictures(bench: Bench, logs: Sequence[Log], final: list[Fitted], folder: Path) -> None:
    """The scored part of each log, measured and modelled."""
    for i, (log, fitted) in enumerate(zip(logs, final, strict=True)):
        part = bench.parts[i]["held"]
        measured = part.channels["temperature"], np.degrees(part.channels["displacement"] / LEVER)
        pairs = zip(("temperature [degC]", "bend [deg]"), measured, bench.residuals(i, "held", fitted), strict=True)
        for what, values, left in pairs:
            seen = np.isfinite(left)
            time = part.time[seen]
            curves = [Curve("measured", time, values[seen]), Curve("model", time, (values - left)[seen], dashed=True)]
            draw(Chart(f"{log.name}, held out", "time [s]", what, curves), folder, f"measured_softlimb_{log.name}_{what.split()[0]}")


def main() -> None:
    """Prints the table."""
    args = arguments(__doc__, data="bu-softlimb", quick="the first log only, three candidates, one round")
    logs = read_logs(args.data)
    known = args.data.name == "bu-softlimb" and not args.quick
    logs = logs[:1] if args.quick else logs
    bench = Bench(logs, CANDIDATES[:3] if args.quick else CANDIDATES)
    say(f"fitting the base model to {len(logs)} logs from {BASE_STARTS} start points each")
    base = [bench.drawn(i, "train", {}, BASE_STARTS, 60)[0] for i in range(len(logs))]
    history = search(bench, base, 1 if args.quick else 8, 1 if args.quick else 4)
    say("fitting all once more to the whole of the first part")
    final = bench.each("fitted", history[-1].fits if history else base, {}, 40 if args.quick else 200)
    agreed, final = agreement(bench, final, 2 if args.quick else 10)
    rows = [*report(bench, logs, base, history, final, known), *agreed]
    if args.out:
        pictures(bench, logs, final, args.out)
    finish("measured_bu_softlimb", rows, args)


if __name__ == "__main__":
    main()
