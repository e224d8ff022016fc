"""Sections of SWEEP.toml and their keys, as pydantic models; the examples are shown in error messages.

Nothing here needs JAX, so that a mistake is reported before it is loaded.
"""

from collections.abc import Mapping
from typing import Annotated, Any

from pydantic import BaseModel, Field

from smajax.arguments import MAX_SEED
from smajax.channels import CHANNELS
from smajax.errors import InputError
from smajax.files.toml import STRICT, advice, check_schema, validate
from smajax.files.validators import one_of
from smajax.parameters.definitions import Declaration

SECTIONS = ("schema", "sweep", "parameters", "input", "objectives", "constraints", "margins", "refine")
# Prefix of the names of axes that vary the input instead of the rig.
INPUT = "input."
SAMPLINGS = ("grid", "latin-hypercube", "sobol")
# Points of a range on a grid where the file gives no number: two ends and the quarters between them.
DEFAULT_POINTS = 5
SHAPES = ("square", "sine", "triangle")
SCALES = ("even", "log")
# Range of an input's frequency in Hz, far wider than any that a wire can follow.
MIN_FREQUENCY = 1e-6
MAX_FREQUENCY = 1e4
# Largest number of designs: a table of so many still fits into the memory of a computer.
MAX_DESIGNS = 100_000_000
# Number of designs in a chunk if the file gives none. Chosen by trial.
DEFAULT_CHUNK = 1024
# Number of cycles that a wire is to last where the sweep does not say: that of the only stress with a source.
DEFAULT_LIFE = 1e6


class SweepSection(BaseModel):
    """The section ``[sweep]``."""

    model_config = STRICT
    rig: str = Field(examples=['"rig.toml"'], description="rig or actuator file, relative to the sweep file")
    sampling: Annotated[str, one_of(SAMPLINGS)] = Field("sobol", description="how designs are drawn")
    designs: int = Field(
        1024,
        ge=1,
        le=MAX_DESIGNS,
        examples=["1024"],
        description="number of designs; a grid has the product of its points",
    )
    seed: int = Field(0, ge=0, le=MAX_SEED, examples=["0"], description="seed of all random numbers")
    chunk: int = Field(
        DEFAULT_CHUNK, ge=1, le=1_000_000, examples=["1024"], description="designs that are simulated at once"
    )
    metrics: list[str] | None = Field(
        None, examples=['["stroke", "efficiency"]'], description="metrics of the table; by default all"
    )
    gradients: bool = Field(
        False, examples=["true"], description="whether the table has the derivatives of the metrics"
    )
    sensitivity: bool | None = Field(
        None,
        examples=["false"],
        description="whether Sobol indices are estimated; by default where the designs suffice",
    )
    limits: str | None = Field(
        None, examples=['"none"'], description="parameter set whose limits of the material hold, or none"
    )
    life: float = Field(
        DEFAULT_LIFE,
        gt=0.0,
        examples=["1_000_000"],
        description="number of cycles that the wire is to last, for the limit of the stress",
    )


class RefineSection(BaseModel):
    """The section ``[refine]``."""

    model_config = STRICT
    starts: int = Field(
        3, ge=1, le=1000, examples=["3"], description="best designs that are refined along the gradients of the metrics"
    )


class Range(BaseModel):
    """The keys of a parameter that varies."""

    model_config = STRICT
    from_: Any = Field(None, alias="from", examples=['"0.1 mm"'], description="lower end of the range")
    to: Any = Field(None, examples=['"0.4 mm"'], description="upper end of the range")
    scale: Annotated[str, one_of(SCALES)] = Field(
        "even", description="whether values are spread evenly over the range, or over its logarithm"
    )
    points: int = Field(DEFAULT_POINTS, ge=2, le=100_000, examples=["5"], description="values of a grid")
    values: list[Any] | None = Field(
        None, max_length=100_000, examples=['["0.1 mm", "0.2 mm"]'], description="values in place of a range"
    )
    catalogue: str | None = Field(
        None, examples=['"flexinol"'], description="parameter set whose stock diameters are taken, for wire.diameter"
    )


class InputSection(BaseModel):
    """The section, checked without the rig."""

    model_config = STRICT
    shape: Annotated[str, one_of(SHAPES)] | None = Field(
        None, alias="wave", examples=['"square"'], description="shape of the periodic input"
    )
    amplitude: Any = Field(None, examples=['"0.4 A"'], description="height of the wave above the offset")
    offset: Any = Field(None, examples=['"0.05 A"'], description="value to which the wave is added")
    frequency: Any = Field(None, examples=['"0.1 Hz"'], description="frequency of the wave")
    highest: Any = Field(
        default=None, examples=['"10 Hz"'], description="highest frequency at which a bandwidth is looked for"
    )
    duty: Any = Field(None, examples=["0.5"], description="share of a cycle in which a square wave is on")
    cycles: int | None = Field(
        None,
        ge=1,
        le=10_000,
        examples=["4"],
        description="number of cycles that are simulated; the metrics are those of the last",
    )
    recording: str | None = Field(None, examples=['"input.csv"'], description="recording in place of a wave")


class Limit(BaseModel):
    """The keys of a constraint."""

    model_config = STRICT
    at_least: Any = Field(None, examples=['"5 mm"'], description="smallest value of the metric")
    at_most: Any = Field(None, examples=['"120 degC"'], description="largest value of the metric")


class MarginSection(BaseModel):
    """The section ``[margins]``."""

    model_config = STRICT
    vary: dict[str, Any] = Field(
        {},
        examples=['{ "environment.ambient" = "3 K" }'],
        description="half widths of ranges around the values of the rig or the design",
    )
    fit: str | None = Field(None, examples=['"result"'], description="folder of a fit whose intervals are the margins")
    constraints: list[str] | None = Field(
        None, examples=['["stroke"]'], description="constraints that hold with the margins; by default all but settling"
    )


def read_head(data: Mapping[str, Any]) -> SweepSection:
    """Check the names of all sections, and return the section ``[sweep]``.

    Args:
        data: Data of the sweep file.

    Raises:
        InputError: If a section is not known, or ``[sweep]`` is missing or not valid.
    """
    for key, value in data.items():
        if key not in SECTIONS:
            what = f"[{key}] is not a section of a sweep" if isinstance(value, dict) else f"{key} is not known"
            raise InputError(f"{what}{advice(key, SECTIONS, 'the sections are')}")
    check_schema(data)
    if "sweep" not in data:
        raise InputError('the section [sweep] is missing: add [sweep] with a line like rig = "rig.toml"')
    return validate(SweepSection, data["sweep"], "sweep")


def read_input(data: Mapping[str, Any]) -> InputSection:
    """Read the section of a sweep file.

    Args:
        data: Data of the sweep file.

    Raises:
        InputError: If it is missing, or a key or value is not valid.
    """
    if "input" not in data:
        lines = 'wave = "square", amplitude = "0.4 A" and frequency = "0.1 Hz"'
        raise InputError(f"the section [input] is missing: add [input] with lines like {lines}, or with a recording")
    return validate(InputSection, data["input"], "input")


def input_declarations(control: str, has_duty: bool) -> dict[str, Declaration]:
    """Return the parameters of a periodic input that can vary, by name.

    Args:
        control: Electrical input of the rig.
        has_duty: Whether the wave is square.
    """
    channel = CHANNELS[control]
    largest = channel.plausible_range[1]
    table = {
        f"{INPUT}amplitude": Declaration(channel.unit, f"amplitude of the {control}", 0.0, largest, None),
        f"{INPUT}frequency": Declaration("Hz", "frequency of the wave", MIN_FREQUENCY, MAX_FREQUENCY, None),
        f"{INPUT}offset": Declaration(channel.unit, f"{control} to which the wave is added", 0.0, largest, None),
    }
    duty = {f"{INPUT}duty": Declaration("1", "share of a cycle that is on", 0.0, 1.0, None)} if has_duty else {}
    return table | duty
