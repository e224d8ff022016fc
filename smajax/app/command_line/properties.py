"""The command properties."""

from enum import StrEnum
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from smajax.app.command_line.early_checks import check_files
from smajax.app.command_line.options import Json
from smajax.app.command_line.reading import NO_CHANGES, Reading, with_reading
from smajax.app.command_line.run import start_run
from smajax.app.output import say, say_json, say_on_stderr
from smajax.errors import Cancelled, InputError

if TYPE_CHECKING:
    from smajax.api.properties import PropertiesStudy


class TangentLine(StrEnum):
    """Lines along a transformation."""

    lines = "lines"
    steepest = "steepest"


@with_reading
def properties(
    recordings: Annotated[
        list[Path], typer.Argument(metavar="CYCLES.csv [MORE.csv ...]", help="Thermal cycles: temperature and strain.")
    ],
    smooth: Annotated[
        int | None,
        typer.Option(
            "--smooth",
            min=1,
            metavar="ROWS",
            help="Rows of the running median of the temperatures, an odd number (default: as their noise requires).",
        ),
    ] = None,
    tangent: Annotated[
        TangentLine,
        typer.Option(
            "--tangent",
            help="Along the transformation: one of three fitted lines, or the tangent where it is steepest.",
        ),
    ] = TangentLine.lines,
    write_set: Annotated[
        Path | None,
        typer.Option("--write-set", metavar="FILE.toml", help="Write a parameter set to start a fit from."),
    ] = None,
    model: Annotated[
        str, typer.Option("--model", metavar="LAW", help="The law that the set is for, as under [fit] of a rig.")
    ] = "brinson",
    reading: Reading = NO_CHANGES,
    quiet: Annotated[bool, typer.Option("--quiet", help="Show no progress.")] = False,
    as_json: Json = False,
) -> None:
    """Estimate the ASTM E3097 temperatures and strains of thermal cycles by tangents, with intervals."""
    if write_set is not None:
        from smajax.recordings.paths import check_output_file

        check_output_file(write_set, "--write-set")
    options = {"smooth": smooth, "tangent": tangent.value, **reading}
    study, interrupted = _analyse(recordings, None if write_set is None else model, options, quiet)
    if write_set is not None:
        _write_set(write_set, study)
    if as_json:
        say_json(_as_json(study))
    else:
        say(study.summary())
    if write_set is not None and not as_json:
        say(f'\nWrote {write_set}: name it in a rig by [rig] parameters = "{write_set.name}".')
    if write_set is not None:
        say_on_stderr(f"{write_set.name}: {study.document['guessed']}")
    if interrupted:
        raise Cancelled("interrupted after the analysis; its results are complete")


def _analyse(
    recordings: list[Path], model: str | None, options: dict[str, Any], quiet: bool
) -> tuple["PropertiesStudy", bool]:
    """Analyse the cycles, and return whether Ctrl-C was pressed at the end; messages name this command's options."""
    check_files(recordings=recordings)
    with start_run(quiet) as progress:
        from smajax.api.properties import thermal_cycle_properties
        from smajax.app.commands.properties_hints import with_cure_of_this_command

        try:
            study = thermal_cycle_properties(recordings, model=model, progress=progress, **options)
            return study, progress.interrupted
        except InputError as error:
            raise with_cure_of_this_command(error, error.fields.get("path"), options) from None


def _write_set(path: Path, study: "PropertiesStudy") -> None:
    from smajax.api.properties import START_VALUES
    from smajax.files.toml import write_text

    write_text(path, study.file_text(START_VALUES))


def _as_json(study: "PropertiesStudy") -> str:
    from smajax.files.documents import to_json

    return to_json(study.document).rstrip() + "\n"
