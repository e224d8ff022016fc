"""The part of a controller file that says what is heard of the rig: [sensor] by the controller, [meters] by the guard and its observer.

[sensor]                          # what the controller sees of its channel
noise = "5 um"
[guard]                           # keeps the wire below a temperature whatever the controller wants
limit = "115 degC"
kp = "0.05 A/K"
[observer]                        # the guard knows the temperature from the wire's power
trust = "0.2 1/s"                 # and corrects it by a thermocouple
[meters]
temperature = { noise = "0.5 K", lag = "1 s" }
"""

import math
from collections.abc import Mapping
from dataclasses import replace
from typing import Any, NamedTuple

import jax.numpy as jnp
from pydantic import BaseModel, Field

from smajax.control.guard import TemperatureGuard
from smajax.control.meters import Meters
from smajax.control.observers import ThermalObserver
from smajax.control.pid import PID
from smajax.control.sensing import Sensing
from smajax.errors import InputError
from smajax.rig import Rig
from smajax.rig_schema import as_text
from smajax.toml_file import STRICT, quantity_at, show, validate

_LATEST = 10_000  # periods of delay


class _Sensor(BaseModel):
    model_config = STRICT
    noise: Any = Field(None, examples=['"0.01 mm"'])
    quantum: Any = Field(None, examples=['"0.005 mm"'])
    delay: Any = Field(None, examples=['"20 ms"'])


class _Guard(BaseModel):
    model_config = STRICT
    limit: Any = Field(examples=['"110 degC"'])
    kp: Any = Field(examples=['"0.05 A/K"'])
    ki: Any = Field(None, examples=['"0.01 A/K/s"'])


class _Observer(BaseModel):
    model_config = STRICT
    a1: Any = Field(None, examples=['"12 K/J"'])
    a2: Any = Field(None, examples=['"-0.8 1/s"'])
    exponent: int = Field(1, ge=1, le=6, examples=["2"])
    trust: Any = Field(None, examples=['"0.2 1/s"'])


class _Thermocouple(_Sensor):
    lag: Any = Field(None, examples=['"1 s"'])


class _Meters(BaseModel):
    model_config = STRICT
    voltage: Any = Field(None, examples=['{ noise = "10 mV", quantum = "5 mV" }'])
    current: Any = Field(None, examples=['{ noise = "2 mA", delay = "20 ms" }'])
    temperature: Any = Field(None, examples=['{ noise = "0.5 K", lag = "1 s" }'])


class Heard(NamedTuple):
    """What in a loop hears the rig, in the order in which a ``Loop`` takes it."""

    sensing: Sensing
    guard: TemperatureGuard | None
    observer: ThermalObserver | None
    meters: Meters | None


def read_sensing(data: Mapping[str, Any], rig: Rig, units: tuple[str, str], period: float, most: float) -> Heard:
    """What a controller file's ``data`` says of it. InputError: section, key and cure.

    ``units`` are those of the command and of differences of the channel, ``period`` is the controller's in s, ``most`` the largest command.
    """
    command, difference = units
    sensing = _sensing(validate(_Sensor, data.get("sensor", {}), "sensor"), difference, period, "sensor")
    guard = _guard(data["guard"], rig, command, period, most) if "guard" in data else None
    observer = _observer(data["observer"], rig, guard, period) if "observer" in data else None
    return Heard(sensing, guard, observer, _meters(data["meters"], guard, observer, period) if "meters" in data else None)


def _guard(data: Any, rig: Rig, command: str, period: float, most: float) -> TemperatureGuard:
    given = validate(_Guard, data, "guard")
    kp, ki = (_positive(v, f"{command}/K{over}", f"guard.{k}") for v, k, over in ((given.kp, "kp", ""), (given.ki, "ki", "/s")))
    if not kp + ki > 0.0:
        raise InputError("guard.kp and guard.ki are 0, so that the guard would never let a command through: give guard.kp a value")
    limit = quantity_at(given.limit, "degC", "guard.limit", least=float(rig.plant.environment.ambient))
    return TemperatureGuard(PID(*arrays(kp, ki, 0.0, 0.0, 0.0, most), period=period), jnp.asarray(limit))


def _sensing(given: _Sensor, unit: str, period: float, place: str) -> Sensing:
    """A sensor's noise, steps and delay; ``unit`` is that of the first two."""
    noise, quantum = (_positive(v, unit, f"{place}.{k}") for k, v in (("noise", given.noise), ("quantum", given.quantum)))
    wait = _positive(given.delay, "s", f"{place}.delay") / period
    if wait > _LATEST:
        raise InputError(f"{place}.delay = {show(given.delay)} is too long: give {_LATEST * period:g} s or less")
    if abs(wait - round(wait)) > 1e-6 * max(wait, 1.0):
        ends = [as_text(period * n, "s") for n in (math.floor(wait), math.ceil(wait))]
        raise InputError(f"{place}.delay = {show(given.delay)} is not a whole number of controller.period: give {ends[0]} or {ends[1]}")
    return Sensing(jnp.asarray(noise), jnp.asarray(quantum), round(wait))


def _observer(data: Any, rig: Rig, guard: TemperatureGuard | None, period: float) -> ThermalObserver:
    """What tells the guard the temperature; what is not given is what the rig's convection and capacity say at the guard's limit."""
    given = validate(_Observer, data, "observer")
    if guard is None:
        raise InputError(
            "[observer] tells a guard the wire's temperature, and there is none: add a section [guard], or take [observer] out"
        )
    if (given.a1 is None) != (given.a2 is None):
        raise InputError(f"observer.{'a1' if given.a1 is None else 'a2'} is missing: give both a1 and a2, or neither for those of the rig")
    own = ThermalObserver.of(rig.plant, float(guard.limit), period, _positive(given.trust, "1/s", "observer.trust"))
    if given.a1 is None:
        if given.exponent != 1:
            raise InputError(f"observer.exponent = {show(given.exponent)} goes with an a1 and an a2 of its own: give both, or take it out")
        return _steady(own, guard, given)
    a1 = quantity_at(given.a1, "K/J", "observer.a1")
    if not a1 > 0.0:
        raise InputError(f"observer.a1 = {show(given.a1)} would not warm a wire by its power: give one above 0")
    a2 = quantity_at(given.a2, "1/s" if given.exponent == 1 else f"K^{1 - given.exponent}/s", "observer.a2")
    if not a2 < 0.0:
        raise InputError(f"observer.a2 = {show(given.a2)} would warm the wire without power: give one below 0")
    return _steady(replace(own, **dict(zip(("a1", "a2", "exponent"), arrays(a1, a2, given.exponent), strict=True))), guard, given)


def _steady(observer: ThermalObserver, guard: TemperatureGuard, given: _Observer) -> ThermalObserver:
    """The observer, if at the guard's limit it forgets no more than all within a period."""
    excess, exponent = float(guard.limit - observer.ambient), float(observer.exponent)
    loses, trusts = -exponent * float(observer.a2) * excess ** (exponent - 1.0), float(observer.gain)
    if observer.period * (loses + trusts) > 1.0:
        key = "trust" if trusts > loses else "a2"
        what = f"observer.{key} = {show(getattr(given, key))}" if getattr(given, key) is not None else "the rig, as [observer] has it,"
        most = as_text(1.0 / (loses + trusts), "s")
        raise InputError(f"{what} acts faster than controller.period: give a smaller one, or a period of at most {most}")
    return observer


def _meters(data: Any, guard: TemperatureGuard | None, observer: ThermalObserver | None, period: float) -> Meters:
    given = validate(_Meters, data, "meters")
    if guard is None:
        raise InputError("[meters] are what a guard and its observer hear, and there is none: add a section [guard], or take [meters] out")
    each, lag = {}, 0.0
    for kind, unit in (("voltage", "V"), ("current", "A"), ("temperature", "K")):
        told = getattr(given, kind)
        if told is None:
            continue
        if kind != "temperature" and observer is None:
            raise InputError(f"meters.{kind}: nothing hears it without an observer: add a section [observer], or take it out")
        if kind == "temperature" and observer is not None and not float(observer.gain) > 0.0:
            raise InputError("meters.temperature: the observer trusts no thermocouple: give observer.trust a value, or take it out")
        one = validate(_Thermocouple if kind == "temperature" else _Sensor, told, f"meters.{kind}")
        each[kind] = _sensing(one, unit, period, f"meters.{kind}")
        if isinstance(one, _Thermocouple):
            lag = _positive(one.lag, "s", "meters.temperature.lag")
    if not each:
        raise InputError('[meters] names none: add a line like temperature = { noise = "0.5 K", lag = "1 s" }, or take the section out')
    return Meters(each, period, *arrays(lag))


def arrays(*values: float) -> tuple[Any, ...]:
    """Numbers as arrays."""
    return tuple(jnp.asarray(v, jnp.float64) for v in values)


def _positive(value: Any, unit: str, place: str) -> float:
    """A quantity of 0 or more; 0 where none is given."""
    return 0.0 if value is None else quantity_at(value, unit, place, least=0.0)
