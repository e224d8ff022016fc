"""The section ``[recording]`` of a rig file: layout and clock of its recordings, and what is done with bad rows."""

from collections.abc import Mapping
from typing import Annotated, Any

from pydantic import BaseModel, Field

from smajax.errors import InputError
from smajax.files.toml import STRICT, show, validate
from smajax.files.validators import one_of
from smajax.recordings.read_options import MAX_SKIPPED_ROWS, ON_BAD_ROWS, TOPIC_INTERPOLATIONS, ReadOptions

# Options that stood in [channels] before there was a section of their own; they are still read there.
OLD_KEYS = ("skip_rows", "delimiter", "decimal", "sheet")


class RecordingSection(BaseModel):
    """The section ``[recording]``; its keys are the attributes of ``ReadOptions``."""

    model_config = STRICT
    skip_rows: int = Field(0, ge=0, le=MAX_SKIPPED_ROWS, examples=["3"])
    header: bool | None = Field(None, examples=["false"])
    columns: list[str] | None = Field(None, min_length=1, examples=['["time [s]", "current [A]", "-"]'])
    units_row: bool | None = Field(None, examples=["true"])
    encoding: str | None = Field(None, min_length=1, examples=['"cp1252"'])
    delimiter: str = Field(",", min_length=1, max_length=1, examples=['";"'])
    decimal: Annotated[str, one_of([".", ","])] = "."
    time_format: str | None = Field(None, min_length=1, examples=['"%d.%m.%Y %H:%M:%S"'])
    sample_period: str | None = Field(None, examples=['"20 ms"'])
    date_column: str | None = Field(None, min_length=1, examples=['"Date"'])
    sheet: Any = Field(None, examples=['"Sheet1"'])
    variable: str | None = Field(None, min_length=1, examples=['"data"'])
    clock_topic: str | None = Field(None, min_length=1, examples=['"/load_cell"'])
    topic_interpolation: Annotated[str, one_of(TOPIC_INTERPOLATIONS)] = "refuse"
    on_bad_rows: Annotated[str, one_of(ON_BAD_ROWS)] = "refuse"


def recording_options(data: Mapping[str, Any]) -> ReadOptions:
    """Return the options of reading in the data of a rig file.

    Args:
        data: Sections of the file; options that older files have in ``[channels]`` are taken from there.

    Raises:
        InputError: If a key or a value is not valid, or an option is in both sections.
    """
    channels = data.get("channels", {})
    old = {key: channels[key] for key in OLD_KEYS if key in channels} if isinstance(channels, dict) else {}
    section = data.get("recording", {})
    twice = [key for key in old if isinstance(section, dict) and key in section]
    if twice:
        raise InputError(f"channels.{twice[0]} and recording.{twice[0]} are both given: keep recording.{twice[0]}")
    read = validate(RecordingSection, section, "recording")
    changes = {name: getattr(read, name) for name in read.model_fields_set} | old
    if changes.get("delimiter") == changes.get("decimal", "."):
        where = "recording" if "decimal" in read.model_fields_set else "channels"
        problem = f'{where}.delimiter and {where}.decimal are both "{changes["decimal"]}"'
        raise InputError(f'{problem}: set delimiter = ";" or "\\t"')
    sheet = changes.get("sheet", ())
    sheets = [sheet] if isinstance(sheet, str) else sheet
    if not isinstance(sheets, list | tuple) or not all(isinstance(name, str) and name for name in sheets):
        cure = 'write it like "Sheet1", ["50 MPa", "100 MPa"] or "all"'
        raise InputError(f"recording.sheet = {show(sheet)} is not the name of a sheet: {cure}")
    try:
        return ReadOptions().replace(**changes)
    except InputError as error:
        raise InputError(f"recording.{error}") from None
