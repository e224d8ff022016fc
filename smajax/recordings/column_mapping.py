"""Mapping of columns to channels, by headers ``name [unit]`` or by ``[channels]`` in the rig file."""

import math
import re
from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from smajax.channels import CHANNELS, channel_of, channel_suggestion, channel_unit
from smajax.errors import InputError, suggestion
from smajax.units import conversion

# Headers of a first column that pandas writes for the row numbers.
ROW_NUMBER_HEADERS = ("", "Unnamed: 0")
_HEADER = re.compile(r"(?P<name>[^\[\]]*+)(?:\[(?P<unit>[^\[\]]*+)\])?")


class ColumnNote(str):
    """Note of a recording on how a single column was read, which a table of the columns shows already."""

    __slots__ = ()


@dataclass(frozen=True)
class ChannelMap:
    """Column, scale and unit of a channel, as in ``[channels]`` of a rig file.

    The value in ``unit`` is ``factor * number / full_scale + offset``: newton from counts of a converter, or a duty
    from 0 to 1 where the file has 0 to 255.

    Attributes:
        column: Header of the column, with or without its unit.
        unit: Unit of the values; ``None`` if it is in the header.
        any_scale: Whether values outside the plausible range of the channel are accepted.
        factor: Factor of the numbers in the file; negative where they fall as the value rises.
        offset: Value where the number is 0, in ``unit``.
        full_scale: Number in the file that stands for 1 before the factor.
        limits: Least and largest value in ``unit``; values beyond them count as the limit, as those of a register that
            is full.
    """

    column: str
    unit: str | None = None
    any_scale: bool = False
    factor: float = 1.0
    offset: float = 0.0
    full_scale: float = 1.0
    limits: tuple[float, float] | None = None

    def __post_init__(self) -> None:
        for name in ("factor", "full_scale"):
            value = getattr(self, name)
            if not (math.isfinite(value) and value):
                raise InputError(f"{name} = {value} of column '{self.column}' is not possible: give another than 0")
        if not math.isfinite(self.offset):
            raise InputError(f"offset = {self.offset} of column '{self.column}' is not possible: give a number")
        if self.limits is not None and not self.limits[0] < self.limits[1]:
            problem = f"limits = {list(self.limits)} of column '{self.column}' are not possible"
            raise InputError(f"{problem}: give the least and the largest value, as in [0, 1]")

    @property
    def is_scaled(self) -> bool:
        """Whether the numbers in the file are not the values."""
        return (self.factor, self.offset, self.full_scale) != (1.0, 0.0, 1.0)

    def scaled(self, numbers: NDArray[np.float64]) -> NDArray[np.float64]:
        """Return the values of a column in ``unit``.

        Args:
            numbers: Numbers in the file, shape ``(rows,)``.
        """
        values = self._unlimited(numbers)
        return values if self.limits is None else np.clip(values, *self.limits)

    def limits_note(self, channel: str, numbers: NDArray[np.float64]) -> str:
        """Return a sentence on the values that count as a limit; empty if there are none.

        Args:
            channel: Name of the channel.
            numbers: Numbers in the file, shape ``(rows,)``.
        """
        if self.limits is None:
            return ""
        values = self._unlimited(numbers)
        count = np.count_nonzero((values < self.limits[0]) | (values > self.limits[1]))
        span = f"{self.limits[0]:.12g} to {self.limits[1]:.12g}"
        note = f"{count} of {len(values)} values of {channel} were limited to {span}, as the rig says"
        return ColumnNote(note) if count else ""

    def _unlimited(self, numbers: NDArray[np.float64]) -> NDArray[np.float64]:
        return numbers * (self.factor / self.full_scale) + self.offset if self.is_scaled else numbers

    def scale_text(self) -> str:
        """Return the scale as the right-hand side of an equation, for notes."""
        divided = f" / {self.full_scale:.12g}" if self.full_scale != 1 else ""
        factor = f"{self.factor:.12g} * " if self.factor != 1 else ""
        sign = "-" if self.offset < 0 else "+"
        return f"{factor}number{divided}" + (f" {sign} {abs(self.offset):.12g}" if self.offset else "")


@dataclass(frozen=True)
class FileColumn:
    """A column of a file that is a channel.

    Attributes:
        index: Number of the column in the file, from 0.
        header: Header of the column.
        name: Name of the channel.
        unit: Unit of the numbers in the file.
        any_scale: Whether values outside the plausible range of the channel are accepted.
        mapped: Whether the rig file maps the column to the channel.
        note: Sentence on the column for the notes of the recording; empty if there is none.
        source: Scale of the numbers in the file; ``None`` if they are the values.
    """

    index: int
    header: str
    name: str
    unit: str
    any_scale: bool = False
    mapped: bool = False
    note: str = ""
    source: ChannelMap | None = None


def assign_columns(
    path: Path | str,
    headers: Sequence[str],
    mapping: Mapping[str, ChannelMap],
    ignore: Sequence[str],
    stamps: Collection[int] = (),
    skipped: Collection[int] = (),
) -> list[FileColumn]:
    """Return the columns that are channels, in the order of the file.

    Args:
        path: The file, or the name of the object, for messages.
        headers: Headers of all columns.
        mapping: Column and unit by channel, as in the rig file.
        ignore: Headers (or names without unit) of columns that are not channels.
        stamps: Numbers of the columns of time stamps, whose unit is s.
        skipped: Numbers of columns that are left out.

    Raises:
        InputError: If a header is neither a channel nor mapped nor ignored, a unit is not valid, or a channel has two
            columns.
    """
    for name in mapping:
        if channel_of(name) is None:
            problem = f"[channels] {name} in the rig is not a known channel{channel_suggestion(name)}"
            raise InputError(f"{path}: {problem}: choose one of {', '.join(CHANNELS)}")
    columns: list[FileColumn] = []
    for index, header in enumerate(headers):
        if index in skipped:
            continue
        name, unit = name_and_unit(header)
        sources = {channel: source for channel, source in mapping.items() if source.column in (header, name)}
        if header in ignore or name in ignore:
            if sources:
                problem = f"column '{header}' is both ignored and mapped to {next(iter(sources))}"
                raise InputError(f"{path}: {problem}: remove one of the two")
            continue
        if not sources and index == 0 and header in ROW_NUMBER_HEADERS:
            continue
        if not header:
            cure = "write one like 'current [A]', or leave the column out with [channels] ignore = [\"\"] in the rig"
            raise InputError(f"{path}: column {index + 1} has no header: {cure}", code="header-blank", cure=cure)
        if index in stamps and "time" in (name, *sources):
            columns.append(FileColumn(index, header, "time", "s", mapped="time" in sources))
            continue
        for channel, source in sources.items():
            columns.append(_mapped_column(path, index, header, unit, channel, source))
        if not sources:
            if channel_of(name) is None:
                raise _unknown_header(path, header, name, headers, mapping, ignore)
            columns.append(FileColumn(index, header, name, _column_unit(path, header, name, unit)))
    _refuse_double_channels(path, columns)
    if not columns:
        raise InputError(f"{path}: every column is ignored: keep at least one of {', '.join(headers)}")
    return columns


def name_and_unit(header: str) -> tuple[str, str | None]:
    """Return the name and the unit in a header ``name [unit]``.

    Args:
        header: The header; its unit is ``None`` if it has none.
    """
    match = _HEADER.fullmatch(header)
    return (match["name"].rstrip(), match["unit"]) if match else (header, None)


def require_channels(
    path: Path | str, columns: Sequence[FileColumn], names: Sequence[str], mapping: Mapping[str, ChannelMap]
) -> None:
    """Check that a file has all required channels.

    Args:
        path: The file, or the name of the object, for messages.
        columns: Columns of the file that are channels.
        names: Required channels.
        mapping: Column and unit by channel, as in the rig file.

    Raises:
        InputError: If a channel is missing or unknown.
    """
    present = [column.name for column in columns]
    for name in names:
        if channel_of(name) is None:
            problem = f"'{name}' is not a known channel{channel_suggestion(name)}"
            raise InputError(f"{path}: {problem}: choose one of {', '.join(CHANNELS)}")
        if name not in present:
            source = f", which the rig maps to column '{mapping[name].column}'," if name in mapping else ""
            problem = f"the channel {name}{source} is missing{suggestion(name, present)}"
            cure = f"add a column '{_example_header(name)}' or map one to {name} under [channels] in the rig"
            if name == "time":
                cure += ', or set sample_period = "20 ms" under [recording] if the file has none'
            message = f"{path}: {problem}: it has {', '.join(present)}, so {cure}"
            example = _example_header(name)
            raise InputError(message, code="channel-missing", cure=cure, channel=name, example=example)


def _mapped_column(
    path: Path | str, index: int, header: str, unit: str | None, channel: str, source: ChannelMap
) -> FileColumn:
    mapped_unit = _column_unit(path, header, channel, source.unit or unit)
    differs = unit and unit.strip() != mapped_unit
    note = ColumnNote(f"column '{header}' was read in {mapped_unit}, as the rig says") if differs else ""
    if source.is_scaled:
        shown = "" if mapped_unit == "1" else f" {mapped_unit}"
        note = ColumnNote(f"{channel} was read as ({source.scale_text()}){shown} of column '{header}', as the rig says")
    scale = source if source.is_scaled or source.limits else None
    return FileColumn(index, header, channel, mapped_unit, source.any_scale, True, note, scale)


def _unknown_header(
    path: Path | str,
    header: str,
    name: str,
    headers: Sequence[str],
    mapping: Mapping[str, ChannelMap],
    ignore: Sequence[str],
) -> InputError:
    has_known_columns = any(channel_of(other.partition("[")[0].strip()) or other in ignore for other in headers)
    skip_hint = "" if has_known_columns or mapping else ", or set skip_rows if the header comes further down"
    problem = f"column '{header}' is not a known channel{channel_suggestion(name)}"
    cure = "rename it, map it under [channels] in the rig, or leave it out"
    cure += f' with [channels] ignore = ["{header}"]{skip_hint}'
    return InputError(f"{path}: {problem}: {cure}", code="unknown-column", cure=cure)


def _refuse_double_channels(path: Path | str, columns: Sequence[FileColumn]) -> None:
    first_of: dict[str, FileColumn] = {}
    for column in columns:
        first = first_of.setdefault(column.name, column)
        if first is not column:
            pair = f"columns {first.index + 1} ('{first.header}') and {column.index + 1} ('{column.header}')"
            cure = f"number them {column.name}_1 and {column.name}_2, or ignore one"
            raise InputError(f"{path}: {pair} are both {column.name}: {cure}")


def _column_unit(path: Path | str, header: str, name: str, unit: str | None) -> str:
    """Return the checked unit of a column; that of a fraction may be missing."""
    canonical = channel_unit(name)
    if not unit or not unit.strip():
        if canonical == "1":
            return "1"
        cure = f"write the header like '{_example_header(name)}', or give the unit under [channels]"
        message, example = f"{path}: column '{header}' has no unit: {cure}", _example_header(name)
        raise InputError(message, code="unit-missing", cure=cure, channel=name, example=example)
    try:
        conversion(unit.strip(), canonical)
    except InputError as error:
        raise InputError(f"{path}: column '{header}': {error}") from None
    return unit.strip()


def _example_header(name: str) -> str:
    return f"{name} [{CHANNELS[channel_of(name) or name].units[0]}]"
