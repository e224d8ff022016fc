"""The two ways in which smajax refuses to go on.

``InputError`` is a mistake in what was handed in: one sentence that names the file, row, column or key, and the cure (exit code 2).
``NumericsError`` is a calculation that failed: a code, the parameters that caused it, and what was saved before (exit code 3).
"""

import difflib
from collections.abc import Iterable, Mapping


class InputError(ValueError):
    """A mistake in a file or argument; the message is one sentence that names the place and the cure."""

    exit_code = 2


class NumericsError(ArithmeticError):
    """A calculation that failed; the message names the result code, the parameters and the cure.

    ``state`` holds the last good values by parameter name, in internal units, where there are any.
    """

    exit_code = 3

    def __init__(self, message: str, state: Mapping[str, float] | None = None):
        super().__init__(message)
        self.state = dict(state or {})


def nearest(word: str, known: Iterable[str]) -> str:
    """`` (did you mean 'x'?)`` for the known word nearest to ``word``, or an empty string if none is near."""
    near = difflib.get_close_matches(word, list(known), n=1, cutoff=0.5)
    return f" (did you mean '{near[0]}'?)" if near else ""
