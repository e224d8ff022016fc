"""Sentences on what was recognised in a file, and questions on what is doubtful."""

from collections.abc import Callable
from dataclasses import dataclass, field


@dataclass(frozen=True)
class Finding:
    """Something that was recognised in the layout of a file.

    Attributes:
        subject: What it is about, such as ``delimiter``.
        choice: What was chosen.
        reason: Why, in one sentence.
    """

    subject: str
    choice: str
    reason: str


@dataclass(frozen=True)
class Question:
    """Something that cannot be decided by the file alone.

    Attributes:
        key: What the answer is for: a header, or an option of ``ReadOptions``.
        text: The doubt in one sentence.
        choice: The answer that is taken if there is no other.
        others: Other possible answers.
        is_column: Whether the answer says what the column ``key`` is; otherwise it is a value of the option.
        option: Option of the command line with the same effect.
        check: Function that raises ``InputError`` for an answer that is not possible; ``None`` where the kind of the
            question says what is possible.
    """

    key: str
    text: str
    choice: str
    others: tuple[str, ...] = ()
    is_column: bool = True
    option: str = ""
    check: Callable[[str], object] | None = field(default=None, compare=False, repr=False)
