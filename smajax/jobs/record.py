"""What is put down about every run: its folder, its exit code, and run.json."""

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
from smajax.versions import versions


class Outcome(NamedTuple):
    """What a job left: its folder, the result document (that of run.json for a simulation), the exit code and, if not 0, the reason.

    A ``note`` says what else happened.
    """

    folder: Path
    document: dict[str, Any]
    code: int
    reason: str = ""
    note: str = ""


@dataclass
class Clock:
    """When a run began, and the seconds spent on each part of it."""

    started: str = field(default_factory=lambda: datetime.now(UTC).isoformat(timespec="seconds"))
    timings: dict[str, float] = field(default_factory=dict)

    @contextlib.contextmanager
    def time(self, part: str) -> Iterator[None]:
        """Adds the time spent within to a part."""
        began = time.perf_counter()
        try:
            yield
        finally:
            self.timings[part] = self.timings.get(part, 0.0) + time.perf_counter() - began


class _Named(Protocol):
    @property
    def name(self) -> str: ...


def run_record(command: str, rig: _Named, argv: Sequence[str], clock: Clock, seed: int | None, code: int) -> dict[str, Any]:
    """The document run.json but for what only this command knows, and for the list of files."""
    return {
        "command": command,
        "argv": list(argv),
        "rig": rig.name,
        "started": clock.started,
        "exit_code": code,
        "seed": seed,
        "versions": {"smajax": __version__, "python": platform.python_version(), **versions()},
        "machine": f"{platform.system()} {platform.machine()}, jax on {jax.default_backend()}",
        "timings": {part: round(seconds, 3) for part, seconds in clock.timings.items()},
    }


def rig_text(path: Path) -> str:
    """The text of a rig file that has been read before."""
    try:
        return path.read_bytes().decode("utf-8-sig")
    except (OSError, UnicodeDecodeError) as error:
        raise InputError(f"{path}: the file cannot be read ({getattr(error, 'strerror', None) or 'not UTF-8'}): check it") from None
