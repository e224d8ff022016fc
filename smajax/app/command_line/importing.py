"""The command import."""

import shlex
from pathlib import Path
from typing import Annotated

import typer

from smajax.app.command_line.reading import NO_CHANGES, Reading, with_reading
from smajax.app.output import say
from smajax.errors import InputError

# Files that are named one by one.
_MOST_NAMES = 5
# Longest ending of the files that are written, whose names begin with that of the recording.
_LONGEST_ENDING = "-recording-1000.csv"


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
    rig: Annotated[
        str | None,
        typer.Option(
            "--rig", metavar="KIND", help="Kind of the rig (default: as the channels suggest); none for no rig."
        ),
    ] = None,
    values: Annotated[
        list[str] | None,
        typer.Option(
            "--set", metavar="NAME=VALUE", help="A value of the rig: 'wire.diameter = 0.5 mm'; may be repeated."
        ),
    ] = None,
    reading: Reading = NO_CHANGES,
) -> None:
    """Look at a file, say what its columns are taken for and why, and write it as a recording, with a rig that fits it.

    In a terminal it asks about what is doubtful.
    """
    from smajax.api.recording_import import import_recording
    from smajax.app.commands.questions import ask_in_terminal, is_terminal, may_overwrite
    from smajax.recordings.paths import check_output_path
    from smajax.recordings.recognition.answers import answers_by_header

    check_output_path(out / f"{file.stem}{_LONGEST_ENDING}", "--out")
    ask = ask_in_terminal if is_terminal() else None
    result = import_recording(
        file,
        channels=answers_by_header(channel or []),
        rig=rig,
        values=dict(map(_named_value, values or [])),
        ask=ask,
        **reading,
    )
    say(result.summary())
    paths = result.save(out, overwrite=may_overwrite(result.paths(out)))
    between = f"... (as many as {len(paths) - 1} recordings)"
    names = [str(path) for path in (paths if len(paths) <= _MOST_NAMES else (paths[0], between, *paths[-2:]))]
    say(f"\nWrote {', '.join(names)}.")
    recording = shlex.quote(str(file))
    if result.draft is None:
        say(
            "Next: add the sections to a rig.toml ('smajax init KIND' writes one), then\n"
            f"      smajax check rig.toml {recording}"
        )
        return
    rig_file, fitted = (shlex.quote(str(path)) for path in (paths[-1], out / f"{file.stem}-fit"))
    say(f"Next: smajax check {rig_file} {recording}\n      smajax fit {rig_file} {recording} --out {fitted}")


def _named_value(text: str) -> tuple[str, str]:
    """Return name and value of a text such as ``wire.diameter = 0.5 mm``."""
    name, equals, value = text.partition("=")
    if not equals or not name.strip() or not value.strip():
        raise InputError(f"--set '{text}' is not a name and a value: write it like 'wire.diameter = 0.5 mm'")
    return name.strip(), value.strip()
