"""Models of the sections of a rig file that do not depend on the plant: ``[rig]`` and ``[fit]``."""

from typing import Annotated, Any

from pydantic import BaseModel, Field

from smajax.arguments import INTERPOLATIONS, MAX_SEED, MAX_STARTS
from smajax.files.rig_classes import rig_classes
from smajax.files.toml import STRICT
from smajax.files.validators import one_of

# The choice of ``rig.control`` for a wire that something else heats, such as water, an oven or a heat gun.
PRESCRIBED_TEMPERATURE = "temperature"


class RigSection(BaseModel):
    """The section ``[rig]``."""

    model_config = STRICT
    kind: Annotated[str, one_of(lambda: rig_classes().mechanisms)] = Field(
        examples=['"dead-weight"'], description="what the wire works against"
    )
    control: Annotated[str, one_of(lambda: (*rig_classes().drives, PRESCRIBED_TEMPERATURE))] | None = Field(
        None,
        examples=['"current"'],
        description="electrical input of the recordings, or a prescribed temperature; needed by every kind but path",
    )
    interpolation: Annotated[str, one_of(INTERPOLATIONS)] = Field(
        "hold", description="the input between samples: hold keeps the last value, linear interpolates"
    )
    parameters: Any = Field(
        None,
        examples=['"my-wire.toml"'],
        description="parameter set, shipped or a file; values of the rig file come before it",
    )


class FitSection(BaseModel):
    """The section ``[fit]``, checked without the plant."""

    model_config = STRICT
    model: Annotated[str, one_of(lambda: rig_classes().materials)] = Field("brinson", description="material law")
    free: list[str] = Field(
        [], examples=['["heat.h0", "heat.capacity"]'], description="parameters that are fitted, by SECTION.KEY"
    )
    per_recording: list[str] = Field(
        [],
        examples=['["environment.ambient"]'],
        description="fitted parameters that have another value in each recording",
    )
    initial: list[str] = Field(
        [], examples=['["temperature"]'], description="initial states that are fitted: temperature, detwinned, twinned"
    )
    bounds: dict[str, Any] = Field(
        {},
        examples=['{"heat.h0" = ["50 W/m^2/K", "200 W/m^2/K"]}'],
        description="lower and upper bound of fitted parameters",
    )
    observe: list[str] | None = Field(
        None,
        examples=['["displacement"]'],
        description="channels that are fitted and scored; by default the motion of the rig",
    )
    noise: dict[str, Any] = Field(
        {},
        examples=['{displacement = "0.02 mm"}'],
        description="standard deviation of a channel's noise; estimated where it is not given",
    )
    input_noise: Any = Field(
        None,
        examples=['"1 mA"'],
        description="standard deviation of the electrical input's noise, none, or estimated (the default)",
    )
    starts: int | None = Field(
        None,
        ge=1,
        le=MAX_STARTS,
        examples=["4"],
        description="points from which the search begins; 4, or one for each of more than ten free parameters",
    )
    seed: int = Field(0, ge=0, le=MAX_SEED, examples=["0"], description="seed of all random numbers")
