"""Closed loops on the exact simulator of a dead weight: a PID written down once more, in plain Python, sampled and held."""

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


def lift(rig: RigFile, pid: Pid, reference: Floats, noise: Floats, substeps: int = 20) -> tuple[Floats, Floats, Floats]:
    """Displacement in m, temperature in degC and command at the samples, all (n,), of a wire that lifts a mass, from rest."""
    parts = (rig.material, rig.heat, rig.wire, rig.mechanism["mass"])
    span, position = np.array([0.0, pid.period]), 0.0
    start = State(rig.wire.ambient, rig.mechanism["mass"] * rigs.GRAVITY / (0.25 * np.pi * rig.wire.diameter**2), 1.0, 0.0)
    found = np.empty((3, len(reference)))
    for k, r in enumerate(reference):
        command = pid(r, position + noise[k])
        found[:, k] = position, start.temperature, command
        run = rigs.dead_weight(*parts, span, np.full(2, command), control=rig.control, interpolation="hold", substeps=substeps, start=start)
        position += run.position[-1] - run.position[0]
        start = State(run.temperature[-1, 0], run.stress[-1, 0], run.detwinned[-1, 0], run.twinned[-1, 0])
    return found[0], found[1], found[2]
