"""Section [instruments] of a controller file: what the temperature limiter and the estimator measure."""

import math
from typing import Any

import jax.numpy as jnp

from smajax.control.controller_file.quantities import float_arrays, optional_quantity
from smajax.control.controller_file.schema import (
    EstimatorSection,
    InstrumentsSection,
    SensorSection,
    ThermocoupleSection,
)
from smajax.control.estimators.thermal_observer import ThermalObserver
from smajax.control.loop.temperature_limiter import TemperatureLimiter
from smajax.control.sensors.instruments import Instruments
from smajax.control.sensors.sensor_model import SensorModel
from smajax.errors import InputError
from smajax.files.rig_file import Rig
from smajax.files.toml import show, validate
from smajax.units import as_text

# Longest delay in periods, to detect wrong units: the delayed values are part of a rollout's state. Chosen by trial.
_MAX_DELAY = 10_000
# Longest delay in periods of an instrument of an extended Kalman filter, whose covariance has a row for each delayed
# reading. Chosen by trial; tests/unit/control/test_tuning.py holds it.
_MAX_FILTER_DELAY = 100
# Relative distance from a whole number of periods that counts as a rounding error of the file.
_ROUNDING = 1e-6
_UNITS = {"voltage": "V", "current": "A", "temperature": "K", "displacement": "m", "angle": "rad"}


def build_sensor(
    section: SensorSection, unit: str, period: float, place: str, default_noise: float = 0.0
) -> SensorModel:
    """Build a sensor from its section.

    Args:
        section: Noise, quantum and delay.
        unit: Unit of noise and quantum.
        period: Period of the controller, s.
        place: Section of the file, for error messages.
        default_noise: Noise where the section gives none.

    Raises:
        InputError: for a wrong quantity, or a delay that is too long or not a whole number of periods.
    """
    noise = default_noise if section.noise is None else optional_quantity(section.noise, unit, f"{place}.noise")
    quantum = optional_quantity(section.quantum, unit, f"{place}.quantum")
    periods = optional_quantity(section.delay, "s", f"{place}.delay") / period
    if periods > _MAX_DELAY:
        raise InputError(f"{place}.delay = {show(section.delay)} is too long: give {_MAX_DELAY * period:g} s or less")
    if abs(periods - round(periods)) > _ROUNDING * max(periods, 1.0):
        ends = [as_text(period * n, "s") for n in (math.floor(periods), math.ceil(periods))]
        raise InputError(
            f"{place}.delay = {show(section.delay)} is not a whole number of controller.period: "
            f"give {ends[0]} or {ends[1]}"
        )
    return SensorModel(jnp.asarray(noise), jnp.asarray(quantum), round(periods))


def read_instruments(
    data: Any,
    rig: Rig,
    limiter: TemperatureLimiter | None,
    estimator: ThermalObserver | EstimatorSection | None,
    period: float,
) -> Instruments:
    """Read the section [instruments].

    Args:
        data: The section of the file.
        rig: The rig.
        limiter: The temperature limiter, if there is one.
        estimator: The thermal observer, or the section of an extended Kalman filter, if there is one.
        period: Period of the controller, s.

    Raises:
        InputError: for a wrong key or quantity, or an instrument that nothing uses.
    """
    section = validate(InstrumentsSection, data, "instruments")
    if limiter is None and not isinstance(estimator, EstimatorSection):
        raise InputError(
            "[instruments] is used by a temperature limiter and its estimator, and there is none: add a section "
            "[temperature_limiter], or take [instruments] out"
        )
    sensors, lag = {}, 0.0
    for kind, unit in _UNITS.items():
        entry = getattr(section, kind)
        if entry is None:
            continue
        _check_use(kind, rig, estimator)
        model = ThermocoupleSection if kind == "temperature" else SensorSection
        sensor = validate(model, entry, f"instruments.{kind}")
        sensors[kind] = build_sensor(sensor, unit, period, f"instruments.{kind}")
        if isinstance(estimator, EstimatorSection):
            _check_for_filter(kind, sensors[kind], period)
        if isinstance(sensor, ThermocoupleSection):
            lag = optional_quantity(sensor.lag, "s", "instruments.temperature.lag")
    if not sensors:
        raise InputError(
            '[instruments] is empty: add a line like temperature = { noise = "0.5 K", lag = "1 s" }, '
            "or take the section out"
        )
    return Instruments(sensors, period, *float_arrays(lag))


def _check_use(kind: str, rig: Rig, estimator: ThermalObserver | EstimatorSection | None) -> None:
    """Refuse an instrument that nothing uses."""
    filtered, coordinate = isinstance(estimator, EstimatorSection), rig.plant.mechanism.coordinate
    if kind in ("displacement", "angle") and (kind != coordinate or not filtered):
        reason = "only an extended Kalman filter uses it" if kind == coordinate else f"this rig has no {kind}"
        cure = "" if filtered else ', or add an [estimator] of kind = "extended"'
        raise InputError(f"instruments.{kind}: {reason}: take it out{cure}")
    if kind != "temperature" and estimator is None:
        raise InputError(
            f"instruments.{kind}: nothing uses it without an estimator: add a section [estimator], or take it out"
        )
    if kind == "temperature" and isinstance(estimator, ThermalObserver) and not float(estimator.gain) > 0.0:
        raise InputError(
            "instruments.temperature: the thermal observer uses no thermocouple: "
            "give estimator.gain a value, or take it out"
        )


def _check_for_filter(kind: str, sensor: SensorModel, period: float) -> None:
    """Refuse an instrument that an extended Kalman filter cannot use."""
    if not float(sensor.noise) + float(sensor.quantum) > 0.0:
        raise InputError(
            f"instruments.{kind}: without noise and quantum its weight in an extended Kalman filter would be infinite: "
            "give it one of them"
        )
    if sensor.delay > _MAX_FILTER_DELAY:
        raise InputError(
            f"instruments.{kind}.delay is too long for an extended Kalman filter: "
            f"give {_MAX_FILTER_DELAY * period:g} s or less"
        )
