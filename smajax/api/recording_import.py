"""Import of a file whose layout and columns are not known: look at it, say what it is taken for, write a recording."""

import contextlib
import dataclasses
import os
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

from smajax.arguments import as_path
from smajax.errors import InputError
from smajax.files.channel_settings import ChannelSettings
from smajax.files.recording_sections import sections_text
from smajax.files.rig_draft import NO_RIG, Assumption, RigDraft, draft_rig, template_kinds
from smajax.files.rig_file import Rig
from smajax.files.toml import write_text
from smajax.recordings.read import read_recordings
from smajax.recordings.read_options import ReadOptions
from smajax.recordings.recognition.findings import Question
from smajax.recordings.recognition.recognise import Recognition, recognise, unrecognised
from smajax.recordings.recording import Recording
from smajax.report.recording_import import import_summary

# What decides a doubt: it gets the question and returns an answer, or None for the choice of the question.
Ask = Callable[[Question], str | None]
# The choice that leaves a value to the fit.
_FITTED = "fitted"


@dataclasses.dataclass(frozen=True, repr=False)
class RecordingImport:
    """A file that was looked at, and the recordings in it.

    Attributes:
        recognition: What the file was taken for, and why.
        recordings: The recordings: one, or several of a workbook or of a clock that begins again.
        questions: Doubts that nobody has decided, with the choices that were made.
        draft: A rig that reads the file and fits its recordings; ``None`` where they suggest none.
        no_rig: Why there is no rig; empty if there is one, or none is wanted.
    """

    recognition: Recognition
    recordings: tuple[Recording, ...]
    questions: tuple[Question, ...]
    draft: RigDraft | None = None
    no_rig: str = ""

    @property
    def rig(self) -> Rig | None:
        """The rig, for example for ``sma.fit(result.rig, result.recordings[0])``."""
        return self.draft.rig if self.draft is not None else None

    @property
    def options(self) -> ReadOptions:
        """Options with which the file is read."""
        return self.recognition.options

    @property
    def channels(self) -> ChannelSettings:
        """The section ``[channels]`` of a rig that reads the file."""
        return ChannelSettings(self.recognition.mapping(), self.recognition.ignored())

    def sections(self) -> str:
        """Return the sections ``[recording]`` and ``[channels]`` of a rig that reads the file as it is."""
        return sections_text(self.options, self.channels)

    def summary(self) -> str:
        """Return what each column was taken for and why, what is doubtful, and the sections of a rig."""
        draft = self.draft or self.no_rig
        return import_summary(self.recognition, self.recordings, self.questions, self.sections(), draft)

    def __repr__(self) -> str:
        return self.summary()

    def paths(self, folder: str | Path = "") -> list[Path]:
        """Return the files that ``save`` writes: one for each recording, the sections, and the rig.

        Args:
            folder: The folder.
        """
        folder, stem = Path(folder), self.recognition.path.stem
        several = len(self.recordings) > 1
        names = [f"{stem}-recording{f'-{k}' if several else ''}.csv" for k in range(1, len(self.recordings) + 1)]
        names += [f"{stem}-sections.toml", *([f"{stem}-rig.toml"] if self.draft is not None else [])]
        return [folder / name for name in names]

    def save(self, folder: str | Path = "", *, overwrite: bool = False) -> list[Path]:
        """Write the recordings as CSV with units in the headers, the sections of a rig, and the rig if there is one.

        Args:
            folder: The folder; made if it is not there.
            overwrite: Whether files that exist are replaced.

        Returns:
            The files.

        Raises:
            InputError: If a file exists (then none is written), or cannot be written.
        """
        folder, paths = Path(folder), self.paths(folder)
        for path in paths:
            if path.exists() and not overwrite:
                cure = "name another folder with --out, or overwrite=True in Python"
                raise InputError(f"{path}: this file exists and is not overwritten: {cure}")
        try:
            folder.mkdir(parents=True, exist_ok=True)
        except OSError as error:
            reason = error.strerror or error
            raise InputError(f"{folder}: the folder cannot be made ({reason}): name another one with --out") from None
        for recording, path in zip(self.recordings, paths, strict=False):
            recording.write(path)
        sections = paths[len(self.recordings)]
        write_text(sections, self._sections_file())
        if self.draft is not None:
            write_text(paths[-1], self.draft.text)
        return paths

    def _sections_file(self) -> str:
        """Return the sections with a comment that says what they are for."""
        name = self.recognition.path.name
        head = f"# Sections for a rig.toml that reads {name} as it is; the CSV written next to this file needs none.\n"
        return head + (self.sections() or "# None are needed.\n")


def import_recording(
    path: str | os.PathLike[str],
    *,
    channels: Mapping[str, str] | None = None,
    rig: str | None = None,
    values: Mapping[str, str] | None = None,
    ask: Ask | None = None,
    **reading: Any,
) -> RecordingImport:
    """Look at a file, and return what its layout and columns are taken for, with the recordings.

    Args:
        path: The file.
        channels: What columns are, by header: ``{"Force sensor": "force [N] factor=-0.0087 offset=7.5"}``, or ``"-"``
            for one to leave out; the others are recognised.
        rig: Kind of the rig; by default that which the channels suggest, and ``"none"`` for no rig.
        values: Values of the rig that no recording gives, by name: ``{"wire.diameter": "0.5 mm"}``.
        ask: Function that decides a doubt: it gets a ``Question`` and returns an answer, or ``None`` for its choice.
        **reading: Options of ``ReadOptions``, such as ``sample_period="20 ms"``, which stay as they are.

    Raises:
        InputError: If the file cannot be read, no column is recognised, or an answer or option is wrong.
    """
    recognition, questions = _decide(
        as_path("import_recording", "path", path, "the path of a file"), dict(channels or {}), dict(reading), ask
    )
    if not any(column.channel not in (None, "time") for column in recognition.columns):
        raise unrecognised(recognition)
    recordings = read_recordings(
        recognition.path,
        mapping=recognition.mapping(),
        ignore=recognition.ignored(),
        clock=recognition.has_clock,
        options=recognition.options,
    )
    result = RecordingImport(recognition, tuple(recordings), questions)
    return _with_rig(result, rig, dict(values or {}), ask)


def _with_rig(result: RecordingImport, kind: str | None, values: dict[str, str], ask: Ask | None) -> RecordingImport:
    """Return an import with a rig of a kind and with values, of which those that are not given are asked for."""
    name = result.recognition.path.stem + "-rig.toml"

    def draft(kind: str | None, values: Mapping[str, str]) -> RigDraft:
        return draft_rig(result.recordings, result.sections(), name, kind=kind, values=values)

    if kind == NO_RIG:
        return result
    try:
        proposal = draft(kind, values)
    except InputError as error:
        if kind is not None or values:
            raise
        return dataclasses.replace(result, no_rig=str(error))
    if ask is not None and kind is None:
        kind = ask(_kind_question(proposal, lambda text: text == NO_RIG or draft(text, values)))
        if kind == NO_RIG:
            return result
        proposal = draft(kind, values)
    for assumption in proposal.assumptions:
        if ask is None:
            break
        answer = ask(_value_question(assumption, lambda text, key=assumption.name: draft(kind, values | {key: text})))
        if answer is not None:
            values[assumption.name] = answer
    return dataclasses.replace(result, draft=draft(kind, values))


def _kind_question(draft: RigDraft, check: Callable[[str], object]) -> Question:
    """Return the question which kind of rig the recordings are of, with the kinds that are possible."""
    kinds = []
    for kind in template_kinds():
        with contextlib.suppress(InputError):
            check(kind)
            kinds.append(kind)
    others = (*(kind for kind in kinds if kind != draft.kind.kind), NO_RIG)
    text = f"{draft.kind.kind} is suggested, since {draft.kind.reason}"
    return Question("rig", text, draft.kind.kind, others, is_column=False, option=f"--rig {others[0]}", check=check)


def _value_question(assumption: Assumption, check: Callable[[str], object]) -> Question:
    """Return the question for a value that no recording gives."""
    text = f"{assumption.meaning}, which no recording gives"
    text += f", so that a fit finds it, from {assumption.value} on, unless you know it" if assumption.is_fitted else ""
    choice = _FITTED if assumption.is_fitted else assumption.value
    option = f"--set '{assumption.name} = {assumption.value}'"
    return Question(assumption.name, text, choice, is_column=False, option=option, check=check)


def _decide(
    path: Path, answers: dict[str, str], changes: dict[str, Any], ask: Ask | None
) -> tuple[Recognition, tuple[Question, ...]]:
    """Return what a file is taken for after all questions, and the questions that nobody has answered."""
    recognition = recognise(path, answers, changes)
    question_keys: set[str] = set()
    while ask is not None:
        question = next((q for q in recognition.questions if q.key not in question_keys), None)
        if question is None:
            break
        question_keys.add(question.key)
        answer = ask(question)
        if answer is None or answer == question.choice:
            continue
        if question.is_column:
            answers[question.key] = answer
        else:
            changes[question.key] = answer
        recognition = recognise(path, answers, changes)
    return recognition, tuple(q for q in recognition.questions if q.key not in question_keys)
