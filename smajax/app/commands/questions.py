"""Questions in a terminal on what is doubtful in a file."""

import sys
from collections.abc import Sequence
from pathlib import Path

import typer

from smajax.app.output import say
from smajax.errors import InputError
from smajax.recordings.read_options import ReadOptions
from smajax.recordings.recognition.answers import LEFT_OUT, parse_answer
from smajax.recordings.recognition.findings import Question


def is_terminal() -> bool:
    """Return whether both input and output are a terminal, so that someone can answer."""
    return sys.stdin.isatty() and sys.stdout.isatty()


def ask_in_terminal(question: Question) -> str | None:
    """Ask a question until the answer is possible; return ``None`` for the choice that is offered.

    Args:
        question: The question.
    """
    is_value = "." in question.key and not question.is_column
    subject = question.key if is_value else question.key.replace("_", " ").capitalize()
    subject = f"Column '{question.key}'" if question.is_column else subject
    say(f"\n{subject}: {question.text}.")
    answers = [question.choice, *(other for other in question.others if other != question.choice)]
    for number, answer in enumerate(answers, 1):
        say(f"  {number}  {_in_words(question, answer)}{'  (Enter)' if number == 1 else ''}")
    example = (
        "a channel such as 'force [N] factor=-0.0087 offset=7.5', - to leave it out"
        if question.is_column
        else "a value"
    )
    while True:
        try:
            text = input(f"Number, or {example}: ").strip()
        except EOFError:  # the end of the input: nobody answers
            return None
        answer = answers[int(text) - 1] if text.isdigit() and 1 <= int(text) <= len(answers) else text
        if not answer or answer == question.choice:
            return None
        problem = _problem(question, answer)
        if not problem:
            return answer
        say(f"  {problem}")


def may_overwrite(paths: Sequence[Path]) -> bool:
    """Return whether files that exist may be replaced, which is asked in a terminal.

    Args:
        paths: The files to write.
    """
    existing = [path for path in paths if path.exists()]
    if not existing or not is_terminal():
        return False
    return typer.confirm(f"\nReplace {', '.join(str(path) for path in existing)}?", default=False)


def _in_words(question: Question, answer: str) -> str:
    if answer == LEFT_OUT:
        return "leave it out"
    return answer or "none: the rows have no time"


def _problem(question: Question, answer: str) -> str:
    """Return why an answer is not possible; empty if it is."""
    try:
        if question.check is not None:
            question.check(answer)
        elif question.is_column:
            parse_answer(question.key, answer)
        else:
            ReadOptions().replace(**{question.key: answer})
    except InputError as error:
        return str(error)
    return ""
