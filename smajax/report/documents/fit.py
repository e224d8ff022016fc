"""``fit.json``, the document of ``smajax fit``."""

from typing import ClassVar, Literal, Self

from pydantic import Field, model_validator

from smajax.report.documents.base import Document, Ends, Number, Part
from smajax.report.documents.parts import BenchEntry, ChannelValue, ImplausibleEntry, NoiseEntry, RecordingEntry


class ParameterEntry(Part):
    """A free parameter; ``value`` and ``interval`` are its estimate and the ends of its 95 % interval."""

    estimate: Number = Field(description="estimate, in the unit; the start value if the fit failed")
    lower95: Number = Field(description="lower end of the 95 % interval, in the unit; null if there is none")
    upper95: Number = Field(description="upper end of the 95 % interval, in the unit; null if there is none")
    unit: str = Field(description="declared unit: SI, degC for temperatures")
    free: bool = Field(description="whether it was fitted")
    at_bound: bool = Field(description="whether the estimate is at a bound, and therefore has no interval")
    bounds: Ends = Field(description="lower and upper bound, in the unit; null for none")
    plausible: Ends | None = Field(
        None, description="what an alloy can have, in the unit; null where no range is known, or in earlier documents"
    )
    nominal: Number = Field(
        None, description="value at which the fit began, in the unit; null if it is derived, or in earlier documents"
    )
    file_unit: str | None = Field(
        None,
        description="unit of the rig file, in which texts show it; null where it has none, or in earlier documents",
    )

    @property
    def value(self) -> float | None:
        """The estimate, in ``unit``; ``None`` if there is none."""
        return self.estimate

    @property
    def interval(self) -> tuple[float, float] | None:
        """The ends of the 95 % interval, in ``unit``; ``None`` if there is none."""
        return None if self.lower95 is None or self.upper95 is None else (self.lower95, self.upper95)

    @model_validator(mode="after")
    def _check_order(self) -> Self:
        if self.lower95 is not None and self.upper95 is not None and self.lower95 > self.upper95:
            raise ValueError("lower95 is above upper95")
        return self


class FixedEntry(Part):
    """A parameter that was not fitted."""

    value: Number = Field(description="value, in the unit")
    unit: str = Field(description="declared unit: SI, degC for temperatures")
    source: str = Field(description="file, and line in it, that gives the value")


class RmseEntry(Part):
    """Root mean square error of a channel."""

    train: Number = Field(description="error on the training recordings, in the unit")
    holdout: Number = Field(description="error on the holdout recordings, in the unit; null without any")
    unit: str = Field(description="unit of the recording's column; K for temperatures")


class CollinearEntry(Part):
    """A group of parameters that the recordings hardly distinguish."""

    parameters: list[str] = Field(min_length=1, description="names of the parameters")
    direction: list[Number] = Field(
        min_length=1, description="their joint change without effect, each relative to the size of the parameter"
    )
    shrink: Number = Field(description="share of the response that remains when they change together")

    @model_validator(mode="after")
    def _check_lengths(self) -> Self:
        if len(self.parameters) != len(self.direction):
            raise ValueError("direction and parameters have different lengths")
        return self


class Correlations(Part):
    """Correlations of the estimates."""

    parameters: list[str] = Field(description="names of the rows and columns")
    matrix: list[list[Number]] = Field(description="correlations, row by row; null without an estimate of them")

    @model_validator(mode="after")
    def _check_lengths(self) -> Self:
        if {len(self.matrix), *map(len, self.matrix)} - {len(self.parameters)}:
            raise ValueError("matrix needs a row and a column for each of the parameters")
        return self


class ProfileEntry(Part):
    """Profile likelihood of a parameter; a rise of 3.841 bounds its 95 % interval."""

    values: list[Number] = Field(description="values at which the parameter was fixed, in its unit")
    rise: list[Number] = Field(description="rise of the cost at each value when all others are fitted again")
    lower95: Number = Field(description="lower end of the 95 % interval, in the parameter's unit; null if it is open")
    upper95: Number = Field(description="upper end of the 95 % interval, in the parameter's unit; null if it is open")

    @model_validator(mode="after")
    def _check_lengths(self) -> Self:
        if len(self.values) != len(self.rise):
            raise ValueError("values and rise have different lengths")
        return self


class InputNoiseEntry(Part):
    """Noise of an electrical input of the fit."""

    channel: str = Field(description="the input")
    value: Number = Field(description="standard deviation of a row, in the unit")
    unit: str = Field(description="unit of the recording's column")
    source: Literal["given", "estimated"] = Field(
        alias="from", description="whether the rig file or the caller gives it, or it was estimated"
    )
    kind: Literal["none", "meter", "ripple", "both", "undecided", "no-plateaus"] = Field(
        description="noise of the meter, ripple that the wire gets, both, or not decided; no-plateaus where the input "
        "does not stay at levels, so that the estimates are not corrected"
    )
    share: Number = Field(description="share of the variance that the wire gets; null if it is not known")
    plateaus: int = Field(
        ge=0, description="number of parts of the training recordings in which the command is constant"
    )
    text: str = Field(description="the same in sentences, with the reason")


class SolverEntry(Part):
    """How the search ended, and its effort."""

    code: Literal["converged", "stalled", "steps", "interrupted", "failed", "diverged", "not_stationary"] = Field(
        description="how it ended"
    )
    text: str = Field(description="the same as a sentence")
    steps: int = Field(ge=0, description="number of steps from the best start")
    simulations: int = Field(ge=0, description="number of simulations")
    wall_s: Number = Field(description="wall time, s")
    compile_s: Number = Field(description="part of the wall time in which programs were compiled, s")
    starts: int = Field(ge=0, description="number of start points")
    starts_at_best: int = Field(ge=0, description="number of starts that reached the best minimum")


class FitDocument(Document):
    """Result of a fit.

    Parameters are in their declared units (SI, temperatures degC); rmse, noise_floor and discretisation in the unit of
    the recording's column (K for temperatures). Missing values are null.
    """

    # Parameter names changed with schema 2 (material.max_transformation_strain was material.max_strain); the keys are
    # those of schema 1.
    SCHEMA: ClassVar[str] = "smajax.fit/2"
    EARLIER: ClassVar[tuple[str, ...]] = ("smajax.fit/1",)

    schema_name: Literal["smajax.fit/2"] = Field(alias="schema", description="name and version of the schema")
    rig: str = Field(description="file name of the rig")
    model: str = Field(description="material law")
    kind: str = Field(description="kind of the rig")
    inputs: list[str] = Field(description="channels that drive the plant")
    observed: list[str] = Field(description="channels that were fitted and scored")
    parameters: dict[str, ParameterEntry] = Field(
        description="free parameters by name; section.key@recording if each recording has its own value"
    )
    fixed: dict[str, FixedEntry] = Field(description="fixed parameters that the rig file or its parameter set gives")
    rmse: dict[str, RmseEntry] = Field(description="error by observed channel")
    noise_floor: dict[str, NoiseEntry] = Field(
        description="standard deviation of the fastest part of the residual, by observed channel"
    )
    indistinct: list[CollinearEntry] = Field(description="groups of collinear parameters")
    correlations: Correlations = Field(description="correlations of the estimates")
    discretisation: dict[str, ChannelValue] = Field(
        description="RMS change of the model on the first recording when all time steps are halved, by observed channel"
    )
    transformation_temperatures: dict[str, Number] = Field(
        default_factory=dict,
        description="transformation temperatures at zero stress that result from the estimates, degC, by parameter "
        "name; empty where none is free, absent in earlier documents",
    )
    profiles: dict[str, ProfileEntry] = Field(description="requested profile likelihoods by parameter")
    solver: SolverEntry = Field(description="how the search ended, and its effort")
    recordings: list[RecordingEntry] = Field(min_length=1, description="training and holdout recordings")
    bench: list[BenchEntry] = Field(
        [], description="what the recordings show about their bench, before any number; absent in earlier documents"
    )
    failure: str = Field(
        "",
        description="why the fit is a failure although its search ended, in words, so that its estimates have no "
        "intervals; empty for others, absent in earlier documents",
    )
    notices: list[str] = Field(
        default_factory=list, description="sentences that come before all others, such as that nothing transforms"
    )
    warnings: list[str] = Field(description="warnings as sentences")
    implausible: list[ImplausibleEntry] = Field(
        default_factory=list,
        description="fitted parameters outside of what an alloy can have, also among the warnings; absent in earlier "
        "documents",
    )
    input_noise: list[InputNoiseEntry] = Field(
        default_factory=list,
        description="noise of the electrical inputs, which estimates and intervals contain; empty where they are taken "
        "as exact on request, or there are none; absent in earlier documents",
    )
    seed: int = Field(description="seed of all random numbers")
    smajax: str = Field(description="version of smajax that computed the result")

    @model_validator(mode="after")
    def _check_names(self) -> Self:
        if self.rmse.keys() != self.noise_floor.keys():
            raise ValueError("rmse and noise_floor have different channels")
        if unknown := self.profiles.keys() - self.parameters.keys():
            raise ValueError(f"profiles.{min(unknown)} is none of the parameters")
        return self
