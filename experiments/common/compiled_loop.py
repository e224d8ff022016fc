"""Simulation of the rotary actuator in compiled NumPy, with a chosen number of steps a sample."""

import json
import os
import subprocess
import sys

from experiments.common.base import ROOT

import numpy as np

from smajax import parameters
from tests.reference import fast_loop

SECONDS, SAMPLE = 10.0, 0.01  # s: duration of the motion, sampling period

# Runs the loop without numba, in a new interpreter, since numba reads NUMBA_DISABLE_JIT at its import.
PLAIN = """
import json, sys, time
sys.path.insert(0, sys.argv[1])
import numpy as np
from tests.reference import fast_loop
rows, grid, current, parts = json.load(sys.stdin)
began = time.perf_counter()
for row in rows:
    fast_loop.rotary(fast_loop.Design(*row), np.array(grid), np.array(current), substeps=parts)
print((time.perf_counter() - began) / len(rows))
"""


class Loop:
    """The designs of a sweep, simulated by the loop that numba compiles."""

    def __init__(self, sweep):
        self.plant = sweep.subject.rig.plant
        self.names = [axis.name for axis in sweep.axes]
        self.time = np.arange(round(SECONDS / SAMPLE) + 1) * SAMPLE
        on = (self.time + 1e-9) % 1.0 < 0.5
        self.current = np.column_stack([on, ~on]).astype(float)

    def rows(self, designs: np.ndarray) -> np.ndarray:
        """Return a row of ``fast_loop.Design`` for each design, shape ``(designs, fields)``.

        The amplitude of the current goes into the resistivities, since heat is resistivity times its square.
        """
        columns_by_name = {n: designs[:, k] for k, n in enumerate(self.names)}
        columns = []
        for field in fast_loop.Design._fields:
            name = next((n for n in columns_by_name if n.endswith("." + field)), None)
            if name is not None:
                columns.append(columns_by_name[name])
                continue
            value = np.full(len(designs), self._value(field))
            columns.append(
                value * columns_by_name["input.amplitude"] ** 2 if field.startswith("resistivity") else value
            )
        return np.column_stack(columns)

    def _value(self, field: str) -> float:
        aliases = {"capacity": "heat.capacity", "thermal_expansion": "material.thermal_expansion"}
        declared = parameters.all_declarations(self.plant)
        for name in (
            aliases.get(field, ""),
            *(f"{section}.{field}" for section in ("material", "heat", "wire", "environment", "pulley")),
        ):
            if name in declared:
                return float(parameters.get(self.plant, name))
        return 0.0

    def strokes(self, designs: np.ndarray, substeps: int) -> np.ndarray:
        """Return the peak-to-peak angle of the last second of each design, rad."""
        return np.ptp(
            fast_loop.rotary_batch(self.rows(designs), self.time, self.current, substeps=substeps)[:, -101:], axis=1
        )


def time_interpreted(loop: Loop, designs: np.ndarray, substeps: int) -> float:
    """Return the seconds a design of the same loop in plain Python, run in a new process.

    Args:
        loop: The compiled loop.
        designs: The designs, shape ``(designs, axes)``.
        substeps: Substeps of a sample.
    """
    payload = json.dumps([loop.rows(designs).tolist(), loop.time.tolist(), loop.current.tolist(), substeps])
    result = subprocess.run(
        [sys.executable, "-c", PLAIN, str(ROOT)],
        input=payload,
        capture_output=True,
        text=True,
        check=True,
        env={**os.environ, "NUMBA_DISABLE_JIT": "1"},
    )
    return float(result.stdout)
