"""Sensors of a simulated rig: what a controller and an estimator measure of the plant.

``AbstractSensor`` is their interface; ``SensorModel`` has noise, quantisation and delay; ``Instruments`` has one such
sensor per channel and wire, and the lag of thermocouples; ``DropoutHold`` holds the last value of a measurement with
dropouts, for at most ``DROPOUT_TIMEOUT``.
"""

from smajax.control.sensors.base import AbstractSensor
from smajax.control.sensors.dropout_hold import DROPOUT_TIMEOUT, DropoutHold
from smajax.control.sensors.instruments import Instruments
from smajax.control.sensors.sensor_model import SensorModel, ideal_sensor

__all__ = ["DROPOUT_TIMEOUT", "AbstractSensor", "DropoutHold", "Instruments", "SensorModel", "ideal_sensor"]
