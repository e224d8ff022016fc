"""Summary of an import: what a file was taken for and why, what is doubtful, and the sections of a rig."""

from collections.abc import Sequence
from textwrap import wrap

from smajax.files.rig_draft import RigDraft
from smajax.recordings.column_mapping import ColumnNote
from smajax.recordings.recognition.answers import LEFT_OUT
from smajax.recordings.recognition.column_choice import ColumnChoice
from smajax.recordings.recognition.findings import Question
from smajax.recordings.recognition.recognise import Recognition
from smajax.recordings.recording import Recording
from smajax.report.summary import table

# Width of the text in columns of a terminal, and least width of the last column of a table.
_WIDTH = 110
_LEAST_WIDTH = 40
# Width of the other columns of a table, beyond which their texts go on in the next line.
_CELL_WIDTH = 36
# Recordings of a file that are listed.
_MOST_RECORDINGS = 8
# Columns that are left out for the same reason, from which on they share a row of the table.
_SHARED_FROM = 3


def import_summary(
    recognition: Recognition,
    recordings: Sequence[Recording],
    questions: Sequence[Question],
    sections: str,
    draft: RigDraft | str,
) -> str:
    """Return the summary as text for a terminal.

    Args:
        recognition: What the file was taken for.
        recordings: The recordings that were read.
        questions: Doubts that nobody has decided.
        sections: The sections of a rig that read the file.
        draft: The rig, or why there is none; empty if none is wanted.
    """
    rows = " + ".join(f"{count:,}" for count in recognition.rows)
    lines = [f"{recognition.path.name}: {rows} rows of {len(recognition.columns)} columns", ""]
    layout = [(f.subject, f.choice, f.reason) for f in recognition.findings]
    if layout:
        lines += [*_wrapped([("layout", "taken as", "because"), *layout]), ""]
    lines += [*_wrapped([("column", "taken as", "because"), *_column_rows(recognition)]), ""]
    for k, question in enumerate(questions, 1):
        lines += ["Doubts:"] if k == 1 else []
        lines += _doubt(k, question)
    lines += [""] if questions else []
    lines += _recording_lines(recordings)
    if sections:
        lines += ["", f"Sections of a rig.toml that read {recognition.path.name} as it is:", "", sections.rstrip()]
    elif recordings:
        lines += ["", f"A rig needs no section to read {recognition.path.name}."]
    lines += _rig_lines(draft)
    return "\n".join(line.rstrip() for line in lines)


def _rig_lines(draft: RigDraft | str) -> list[str]:
    """Return the sentences on the rig: its kind, what it fits, and the values in it that no recording gives."""
    if isinstance(draft, str):
        return ["", *wrap(f"No rig is written: {draft}.", _WIDTH)] if draft else []
    observed, free = ", ".join(draft.rig.fit.observe), ", ".join(draft.rig.fit.names)
    text = f"Rig: {draft.kind.kind}, since {draft.kind.reason}; it fits {observed} by {free}."
    lines = ["", *wrap(text, _WIDTH, break_on_hyphens=False)]
    alloy = "alloy" if draft.rig.kind == "path" else "alloy and heat transfer"
    fixed = [f"{a.name} = {a.value}" for a in draft.assumptions if not a.is_fitted]
    assumed = "".join(f"{value}, " for value in fixed)
    example = fixed[0] if fixed else "material.austenite_start = 68 degC"
    text = f"Assumed in it, as no recording gives it: {assumed}{alloy} of Flexinol wire. "
    for assumption in draft.assumptions:
        if assumption.is_fitted:
            text += f"For the same reason {assumption.name} is fitted, from {assumption.value} on. "
    text += f"Give what you know, as in --set '{example}' (values in Python), or correct it in the file. "
    text += "Of another alloy, free more: smajax explain free-parameters."
    return [*lines, *wrap(text, _WIDTH, break_long_words=False, break_on_hyphens=False)]


def _recording_lines(recordings: Sequence[Recording]) -> list[str]:
    """Return the channels of the recordings and their notes, each note once, and without those that the table has."""
    lines: list[str] = []
    shown: set[str] = set()
    for recording in recordings[:_MOST_RECORDINGS]:
        lines += wrap(repr(recording).strip("<>"), _WIDTH, subsequent_indent="  ")
        for note in recording.notes:
            if note not in shown and not isinstance(note, ColumnNote):
                lines += wrap(f"  {note}", _WIDTH, subsequent_indent="  ")
                shown.add(note)
    others = len(recordings) - _MOST_RECORDINGS
    return [*lines, f"and {others} more recordings"] if others > 0 else lines


def _column_rows(recognition: Recognition) -> list[tuple[str, str, str]]:
    """Return the rows of the table of columns; neighbours that are left out for the same reason share one."""
    rows: list[tuple[str, str, str]] = []
    groups: list[list[ColumnChoice]] = []
    for column in recognition.columns:
        if groups and groups[-1][-1].text == column.text == LEFT_OUT and groups[-1][-1].reason == column.reason:
            groups[-1].append(column)
        else:
            groups.append([column])
    for group in groups:
        names = [column.header or "(no name)" for column in group]
        if len(group) < _SHARED_FROM:
            texts = ["left out" if column.text == LEFT_OUT else column.text for column in group]
            rows += zip(names, texts, [column.full_reason for column in group], strict=True)
        else:
            rows.append((f"{names[0]} to {names[-1]}", f"left out ({len(group)})", group[0].reason))
    return rows


def _doubt(number: int, question: Question) -> list[str]:
    """Return the lines on a doubt, with the choice that was made and the option for another one."""
    if question.is_column:
        subject = question.key or "(no name)"
        choice = "it is left out" if question.choice == LEFT_OUT else f"taken as {question.choice}"
    else:
        subject = question.key.replace("_", " ")
        choice = f"{question.key} = {question.choice}" if question.choice else "the recording has no time"
    text = f"{number}. {subject}: {question.text}; {choice}. Otherwise give for example {question.option}"
    return wrap(text, _WIDTH, subsequent_indent="   ", break_long_words=False, break_on_hyphens=False)


def _wrapped(rows: Sequence[tuple[str, str, str]]) -> list[str]:
    """Return a table of three columns whose texts go on in further lines where they are long."""
    widths = [min(max(len(row[k]) for row in rows), _CELL_WIDTH) for k in (0, 1)]
    last = max(_WIDTH - sum(widths) - 6, _LEAST_WIDTH)
    lines: list[tuple[str, str, str]] = []
    for row in rows:
        cells = [wrap(text, width) or [""] for text, width in zip(row, (*widths, last), strict=True)]
        for k in range(max(len(cell) for cell in cells)):
            first, second, third = (cell[k] if k < len(cell) else "" for cell in cells)
            lines.append((first, second, third))
    return table(lines)
