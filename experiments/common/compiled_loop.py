"""The rotary actuator's loop in compiled NumPy, on as many steps a sample as one asks for."""

import numpy as np

from smajax import parameters
from tests.reference import fast_loop

SECONDS, SAMPLE = 10.0, 0.01  # of motion, and between samples


class Loop:
    """The same designs through the loop compiled by numba."""

    def __init__(self, sweep):
        self.plant = sweep.subject.rig.plant
        self.names = [axis.name for axis in sweep.axes]
        self.time = np.arange(round(SECONDS / SAMPLE) + 1) * SAMPLE
        on = (self.time + 1e-9) % 1.0 < 0.5
        self.current = np.column_stack([on, ~on]).astype(float)

    def rows(self, designs: np.ndarray) -> np.ndarray:
        """A row of ``fast_loop.Design`` for each.

        The amplitude goes into the resistivities, as heat is resistivity times its square.
        """
        own = {n: designs[:, k] for k, n in enumerate(self.names)}
        columns = []
        for field in fast_loop.Design._fields:
            name = next((n for n in own if n.endswith("." + field)), None)
            if name is not None:
                columns.append(own[name])
                continue
            value = np.full(len(designs), self._of(field))
            columns.append(value * own["input.amplitude"] ** 2 if field.startswith("resistivity") else value)
        return np.column_stack(columns)

    def _of(self, field: str) -> float:
        aliases = {"capacity": "heat.capacity", "thermal_expansion": "material.thermal_expansion"}
        known = parameters.all_declarations(self.plant)
        for name in (
            aliases.get(field, ""),
            *(f"{section}.{field}" for section in ("material", "heat", "wire", "environment", "pulley")),
        ):
            if name in known:
                return float(parameters.get(self.plant, name))
        return 0.0

    def strokes(self, designs: np.ndarray, substeps: int) -> np.ndarray:
        """Largest less smallest angle of the last second."""
        return np.ptp(
            fast_loop.rotary_batch(self.rows(designs), self.time, self.current, substeps=substeps)[:, -101:], axis=1
        )
