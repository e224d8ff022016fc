"""Models of the sections of a rig file that do not depend on the plant: ``[rig]`` and ``[fit]``."""

from typing import Annotated, Any

from pydantic import BaseModel, Field

from smajax.arguments import MAX_SEED, MAX_STARTS
from smajax.files.toml import STRICT
from smajax.files.validators import one_of
from smajax.plant.drive import DRIVES
from smajax.plant.materials.registry import MATERIALS
from smajax.plant.mechanisms.registry import MECHANISMS

INTERPOLATIONS = ("hold", "linear")
# The choice of ``rig.control`` for a wire that something else heats, such as water, an oven or a heat gun.
PRESCRIBED_TEMPERATURE = "temperature"


class RigSection(BaseModel):
    """The section ``[rig]``."""

    model_config = STRICT
    kind: Annotated[str, one_of(MECHANISMS)] = Field(examples=['"dead-weight"'])
    control: Annotated[str, one_of((*DRIVES, PRESCRIBED_TEMPERATURE))] | None = Field(None, examples=['"current"'])
    interpolation: Annotated[str, one_of(INTERPOLATIONS)] = "hold"
    parameters: Any = Field(None, examples=['"my-wire.toml"'])


class FitSection(BaseModel):
    """The section ``[fit]``, checked without the plant."""

    model_config = STRICT
    model: Annotated[str, one_of(MATERIALS)] = "brinson"
    free: list[str] = Field([], examples=['["heat.h0", "heat.capacity"]'])
    per_recording: list[str] = Field([], examples=['["environment.ambient"]'])
    initial: list[str] = Field([], examples=['["temperature"]'])
    bounds: dict[str, Any] = Field({}, examples=['{"heat.h0" = ["50 W/m^2/K", "200 W/m^2/K"]}'])
    observe: list[str] | None = Field(None, examples=['["displacement"]'])
    noise: dict[str, Any] = Field({}, examples=['{displacement = "0.02 mm"}'])
    input_noise: Any = Field(None, examples=['"1 mA"'])
    starts: int | None = Field(None, ge=1, le=MAX_STARTS, examples=["4"])
    seed: int = Field(0, ge=0, le=MAX_SEED, examples=["0"])
