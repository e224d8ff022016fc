"""Model of a soft arm with one driven wire: its rig, the parts of a log, and residuals of all parameters' values."""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence

from experiments.common.arm_log import Log, reading_shift

import jax
import numpy as np
from equinox import Module, field

from smajax import parameters
from smajax.fitting.problem import Problem
from smajax.numerics.loop_kernels import jit_with_kernels
from smajax.recordings.recording import Recording

LEVER = 0.003  # m of wire per rad of bend; nominal, since max_transformation_strain scales with it


RIG = """
schema = 1
[rig]
kind = "bias-spring"
control = "duty"
[drive]
supply = "2.5 V"
[material]
martensite_start = "60 degC"
martensite_finish = "-190 degC"
austenite_start = "60 degC"
austenite_finish = "100 degC"
clausius_clapeyron_austenite = "7 MPa/K"
clausius_clapeyron_martensite = "7 MPa/K"
modulus_austenite = "40 GPa"
modulus_martensite = "40 GPa"
detwinning_start_stress = "0 MPa"
detwinning_finish_stress = "100 MPa"
max_transformation_strain = "1.5 %"
[heat]
h0 = "60 W/m^2/K"
capacity = "3 MJ/m^3/K"
[wire]
diameter = "0.25 mm"
length = "100 mm"
[spring]
preload = "5 N"
stiffness = "6.7 N/mm"
[environment]
ambient = "22 degC"
[initial]
temperature = "22 degC"
[fit]
free = ["drive.supply", "heat.h0", "environment.ambient", "initial.temperature",
        "material.austenite_shift", "material.austenite_finish",
        "material.martensite_start", "material.detwinning_finish_stress", "material.max_transformation_strain",
        "sensor.displacement_offset"]
observe = ["temperature", "displacement"]
noise = { temperature = "1 K", displacement = "0.015 mm" }
starts = 1
[fit.bounds]
"drive.supply" = ["0.1 V", "10 V"]
"heat.h0" = ["3 W/m^2/K", "400 W/m^2/K"]
"environment.ambient" = ["15 degC", "30 degC"]
"initial.temperature" = ["15 degC", "60 degC"]
"material.austenite_shift" = ["-80 K", "100 K"]
"material.austenite_finish" = ["62 degC", "200 degC"]
"material.martensite_start" = ["0 degC", "150 degC"]
"material.detwinning_finish_stress" = ["5 MPa", "400 MPa"]
"material.max_transformation_strain" = ["0.5 %", "10 %"]
"""
DENSE_SECONDS = 40.0  # s after the first pulse in which all rows are kept
TAIL_SECONDS = 1.1  # s between rows after that
BLOCK_SECONDS = 2.0  # s; every third block is the selection part


def split_log(log: Log) -> dict[str, Recording]:
    """Split a log into recordings.

    Each covers the whole log; its channels are NaN outside the rows of its role, and a temperature stands in a
    separate row, at the time when it was taken. Before the scored part, the slow tail of a pulse is thinned.

    Returns:
        Recordings by role: ``train`` and ``select`` together make ``fitted``, ``held`` is scored; ``whole`` has all.
    """
    kept_rows = [0]
    for k, now in enumerate(log.time):
        dense = now < log.pulses[0] + DENSE_SECONDS or now >= log.scored
        if k and (dense or (now - log.time[kept_rows[-1]] >= TAIL_SECONDS and np.isfinite(log.temperature[k]))):
            kept_rows.append(k)
    rows_of_readings = [k for k in kept_rows if np.isfinite(log.temperature[k])]
    readings = log.time[rows_of_readings] + reading_shift(log)[rows_of_readings]
    time, position = np.unique(np.concatenate([log.time[kept_rows], readings]), return_inverse=True)
    temperature, bend = np.full((2, len(time)), np.nan)
    temperature[position[len(kept_rows) :]] = log.temperature[rows_of_readings]
    bend[position[: len(kept_rows)]] = log.bend[kept_rows]
    channels = {"temperature": temperature, "displacement": np.radians(bend) * LEVER}
    units = {"duty": "1", "temperature": "degC", "displacement": "mm"}
    fitted = time < log.until
    chosen = np.floor((time - log.pulses[0]) / BLOCK_SECONDS) % 3 == 2
    rows = {"train": fitted & ~chosen, "select": fitted & chosen, "fitted": fitted, "held": time > log.scored}
    rows["whole"] = np.full(len(time), True)
    duty = {"duty": log.duty[np.clip(np.searchsorted(log.time, time, side="right") - 1, 0, None)]}
    return {
        role: Recording.from_arrays(
            log.name, time, duty | {c: np.where(own, v, np.nan) for c, v in channels.items()}, units
        )
        for role, own in rows.items()
    }


class Model(Module):
    """A fit problem as a function of the values of all parameters, those of the rig first, in internal units.

    Attributes:
        problem: The fit problem; its free parameters are those of the rig.
        names: Names of the effects' parameters.
    """

    problem: Problem
    names: tuple[str, ...] = field(static=True)

    def predict(self, values: jax.Array) -> tuple[jax.Array, jax.Array]:
        """Predict the channels, and the error code, as ``Problem.predict``."""
        problem, vector = self._at(values)
        return problem.predict(vector)

    def residual(self, values: jax.Array) -> jax.Array:
        """Return the residuals over their noise."""
        problem, vector = self._at(values)
        return problem.residual(vector)

    def _at(self, values: jax.Array) -> tuple[Problem, jax.Array]:
        count = len(self.problem.unknowns)
        effects = {name: values[count + i] for i, name in enumerate(self.names)}
        plant = parameters.replace(self.problem.plant, effects)
        return dataclasses.replace(self.problem, plant=plant), values[:count] / self.problem.scales


@jit_with_kernels
def linearise(model: Model, values: jax.Array) -> tuple[jax.Array, jax.Array]:
    """Return the residuals and their Jacobian."""

    def twice(v: jax.Array) -> tuple[jax.Array, jax.Array]:
        residual = model.residual(v)
        return residual, residual

    jacobian, residual = jax.jacfwd(twice, has_aux=True)(values)
    return residual, jacobian


def rms(series: Sequence[np.ndarray]) -> float:
    """Return the root mean square over all samples that are not NaN."""
    return float(np.sqrt(np.nanmean(np.concatenate(series) ** 2)))
