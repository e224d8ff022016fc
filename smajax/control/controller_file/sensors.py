"""Sections of a controller file on measurements: [sensor], [temperature_limiter], [estimator] and [instruments].

[sensor]                          # the sensor of the controlled channel
noise = "5 um"
[temperature_limiter]             # keeps the wire below a temperature, whatever the command
limit = "115 degC"
kp = "0.05 A/K"
[estimator]                       # the limiter uses the temperature that is estimated from the wire's power
gain = "0.2 1/s"                  # and corrected by a thermocouple; or by a Kalman filter with all instruments:
kind = "extended"
unknown = { "environment.ambient" = "4 K" }
use_estimate = true               # the controller uses the filter's estimate, too, instead of its sensor
[instruments]                     # the sensors of temperature limiter and estimator
temperature = { noise = "0.5 K", lag = "1 s" }
"""

from collections.abc import Mapping
from typing import Any, NamedTuple

import jax.numpy as jnp

from smajax.control.controller_file.estimator import (
    build_extended_filter,
    build_thermal_observer,
    read_estimator_section,
)
from smajax.control.controller_file.instruments import build_sensor, read_instruments
from smajax.control.controller_file.quantities import float_arrays, optional_quantity
from smajax.control.controller_file.schema import SensorSection, TemperatureLimiterSection
from smajax.control.controllers.pid import PID
from smajax.control.estimators.base import AbstractTemperatureEstimator
from smajax.control.loop.temperature_limiter import TemperatureLimiter
from smajax.control.sensors.instruments import Instruments
from smajax.control.sensors.sensor_model import SensorModel
from smajax.errors import InputError
from smajax.files.rig_file import Rig
from smajax.files.toml import quantity_at, validate


class LoopSensors(NamedTuple):
    """Parts of a closed loop that measure, with the names of the fields of ``ClosedLoop``."""

    sensor: SensorModel
    temperature_limiter: TemperatureLimiter | None
    estimator: AbstractTemperatureEstimator | None
    instruments: Instruments | None
    use_estimate: bool = False


def read_sensors(
    data: Mapping[str, Any], rig: Rig, channel: str, units: tuple[str, str], period: float, max_command: float
) -> LoopSensors:
    """Read the sections on measurements.

    Args:
        data: Sections of the file by name.
        rig: The rig, whose noise of the channel counts where [sensor] gives none.
        channel: The controlled channel.
        units: Unit of the command, and of differences of the channel.
        period: Period of the controller, s.
        max_command: Largest command of a wire, internal unit.

    Raises:
        InputError: for a wrong key or value, a missing section, or one that nothing uses.
    """
    command_unit, difference = units
    limiter = None
    if "temperature_limiter" in data:
        limiter = _temperature_limiter(data["temperature_limiter"], rig, command_unit, period, max_command)
    section = read_estimator_section(data["estimator"], limiter) if "estimator" in data else None
    measured = section is None or not section.use_estimate
    default_noise = rig.fit.noise.get(channel, 0.0) if measured else 0.0
    sensor_section = validate(SensorSection, data.get("sensor", {}), "sensor")
    sensor = build_sensor(sensor_section, difference, period, "sensor", default_noise)
    if section is None or section.kind == "thermal":
        observer = None if section is None or limiter is None else build_thermal_observer(section, rig, limiter, period)
        instruments = None
        if "instruments" in data:
            instruments = read_instruments(data["instruments"], rig, limiter, observer, period)
        return LoopSensors(sensor, limiter, observer, instruments)
    if "instruments" not in data:
        raise InputError(
            "an extended Kalman filter needs the section [instruments], which says what it measures: add it, "
            'with a line like voltage = { noise = "2 mV" }'
        )
    if section.use_estimate and "sensor" in data:
        raise InputError(
            "[sensor] is the sensor of the controller, and with estimator.use_estimate the controller uses the "
            "estimate of the filter, which measures by [instruments]: "
            f"move it to instruments.{rig.plant.mechanism.coordinate}, or take it out"
        )
    instruments = read_instruments(data["instruments"], rig, limiter, section, period)
    return LoopSensors(
        sensor, limiter, build_extended_filter(section, rig, instruments, period), instruments, section.use_estimate
    )


def _temperature_limiter(
    data: Any, rig: Rig, command_unit: str, period: float, max_command: float
) -> TemperatureLimiter:
    """The temperature limiter from its section."""
    section = validate(TemperatureLimiterSection, data, "temperature_limiter")
    kp = optional_quantity(section.kp, f"{command_unit}/K", "temperature_limiter.kp")
    ki = optional_quantity(section.ki, f"{command_unit}/K/s", "temperature_limiter.ki")
    if not kp + ki > 0.0:
        raise InputError(
            "temperature_limiter.kp and temperature_limiter.ki are 0, so that no command would ever be allowed: give "
            "temperature_limiter.kp a value"
        )
    ambient = float(rig.plant.environment.ambient)
    limit = quantity_at(section.limit, "degC", "temperature_limiter.limit", least=ambient)
    pid = PID(*float_arrays(kp, ki, 0.0, 0.0, 0.0, max_command), period=period)
    return TemperatureLimiter(pid, jnp.asarray(limit))
