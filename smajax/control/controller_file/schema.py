"""Sections of controller.toml and their keys, as pydantic models; the examples are shown in error messages.

The models need no JAX, so that a mistake is reported before it is loaded.
"""

from collections.abc import Mapping, Sequence
from typing import Annotated, Any

from pydantic import BaseModel, Field

from smajax.arguments import MAX_SEED
from smajax.control.analysis.case_numbers import NOISE_CASES
from smajax.errors import InputError
from smajax.files.class_tables import shipped_document
from smajax.files.rig_classes import uses_tables
from smajax.files.toml import STRICT, validate
from smajax.files.validators import one_of

# Keys of [controller] that belong to some kinds only.
OPTIONS = ("derivative_on", "law")
SECTIONS = (
    "schema",
    "controller",
    "gains",
    "feedforward",
    "reference",
    "tune",
    "limits",
    "sensor",
    "temperature_limiter",
    "estimator",
    "instruments",
    "robust",
    "change",
)


def controller_kinds() -> Mapping[str, Sequence[str]]:
    """Return the kinds of controllers that a file may name, with the names of their own options."""
    if uses_tables():
        return shipped_document()["controllers"]
    from smajax.control.controllers.registry import file_kinds

    return {kind: cls.options() for kind, cls in file_kinds().items()}


class ControllerSection(BaseModel):
    """Section [controller]: kind, period, channel and limits of the command."""

    model_config = STRICT
    kind: Annotated[str, one_of(controller_kinds)] = Field(
        "pid", description="kind of controller, or the name of a registered class"
    )
    period: str = Field(examples=['"20 ms"'], description="time between two samples")
    output: list[Any] = Field(
        min_length=2, max_length=2, examples=['["0 A", "0.5 A"]'], description="smallest and largest command"
    )
    channel: str | None = Field(
        None, examples=['"displacement"'], description="controlled channel; by default the motion of the rig"
    )
    derivative_on: Annotated[str, one_of(("error", "value"))] = Field(
        "error", description="signal of the derivative: the error, or minus the value"
    )
    law: Annotated[str, one_of(("gradient", "printed"))] = Field(
        "gradient", description="adaptation of an adaptive PID: along the gradient, or as printed in its paper"
    )
    carrier: Any = Field(
        None, examples=['"100 Hz"'], description="frequency of the pulses of a duty; without it the mean acts"
    )


def controller_section(data: Any) -> ControllerSection:
    """Read [controller]; an own kind may have its static fields as further keys, which are left out here.

    Args:
        data: The section.

    Raises:
        InputError: for a wrong or unknown key or value, or an own kind whose option has the name of another key.
    """
    kind = data.get("kind", "pid") if isinstance(data, dict) else None
    own = controller_kinds().get(kind, ()) if isinstance(kind, str) else ()
    if taken := [name for name in own if name in ControllerSection.model_fields and name not in OPTIONS]:
        raise InputError(
            f"controller.kind = '{kind}': its option '{taken[0]}' has the name of another key of [controller]: rename "
            f"the field '{taken[0]}' of its class"
        )
    if isinstance(data, dict):
        data = {name: value for name, value in data.items() if name in OPTIONS or name not in own}
    return validate(ControllerSection, data, "controller")


class FeedforwardSection(BaseModel):
    """Section [feedforward]: number of play operators, and the slow loop to which the operator is fitted."""

    model_config = STRICT
    operators: int = Field(
        10, ge=1, le=100, examples=["10"], description="number of play operators of the hysteresis model"
    )
    range: list[Any] | None = Field(
        None,
        min_length=2,
        max_length=2,
        examples=['["0.1 A", "0.35 A"]'],
        description="commands between which the slow loop is simulated",
    )
    recording: str | None = Field(
        None, examples=['"slow.csv"'], description="recording of a slow loop, in place of a simulated one"
    )


class TuneSection(BaseModel):
    """Section [tune]: free gains, objective and search."""

    model_config = STRICT
    free: list[str] | None = Field(
        None, examples=['["kp", "ki"]'], description="gains that are tuned; by default all that are above 0"
    )
    objective: Any = Field(
        "tracking",
        examples=['"tracking"'],
        description="tracking, itae, energy, effort, settling, or weights of several",
    )
    bounds: dict[str, Any] = Field(
        {},
        examples=['{ kp = ["1 A/m", "500 A/m"] }'],
        description="bounds of gains; by default 0.01 and 100 times the start value",
    )
    starts: int = Field(4, ge=1, le=1000, examples=["4"], description="points from which the search begins")
    seed: int = Field(0, ge=0, le=MAX_SEED, examples=["0"], description="seed of all random numbers")
    band: Any = Field(
        "2 %", examples=['"2 %"'], description="band around the reference in which a response counts as settled"
    )
    check: int = Field(
        NOISE_CASES,
        ge=1,
        le=100_000,
        examples=["64"],
        description="draws of the noise by which the gains are judged; 1 for the rollout of the file only",
    )


class LimitsSection(BaseModel):
    """Section [limits]: limits on the wires' channels and on the step response."""

    model_config = STRICT
    temperature: Any = Field(None, examples=['"110 degC"'], description="largest temperature of a wire")
    current: Any = Field(None, examples=['"0.4 A"'], description="largest current of a wire")
    stress: Any = Field(None, examples=['"200 MPa"'], description="largest stress of a wire")
    overshoot: Any = Field(None, examples=['"2 %"'], description="largest overshoot of a step, as a share of it")
    settling: Any = Field(None, examples=['"5 s"'], description="longest settling time of a step")


class RobustSection(BaseModel):
    """Section [robust]: samples of uncertain parameters for which the gains are tuned and checked."""

    model_config = STRICT
    fit: str | None = Field(
        None, examples=['"result"'], description="folder of a fit from whose intervals parameters are drawn"
    )
    draws: int = Field(8, ge=1, le=4096, examples=["8"], description="number of draws that the gains are tuned for")
    check: int = Field(
        64, ge=1, le=100_000, examples=["500"], description="number of draws that the gains are checked on"
    )
    vary: dict[str, Any] = Field(
        {},
        examples=['{ "environment.ambient" = ["15 degC", "30 degC"] }'],
        description="ranges from which parameters are drawn",
    )


class ReferenceSection(BaseModel):
    """Section [reference]: the reference of the channel over time."""

    model_config = STRICT
    kind: Annotated[str, one_of(("step", "staircase", "sine", "recorded"))] = Field(
        examples=['"staircase"'], description="shape over time"
    )
    duration: Any = Field(None, examples=['"60 s"'], description="length of the rollout")
    low: Any = Field(
        None, examples=['"0 mm"'], description="value before the step, or smallest of a sine; by default that at rest"
    )
    high: Any = Field(None, examples=['"5 mm"'], description="value after the step, or largest of a sine")
    at: Any = Field(None, examples=['"1 s"'], description="time of the step")
    levels: list[Any] = Field([], examples=['["2 mm", "6 mm", "4 mm"]'], description="values of a staircase")
    hold: Any = Field(None, examples=['"20 s"'], description="time at each level of a staircase")
    frequency: Any = Field(None, examples=['"0.1 Hz"'], description="frequency of a sine")
    file: str | None = Field(
        None, examples=['"reference.csv"'], description="recording with the reference in the controlled channel"
    )


class ChangeSection(BaseModel):
    """One section [[change]]: a parameter of the rig that jumps at a time."""

    model_config = STRICT
    parameter: str = Field(examples=['"load.mass"'], description="parameter of the rig, by SECTION.KEY")
    at: Any = Field(examples=['"30 s"'], description="time of the jump")
    value: Any = Field(examples=['"0.3 kg"'], description="value after the jump")


class SensorSection(BaseModel):
    """Section [sensor], or one entry of [instruments]: noise, quantisation and delay."""

    model_config = STRICT
    noise: Any = Field(None, examples=['"0.01 mm"'], description="standard deviation of the noise")
    quantum: Any = Field(None, examples=['"0.005 mm"'], description="step of the converter")
    delay: Any = Field(None, examples=['"20 ms"'], description="delay of the reading")


class ThermocoupleSection(SensorSection):
    """Entry ``temperature`` of [instruments]: a sensor with a lag."""

    lag: Any = Field(None, examples=['"1 s"'], description="time constant of the thermocouple")


class TemperatureLimiterSection(BaseModel):
    """Section [temperature_limiter]: largest temperature and gains."""

    model_config = STRICT
    limit: Any = Field(examples=['"110 degC"'], description="temperature that the wire must not exceed")
    kp: Any = Field(examples=['"0.05 A/K"'], description="proportional gain, command per kelvin below the limit")
    ki: Any = Field(None, examples=['"0.01 A/K/s"'], description="integral gain")


class EstimatorSection(BaseModel):
    """Section [estimator]: a thermal observer or an extended Kalman filter."""

    model_config = STRICT
    kind: Annotated[str, one_of(("thermal", "extended"))] = Field(
        "thermal", description="a thermal observer, or an extended Kalman filter"
    )
    a1: Any = Field(
        None, examples=['"12 K/J"'], description="rise of the temperature per heat; by default from the rig"
    )
    a2: Any = Field(None, examples=['"-0.8 1/s"'], description="rate of cooling; by default from the rig")
    exponent: int = Field(1, ge=1, le=6, examples=["2"], description="power of the excess temperature in the cooling")
    gain: Any = Field(None, examples=['"0.2 1/s"'], description="correction by a thermocouple, per time")
    unknown: dict[str, Any] = Field(
        {},
        examples=['{ "environment.ambient" = "4 K" }'],
        description="parameters that the filter estimates, with their initial standard deviations",
    )
    start: Any = Field("0 K", examples=['"5 K"'], description="standard deviation of the initial temperature")
    temperature_process_noise: Any = Field(
        "2 K",
        examples=['"2 K"'],
        description="random walk of the temperature, standard deviation in the square root of a second",
    )
    fraction_process_noise: Any = Field(
        "10 %", examples=['"10 %"'], description="random walk of the martensite fraction, likewise"
    )
    use_estimate: bool = Field(
        False, examples=["true"], description="whether the controller uses the filter's estimate of its channel"
    )


class InstrumentsSection(BaseModel):
    """Section [instruments]: a sensor for each kind of channel."""

    model_config = STRICT
    voltage: Any = Field(
        None,
        examples=['{ noise = "10 mV", quantum = "5 mV" }'],
        description="sensor of the voltage, with the keys of [sensor]",
    )
    current: Any = Field(
        None, examples=['{ noise = "2 mA", delay = "20 ms" }'], description="sensor of the current, likewise"
    )
    temperature: Any = Field(
        None, examples=['{ noise = "0.5 K", lag = "1 s" }'], description="thermocouple, likewise, with a lag"
    )
    displacement: Any = Field(
        None, examples=['{ noise = "20 um" }'], description="sensor of the displacement, likewise"
    )
    angle: Any = Field(None, examples=['{ noise = "0.1 deg" }'], description="sensor of the angle, likewise")
