"""Code that runs in the FMUs and calls the equations when the importing tool steps. It needs only Python with NumPy.

``model.json`` lists the variables; a value reference is a position in that list. The module with the same name and the
suffix ``_equations`` is written by smajax and has ``start``, ``advance`` and ``outputs``. A plant takes steps of at
most ``longest`` s; a controller is called every ``period`` s and holds its command in between.
"""

import importlib
import json
import math
from pathlib import Path
from types import ModuleType
from typing import Any

import numpy as np
from pythonfmu import Fmi2Slave
from pythonfmu.enums import Fmi2Status

# Rounding errors of a quotient of times up to which no further step or sample is added.
_STEP_ROUNDING = 1e-9
_SAMPLE_ROUNDING = 1e-6


class _Slave(Fmi2Slave):
    """Plant or controller; the state is ``None`` until it is needed, and is never changed in place."""

    def __init__(self, **kwargs: Any):
        super().__init__(**kwargs)
        self.equations: ModuleType = importlib.import_module(f"{__name__}_equations")
        self.model: dict[str, Any] = json.loads((Path(kwargs["resources"]) / "model.json").read_text("utf-8"))
        variables = self.model["variables"]
        self.places: dict[str, list[int]] = {
            kind: [i for i, v in enumerate(variables) if v["causality"] == kind]
            for kind in ("input", "output", "parameter")
        }
        self.values: list[float] = [np.float64(v.get("start", math.nan)) for v in variables]
        self.state: Any = None
        self.running: bool = False
        self.begin: float = 0.0
        self.samples: int = 0

    def setup_experiment(self, start_time: float, *_: Any) -> None:
        """Store the start time in s."""
        self.begin = start_time

    def exit_initialization_mode(self) -> None:
        """Compute the start state from the start values."""
        self.state = self._current_state()
        self.running = True

    def do_step(self, current_time: float, step_size: float) -> bool:
        """Take a communication step (times in s); return whether the state is finite."""
        inputs, parameters, state = self._values_of("input"), self._values_of("parameter"), self._current_state()
        with np.errstate(all="ignore"):
            for duration in self._durations(current_time, step_size):
                *state, failed = self.equations.advance(parameters, state, inputs, np.float64(duration))
                if failed:
                    self.log(
                        f"the step from {current_time:g} s did not converge: check the units of the inputs",
                        Fmi2Status.warning,
                    )
        self.state = state
        return bool(all(np.all(np.isfinite(leaf)) for leaf in state))

    def set_real(self, vrs: list[int], values: list[float]) -> None:
        """Set variables by their value references."""
        for vr, value in zip(vrs, values, strict=True):
            self.values[vr] = np.float64(value)
        if not self.running:
            self.state = None  # its start values are still being set

    def get_real(self, vrs: list[int]) -> list[float]:
        """Return variables by their value references; outputs are computed from the current inputs."""
        if set(vrs) & set(self.places["output"]):
            with np.errstate(all="ignore"):
                outputs = self.equations.outputs(
                    self._values_of("parameter"), self._current_state(), self._values_of("input")
                )
            for place, value in zip(self.places["output"], outputs, strict=True):
                self.values[place] = value
        return [float(self.values[vr]) for vr in vrs]

    def _values_of(self, kind):
        return [self.values[i] for i in self.places[kind]]

    def _current_state(self):
        if self.state is not None:
            return self.state
        with np.errstate(all="ignore"):
            return list(self.equations.start(self._values_of("parameter"), self._values_of("input")))

    def _durations(self, time, step):
        """Durations of a plant's steps within a communication step, or the period for each sample of a controller."""
        if "longest" in self.model:
            count = max(1, math.ceil(step / self.model["longest"] - _STEP_ROUNDING))
            return [step / count] * count
        period = self.model["period"]
        last = math.ceil((time + step - self.begin) / period - _SAMPLE_ROUNDING)
        due = max(0, last - self.samples)
        self.samples = max(last, self.samples)
        return [period] * due

    def _get_fmu_state(self):
        return {
            "values": list(self.values),
            "state": self.state,
            "running": self.running,
            "begin": self.begin,
            "samples": self.samples,
        }

    def _set_fmu_state(self, state):
        for name, value in state.items():
            setattr(self, name, list(value) if name == "values" else value)
