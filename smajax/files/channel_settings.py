"""The section ``[channels]`` of a rig file: the columns of the channels, with their scales and units."""

import re
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Annotated, Any

from pydantic import BaseModel, Field

from smajax.channels import CHANNELS, channel_of, channel_unit
from smajax.errors import InputError
from smajax.files.toml import STRICT, advice, show, validate
from smajax.files.validators import one_of
from smajax.recordings.column_mapping import ChannelMap
from smajax.recordings.read_options import MAX_SKIPPED_ROWS
from smajax.units import conversion

# Names by which people call the raw numbers of a converter or timer, which are no units.
_RAW_UNIT = re.compile(r"(adc |raw )?(counts?|ticks?|bits?|digits?|lsb|adc|raw|pwm|steps?)|1/\d+", re.IGNORECASE)


@dataclass(frozen=True)
class ChannelSettings:
    """The section ``[channels]``.

    Attributes:
        columns: Column and unit of each mapped channel, by channel.
        ignore: Headers of columns that are not channels.
    """

    columns: Mapping[str, ChannelMap]
    ignore: tuple[str, ...] = ()

    def table(self) -> dict[str, Any]:
        """Return the section as a table that ``channel_settings`` reads back to the same settings."""
        columns = {}
        for channel, source in self.columns.items():
            scale = {key: getattr(source, key) for key in _SCALE}
            columns[channel] = {
                "column": source.column,
                "unit": source.unit,
                **{k: list(v) if k == "limits" else v for k, v in scale.items() if v != _SCALE[k]},
                "any_scale": source.any_scale or None,
            }
        return {"ignore": list(self.ignore) or None, **columns}


# Keys of a column that scale its numbers, with the values that leave them as they are.
_SCALE = {"factor": 1.0, "offset": 0.0, "full_scale": 1.0, "limits": None}


class Column(BaseModel):
    """The keys of a channel's column."""

    model_config = STRICT
    column: str | None = Field(
        None, min_length=1, examples=['"Laser (um)"'], description="header of the column in the file"
    )
    unit: str | None = Field(None, examples=['"um"'], description="unit of the numbers, after factor and offset")
    any_scale: bool = Field(
        False, examples=["true"], description="whether values far outside of the usual range are accepted"
    )
    factor: float = Field(
        1.0,
        allow_inf_nan=False,
        examples=["-0.0087"],
        description="factor of the numbers: value = factor * number / full_scale + offset",
    )
    offset: float = Field(0.0, allow_inf_nan=False, examples=["7.5"], description="offset of the values, in unit")
    full_scale: float = Field(
        1.0, gt=0, allow_inf_nan=False, examples=["255"], description="largest number of a converter"
    )
    limits: list[float] | None = Field(
        None, min_length=2, max_length=2, examples=["[0, 1]"], description="values beyond these two count as the limit"
    )


class Layout(BaseModel):
    """The keys that are not channels; those of ``OLD_KEYS`` are read by ``recording_options``."""

    model_config = STRICT
    unit: Any = Field(
        None, examples=['"mm"'], description="unit of the only mapped channel, or a table of units by channel"
    )
    ignore: list[str] = Field(
        [], examples=['["Operator", "Remarks"]'], description="headers of columns that are no channels"
    )
    skip_rows: int = Field(
        0, ge=0, le=MAX_SKIPPED_ROWS, examples=["3"], description="earlier place of recording.skip_rows"
    )
    delimiter: str = Field(
        ",", min_length=1, max_length=1, examples=['";"'], description="earlier place of recording.delimiter"
    )
    decimal: Annotated[str, one_of([".", ","])] = Field(".", description="earlier place of recording.decimal")
    sheet: str | None = Field(None, examples=['"Sheet1"'], description="earlier place of recording.sheet")


def channel_settings(data: Any) -> ChannelSettings:
    """Return the settings in the data of the section.

    The unit of a channel is given with its column (``displacement = {column = "Laser (um)", unit = "um"}``), under
    ``[channels.unit]``, or as ``unit`` alone if only one channel is mapped. ``factor``, ``offset`` and ``full_scale``
    make values of raw numbers (``force = {column = "ADC", factor = -0.0087, offset = 7.5, unit = "N"}``), and
    ``limits`` bounds them.

    Args:
        data: Content of ``[channels]`` as parsed from the file.

    Raises:
        InputError: If a key, a channel, a column or a unit is not valid.
    """
    for key in data if isinstance(data, dict) else ():
        if key not in Layout.model_fields and channel_of(key) is None:
            keys = [*CHANNELS, *Layout.model_fields]
            raise InputError(
                f"channels.{key} is neither a channel nor an option{advice(key, keys, 'the channels and options are')}"
            )
    layout_data = {k: v for k, v in data.items() if channel_of(k) is None} if isinstance(data, dict) else data
    layout = validate(Layout, layout_data, "channels")
    columns = {channel: _read_column(channel, source) for channel, source in data.items() if channel_of(channel)}
    units = _read_units(layout.unit, columns)
    sources = {}
    for channel in dict.fromkeys([*columns, *units]):
        source = columns.get(channel)
        unit = (source and source.unit) or units.get(channel)
        if unit is not None:
            _check_unit(channel, unit)
        scale = {key: getattr(source, key) for key in _SCALE} if source else {}
        scale["limits"] = tuple(source.limits) if source and source.limits else None
        column = (source and source.column) or channel
        try:
            sources[channel] = ChannelMap(column, unit, bool(source and source.any_scale), **scale)
        except InputError as error:
            raise InputError(f"channels.{channel}: {error}") from None
    return ChannelSettings(sources, tuple(layout.ignore))


def _check_unit(channel: str, unit: str) -> None:
    """Refuse a unit that does not convert to that of the channel; raw numbers need a scale."""
    try:
        conversion(unit, channel_unit(channel))
    except InputError as error:
        if not _RAW_UNIT.fullmatch(unit.strip()):
            raise InputError(f"channels.{channel}: {error}") from None
        result = CHANNELS[channel_of(channel) or channel].units[0]
        if channel_unit(channel) == "1":
            cure = "give the number that stands for 1, as in full_scale = 255, and no unit"
        else:
            cure = f'give the scale and the unit of the result, as in factor = 0.01, offset = 0.0, unit = "{result}"'
        raise InputError(f"channels.{channel}: '{unit}' is not a unit of {channel_of(channel)}: {cure}") from None


def _read_column(channel: str, source: Any) -> Column:
    if not isinstance(source, str | dict):
        cure = 'write it like "Laser (um)" or {column = "Laser (um)", unit = "um"}'
        raise InputError(f"channels.{channel} = {show(source)} is not the header of a column: {cure}")
    return validate(Column, {"column": source} if isinstance(source, str) else source, f"channels.{channel}")


def _read_units(unit: Any, columns: Mapping[str, Column]) -> dict[str, str]:
    """Return the units by channel that ``channels.unit`` gives."""
    if unit is None:
        return {}
    if isinstance(unit, str):
        if len(columns) != 1:
            cure = 'write it like displacement = {column = "Laser (um)", unit = "um"}'
            raise InputError(f"channels.unit = '{unit}' does not name its channel: {cure}")
        return {next(iter(columns)): unit}
    if not isinstance(unit, dict):
        raise InputError('channels.unit is not a table: write lines like displacement = "um" below [channels.unit]')
    for channel, text in unit.items():
        if channel_of(channel) is None:
            problem = f"channels.unit has '{channel}', which is not a channel"
            raise InputError(f"{problem}{advice(channel, CHANNELS, 'the channels are')}")
        if not isinstance(text, str):
            raise InputError(f'channels.unit.{channel} = {show(text)} is not a unit: write it like displacement = "um"')
    return dict(unit)
