"""Processes that a test or an experiment watches and kills."""

import contextlib

import psutil


def workers_of(parent: int) -> list[psutil.Process]:
    """The worker processes of a run on a cluster of its own, by the run's process number."""
    with contextlib.suppress(psutil.NoSuchProcess):
        return [
            p
            for p in psutil.Process(parent).children(recursive=True)
            if any("spawn_main" in word for word in p.cmdline())
        ]
    return []
