"""The diagnosis and three other methods on the same recordings with the same hidden effects.

    python experiments/diagnosis/alternative_methods.py [--quick] [--seeds N] [--json FILE] [--out DIR]

- Exhaustive refit with BIC (schwarz1978): every effect of the catalogue is fitted to the training recording, and the
  best is added as long as the Bayesian information criterion falls. There is no projection, no equivalence class and
  no selection recording.
- Sparse regression on estimated states (SINDy, by pysindy): the rate of the fitted model's error is a sparse linear
  function of the error, the model's temperature and martensite fraction, their rates, the input and the time. The
  selection recording chooses its threshold. Its largest term counts as a name if it is that of the hidden effect.
- Universal differential equation: a small network of temperature, martensite fraction and stress adds heat to the
  balance. It is fitted together with the rig's parameters from two draws of weights, of which the selection recording
  chooses one. It names nothing.

Cases, truth and noise are those of hidden_effects.py. With ``--out``, each answer is appended to DIR/cases.jsonl, and
answers that are there are not computed again. Needs pysindy: ``pip install "smajax[rivals]"``.
"""

from __future__ import annotations

import dataclasses
import importlib.util
import math
import sys
import time
import warnings
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

sys.path.insert(0, str(Path(__file__).resolve().parents[2]))  # the checkout: smajax, tests/reference, experiments

from experiments.common.base import ROOT, Row, add_case, arguments, finish, read_cases, say
from experiments.common.hidden_recordings import NOISE, draw_strengths, record

import jax
import jax.numpy as jnp
import numpy as np

from smajax.diagnosis.candidates import EffectSet, Refit
from smajax.diagnosis.outcome import diagnose
from smajax.diagnosis.problem import DiagnosisProblem
from smajax.files.rig_file import Rig, read_rig
from smajax.fitting.multi_start import MultiStartSolver
from smajax.fitting.problem import Problem, build_problem
from smajax.numerics.ensemble import share_among_cores
from smajax.parameters import parameter
from smajax.plant.effects.base import HeatEffect, StageContext, WireState

CASES = ("latent-heat", "airflow-change", "ambient-drift", "backlash", "coulomb-friction", "sensor-lag", "creep", "")
# The terms of the sparse regression that count as the right name.
TERMS = {
    "latent-heat": ("martensite rate",),
    "airflow-change": ("step", "excess"),
    "ambient-drift": ("time",),
    "backlash": ("sign of the rate",),
    "coulomb-friction": ("sign of the rate",),
    "sensor-lag": ("martensite rate",),
    "creep": ("martensite",),
}
NEURONS = 6  # of the network in the heat balance


@dataclass(frozen=True)
class Answer:
    """The answer of one method to one case.

    Attributes:
        named: The effect that it names; empty for none.
        ratio: Its held-out error over the noise.
        seconds: Wall time.
    """

    named: str
    ratio: float
    seconds: float


def run_diagnosis(rig: Rig, recordings: list, key: str) -> tuple[str, float]:
    """Run the diagnosis.

    Args:
        rig: The rig.
        recordings: Training, selection and held-out recording.
        key: The hidden effect; not used.

    Returns:
        The effect named first, and the held-out error over the noise.
    """
    diagnosis = diagnose(DiagnosisProblem(rig.plant, recordings, rig.fit, interpolation=rig.interpolation))
    return diagnosis.effects[0] if diagnosis.effects else "", diagnosis.rmse["displacement"]["holdout_after"] / NOISE


def run_exhaustive_refit(rig: Rig, recordings: list, key: str) -> tuple[str, float]:
    """Refit with every effect in turn, and choose by the BIC on the training recording.

    Args:
        rig: The rig.
        recordings: Training, selection and held-out recording.
        key: The hidden effect; not used.

    Returns:
        The effect added first, and the held-out error over the noise.
    """
    problem = DiagnosisProblem(rig.plant, recordings, rig.fit, interpolation=rig.interpolation)
    problem.wait_for_compilation()
    best = problem.fit(EffectSet(), problem.nominal, max_steps=60, rtol=1e-8)

    def criterion(refit: Refit) -> float:
        samples = len(problem.counted_samples(refit.residual))
        free = problem.size + len(problem.free_effect_parameters(refit.effect_set))
        return (
            samples * math.log(problem.reduced_chi2(refit.residual, 0)) + free * math.log(samples)
            if math.isfinite(refit.chi2)
            else math.inf
        )

    for _ in range(3):
        starts = []
        for effect in (k for k in problem.effects if k not in best.effect_set.keys):
            for base, size in ((best.base, 0.1), (problem.nominal, 0.4)):
                values = {f"effects.{effect}.strength": size * problem.effects[effect].typical}
                values |= {f"effects.{effect}.{n}": v for n, v in problem.shape_grid(effect)[0]}
                starts.append((best.effect_set.with_effect(effect, values), base))
        refits = share_among_cores(lambda start: problem.fit(*start), starts)
        next_best = min(refits, key=criterion)
        if criterion(next_best) >= criterion(best):
            break
        best = next_best
    residual = problem.predict(best.effect_set, best.base, 2)
    first = best.effect_set.keys[0] if best.effect_set.keys else ""
    return first, math.sqrt(problem.reduced_chi2(residual, 2)) * problem.noise["displacement"] / NOISE


def run_sparse_regression(rig: Rig, recordings: list, key: str) -> tuple[str, float]:
    """Regress the error's rate on estimated states.

    Args:
        rig: The rig.
        recordings: Training, selection and held-out recording.
        key: The hidden effect, whose terms count as its name.

    Returns:
        The effect or term, and the held-out error over the noise.
    """
    pysindy = importlib.import_module("pysindy")
    problem = DiagnosisProblem(rig.plant, recordings, rig.fit, interpolation=rig.interpolation)
    problem.wait_for_compilation()
    fitted = problem.fit(EffectSet(), problem.nominal, max_steps=60, rtol=1e-8)
    errors, tables = [], []
    for k, recording in enumerate(recordings):
        residual = problem.predict(EffectSet(), fitted.base, k)
        errors.append(problem.series(residual, k)["displacement"] * problem.noise["displacement"] * 1e3)
        states = problem.states(fitted, jax.tree.map(lambda leaf: leaf[0], problem.problems[k].data.inputs))
        count, time_ = len(recording), recording.time
        excess = np.asarray(states.temperature)[:count, 0] - float(rig.plant.environment.ambient)
        martensite = np.asarray(states.fractions.martensite)[:count, 0]
        current, rate = recording.channels["current"], np.gradient(martensite, time_)
        tables.append(
            {
                "excess": excess / 50.0,
                "excess squared": (excess / 50.0) ** 2,
                "martensite": martensite,
                "martensite rate": rate,
                "sign of the rate": np.sign(rate) * (np.abs(rate) > 1e-3),
                "current squared": current**2,
                "time": time_ / time_[-1],
                "step": (time_ > 0.39 * time_[-1]) * excess / 50.0,
            }
        )
    names, best = list(tables[0]), ("", math.inf, math.inf)
    columns = [np.column_stack(list(table.values())) for table in tables]
    for threshold in (0.003, 0.01, 0.03, 0.1, 0.3):
        model = pysindy.SINDy(
            optimizer=pysindy.STLSQ(threshold=threshold, alpha=1e-3, normalize_columns=True),
            feature_library=pysindy.PolynomialLibrary(degree=1),
            differentiation_method=pysindy.SmoothedFiniteDifference(),
        )
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            model.fit(errors[0][:, None], t=recordings[0].time, u=columns[0])
        weights = np.asarray(model.coefficients())[0]
        remainders = [
            errors[k] - _integrate_linear_model(weights, columns[k], recordings[k].time, errors[k][0]) for k in (1, 2)
        ]
        rms = [float(np.sqrt(np.mean(w**2))) for w in remainders]
        if rms[0] < best[1]:
            sizes = np.abs(weights[2:]) * np.std(columns[0], axis=0)
            term = names[int(np.argmax(sizes))] if np.any(sizes) else ""
            best = (term, rms[0], rms[1])
    return key if key and best[0] in TERMS[key] else best[0], best[2] * 1e-3 / NOISE


def _integrate_linear_model(weights: np.ndarray, columns: np.ndarray, seconds: np.ndarray, first: float) -> np.ndarray:
    """Integrate the error from a linear model of its rate (constant, error, columns), exact under a held input."""
    drive = weights[0] + columns @ weights[2:]
    values = [first]
    pole = min(weights[1], 0.0)
    for k, step in enumerate(np.diff(seconds)):
        growth = math.exp(pole * step)
        values.append(values[-1] * growth + drive[k] * ((growth - 1.0) / pole if pole < -1e-12 else step))
    return np.array(values)


class NeuralHeat(HeatEffect):
    """Heat added by a network of temperature, martensite fraction and stress.

    Attributes:
        weights: Weights of the network, shape ``(5 NEURONS + 1,)``.
        strength: Heat of one unit of its output, W/m^3.
    """

    weights: jax.Array
    strength: jax.Array = parameter("W/m^3", "heat of one unit of the network", 0.0, math.inf, 0.0)
    key = "neural-heat"
    typical = 1.0
    source = "a network"

    def power(self, now: WireState, memory: Any, where: StageContext) -> jax.Array:
        """Return the network's heat in each wire, W/m^3."""
        inner = self.weights[: 4 * NEURONS].reshape(4, NEURONS)
        outer = self.weights[4 * NEURONS :]
        features = ((now.temperature - where.environment.ambient) / 50.0, now.fractions.martensite, now.stress / 2e8)
        neurons = jnp.tanh(sum(s[:, None] * w[None] for s, w in zip(features, inner[:3], strict=True)) + inner[3][None])
        return self.strength * (neurons @ outer[:NEURONS] + outer[NEURONS])


def run_universal_equation(rig: Rig, recordings: list, key: str) -> tuple[str, float]:
    """Fit a network in the heat balance together with the rig's parameters.

    Args:
        rig: The rig.
        recordings: Training, selection and held-out recording.
        key: The hidden effect; not used.

    Returns:
        No name, and the held-out error over the noise.
    """
    size = 5 * NEURONS + 1
    per_kelvin = float(rig.plant.heat.conductance(rig.plant.environment.ambient, rig.plant.wire))
    net = NeuralHeat(weights=jnp.zeros(size), strength=jnp.asarray(20.0 * per_kelvin))
    plant = dataclasses.replace(rig.plant, effects=(net,))
    whole_problem = build_problem(plant, recordings, rig.fit, interpolation=rig.interpolation)
    parts = [
        dataclasses.replace(whole_problem, data=jax.tree.map(lambda leaf, k=k: leaf[k : k + 1], whole_problem.data))
        for k in range(3)
    ]
    free = len(whole_problem.unknowns)

    def residual(vector: jax.Array, problem: Problem) -> jax.Array:
        changed = dataclasses.replace(net, weights=vector[free:])
        return dataclasses.replace(problem, plant=dataclasses.replace(problem.plant, effects=(changed,))).residual(
            vector[:free]
        )

    lower, upper = (
        np.append(side, np.full(size, far)) for side, far in zip(whole_problem.bounds, (-20.0, 20.0), strict=True)
    )
    best = (math.inf, math.inf)
    for seed in (0, 1):
        weights = (
            0.5
            * np.random.default_rng(seed).standard_normal(size)
            * np.append(np.ones(4 * NEURONS), np.full(NEURONS + 1, 0.02))
        )
        start = np.append(whole_problem.nominal, weights)
        point = (
            MultiStartSolver(residual, parts[0], start[None], lower, upper, size=parts[0].size)
            .advance(60)
            .result()
            .points[0]
        )
        searches = [MultiStartSolver(residual, parts[k], point[None], lower, upper, size=parts[0].size) for k in (1, 2)]
        validations = [search.advance(1).result() for search in searches]
        scale = 1.0 / float(np.max(whole_problem.data.weight)) / NOISE
        rms = [float(np.sqrt(np.mean(t.residuals[0] ** 2))) * scale for t in validations]
        best = min(best, (rms[0], rms[1]))
    return "", best[1]


METHODS: dict[str, Callable[[Rig, list, str], tuple[str, float]]] = {
    "smajax diagnose": run_diagnosis,
    "exhaustive refit, BIC": run_exhaustive_refit,
    "SINDy on estimated states": run_sparse_regression,
    "universal differential equation": run_universal_equation,
}


def main() -> None:
    """Run all methods on all cases and print the table."""
    args = arguments(__doc__, quick="one hidden effect", more={"--seeds": {"type": int, "default": 2}})
    if importlib.util.find_spec("pysindy") is None:
        sys.exit('sparse regression needs pysindy: pip install "smajax[rivals]"')
    rig = read_rig(ROOT / "data" / "recordings" / "dead-weight" / "rig.toml")
    answers: dict[str, list[tuple[str, Answer]]] = {name: [] for name in METHODS}
    done_before = read_cases(args.out)
    done = {(c["seed"], c["case"], c["method"]): Answer(c["named"], c["ratio"], c["seconds"]) for c in done_before}
    for seed in range(1 if args.quick else args.seeds):
        for key in CASES[:1] if args.quick else CASES:
            rng = np.random.default_rng([seed, 7, *key.encode()])
            recordings = record(draw_strengths(rng, (key,)) if key else {}, rng)
            for name, method in METHODS.items():
                if (seed, key, name) not in done:
                    start = time.perf_counter()
                    named, ratio = method(rig, recordings, key)
                    done[seed, key, name] = Answer(named, ratio, time.perf_counter() - start)
                    add_case(
                        args.out,
                        {"seed": seed, "case": key, "method": name, **dataclasses.asdict(done[seed, key, name])},
                    )
                    say(f"{key or 'nothing'} ({seed}), {name}: {named or 'nothing'}, {ratio:.2f} of the noise")
                answers[name].append((key, done[seed, key, name]))
    rows = []
    for name, method_answers in answers.items():
        hidden = [(key, a) for key, a in method_answers if key]
        correct = sum(a.named == key for key, a in hidden)
        false_alarms = sum(bool(a.named) for key, a in method_answers if not key)
        ratios = [a.ratio for _, a in hidden]
        seconds = [a.seconds for _, a in method_answers]
        text = (
            f"{correct} of {len(hidden)} named, {false_alarms} false alarms; held-out error over the noise "
            f"{np.median(ratios):.2f} (median), "
        )
        text += f"{max(ratios):.2f} (worst); {np.median(seconds):.0f} s"
        facts = [{"case": key, **dataclasses.asdict(a)} for key, a in method_answers]
        rows.append(Row(name, "-", text, None, {"cases": facts}))
    options = "" if args.quick or args.seeds == 2 else f" --seeds {args.seeds}"
    finish(rows, args, words=options, resumed=bool(done_before))


if __name__ == "__main__":
    main()
