"""The temperature estimator of ali2026: which exponent n, and whether linear least squares suffices.

    python experiments/papers/hip/hip_estimator.py [--data DIR] [--quick] [--json FILE] [--out DIR]

Source: ali2026. The estimator predicts the wire's excess temperature from its electrical power,
dT/dt = a_1 P + a_2 sgn(T) |T|^n with n = 1, 2 or 3; a third term, a_1 P + a_2 T + a_3 T^3, combines n = 1 and 3. The
paper solves for the coefficients by linear least squares on differences of the measured temperature. Here they are also
fitted to the simulated temperature, for which the estimator is used. The score is the error of the simulated
temperature on a held-out recording. The recordings are those of two reference rigs (tests/reference, whose h(T) and
phase-dependent resistance the estimator does not have), with 0.4 K of noise, and of a soft arm measured by others
(DIR), whose thermocouple is refreshed every second or third row and whose power is assumed proportional to the duty.
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
    """A recording of power and temperature.

    Attributes:
        time: Time, s.
        power: Power, W, or duty.
        excess: Excess temperature, K; NaN where it was not measured.
    """

    time: np.ndarray
    power: np.ndarray
    excess: np.ndarray


@njit(cache=True)
def simulate_excess(time, power, start, factors, exponents):
    """Return the excess temperature at all rows, by Heun's rule with held power.

    Args:
        time: Times, s, shape ``(n,)``.
        power: Power, shape ``(n,)``.
        start: First excess temperature, K.
        factors: Factor of the power, and one for each exponent.
        exponents: Exponents of the excess temperature.
    """
    values = np.empty(len(time))
    values[0] = value = start
    for k in range(len(time) - 1):
        step = (time[k + 1] - time[k]) / PIECES
        for _ in range(PIECES):
            first = factors[0] * power[k]
            for j in range(len(exponents)):
                first += factors[j + 1] * np.sign(value) * abs(value) ** exponents[j]
            guess = value + step * first
            second = factors[0] * power[k]
            for j in range(len(exponents)):
                second += factors[j + 1] * np.sign(guess) * abs(guess) ** exponents[j]
            value = value + 0.5 * step * (first + second)
            value = min(max(value, -500.0), 5000.0)
        values[k + 1] = value
    return values


def fit_linear(log: Log, exponents: tuple[float, ...]) -> np.ndarray:
    """Return the coefficients as the paper does.

    Differences of the measured temperature are regressed on power and powers of the temperature.
    """
    measured = np.flatnonzero(np.isfinite(log.excess))
    t, excess = log.time[measured], log.excess[measured]
    rate = np.diff(excess) / np.diff(t)
    middle = 0.5 * (excess[1:] + excess[:-1])
    power = np.array([np.mean(log.power[a:b]) for a, b in itertools.pairwise(measured)])
    columns = np.column_stack([power, *(np.sign(middle) * np.abs(middle) ** n for n in exponents)])
    sizes = np.linalg.norm(columns, axis=0)
    return np.linalg.lstsq(columns / sizes, rate, rcond=None)[0] / sizes


def fit_by_simulation(log: Log, exponents: tuple[float, ...], start: np.ndarray) -> np.ndarray:
    """Return the coefficients by least squares on the simulated temperature, each in units of its start value.

    Args:
        log: The recording.
        exponents: Exponents of the excess temperature.
        start: Start values.
    """
    measured = np.isfinite(log.excess)
    powers = np.array(exponents)
    scale = np.where(start != 0.0, start, 1e-6)

    def residual(x: np.ndarray) -> np.ndarray:
        return (simulate_excess(log.time, log.power, _first_excess(log), x * scale, powers) - log.excess)[measured]

    best = min(
        (scipy.optimize.least_squares(residual, np.ones(len(start)) * s, x_scale="jac") for s in (1.0, 0.5, 2.0)),
        key=lambda r: r.cost,
    )
    return best.x * scale


def _first_excess(log: Log) -> float:
    return float(log.excess[np.isfinite(log.excess)][0])


def simulation_rmse(log: Log, exponents: tuple[float, ...], factors: np.ndarray) -> float:
    """Return the RMSE of the simulated temperature, K.

    Args:
        log: The recording.
        exponents: Exponents of the excess temperature.
        factors: The coefficients.
    """
    predicted = simulate_excess(log.time, log.power, _first_excess(log), factors, np.array(exponents))
    return float(np.sqrt(np.nanmean((predicted - log.excess) ** 2)))


def reference_logs(name: str) -> tuple[Log, Log]:
    """Simulate a shipped rig under its training and its held-out input, with noise."""
    folder = ROOT / "data" / "recordings" / name
    logs = []
    rig = read_rig(folder / "rig.toml")
    for k, part in enumerate(("train", "holdout")):
        channels = read_csv(folder / f"{part}.csv")
        run = simulate(rig, channels)
        excess = run.temperature[:, 0] - rig.wire.ambient
        noise = NOISE * np.random.default_rng(k).standard_normal(len(excess))
        logs.append(Log(channels["time"], run.current[:, 0] ** 2 * run.resistance[:, 0], excess + noise))
    return logs[0], logs[1]


def arm_logs(folder: Path) -> dict[str, tuple[Log, Log]]:
    """Return the first and the second pulse of each log."""
    logs = {}
    for log in read_logs(folder):
        rest = log.temperature[np.isfinite(log.temperature)][:5].mean()
        parts = []
        for mask in (log.time < log.until, log.time > log.scored):
            parts.append(Log(log.time[mask], log.duty[mask], log.temperature[mask] - rest))
        logs[log.name] = (parts[0], parts[1])
    return logs


def cooling_exponent(log: Log) -> float:
    """Return the exponent of the cooling rate over the excess temperature without power, over half seconds."""
    measured = np.isfinite(log.excess)
    grid = np.arange(log.time[0], log.time[-1], 0.5)
    excess = np.interp(grid, log.time[measured], log.excess[measured])
    power = np.interp(grid, log.time, log.power)
    rate = -np.diff(excess) / 0.5
    middle = 0.5 * (excess[1:] + excess[:-1])
    cools = (np.maximum(power[1:], power[:-1]) < 0.02 * log.power.max()) & (middle > 0.1 * middle.max()) & (rate > 0.0)
    return float(np.polyfit(np.log(middle[cools]), np.log(rate[cools]), 1)[0]) if np.sum(cools) > 5 else float("nan")


def main() -> None:
    """Print the table."""
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
    for name, (train, held_out) in cases.items():
        scores: dict[str, tuple[float, float]] = {}
        curves = [
            Curve(
                "measured", held_out.time[np.isfinite(held_out.excess)], held_out.excess[np.isfinite(held_out.excess)]
            )
        ]
        for form, exponents in FORMS.items():
            start = fit_linear(train, exponents)
            refined = fit_by_simulation(train, exponents, start)
            scores[form] = (simulation_rmse(held_out, exponents, start), simulation_rmse(held_out, exponents, refined))
            say(
                f"{name}, {form}: {scores[form][0]:.2f} K by linear least squares, {scores[form][1]:.2f} K by the "
                "simulation's error"
            )
            curves.append(
                Curve(
                    form,
                    held_out.time,
                    simulate_excess(
                        held_out.time, held_out.power, _first_excess(held_out), refined, np.array(exponents)
                    ),
                )
            )
        if args.out:
            draw(
                Chart(name, "time [s]", "excess temperature [K]", curves),
                args.out,
                "hip_estimator_" + name.replace(", ", "_"),
            )
        for k, method in enumerate(("linear least squares", "simulation error")):
            text = ", ".join(f"{form}: {s[k]:.2f} K" for form, s in scores.items())
            single = {form: s[k] for form, s in scores.items() if " and " not in form}
            text += f"; best single exponent {min(single, key=lambda f: single[f])}"
            rows.append(Row(f"{name}, {method}", "-", text, None, {"rmse": scores}))
        rows.append(Row(f"{name}, why", "-", f"without power the wire cools as T^{cooling_exponent(train):.2f}", None))
    finish(rows, args)


if __name__ == "__main__":
    main()
