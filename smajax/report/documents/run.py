"""``run.json``: how a result folder was made; for a simulation it is the result document."""

from typing import ClassVar, Literal

from pydantic import Field

from smajax.report.documents.base import Document, Number, Part
from smajax.report.documents.parts import RecordingEntry


class _RunHead(Document):
    """The keys of every command."""

    SCHEMA: ClassVar[str] = "smajax.run/1"

    schema_name: Literal["smajax.run/1"] = Field(alias="schema", description="name and version of the schema")
    command: Literal["fit", "diagnose", "compare", "tune", "sweep", "simulate", "properties"] = Field(
        description="the command"
    )
    argv: list[str] = Field(description="the command line; empty if the library was called from Python")
    rig: str = Field(description="file name of the rig or actuator; empty for properties")
    started: str = Field(description="start of the run, ISO 8601 in UTC")
    exit_code: int = Field(description="exit code: 0 done, 3 failed numerics, 130 interrupted")
    seed: int | None = Field(description="seed of all random numbers; null if there are none")
    versions: dict[str, str] = Field(description="versions of smajax, Python and the packages that compute")
    machine: str = Field(description="operating system, architecture and device")
    timings: dict[str, float] = Field(description="wall time of each part, s")


class RunDocument(_RunHead):
    """Record of a run."""

    code: str | None = Field(None, description="fit: how the search ended")
    text: str | None = Field(None, description="fit: the same as a sentence")
    inputs: list[str] | None = Field(None, description="compare and diagnose: channels that drive the plant")
    controller: str | None = Field(None, description="tune: file name of the controller")
    sweep: str | None = Field(None, description="sweep: file name of the sweep")
    header: str | None = Field(None, description="sweep: hash that identifies the sweep")
    reason: str | None = Field(None, description="why the study did not succeed; missing if it did")
    files: list[str] = Field(description="the files of the folder")


class RangeEntry(Part):
    """Range of a simulated channel."""

    lowest: Number = Field(description="lowest value, in the unit")
    highest: Number = Field(description="highest value, in the unit")
    unit: str = Field(description="unit of the column of simulation.csv")


class CycleMetricEntry(Part):
    """Metric of the last cycle of a simulation."""

    value: Number = Field(description="value, in the unit")
    unit: str = Field(description="unit: SI, degC for temperatures")


class SimulationDocument(_RunHead):
    """``run.json`` of ``smajax simulate``: record of the run, and ranges of the simulated channels."""

    command: Literal["simulate"] = Field(description="the command")
    code: str = Field(description="how the simulation ended: done, or the code of the failure")
    text: str = Field(description="the same as a sentence")
    inputs: list[str] = Field(description="channels that drive the plant")
    observed: list[str] = Field(description="observed channels of the rig")
    channels: dict[str, RangeEntry] = Field(description="ranges of the simulated channels by name")
    recordings: list[RecordingEntry] = Field(min_length=1, description="the recording of the inputs")
    warnings: list[str] = Field(description="warnings as sentences")
    metrics: dict[str, CycleMetricEntry] | None = Field(
        None, description="metrics of a sweep over the last cycle, by name; missing without a number of cycles"
    )
    files: list[str] = Field(description="the files of the folder")
