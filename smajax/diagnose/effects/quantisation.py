"""Rounding by the converter: part of the noise, without a mean effect."""

import jax

from smajax.parameters import parameter
from smajax.plant.effect import SensorEffect


class Quantisation(SensorEffect):
    """No mean effect: its variance, the step squared over 12, belongs to the noise."""

    strength: jax.Array = parameter("1", "step of the converter", 0.0, 1.0, 0.0)
    key = "quantisation"
    typical = 1.0
    source = "the variance of rounding, step squared over 12"
    no_mean_effect = "rounding scatters and does not shift: its variance is counted in the noise"
