"""Record of a run: its timings, and the document run.json."""

import contextlib
import platform
import time
from collections.abc import Iterator
from dataclasses import dataclass, field
from datetime import UTC, datetime
from typing import Any

import jax

from smajax import __version__
from smajax.files.versions import package_versions


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


def run_record(command: str, rig: str, clock: Clock, seed: int | None, code: int) -> dict[str, Any]:
    """Return the entries of run.json that all studies have, except the list of files; ``argv`` is empty.

    Args:
        command: Name of the command.
        rig: Name of the rig, or of the subject of a sweep; empty without one.
        clock: Timings of the run.
        seed: Seed of the random numbers, or ``None``.
        code: The exit code.
    """
    return {
        "command": command,
        "argv": [],
        "rig": rig,
        "started": clock.started,
        "exit_code": code,
        "seed": seed,
        "versions": {"smajax": __version__, "python": platform.python_version(), **package_versions()},
        "machine": f"{platform.system()} {platform.machine()}, jax on {jax.default_backend()}",
        "timings": {part: round(seconds, 3) for part, seconds in clock.timings.items()},
    }
