"""The part of a controller file that says what a rollout meets: [reference], what the channel should do, and [[change]], what changes.

[reference]
kind = "step"                     # step, staircase, sine, recorded
high = "5 mm"
duration = "20 s"
[[change]]                        # a parameter of the rig that jumps, as often as there are such sections
parameter = "load.mass"
at = "10 s"
value = "0.3 kg"
"""

from collections.abc import Mapping
from pathlib import Path
from typing import Annotated, Any

import jax.numpy as jnp
import numpy as np
from pydantic import BaseModel, Field

from smajax import parameters, recording
from smajax.control import references
from smajax.control.rollout import Scenario
from smajax.errors import InputError
from smajax.rig import Rig
from smajax.rig_schema import one_of, quantity
from smajax.toml_file import STRICT, advice, quantity_at, show, validate

_KEYS = {
    "step": ("duration", "low", "high", "at"),
    "staircase": ("duration", "levels", "hold"),
    "sine": ("duration", "low", "high", "frequency"),
    "recorded": ("file",),
}


class _Reference(BaseModel):
    model_config = STRICT
    kind: Annotated[str, one_of(("step", "staircase", "sine", "recorded"))]
    duration: Any = Field(None, examples=['"60 s"'])
    low: Any = Field(None, examples=['"0 mm"'])
    high: Any = Field(None, examples=['"5 mm"'])
    at: Any = Field(None, examples=['"1 s"'])
    levels: list[Any] = Field([], examples=['["2 mm", "6 mm", "4 mm"]'])
    hold: Any = Field(None, examples=['"20 s"'])
    frequency: Any = Field(None, examples=['"0.1 Hz"'])
    file: str | None = Field(None, examples=['"wanted.csv"'])


class _Change(BaseModel):
    model_config = STRICT
    parameter: str = Field(examples=['"load.mass"'])
    at: Any = Field(examples=['"30 s"'])
    value: Any = Field(examples=['"0.3 kg"'])


def read_scenario(
    data: Mapping[str, Any], folder: Path, rig: Rig, seen: tuple[str, str, float], rest: float, seed: int
) -> Scenario:  # fmt: skip
    """The scenario of a controller file's ``data``, whose paths start at ``folder``. InputError: section, key and cure.

    ``seen`` is the channel, its unit and the period in s, ``rest`` the channel's value at the start (where a ``low`` that is not given
    lies), ``seed`` that of the sensor's noise.
    """
    channel, unit, period = seen
    section = data["reference"]
    if isinstance(section, dict) and (kind := str(section.get("kind"))) in _KEYS:
        unknown = [key for key in section if key not in _Reference.model_fields]
        if unknown:  # the cure is among this kind's keys
            raise InputError(f"reference.{unknown[0]} is not known{advice(unknown[0], _KEYS[kind], f'the keys of a {kind} are')}")
    given = validate(_Reference, section, "reference")

    def level(value: Any, key: str, unit: str = unit, **ends: float) -> float:
        if value is None:
            field = _Reference.model_fields[key]
            raise InputError(f"reference.{key} is missing: a {given.kind} needs a line like {key} = {(field.examples or [''])[0]}")
        return quantity_at(value, unit, f"reference.{key}", **ends)

    def lasting(value: Any, key: str, periods: int) -> float:
        seconds = level(value, key, "s")
        if not seconds >= periods * period:
            least = f"{f'{periods} times ' if periods > 1 else ''}controller.period = {show(data['controller']['period'])}"
            raise InputError(f"reference.{key} = {show(value)} is shorter than {least}: make it longer, or the period shorter")
        return seconds

    for key in ("duration", "low", "high", "at", "levels", "hold", "frequency", "file"):
        if getattr(given, key) not in (None, []) and key not in _KEYS[given.kind]:
            raise InputError(
                f"reference.{key} has no place with a {given.kind}, whose keys are {', '.join(_KEYS[given.kind])}: take it out"
            )
    low = rest if given.low is None else quantity_at(given.low, unit, "reference.low")
    if given.kind == "recorded":
        if given.file is None:
            raise InputError('reference.file is missing: name the recording, as in file = "wanted.csv"')
        wanted = recording.read(folder / given.file, required=(channel,), mapping=rig.channels.columns)
        time = _clock(float(wanted.time[-1] - wanted.time[0]) + period, period, "file")
        values = references.recorded(time, wanted.time, wanted.channels[channel])
        before = float(values[0])
    else:
        time = _clock(lasting(given.duration, "duration", 2), period, "duration")
        before = low
        if given.kind == "step":
            at = 0.0 if given.at is None else quantity_at(given.at, "s", "reference.at", least=0.0)
            if at > time[-1]:
                raise InputError(f"reference.at = {show(given.at)} is not within reference.duration: give an earlier one")
            values = references.step(time, low, level(given.high, "high"), at)
        elif given.kind == "staircase":
            if not given.levels:
                raise InputError('reference.levels is missing: a staircase needs a line like levels = ["2 mm", "6 mm", "4 mm"]')
            steps, before = [quantity_at(v, unit, "reference.levels") for v in given.levels], rest
            hold = lasting(given.hold, "hold", 1)
            if (len(steps) - 1) * hold > time[-1]:
                raise InputError(
                    f"reference.levels: {len(steps)} levels of {show(given.hold)} do not fit into {show(given.duration)}: make it longer"
                )
            values = references.staircase(time, steps, hold)
        else:
            frequency = level(given.frequency, "frequency", "Hz", least=1e-6)
            if frequency * period >= 0.5:
                raise InputError(f"reference.frequency = {show(given.frequency)} is not below half a cycle in controller.period: lower it")
            values = references.sine(time, low, level(given.high, "high"), frequency)
    draws = jnp.asarray(np.random.default_rng(seed).standard_normal(len(time)))
    return Scenario(jnp.asarray(values), jnp.asarray(before), draws, _changes(data.get("change", []), rig, time))


def _clock(duration: float, period: float, key: str) -> np.ndarray:
    try:
        return references.clock(duration, period)
    except InputError as error:
        raise InputError(f"reference.{key}: {error}") from None


def _changes(listed: Any, rig: Rig, time: np.ndarray) -> dict[str, Any]:
    """The parameters that change, each as a series; whatever the order of the sections, later changes come after earlier ones."""
    read = []
    for change in listed if isinstance(listed, list) else [listed]:
        one = validate(_Change, change, "change")
        if one.parameter.startswith("initial."):
            raise InputError(f"change.parameter: {one.parameter} is how a run begins, which nothing changes later: set it in the rig")
        try:
            declared = parameters.declaration(rig.plant, one.parameter)
        except InputError as error:
            raise InputError(f"change.parameter: {error}") from None
        try:
            value = quantity(one.value, declared)
        except InputError as error:
            raise InputError(f"change.value of {one.parameter}: {error}") from None
        at = quantity_at(one.at, "s", f"change.at of {one.parameter}", least=0.0)
        if at > time[-1]:
            raise InputError(f"change.at of {one.parameter} = {show(one.at)} is after the reference's end: give an earlier one")
        read.append((at, one.parameter, value))
    changes: dict[str, np.ndarray] = {}
    for at, name, value in sorted(read, key=lambda change: change[0]):
        series = changes.setdefault(name, np.full(len(time), float(parameters.get(rig.plant, name))))
        series[time >= at - 1e-9] = value
    return {name: jnp.asarray(series) for name, series in changes.items()}
