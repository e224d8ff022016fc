"""Record of a run: outcome, timings, and the document run.json."""

import contextlib
import platform
import time
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field
from datetime import UTC, datetime
from pathlib import Path
from typing import Any, NamedTuple, Protocol

import jax

from smajax import __version__
from smajax.errors import InputError
from smajax.files.versions import package_versions


class Outcome(NamedTuple):
    """Outcome of a job.

    Attributes:
        folder: The result folder.
        document: The result document; that of run.json for a simulation.
        code: The exit code.
        reason: Reason for an exit code other than 0.
        note: Sentence on anything else that the user should know.
    """

    folder: Path
    document: dict[str, Any]
    code: int
    reason: str = ""
    note: str = ""


@dataclass
class Clock:
    """Timings of a run.

    Attributes:
        started: Start of the run, ISO 8601 in UTC.
        timings: Wall time of each part in s.
    """

    started: str = field(default_factory=lambda: datetime.now(UTC).isoformat(timespec="seconds"))
    timings: dict[str, float] = field(default_factory=dict)

    @contextlib.contextmanager
    def time(self, part: str) -> Iterator[None]:
        """Add the wall time of the context to a part."""
        start = time.perf_counter()
        try:
            yield
        finally:
            self.timings[part] = self.timings.get(part, 0.0) + time.perf_counter() - start


class _Named(Protocol):
    @property
    def name(self) -> str: ...


def run_record(
    command: str, rig: _Named, argv: Sequence[str], clock: Clock, seed: int | None, code: int
) -> dict[str, Any]:
    """Return the entries of run.json that all commands have, except the list of files.

    Args:
        command: Name of the command.
        rig: The rig, or the subject of a sweep.
        argv: The command line.
        clock: Timings of the run.
        seed: Seed of the random numbers, or ``None``.
        code: The exit code.
    """
    return {
        "command": command,
        "argv": list(argv),
        "rig": rig.name,
        "started": clock.started,
        "exit_code": code,
        "seed": seed,
        "versions": {"smajax": __version__, "python": platform.python_version(), **package_versions()},
        "machine": f"{platform.system()} {platform.machine()}, jax on {jax.default_backend()}",
        "timings": {part: round(seconds, 3) for part, seconds in clock.timings.items()},
    }


def read_rig_text(path: Path) -> str:
    """Read the text of a rig file for its copy in the result folder.

    Raises:
        InputError: If the file can no longer be read.
    """
    try:
        return path.read_bytes().decode("utf-8-sig")
    except (OSError, UnicodeDecodeError) as error:
        reason = getattr(error, "strerror", None) or "not UTF-8"
        raise InputError(f"{path}: the file cannot be read ({reason}): check it") from None
