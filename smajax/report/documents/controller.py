"""``controller.json``: a tuned controller, for programs other than smajax."""

from typing import Annotated, Any, ClassVar, Literal

from pydantic import Field

from smajax.report.documents.base import Document, Part

_Range = Annotated[list[float], Field(min_length=2, max_length=2)]


class GainValue(Part):
    """A gain."""

    value: float = Field(description="value, in the unit")
    unit: str = Field(description="unit in SI, degC for temperatures")


class Envelope(Part):
    """Envelope of an inverse operator, in the internal units of channel and command."""

    height: float = Field(description="height, in the channel's unit")
    steepness: float = Field(description="steepness, per unit of the command")
    shift: float = Field(description="shift, dimensionless")
    middle: float = Field(description="middle, in the channel's unit")


class FeedforwardInverse(Part):
    """Inverse Prandtl-Ishlinskii operator of a feedforward."""

    kind: Literal["inverse-prandtl-ishlinskii"] = Field(description="kind of the operator")
    direct: float = Field(description="direct part, dimensionless")
    thresholds: list[float] = Field(description="thresholds of the operators, in the channel's unit")
    densities: list[float] = Field(description="weights of the operators, dimensionless")
    envelope: Envelope = Field(description="the envelope")


class Limiter(Part):
    """Temperature limiter."""

    limit: float = Field(description="largest temperature, degC")
    kp: float = Field(description="proportional gain, unit of the command per K")
    ki: float = Field(description="integral gain, unit of the command per K and s")
    upper: float = Field(description="largest command, SI")


class Estimator(Part):
    """Temperature estimator; the numbers are those of a thermal observer, and absent for a Kalman filter."""

    kind: str | None = Field(None, description="kind of a Kalman filter; absent for a thermal observer")
    a1: float | None = Field(None, description="coefficient of the heating, SI")
    a2: float | None = Field(None, description="coefficient of the cooling, SI")
    exponent: float | None = Field(None, description="exponent of the command in the heating")
    ambient: float | None = Field(None, description="ambient temperature, degC")
    gain: float | None = Field(None, description="gain of the correction by a measured temperature, 1/s")
    steers: bool | None = Field(None, description="true if the controller uses the estimate; else absent")


class ControllerDocument(Document):
    """A tuned controller."""

    # With schema 2 the kinds of Kalman filters changed: ExtendedKalmanFilter was ExtendedFilter. The keys are those of
    # schema 1.
    SCHEMA: ClassVar[str] = "smajax.controller/2"
    EARLIER: ClassVar[tuple[str, ...]] = ("smajax.controller/1",)

    schema_name: Literal["smajax.controller/2"] = Field(alias="schema", description="name and version of the schema")
    kind: str = Field(description="kind of the controller")
    period_s: float = Field(description="period of the controller, s")
    output: _Range = Field(description="limits of the command, SI")
    blind_s: float = Field(
        description="time for which the channel, or a temperature, may be missing before the command is 0, s"
    )
    gains: dict[str, GainValue] = Field(description="gains by name")
    derivative_on: str | None = Field(
        None, description="signal of which the derivative is taken: error or measurement; absent without a derivative"
    )
    least: float | None = Field(None, description="smallest value of 1 + kb y of a BPID; absent for others")
    leave: float | None = Field(None, description="exit factor of a PPID; absent for others")
    law: str | None = Field(None, description="adaptation law of an adaptive PID; absent for others")
    growth: float | None = Field(None, description="bound of an adaptive PID's gains, as a multiple of their start")
    state: list[str] | None = Field(
        None, description="names of the numbers of the state, as in the C header; absent up to version 0.2.0"
    )
    constants: dict[str, Any] | None = Field(None, description="other constants of an own controller, by name")
    feedforward: FeedforwardInverse | None = Field(None, description="operator of a feedforward; absent without one")
    wires: list[float] | None = Field(None, description="largest commands of two wires, SI; absent for one wire")
    guard: Limiter | None = Field(None, description="temperature limiter; absent without one")
    observer: Estimator | None = Field(None, description="temperature estimator; absent without one")
