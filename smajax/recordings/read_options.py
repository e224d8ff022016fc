"""Options of the one reader of recordings: how a file is laid out, its clock, and what is done with bad rows.

The same names are keys of ``[recording]`` in a rig file, options of the command line (``--skip-rows``), and keyword
arguments of ``read_recording``, ``Rig.read`` and ``thermal_cycle_properties``.
"""

import dataclasses
import datetime
import math
import numbers
from collections.abc import Mapping, Sequence
from typing import Any, Literal, cast

from smajax.errors import InputError, suggestion
from smajax.units import as_text, parse_quantity

OnBadRows = Literal["refuse", "drop", "split"]
ON_BAD_ROWS = ("refuse", "drop", "split")
TopicInterpolation = Literal["refuse", "hold", "linear"]
TOPIC_INTERPOLATIONS = ("refuse", "hold", "linear")
# Name by which every sheet of a workbook is read.
ALL_SHEETS = "all"
# Rows before the header that may be skipped; chosen by trial.
MAX_SKIPPED_ROWS = 10_000_000
# Directives of a time format that say the day; a format without one is a time of day.
DATE_DIRECTIVES = ("%Y", "%y", "%d", "%j", "%m", "%b", "%B", "%c", "%x", "%G")


@dataclasses.dataclass(frozen=True)
class ReadOptions:
    """Options of reading a recording.

    Attributes:
        skip_rows: Rows of a text file or sheet before the header.
        header: Whether there is a row of headers; by default, unless ``columns`` are named and a cell of the row is a
            number.
        columns: Headers of a file without any, or in place of those in the file ("temperature [degC]").
        units_row: Whether the row after the header has the units; by default, if all of its cells are units.
        encoding: Encoding of a text file, such as ``utf-8``, ``utf-16`` or ``cp1252``; by default these three are
            distinguished.
        delimiter: Character between the cells of a text file.
        decimal: Decimal sign of a text file, ``.`` or ``,``.
        time_format: Format of time stamps with the directives of ``datetime.strptime`` ("%d.%m.%Y %H:%M:%S"); by
            default dates of ISO 8601 and times of day are recognised.
        sample_period: Time between two rows of a file without a time column, in s.
        date_column: Header of the column of dates where the time column has times of day; by default one named
            "date" next to times of day.
        sheet: Sheets of a workbook, or groups of a TDMS file; ``("all",)`` for all of them, empty for the first.
        variable: Matrix or struct of a .mat file, or member of a .json file, that has the columns; a field of a struct
            as in ``run.data``.
        clock_topic: Topic of a ROS bag or MCAP file whose messages are the rows; needed where columns are of several
            topics with different stamps.
        topic_interpolation: What is done with other topics at the stamps of ``clock_topic``: ``refuse``, ``hold`` the
            last message, or ``linear`` interpolation.
        on_bad_rows: What is done with rows that cannot be read or in which time does not increase: ``refuse`` the
            file, ``drop`` them, or drop them and ``split`` the recording where the clock begins again.
    """

    skip_rows: int = 0
    header: bool | None = None
    columns: tuple[str, ...] | None = None
    units_row: bool | None = None
    encoding: str | None = None
    delimiter: str = ","
    decimal: str = "."
    time_format: str | None = None
    sample_period: float | None = None
    date_column: str | None = None
    sheet: tuple[str, ...] = ()
    variable: str | None = None
    clock_topic: str | None = None
    topic_interpolation: TopicInterpolation = "refuse"
    on_bad_rows: OnBadRows = "refuse"

    def __post_init__(self) -> None:
        listed = {"columns": self.columns, "sheet": self.sheet}
        for name, value in listed.items():
            texts = (value,) if isinstance(value, str) else value
            object.__setattr__(self, name, None if texts is None else tuple(str(text) for text in texts))
        object.__setattr__(self, "sheet", self.sheet or ())
        if isinstance(self.sample_period, str):
            object.__setattr__(self, "sample_period", _period(self.sample_period))
        self._check_types()
        self._check_layout()
        self._check_clock()
        _check_choice("on_bad_rows", self.on_bad_rows, ON_BAD_ROWS)
        _check_choice("topic_interpolation", self.topic_interpolation, TOPIC_INTERPOLATIONS)

    def replace(self, **changes: Any) -> "ReadOptions":
        """Return the options with some changed.

        Args:
            **changes: New values by name.

        Raises:
            InputError: If a name or a value is not valid.
        """
        names = [field.name for field in dataclasses.fields(self)]
        for name in changes:
            if name not in names:
                hint = suggestion(name, names)
                raise InputError(f"'{name}' is not an option of reading{hint}: they are {', '.join(names)}")
        return dataclasses.replace(self, **changes)

    def changed(self) -> dict[str, Any]:
        """Return the options that differ from the defaults, by name."""
        default = ReadOptions()
        values = {field.name: getattr(self, field.name) for field in dataclasses.fields(self)}
        return {name: value for name, value in values.items() if value != getattr(default, name)}

    def table(self) -> dict[str, Any]:
        """Return the section ``[recording]`` of a rig file with the options that differ from the defaults."""
        table = {name: list(v) if isinstance(v, tuple) else v for name, v in self.changed().items()}
        if self.sample_period is not None:
            table["sample_period"] = as_text(self.sample_period, "s")
        if len(self.sheet) == 1:
            table["sheet"] = self.sheet[0]
        return table

    def _check_types(self) -> None:
        """Check the types of texts and of the number of rows, which the checks of their values rely on."""
        if not isinstance(self.skip_rows, numbers.Integral) or isinstance(self.skip_rows, bool):
            raise InputError(f"skip_rows = {self.skip_rows!r}: give the number of rows before the header")
        if isinstance(self.sample_period, bool) or not isinstance(self.sample_period, numbers.Real | None):
            raise InputError(f'sample_period = {self.sample_period!r} is not a time: give one such as "20 ms"')
        for name in ("delimiter", "decimal", "encoding", "time_format", "date_column", "variable", "clock_topic"):
            value = getattr(self, name)
            if not isinstance(value, str) and (value is not None or name in ("delimiter", "decimal")):
                raise InputError(f"{name} = {value!r} is of type {type(value).__name__}: give a text")

    def _check_layout(self) -> None:
        if not 0 <= self.skip_rows <= MAX_SKIPPED_ROWS:
            problem = "is negative" if self.skip_rows < 0 else f"is above {MAX_SKIPPED_ROWS}"
            raise InputError(f"skip_rows = {self.skip_rows} {problem}: give the number of rows before the header")
        if self.decimal not in (".", ","):
            raise InputError(f'decimal = "{self.decimal}" is not known: it is "." or ","')
        single = len(self.delimiter) == 1 and self.delimiter.isascii()
        if not single or self.delimiter.isalnum() or self.delimiter in '+-."\r\n':
            cure = 'give one such as ",", ";" or "\\t"'
            raise InputError(f"delimiter = {self.delimiter!r} is not possible: {cure}")
        if self.header is False and self.columns is None:
            raise InputError('header = false needs names: give columns = ["time [s]", "current [A]", ...]')
        if self.encoding is not None:
            _check_encoding(self.encoding)

    def _check_clock(self) -> None:
        period = self.sample_period
        if period is not None and not (math.isfinite(period) and period > 0):
            raise InputError(f'sample_period = {period} is not a time: give one such as "20 ms"')
        if self.time_format is None:
            return
        example = datetime.datetime(2024, 3, 1, 12, 30, 15, 250000)
        try:
            text = example.strftime(self.time_format)
            datetime.datetime.strptime(text, self.time_format)
            is_format = text != self.time_format
        except ValueError:
            is_format = False
        if not is_format:
            cure = 'write it with the directives of strptime, as in "%d.%m.%Y %H:%M:%S"'
            raise InputError(f'time_format = "{self.time_format}" is not a format: {cure}')
        if period is not None:
            raise InputError("time_format is for a time column and sample_period for none: keep one of the two")


def _check_choice(name: str, value: str, words: Sequence[str]) -> None:
    if value not in words:
        choices = ", ".join(f'"{word}"' for word in words)
        raise InputError(f'{name} = "{value}" is not known{suggestion(str(value), words)}: it is one of {choices}')


def check_delimiter(options: ReadOptions, path: Any) -> None:
    """Refuse a delimiter that is also the decimal sign.

    Args:
        options: The options.
        path: The text file, for the message.

    Raises:
        InputError: If they are the same.
    """
    if options.delimiter == options.decimal:
        problem = f'delimiter and decimal are both "{options.decimal}"'
        cure = 'set delimiter = ";" or "\\t"'
        raise InputError(f"{path}: {problem}: {cure}", code="delimiter-is-decimal", cure=cure)


def read_options(options: ReadOptions | None = None, changes: Mapping[str, Any] | None = None) -> ReadOptions:
    """Return options with changes.

    Args:
        options: The options; the defaults if ``None``.
        changes: New values by name.

    Raises:
        InputError: If a name or a value is not valid.
    """
    return (options or ReadOptions()).replace(**(changes or {}))


def _period(text: str) -> float:
    try:
        return cast(float, parse_quantity(text, "s"))
    except InputError as error:
        raise InputError(f"sample_period: {error}") from None


def _check_encoding(encoding: str) -> None:
    try:
        "a".encode(encoding)  # a codec from bytes to bytes, such as zlib, is refused as well
    except (LookupError, ValueError):
        hint = suggestion(encoding, ("utf-8", "utf-16", "cp1252", "latin-1"))
        cure = 'give one such as "utf-8", "utf-16" or "cp1252", or leave it out'
        raise InputError(f'encoding = "{encoding}" is not known{hint}: {cure}') from None
