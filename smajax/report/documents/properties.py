"""``properties.json``, the document that ``smajax properties --json`` prints."""

from typing import ClassVar, Literal, Self

from pydantic import Field, model_validator

from smajax.report.documents.base import Document, Part, Rows


class PropertyEntry(Part):
    """A property with its 95 % interval."""

    value: float = Field(description="estimate, in the unit")
    lower95: float = Field(description="lower end of the 95 % interval, in the unit")
    upper95: float = Field(description="upper end of the 95 % interval, in the unit")
    unit: Literal["degC", "K", "1"] = Field(description="degC for temperatures, K for differences, 1 for strains")

    @property
    def interval(self) -> tuple[float, float]:
        """The ends of the 95 % interval, in ``unit``."""
        return self.lower95, self.upper95


class CycleEntry(Part):
    """One thermal cycle."""

    number: int = Field(ge=1, description="number of the cycle in its recording, from 1")
    rows: Rows = Field(description="first and last row, from 1")
    loops_left_out: list[Rows] = Field(description="first and last rows of minor loops, which are left out")
    values: dict[str, PropertyEntry] = Field(description="properties of the cycle by name")


class BranchEntry(Part):
    """A branch without a partner."""

    rows: Rows = Field(description="first and last row, from 1")
    branch: Literal["cooling", "heating"] = Field(description="direction of the temperature")


class GroupEntry(Part):
    """The cycles of a recording at one stress."""

    name: str = Field(description="name of the recording")
    sha256: str = Field(description="SHA-256 of its file")
    stress_Pa: float | None = Field(description="stress, Pa; null if it was not recorded")
    smoothed_rows: int = Field(ge=1, description="rows of the running median of the temperatures; 1 for none")
    mean: dict[str, PropertyEntry] | None = Field(description="means over the cycles by name; null without any cycle")
    cycles: list[CycleEntry] = Field(description="the cycles")
    in_no_cycle: list[BranchEntry] = Field(description="branches without a partner, which are left out")
    notes: list[str] = Field([], description="sentences on how the file was read, such as sheets that were left out")

    @model_validator(mode="after")
    def _check_mean(self) -> Self:
        if (self.mean is None) == bool(self.cycles):
            raise ValueError("mean belongs to recordings with cycles, and only to these")
        return self


class PropertiesDocument(Document):
    """Properties of thermal cycles after ASTM E3097."""

    SCHEMA: ClassVar[str] = "smajax.properties/1"

    schema_name: Literal["smajax.properties/1"] = Field(alias="schema", description="name and version of the schema")
    tangent: Literal["lines", "steepest"] = Field(description="line along the transformation")
    definition: str = Field(description="definition of start and finish in words")
    recordings: list[GroupEntry] = Field(description="cycles by recording and stress")
    refused: list[str] = Field(description="sentences on cycles that could not be analysed")
    refused_merged: list[str] = Field(
        [], description="the same, one sentence for all cycles with one reason; absent in earlier documents"
    )
    smajax: str = Field(description="version of smajax that computed the result")
    guessed: str | None = Field(
        None, description="which values of the written parameter set do not come from the cycles; absent without one"
    )
