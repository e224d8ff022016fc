"""The part of a controller file that says what is heard of the rig: [sensor] by the controller, [meters] by guard and observer.

[sensor]                          # what the controller sees of its channel
noise = "5 um"
[guard]                           # keeps the wire below a temperature whatever the controller wants
limit = "115 degC"
kp = "0.05 A/K"
[observer]                        # the guard knows the temperature from the wire's power
trust = "0.2 1/s"                 # and corrects it by a thermocouple; or, from all meters, by a Kalman filter on the plant:
kind = "extended"
unknown = { "environment.ambient" = "4 K" }
steers = true                     # the controller, too, goes by the filter, and not by a sensor of its channel
[meters]
temperature = { noise = "0.5 K", lag = "1 s" }
"""

import math
from collections.abc import Mapping
from dataclasses import replace
from typing import Annotated, Any, NamedTuple

import jax.numpy as jnp
from pydantic import BaseModel, Field

from smajax import parameters
from smajax.control.driven import DrivenPlant
from smajax.control.extended import ExtendedFilter
from smajax.control.guard import TemperatureGuard
from smajax.control.meters import Meters
from smajax.control.observers import AbstractThermometer, ThermalObserver
from smajax.control.pid import PID
from smajax.control.sensing import Sensing
from smajax.errors import InputError
from smajax.rig import Rig
from smajax.rig_schema import as_text, one_of
from smajax.toml_file import STRICT, quantity_at, show, validate

_LATEST = 10_000  # periods of delay
_LATEST_FILTERED = 100  # of a meter that an extended filter hears: it carries as many past values along
_THERMAL, _EXTENDED = ("a1", "a2", "exponent", "trust"), ("unknown", "start", "drift", "walk", "steers")


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
    kind: Annotated[str, one_of(("thermal", "extended"))] = "thermal"
    a1: Any = Field(None, examples=['"12 K/J"'])
    a2: Any = Field(None, examples=['"-0.8 1/s"'])
    exponent: int = Field(1, ge=1, le=6, examples=["2"])
    trust: Any = Field(None, examples=['"0.2 1/s"'])
    unknown: dict[str, Any] = Field({}, examples=['{ "environment.ambient" = "4 K" }'])
    start: Any = Field("0 K", examples=['"5 K"'])
    drift: Any = Field("2 K", examples=['"2 K"'])
    walk: Any = Field("10 %", examples=['"10 %"'])
    steers: bool = Field(False, examples=["true"])


class _Thermocouple(_Sensor):
    lag: Any = Field(None, examples=['"1 s"'])


class _Meters(BaseModel):
    model_config = STRICT
    voltage: Any = Field(None, examples=['{ noise = "10 mV", quantum = "5 mV" }'])
    current: Any = Field(None, examples=['{ noise = "2 mA", delay = "20 ms" }'])
    temperature: Any = Field(None, examples=['{ noise = "0.5 K", lag = "1 s" }'])
    displacement: Any = Field(None, examples=['{ noise = "20 um" }'])
    angle: Any = Field(None, examples=['{ noise = "0.1 deg" }'])


class Heard(NamedTuple):
    """What in a loop hears the rig, by the names by which a ``Loop`` takes it."""

    sensing: Sensing
    guard: TemperatureGuard | None
    observer: AbstractThermometer | None
    meters: Meters | None
    believes: bool = False


def read_sensing(data: Mapping[str, Any], rig: Rig, units: tuple[str, str], period: float, most: float) -> Heard:
    """What a controller file's ``data`` says of it. InputError: section, key and cure.

    ``units`` are those of the command and of differences of the channel, ``period`` is the controller's in s, ``most`` the largest command.
    """
    command, difference = units
    sensing = _sensing(validate(_Sensor, data.get("sensor", {}), "sensor"), difference, period, "sensor")
    guard = _guard(data["guard"], rig, command, period, most) if "guard" in data else None
    given = _observer(data["observer"], guard) if "observer" in data else None
    if given is None or given.kind == "thermal":
        observer = None if given is None or guard is None else _thermal(given, rig, guard, period)
        return Heard(sensing, guard, observer, _meters(data["meters"], rig, guard, observer, period) if "meters" in data else None)
    if "meters" not in data:
        raise InputError('an extended filter knows what it hears by [meters]: add it, with a line like voltage = { noise = "2 mV" }')
    if given.steers and "sensor" in data:
        raise InputError(
            "[sensor] is what a controller hears, and by observer.steers this one goes by the filter, which hears [meters]: move it to "
            f"meters.{rig.plant.mechanism.coordinate}, or take it out"
        )
    meters = _meters(data["meters"], rig, guard, given, period)
    return Heard(sensing, guard, _extended(given, rig, meters, period), meters, given.steers)


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


def _observer(data: Any, guard: TemperatureGuard | None) -> _Observer:
    given = validate(_Observer, data, "observer")
    if guard is None and not (given.kind == "extended" and given.steers):
        raise InputError(
            "[observer] tells a guard the wire's temperature, and there is none: add a section [guard], or take [observer] out"
            + (", or let the controller go by it: steers = true" if given.kind == "extended" else "")
        )
    for key in _EXTENDED if given.kind == "thermal" else _THERMAL:
        if key in given.model_fields_set:
            other = "extended" if given.kind == "thermal" else "thermal"
            raise InputError(f'observer.{key} belongs to kind = "{other}": take it out, or change the kind')
    return given


def _extended(given: _Observer, rig: Rig, meters: Meters, period: float) -> ExtendedFilter:
    """The filter on the rig's own plant, which takes the meters for what they are; of a carrier it knows the mean."""
    unknown = {}
    for name, value in given.unknown.items():
        try:
            declared = parameters.declaration(rig.plant, name)
        except InputError as error:
            raise InputError(f"observer.unknown: {error}") from None
        unknown[name] = quantity_at(value, "K" if declared.unit == "degC" else declared.unit, f"observer.unknown.{name}", least=0.0)
    start, drift = (_positive(v, "K", f"observer.{k}") for v, k in ((given.start, "start"), (given.drift, "drift")))
    walk = _positive(given.walk, "1", "observer.walk")
    return ExtendedFilter.of(DrivenPlant.of(rig.plant, period), meters, unknown, start=start, drift=drift, walk=walk)


def _thermal(given: _Observer, rig: Rig, guard: TemperatureGuard, period: float) -> ThermalObserver:
    """What tells the guard the temperature; what is not given is what the rig's convection and capacity say at the guard's limit."""
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


def _meters(data: Any, rig: Rig, guard: TemperatureGuard | None, observer: ThermalObserver | _Observer | None, period: float) -> Meters:
    """What guard and observer hear, the observer being a thermal one or, by its section, a filter."""
    given = validate(_Meters, data, "meters")
    each, lag, filtered = {}, 0.0, isinstance(observer, _Observer)
    if guard is None and not filtered:
        raise InputError("[meters] are what a guard and its observer hear, and there is none: add a section [guard], or take [meters] out")
    for kind, unit in (("voltage", "V"), ("current", "A"), ("temperature", "K"), ("displacement", "m"), ("angle", "rad")):
        told = getattr(given, kind)
        if told is None:
            continue
        if kind in ("displacement", "angle") and (kind != rig.plant.mechanism.coordinate or not filtered):
            why = "only an extended filter hears it" if kind == rig.plant.mechanism.coordinate else f"this rig has no {kind}"
            raise InputError(f"meters.{kind}: {why}: take it out" + (', or add an [observer] of kind = "extended"' if not filtered else ""))
        if kind != "temperature" and observer is None:
            raise InputError(f"meters.{kind}: nothing hears it without an observer: add a section [observer], or take it out")
        if kind == "temperature" and isinstance(observer, ThermalObserver) and not float(observer.gain) > 0.0:
            raise InputError("meters.temperature: the observer trusts no thermocouple: give observer.trust a value, or take it out")
        one = validate(_Thermocouple if kind == "temperature" else _Sensor, told, f"meters.{kind}")
        each[kind] = _sensing(one, unit, period, f"meters.{kind}")
        if filtered and not float(each[kind].noise) + float(each[kind].quantum) > 0.0:
            raise InputError(f"meters.{kind}: an extended filter would trust it without bounds: give it a noise or a quantum")
        if filtered and each[kind].delay > _LATEST_FILTERED:
            raise InputError(f"meters.{kind}.delay is too long for an extended filter: give {_LATEST_FILTERED * period:g} s or less")
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
