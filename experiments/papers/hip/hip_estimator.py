"""ali2026's temperature estimator: which exponent n, and is linear least squares enough?

    python experiments/papers/hip/hip_estimator.py [--data DIR] [--quick] [--json FILE] [--out DIR]

The estimator predicts the wire's excess temperature from its electrical power, dT/dt = a_1 P + a_2 sgn(T) |T|^n
(where n is 1, 2 or 3; with a third term, a_1 P + a_2 T + a_3 T^3, it nests n = 1 and 3). The paper solves for the
coefficients by linear least squares on differences of the measured temperature; here they are also fitted to the
simulated temperature itself, which is what the estimator is used for. Scored is the simulated temperature on a
held-out recording: of two reference rigs (tests/reference, whose h(T) and phase-dependent resistance the estimator
does not know), with 0.4 K of noise, and of a soft arm measured by others (DIR), whose thermocouple is refreshed every
second or third row and whose power is taken to go with the duty.
"""

from __future__ import annotations

import itertools
import sys
from dataclasses import dataclass
from pathlib import Path

sys.path.insert(0, str(Path(__file__).resolve().parents[3]))  # the checkout: smajax, tests/reference, experiments

from experiments.common.arm_log import read_logs
from experiments.common.base import DATA, ROOT, Row, arguments, finish, say
from experiments.common.charts import Chart, Curve, draw

import numpy as np
import scipy.optimize
from numba import njit

from tests.reference.rig_file import read_csv, read_rig, simulate

FORMS = {"n = 1": (1.0,), "n = 2": (2.0,), "n = 3": (3.0,), "n = 1 and 3": (1.0, 3.0)}
NOISE = 0.4
PIECES = 4


@dataclass(frozen=True)
class Log:
    """Times in s, power (in W, or duty), excess temperature in K; NaN where it was not measured."""

    time: np.ndarray
    power: np.ndarray
    excess: np.ndarray


@njit(cache=True)
def predicted(time, power, start, factors, exponents):
    """Excess temperature at all rows: power is held, each step in pieces by Heun's rule."""
    found = np.empty(len(time))
    found[0] = now = start
    for k in range(len(time) - 1):
        step = (time[k + 1] - time[k]) / PIECES
        for _ in range(PIECES):
            first = factors[0] * power[k]
            for j in range(len(exponents)):
                first += factors[j + 1] * np.sign(now) * abs(now) ** exponents[j]
            guess = now + step * first
            second = factors[0] * power[k]
            for j in range(len(exponents)):
                second += factors[j + 1] * np.sign(guess) * abs(guess) ** exponents[j]
            now = now + 0.5 * step * (first + second)
            now = min(max(now, -500.0), 5000.0)
        found[k + 1] = now
    return found


def linear(log: Log, exponents: tuple[float, ...]) -> np.ndarray:
    """Coefficients as in the paper.

    Differences of the measured temperature against power and powers of the temperature.
    """
    seen = np.flatnonzero(np.isfinite(log.excess))
    t, excess = log.time[seen], log.excess[seen]
    rate = np.diff(excess) / np.diff(t)
    middle = 0.5 * (excess[1:] + excess[:-1])
    power = np.array([np.mean(log.power[a:b]) for a, b in itertools.pairwise(seen)])
    columns = np.column_stack([power, *(np.sign(middle) * np.abs(middle) ** n for n in exponents)])
    sizes = np.linalg.norm(columns, axis=0)
    return np.linalg.lstsq(columns / sizes, rate, rcond=None)[0] / sizes


def by_simulation(log: Log, exponents: tuple[float, ...], start: np.ndarray) -> np.ndarray:
    """Coefficients by least squares on the simulated temperature, each in units of its start value."""
    seen, powers = np.isfinite(log.excess), np.array(exponents)
    scale = np.where(start != 0.0, start, 1e-6)

    def left(x: np.ndarray) -> np.ndarray:
        return (predicted(log.time, log.power, _first(log), x * scale, powers) - log.excess)[seen]

    best = min(
        (scipy.optimize.least_squares(left, np.ones(len(start)) * s, x_scale="jac") for s in (1.0, 0.5, 2.0)),
        key=lambda r: r.cost,
    )
    return best.x * scale


def _first(log: Log) -> float:
    return float(log.excess[np.isfinite(log.excess)][0])


def error(log: Log, exponents: tuple[float, ...], factors: np.ndarray) -> float:
    """RMSE of the simulated temperature in K."""
    found = predicted(log.time, log.power, _first(log), factors, np.array(exponents))
    return float(np.sqrt(np.nanmean((found - log.excess) ** 2)))


def reference_logs(name: str) -> tuple[Log, Log]:
    """A shipped rig's training and holdout input, by the reference simulator, with noise."""
    folder, logs = ROOT / "data" / "recordings" / name, []
    rig = read_rig(folder / "rig.toml")
    for k, part in enumerate(("train", "holdout")):
        channels = read_csv(folder / f"{part}.csv")
        run = simulate(rig, channels)
        excess = run.temperature[:, 0] - rig.wire.ambient
        noise = NOISE * np.random.default_rng(k).standard_normal(len(excess))
        logs.append(Log(channels["time"], run.current[:, 0] ** 2 * run.resistance[:, 0], excess + noise))
    return logs[0], logs[1]


def arm_logs(folder: Path) -> dict[str, tuple[Log, Log]]:
    """Each log's first pulse, and its second."""
    found = {}
    for log in read_logs(folder):
        rest = log.temperature[np.isfinite(log.temperature)][:5].mean()
        parts = []
        for mask in (log.time < log.until, log.time > log.scored):
            parts.append(Log(log.time[mask], log.duty[mask], log.temperature[mask] - rest))
        found[log.name] = (parts[0], parts[1])
    return found


def cooling_exponent(log: Log) -> float:
    """Exponent of the cooling rate over the excess temperature without power, over half a second at a time."""
    seen = np.isfinite(log.excess)
    grid = np.arange(log.time[0], log.time[-1], 0.5)
    excess, power = np.interp(grid, log.time[seen], log.excess[seen]), np.interp(grid, log.time, log.power)
    rate, middle = -np.diff(excess) / 0.5, 0.5 * (excess[1:] + excess[:-1])
    cools = (np.maximum(power[1:], power[:-1]) < 0.02 * log.power.max()) & (middle > 0.1 * middle.max()) & (rate > 0.0)
    return float(np.polyfit(np.log(middle[cools]), np.log(rate[cools]), 1)[0]) if np.sum(cools) > 5 else float("nan")


def main() -> None:
    """Prints the table."""
    args = arguments(__doc__, data="bu-softlimb", quick="one reference rig only")
    cases = {
        f"reference, {name}": reference_logs(name)
        for name in (("dead-weight",) if args.quick else ("dead-weight", "bias-spring"))
    }
    if not args.quick and (args.data.is_dir() or args.data != DATA / "bu-softlimb"):
        cases |= arm_logs(args.data)
    elif not args.quick:
        say(f"{args.data} is not there: the soft arm is left out")
    rows = []
    for name, (train, held) in cases.items():
        scores: dict[str, tuple[float, float]] = {}
        curves = [Curve("measured", held.time[np.isfinite(held.excess)], held.excess[np.isfinite(held.excess)])]
        for form, exponents in FORMS.items():
            start = linear(train, exponents)
            better = by_simulation(train, exponents, start)
            scores[form] = (error(held, exponents, start), error(held, exponents, better))
            say(
                f"{name}, {form}: {scores[form][0]:.2f} K by linear least squares, {scores[form][1]:.2f} K by the "
                "simulation's error"
            )
            curves.append(
                Curve(form, held.time, predicted(held.time, held.power, _first(held), better, np.array(exponents)))
            )
        if args.out:
            draw(
                Chart(name, "time [s]", "excess temperature [K]", curves),
                args.out,
                "hip_estimator_" + name.replace(", ", "_"),
            )
        for k, how in enumerate(("linear least squares", "simulation error")):
            told = ", ".join(f"{form}: {s[k]:.2f} K" for form, s in scores.items())
            single = {form: s[k] for form, s in scores.items() if " and " not in form}
            told += f"; best single exponent {min(single, key=lambda f: single[f])}"
            rows.append(Row(f"{name}, {how}", "-", told, None, {"rmse": scores}))
        rows.append(Row(f"{name}, why", "-", f"without power the wire cools as T^{cooling_exponent(train):.2f}", None))
    finish(rows, args)


if __name__ == "__main__":
    main()
