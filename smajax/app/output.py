"""Output of the commands: what a terminal would act on, or cannot show, is printed as escapes."""

import io
import json
import sys

import typer

from smajax.errors import printable, printable_sentence


def escape_what_cannot_be_encoded() -> None:
    """Let stdout and stderr print escapes for characters that the console's encoding does not have."""
    for stream in (sys.stdout, sys.stderr):
        if isinstance(stream, io.TextIOWrapper):  # a stream of a test or of another program may be of another kind
            stream.reconfigure(errors="backslashreplace")


def say(text: object) -> None:
    """Print a text of one or several lines on stdout.

    Args:
        text: The text.
    """
    typer.echo(printable(str(text)))


def say_on_stderr(text: str) -> None:
    """Print a sentence of smajax on stderr.

    Args:
        text: The sentence, without the name of the command.
    """
    typer.echo(f"smajax: {printable_sentence(text)}", err=True)


def say_json(text: str) -> None:
    """Print a JSON document on stdout, with escapes of JSON for what is not printed as it is.

    Args:
        text: The document, which ends with a line feed.
    """
    encoding = getattr(sys.stdout, "encoding", None) or "utf-8"
    # Only strings of JSON have characters beyond ASCII.
    shown = (c if c.isascii() or _is_shown(c, encoding) else json.dumps(c)[1:-1] for c in text)
    typer.echo("".join(shown), nl=False)


def _is_shown(character: str, encoding: str) -> bool:
    """Return whether a character is printed as it is."""
    try:
        character.encode(encoding)
    except UnicodeEncodeError:
        return False
    return printable(character) == character
