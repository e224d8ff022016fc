"""Closed loops with the exact simulators of a dead weight and of two wires on a pulley: a second, sampled PID controller
in plain Python."""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from tests.reference import rigs
from tests.reference.rig_file import RigFile
from tests.reference.wire import State

Floats = NDArray[np.float64]


@dataclass
class Pid:
    """Parallel form, rectangle rule, backward differences of the error, filtered; the integral stops while the output is cut."""

    kp: float
    ki: float
    kd: float
    filter_time: float
    lower: float
    upper: float
    period: float
    summed: float = 0.0
    last: float = 0.0
    slope: float = 0.0

    def __call__(self, reference: float, value: float) -> float:
        """The command after one sample."""
        e = reference - value
        self.slope += (e - self.last - self.period * self.slope) / (self.filter_time + self.period)
        self.last = e
        more = self.summed + self.ki * e * self.period
        u = self.kp * e + more + self.kd * self.slope
        if not (u > self.upper and more > self.summed) and not (u < self.lower and more < self.summed):
            self.summed = more
        return min(max(u, self.lower), self.upper)


def lift(
    rig: RigFile,
    pid: Pid,
    reference: Floats,
    noise: Floats,
    substeps: int = 20,
    sense: Callable[[float, float, float], float] | None = None,
) -> tuple[Floats, Floats, Floats]:
    """Displacement in m, temperature in degC and command at the samples, all (n,), of a wire that lifts a mass, from rest.

    The controller measures the displacement with ``noise``, or the output of ``sense`` for displacement, resistance and previous command.
    """
    parts = (rig.material, rig.heat, rig.wire, rig.mechanism["mass"])
    span, position, command = np.array([0.0, pid.period]), 0.0, 0.0
    start = State(
        rig.wire.ambient, rig.mechanism["mass"] * rigs.GRAVITY / (0.25 * np.pi * rig.wire.diameter**2), 1.0, 0.0
    )
    drive = {"control": rig.control, "interpolation": "hold", "substeps": substeps}
    ohms = float(rigs.dead_weight(*parts, span, np.zeros(2), **drive, start=start).resistance[0, 0])
    series = np.empty((3, len(reference)))
    for k, r in enumerate(reference):
        command = pid(r, sense(position, ohms, command) if sense else position + noise[k])
        series[:, k] = position, start.temperature, command
        run = rigs.dead_weight(*parts, span, np.full(2, command), **drive, start=start)
        position, ohms = position + run.position[-1] - run.position[0], float(run.resistance[-1, 0])
        start = State(run.temperature[-1, 0], run.stress[-1, 0], run.detwinned[-1, 0], run.twinned[-1, 0])
    return series[0], series[1], series[2]


def turn(
    rig: RigFile,
    pid: Pid,
    co_contraction: float,
    reference: Floats,
    noise: Floats,
    quantum: float = 0.0,
    substeps: int = 20,
) -> tuple[Floats, Floats, Floats]:
    """Angle in rad (n,), temperatures in degC and commands (n, 2) at the samples, of two wires that turn a light pulley, from rest.

    The controller sees the angle with its ``noise``, rounded to ``quantum`` rad. What it commands heats wire 1 above 0 and wire 2 below;
    both also get the co-contraction, and at most the limit of the controller.
    """
    parts = (rig.material, rig.heat, rig.wire, rig.mechanism["radius"])
    span, angle = np.array([0.0, pid.period]), 0.0
    start = (rigs.drawn_out(rig.material, rig.wire, rig.wire.prestrain),) * 2
    angles, temperatures, commands = (
        np.empty(len(reference)),
        np.empty((len(reference), 2)),
        np.empty((len(reference), 2)),
    )
    for k, r in enumerate(reference):
        seen = angle + noise[k]
        command = pid(r, quantum * round(seen / quantum) if quantum else seen)
        each = [min(co_contraction + max(u, 0.0), pid.upper) for u in (command, -command)]
        angles[k], temperatures[k], commands[k] = angle, [s.temperature for s in start], each
        run = rigs.rotary(
            *parts,
            span,
            np.tile(each, (2, 1)),
            control=rig.control,
            interpolation="hold",
            substeps=substeps,
            start=start,
            angle=angle,
        )
        angle = float(run.position[-1])
        start = tuple(
            State(*(float(a[-1, i]) for a in (run.temperature, run.stress, run.detwinned, run.twinned))) for i in (0, 1)
        )
    return angles, temperatures, commands
