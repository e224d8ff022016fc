"""The command import."""

from pathlib import Path
from typing import Annotated

import typer

from smajax.app.command_line.reading import NO_CHANGES, Reading, with_reading

# Files that are named one by one.
_MOST_NAMES = 5


@with_reading
def import_file(
    file: Annotated[Path, typer.Argument(metavar="FILE", help="A recording as it is.")],
    out: Annotated[
        Path, typer.Option("--out", metavar="DIR", help="The folder for the files; made if it is not there.")
    ] = Path(),
    channel: Annotated[
        list[str] | None,
        typer.Option(
            "--channel",
            metavar="COLUMN=CHANNEL",
            help=r"What a column is: 'load cell = force \[N] factor=-0.01 offset=7.5', or - for none; may be repeated.",
        ),
    ] = None,
    reading: Reading = NO_CHANGES,
) -> None:
    """Look at a file, say what its columns are taken for and why, and write it as a recording; asks in a terminal."""
    from smajax.api.recording_import import import_recording
    from smajax.app.commands.questions import ask_in_terminal, is_terminal, may_overwrite
    from smajax.recordings.recognition.answers import answers_by_header

    ask = ask_in_terminal if is_terminal() else None
    result = import_recording(file, channels=answers_by_header(channel or []), ask=ask, **reading)
    typer.echo(result.summary())
    paths = result.save(out, overwrite=may_overwrite(result.paths(out)))
    between = f"... (as many as {len(paths) - 1} recordings)"
    names = [str(path) for path in (paths if len(paths) <= _MOST_NAMES else (paths[0], between, *paths[-2:]))]
    typer.echo(f"\nWrote {', '.join(names)}.")
    typer.echo(
        "Next: add the sections to a rig.toml ('smajax init KIND' writes one), then smajax check rig.toml " + f"{file}"
    )
