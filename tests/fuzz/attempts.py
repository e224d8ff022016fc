"""One try of the fuzzer: a mutated file, what reads it, and whether the answer is one of those that are allowed."""

import contextlib
import signal
import sys
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from random import Random
from types import FrameType

import numpy as np

from smajax.errors import InputError
from smajax.recordings.read import read_recordings
from smajax.recordings.recognition.recognise import recognise
from tests.fuzz import mutations
from tests.fuzz.samples import SAMPLES

# Seconds that reading a file of some kilobytes may take on a busy machine.
LIMIT_SECONDS = 10.0
# Bytes by which the memory may grow for such a file.
LIMIT_BYTES = 2**29

_MUTATIONS: dict[str, Callable[[bytes, Random], bytes]] = {
    "csv": mutations.mutate_text,
    "json": mutations.mutate_text,
    "mat5": mutations.mutate_mat5,
    "xlsx": mutations.mutate_archive,
}
_OPTIONS = ("columns", "delimiter", "decimal", "skip_rows", "sheet")
FORMATS = tuple(SAMPLES)


class TooSlow(BaseException):
    """A try that takes too long; no handler of ``Exception`` takes it for an error of the file."""


def mutated_file(kind: str, seed: int) -> tuple[str, bytes, dict]:
    """Return the ending, the bytes and the options of reading of a try.

    Args:
        kind: The format, a key of ``SAMPLES``.
        seed: Number of the try.
    """
    random = Random(f"{kind} {seed}")
    sample = random.choice(SAMPLES[kind])
    content = _MUTATIONS.get(kind, mutations.mutate)(sample.content, random)
    options = dict(sample.options)
    if random.random() < 0.25:
        options["drop_bad_rows"] = True
    return sample.suffix, content, options


def try_recording(kind: str, seed: int, folder: Path) -> str:
    """Read a mutated recording, and every fourth time also recognise its columns; return what came of it.

    Args:
        kind: The format.
        seed: Number of the try.
        folder: Folder for the file.
    """
    suffix, content, options = mutated_file(kind, seed)
    path = folder / f"wire{suffix}"
    path.write_bytes(content)
    with limited():
        try:
            recordings = read_recordings(path, required=("current",), observed=("displacement",), **options)
        except InputError as error:
            check_sentence(str(error))
            outcome = "refused"
        else:
            for recording in recordings:
                counts = {len(recording.time), *(len(values) for values in recording.channels.values())}
                assert len(counts) == 1 and all(np.isfinite(v).all() for v in recording.channels.values())
            outcome = "read"
    if seed % 4 == 0:
        with limited():
            try:
                recognise(path, {}, {name: options[name] for name in _OPTIONS if name in options})
            except InputError as error:
                check_sentence(str(error))
    return outcome


def check_sentence(text: str) -> None:
    """Check that the text of an error is not empty and not a wall of text."""
    assert text.strip() and len(text) < 100_000


@contextlib.contextmanager
def limited() -> Iterator[None]:
    """Raise ``TooSlow`` after some seconds, where the system has such a clock, and check time and memory."""
    begin, memory = time.monotonic(), peak_memory()
    has_clock = hasattr(signal, "setitimer")
    if has_clock:
        previous = signal.signal(signal.SIGALRM, _stop)
        signal.setitimer(signal.ITIMER_REAL, LIMIT_SECONDS)
    try:
        yield
    finally:
        if has_clock:
            signal.setitimer(signal.ITIMER_REAL, 0)
            signal.signal(signal.SIGALRM, previous)
    seconds, growth = time.monotonic() - begin, peak_memory() - memory
    assert seconds < LIMIT_SECONDS, f"{seconds:.1f} s"
    assert growth < LIMIT_BYTES, f"{growth / 2**20:.0f} MiB"


def peak_memory() -> int:
    """Return the largest memory of this process so far in bytes; 0 where the system does not tell."""
    try:
        import resource
    except ImportError:
        return 0
    unit = 1 if sys.platform == "darwin" else 1024
    return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss * unit


def _stop(number: int, frame: FrameType | None) -> None:
    raise TooSlow
