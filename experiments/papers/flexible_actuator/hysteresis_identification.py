"""Bouc-Wen and Prandtl-Ishlinskii operators identified as in copaci2020: gradients against differential evolution.

    python experiments/papers/flexible_actuator/hysteresis_identification.py [--data DIR]
        [--quick] [--json FILE] [--out DIR]

Source: copaci2020. A wire against a bias spring, simulated by tests/reference (Brinson's kinetics and a heat balance,
not these operators), is heated and cooled slowly by a triangular voltage: one cycle reaches both saturated ends of the
loop, another turns back before. Each operator is fitted to the last of three cycles, with noise, by gradients and by
SciPy's differential evolution at the paper's budgets: 60 and 100 iterations for Bouc-Wen's five parameters, 400 for the
Prandtl-Ishlinskii operator with ten plays and two tanh envelopes. The model is also simulated over the cycle before,
which is not scored, since its own first cycle is a virgin curve. A row also gives the simulations after which a search
was within 1 % of the least error of both. The paper finds that Bouc-Wen is poor at the saturated ends and the tanh
envelopes are good there.

DIR holds first-order descending curves of a morphing wing's actuator, measured by others: a model is fitted to one file
and predicts the other.
"""

from __future__ import annotations

import csv
import sys
from pathlib import Path
from typing import Any

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
PERIOD, STEP = 200.0, 0.5  # s
LOOPS = {"saturated": (0.0, 4.5), "unsaturated": (0.0, 3.6)}
BUDGETS = {"bouc-wen": (60, 100), "prandtl-ishlinskii": (400,)}
SPECS = {"bouc-wen": bouc_wen_spec, "prandtl-ishlinskii": prandtl_ishlinskii_spec}
STARTS = 12
END_SHARE = 0.1  # share of the input's range that counts as an end


def simulate_loop(name: str) -> Series:
    """Return the last two of three slow cycles, in V and mm; the output of the first of them is NaN."""
    low, high = LOOPS[name]
    seconds = np.arange(0.0, 3 * PERIOD, STEP)
    voltage = low + (high - low) * (1.0 - np.abs(2.0 * ((seconds / PERIOD) % 1.0) - 1.0))
    rig = read_rig(ROOT / "data" / "recordings" / "bias-spring" / "rig.toml")
    contraction = 1e3 * simulate(rig, {"time": seconds, "voltage": voltage}).position
    cycle = int(PERIOD / STEP)
    last = slice(-2 * cycle, None)
    measured = contraction[last] + np.append(
        np.full(cycle, np.nan), NOISE * np.random.default_rng(len(name)).standard_normal(cycle)
    )
    return Series(name, seconds[last] - seconds[last][0], voltage[last], measured)


def rms(series: Series, model: np.ndarray) -> float:
    """Return the RMSE where the output is measured."""
    return float(np.sqrt(np.nanmean((model - series.output) ** 2)))


def effort_text(search: baselines.BaselineResult, cost: float) -> str:
    """Return in words after how many simulations a search was within 1 % of an error."""
    effort = search.effort_to_reach(1.01**2 * cost)
    return f"there after {effort[0]:,}" if effort else "never there"


def end_rms(series: Series, model: np.ndarray) -> float:
    """Return the RMSE where the input is within a tenth of its range from either end."""
    share = (series.input - series.input.min()) / np.ptp(series.input)
    near = (share < END_SHARE) | (share > 1.0 - END_SHARE)
    return float(np.sqrt(np.nanmean((model - series.output)[near] ** 2)))


def identification_rows(quick: bool, out: Path | None) -> list[Row]:
    """Fit both operators to both loops.

    Args:
        quick: Only the saturated loop, with a tenth of the budgets.
        out: Where the pictures go; ``None`` for none.
    """
    rows: list[Row] = []
    at_ends: dict[str, dict[str, float]] = {}
    for name in list(LOOPS)[: 1 if quick else 2]:
        series = simulate_loop(name)
        scored = np.isfinite(series.output)
        loop_curves = [Curve("reference with noise", series.input[scored], series.output[scored])]
        for kind, make in SPECS.items():
            spec = make([series])
            problem = build_io_problem(spec, [series], 1.0 / NOISE)
            by_gradient = baselines.run_gradient_search(problem, seed=0, starts=STARTS, max_steps=150)
            for iterations in BUDGETS[kind]:
                budget = iterations * 15 * spec.size // (10 if quick else 1)
                evolved = baselines.run_differential_evolution(
                    problem, seed=0, budget=budget, vectorized=True, settles=False
                )
                searches = {"gradient": by_gradient, "differential evolution": evolved}
                label = f"{name} loop, {kind} ({spec.size} parameters), {iterations} iterations"
                row, curves = comparison_row(label, series, problem, searches)
                say(f"{name}, {kind}, {iterations} iterations: {row.measured}")
                rows.append(row)
                if out:
                    chart = Chart(f"{kind}, {name} loop", "simulations", "RMSE [mm]", curves, log_x=True, log_y=True)
                    draw(chart, out, f"hysteresis_{name}_{kind}_{iterations}")
            model = np.asarray(problem.predict(by_gradient.vector)[0])
            loop_curves.append(Curve(kind, series.input[scored], model[scored]))
            at_ends.setdefault(name, {})[kind] = end_rms(series, model)
        if out:
            draw(Chart(f"{name} loop", "voltage [V]", "contraction [mm]", loop_curves), out, f"hysteresis_{name}")
    return rows + [end_row(name, errors) for name, errors in at_ends.items()]


def comparison_row(
    label: str, series: Series, problem: Any, searches: dict[str, baselines.BaselineResult]
) -> tuple[Row, list[Curve]]:
    """Compare the errors and the costs of two searches.

    Args:
        label: Name of the row.
        series: The loop.
        problem: The fit problem.
        searches: The searches by name, that by gradients first.

    Returns:
        The row, and curves of the error over the number of simulations.
    """
    texts, numbers, curves = [], {}, []
    count = int(np.sum(np.isfinite(series.output)))
    least_cost = min(result.cost for result in searches.values())
    for method, result in searches.items():
        model = np.asarray(problem.predict(result.vector)[0])
        rmse = rms(series, model)
        end_error = end_rms(series, model)
        effort = effort_text(result, least_cost)
        cost = f"{result.simulations:,} simulations ({effort}), {result.wall_time:.1f} s"
        texts.append(f"{method} {rmse:.3f} mm ({end_error:.3f} at the ends), {cost}")
        numbers[method] = {
            "rmse": rmse,
            "ends": end_error,
            "simulations": result.simulations,
            "wall": result.wall_time,
        }
        steps = [(s, float(np.sqrt(c / count)) * NOISE) for s, _, c in result.history if c < 1e12]
        curves.append(Curve(method, [s for s, _ in steps], [e for _, e in steps], steps=True))
    errors = [numbers[method]["rmse"] for method in searches]
    return Row(label, "gradient no worse", "; ".join(texts), errors[0] <= 1.01 * errors[1], numbers), curves


def end_row(name: str, errors: dict[str, float]) -> Row:
    """Compare the errors of both operators at the ends of a loop."""
    ratio = errors["bouc-wen"] / errors["prandtl-ishlinskii"]
    text = f"Bouc-Wen's error at the ends is {ratio:.1f} times that of the tanh envelopes"
    saturated = name == "saturated"
    target, is_met = ("> 1", ratio > 1.0) if saturated else ("-", None)
    return Row(f"{name} loop: the paper's finding", target, text, is_met)


def read_curves(path: Path) -> list[Series]:
    """Read the branches of a file, each from zero input up to its turning point and back, with 10 s a point."""
    if not path.is_file():
        refuse(f"{path} is not there: give the folder of the first-order curves by --data")
    with path.open(newline="", encoding="utf-8") as file:
        rows = [[float(v) for v in row] for row in list(csv.reader(file))[1:]]
    columns = np.array(rows)
    branches = [columns[columns[:, 0] == k] for k in np.unique(columns[:, 0])]
    return [Series(f"{path.stem} {k}", 10.0 * np.arange(len(b)), b[:, 1], b[:, 2]) for k, b in enumerate(branches)]


def first_order_rows(folder: Path, quick: bool, out: Path | None) -> list[Row]:
    """Fit the operators to one file, and predict the other.

    Args:
        folder: Folder of the curves.
        quick: Only one direction.
        out: Where the pictures go; ``None`` for none.
    """
    rows = []
    sets = {name: read_curves(folder / f"Data{name}.csv") for name in ("T", "E")}
    for train, held_out in (("T", "E"),) if quick else (("T", "E"), ("E", "T")):
        for kind, make in {"prandtl-ishlinskii": prandtl_ishlinskii_spec, "bouc-wen": bouc_wen_spec}.items():
            result = fit_io_model(make(sets[train]), sets[train], starts=STARTS)
            residual = np.concatenate([result.respond(s) - s.output for s in sets[held_out]])
            span = float(np.ptp(np.concatenate([s.output for s in sets[held_out]])))
            rmse = float(np.sqrt(np.mean(residual**2)))
            text = (
                f"{rmse:.3f} of {span:.1f} ({100 * rmse / span:.1f} %) on Data{held_out}; {result.rmse:.3f} on "
                f"Data{train}; {result.wall_time:.0f} s"
            )
            rows.append(
                Row(
                    f"first-order curves, {kind} on Data{train}",
                    "-",
                    text,
                    None,
                    {"holdout": rmse, "train": result.rmse},
                )
            )
            if out and kind == "prandtl-ishlinskii":
                curves = [Curve(f"measured {s.name}", s.input, s.output, dashed=True) for s in sets[held_out][:3]]
                curves += [Curve(f"model {s.name}", s.input, result.respond(s)) for s in sets[held_out][:3]]
                draw(
                    Chart(f"predicting Data{held_out}", "input [V]", "output", curves),
                    out,
                    f"hysteresis_forc_{held_out}",
                )
    return rows


def main() -> None:
    """Print the table."""
    args = arguments(
        __doc__, data="morphing-forc", quick="the saturated loop, a tenth of the budgets, one direction of the curves"
    )
    rows = identification_rows(args.quick, args.out)
    if args.data.is_dir() or args.data != DATA / "morphing-forc":
        rows += first_order_rows(args.data, args.quick, args.out)
    else:
        say(f"{args.data} is not there: the first-order curves are left out")
    finish(rows, args)


if __name__ == "__main__":
    main()
