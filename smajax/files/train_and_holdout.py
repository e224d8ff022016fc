"""Training and holdout recordings of one rig, with distinct names."""

import dataclasses
from collections.abc import Sequence
from pathlib import Path

from smajax.errors import InputError
from smajax.files.rig_file import Rig
from smajax.recordings.recording import Recording

# Folders that are added to a name to make it distinct; longer ones are replaced by the full path. Chosen by trial.
_MAX_DEPTH = 64


def read_train_and_holdout(
    rig: Rig, train: Sequence[Path], holdout: Sequence[Path], drop_bad_rows: bool
) -> list[tuple[Recording, str]]:
    """Read the recordings of a fit.

    Args:
        rig: The rig that all were made on.
        train: Files that are fitted.
        holdout: Files that are only scored.
        drop_bad_rows: Whether to omit rows that cannot be used.

    Returns:
        Pairs of a recording, with a distinct name, and its role, "train" or "holdout".

    Raises:
        InputError: If a recording cannot be used or is given twice, or only some of them have a time.
    """
    paths = [*train, *holdout]
    places = [path.resolve() for path in paths]
    for k, place in enumerate(places):
        if place in places[:k]:
            raise InputError(f"{paths[k]}: this recording is given twice: name each one once")
    recordings = [rig.read(path, drop_bad_rows=drop_bad_rows) for path in paths]
    if len({r.has_clock for r in recordings}) > 1:
        name = next(r.name for r in recordings if not r.has_clock)
        cure = "give it a time column, or fit it on its own"
        raise InputError(f"{name}: this recording has no time and the others do: {cure}")
    renamed = [dataclasses.replace(r, name=name) for r, name in zip(recordings, _short_names(places), strict=True)]
    return [(r, "train" if k < len(train) else "holdout") for k, r in enumerate(renamed)]


def _short_names(places: Sequence[Path]) -> list[str]:
    """Return file names with as many of their folders as are needed to make them distinct."""
    for depth in range(1, _MAX_DEPTH):
        names = ["/".join(place.parts[-depth:]) for place in places]
        if len(set(names)) == len(names):
            return names
    return [str(place) for place in places]
