"""``sweep.json``, the document of ``smajax sweep``."""

from typing import ClassVar, Literal, Self

from pydantic import Field, model_validator

from smajax.report.documents.base import Document, Ends, Number, Part

# A metric: "inf" and "-inf" for infinities, null for NaN.
Metric = float | Literal["inf", "-inf"] | None


class AxisEntry(Part):
    """A parameter of the sweep."""

    unit: str = Field(description="unit: SI, degC for temperatures")
    lower: float = Field(alias="from", description="lower end, in the unit")
    upper: float = Field(alias="to", description="upper end, in the unit")
    scale: Literal["log", "even"] = Field(description="whether the designs are even in the logarithm or in the value")
    values: list[float] = Field(description="values of a list, in the unit; empty for a range")
    labels: list[str] | None = Field(None, description="names of the values, which are then their indices")
    catalogue: str | None = Field(None, description="wire whose stock diameters the values are")


class MetricEntry(Part):
    """Range of a metric over all designs."""

    unit: str = Field(description="unit: SI, degC for temperatures")
    lowest: Metric = Field(description="lowest value, in the unit; null if no design has one")
    highest: Metric = Field(description="highest value, in the unit; null if no design has one")


class ConstraintEntry(Part):
    """Range that a metric is required to have, in its unit."""

    at_least: Number = Field(description="lower end; null for none")
    at_most: Number = Field(description="upper end; null for none")
    excludes: int | None = Field(None, ge=0, description="number of simulated designs that violate it")
    excludes_alone: int | None = Field(None, ge=0, description="number of these that violate no other constraint")


class LimitEntry(Part):
    """Limit of the material, which holds as a constraint."""

    at_most: float = Field(description="upper end of the metric, in its unit")
    cycles: float | None = Field(description="number of cycles that a wire bears at this stress; null for others")
    parameter_set: str = Field(description="parameter set of the limit")
    source: str = Field(description="where it comes from")


class MarginEntry(Part):
    """Deviations for which the constraints hold."""

    metrics: list[str] = Field(description="metrics with margin, which the constraints bound")
    vary: dict[str, float] = Field(description="half widths of ranges by parameter, in its unit")
    units: dict[str, str] = Field(description="units of these half widths")
    fit: str = Field(description="folder of the fit whose intervals count; empty for none")


class DesignEntry(Part):
    """A design of the Pareto front."""

    design: int = Field(ge=0, description="its number in the table")
    parameters: dict[str, float] = Field(description="parameters by name, in their units")
    metrics: dict[str, Metric] = Field(description="metrics by name, in their units")


class RefinedEntry(Part):
    """A design that was refined by gradients."""

    parameters: dict[str, float] = Field(description="parameters after the refinement, in their units")
    before: dict[str, Metric] = Field(description="metrics before it, in their units")
    metrics: dict[str, Metric] = Field(description="metrics after it, in their units")
    simulations: int = Field(ge=0, description="number of simulations")
    better: bool = Field(description="whether it satisfies all constraints and is better than before")
    rescued: bool = Field(description="whether it violated a constraint before and satisfies all after")
    command: str | None = Field(None, description="command that shows its metrics, in the result folder")


class SettlingEntry(Part):
    """Numbers of designs whose last cycle does not end where it began; empty for an actuator without cycles."""

    limit: float | None = Field(None, description="largest gap of a settled cycle, as a share of its range")
    unsettled: int | None = Field(None, ge=0, description="number of designs that have not settled")
    unsettled_on_front: int | None = Field(None, ge=0, description="number of these on the front")
    unsettled_refined: int | None = Field(None, ge=0, description="number of refined designs that have not settled")


class SobolEntry(Part):
    """Sobol indices of a metric and a parameter: shares of the metric's variance."""

    first: Number = Field(description="first-order index")
    first95: Ends = Field(description="95 % interval of the first-order index")
    total: Number = Field(description="total index")
    total95: Ends = Field(description="95 % interval of the total index")


class SweepDocument(Document):
    """Result of a sweep, in SI units and degC. Missing values are null, infinite metrics "inf" or "-inf"."""

    # Schema 2 has the parameter names of smajax 0.2; all else is as in schema 1.
    SCHEMA: ClassVar[str] = "smajax.sweep/2"
    EARLIER: ClassVar[tuple[str, ...]] = ("smajax.sweep/1",)

    schema_name: Literal["smajax.sweep/2"] = Field(alias="schema", description="name and version of the schema")
    sweep: str = Field(description="file name of the sweep")
    rig: str = Field(description="file name of the rig or actuator")
    sampling: str = Field(description="how the designs were drawn")
    designs: int = Field(ge=0, description="number of designs")
    codes: dict[str, int] = Field(description="number of designs by the code of their simulation")
    feasible: int = Field(ge=0, description="number of designs that satisfy all constraints")
    parameters: dict[str, AxisEntry] = Field(description="parameters of the sweep by name")
    metrics: dict[str, MetricEntry] = Field(description="ranges of the metrics by name")
    objectives: dict[str, Literal["min", "max"]] = Field(description="metrics to minimise or maximise")
    constraints: dict[str, ConstraintEntry] = Field(description="required ranges of metrics by name")
    limits: dict[str, LimitEntry] | None = Field(None, description="limits of the material by metric; empty for none")
    margins: MarginEntry | None = Field(None, description="margins of the constraints; missing for none")
    front: list[DesignEntry] = Field(description="designs of the Pareto front; up to 200 of them, the table has all")
    on_front: int = Field(ge=0, description="number of designs on the Pareto front")
    settling: SettlingEntry = Field(description="designs that have not settled; empty for an actuator")
    sensitivity: dict[str, dict[str, SobolEntry]] = Field(description="Sobol indices by metric and parameter")
    sensitivity_notes: list[str] = Field(description="sentences on missing rows and indices")
    refined: list[RefinedEntry] = Field(description="refined designs")
    problems: list[str] = Field(description="reasons why there is no usable design, as clauses")
    seed: int = Field(description="seed of all random numbers")
    smajax: str = Field(description="version of smajax that computed the result")
    purchase: str | None = Field(None, description="what to buy for the best design, in words")
    summary: str = Field(description="the result in sentences")

    @model_validator(mode="after")
    def _check_names(self) -> Self:
        for key in ("objectives", "constraints"):
            if unknown := getattr(self, key).keys() - self.metrics.keys():
                raise ValueError(f"{key}.{min(unknown)} is none of the metrics")
        if sum(self.codes.values()) != self.designs:
            raise ValueError("codes do not add up to the number of designs")
        return self
