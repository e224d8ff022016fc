"""Estimators of states that a rig does not measure, or measures with much noise or lag.

- ``ThermalObserver``: the temperature of a wire from its electrical power, corrected by a thermocouple (Luenberger
  observer).
- ``ExtendedKalmanFilter``, ``EnsembleKalmanFilter``: the whole state of the plant from all instruments.
- ``AngleKalmanFilter`` and ``ImuSensor``: an angle from a gyroscope and a tilt sensor.
"""

from smajax.control.estimators.angle_kalman_filter import AngleKalmanFilter
from smajax.control.estimators.base import AbstractFilter, AbstractTemperatureEstimator, Estimate
from smajax.control.estimators.ensemble_kalman_filter import EnsembleKalmanFilter
from smajax.control.estimators.extended_kalman_filter import ExtendedKalmanFilter
from smajax.control.estimators.imu_sensor import ImuSensor
from smajax.control.estimators.thermal_observer import ThermalObserver

__all__ = [
    "AbstractFilter",
    "AbstractTemperatureEstimator",
    "AngleKalmanFilter",
    "EnsembleKalmanFilter",
    "Estimate",
    "ExtendedKalmanFilter",
    "ImuSensor",
    "ThermalObserver",
]
