"""Bouc-Wen and Prandtl-Ishlinskii operators identified as in copaci2020.

Gradients against differential evolution.

    python experiments/papers/flexible_actuator/hysteresis_identification.py [--data DIR]
        [--quick] [--json FILE] [--out DIR]

A wire against a bias spring, by tests/reference (other equations: Brinson's kinetics and a heat balance), is heated
and cooled slowly by a triangular voltage: one cycle that goes to both ends, where the loop is saturated, and one that
turns back before. To the last of three cycles, with noise, each operator is fitted by gradients and by SciPy's
differential evolution at the paper's budgets: 60 and 100 iterations for Bouc-Wen's five parameters, 400 for the
Prandtl-Ishlinskii operator with ten plays and two tanh envelopes, all of which it spends. The model goes through the
cycle before, too, where it is not scored: its first cycle is a virgin curve, which the wire left long ago. Told is
also after how many simulations a search was within 1 % of the least error that either found. The paper finds that
Bouc-Wen is poor at the saturated ends and the tanh envelopes are good there.

DIR holds first-order descending curves of a morphing wing's actuator, measured by others: fitted on one file, the
other is predicted.
"""

from __future__ import annotations

import csv
import sys
from pathlib import Path

sys.path.insert(0, str(Path(__file__).resolve().parents[3]))  # the checkout: smajax, tests/reference, experiments

from experiments.common.base import DATA, ROOT, Row, arguments, finish, refuse, say
from experiments.common.charts import Chart, Curve, draw

import numpy as np

from smajax.fitting import baselines
from smajax.fitting.io_models.fit import fit_io_model
from smajax.fitting.io_models.problem import Series, build_io_problem
from smajax.fitting.io_models.specs import bouc_wen_spec, prandtl_ishlinskii_spec
from tests.reference.rig_file import read_rig, simulate

NOISE = 0.02  # mm
PERIOD, STEP = 200.0, 0.5
LOOPS = {"saturated": (0.0, 4.5), "unsaturated": (0.0, 3.6)}
BUDGETS = {"bouc-wen": (60, 100), "prandtl-ishlinskii": (400,)}
MAKERS = {"bouc-wen": bouc_wen_spec, "prandtl-ishlinskii": prandtl_ishlinskii_spec}
STARTS = 12
END = 0.1  # share of the input's range that counts as an end


def loop(name: str) -> Series:
    """The last two of three slow cycles, in V and mm; of the first of them only the input is told."""
    low, high = LOOPS[name]
    seconds = np.arange(0.0, 3 * PERIOD, STEP)
    voltage = low + (high - low) * (1.0 - np.abs(2.0 * ((seconds / PERIOD) % 1.0) - 1.0))
    rig = read_rig(ROOT / "data" / "recordings" / "bias-spring" / "rig.toml")
    lifted = 1e3 * simulate(rig, {"time": seconds, "voltage": voltage}).position
    cycle = int(PERIOD / STEP)
    last = slice(-2 * cycle, None)
    seen = lifted[last] + np.append(
        np.full(cycle, np.nan), NOISE * np.random.default_rng(len(name)).standard_normal(cycle)
    )
    return Series(name, seconds[last] - seconds[last][0], voltage[last], seen)


def rms(series: Series, model: np.ndarray) -> float:
    """RMSE where the output is told."""
    return float(np.sqrt(np.nanmean((model - series.output) ** 2)))


def within(search: baselines.BaselineResult, cost: float) -> str:
    """After how many simulations a search was within 1 % of an error."""
    reached = search.effort_to_reach(1.01**2 * cost)
    return f"there after {reached[0]:,}" if reached else "never there"


def ends(series: Series, model: np.ndarray) -> float:
    """RMSE where the input is within a tenth of its range from either end."""
    share = (series.input - series.input.min()) / np.ptp(series.input)
    near = (share < END) | (share > 1.0 - END)
    return float(np.sqrt(np.nanmean((model - series.output)[near] ** 2)))


def identification(quick: bool, out: Path | None) -> list[Row]:
    """Both operators on both loops."""
    rows: list[Row] = []
    at_ends: dict[str, dict[str, float]] = {}
    for name in list(LOOPS)[: 1 if quick else 2]:
        series = loop(name)
        told_rows = np.isfinite(series.output)
        count = int(np.sum(told_rows))
        drawn = [Curve("reference with noise", series.input[told_rows], series.output[told_rows])]
        for kind, make in MAKERS.items():
            family = make([series])
            problem = build_io_problem(family, [series], 1.0 / NOISE)
            by_gradient = baselines.run_gradient_search(problem, seed=0, starts=STARTS, max_steps=150)
            for iterations in BUDGETS[kind]:
                budget = iterations * 15 * family.size // (10 if quick else 1)
                evolved = baselines.run_differential_evolution(
                    problem, seed=0, budget=budget, vectorized=True, settles=False
                )
                found = {"gradient": by_gradient, "differential evolution": evolved}
                told, numbers, curves = [], {}, []
                least = min(one.cost for one in found.values())
                for how, one in found.items():
                    model = np.asarray(problem.predict(one.vector)[0])
                    rmse, far = rms(series, model), ends(series, model)
                    cost = f"{one.simulations:,} simulations ({within(one, least)}), {one.wall_time:.1f} s"
                    told.append(f"{how} {rmse:.3f} mm ({far:.3f} at the ends), {cost}")
                    numbers[how] = {"rmse": rmse, "ends": far, "simulations": one.simulations, "wall": one.wall_time}
                    steps = [(s, float(np.sqrt(c / count)) * NOISE) for s, _, c in one.history if c < 1e12]
                    curves.append(Curve(how, [s for s, _ in steps], [e for _, e in steps], steps=True))
                    if how == "gradient" and iterations == BUDGETS[kind][-1]:
                        drawn.append(Curve(kind, series.input[told_rows], model[told_rows]))
                        at_ends.setdefault(name, {})[kind] = far
                rmse = [numbers[how]["rmse"] for how in found]
                say(f"{name}, {kind}, {iterations} iterations: " + "; ".join(told))
                what = f"{name} loop, {kind} ({family.size} parameters), {iterations} iterations"
                rows.append(Row(what, "gradient no worse", "; ".join(told), rmse[0] <= 1.01 * rmse[1], numbers))
                if out:
                    chart = Chart(f"{kind}, {name} loop", "simulations", "RMSE [mm]", curves, log_x=True, log_y=True)
                    draw(chart, out, f"hysteresis_{name}_{kind}_{iterations}")
        if out:
            draw(Chart(f"{name} loop", "voltage [V]", "contraction [mm]", drawn), out, f"hysteresis_{name}")
    for name, found in at_ends.items():
        ratio = found["bouc-wen"] / found["prandtl-ishlinskii"]
        told = f"Bouc-Wen's error at the ends is {ratio:.1f} times that of the tanh envelopes"
        saturated = name == "saturated"
        rows.append(
            Row(
                f"{name} loop: the paper's finding",
                "> 1" if saturated else "-",
                told,
                ratio > 1.0 if saturated else None,
            )
        )
    return rows


def read_curves(path: Path) -> list[Series]:
    """The branches of a file, each from no input up to where it turns and back; 10 s a point."""
    if not path.is_file():
        refuse(f"{path} is not there: give the folder of the first-order curves by --data")
    with path.open(newline="", encoding="utf-8") as file:
        rows = [[float(v) for v in row] for row in list(csv.reader(file))[1:]]
    columns = np.array(rows)
    branches = [columns[columns[:, 0] == k] for k in np.unique(columns[:, 0])]
    return [Series(f"{path.stem} {k}", 10.0 * np.arange(len(b)), b[:, 1], b[:, 2]) for k, b in enumerate(branches)]


def first_order_curves(folder: Path, quick: bool, out: Path | None) -> list[Row]:
    """Fitted on one file, predicting the other."""
    rows, sets = [], {name: read_curves(folder / f"Data{name}.csv") for name in ("T", "E")}
    for train, held in (("T", "E"),) if quick else (("T", "E"), ("E", "T")):
        for kind, make in {"prandtl-ishlinskii": prandtl_ishlinskii_spec, "bouc-wen": bouc_wen_spec}.items():
            found = fit_io_model(make(sets[train]), sets[train], starts=STARTS)
            left = np.concatenate([found.respond(s) - s.output for s in sets[held]])
            span = float(np.ptp(np.concatenate([s.output for s in sets[held]])))
            rmse = float(np.sqrt(np.mean(left**2)))
            told = (
                f"{rmse:.3f} of {span:.1f} ({100 * rmse / span:.1f} %) on Data{held}; {found.rmse:.3f} on "
                f"Data{train}; {found.wall_time:.0f} s"
            )
            rows.append(
                Row(
                    f"first-order curves, {kind} on Data{train}",
                    "-",
                    told,
                    None,
                    {"holdout": rmse, "train": found.rmse},
                )
            )
            if out and kind == "prandtl-ishlinskii":
                curves = [Curve(f"measured {s.name}", s.input, s.output, dashed=True) for s in sets[held][:3]]
                curves += [Curve(f"model {s.name}", s.input, found.respond(s)) for s in sets[held][:3]]
                draw(Chart(f"predicting Data{held}", "input [V]", "output", curves), out, f"hysteresis_forc_{held}")
    return rows


def main() -> None:
    """Prints the table."""
    args = arguments(
        __doc__, data="morphing-forc", quick="the saturated loop, a tenth of the budgets, one direction of the curves"
    )
    rows = identification(args.quick, args.out)
    if args.data.is_dir() or args.data != DATA / "morphing-forc":
        rows += first_order_curves(args.data, args.quick, args.out)
    else:
        say(f"{args.data} is not there: the first-order curves are left out")
    finish(rows, args)


if __name__ == "__main__":
    main()
