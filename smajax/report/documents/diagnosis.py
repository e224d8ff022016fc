"""``diagnosis.json``, the document of ``smajax diagnose``."""

from typing import ClassVar, Literal, Self

from pydantic import Field, model_validator

from smajax.report.documents.base import Document, Ends, Number, Part
from smajax.report.documents.parts import BenchEntry, ImplausibleEntry, NoiseEntry, RecordingEntry, Stage

RejectionCode = Literal[
    "chance",
    "selection",
    "noise",
    "part-of-excess",
    "implausible",
    "zero",
    "unneeded",
    "swapped",
    "little-explained",
    "law",
    "holdout",
]
_ROLES = ["train", "select", "holdout"]
# Effects that stand for cells and grains among the effects.
STRUCTURE_KEYS = ("end-conduction", "gradual-transformation")


class ErrorEntry(Part):
    """Root mean square errors of a channel before and after effects were added, in the unit."""

    unit: str = Field(description="unit of the recording's column; K for temperatures")
    train_before: Number = Field(description="on the training recording, without further effects")
    train_after: Number = Field(description="on the training recording, with the accepted effects")
    select_before: Number = Field(description="on the selection recording, without further effects")
    select_after: Number = Field(description="on the selection recording, with the accepted effects")
    holdout_before: Number = Field(description="on the holdout, without further effects")
    holdout_after: Number = Field(description="on the holdout, with the accepted effects")
    holdout_cut_95: Ends = Field(
        description="95 % interval of the reduction on the holdout, on the rows that holdout.interval_of names"
    )


class LeftOutEntry(Part):
    """A recorded channel, or an effect of the rig file, that the diagnosis did not use."""

    channel: str | None = Field(None, description="the channel; absent for an effect")
    effect: str | None = Field(None, description="key of an effect that this rig cannot have; absent for a channel")
    why: str = Field(description="the reason")

    @model_validator(mode="after")
    def _check_subject(self) -> Self:
        if (self.channel is None) == (self.effect is None):
            raise ValueError("needs either a channel or an effect")
        return self


class FailureEntry(Part):
    """A prediction that failed, or has states that no wire has; its errors are null."""

    recording: str = Field(description="name of the recording")
    when: Literal["before", "after"] = Field(description="before or after effects were added")
    code: str = Field(description="code of the failure, such as overheated or overstrained")
    text: str = Field(description="meaning and cure")


class GoodnessOfFit(Part):
    """Reduced chi-squared of the residual: its mean square relative to that of the noise."""

    before: Number = Field(description="without further effects")
    after: Number = Field(description="with the accepted effects")
    critical: Number = Field(description="value up to which the residual counts as noise")


class DetectabilityEntry(Part):
    """What the training input can show of an effect."""

    key: str = Field(description="key of the effect")
    stage: Stage = Field(description="stage of the plant to which it belongs")
    status: Literal["testable", "absorbed", "blind"] = Field(
        description="testable; absorbed by free parameters; or blind: without a visible response"
    )
    smallest_detectable: Number = Field(description="smallest strength that can be detected, in the unit")
    unit: str = Field(description="unit of the strength")
    absorbed_by: list[str] = Field(description="parameters and effects that can imitate it")
    why: str = Field(description="the reason, if it cannot be tested; else empty")


class RankingEntry(DetectabilityEntry):
    """An effect of the catalogue with its evidence."""

    strength: Number = Field(description="estimated strength, in the unit")
    lower95: Number = Field(description="lower end of the strength's 95 % interval, in the unit")
    upper95: Number = Field(description="upper end of the strength's 95 % interval, in the unit")
    statistic: Number = Field(description="score statistic in the first round")
    p_value: Number = Field(
        description="probability that noise with the autocorrelation of the residual gives any effect a statistic at "
        "least as large"
    )
    refit_rmse_select: Number = Field(
        description="error on the selection recording after a refit with the effect, in the unit of the first channel; "
        "null if there was no complete refit"
    )


class RejectedEntry(Part):
    """An effect that was tried and rejected."""

    key: str = Field(description="key of the effect")
    code: RejectionCode | None = Field(None, description="code of the reason; absent in earlier documents")
    why: str = Field(description="the reason")


class StructureEntry(Part):
    """Structure of the wire: cells along it and grains in them."""

    variant: Literal["neither", "cells", "grains", "both"] = Field(description="what the wire needs")
    cells: int = Field(ge=1, description="number of cells; 1 for a wire of one temperature")
    grains: int = Field(
        ge=1, description="number of grains in each cell, 1 without; with cells alone their spreads are 0"
    )
    select_error_over_noise: dict[Literal["neither", "cells", "grains", "both"], Number] = Field(
        description="error on the selection recording relative to the noise, by variant, with the same effects; empty "
        "if the structure was not fitted, since the fit is near the noise or the rig file has cells or grains"
    )
    jointly: bool = Field(
        False,
        description="whether fits to training and selection recording together decided, and the errors are theirs: the "
        "training recording alone does not determine the structure",
    )


class LawEntry(Part):
    """Comparison of the rig's material law with the other laws on the selection recording."""

    own: str = Field(description="law of the rig; empty if it is not registered")
    better: str | None = Field(
        description="the best law, if it predicts the selection recording better than that of the rig does without "
        "effects, by at least 10 % and by more than chance"
    )
    cause: Literal["none", "law", "effect", "either", "part"] = Field(
        description="none: no law is better; law: the better one explains most of the excess, and more than effects "
        "do; effect: effects next to the rig's law explain more; either: the recordings do not distinguish these; "
        "part: the better law explains a small part only"
    )
    select_error_over_noise: dict[str, Number] = Field(
        description="error on the selection recording relative to the noise, by law, each without further effects; "
        "null where the fit or the prediction fails"
    )
    error_with_effects_over_noise: Number = Field(
        description="the same for the rig's law with the effects and the structure that were found first"
    )
    cut_95_over_noise: Ends | None = Field(
        description="95 % interval of the fall of the error by the better law, relative to the noise; null without one"
    )
    skipped: dict[str, str] = Field(description="laws that cannot be fitted, and why")


class SupportEntry(Part):
    """Evidence of an effect on the selection recording."""

    key: str = Field(description="key of the effect")
    explains: Number = Field(description="share of the excess mean square over the noise, without it, from 0 to 1")
    cut_95_over_noise: Ends = Field(
        description="95 % interval of the fall of the error, relative to the noise; null if there is no prediction "
        "without it"
    )


class SplitErrors(Part):
    """Errors of a channel on the three recordings, in the unit."""

    train: Number = Field(description="on the training recording")
    select: Number = Field(description="on the selection recording")
    holdout: Number = Field(description="on the holdout")


class BudgetChannel(SplitErrors):
    """Errors of a channel by one model."""

    unit: str = Field(description="unit of the recording's column; K for temperatures")
    holdout_cut_95: Ends | None = Field(
        description="95 % interval of the fall of the error from the model before, on the second half of the holdout, "
        "which had no part in any choice; null for the first two models"
    )
    cut_if_last: SplitErrors | None = Field(
        description="fall of the error if this is added last; null for the first two models"
    )


class BudgetEntry(Part):
    """Errors of one model, each with one thing more than the one before."""

    added: str = Field(
        description="naive: the mean of the training recording; base: the model of the rig file; structure: cells and "
        "grains; else the key of an effect"
    )
    channels: dict[str, BudgetChannel] = Field(description="errors by channel")


class HoldoutEntry(Part):
    """Part of the holdout in the choice of the effects."""

    decided: bool = Field(
        description="whether the holdout had a part in the choice, so that the errors on it are after selection"
    )
    removed: list[str] = Field(description="keys of the effects that it removed")
    decided_by: Literal["first half"] | None = Field(
        None,
        description="rows of the holdout that had a part in the choice; null if none had, absent in earlier documents",
    )
    interval_of: Literal["second half", "all rows"] | None = Field(
        None, description="rows of the holdout that rmse.holdout_cut_95 is of; absent in earlier documents"
    )


class EffectParameterEntry(Part):
    """A fitted parameter of an accepted effect, in its internal unit."""

    name: str = Field(description="name of the parameter")
    value: Number = Field(description="estimate")
    unit: str = Field(description="internal unit")
    meaning: str = Field(description="meaning of the parameter")
    lower95: Number = Field(description="lower end of the 95 % interval; null if the recordings do not determine it")
    upper95: Number = Field(description="upper end of the 95 % interval; null if the recordings do not determine it")
    plausible: Ends | None = Field(None, description="plausible range; absent in earlier documents, null ends for none")


class ExcludedEntry(Part):
    """An effect without any trace in the last fit's residual."""

    key: str = Field(description="key of the effect")
    above: Number = Field(description="strength above which it is excluded, in the unit")
    unit: str = Field(description="unit of the strength")


class ResidualEntry(Part):
    """Statistics of the residual of a channel, measured minus model, on the training recording."""

    rms: Number = Field(description="root mean square, in the unit of the recording's column")
    band_99: Number = Field(description="half width of the 99 % band of the correlations of white noise")
    autocorrelation: list[Number] = Field(description="autocorrelation at lags of 1, 2, ... samples")
    cross_correlation: dict[str, list[Number]] = Field(description="correlation with each input, lag by lag")
    outside: dict[str, Number] = Field(description="share of the lags outside the 99 % band, by name of the other")


class ResidualPair(Part):
    """Statistics of the residual before and after."""

    before: ResidualEntry = Field(description="without further effects")
    after: ResidualEntry = Field(description="with the accepted effects")


class NonparametricEntry(Part):
    """A nonparametric term that would explain a part of the residual; not its cause."""

    stage: Stage = Field(description="stage of the plant to which it adds")
    adds: str = Field(description="what it adds: heat, shift or strain")
    unit: str = Field(description="unit of the term")
    against: str = Field(description="the state of which it is a function, such as temperature or martensite")
    at: list[Number] = Field(description="values of that state")
    term: list[Number] = Field(description="values of the term there, in the unit")
    explains: Number = Field(description="share of the residual that it explains, from 0 to 1")
    select_error_over_noise: Number = Field(description="error on the selection recording relative to the noise")
    note: str = Field(description="how to read it")


class NextExperimentEntry(Part):
    """An input that distinguishes the effects that remain possible."""

    file: str | None = Field(description="file with the input in the result folder; null if there is none")
    separates: list[str] = Field(description="keys of the effects that it distinguishes")
    sigma: Number = Field(description="expected difference of their responses in standard deviations")
    advice: str = Field(description="what to run, as a clause")


class DiagnosisDocument(Document):
    """Result of a diagnosis.

    Errors and noise are in the unit of the recording's column, strengths in the unit of the effect. Missing values are
    null.
    """

    # Schema 2 has the keys of schema 1, under which material.max_transformation_strain was called material.max_strain.
    SCHEMA: ClassVar[str] = "smajax.diagnosis/2"
    EARLIER: ClassVar[tuple[str, ...]] = ("smajax.diagnosis/1",)

    schema_name: Literal["smajax.diagnosis/2"] = Field(alias="schema", description="name and version of the schema")
    bench: list[BenchEntry] = Field(
        [], description="what the recordings show about their bench; absent in earlier documents"
    )
    verdict: Literal["named", "named-up-to-class", "partial", "unresolved", "nothing-missing"] = Field(
        description="whether effects explain the residual"
    )
    effects: list[str] = Field(description="keys of the accepted effects, in order")
    equivalent: dict[str, list[str]] = Field(
        description="by accepted effect: the effects from which the recordings cannot distinguish it"
    )
    structure: StructureEntry | None = Field(
        None, description="structure of the wire, which the effects name as well; absent in earlier documents"
    )
    support: list[SupportEntry] = Field(
        [], description="evidence for the accepted effects; absent in earlier documents"
    )
    candidates: list[SupportEntry] = Field(
        [],
        description="effects that explain a part only, so that the rig may have them; absent in earlier documents",
    )
    law: LawEntry | None = Field(
        None,
        description="comparison with other material laws; null where it was not asked for, absent in earlier documents",
    )
    unresolved_stage: Stage | None = Field(description="stage that the remaining residual looks most like")
    interrupted: bool = Field(False, description="whether the diagnosis was stopped before its end")
    summary: str = Field(description="the result in sentences")
    rmse: dict[str, ErrorEntry] = Field(description="errors by channel")
    error_budget: list[BudgetEntry] = Field(
        [],
        description="errors by what was added to the model, each fitted to training and selection recording; empty if "
        "the diagnosis was stopped before, absent in earlier documents",
    )
    holdout: HoldoutEntry | None = Field(
        None, description="part of the holdout in the choice of the effects; absent in earlier documents"
    )
    effect_parameters: list[EffectParameterEntry] = Field(
        [], description="all fitted parameters of the accepted effects; absent in earlier documents"
    )
    failures: list[FailureEntry] = Field(
        [], description="predictions that failed or that no wire has; absent in earlier documents"
    )
    implausible: list[ImplausibleEntry] = Field(
        [], description="fitted parameters outside of what an alloy can have; absent in earlier documents"
    )
    evidence: list[str] = Field(
        description="auxiliary channels: recorded, not observed, and explained up to gain and offset of their sensors"
    )
    recordings: list[RecordingEntry] = Field(description="training, selection and holdout recording, in this order")
    left_out: list[LeftOutEntry] = Field(description="recorded channels and effects that were not used")
    noise_floor: dict[str, NoiseEntry] = Field(description="noise by channel")
    base_fit_at_rest: bool = Field(description="whether the fit without further effects converged")
    rising_convection: list[str] = Field(
        [],
        description="coefficients of h(T) that were bounded at 0, since the fit without this overheats with the input "
        "of another recording; absent in earlier documents",
    )
    goodness_of_fit: GoodnessOfFit = Field(description="reduced chi-squared before and after")
    stages: dict[Stage, Number] = Field(description="share of the residual that each stage can explain, from 0 to 1")
    ranking: list[RankingEntry] = Field(description="all effects: accepted ones first, then by their statistic")
    rejected: list[RejectedEntry] = Field(description="effects that were tried and rejected")
    excluded: list[ExcludedEntry] = Field(description="effects without any trace in the last fit's residual")
    preflight: list[DetectabilityEntry] = Field(
        description="what the training input can show at the rig's own values, before any fit"
    )
    residual: dict[str, ResidualPair] = Field(description="statistics of the residual by channel")
    free_form: NonparametricEntry | None = Field(description="nonparametric term; null if there is none")
    next_experiment: NextExperimentEntry | None = Field(description="input to run next; null if there is none")
    simulations: int = Field(ge=0, description="number of simulations")
    wall_s: float = Field(description="wall time, s")
    seed: int = Field(description="seed of all random numbers")
    smajax: str = Field(description="version of smajax that computed the result")

    @model_validator(mode="after")
    def _check_names(self) -> Self:
        # The first documents of schema 1 had no recordings.
        if self.recordings and [recording.role for recording in self.recordings] != _ROLES:
            raise ValueError("recordings need the roles train, select and holdout, in this order")
        if self.rmse.keys() != self.noise_floor.keys():
            raise ValueError("rmse and noise_floor have different channels")
        if unranked := set(self.effects) - {entry.key for entry in self.ranking} - set(STRUCTURE_KEYS):
            raise ValueError(f"effects: {min(unranked)} is not in the ranking")
        if unknown := self.equivalent.keys() - set(self.effects):
            raise ValueError(f"equivalent.{min(unknown)} is none of the effects")
        return self
