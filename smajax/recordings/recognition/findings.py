"""Sentences on what was recognised in a file, and questions on what is doubtful."""

from dataclasses import dataclass


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
    """

    key: str
    text: str
    choice: str
    others: tuple[str, ...] = ()
    is_column: bool = True
    option: str = ""
