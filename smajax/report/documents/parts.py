"""Parts that several documents share."""

from typing import Literal

from pydantic import Field

from smajax.report.documents.base import Ends, Number, Part

Stage = Literal["drive", "heat", "material", "mechanism", "sensor"]


class RecordingEntry(Part):
    """A recording that the result depends on."""

    name: str = Field(description="file name")
    sha256: str = Field(description="SHA-256 of the file; empty for a recording that is not from a file")
    rows: int = Field(ge=0, description="number of rows")
    role: Literal["train", "select", "holdout", "simulation"] = Field(description="what it was used for")
    notes: list[str] = Field(description="repairs and assumptions when it was read")


class BenchEntry(Part):
    """What recordings show about their bench: a clock, a unit, a sign or an offset that is not the rig's."""

    code: Literal["offset", "sign", "unit", "input", "clock"] = Field(description="what is doubtful")
    channel: str = Field(description="channel that it is about; time for the clock")
    recordings: list[str] = Field(description="names of the recordings that show it")
    text: str = Field(description="the finding and its cure in a sentence")


class ChannelValue(Part):
    """A value of a channel."""

    value: Number = Field(description="the value, in the unit")
    unit: str = Field(description="unit of the recording's column; K for temperatures")


class NoiseEntry(Part):
    """The noise of a channel."""

    value: Number = Field(description="standard deviation, in the unit")
    unit: str = Field(description="unit of the recording's column; K for temperatures")
    source: str = Field(
        alias="from",
        description="where it comes from: rest, residual differences or rounding (of the recordings), or the rig file",
    )


class ImplausibleEntry(Part):
    """A fitted parameter outside of what an alloy can have."""

    code: Literal["implausible"] = Field(description="code of the warning")
    name: str = Field(description="name of the parameter; material.hysteresis is that of the fitted temperatures")
    value: Number = Field(description="the estimate, in the unit")
    unit: str = Field(description="declared unit")
    plausible: Ends = Field(description="smallest and largest value that an alloy can have, in the unit")
    source: str = Field(description="source of the range, with keys of docs/references.bib")
    text: str = Field(description="the same in a sentence")


class Margins(Part):
    """Stability margins of the loop linearised along its rollout; medians over the rollout for a nonlinear plant."""

    gain: Number = Field(description="gain margin, a factor; null if there is none")
    phase: Number = Field(description="phase margin, degrees; null if there is none")
    sensitivity: Number = Field(description="largest magnitude of the sensitivity, a factor")
