"""Sections of controller.toml and their keys, as pydantic models; the examples are shown in error messages."""

from typing import Annotated, Any

from pydantic import BaseModel, BeforeValidator, Field, TypeAdapter

from smajax.arguments import MAX_SEED
from smajax.control.analysis.cases import NOISE_CASES
from smajax.control.controllers.registry import controller_class, file_kinds
from smajax.errors import InputError
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


def _known_kind(kind: Any) -> str:
    return TypeAdapter(Annotated[str, one_of(file_kinds())]).validate_python(kind)


class ControllerSection(BaseModel):
    """Section [controller]: kind, period, channel and limits of the command."""

    model_config = STRICT
    kind: Annotated[str, BeforeValidator(_known_kind)] = "pid"
    period: str = Field(examples=['"20 ms"'])
    output: list[Any] = Field(min_length=2, max_length=2, examples=['["0 A", "0.5 A"]'])
    channel: str | None = Field(None, examples=['"displacement"'])
    derivative_on: Annotated[str, one_of(("error", "value"))] = "error"
    law: Annotated[str, one_of(("gradient", "printed"))] = "gradient"
    carrier: Any = Field(None, examples=['"100 Hz"'])


def controller_section(data: Any) -> ControllerSection:
    """Read [controller]; an own kind may have its static fields as further keys, which are left out here.

    Args:
        data: The section.

    Raises:
        InputError: for a wrong or unknown key or value, or an own kind whose option has the name of another key.
    """
    kind = data.get("kind", "pid") if isinstance(data, dict) else None
    own = controller_class(kind).options() if isinstance(kind, str) and kind in file_kinds() else ()
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
    operators: int = Field(10, ge=1, le=100, examples=["10"])
    range: list[Any] | None = Field(None, min_length=2, max_length=2, examples=['["0.1 A", "0.35 A"]'])
    recording: str | None = Field(None, examples=['"slow.csv"'])


class TuneSection(BaseModel):
    """Section [tune]: free gains, objective and search."""

    model_config = STRICT
    free: list[str] | None = Field(None, examples=['["kp", "ki"]'])
    objective: Any = Field("tracking", examples=['"tracking"'])
    bounds: dict[str, Any] = Field({}, examples=['{ kp = ["1 A/m", "500 A/m"] }'])
    starts: int = Field(4, ge=1, le=1000, examples=["4"])
    seed: int = Field(0, ge=0, le=MAX_SEED, examples=["0"])
    band: Any = Field("2 %", examples=['"2 %"'])
    check: int = Field(NOISE_CASES, ge=1, le=100_000, examples=["64"])


class LimitsSection(BaseModel):
    """Section [limits]: limits on the wires' channels and on the step response."""

    model_config = STRICT
    temperature: Any = Field(None, examples=['"110 degC"'])
    current: Any = Field(None, examples=['"0.4 A"'])
    stress: Any = Field(None, examples=['"200 MPa"'])
    overshoot: Any = Field(None, examples=['"2 %"'])
    settling: Any = Field(None, examples=['"5 s"'])


class RobustSection(BaseModel):
    """Section [robust]: samples of uncertain parameters for which the gains are tuned and checked."""

    model_config = STRICT
    fit: str | None = Field(None, examples=['"result"'])
    draws: int = Field(8, ge=1, le=4096, examples=["8"])
    check: int = Field(64, ge=1, le=100_000, examples=["500"])
    vary: dict[str, Any] = Field({}, examples=['{ "environment.ambient" = ["15 degC", "30 degC"] }'])


class ReferenceSection(BaseModel):
    """Section [reference]: the reference of the channel over time."""

    model_config = STRICT
    kind: Annotated[str, one_of(("step", "staircase", "sine", "recorded"))]
    duration: Any = Field(None, examples=['"60 s"'])
    low: Any = Field(None, examples=['"0 mm"'])
    high: Any = Field(None, examples=['"5 mm"'])
    at: Any = Field(None, examples=['"1 s"'])
    levels: list[Any] = Field([], examples=['["2 mm", "6 mm", "4 mm"]'])
    hold: Any = Field(None, examples=['"20 s"'])
    frequency: Any = Field(None, examples=['"0.1 Hz"'])
    file: str | None = Field(None, examples=['"reference.csv"'])


class ChangeSection(BaseModel):
    """One section [[change]]: a parameter of the rig that jumps at a time."""

    model_config = STRICT
    parameter: str = Field(examples=['"load.mass"'])
    at: Any = Field(examples=['"30 s"'])
    value: Any = Field(examples=['"0.3 kg"'])


class SensorSection(BaseModel):
    """Section [sensor], or one entry of [instruments]: noise, quantisation and delay."""

    model_config = STRICT
    noise: Any = Field(None, examples=['"0.01 mm"'])
    quantum: Any = Field(None, examples=['"0.005 mm"'])
    delay: Any = Field(None, examples=['"20 ms"'])


class ThermocoupleSection(SensorSection):
    """Entry ``temperature`` of [instruments]: a sensor with a lag."""

    lag: Any = Field(None, examples=['"1 s"'])


class TemperatureLimiterSection(BaseModel):
    """Section [temperature_limiter]: largest temperature and gains."""

    model_config = STRICT
    limit: Any = Field(examples=['"110 degC"'])
    kp: Any = Field(examples=['"0.05 A/K"'])
    ki: Any = Field(None, examples=['"0.01 A/K/s"'])


class EstimatorSection(BaseModel):
    """Section [estimator]: a thermal observer or an extended Kalman filter."""

    model_config = STRICT
    kind: Annotated[str, one_of(("thermal", "extended"))] = "thermal"
    a1: Any = Field(None, examples=['"12 K/J"'])
    a2: Any = Field(None, examples=['"-0.8 1/s"'])
    exponent: int = Field(1, ge=1, le=6, examples=["2"])
    gain: Any = Field(None, examples=['"0.2 1/s"'])
    unknown: dict[str, Any] = Field({}, examples=['{ "environment.ambient" = "4 K" }'])
    start: Any = Field("0 K", examples=['"5 K"'])
    temperature_process_noise: Any = Field("2 K", examples=['"2 K"'])
    fraction_process_noise: Any = Field("10 %", examples=['"10 %"'])
    use_estimate: bool = Field(False, examples=["true"])


class InstrumentsSection(BaseModel):
    """Section [instruments]: a sensor for each kind of channel."""

    model_config = STRICT
    voltage: Any = Field(None, examples=['{ noise = "10 mV", quantum = "5 mV" }'])
    current: Any = Field(None, examples=['{ noise = "2 mA", delay = "20 ms" }'])
    temperature: Any = Field(None, examples=['{ noise = "0.5 K", lag = "1 s" }'])
    displacement: Any = Field(None, examples=['{ noise = "20 um" }'])
    angle: Any = Field(None, examples=['{ noise = "0.1 deg" }'])
