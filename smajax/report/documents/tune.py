"""``tune.json``, the document of ``smajax tune``."""

from typing import Annotated, ClassVar, Literal, Self

from pydantic import Field, model_validator

from smajax.report.documents.base import Document, Ends, Number, Part
from smajax.report.documents.parts import Margins


class GainEntry(Part):
    """A gain or another number of the controller."""

    start: Number = Field(description="start value, in the unit")
    tuned: Number = Field(description="tuned value, in the unit")
    unit: str = Field(description="unit in SI, degC for temperatures")
    usual_unit: str = Field(description="unit in which it is shown, which follows the usual unit of the channel")
    free: bool = Field(description="whether it was tuned")
    bounds: Ends = Field(description="lower and upper bound, in the unit; null for a fixed one")


class MetricsPair(Part):
    """Metrics of the rollouts with the start and the tuned gains, by name, in SI units and degC."""

    start: dict[str, Number] = Field(description="with the start gains; null where there is no finite value")
    tuned: dict[str, Number] = Field(description="with the tuned gains; null where there is no finite value")


class MarginsPair(Part):
    """Stability margins with the start and the tuned gains."""

    start: Margins = Field(description="with the start gains")
    tuned: Margins = Field(description="with the tuned gains")


class StablePair(Part):
    """Whether the rollouts are stable."""

    start: bool = Field(description="with the start gains")
    tuned: bool = Field(description="with the tuned gains")


class DrawsEntry(Part):
    """Checks of gains on draws of the uncertain parameters."""

    draws: int = Field(ge=1, description="number of draws")
    unstable: int = Field(ge=0, description="number of draws with an unstable rollout")
    unstable_linearised: int = Field(ge=0, description="number of further draws that are unstable, linearised")
    beyond_a_limit: int = Field(ge=0, description="number of draws that violate a limit")
    spread: dict[str, Annotated[list[Number], Field(min_length=3, max_length=3)]] = Field(
        description="5, 50 and 95 % quantile of each metric, in SI units and degC"
    )
    worst: dict[str, Number] = Field(description="largest value of each metric, in SI units and degC")
    worst_margins: Margins = Field(description="worst margins of all draws")


class WorstEntry(Part):
    """Largest value of a metric over the cases of a check."""

    value: Number = Field(description="largest value, in SI units and degC; null where it is not finite")
    case: str = Field(description="name of the case")


class CheckEntry(Part):
    """Check of the tuned gains on cases that no search has used."""

    cases: int = Field(ge=1, description="number of cases")
    groups: dict[str, int] = Field(
        description="number of cases by what they vary: noise, quiet (without noise), ambient (temperature), drawn "
        "(parameters), start (of the loop), rounded (gains)"
    )
    failing: int = Field(ge=0, description="number of cases that are unstable or violate a limit")
    unstable: int = Field(ge=0, description="number of cases without noise that are unstable")
    beyond: dict[str, int] = Field(description="number of cases that violate a limit, by its name; without zeros")
    worst: dict[str, WorstEntry] = Field(description="largest value of each metric with the tuned gains")
    start: dict[str, WorstEntry] = Field(description="largest value of each metric with the start gains")
    retunings: int = Field(ge=0, description="number of searches for cases that violated a limit")


class ResponseEntry(Part):
    """Response to a jump of the reference."""

    rise: Number = Field(description="rise time from 10 to 90 %, s; null where 90 % is not reached")
    settling: Number = Field(description="settling time, s; null where the last sample is outside of the band")
    overshoot: Number = Field(description="overshoot as a share of the jump")


class JumpEntry(Part):
    """A jump of the reference, and the responses to it."""

    number: int = Field(ge=1, description="number of the jump, from 1")
    time: float = Field(description="time of the jump, s")
    before: float = Field(description="reference before it, in the unit of the channel")
    after: float = Field(description="reference after it, in the unit of the channel")
    start: ResponseEntry = Field(description="response with the start gains")
    tuned: ResponseEntry = Field(description="response with the tuned gains")
    worst: ResponseEntry | None = Field(
        None, description="largest values over the cases of the check; absent without one"
    )


class RobustEntry(Part):
    """Checks on draws; empty without draws."""

    start: DrawsEntry | None = Field(None, description="with the start gains")
    tuned: DrawsEntry | None = Field(None, description="with the tuned gains")


class ObjectiveEntry(Part):
    """What was minimised."""

    settle: bool = Field(description="whether the settling time was minimised")
    weights: dict[str, float] = Field(description="weights of the cost's terms that were used")
    asked: dict[str, float] | None = Field(None, description="weights of the controller file; absent if they were used")


class FeedforwardEntry(Part):
    """Fit of the feedforward operator, before its inversion."""

    operators: int = Field(ge=1, description="number of play operators")
    loop: str = Field(description="name of the recording of the slow loop, or simulated")
    command: Ends = Field(description="range of the command of the loop, in command_unit")
    command_unit: str = Field(description="unit of the command")
    seconds: Number = Field(description="duration of the loop, s")
    misfit: Number = Field(description="RMSE of the operator, in the unit of the channel")
    stroke: Number = Field(description="stroke of the loop, in the unit of the channel")


class PulsesEntry(Part):
    """A command that is pulsed."""

    carrier: float = Field(description="frequency of the pulses, Hz")
    rmse_of_mean: Number = Field(description="RMSE with the mean of the pulses as command, in the unit of the channel")


class TuneDocument(Document):
    """Result of a tuning, in SI units and degC. Missing and infinite values are null."""

    # Schema 2 has the parameter names of smajax 0.2; all else is as in schema 1.
    SCHEMA: ClassVar[str] = "smajax.tune/2"
    EARLIER: ClassVar[tuple[str, ...]] = ("smajax.tune/1",)

    schema_name: Literal["smajax.tune/2"] = Field(alias="schema", description="name and version of the schema")
    rig: str = Field(description="file name of the rig")
    controller: str = Field(description="file name of the controller")
    channel: str = Field(description="the controlled channel")
    unit: str = Field(description="unit of the channel")
    command_unit: str | None = Field(None, description="unit of the command; absent up to version 0.2.0")
    feasible: bool = Field(description="whether the tuned gains are stable and meet all limits, also on all draws")
    problems: list[str] = Field(description="reasons why the result or the start is not usable, as clauses")
    gains: dict[str, GainEntry] = Field(description="gains by name")
    metrics: MetricsPair = Field(description="metrics of the rollouts")
    limits: dict[str, Number] = Field(description="limits by name, in SI units and degC")
    margins: MarginsPair = Field(description="stability margins")
    stable: StablePair = Field(description="whether the rollouts are stable")
    robust: RobustEntry = Field(description="checks on draws; empty without draws")
    start_kept: bool = Field(description="whether the start gains were kept, since no others are better on the draws")
    objective: ObjectiveEntry = Field(description="what was minimised")
    rollouts: int = Field(ge=0, description="number of rollouts")
    seed: int = Field(description="seed of all random numbers")
    smajax: str = Field(description="version of smajax that computed the result")
    left_out: dict[str, str] = Field(description="reason by file that was not written")
    feedforward: FeedforwardEntry | None = Field(None, description="fit of the feedforward; absent without one")
    pulses: PulsesEntry | None = Field(None, description="pulses of the command; absent without a carrier")
    believes: list[str] | None = Field(None, description="channels that the filter measures; absent without a filter")
    recording_notes: list[str] | None = Field(
        None, description="sentences on references and recordings of the controller file; absent where there are none"
    )
    case_check: CheckEntry | None = Field(
        None, description="check on cases that no search has used; absent where only the rollout of the file counts"
    )
    jumps: list[JumpEntry] | None = Field(None, description="jumps of the reference; absent up to version 0.2.0")
    low_margins: MarginsPair | None = Field(
        None,
        description="5 % quantile of gain and phase margin, and 95 % quantile of the sensitivity, over the operating "
        "points; absent up to version 0.2.0",
    )
    summary: str = Field(description="the result in sentences")

    @model_validator(mode="after")
    def _check_names(self) -> Self:
        if self.metrics.start.keys() != self.metrics.tuned.keys():
            raise ValueError("metrics of start and tuned gains have different names")
        if (self.robust.start is None) != (self.robust.tuned is None):
            raise ValueError("robust needs the checks of both start and tuned gains, or none")
        return self
