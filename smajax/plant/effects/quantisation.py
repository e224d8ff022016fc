"""Quantisation: rounding by the converter, which is part of the noise."""

from typing import ClassVar

import jax

from smajax.parameters import parameter
from smajax.plant.effects.base import SensorEffect


class Quantisation(SensorEffect):
    """Rounding without a mean effect: its variance, the step squared over 12, belongs to the noise."""

    strength: jax.Array = parameter("1", "step of the converter", 0.0, 1.0, 0.0)
    key = "quantisation"
    obstacle_to_rates = "rounded readings"
    typical: ClassVar[float] = 1.0
    source = "the variance of rounding, step squared over 12"
    remedy = "Use a converter of finer steps or a smaller range; the step belongs to the noise (fit.noise)."
    no_mean_effect = "rounding scatters and does not shift the mean: its variance is counted in the noise"
