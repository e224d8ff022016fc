"""The section ``[channels]`` of a rig file: the columns of the channels, and the layout of a text file."""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Annotated, Any

from pydantic import BaseModel, Field

from smajax.channels import CHANNELS, channel_of, channel_unit
from smajax.errors import InputError
from smajax.files.toml import STRICT, advice, show, validate
from smajax.files.validators import one_of
from smajax.recordings.column_mapping import ChannelMap
from smajax.units import conversion

# Rows before the header that may be skipped; chosen by trial.
_MAX_SKIPPED_ROWS = 10_000_000


@dataclass(frozen=True)
class ChannelSettings:
    """The section ``[channels]``.

    Attributes:
        columns: Column and unit of each mapped channel, by channel.
        ignore: Headers of columns that are not channels.
        skip_rows: Rows before the header.
        delimiter: Character between the cells of a text file.
        decimal: Decimal sign of a text file.
        sheet: Sheet of a workbook; the first by default.
    """

    columns: Mapping[str, ChannelMap]
    ignore: tuple[str, ...] = ()
    skip_rows: int = 0
    delimiter: str = ","
    decimal: str = "."
    sheet: str | None = None

    def table(self) -> dict[str, Any]:
        """Return the section as a table that ``channel_settings`` reads back to the same settings."""
        default = ChannelSettings({})
        layout = {key: getattr(self, key) for key in ("skip_rows", "delimiter", "decimal", "sheet")}
        changed = {key: value for key, value in layout.items() if value != getattr(default, key)}
        columns = {
            c: {"column": s.column, "unit": s.unit, "any_scale": s.any_scale or None} for c, s in self.columns.items()
        }
        return {"ignore": list(self.ignore) or None, **changed, **columns}


class _Column(BaseModel):
    model_config = STRICT
    column: str | None = Field(None, min_length=1, examples=['"Laser (um)"'])
    unit: str | None = Field(None, examples=['"um"'])
    any_scale: bool = Field(False, examples=["true"])


class _Layout(BaseModel):
    model_config = STRICT
    unit: Any = None
    ignore: list[str] = Field([], examples=['["Operator", "Remarks"]'])
    skip_rows: int = Field(0, ge=0, le=_MAX_SKIPPED_ROWS, examples=["3"])
    delimiter: str = Field(",", min_length=1, max_length=1, examples=['";"'])
    decimal: Annotated[str, one_of([".", ","])] = "."
    sheet: str | None = Field(None, examples=['"Sheet1"'])


def channel_settings(data: Any) -> ChannelSettings:
    """Return the settings in the data of the section.

    The unit of a channel is given with its column (``displacement = {column = "Laser (um)", unit = "um"}``), under
    ``[channels.unit]``, or as ``unit`` alone if only one channel is mapped.

    Args:
        data: Content of ``[channels]`` as parsed from the file.

    Raises:
        InputError: If a key, a channel, a column or a unit is not valid.
    """
    for key in data if isinstance(data, dict) else ():
        if key not in _Layout.model_fields and channel_of(key) is None:
            keys = [*CHANNELS, *_Layout.model_fields]
            raise InputError(
                f"channels.{key} is neither a channel nor an option{advice(key, keys, 'the channels and options are')}"
            )
    layout_data = {k: v for k, v in data.items() if channel_of(k) is None} if isinstance(data, dict) else data
    layout = validate(_Layout, layout_data, "channels")
    columns = {channel: _read_column(channel, source) for channel, source in data.items() if channel_of(channel)}
    units = _read_units(layout.unit, columns)
    sources = {}
    for channel in dict.fromkeys([*columns, *units]):
        source = columns.get(channel)
        unit = (source and source.unit) or units.get(channel)
        if unit is not None:
            try:
                conversion(unit, channel_unit(channel))
            except InputError as error:
                raise InputError(f"channels.{channel}: {error}") from None
        sources[channel] = ChannelMap((source and source.column) or channel, unit, bool(source and source.any_scale))
    if layout.delimiter == layout.decimal:
        problem = f'channels.delimiter and channels.decimal are both "{layout.decimal}"'
        raise InputError(f'{problem}: set delimiter = ";" or "\\t"')
    return ChannelSettings(
        sources, tuple(layout.ignore), layout.skip_rows, layout.delimiter, layout.decimal, layout.sheet
    )


def _read_column(channel: str, source: Any) -> _Column:
    if not isinstance(source, str | dict):
        cure = 'write it like "Laser (um)" or {column = "Laser (um)", unit = "um"}'
        raise InputError(f"channels.{channel} = {show(source)} is not the header of a column: {cure}")
    return validate(_Column, {"column": source} if isinstance(source, str) else source, f"channels.{channel}")


def _read_units(unit: Any, columns: Mapping[str, _Column]) -> dict[str, str]:
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
