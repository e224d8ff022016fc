"""The record of a run: its outcome, its timings, and the document run.json."""

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
    """How a job ended.

    Attributes:
        folder: The result folder.
        document: The result document; that of run.json for a simulation.
        code: The exit code.
        reason: Why the code is not 0.
        note: What else happened.
    """

    folder: Path
    document: dict[str, Any]
    code: int
    reason: str = ""
    note: str = ""


@dataclass
class Clock:
    """When a run began (ISO 8601, UTC), and the wall time (s) of each part of it."""

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
    """Build the document run.json, without what only this command adds and without the list of files.

    Args:
        command: The command.
        rig: The rig, or the sweep's subject.
        argv: The command line.
        clock: The timings of the run.
        seed: The seed of random numbers, if any.
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


def rig_text(path: Path) -> str:
    """Read the text of a rig file.

    Raises:
        InputError: If it cannot be read, though it was read before.
    """
    try:
        return path.read_bytes().decode("utf-8-sig")
    except (OSError, UnicodeDecodeError) as error:
        reason = getattr(error, "strerror", None) or "not UTF-8"
        raise InputError(f"{path}: the file cannot be read ({reason}): check it") from None
