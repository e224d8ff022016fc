"""Sentences on a recording that a controller file names: how it was read, and its channels that are not used."""

from collections.abc import Sequence

from smajax.recordings.recording import Recording


def recording_notes(recording: Recording, used: Sequence[str], reason: str) -> tuple[str, ...]:
    """Return the notes on a recording, with one on the channels that are not used.

    Args:
        recording: The recording.
        used: Channels that are used.
        reason: Why others are not, such as "the reference is the displacement".
    """
    others = [name for name in recording.channels if name not in used]
    unused = (f"recorded and not used, since {reason}: {', '.join(others)}",) if others else ()
    return tuple(f"{recording.name}: {note}" for note in (*recording.notes, *unused))
