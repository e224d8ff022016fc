"""Options of reading recordings, declared once for every command that reads them."""

import functools
import inspect
from collections.abc import Callable, Mapping
from enum import StrEnum
from pathlib import Path
from types import MappingProxyType
from typing import TYPE_CHECKING, Annotated, Any, TypeVar

import typer

if TYPE_CHECKING:
    from smajax.files.rig_file import Rig

# Delimiters that a shell cannot pass easily, by name.
_DELIMITERS = {"tab": "\t", "\\t": "\t", "space": " "}
_PANEL = "Reading of recordings"

# Options that were given, by attribute of ``ReadOptions``, and none.
Reading = Mapping[str, Any]
NO_CHANGES: Reading = MappingProxyType({})
Command = TypeVar("Command", bound=Callable[..., Any])


# What is done with bad rows; an enumeration, since Typer lists its values. By function, as str has a method ``split``.
_OnBadRows: type[StrEnum] = StrEnum("_OnBadRows", ["refuse", "drop", "split"])
# What is done with topics of other stamps than the clock's.
_TopicInterpolation: type[StrEnum] = StrEnum("_TopicInterpolation", ["refuse", "hold", "linear"])


def _option(*names: str, **settings: Any) -> Any:
    return typer.Option(*names, rich_help_panel=_PANEL, **settings)


# Options by attribute of ``ReadOptions``; ``drop_bad_rows`` is on_bad_rows = "drop".
_OPTIONS: dict[str, Any] = {
    "skip_rows": Annotated[
        int | None, _option("--skip-rows", min=0, metavar="ROWS", help="Rows before the header, such as a title.")
    ],
    "header": Annotated[
        bool | None,
        _option("--header/--no-header", help="Whether there is a row of headers (default: it is recognised)."),
    ],
    "columns": Annotated[
        str | None,
        _option(
            "--columns",
            metavar="A,B,...",
            help=r"Headers of a file without any, or in their place: 'temperature \[degC],strain \[%],-'; "
            "- is left out.",
        ),
    ],
    "units_row": Annotated[
        bool | None,
        _option("--units-row/--no-units-row", help="Whether units follow the header (default: it is recognised)."),
    ],
    "encoding": Annotated[
        str | None,
        _option("--encoding", metavar="NAME", help="Encoding (default: UTF-8, UTF-16 or cp1252 as recognised)."),
    ],
    "delimiter": Annotated[
        str | None,
        _option("--delimiter", metavar="CHARACTER", help="Character between columns; 'tab' and 'space' by name."),
    ],
    "decimal": Annotated[
        str | None, _option("--decimal", metavar="SIGN", help="The decimal sign of text files and cells: '.' or ','.")
    ],
    "time_format": Annotated[
        str | None,
        _option("--time-format", metavar="FORMAT", help="Format of time stamps, such as '%d.%m.%Y %H:%M:%S'."),
    ],
    "sample_period": Annotated[
        str | None,
        _option("--sample-period", metavar="TIME", help="Time between two rows without a time column: '20 ms'."),
    ],
    "date_column": Annotated[
        str | None,
        _option("--date-column", metavar="HEADER", help="Column of dates next to a time column with times of day."),
    ],
    "sheet": Annotated[
        list[str] | None,
        _option("--sheet", metavar="NAME", help="Sheet of a workbook or group of TDMS, or 'all'; may be repeated."),
    ],
    "variable": Annotated[
        str | None,
        _option(
            "--variable", metavar="NAME", help="Matrix or struct of a .mat, or member of a .json, with the columns."
        ),
    ],
    "clock_topic": Annotated[
        str | None,
        _option("--clock-topic", metavar="TOPIC", help="Topic of a ROS bag or MCAP file whose messages are the rows."),
    ],
    "topic_interpolation": Annotated[
        _TopicInterpolation | None,
        _option("--topic-interpolation", help="What is done with other topics at the stamps of --clock-topic."),
    ],
    "on_bad_rows": Annotated[
        _OnBadRows | None,
        _option(
            "--on-bad-rows",
            help="What is done with rows that cannot be read, or whose time does not increase; split drops them, and "
            "begins a recording where the clock begins again.",
        ),
    ],
    "drop_bad_rows": Annotated[
        bool, _option("--drop-bad-rows", help="Leave out such rows; they are counted in the result.")
    ],
}


def with_reading(command: Command) -> Command:
    """Give a command the options of reading.

    Args:
        command: The command; its argument ``reading`` gets the options that were given, by their names.
    """
    signature = inspect.signature(command, eval_str=True)
    parameters: list[inspect.Parameter] = []
    for parameter in signature.parameters.values():
        if parameter.name != "reading":
            parameters.append(parameter)
            continue
        for name, annotation in _OPTIONS.items():
            default = False if name == "drop_bad_rows" else None
            kind = inspect.Parameter.KEYWORD_ONLY
            parameters.append(inspect.Parameter(name, kind, default=default, annotation=annotation))
    keywords = [p.replace(kind=inspect.Parameter.KEYWORD_ONLY) for p in parameters]

    @functools.wraps(command)
    def command_with_options(**arguments: Any) -> Any:
        values = {name: arguments.pop(name) for name in _OPTIONS}
        return command(**arguments, reading=_changes(values))

    wrapper: Any = command_with_options
    wrapper.__signature__ = signature.replace(parameters=keywords)
    wrapper.__annotations__ = {p.name: p.annotation for p in keywords}
    return wrapper


def rig_with_reading(rig: Path, reading: Reading, drop_misplaced: bool = False) -> "Path | Rig":
    """Return a rig with its options of reading replaced by those that were given; the path if there are none.

    Args:
        rig: The rig file.
        reading: Options by attribute of ``ReadOptions``.
        drop_misplaced: Whether effects that do not apply to the rig are left out, as ``diagnose`` does.
    """
    if not reading:
        return rig
    from smajax.files.rig_file import read_rig

    return read_rig(rig, drop_misplaced=drop_misplaced).with_read_options(**reading)


def _changes(values: dict[str, Any]) -> dict[str, Any]:
    """Return the options that were given on the command line, as values of ``ReadOptions``."""
    changes = {name: value for name, value in values.items() if value not in (None, [], "")}
    if changes.pop("drop_bad_rows"):
        changes["on_bad_rows"] = "drop"
    for name in ("on_bad_rows", "topic_interpolation"):
        if name in changes:
            changes[name] = str(changes[name])
    if "columns" in changes:
        changes["columns"] = tuple(name.strip() for name in changes["columns"].split(","))
    if "delimiter" in changes:
        changes["delimiter"] = _DELIMITERS.get(changes["delimiter"], changes["delimiter"])
    return changes
