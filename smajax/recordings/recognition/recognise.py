"""Recognition of a file: its layout, its columns and its clock."""

import contextlib
import dataclasses
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from smajax.channels import channel_of
from smajax.errors import InputError
from smajax.recordings.column_mapping import ROW_NUMBER_HEADERS, ChannelMap
from smajax.recordings.read_options import ReadOptions
from smajax.recordings.readers import TEXT_SUFFIXES, Table, open_tables
from smajax.recordings.recognition.answers import LEFT_OUT, check_headers
from smajax.recordings.recognition.bad_row_question import bad_row_question
from smajax.recordings.recognition.channel_choice import DRIVING, choose_channels
from smajax.recordings.recognition.clock import choose_clock, period_question
from smajax.recordings.recognition.column_choice import ColumnChoice, choose_column
from smajax.recordings.recognition.findings import Finding, Question
from smajax.recordings.recognition.header_words import is_own_header
from smajax.recordings.recognition.text_layout import Layout
from smajax.recordings.recognition.value_ranges import Floats, likely_channels, range_text

# Columns that are asked about where no channel is recognised.
_MAX_ASKED = 8


@dataclasses.dataclass(frozen=True)
class Recognition:
    """What a file was taken for.

    Attributes:
        path: The file.
        options: Options of reading.
        columns: What each column is taken for.
        findings: What was recognised in the layout, with reasons.
        questions: What is doubtful, with the choice that was made.
        rows: Number of rows of each table of the file.
    """

    path: Path
    options: ReadOptions
    columns: tuple[ColumnChoice, ...]
    findings: tuple[Finding, ...]
    questions: tuple[Question, ...]
    rows: tuple[int, ...]

    @property
    def has_clock(self) -> bool:
        """Whether there is a time column or a sample period."""
        return self.options.sample_period is not None or any(c.channel == "time" for c in self.columns)

    def mapping(self) -> dict[str, ChannelMap]:
        """Return the columns of channels whose headers do not say all, as in ``[channels]`` of a rig file."""
        return {
            column.channel: column.source
            for column in self.columns
            if column.channel and column.source and not is_own_header(column.header, column.channel, column.source)
        }

    def ignored(self) -> tuple[str, ...]:
        """Return the headers of the columns that are left out; the reader leaves out row numbers itself."""
        headers = [c.header for c in self.columns if c.channel is None and not (c.index == 0 and _is_row_number(c))]
        return tuple(dict.fromkeys(headers))


def recognise(path: Path, answers: Mapping[str, str], changes: Mapping[str, Any]) -> Recognition:
    """Return what a file is taken for.

    Args:
        path: The file.
        answers: What columns are, by header, as in ``parse_answer``.
        changes: Options of ``ReadOptions`` by name, which stay as they are.

    Raises:
        InputError: If the file cannot be read as a table, its sheets have different columns, no column is recognised,
            or an answer or option is wrong.
    """
    layout = recognise_layout(path, changes)
    tables = open_tables(path, layout.options)
    headers = tables[0].headers
    if not headers:
        raise InputError(f"{path}: there are no columns: record a time and the channels of the rig")
    check_headers(answers, headers, path)
    for table in tables[1:]:
        if table.headers != headers:
            problem = f"{table.label_kind} '{table.label}' has other columns than '{tables[0].label}'"
            raise InputError(f"{path}: {problem}: import them one by one, each named by --sheet")
    parts = [load_columns(table) for table in tables]
    values = {k: np.concatenate([part[k] for part in parts]) for k in range(len(headers))}
    choices = [choose_column(k, header, values[k], answers.get(header)) for k, header in enumerate(headers)]
    stamps = {k for k in tables[0].stamps if np.isfinite(values[k]).any()}
    choices = choose_clock(choices, values, stamps, layout.options.sample_period is not None)
    choices = choose_channels(choices, values)
    findings, questions = list(layout.findings), []
    if not layout.named or not any(c.channel not in (None, "time") and not c.is_answer for c in choices):
        choices = _with_questions(choices, values, layout.named)
    questions += [c.question for c in choices if c.question and c.header not in answers]
    if not any(c.channel == "time" for c in choices) and "sample_period" not in changes:
        question = period_question(choices, values)
        if any(channel_of(c.channel or "") in DRIVING for c in choices):
            questions.append(question)
        else:
            findings.append(
                Finding("time", "none", f"{question.text}, as those of a path; else give {question.option}")
            )
    questions += [question for question in layout.questions if question.key not in changes]
    options = layout.options
    question = _bad_rows(choices, parts, tables)
    if question is not None and question.key not in changes:
        questions.append(question)
        options = options.replace(on_bad_rows=question.choice)
    rows = tuple(len(part[0]) for part in parts)
    return Recognition(path, options, tuple(choices), tuple(findings), tuple(questions), rows)


def load_columns(table: Table) -> list[Floats]:
    """Return all columns of a table, with NaN in place of what is not a number.

    Args:
        table: The table.

    Raises:
        InputError: If no column can be read.
    """
    indices = range(len(table.headers))
    try:
        return table.load(indices, lenient=True)
    except InputError as error:
        first_error = error
    columns: dict[int, Floats] = {}
    for k in indices:  # variables of a .mat file may be texts, or have another length
        with contextlib.suppress(InputError):
            columns[k] = table.load([k], lenient=True)[0]
    if not columns:
        raise first_error
    lengths = [len(column) for column in columns.values()]
    rows = max(lengths, key=lengths.count)
    blank = np.full(rows, np.nan)
    return [columns[k] if k in columns and len(columns[k]) == rows else blank for k in indices]


def recognise_layout(path: Path, changes: Mapping[str, Any]) -> Layout:
    """Return the layout of a file.

    Args:
        path: The file.
        changes: Options of ``ReadOptions`` by name, which stay as they are.

    Raises:
        InputError: If the file is not a table, or an option is wrong.
    """
    options = ReadOptions().replace(**changes)
    fixed = [name for name, value in changes.items() if value is not None]
    ending = path.suffix.lower()
    if path.is_file() and path.stat().st_size and ending in TEXT_SUFFIXES:
        from smajax.recordings.recognition.text_layout import recognise_text

        return recognise_text(path, options, fixed)
    if path.is_file() and path.stat().st_size and ending == ".xlsx":
        from smajax.recordings.recognition.sheet_layout import recognise_workbook

        return recognise_workbook(path, options, fixed)
    return Layout(options)


def unrecognised(recognition: Recognition) -> InputError:
    """Return the error of a file in which no column but the time is recognised.

    Args:
        recognition: What the file was taken for.
    """
    columns = [c for c in recognition.columns if c.question is not None]
    listed = "; ".join(f"'{c.header}': {c.question.text}" for c in columns if c.question)
    if recognition.options.header is False and len(columns) == len(recognition.columns):
        names = ",".join(c.question.others[0] for c in columns if c.question)
        example = f"for example --columns '{names}' (columns in Python), with - for one to leave out"
        cure = f"name the columns by --columns, {example}"
    else:
        example = next((c.question.option for c in columns if c.question), "--columns")
        cure = f"say what they are, for example by {example} (channels in Python)"
    problem = f"no column is recognised as a channel ({listed})" if listed else "no column is recognised as a channel"
    return InputError(f"{recognition.path}: {problem}: {cure}")


def _with_questions(choices: Sequence[ColumnChoice], values: Mapping[int, Floats], named: bool) -> list[ColumnChoice]:
    """Return the choices with a question for the first columns that have numbers and are not recognised."""
    result = list(choices)
    open_choices = [c for c in choices if c.channel is None and not c.question and not c.is_answer]
    unknown = [c for c in open_choices if c.code == "unknown"]
    for choice in unknown[:_MAX_ASKED]:
        numbers = values[choice.index][np.isfinite(values[choice.index])]
        name = "its name does not say what it is, and" if named else "it has no name, and"
        text = f"{name} its values are {range_text(numbers)}"
        others = likely_channels(numbers)
        question = Question(choice.header, text, LEFT_OUT, others, True, f"--channel '{choice.header} = {others[0]}'")
        result[choice.index] = dataclasses.replace(choice, question=question)
    return result


def _bad_rows(
    choices: Sequence[ColumnChoice], parts: Sequence[Sequence[Floats]], tables: Sequence[Table]
) -> Question | None:
    """Return the question what is done with bad rows of all tables; ``None`` where every row is good."""
    if not any(choice.channel for choice in choices):
        return None
    questions = []
    for part, table in zip(parts, tables, strict=True):
        question = bad_row_question(choices, dict(enumerate(part)), table.first_row)
        if question is not None:
            place = f"sheet '{table.label}': " if table.label else ""
            questions.append(dataclasses.replace(question, text=place + question.text))
    # A clock that begins again in one sheet is worse than a repeated time in another.
    worst = [question for question in questions if question.choice == "split"] or questions
    if len(questions) > 1:
        text = f"{len(questions)} of {len(tables)} sheets have bad rows, as in {worst[0].text}"
        return dataclasses.replace(worst[0], text=text)
    return worst[0] if worst else None


def _is_row_number(choice: ColumnChoice) -> bool:
    return choice.header in ROW_NUMBER_HEADERS and choice.code == "counts-rows"
