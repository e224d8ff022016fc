"""Errors that smajax raises on purpose, and parts of their sentences.

``InputError`` reports a mistake in the input: one sentence that names the file, row, column or key, and the cure (exit
code 2). ``NumericsError`` reports a failed calculation: the result code, the parameters that caused it, and the results
that were saved before (exit code 3). ``Cancelled`` reports that a callback or Ctrl-C stopped the work before there was
a result (exit code 130). ``DerivativeError`` refuses a derivative that does not exist, in place of a wrong number.
"""

import difflib
import unicodedata
from collections.abc import Iterable, Mapping
from typing import Any

# Similarity (difflib's ratio, 0 to 1) from which a name is suggested; chosen by trial,
# tests/unit/files/test_bad_rigs.py holds it.
_MIN_SIMILARITY = 0.5
# Characters of a value, and of the message of another package, that a sentence shows; chosen to keep it on one line.
_VALUE_CHARACTERS = 30
_MESSAGE_CHARACTERS = 120


# Categories of Unicode that a terminal acts on in place of showing them, such as escapes and changes of the direction
# of text, and halves of characters, which stand for the bytes of a file name that is not UTF-8.
_NOT_SHOWN = ("Cc", "Cf", "Cs", "Zl", "Zp")
# Characters of the longest sentence that is printed: above that of all names of parameters.
_SENTENCE_CHARACTERS = 4000
# Python's numbers for bytes of a file name that are not UTF-8 (PEP 383).
_UNDECODED_BYTES = range(0xDC80, 0xDD00)


class InputError(ValueError):
    """A mistake in a file or argument; the message is one sentence that names the place and the cure.

    Attributes:
        code: Name of the kind of mistake for programs, empty where there is none.
        fields: What the sentence is about, by name: the parts of it that a front end may need.
    """

    exit_code = 2

    def __init__(self, message: str = "", *, code: str = "", **fields: Any):
        """Make the error.

        Args:
            message: The sentence.
            code: Name of the kind of mistake.
            **fields: What the sentence is about.
        """
        super().__init__(message)
        self.code: str = code
        self.fields: dict[str, Any] = fields

    def with_cure(self, cure: str) -> "InputError":
        """Return the error with another cure, for a front end whose options have other names.

        Args:
            cure: The text in place of the field ``cure``, which is a part of the sentence.

        Returns:
            The error with the new cure; the error itself where its sentence has no cure to replace.
        """
        old_cure = self.fields.get("cure", "")
        if not old_cure or old_cure not in str(self):
            return self
        before, _, after = str(self).rpartition(old_cure)
        return type(self)(before + cure + after, code=self.code, **(self.fields | {"cure": cure}))


class DerivativeError(InputError):
    """A derivative that does not exist; the message names the function and what to use instead."""


class NumericsError(ArithmeticError):
    """A failed calculation; the message names the result code, the parameters and the cure.

    Attributes:
        state: Last valid parameter values by name, in internal units; empty if there are none.
        rig: Text of a rig file with these values; empty if there is none.
        run: Record of the run that failed; empty if there is none.
    """

    exit_code = 3

    def __init__(self, message: str, state: Mapping[str, float] | None = None):
        """Make the error.

        Args:
            message: One sentence with the result code, the parameters and the cure.
            state: Last valid parameter values by name, in internal units.
        """
        super().__init__(message)
        self.state: dict[str, float] = dict(state or {})
        self.rig: str = ""
        self.run: dict[str, Any] = {}


class Cancelled(Exception):
    """The work was cancelled by its progress callback before there was a result."""

    exit_code = 130


def suggestion(word: str, candidates: Iterable[str]) -> str:
    """Return the suggestion of a name for a misspelt one, to append to a message.

    Args:
        word: The misspelt name.
        candidates: Names that exist.

    Returns:
        `` (did you mean 'x'?)`` with the most similar candidate; an empty string where none is similar.
    """
    matches = difflib.get_close_matches(str(word), list(candidates), n=1, cutoff=_MIN_SIMILARITY)
    return f" (did you mean '{matches[0]}'?)" if matches else ""


def shortened(text: str, length: int = _VALUE_CHARACTERS) -> str:
    """Return a text for a sentence, with three dots in place of what exceeds ``length`` characters.

    Args:
        text: The text.
        length: Largest number of characters, the dots included.
    """
    return text if len(text) <= length else text[: length - 3] + "..."


def printable(text: str) -> str:
    """Return a text of several lines for a terminal, with escapes in place of other control characters.

    Args:
        text: The text.
    """
    if text.isascii() and text.replace("\n", "").isprintable():
        return text
    return "".join(_escaped(c) if c != "\n" and unicodedata.category(c) in _NOT_SHOWN else c for c in text)


def printable_sentence(text: str) -> str:
    """Return a sentence for a terminal: one line, with escapes, and three dots in the middle of what is too long.

    Args:
        text: The sentence.
    """
    line = printable(text).replace("\n", "\\n")
    if len(line) <= _SENTENCE_CHARACTERS:
        return line
    half = _SENTENCE_CHARACTERS // 2
    return f"{line[:half]} ... {line[-half:]}"


def _escaped(character: str) -> str:
    if ord(character) in _UNDECODED_BYTES:
        return f"\\x{ord(character) - 0xDC00:02x}"
    return character.encode("unicode_escape").decode("ascii")


def first_line(error: Exception) -> str:
    """Return the beginning of the message of another package's error, for a sentence."""
    return (str(error).splitlines() or [type(error).__name__])[0][:_MESSAGE_CHARACTERS]


def missing_members(cls: type[Any]) -> str:
    """Return in words all that a class has to define and does not; empty if it is complete.

    Args:
        cls: A class derived from ``smajax.parameters.CheckedModule``.
    """
    names = [*missing_attributes(cls), *sorted(getattr(cls, "__abstractvars__", ()))]
    problems = [f"define {', '.join(map(repr, names))} in the body of the class"] if names else []
    return "; ".join([*problems, *filter(None, [missing_methods(cls)])])


def missing_methods(cls: type[Any]) -> str:
    """Return in words which abstract methods a class does not define; empty if it defines all of them.

    Args:
        cls: The class.
    """
    names = sorted(getattr(cls, "__abstractmethods__", ()))
    docs = [((getattr(cls, name).__doc__ or "").strip().splitlines() or [""])[0].rstrip(".") for name in names]
    purposes = [
        f"'{name}'" + (f" ({doc[0].lower()}{doc[1:]})" if doc else "") for name, doc in zip(names, docs, strict=True)
    ]
    return f"define the {'method' if len(names) == 1 else 'methods'} {', '.join(purposes)}" if names else ""


def missing_attributes(cls: type[Any]) -> list[str]:
    """Return the names in ``required_attributes`` of a class that have no value.

    Args:
        cls: A class derived from ``smajax.parameters.CheckedModule``.
    """
    return [name for name in cls.required_attributes if not hasattr(cls, name)]
