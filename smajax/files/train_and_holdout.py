"""Training and holdout recordings of one rig, with distinct names."""

import dataclasses
import itertools
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from smajax.errors import InputError
from smajax.files.rig_file import Rig
from smajax.recordings.recording import Recording
from smajax.recordings.sources import DEFAULT_NAME, RecordingSource, as_source_list, is_path

# Folders that are added to a name to make it distinct; longer ones are replaced by the full path. Chosen by trial.
_MAX_DEPTH = 64


def read_train_and_holdout(
    rig: Rig,
    train: RecordingSource | Sequence[RecordingSource],
    holdout: RecordingSource | Sequence[RecordingSource] = (),
    drop_bad_rows: bool = False,
) -> list[tuple[Recording, str]]:
    """Read the recordings of a fit.

    Args:
        rig: The rig that all were made on.
        train: Files, tables in memory or recordings that are fitted; one, or several in a list or tuple.
        holdout: Those that are only scored.
        drop_bad_rows: Whether to omit rows that cannot be used.

    Returns:
        Pairs of a recording, with a distinct name, and its role, "train" or "holdout"; a file with several sheets, or
        that is split at bad rows, gives several.

    Raises:
        InputError: If a recording cannot be used or is given twice, or only some of them have a time.
    """
    train, holdout = as_source_list(train), as_source_list(holdout)
    sources = [Path(source) if is_path(source) else source for source in [*train, *holdout]]
    names = _names(sources)
    _refuse_repeated(sources, names)
    in_memory = sum(not isinstance(source, Path | Recording) for source in sources)
    recordings: list[tuple[Recording, str]] = []
    for k, (source, name) in enumerate(zip(sources, names, strict=True)):
        renamed = isinstance(source, Recording) and name != source.name
        given_name = name if isinstance(source, Path) or in_memory > 1 or renamed else None
        parts = rig.read_all(source, name=given_name, drop_bad_rows=drop_bad_rows)
        if len(parts) == 1:
            parts = [dataclasses.replace(parts[0], name=name)]
        recordings += [(part, "train" if k < len(train) else "holdout") for part in parts]
    if len({recording.has_clock for recording, _ in recordings}) > 1:
        name = next(recording.name for recording, _ in recordings if not recording.has_clock)
        cure = "give it a time column or a sample_period, or fit it on its own"
        raise InputError(f"{name}: this recording has no time and the others do: {cure}")
    return recordings


def _refuse_repeated(sources: Sequence[Any], names: Sequence[str]) -> None:
    """Refuse a path or an object that is given twice."""
    keys = [source.resolve() if isinstance(source, Path) else id(source) for source in sources]
    for k, key in enumerate(keys):
        if key in keys[:k]:
            label = sources[k] if isinstance(sources[k], Path) else names[keys.index(key)]
            raise InputError(f"{label}: this recording is given twice: name each one once")


def _names(sources: Sequence[Any]) -> list[str]:
    """Return distinct names: those of files and recordings, "recording" and "recording 2" for tables in memory."""
    file_names = iter(_short_names([source.resolve() for source in sources if isinstance(source, Path)]))
    names: list[str] = []
    for source in sources:
        if isinstance(source, Path):
            name = next(file_names)
        else:
            name = source.name if isinstance(source, Recording) else DEFAULT_NAME
        numbered_names = (f"{name} {number}" for number in itertools.count(2))
        names.append(next(n for n in itertools.chain([name], numbered_names) if n not in names))
    return names


def _short_names(places: Sequence[Path]) -> list[str]:
    """Return file names with as many of their folders as are needed to make them distinct."""
    for depth in range(1, _MAX_DEPTH):
        names = ["/".join(place.parts[-depth:]) for place in places]
        if len(set(names)) == len(names):
            return names
    return [str(place) for place in places]
