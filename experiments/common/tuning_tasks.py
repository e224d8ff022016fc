"""Random tuning tasks of a wire that lifts a weight, and their judgement on the exact simulator (tests/reference)."""

from __future__ import annotations

from dataclasses import dataclass, replace
from pathlib import Path
from typing import NamedTuple

from experiments.common.base import ROOT

import numpy as np

from smajax.control.analysis.step_response import find_jumps, step_responses, tracking_errors
from tests.reference.closed_loop import Pid, lift
from tests.reference.rig_file import RigFile
from tests.reference.rig_file import read_rig as read_reference

FOLDER = ROOT / "data" / "recordings" / "dead-weight"
# Fresh draws of noise and ambient temperature for each task, and the range of the temperature, K.
DRAWS = 20
AMBIENT = 3.0
# Tolerance of a limit: overshoot as a share of the jump, temperature in K, as the command's.
TOLERANCE = {"overshoot": 4e-5, "temperature": 0.02}
_DIAMETERS = (0.1, 0.15, 0.25, 0.38, 0.51)  # mm
_GRAVITY = 9.81


@dataclass(frozen=True)
class TuningTask:
    """A task.

    Attributes:
        number: Number, which is the seed of its draws.
        diameter: Diameter of the wire, mm.
        mass: Load, kg.
        period: Period of the controller, s.
        hold: Duration of each level, s.
        levels: Levels of the reference, mm.
        noise: Standard deviation of the sensor's noise, um.
        limits: Limits by name: overshoot as a share, temperature in degC.
        derivative: Whether the controller has a derivative part.
    """

    number: int
    diameter: float
    mass: float
    period: float
    hold: float
    levels: tuple[float, ...]
    noise: float
    limits: dict[str, float]
    derivative: bool

    @property
    def current(self) -> float:
        """Largest current, A, scaled from that of the shipped wire."""
        return round(0.5 * (self.diameter / 0.15) ** 1.5, 3)

    @property
    def words(self) -> str:
        """The task in words."""
        limits = " and ".join(
            f"overshoot <= {100 * v:.0f} %" if n == "overshoot" else f"<= {v:.0f} degC" for n, v in self.limits.items()
        )
        levels = ", ".join(f"{v:g}" for v in self.levels)
        kind = "PID" if self.derivative else "PI"
        return f"{self.number}: {self.diameter:g} mm, {kind}, {levels} mm, noise {self.noise:g} um, {limits}"

    def rig_text(self) -> str:
        """Return the text of the rig file."""
        text = (FOLDER / "rig.toml").read_text(encoding="utf-8")
        text = text.replace('diameter = "0.15 mm"', f'diameter = "{self.diameter:g} mm"')
        return text.replace('mass = "0.2 kg"', f'mass = "{self.mass:g} kg"')

    def controller_text(self) -> str:
        """Return the text of the controller file."""
        factor = self.current / 0.5
        lines = [
            "schema = 1",
            "[controller]",
            'kind = "pid"',
            f'period = "{1e3 * self.period:g} ms"',
            f'output = ["0 A", "{self.current:g} A"]',
            "[gains]",
            f'kp = "{30 * factor:g} A/m"',
            f'ki = "{10 * factor:g} A/m/s"',
        ]
        if self.derivative:
            lines += [f'kd = "{0.5 * factor:g} A s/m"', f'filter_time = "{2.5e3 * self.period:g} ms"']
        lines += ["[reference]", 'kind = "staircase"', f'duration = "{self.hold * len(self.levels):g} s"']
        lines += [f'hold = "{self.hold:g} s"', f"levels = {[f'{v:g} mm' for v in self.levels]}".replace("'", '"')]
        units = {"overshoot": lambda v: f"{100 * v:g} %", "temperature": lambda v: f"{v:g} degC"}
        lines += ["[limits]", *(f'{name} = "{units[name](v)}"' for name, v in self.limits.items())]
        return "\n".join([*lines, "[sensor]", f'noise = "{self.noise:g} um"', ""])

    def reference(self) -> np.ndarray:
        """Return the reference at the samples, m."""
        return np.repeat(1e-3 * np.array(self.levels), round(self.hold / self.period))

    def truth(self) -> RigFile:
        """Return the rig of the exact simulator."""
        rig = read_reference(FOLDER / "rig.toml")
        return replace(rig, wire=rig.wire._replace(diameter=1e-3 * self.diameter), mechanism={"mass": self.mass})


def random_task(number: int) -> TuningTask:
    """Draw a task.

    Args:
        number: Number of the task, the seed of the draw.
    """
    rng = np.random.default_rng([number, 45])
    diameter = float(rng.choice(_DIAMETERS))
    area = 0.25 * np.pi * (1e-3 * diameter) ** 2
    mass = float(f"{rng.uniform(90e6, 140e6) * area / _GRAVITY:.3g}")
    levels: list[float] = []
    while len(levels) < rng.integers(2, 4):
        level = round(float(rng.uniform(2.0, 6.5)), 1)
        if not levels or abs(level - levels[-1]) >= 1.0:
            levels.append(level)
    limits = {"overshoot": float(rng.choice([0.03, 0.05, 0.08, 0.12]))}
    if rng.uniform() < 0.5:
        limits["temperature"] = float(rng.choice([100.0, 110.0, 120.0]))
        if rng.uniform() < 0.3:
            limits = {"temperature": limits["temperature"]}
    # Thicker wires are slower; the time constant of the shipped wire belongs to 20 ms and 8 s.
    slower = max(1.0, diameter / 0.15)
    period = float(rng.choice([0.02, 0.05])) if slower < 1.5 else 0.05
    hold = round(8.0 * slower / period) * period
    noise = float(rng.choice([2.0, 5.0, 10.0, 20.0]))
    return TuningTask(number, diameter, mass, period, hold, tuple(levels), noise, limits, bool(rng.uniform() < 0.4))


class ExactRun(NamedTuple):
    """A run of the exact simulator.

    Attributes:
        rmse: Tracking error, m.
        overshoot: Largest overshoot of all jumps, as a share of the jump.
        temperature: Highest temperature, degC.
    """

    rmse: float
    overshoot: float
    temperature: float

    def keeps(self, name: str, limit: float) -> bool:
        """Return whether the run keeps a limit, by name."""
        return getattr(self, name) <= limit + TOLERANCE[name]


def exact_runs(task: TuningTask, gains: dict[str, float]) -> list[ExactRun]:
    """Return runs with fresh noise at ambient temperatures within the range.

    Args:
        task: The task.
        gains: All gains by name, internal units.
    """
    rng, truth, reference = np.random.default_rng([task.number, 46]), task.truth(), task.reference()
    jumps, runs = find_jumps(reference, 0.0, task.period), []
    for _ in range(DRAWS):
        ambient = truth.wire.ambient + rng.uniform(-AMBIENT, AMBIENT)
        rig = replace(truth, wire=truth.wire._replace(ambient=ambient))
        noise = 1e-6 * task.noise * rng.standard_normal(len(reference))
        values = [gains.get(name, 0.0) for name in ("kp", "ki", "kd", "filter_time")]
        value, temperature, _ = lift(rig, Pid(*values, 0.0, task.current, task.period), reference, noise)
        responses = step_responses(value, reference, jumps, task.period)
        overshoot = max(response.overshoot for response in responses)
        rmse = tracking_errors(value, reference, task.period)["rmse"]
        runs.append(ExactRun(rmse, overshoot, float(np.max(temperature))))
    return runs


def write_files(task: TuningTask, folder: Path) -> tuple[Path, Path]:
    """Write rig and controller file of a task, and return their paths."""
    folder.mkdir(parents=True, exist_ok=True)
    (folder / "rig.toml").write_text(task.rig_text(), encoding="utf-8")
    (folder / "controller.toml").write_text(task.controller_text(), encoding="utf-8")
    return folder / "rig.toml", folder / "controller.toml"
