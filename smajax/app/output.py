"""Output of the commands: what a terminal would act on, or cannot show, is printed as escapes.

``print`` writes in the encoding of the console, where ``typer.echo`` takes ASCII for UTF-8.
"""

import io
import json
import sys

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
    print(printable(str(text)), flush=True)


def say_on_stderr(text: str) -> None:
    """Print a sentence of smajax on stderr.

    Args:
        text: The sentence, without the name of the command.
    """
    print(f"smajax: {printable_sentence(text)}", file=sys.stderr, flush=True)


def say_json(text: str) -> None:
    """Print a JSON document on stdout, with escapes of JSON for what is not printed as it is.

    Args:
        text: The document, which ends with a line feed.
    """
    encoding = getattr(sys.stdout, "encoding", None) or "utf-8"
    # Only strings of JSON have characters beyond ASCII.
    shown = (c if c.isascii() or _is_shown(c, encoding) else json.dumps(c)[1:-1] for c in text)
    print("".join(shown), end="", flush=True)


def _is_shown(character: str, encoding: str) -> bool:
    """Return whether a character is printed as it is."""
    try:
        character.encode(encoding)
    except UnicodeEncodeError:
        return False
    return printable(character) == character
