"""``compare.json``, the document of ``smajax compare``."""

from typing import Any, ClassVar, Literal, Self

from pydantic import Field, model_validator

from smajax.report.documents.base import Document, Number, Part
from smajax.report.documents.parts import RecordingEntry

# A number, or the nested lists of an array.
_Array = Number | list[Any]


class FittedEntry(Part):
    """A fitted parameter of a model, or an array of them."""

    value: _Array = Field(description="value or array of values, in the unit")
    lower95: _Array = Field(description="lower end of the 95 % interval, of the same shape; null for none")
    upper95: _Array = Field(description="upper end of the 95 % interval, of the same shape; null for none")
    free: bool = Field(description="whether it was fitted")
    unit: str | None = Field(None, description="unit; absent for input-output models: SI, degC, times in s")


class ModelEntry(Part):
    """The result of one model."""

    name: str = Field(description="name of the model")
    kind: Literal["law", "input-output"] = Field(description="material law of the plant, or input-output model")
    why: str = Field(description="why it could not be fitted; empty if it was")
    note: str = Field(description="how the recordings were changed for it, and what limits its prediction")
    at_bound: list[str] = Field(description="parameters whose estimates are at a bound, with that bound")
    undetermined: list[str] = Field(description="parameters that the training recording does not determine")
    parameters: int = Field(ge=0, description="number of free parameters")
    rmse_train: Number = Field(description="error on the training recording, in the document's unit")
    rmse_holdout: Number = Field(description="error on the holdout, in the document's unit")
    bic: Number = Field(description="Bayesian information criterion on the training recording")
    fitted: dict[str, FittedEntry] = Field(description="parameters by name")
    fit_percent_train: Number = Field(
        description="fit on the training recording, 100 (1 - |y - model| / |y - mean|) in percent"
    )
    fit_percent_holdout: Number = Field(description="the same on the holdout")
    wall_s: float = Field(description="wall time of the fit, s")


class CompareDocument(Document):
    """Result of a comparison: models ranked by their error on the holdout, best first. Missing values are null."""

    # Parameter names changed with schema 2; the keys are those of schema 1.
    SCHEMA: ClassVar[str] = "smajax.compare/2"
    EARLIER: ClassVar[tuple[str, ...]] = ("smajax.compare/1",)

    schema_name: Literal["smajax.compare/2"] = Field(alias="schema", description="name and version of the schema")
    rig: str = Field(description="file name of the rig")
    channel: str = Field(description="the channel that is compared")
    not_compared: list[str] = Field(description="observed channels that are not compared")
    unit: str = Field(description="unit of the errors: that of the recording's column; K for temperatures")
    summary: str = Field(description="the result in sentences")
    models: list[ModelEntry] = Field(min_length=1, description="the models, best first, those left out at the end")
    recordings: list[RecordingEntry] = Field(min_length=2, max_length=2, description="training recording and holdout")
    seed: int = Field(description="seed of all random numbers")
    smajax: str = Field(description="version of smajax that computed the result")

    @model_validator(mode="after")
    def _check_order(self) -> Self:
        errors = [model.rmse_holdout for model in self.models]
        order = sorted(errors, key=lambda error: (error is None, error))
        if errors != order:
            raise ValueError("models are not in the order of rmse_holdout")
        return self
