"""What runs inside the FMUs: the equations beside it, called as the importing tool steps. It needs Python with NumPy, and no more.

``model.json`` lists the variables, a value reference being a place in that list. The module beside this one, with ``_equations`` at the
end of its name, is written by smajax and holds ``start``, ``advance`` and ``outputs``. A plant goes on by steps no longer than ``longest``;
a controller is called every ``period`` and holds its command between, both in s.
"""

import importlib
import json
import math
from pathlib import Path

import numpy as np
from pythonfmu import Fmi2Slave
from pythonfmu.enums import Fmi2Status


class Slave(Fmi2Slave):
    """A plant or a controller; the state is ``None`` until something asks for it, and does not change in place."""

    def __init__(self, **kwargs):
        super().__init__(**kwargs)
        self.equations = importlib.import_module(f"{__name__}_equations")
        self.model = json.loads((Path(kwargs["resources"]) / "model.json").read_text("utf-8"))
        variables = self.model["variables"]
        self.places = {kind: [i for i, v in enumerate(variables) if v["causality"] == kind] for kind in ("input", "output", "parameter")}
        self.values = [np.float64(v.get("start", math.nan)) for v in variables]
        self.state, self.running, self.begin, self.samples = None, False, 0.0, 0

    def setup_experiment(self, start_time, *_):
        self.begin = start_time

    def exit_initialization_mode(self):
        self.state, self.running = self._now(), True

    def do_step(self, current_time, step_size):
        inputs, parameters, state = self._given("input"), self._given("parameter"), self._now()
        with np.errstate(all="ignore"):
            for duration in self._durations(current_time, step_size):
                *state, failed = self.equations.advance(parameters, state, inputs, np.float64(duration))
                if failed:
                    self.log(f"the step from {current_time:g} s could not be solved: check the inputs' scale", Fmi2Status.warning)
        self.state = state
        return bool(all(np.all(np.isfinite(leaf)) for leaf in state))

    def set_real(self, vrs, values):
        for vr, value in zip(vrs, values, strict=True):
            self.values[vr] = np.float64(value)
        if not self.running:
            self.state = None  # what it starts from is still being set

    def get_real(self, vrs):
        outputs = set(vrs) & set(self.places["output"])
        if outputs:
            with np.errstate(all="ignore"):
                now = self.equations.outputs(self._given("parameter"), self._now(), self._given("input"))
            for place, value in zip(self.places["output"], now, strict=True):
                self.values[place] = value
        return [float(self.values[vr]) for vr in vrs]

    def _given(self, kind):
        return [self.values[i] for i in self.places[kind]]

    def _now(self):
        if self.state is not None:
            return self.state
        with np.errstate(all="ignore"):
            return list(self.equations.start(self._given("parameter"), self._given("input")))

    def _durations(self, time, step):
        """The steps of a plant within a communication step; for each sample of a controller that is due in it, its period."""
        if "longest" in self.model:
            pieces = max(1, math.ceil(step / self.model["longest"] - 1e-9))
            return [step / pieces] * pieces
        period = self.model["period"]
        last = math.ceil((time + step - self.begin) / period - 1e-6)
        due, self.samples = max(0, last - self.samples), max(last, self.samples)
        return [period] * due

    def _get_fmu_state(self):
        return {"values": list(self.values), "state": self.state, "running": self.running, "begin": self.begin, "samples": self.samples}

    def _set_fmu_state(self, state):
        for name, value in state.items():
            setattr(self, name, list(value) if name == "values" else value)
