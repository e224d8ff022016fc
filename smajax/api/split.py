"""One recording as training, selection and holdout recording, cut where the wire is at rest."""

import dataclasses
import math
from typing import Any

import numpy as np

from smajax.api.sources import one_source
from smajax.errors import InputError
from smajax.files.rig_file import Rig
from smajax.fitting.noise import difference_noise
from smajax.recordings.recording import Recording
from smajax.simulation.rest_rows import StartRows, rows_of

# Shares of the rows at which training and selection should end.
_ENDS = (0.5, 0.75)
# Least share of the rows of each part. Chosen by trial.
_LEAST_PART = 0.1
# Share of a channel's noise up to which a start in the middle may change it: with 0.5 an error grows by an eighth.
_OF_NOISE = 0.5
# What a split does not show, as a note of its last part.
_WARNING = (
    "it is a part of the same recording as the training rows, so that its error does not show how the model does with "
    "another input or load, at another ambient temperature, after another mounting, or on another day: record those"
)


def split_recording(rig: Rig, source: Any, drop_bad_rows: bool = False) -> list[Recording]:
    """Cut a recording into three: for training, selection and holdout, about half, a quarter and a quarter of the rows.

    Each part begins where the wire is at rest by the rig's values, since a model starts there.

    Args:
        rig: The rig.
        source: The recording: a path, a table in memory, or a ``Recording``.
        drop_bad_rows: Whether to omit rows that cannot be read.

    Returns:
        The three parts, whose times begin at 0; the last one has a note on what it does not show.

    Raises:
        InputError: If the recording cannot be read, or the wire is nowhere at rest near such a cut.
    """
    recording = rig.read(one_source(source, "train"), drop_bad_rows=drop_bad_rows)
    tolerances = {c: _OF_NOISE * difference_noise(recording.channels[c]) for c in rig.fit.observe}
    starts, rows, cuts = StartRows(rig.plant, recording, tolerances), len(recording), [0]
    for share in _ENDS:
        lowest, highest = cuts[-1] + math.ceil(_LEAST_PART * rows), math.floor((1.0 - _LEAST_PART) * rows)
        cut = starts.nearest(round(share * rows), lowest, highest)
        if cut is None:
            span = f"between {lowest:,} and {highest:,}"
            raise InputError(
                f"{recording.name}: --split finds no row {span} at which the wire is back in the state of a start by "
                "the rig's values: record three runs and name each, or let it cool down between loops"
            )
        cuts.append(cut)
    ends = [*cuts[1:], rows]
    parts = [
        _part(recording, name, first, last)
        for name, first, last in zip(("train", "select", "holdout"), cuts, ends, strict=True)
    ]
    parts[-1] = dataclasses.replace(parts[-1], notes=(*parts[-1].notes, _WARNING))
    return parts


def split_for_fit(rig: Rig, source: Any, drop_bad_rows: bool = False) -> tuple[Recording, Recording]:
    """Cut a recording into two for a fit: three quarters of its rows, and all of them with the last quarter measured.

    The model runs through the rows before the holdout, so that the cut need not be at rest.

    Args:
        rig: The rig.
        source: The recording: a path, a table in memory, or a ``Recording``.
        drop_bad_rows: Whether to omit rows that cannot be read.

    Returns:
        The training recording, and the holdout, whose observed channels are NaN before its own rows.

    Raises:
        InputError: If the recording cannot be read.
    """
    recording = rig.read(one_source(source, "train"), drop_bad_rows=drop_bad_rows)
    rows = len(recording)
    cut = math.ceil(_ENDS[-1] * rows)
    before = np.arange(rows) < cut
    channels = {c: np.where(before, np.nan, v) if c in rig.fit.observe else v for c, v in recording.channels.items()}
    note = f"rows {cut + 1:,} to {rows:,} are scored, those before bring the model into its state"
    notes = (*recording.notes, note, _WARNING)
    name = f"{recording.name} (holdout)"
    return _part(recording, "train", 0, cut), dataclasses.replace(recording, name=name, channels=channels, notes=notes)


def fit_sources(rig: Rig, train: Any, holdout: Any, split: bool, drop_bad_rows: bool) -> tuple[Any, Any]:
    """Return the training and holdout recordings of a fit: those that are given, or the parts of the only one.

    Args:
        rig: The rig.
        train: Training recordings.
        holdout: Holdout recordings; ``None`` for none.
        split: Whether the training recording is cut.
        drop_bad_rows: Whether to omit rows that cannot be read.

    Raises:
        InputError: If there is a holdout and a split, or the recording cannot be read.
    """
    if not split:
        return train, holdout
    refuse_others("fit", split, holdout=holdout)
    return split_for_fit(rig, train, drop_bad_rows)


def split_in_two(rig: Rig, source: Any, drop_bad_rows: bool = False) -> tuple[Recording, Recording]:
    """Cut a recording as ``split_recording`` does, with the first two parts as one training recording.

    Args:
        rig: The rig.
        source: The recording.
        drop_bad_rows: Whether to omit rows that cannot be read.

    Raises:
        InputError: As ``split_recording``.
    """
    train, select, holdout = split_recording(rig, source, drop_bad_rows)
    whole = rig.read(one_source(source, "train"), drop_bad_rows=drop_bad_rows)
    return _part(whole, "train", 0, len(train) + len(select)), holdout


def refuse_others(function: str, split: bool, **others: Any) -> None:
    """Check that a recording is split or that all others are given.

    Args:
        function: Name of the function, for messages.
        split: Whether the training recording is split.
        **others: The other recordings by argument; ``None`` where not given.

    Raises:
        InputError: If both or neither is asked for.
    """
    for name, value in others.items():
        given = value is not None and not (isinstance(value, list | tuple) and not value)
        if split and given:
            raise InputError(f"{function}: {name} is given and split, too: leave one of them out")
        if not split and not given:
            raise InputError(
                f"{function}: {name} is missing: give --{name} ({name}=), or --split (split=True) to cut one recording "
                "(smajax explain three-recordings)"
            )


def _part(recording: Recording, name: str, first: int, last: int) -> Recording:
    """Rows ``first`` to ``last`` of a recording, whose times begin at 0."""
    note = f"rows {first + 1:,} to {last:,} of {len(recording):,} of {recording.name}"
    part = rows_of(recording, first, last)
    return dataclasses.replace(part, name=f"{recording.name} ({name})", notes=(*recording.notes, note))
