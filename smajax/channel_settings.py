"""What a rig file says about its recordings' files: which column is which channel, and how a text file is laid out."""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Annotated, Any

from pydantic import BaseModel, Field

from smajax.errors import InputError
from smajax.recording import ChannelMap
from smajax.rig_schema import channel_unit, one_of
from smajax.toml_file import STRICT, advice, show, validate
from smajax.units import CHANNELS, channel_of, conversion


@dataclass(frozen=True)
class ChannelSettings:
    """The section ``[channels]``: ``columns`` by channel, ``ignore`` headers that are no channels, and the layout of the file."""

    columns: Mapping[str, ChannelMap]
    ignore: tuple[str, ...] = ()
    skip_rows: int = 0
    delimiter: str = ","
    decimal: str = "."
    sheet: str | None = None

    def table(self) -> dict[str, Any]:
        """The section as a table that ``channel_settings`` takes back to the same settings."""
        plain = ChannelSettings({})
        layout = {key: getattr(self, key) for key in ("skip_rows", "delimiter", "decimal", "sheet")}
        unusual = {key: value for key, value in layout.items() if value != getattr(plain, key)}
        columns = {c: {"column": s.column, "unit": s.unit, "any_scale": s.any_scale or None} for c, s in self.columns.items()}
        return {"ignore": list(self.ignore) or None, **unusual, **columns}


class _Column(BaseModel):
    model_config = STRICT
    column: str | None = Field(None, min_length=1, examples=['"Laser (um)"'])
    unit: str | None = Field(None, examples=['"um"'])
    any_scale: bool = Field(False, examples=["true"])


class _Layout(BaseModel):
    model_config = STRICT
    unit: Any = None
    ignore: list[str] = Field([], examples=['["Operator", "Remarks"]'])
    skip_rows: int = Field(0, ge=0, le=10_000_000, examples=["3"])
    delimiter: str = Field(",", min_length=1, max_length=1, examples=['";"'])
    decimal: Annotated[str, one_of([".", ","])] = "."
    sheet: str | None = Field(None, examples=['"Sheet1"'])


def channel_settings(data: Any) -> ChannelSettings:
    """The settings from the section's data.

    A channel's unit may stand beside its column (``displacement = {column = "Laser (um)", unit = "um"}``), under ``[channels.unit]``, or,
    if only one channel is mapped, as ``unit`` alone.
    """
    for key in data if isinstance(data, dict) else ():
        if key not in _Layout.model_fields and channel_of(key) is None:
            known = [*CHANNELS, *_Layout.model_fields]
            raise InputError(f"channels.{key} is neither a channel nor an option{advice(key, known, 'there are')}")
    section = validate(_Layout, {k: v for k, v in data.items() if channel_of(k) is None} if isinstance(data, dict) else data, "channels")
    columns = {channel: _column(channel, source) for channel, source in data.items() if channel_of(channel)}
    units = _units(section.unit, columns)
    found = {}
    for channel in dict.fromkeys([*columns, *units]):
        source = columns.get(channel)
        unit = (source and source.unit) or units.get(channel)
        if unit is not None:
            try:
                conversion(unit, channel_unit(channel))
            except InputError as error:
                raise InputError(f"channels.{channel}: {error}") from None
        found[channel] = ChannelMap((source and source.column) or channel, unit, bool(source and source.any_scale))
    if section.delimiter == section.decimal:
        raise InputError(f'channels.delimiter and channels.decimal are both "{section.decimal}": set delimiter = ";" or "\\t"')
    return ChannelSettings(found, tuple(section.ignore), section.skip_rows, section.delimiter, section.decimal, section.sheet)


def _column(channel: str, source: Any) -> _Column:
    if not isinstance(source, str | dict):
        cure = 'write it like "Laser (um)" or {column = "Laser (um)", unit = "um"}'
        raise InputError(f"channels.{channel} = {show(source)} is not the header of a column: {cure}")
    return validate(_Column, {"column": source} if isinstance(source, str) else source, f"channels.{channel}")


def _units(unit: Any, columns: Mapping[str, _Column]) -> dict[str, str]:
    if unit is None:
        return {}
    if isinstance(unit, str):
        if len(columns) != 1:
            cure = 'write it like displacement = {column = "Laser (um)", unit = "um"}'
            raise InputError(f"channels.unit = '{unit}' does not say of which channel: {cure}")
        return {next(iter(columns)): unit}
    if not isinstance(unit, dict):
        raise InputError('channels.unit is not a table: write lines like displacement = "um" below [channels.unit]')
    for channel, text in unit.items():
        if channel_of(channel) is None:
            raise InputError(f"channels.unit has '{channel}', which is not a channel{advice(channel, CHANNELS, 'there are')}")
        if not isinstance(text, str):
            raise InputError(f'channels.unit.{channel} = {show(text)} is not a unit: write it like displacement = "um"')
    return dict(unit)
